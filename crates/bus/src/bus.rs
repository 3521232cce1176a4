//! The session and what is sent straight from it.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use echosplat_model::{StampedPose, Timestamp};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

use crate::endpoints::{self, Endpoints};
use crate::keys::Keys;
use crate::publisher::MapPublisher;
use crate::streams::{PingSubscription, PoseSubscription, StatusSubscription};
use crate::subscriber::MapSubscriber;
use crate::zenoh_config::Plan;
use crate::{BusConfig, BusError, pose_message};

/// Name of the vehicle's frame in published poses (REP 105).
const VEHICLE_FRAME_ID: &str = "base_link";

/// An open session. Publishers and subscribers made from it keep it open until they are gone or
/// [`Bus::close`] is called.
#[derive(Debug)]
pub struct Bus {
    link: Arc<Link>,
    endpoints: Endpoints,
    pose_publisher: Publisher<'static>,
    pings: Sender<OutgoingPing>,
    pings_dropped: AtomicU64,
}

/// What publishers and subscribers share.
#[derive(Debug)]
pub(crate) struct Link {
    pub(crate) session: zenoh::Session,
    pub(crate) keys: Keys,
    pub(crate) config: BusConfig,
}

#[derive(Debug)]
struct OutgoingPing {
    frame: Vec<u8>,
    host_time: Timestamp,
}

/// While it is held, others see the service as alive.
#[derive(Debug)]
pub struct AliveToken(#[expect(dead_code, reason = "held for its end")] LivelinessToken);

impl Bus {
    /// Opens a session as `config` says; see [`crate::LOOPBACK`] for the default.
    ///
    /// # Errors
    /// If a setting or file is refused, or zenoh does not open within the time allowed. That
    /// nobody is there to connect to is no error.
    pub fn open(config: BusConfig) -> Result<Self, BusError> {
        let environment = std::env::var_os(zenoh::Config::DEFAULT_CONFIG_PATH_ENV);
        let environment = environment.filter(|path| !path.is_empty());
        let plan = Plan::new(&config, environment.map(PathBuf::from))?;
        let keys = Keys::new(&config.prefix, &config.node)?;
        for warning in &plan.endpoints.warnings {
            tracing::warn!("zenoh: {warning}");
        }
        let mut endpoints = plan.endpoints;
        let taken = endpoints::taken(&endpoints.listen);
        let limit = Duration::from_secs_f64(config.open_timeout_s);
        let session = within("opening the zenoh session", limit, move || {
            zenoh::open(plan.config).wait()
        })?
        .map_err(BusError::zenoh("open a session"))?;
        if !taken.is_empty() && is_alone(&session) {
            let warning = endpoints::held_by_a_stranger(&taken);
            tracing::warn!("zenoh: {warning}");
            endpoints.warnings.push(warning);
        }
        let pose_publisher = declare_pose_publisher(&session, &keys)?;
        let link = Arc::new(Link {
            session,
            keys,
            config,
        });
        let pings = start_ping_thread(&link)?;
        Ok(Self {
            link,
            endpoints,
            pose_publisher,
            pings,
            pings_dropped: AtomicU64::new(0),
        })
    }

    /// Where it connects to and listens, and what to warn of (also logged when opened).
    #[must_use]
    pub fn endpoints(&self) -> &Endpoints {
        &self.endpoints
    }

    /// The keys it uses.
    #[must_use]
    pub fn keys(&self) -> &Keys {
        &self.link.keys
    }

    /// The session's own name in the zenoh network.
    #[must_use]
    pub fn zenoh_id(&self) -> String {
        self.link.session.zid().to_string()
    }

    /// Sends a pose as JSON. Waits while the link is congested, up to zenoh's 5 s.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn publish_pose(&self, pose: &StampedPose) -> Result<(), BusError> {
        let frame_id = &self.link.config.frame_id;
        let json = pose_message::encode_json(pose, frame_id, VEHICLE_FRAME_ID);
        let put = self.pose_publisher.put(json).wait();
        put.map_err(BusError::zenoh("publish a pose"))
    }

    /// Whether somebody, in this process or beyond, takes poses.
    #[must_use]
    pub fn has_pose_subscriber(&self) -> bool {
        let status = self.pose_publisher.matching_status().wait();
        status.is_ok_and(|status| status.matching())
    }

    /// Hands a raw Ping frame over to be sent; never blocks. With the queue full the
    /// frame, being the newest, is dropped and counted.
    pub fn publish_ping(&self, frame: &[u8], host_time: Timestamp) {
        let frame = frame.to_vec();
        let sent = self.pings.try_send(OutgoingPing { frame, host_time });
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) = sent {
            self.pings_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Pings that [`Bus::publish_ping`] dropped.
    #[must_use]
    pub fn pings_dropped(&self) -> u64 {
        self.pings_dropped.load(Ordering::Relaxed)
    }

    /// Sends the service's status; lost if the link is congested.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn publish_status(&self, status: &serde_json::Value) -> Result<(), BusError> {
        let put = self
            .link
            .session
            .put(self.link.keys.status(), status.to_string());
        put.encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(BusError::zenoh("publish the status"))
    }

    /// Says that the service is there, until the token is dropped.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn declare_alive(&self) -> Result<AliveToken, BusError> {
        let token = self.link.session.liveliness();
        let token = token.declare_token(self.link.keys.alive()).wait();
        token
            .map(AliveToken)
            .map_err(BusError::zenoh("declare the liveliness token"))
    }

    /// Starts to publish the map.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn publish_map(&self) -> Result<MapPublisher, BusError> {
        MapPublisher::start(&self.link)
    }

    /// Starts to follow the map of this prefix and node.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn subscribe_map(&self) -> Result<MapSubscriber, BusError> {
        MapSubscriber::start(&self.link)
    }

    /// Starts to take poses.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn subscribe_poses(&self) -> Result<PoseSubscription, BusError> {
        PoseSubscription::start(&self.link)
    }

    /// Starts to take raw Ping frames, for mapping on another machine.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn subscribe_pings(&self) -> Result<PingSubscription, BusError> {
        PingSubscription::start(&self.link)
    }

    /// Starts to take the service's status.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn subscribe_status(&self) -> Result<StatusSubscription, BusError> {
        StatusSubscription::start(&self.link)
    }

    /// Closes the session, and with it everything made from it.
    ///
    /// # Errors
    /// If it takes longer than [`BusConfig::close_timeout_s`]; it then goes on in the background.
    pub fn close(self) -> Result<(), BusError> {
        let limit = self.link.config.close_timeout();
        let session = self.link.session.clone();
        let closed = within("closing the zenoh session", limit, move || {
            session.close().wait()
        })?;
        closed.map_err(BusError::zenoh("close the session"))
    }
}

#[cfg(test)]
impl Bus {
    pub(crate) fn session_for_tests(&self) -> &zenoh::Session {
        &self.link.session
    }
}

/// Whether no other session is connected.
fn is_alone(session: &zenoh::Session) -> bool {
    let info = session.info();
    info.peers_zid().wait().next().is_none() && info.routers_zid().wait().next().is_none()
}

fn declare_pose_publisher(
    session: &zenoh::Session,
    keys: &Keys,
) -> Result<Publisher<'static>, BusError> {
    let publisher = session.declare_publisher(keys.pose());
    publisher
        .encoding(Encoding::APPLICATION_JSON)
        .congestion_control(CongestionControl::Block)
        .wait()
        .map_err(BusError::zenoh("declare the publisher of poses"))
}

/// Sending may wait a millisecond for a congested link; the ping path must not.
fn start_ping_thread(link: &Arc<Link>) -> Result<Sender<OutgoingPing>, BusError> {
    let (sender, receiver) = bounded(link.config.ping_queue_len);
    let (session, key) = (link.session.clone(), link.keys.ping());
    spawn("bus-pings", move || send_pings(&session, &key, &receiver))?;
    Ok(sender)
}

fn send_pings(session: &zenoh::Session, key: &str, pings: &Receiver<OutgoingPing>) {
    for OutgoingPing { frame, host_time } in pings {
        let attachment = serde_json::json!({ "host_time_ns": host_time.nanos() });
        let sent = session
            .put(key, frame)
            .encoding(Encoding::APPLICATION_OCTET_STREAM)
            .attachment(attachment.to_string())
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::DataHigh)
            .wait();
        if sent.is_err() {
            return;
        }
    }
}

/// Starts a named thread.
pub(crate) fn spawn(
    name: &'static str,
    run: impl FnOnce() + Send + 'static,
) -> Result<std::thread::JoinHandle<()>, BusError> {
    let thread = std::thread::Builder::new().name(name.to_owned());
    thread.spawn(run).map_err(|reason| BusError::Zenoh {
        action: format!("start the thread {name}"),
        reason: reason.to_string(),
    })
}

/// Runs `work` on a thread of its own and waits for it no longer than `limit`. A thread of its
/// own also keeps zenoh's blocking calls out of whatever runtime the caller lives in.
fn within<T: Send + 'static>(
    action: &'static str,
    limit: Duration,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, BusError> {
    let (sender, receiver) = bounded(1);
    spawn("bus-session", move || {
        // Nobody may be waiting any more.
        let _ = sender.send(work());
    })?;
    receiver
        .recv_timeout(limit)
        .map_err(|_| BusError::TimedOut { action, limit })
}
