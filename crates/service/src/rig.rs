//! A simulated sonar behind the real protocol on a real port, with its dive's poses on the bus in
//! step with its pings.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use echosplat_bus::Bus;
use echosplat_driver::{
    DriverConfig, EmulatedDevice, ListenUrl, OnPing, ServeError, ServeOptions, ServeStatus, Server,
    serve,
};
use echosplat_model::{StampedPose, Timestamp};
use echosplat_session::{ClockSource, SessionConfig};
use echosplat_simulator::{DeviceCounters, Dive, SimulatedDevice, SimulatedSonar};

use crate::arguments::PoseClock;
use crate::config::Config;
use crate::exit::Usage;
use crate::pipeline::IsOver;
use crate::{clock, inputs};

/// Poses go out so long before the ping that needs them.
const AHEAD_S: f64 = 0.3;
/// The first pose waits so long for somebody to take it.
const FIRST_POSE_WAIT: Duration = Duration::from_secs(5);
/// After the dive, so long without a ping means that no more will come.
const QUIET: Duration = Duration::from_secs(10);

/// A device being served, and what it has seen.
pub(crate) struct Rig {
    server: Server,
    seen: Arc<Mutex<Seen>>,
    dive: Arc<Dive>,
}

/// What the device has seen and done.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Seen {
    pub(crate) counters: DeviceCounters,
    /// Whether its dive is over.
    pub(crate) is_finished: bool,
}

/// Where poses go, and on which clock.
pub(crate) struct PosesTo {
    pub(crate) bus: Arc<Bus>,
    pub(crate) clock: PoseClock,
}

impl Rig {
    /// # Errors
    /// If the address is taken or cannot be listened on.
    pub(crate) fn start(
        sonar: SimulatedSonar,
        listen: &ListenUrl,
        rate: f64,
        poses: Option<PosesTo>,
    ) -> anyhow::Result<Self> {
        let dive = Arc::clone(sonar.dive());
        let seen = Arc::new(Mutex::new(Seen::default()));
        let device = Watched {
            device: SimulatedDevice::new(Arc::new(sonar)),
            seen: Arc::clone(&seen),
        };
        let options = ServeOptions {
            rate,
            on_ping: poses.map(|to| publishing(to, Arc::clone(&dive))),
        };
        let server = serve(listen, Box::new(device), options).map_err(|error| match error {
            ServeError::Thread(_) => anyhow::Error::new(error),
            wrong => Usage::error(wrong),
        })?;
        Ok(Self { server, seen, dive })
    }

    /// What a client connects to.
    pub(crate) fn url(&self) -> &str {
        self.server.url()
    }

    /// A driver that asks for the dive as it was planned, on the dive's clock.
    ///
    /// # Errors
    /// If the port cannot be connected to.
    pub(crate) fn driver(&self, config: &Config) -> anyhow::Result<DriverConfig> {
        let settings = self.dive.settings();
        let mut driver = inputs::driver(config, inputs::sonar_url(self.url())?);
        driver.session = SessionConfig {
            range_start_m: settings.range_start_m,
            range_length_m: settings.range_length_m,
            ping_interval_ms: (1e3 * self.dive.ping_interval_s()).round() as u32,
            bin_count: settings.bin_count as u16,
            clock: ClockSource::Device,
            ..driver.session
        };
        Ok(driver)
    }

    /// Says when the dive is over and all of it has been received.
    pub(crate) fn end_of_dive(self) -> IsOver {
        let mut quiet_since: Option<(u64, Instant)> = None;
        Box::new(move |driver| {
            let seen = self.seen();
            let received = driver.session.profiles;
            // What is decoded may still be on its way to the mapper.
            let is_delivered = driver.pings_sent + driver.pings_dropped >= driver.session.pings;
            if !seen.is_finished || (received >= seen.counters.pings && is_delivered) {
                return seen.is_finished;
            }
            // Over a link that loses some, a mapper that has nothing to do is the end.
            let taken = driver.pings_sent;
            let (before, since) = *quiet_since.get_or_insert((taken, Instant::now()));
            if before != taken {
                quiet_since = None;
            }
            before == taken && since.elapsed() > QUIET
        })
    }

    pub(crate) fn dive(&self) -> &Dive {
        &self.dive
    }

    /// What the device has seen and done.
    pub(crate) fn seen(&self) -> Seen {
        *self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends all links.
    pub(crate) fn stop(self) -> (ServeStatus, Seen) {
        let status = self.server.stop();
        let seen = *self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        (status, seen)
    }
}

/// Publishes before each ping the poses up to a little after it.
fn publishing(to: PosesTo, dive: Arc<Dive>) -> OnPing {
    let mut next = 0;
    let mut host_offset_nanos = None;
    Box::new(move |_index, due| {
        if next == 0 {
            wait_for_subscriber(&to.bus);
        }
        let offset_nanos = match to.clock {
            PoseClock::Device => 0,
            PoseClock::Host => *host_offset_nanos
                .get_or_insert_with(|| clock::now().nanos().saturating_sub(due.nanos())),
        };
        let horizon = due.offset_by(AHEAD_S);
        let waiting = dive.reported_poses().get(next..).unwrap_or_default();
        for pose in waiting.iter().take_while(|pose| pose.time <= horizon) {
            next += 1;
            let shifted = StampedPose {
                time: pose.time.offset_by_nanos(offset_nanos),
                ..*pose
            };
            if let Err(error) = to.bus.publish_pose(&shifted) {
                tracing::debug!(%error, "pose not published");
            }
        }
    })
}

fn wait_for_subscriber(bus: &Bus) {
    let begin = Instant::now();
    while !bus.has_pose_subscriber() && begin.elapsed() < FIRST_POSE_WAIT {
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// The device, with its counters where others can read them.
struct Watched {
    device: SimulatedDevice,
    seen: Arc<Mutex<Seen>>,
}

impl Watched {
    fn tell(&self) {
        *self.seen.lock().unwrap_or_else(PoisonError::into_inner) = Seen {
            counters: self.device.counters(),
            is_finished: self.device.is_finished(),
        };
    }
}

impl EmulatedDevice for Watched {
    fn receive(&mut self, bytes: &[u8], now: Timestamp, out: &mut Vec<u8>) {
        EmulatedDevice::receive(&mut self.device, bytes, now, out);
        self.tell();
    }

    fn next_due(&self) -> Option<Timestamp> {
        self.device.next_due()
    }

    fn next_ping_due(&self) -> Option<Timestamp> {
        self.device.next_ping_due()
    }

    fn transmit(&mut self, out: &mut Vec<u8>) {
        self.device.transmit(out);
        self.tell();
    }

    fn is_finished(&self) -> bool {
        self.device.is_finished()
    }
}
