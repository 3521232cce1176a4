//! A simulated sonar behind the real protocol on a real port, with its dive's poses on the bus in
//! step with its pings.

mod vehicle;

pub(crate) use vehicle::PosesTo;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use echosplat_driver::{
    DriverConfig, EmulatedDevice, ListenUrl, ServeError, ServeOptions, ServeStatus, Server, serve,
};
use echosplat_model::Timestamp;
use echosplat_session::{ClockSource, SessionConfig};
use echosplat_simulator::{DeviceCounters, Dive, SimulatedDevice, SimulatedSonar};

use crate::config::Config;
use crate::exit::Usage;
use crate::inputs;
use crate::pipeline::IsOver;
use crate::rig::vehicle::Vehicle;

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
        let is_real_time = (rate - 1.0).abs() < 1e-9;
        let device = Watched {
            device: SimulatedDevice::new(Arc::new(sonar)),
            vehicle: poses.map(|to| Vehicle::new(to, Arc::clone(&dive), is_real_time)),
            seen: Arc::clone(&seen),
        };
        let options = ServeOptions { rate };
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

/// The device, with its counters where others can read them and the vehicle that carries it.
struct Watched {
    device: SimulatedDevice,
    vehicle: Option<Vehicle>,
    seen: Arc<Mutex<Seen>>,
}

impl Watched {
    fn tell(&self) {
        *self.seen.lock().unwrap_or_else(PoisonError::into_inner) = Seen {
            counters: self.device.counters(),
            is_finished: self.device.is_finished(),
        };
    }

    /// Says what a client made of the device that was pinging or not.
    fn has_been_asked(&mut self, was_pinging: bool, enables: u64) {
        let is_pinging = self.device.is_pinging();
        let at = self.device.dive_time();
        match (was_pinging, is_pinging) {
            (false, true) => {
                tracing::info!("asked to ping, {:.1} s into the dive", at.as_secs_f64());
            }
            (true, false) => tracing::info!(
                "told to stop, {:.1} s into the dive, which waits there",
                at.as_secs_f64()
            ),
            _ => {}
        }
        let Some(vehicle) = &mut self.vehicle else {
            return;
        };
        if is_pinging && !was_pinging {
            vehicle.begin(at);
        }
        vehicle.is_asked_again |= self.device.counters().enables > enables;
    }
}

impl EmulatedDevice for Watched {
    fn receive(&mut self, bytes: &[u8], now: Timestamp, out: &mut Vec<u8>) {
        let was_pinging = self.device.is_pinging();
        let enables = self.device.counters().enables;
        EmulatedDevice::receive(&mut self.device, bytes, now, out);
        self.has_been_asked(was_pinging, enables);
        self.tell();
    }

    fn next_due(&self) -> Option<Timestamp> {
        let is_held = self.vehicle.as_ref().is_some_and(|vehicle| vehicle.waits);
        if is_held {
            return None;
        }
        self.device.next_due()
    }

    fn next_ping_due(&self) -> Option<Timestamp> {
        self.next_due().and(self.device.next_ping_due())
    }

    fn transmit(&mut self, out: &mut Vec<u8>) {
        let is_ping = self.device.next_ping_due() == self.device.next_due();
        if let Some(vehicle) = self.vehicle.as_mut().filter(|_| is_ping) {
            vehicle.before_ping(self.device.dive_time());
        }
        self.device.transmit(out);
        if is_ping && self.device.is_finished() {
            tracing::info!("the dive is over; stopped and started again it begins anew");
        }
        self.tell();
    }

    fn go_along(&mut self, clients_seen: u64) {
        let is_pinging = self.device.is_pinging() && !self.device.is_finished();
        if let Some(vehicle) = self.vehicle.as_mut().filter(|_| is_pinging) {
            vehicle.go_along(self.device.dive_time(), clients_seen);
        }
    }

    fn is_finished(&self) -> bool {
        self.device.is_finished()
    }
}
