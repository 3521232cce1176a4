//! The session and what is sent straight from it.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use bytes::Bytes;
use crossbeam_channel::{Sender, TrySendError, bounded};
use echosplat_liveness::Heartbeat;
use echosplat_model::{Pose, StampedPose, Timestamp};
use serde::Serialize;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

use crate::alive::{self, AliveToken, Watch};
use crate::endpoints::{self, Endpoints};
use crate::keys::Keys;
use crate::listening::{self, Tried};
use crate::publisher::MapPublisher;
use crate::ros2::{self, NodeSlot, RosPublisher};
use crate::streams::{
    MAX_STATUS_BYTES, MessageSubscription, PingSubscription, PoseSubscription, StatusSubscription,
};
use crate::subscriber::MapSubscriber;
use crate::tape::{TapeFollower, TapeKeeper};
use crate::taps::{DeltaTap, StaticTransformTap, TapBoard};
use crate::zenoh_config::Plan;
use crate::{BusConfig, BusError, pose_message};

/// Name of the vehicle's frame in published poses (REP 105).
pub(crate) const VEHICLE_FRAME_ID: &str = "base_link";

/// An open session. Publishers and subscribers made from it keep it open until they are gone or
/// [`Bus::close`] is called.
#[derive(Debug)]
pub struct Bus {
    link: Arc<Link>,
    endpoints: Endpoints,
    pose_publisher: Publisher<'static>,
    pings: Sender<OutgoingPing>,
    ping_heartbeat: Heartbeat,
    tally: Arc<Tally>,
    others: OnceLock<Watch>,
}

/// What was sent outside the map, and what was not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct BusCounters {
    /// Pings given to zenoh. What it drops under congestion it does not tell.
    pub pings_sent: u64,
    /// Newest pings dropped because the queue was full.
    pub pings_dropped: u64,
    /// Pings that zenoh refused.
    pub pings_failed: u64,
    /// Statuses given to zenoh.
    pub statuses_sent: u64,
    /// Statuses longer than any subscriber takes, or that zenoh refused.
    pub statuses_failed: u64,
}

#[derive(Debug, Default)]
struct Tally {
    pings_sent: AtomicU64,
    pings_dropped: AtomicU64,
    pings_failed: AtomicU64,
    statuses_sent: AtomicU64,
    statuses_failed: AtomicU64,
}

/// What publishers and subscribers share.
#[derive(Debug)]
pub(crate) struct Link {
    pub(crate) session: zenoh::Session,
    pub(crate) keys: Keys,
    pub(crate) config: BusConfig,
    pub(crate) taps: TapBoard,
    pub(crate) ros: NodeSlot,
}

#[derive(Debug)]
struct OutgoingPing {
    frame: Bytes,
    host_time: Timestamp,
}

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
        let mut endpoints = plan.endpoints;
        let tried = listening::try_all(&endpoints.listen);
        let limit = Duration::from_secs_f64(config.open_timeout_s);
        let session = within("opening the zenoh session", limit, move || {
            zenoh::open(plan.config).wait()
        })?
        .map_err(BusError::zenoh("open a session"))?;
        look_around(&session, tried, &mut endpoints);
        for warning in &endpoints.warnings {
            tracing::warn!("zenoh: {warning}");
        }
        let pose_publisher = declare_pose_publisher(&session, &keys)?;
        let link = Arc::new(Link {
            session,
            keys,
            config,
            taps: TapBoard::default(),
            ros: NodeSlot::default(),
        });
        let tally = Arc::new(Tally::default());
        let ping_heartbeat = Heartbeat::new("bus-pings");
        let pings = start_ping_thread(&link, &tally, ping_heartbeat.clone())?;
        Ok(Self {
            link,
            endpoints,
            pose_publisher,
            pings,
            ping_heartbeat,
            tally,
            others: OnceLock::new(),
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
    pub fn publish_ping(&self, frame: Bytes, host_time: Timestamp) {
        let sent = self.pings.try_send(OutgoingPing { frame, host_time });
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) = sent {
            count(&self.tally.pings_dropped);
        }
    }

    /// Whether the thread that sends pings is alive; it goes on after a panic.
    #[must_use]
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.ping_heartbeat
    }

    /// Pings that [`Bus::publish_ping`] took and that were not sent.
    #[must_use]
    pub fn pings_dropped(&self) -> u64 {
        let counters = self.counters();
        counters.pings_dropped + counters.pings_failed
    }

    /// What was sent outside the map, and what was not.
    #[must_use]
    pub fn counters(&self) -> BusCounters {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        BusCounters {
            pings_sent: read(&self.tally.pings_sent),
            pings_dropped: read(&self.tally.pings_dropped),
            pings_failed: read(&self.tally.pings_failed),
            statuses_sent: read(&self.tally.statuses_sent),
            statuses_failed: read(&self.tally.statuses_failed),
        }
    }

    /// Sends the service's status; lost if the link is congested. Never waits long: zenoh drops it
    /// after a millisecond, one of several fragments after 50 ms.
    ///
    /// # Errors
    /// If it is longer than a subscriber takes, 256 KiB, or the session is closed.
    pub fn publish_status(&self, status: &serde_json::Value) -> Result<(), BusError> {
        self.publish_status_on(self.link.keys.status(), status)
    }

    /// The same for a driver that runs apart from its mapper.
    ///
    /// # Errors
    /// As [`Bus::publish_status`].
    pub fn publish_driver_status(&self, status: &serde_json::Value) -> Result<(), BusError> {
        self.publish_status_on(self.link.keys.driver_status(), status)
    }

    fn publish_status_on(&self, key: String, status: &serde_json::Value) -> Result<(), BusError> {
        let sent = self.put_status(key, status.to_string());
        count(match sent {
            Ok(()) => &self.tally.statuses_sent,
            Err(_) => &self.tally.statuses_failed,
        });
        sent
    }

    fn put_status(&self, key: String, json: String) -> Result<(), BusError> {
        if json.len() > MAX_STATUS_BYTES {
            return Err(BusError::TooLong {
                what: "status",
                found: json.len(),
                limit: MAX_STATUS_BYTES,
            });
        }
        let put = self.link.session.put(key, json);
        put.encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(BusError::zenoh("publish the status"))
    }

    /// Words naming another service of this node, if one is on the bus in any of these roles; to be
    /// asked before [`Bus::declare_alive`]. Where it is told to connect to others and none is
    /// there yet, it is asked again until `limit` is over; else once, in milliseconds.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn service_alive_elsewhere(
        &self,
        roles: &[&str],
        limit: Duration,
    ) -> Result<Option<String>, BusError> {
        let connects = !self.endpoints.connects_elsewhere().is_empty();
        let may_connect = || connects && company(&self.link.session) == 0;
        alive::elsewhere(&self.link, roles, limit, may_connect)
    }

    /// Says that the service is there in this role ([`crate::MAPPER_ROLE`],
    /// [`crate::DRIVER_ROLE`]), until the token is dropped, and begins to watch for others of this
    /// node.
    ///
    /// # Errors
    /// If the role cannot stand in a key, or the session is closed.
    pub fn declare_alive(&self, role: &str) -> Result<AliveToken, BusError> {
        let token = alive::declare(&self.link, role)?;
        if self.others.get().is_none() {
            // Set by another thread in between, it is as good.
            let _ = self.others.set(Watch::start(&self.link)?);
        }
        Ok(token)
    }

    /// Zenoh ids of other services of this node and role, in order; none before
    /// [`Bus::declare_alive`]. [`crate::gives_way`] says which of them is to end.
    #[must_use]
    pub fn others_alive(&self, role: &str) -> Vec<String> {
        let others = self.others.get();
        others.map_or_else(Vec::new, |others| others.others(role))
    }

    /// Hands each delta message that is published from the next [`Bus::publish_map`] on to `tap`,
    /// as it goes out, whether or not anybody subscribes: the cloud (CDR of
    /// `sensor_msgs/msg/PointCloud2`) and the attachment (JSON). Called on the publishing thread,
    /// and must not wait.
    pub fn on_delta(&self, tap: DeltaTap) {
        self.link.taps.edit().delta = Some(Arc::new(tap));
    }

    /// Hands the place of the map's own frame (CDR of `tf2_msgs/msg/TFMessage`) to `tap`, before
    /// the first delta of each epoch that has such a frame. As [`Bus::on_delta`] otherwise.
    pub fn on_static_transform(&self, tap: StaticTransformTap) {
        self.link.taps.edit().static_transform = Some(Arc::new(tap));
    }

    /// Starts to publish the map.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn publish_map(&self) -> Result<MapPublisher, BusError> {
        MapPublisher::start(&self.link)
    }

    /// Starts to publish map, odometry and transforms for ROS 2, if a domain of it is configured;
    /// `vehicle_from_sensor` is where the sonar sits.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn publish_ros(&self, vehicle_from_sensor: Pose) -> Result<Option<RosPublisher>, BusError> {
        let is_asked = self.link.config.ros_domain_id.is_some();
        let publisher = is_asked.then(|| RosPublisher::start(&self.link, vehicle_from_sensor));
        publisher.transpose()
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
        PoseSubscription::start(&self.link, &self.link.keys.pose(), None)
    }

    /// Starts to take poses from a key of another program.
    ///
    /// # Errors
    /// If zenoh refuses, for example a text that is no key.
    pub fn subscribe_poses_on(&self, key: &str) -> Result<PoseSubscription, BusError> {
        PoseSubscription::start(&self.link, key, None)
    }

    /// Starts to take poses from a topic of ROS 2, `nav_msgs/msg/Odometry`.
    ///
    /// # Errors
    /// If no domain of ROS is configured, it is no topic that poses can come from, or zenoh refuses.
    pub fn subscribe_odometry_of_ros(&self, topic: &str) -> Result<PoseSubscription, BusError> {
        let (key, token) = ros2::odometry_of(&self.link, topic)?;
        PoseSubscription::start(&self.link, &key, Some(token))
    }

    /// Starts to take the messages of other programs on `keys`, which may be patterns.
    ///
    /// # Errors
    /// If zenoh refuses, for example a text that is no key.
    pub fn subscribe_messages(&self, keys: &[String]) -> Result<MessageSubscription, BusError> {
        MessageSubscription::start(&self.link, keys)
    }

    /// Starts to take raw Ping frames, for mapping on another machine.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn subscribe_pings(&self) -> Result<PingSubscription, BusError> {
        PingSubscription::start(&self.link)
    }

    /// Starts to keep what a driver hears, for a mapper elsewhere. `driver` names this run of it, and
    /// `begin` is told to every mapper before anything else.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn keep_tape(&self, driver: u64, begin: serde_json::Value) -> Result<TapeKeeper, BusError> {
        TapeKeeper::start(&self.link, driver, begin)
    }

    /// Follows what this node's driver hears.
    #[must_use]
    pub fn follow_tape(&self) -> TapeFollower {
        TapeFollower::new(&self.link)
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

/// Learns what came of the endpoints.
fn look_around(session: &zenoh::Session, tried: Vec<Tried>, endpoints: &mut Endpoints) {
    let connected_count = company(session);
    let is_alone = connected_count == 0;
    let taken = listening::taken(&tried);
    let (listen, not_listening) = listening::outcome(tried, is_alone);
    (endpoints.listen, endpoints.not_listening) = (listen, not_listening);
    endpoints.connected_count = connected_count;
    if !taken.is_empty() && is_alone {
        let warning = endpoints::held_by_a_stranger(&taken);
        endpoints.warnings.push(warning);
    }
    endpoints.warn_of_what_did_not_open();
}

/// How many other sessions are connected.
fn company(session: &zenoh::Session) -> usize {
    let info = session.info();
    info.peers_zid().wait().count() + info.routers_zid().wait().count()
}

fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
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
fn start_ping_thread(
    link: &Arc<Link>,
    tally: &Arc<Tally>,
    heartbeat: Heartbeat,
) -> Result<Sender<OutgoingPing>, BusError> {
    let (sender, receiver) = bounded(link.config.ping_queue_len);
    let (session, key) = (link.session.clone(), link.keys.ping());
    let tally = Arc::clone(tally);
    spawn("bus-pings", move || {
        heartbeat.run_again(|| {
            heartbeat.rest();
            for ping in &receiver {
                heartbeat.beat();
                send_ping(&session, &key, ping, &tally);
                heartbeat.rest();
            }
        });
    })?;
    Ok(sender)
}

fn send_ping(session: &zenoh::Session, key: &str, ping: OutgoingPing, tally: &Tally) {
    let attachment = serde_json::json!({ "host_time_ns": ping.host_time.nanos() });
    let sent = session
        .put(key, ping.frame)
        .encoding(Encoding::APPLICATION_OCTET_STREAM)
        .attachment(attachment.to_string())
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::DataHigh)
        .wait();
    count(match sent {
        Ok(()) => &tally.pings_sent,
        Err(_) => &tally.pings_failed,
    });
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
