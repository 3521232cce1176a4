//! A tiny scripted device on the protocol's own crate, and bounded waits.
#![allow(dead_code, reason = "each test binary uses its part")]
#![allow(clippy::unwrap_used, reason = "a helper of tests fails where they do")]

use std::sync::{Arc, LazyLock, Mutex};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, bounded};
use echosplat_driver::{
    DriverConfig, DriverEvent, DriverHandle, EmulatedDevice, ListenUrl, ServeOptions, Server,
    serve, spawn,
};
use echosplat_firmware_protocol::{
    DeviceInformation, Frame, Message, OsMonoProfile, OsPingParams, PowerResults, id,
};
use echosplat_model::{Ping, Timestamp};
use echosplat_session::{ClockSource, SessionConfig};
use tokio::runtime::{Handle, Runtime};

pub(crate) const PATIENCE: Duration = Duration::from_secs(20);
pub(crate) const INTERVAL_MS: i64 = 10;

/// Every `enable` the device was sent.
pub(crate) type Enables = Arc<Mutex<Vec<bool>>>;

#[derive(Default)]
pub(crate) struct Scripted {
    enables: Enables,
    settings: Option<OsPingParams>,
    due_ms: i64,
    number: u32,
    /// Stops by itself after so many pings; 0 never.
    limit: u32,
}

impl Scripted {
    pub(crate) fn new(limit: u32) -> (Box<Self>, Enables) {
        let device = Self {
            limit,
            ..Self::default()
        };
        let enables = Arc::clone(&device.enables);
        (Box::new(device), enables)
    }
}

pub(crate) fn append(message: &Message<'_>, out: &mut Vec<u8>) {
    let start = out.len();
    out.resize(start + message.encoded_byte_count(), 0);
    message.encode(1, 0, &mut out[start..]).unwrap();
}

/// One profile as a frame.
pub(crate) fn profile(number: u32, millis: u32, length_mm: u32, bin_count: u16, out: &mut Vec<u8>) {
    let results = vec![0x40; 2 * usize::from(bin_count)];
    let profile = OsMonoProfile {
        ping_number: number,
        start_mm: 0,
        length_mm,
        timestamp_ms: millis,
        ping_hz: 451_127,
        gain_index: 0,
        sos_dmps: 15_000,
        channel_number: 0,
        pulse_duration_sec: 2e-5,
        analog_gain: 1.0,
        max_pwr_db: 40.0,
        min_pwr_db: -20.0,
        transducer_heading_deg: 0.0,
        vehicle_heading_deg: 0.0,
        pwr_results: PowerResults::from_bytes(&results).unwrap(),
    };
    append(&Message::OsMonoProfile(profile), out);
}

impl EmulatedDevice for Scripted {
    fn receive(&mut self, bytes: &[u8], now: Timestamp, out: &mut Vec<u8>) {
        let frame = Frame::from_bytes(bytes).unwrap();
        match Message::parse(&frame).unwrap() {
            Message::GeneralRequest {
                requested_id: id::DEVICE_INFORMATION,
            } => append(
                &Message::DeviceInformation(DeviceInformation {
                    device_type: 104,
                    device_revision: 2,
                    firmware: [1, 5, 6],
                }),
                out,
            ),
            Message::OsPingParams(params) => {
                self.enables.lock().unwrap().push(params.enable);
                if self.settings.is_none() {
                    self.due_ms = self.due_ms.max(now.nanos() / 1_000_000);
                }
                self.settings = params.enable.then_some(params);
            }
            _ => {}
        }
    }

    fn next_due(&self) -> Option<Timestamp> {
        let is_done = self.limit > 0 && self.number >= self.limit;
        (self.settings.is_some() && !is_done).then(|| Timestamp::from_millis(self.due_ms))
    }

    fn transmit(&mut self, out: &mut Vec<u8>) {
        let Some(settings) = self.settings else {
            return;
        };
        let millis = self.due_ms as u32;
        profile(
            self.number,
            millis,
            settings.length_mm,
            settings.num_results,
            out,
        );
        self.number += 1;
        self.due_ms += INTERVAL_MS;
    }

    fn is_finished(&self) -> bool {
        self.limit > 0 && self.number >= self.limit
    }
}

pub(crate) fn serve_at(listen: &str, device: Box<Scripted>, rate: f64) -> Server {
    let listen: ListenUrl = listen.parse().unwrap();
    serve(&listen, device, ServeOptions { rate }).unwrap()
}

pub(crate) fn config(url: &str, clock: ClockSource) -> DriverConfig {
    DriverConfig {
        session: SessionConfig {
            range_length_m: 3.0,
            bin_count: 200,
            clock,
            ..SessionConfig::default()
        },
        ..DriverConfig::new(url.parse().unwrap())
    }
}

/// Of all tests of a binary; never ended, as that of the program.
pub(crate) fn runtime() -> &'static Handle {
    static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());
    RUNTIME.handle()
}

pub(crate) fn connect(url: &str, clock: ClockSource) -> (DriverHandle, Receiver<DriverEvent>) {
    let (sender, receiver) = bounded(1_000);
    let driver = spawn(runtime(), config(url, clock), None, sender).unwrap();
    (driver, receiver)
}

/// The next event that `wanted` takes something from; others are passed over.
pub(crate) fn next<T>(
    events: &Receiver<DriverEvent>,
    mut wanted: impl FnMut(DriverEvent) -> Option<T>,
) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let event = events.recv_deadline(deadline).expect("it comes in time");
        if let Some(found) = wanted(event) {
            return found;
        }
    }
}

pub(crate) fn next_ping(events: &Receiver<DriverEvent>) -> Arc<Ping> {
    next(events, |event| match event {
        DriverEvent::Ping { ping, .. } => Some(ping),
        _ => None,
    })
}

pub(crate) fn next_is(events: &Receiver<DriverEvent>, wanted: &DriverEvent) {
    next(events, |event| (event == *wanted).then_some(()));
}

pub(crate) fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !condition() {
        assert!(Instant::now() < deadline, "in vain: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}
