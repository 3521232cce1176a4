//! The session.

mod opening;
mod parts;
mod sending;
mod threads;

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use crossbeam_channel::Sender;
use echosplat_liveness::Heartbeat;
use zenoh::Wait;
use zenoh::pubsub::Publisher;

use crate::alive::{self, AliveToken, Watch};
use crate::endpoints::{self, Endpoints};
use crate::keys::Keys;
use crate::listening::{self, Tried};
use crate::reach::{Reach, Unreached};
use crate::ros2::NodeSlot;
use crate::taps::TapBoard;
use crate::zenoh_config::Plan;
use crate::{BusConfig, BusError};
pub use sending::BusCounters;
use sending::{OutgoingPing, Tally};
pub(crate) use threads::spawn;
use threads::within;

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
    reach: Reach,
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
        let (mut endpoints, is_lone_peer) = (plan.endpoints.clone(), plan.is_lone_peer);
        let relies_on_scouting = plan.is_client() && endpoints.connect.is_empty();
        let tried = listening::try_all(&endpoints.listen);
        let limit = Duration::from_secs_f64(config.open_timeout_s);
        let session = within("opening the zenoh session", limit, move || {
            opening::open(plan)
        })?
        .map_err(BusError::zenoh("open a session"))?;
        look_around(&session, tried, &mut endpoints);
        if relies_on_scouting && endpoints.connected_count == 0 {
            endpoints.warn_of_no_router_found();
        }
        if is_lone_peer && session.info().routers_zid().wait().count() > 0 {
            endpoints.warn_of_peers_out_of_reach();
        }
        for warning in &endpoints.warnings {
            tracing::warn!("zenoh: {warning}");
        }
        let pose_publisher = sending::declare_pose_publisher(&session, &keys)?;
        let link = Arc::new(Link {
            session,
            keys,
            config,
            taps: TapBoard::default(),
            ros: NodeSlot::default(),
        });
        let tally = Arc::new(Tally::default());
        let ping_heartbeat = Heartbeat::new("bus-pings");
        let pings = sending::start_ping_thread(&link, &tally, ping_heartbeat.clone())?;
        let elsewhere = endpoints.connects_elsewhere();
        let elsewhere = elsewhere.into_iter().map(str::to_owned).collect();
        let reach = Reach::start(&link, elsewhere)?;
        Ok(Self {
            link,
            endpoints,
            pose_publisher,
            pings,
            ping_heartbeat,
            tally,
            others: OnceLock::new(),
            reach,
        })
    }

    /// Where it connects to and listens, and what to warn of (also logged when opened).
    #[must_use]
    pub fn endpoints(&self) -> &Endpoints {
        &self.endpoints
    }

    /// While nobody is connected: each endpoint it connects to, and what is in the way there. They are
    /// tried again until somebody answers.
    #[must_use]
    pub fn unreached(&self) -> Vec<Unreached> {
        self.reach.unreached()
    }

    /// Of its threads, which all else goes on without.
    #[must_use]
    pub fn heartbeats(&self) -> [&Heartbeat; 2] {
        [&self.ping_heartbeat, self.reach.heartbeat()]
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
pub(crate) fn company(session: &zenoh::Session) -> usize {
    let info = session.info();
    info.peers_zid().wait().count() + info.routers_zid().wait().count()
}
