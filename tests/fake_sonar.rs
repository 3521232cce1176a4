//! A sonar that sends what a test wants, forty times a second, whatever it is asked; and a vehicle
//! that publishes its poses.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use echosplat_bus::{Bus, BusConfig};
use echosplat_firmware_protocol::{Message, OsMonoProfile, PowerResults};
use echosplat_model::glam::DVec3;
use echosplat_model::{Pose, StampedPose, Timestamp};

/// From ping to ping.
pub(crate) const INTERVAL: Duration = Duration::from_millis(25);

/// Served until dropped.
pub(crate) struct FakeSonar {
    pub(crate) port: u16,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl FakeSonar {
    /// `bytes(i)` is what is sent `i` intervals after a client connected.
    pub(crate) fn start(bytes: impl Fn(u32) -> Vec<u8> + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("loopback has free ports");
        listener.set_nonblocking(true).expect("a socket");
        let port = listener.local_addr().expect("it is bound").port();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            while !stopped.load(Ordering::Relaxed) {
                match listener.accept() {
                    Ok((client, _)) => serve(client, &bytes, &stopped),
                    Err(_) => std::thread::sleep(INTERVAL),
                }
            }
        });
        Self {
            port,
            stop,
            thread: Some(thread),
        }
    }

    pub(crate) fn url(&self) -> String {
        format!("tcp://127.0.0.1:{}", self.port)
    }
}

impl Drop for FakeSonar {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic in it has been printed.
            let _ = thread.join();
        }
    }
}

fn serve(mut client: TcpStream, bytes: &impl Fn(u32) -> Vec<u8>, stop: &AtomicBool) {
    let mut requests = [0; 1024];
    for index in 0.. {
        if stop.load(Ordering::Relaxed) || client.write_all(&bytes(index)).is_err() {
            return;
        }
        client.set_nonblocking(true).expect("a socket");
        match client.read(&mut requests) {
            Ok(0) => return,
            Err(error) if error.kind() != ErrorKind::WouldBlock => return,
            _ => {}
        }
        client.set_nonblocking(false).expect("a socket");
        std::thread::sleep(INTERVAL);
    }
}

/// The frame of ping `number`, with one echo at 4 m that scatters, after `change`.
pub(crate) fn profile(number: u32, change: impl FnOnce(&mut OsMonoProfile<'_>)) -> Vec<u8> {
    let mixed = |bin: u32| (bin ^ number.wrapping_mul(7919)).wrapping_mul(2_654_435_761) >> 20;
    let power = |bin: u32| (if bin.abs_diff(240) < 4 { 50_000 } else { 8_000 }) + mixed(bin) as u16;
    let results: Vec<u8> = (0..600).flat_map(|bin| power(bin).to_le_bytes()).collect();
    profile_of(number, &results, change)
}

/// The frame of ping `number` with these results, two bytes a bin.
pub(crate) fn profile_of(
    number: u32,
    results: &[u8],
    change: impl FnOnce(&mut OsMonoProfile<'_>),
) -> Vec<u8> {
    let mut profile = OsMonoProfile {
        ping_number: number,
        start_mm: 0,
        length_mm: 10_000,
        timestamp_ms: number.wrapping_mul(25),
        ping_hz: 451_127,
        gain_index: 4,
        sos_dmps: 15_000,
        channel_number: 0,
        pulse_duration_sec: 2e-5,
        analog_gain: 74.55,
        max_pwr_db: 60.0,
        min_pwr_db: -20.0,
        transducer_heading_deg: 0.0,
        vehicle_heading_deg: 0.0,
        pwr_results: PowerResults::from_bytes(results).expect("two bytes a bin"),
    };
    change(&mut profile);
    encoded(&Message::OsMonoProfile(profile))
}

/// A message's frame.
pub(crate) fn encoded(message: &Message<'_>) -> Vec<u8> {
    let mut frame = vec![0; message.encoded_byte_count()];
    message.encode(1, 0, &mut frame).expect("it fits its frame");
    frame
}

/// The host's clock.
pub(crate) fn now() -> Timestamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    Timestamp::from_nanos(since.expect("after 1970").as_nanos() as i64)
}

/// A pose of a vehicle that moves along y at 0.3 m/s.
pub(crate) fn pose_at(time: Timestamp, seconds: f64) -> StampedPose {
    StampedPose {
        time,
        world_from_vehicle: Pose::from_yaw_pitch_roll(0.0, 0.0, 0.0, DVec3::Y * 0.3 * seconds),
        uncertainty: None,
        epoch: 0,
    }
}

/// Publishes poses fifty times a second until dropped.
pub(crate) struct FakeVehicle {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl FakeVehicle {
    /// `pose(seconds)` is what is sent so long after the start.
    pub(crate) fn start(
        bus_port: u16,
        pose: impl Fn(f64) -> Option<StampedPose> + Send + 'static,
    ) -> Self {
        let bus = open_bus(bus_port);
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let begin = std::time::Instant::now();
            while !stopped.load(Ordering::Relaxed) {
                if let Some(pose) = pose(begin.elapsed().as_secs_f64()) {
                    bus.publish_pose(&pose).expect("the session is open");
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for FakeVehicle {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A session that connects to the service's port, once it is there.
pub(crate) fn open_bus(port: u16) -> Bus {
    let owned = |(key, value): (&str, String)| (key.to_owned(), value);
    Bus::open(BusConfig {
        zenoh: [
            ("listen/endpoints", "[]".to_owned()),
            ("connect/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
            ("connect/timeout_ms", "-1".to_owned()),
        ]
        .map(owned)
        .into(),
        ..BusConfig::default()
    })
    .expect("zenoh opens")
}
