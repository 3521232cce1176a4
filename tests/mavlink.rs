//! Vehicles that speak `MAVLink`: over two routes, beside gimbals and other vehicles, and behind a mavlink-server.

use std::net::UdpSocket;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::Value;
use zenoh::Wait;

use crate::fake_sonar::{FakeSonar, open_bus, profile};
use crate::harness::{Program, bus_at, free_port, wait_until_listening};

const LONG: Duration = Duration::from_secs(60);

const AUTOPILOT: (u8, u8) = (12, 3);
const GIMBAL: (u8, u8) = (26, 8);

/// CRC-16/MCRF4XX, as `MAVLink` has it.
fn checksum(bytes: impl Iterator<Item = u8>) -> u16 {
    bytes.fold(0xFFFF, |crc, byte| {
        let mixed = byte ^ (crc as u8);
        let mixed = u16::from(mixed ^ (mixed << 4));
        (crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4)
    })
}

/// A frame of `MAVLink` 1; `extra` is the checksum of the message's definition.
fn frame((system, component): (u8, u8), id: u8, extra: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0xFE, payload.len() as u8, 0, system, component, id];
    bytes.extend(payload);
    let crc = checksum(bytes[1..].iter().copied().chain([extra]));
    bytes.extend(crc.to_le_bytes());
    bytes
}

fn of_floats(boot_ms: u32, floats: [f32; 6]) -> Vec<u8> {
    let floats = floats.into_iter().flat_map(f32::to_le_bytes);
    boot_ms.to_le_bytes().into_iter().chain(floats).collect()
}

/// Somebody who sends a position and an attitude.
#[derive(Clone, Copy)]
struct Speaker {
    id: (u8, u8),
    /// `MAV_TYPE` and `MAV_AUTOPILOT`.
    what: (u8, u8),
    uptime_ms: u32,
    /// North; without it there is an attitude alone.
    north_m: Option<f32>,
}

impl Speaker {
    fn autopilot(system: u8, north_m: f32) -> Self {
        Self {
            id: (system, 1),
            what: AUTOPILOT,
            uptime_ms: 100_000 * u32::from(system),
            north_m: Some(north_m),
        }
    }

    fn frames(&self, since_ms: u32) -> Vec<Vec<u8>> {
        let (boot_ms, seconds) = (self.uptime_ms + since_ms, since_ms as f32 * 1e-3);
        let place = |north_m: f32| [north_m, 0.2 * seconds, 1.0, 0.0, 0.2, 0.0];
        let yaw = 0.3 * seconds.sin();
        let position = self
            .north_m
            .map(|north_m| of_floats(boot_ms, place(north_m)));
        let position = position.map(|payload| frame(self.id, 32, 185, &payload));
        let attitude = of_floats(boot_ms, [0.0, 0.0, yaw, 0.0, 0.0, 0.0]);
        let attitude = frame(self.id, 30, 39, &attitude);
        let (kind, autopilot) = self.what;
        let heartbeat = frame(self.id, 0, 50, &[0, 0, 0, 0, kind, autopilot, 0, 4, 3]);
        let heartbeat = (since_ms % 1_000 < 20).then_some(heartbeat);
        position
            .into_iter()
            .chain([attitude])
            .chain(heartbeat)
            .collect()
    }
}

/// Calls `tick(milliseconds)` fifty times a second until dropped.
struct Ticking {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Ticking {
    fn start(mut tick: impl FnMut(u32) + Send + 'static) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let begin = Instant::now();
            for since_ms in (0..).step_by(20) {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                let due = Duration::from_millis(since_ms);
                std::thread::sleep(due.saturating_sub(begin.elapsed()));
                tick(since_ms as u32);
            }
        });
        Self {
            stop,
            thread: Some(thread),
        }
    }

    /// These send to a port of this machine.
    fn over_udp(port: u16, speakers: &[Speaker]) -> Self {
        let speakers = speakers.to_vec();
        let link = UdpLink::to(port);
        Self::start(move |since_ms| {
            let frames = speakers.iter().flat_map(|speaker| speaker.frames(since_ms));
            frames.for_each(|frame| link.send(&frame));
        })
    }
}

impl Drop for Ticking {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic in it has been printed.
            let _ = thread.join();
        }
    }
}

struct UdpLink(UdpSocket);

impl UdpLink {
    fn to(port: u16) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("loopback has free ports");
        socket.connect(("127.0.0.1", port)).expect("an address");
        Self(socket)
    }

    fn send(&self, frame: &[u8]) {
        // Nobody listens yet.
        let _ = self.0.send(frame);
    }
}

/// A service with these poses beside a sound sonar.
struct Run {
    service: Program,
    folder: tempfile::TempDir,
    bus_port: u16,
    _sonar: FakeSonar,
}

impl Run {
    fn start(pose: &str) -> Self {
        let sonar = FakeSonar::start(|i| profile(i, |_| {}));
        let folder = tempfile::tempdir().expect("a temporary folder");
        let map = folder.path().join("map.ply").display().to_string();
        let bus_port = free_port();
        let (url, bus) = (sonar.url(), bus_at(bus_port));
        let own = [
            "run",
            "--sonar",
            &url,
            "--pose",
            pose,
            "--map",
            &map,
            "--verbose",
        ];
        let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
        let mut service = Program::echosplat(&[&own[..], &bus].concat());
        wait_until_listening(&mut service, bus_port);
        Self {
            service,
            folder,
            bus_port,
            _sonar: sonar,
        }
    }

    /// The first status in which `is_so` of what is known of the poses' source.
    fn wait_for_source(&mut self, what: &str, is_so: impl Fn(&Value) -> bool) -> Value {
        let bus = open_bus(self.bus_port);
        let statuses = bus.subscribe_status().expect("zenoh subscribes");
        self.service.wait_for(what, LONG, |_| {
            let status = statuses.take_newest()?;
            is_so(&status["poses"]["source"]).then_some(status)
        })
    }

    /// Ends it; gives the names of the maps that it wrote.
    fn finish(mut self) -> (Vec<String>, String) {
        self.service.interrupt();
        self.service.wait_exit(Duration::from_secs(20));
        (maps(self.folder.path()), self.service.stderr())
    }
}

fn maps(folder: &Path) -> Vec<String> {
    let files = std::fs::read_dir(folder).expect("the folder is there");
    let names = files
        .flatten()
        .map(|file| file.file_name().to_string_lossy().into_owned());
    let mut maps: Vec<String> = names
        .filter(|name| name.ends_with(".ply") && !name.contains("ambiguous"))
        .collect();
    maps.sort();
    maps
}

fn count(source: &Value, key: &str) -> u64 {
    source[key].as_u64().unwrap_or(0)
}

fn used(source: &Value) -> &str {
    let senders = source["senders"].as_array().map_or(&[][..], Vec::as_slice);
    let used = senders.iter().find(|sender| sender["is_used"] == true);
    used.and_then(|sender| sender["name"].as_str())
        .unwrap_or("")
}

#[test]
fn a_second_slower_route_does_not_split_the_map() {
    let port = free_port();
    let mut run = Run::start(&format!("mavlink+udp://127.0.0.1:{port}"));
    let (first, second) = (UdpLink::to(port), UdpLink::to(port));
    let vehicle = Speaker::autopilot(1, 0.0);
    let _vehicle = Ticking::start(move |since_ms| {
        for frame in vehicle.frames(since_ms) {
            first.send(&frame);
        }
        // As a radio that saves its airtime: ten at once.
        let Some(before_ms) = since_ms.checked_sub(2_500).filter(|ms| ms % 200 < 20) else {
            return;
        };
        for before_ms in (before_ms..before_ms + 200).step_by(20) {
            vehicle
                .frames(before_ms)
                .iter()
                .for_each(|frame| second.send(frame));
        }
    });
    let status = run.wait_for_source("late copies", |source| count(source, "late") > 300);
    let poses = &status["poses"];
    assert_eq!(poses["source"]["epoch"], 0, "{poses}");
    assert_eq!(poses["guard"]["epoch"], 0, "{poses}");
    assert_eq!(status["notices"], serde_json::json!([]), "{status}");
    let (maps, log) = run.finish();
    assert_eq!(maps, ["map.ply"], "{log}");
}

#[test]
fn a_vehicle_that_boots_begins_a_map_whatever_a_slower_route_still_brings() {
    let port = free_port();
    let mut run = Run::start(&format!("mavlink+udp://127.0.0.1:{port}"));
    let (first, second) = (UdpLink::to(port), UdpLink::to(port));
    let before = Speaker::autopilot(1, 0.0);
    let after = Speaker {
        uptime_ms: 0,
        ..before
    };
    let boots_ms = 4_000;
    let frames = move |since_ms: u32| match since_ms.checked_sub(boots_ms) {
        None => before.frames(since_ms),
        Some(up_ms) if up_ms >= 500 => after.frames(up_ms),
        Some(_) => Vec::new(),
    };
    let _vehicle = Ticking::start(move |since_ms| {
        frames(since_ms).iter().for_each(|frame| first.send(frame));
        if let Some(before_ms) = since_ms.checked_sub(1_300) {
            frames(before_ms)
                .iter()
                .for_each(|frame| second.send(frame));
        }
    });
    let status = run.wait_for_source("a new epoch and poses in it", |source| {
        source["epoch"] == 1 && count(source, "accepted") > 400
    });
    assert_eq!(status["poses"]["source"]["epoch"], 1, "{status}");
    let (maps, log) = run.finish();
    assert_eq!(maps, ["map.1.ply", "map.ply"], "{log}");
}

#[test]
fn a_gimbal_that_speaks_first_is_passed_over() {
    let port = free_port();
    let gimbal = Speaker {
        id: (1, 154),
        what: GIMBAL,
        uptime_ms: 7_000,
        north_m: None,
    };
    let mut run = Run::start(&format!("mavlink+udp://127.0.0.1:{port}"));
    let _gimbal = Ticking::over_udp(port, &[gimbal]);
    run.wait_for_source("the gimbal", |source| count(source, "received") > 20);
    let _vehicle = Ticking::over_udp(port, &[Speaker::autopilot(1, 0.0)]);
    let status = run.wait_for_source("poses", |source| count(source, "accepted") > 300);
    assert_eq!(used(&status["poses"]["source"]), "system 1 component 1");
    let (_, log) = run.finish();
    assert!(!log.contains("EKF's origin"), "{log}");
}

#[test]
fn a_second_autopilot_is_told_and_the_url_chooses() {
    let (one, two) = (Speaker::autopilot(1, 0.0), Speaker::autopilot(2, 30.0));
    let port = free_port();
    let url = format!("mavlink+udp://127.0.0.1:{port}");
    let mut run = Run::start(&url);
    let vehicles = Ticking::over_udp(port, &[two, one]);
    run.service
        .wait_for_text("a second autopilot is heard on the same link", LONG);
    run.service.wait_for_text("?system=1", LONG);
    run.service.terminate();
    run.service.wait_exit_code(3, Duration::from_secs(20));
    drop((vehicles, run));

    let mut run = Run::start(&format!("{url}?system=1"));
    let _vehicles = Ticking::over_udp(port, &[two, one]);
    let status = run.wait_for_source("poses", |source| count(source, "accepted") > 200);
    let source = &status["poses"]["source"];
    assert_eq!(used(source), "system 1 component 1");
    assert_eq!(
        source["senders"].as_array().map(Vec::len),
        Some(2),
        "{source}"
    );
    let (_, log) = run.finish();
    assert!(!log.contains("second autopilot"), "{log}");
}

#[test]
fn raw_messages_of_a_mavlink_server_are_preferred_to_its_json() {
    let mut run = Run::start("mavlink+zenoh://");
    let endpoint = format!("[\"tcp/127.0.0.1:{}\"]", run.bus_port);
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\""),
        ("connect/endpoints", &endpoint),
        ("scouting/multicast/enabled", "false"),
    ] {
        config
            .insert_json5(key, value)
            .expect("zenoh has the setting");
    }
    let session = zenoh::open(config).wait().expect("zenoh opens");
    let vehicle = Speaker::autopilot(1, 0.0);
    // What the JSON says can be told apart: a vehicle elsewhere.
    let json = |name: &str, boot_ms: u32, fields: &str| {
        format!(
            r#"{{"header":{{"system_id":1,"component_id":1,"sequence":0}},
            "message":{{"type":"{name}","time_boot_ms":{boot_ms},{fields}}}}}"#
        )
    };
    let _server = Ticking::start(move |since_ms| {
        let put = |key: &str, payload: Vec<u8>| session.put(key, payload).wait().unwrap();
        for frame in vehicle.frames(since_ms) {
            put("mavlink_raw/out", frame);
        }
        let boot_ms = vehicle.uptime_ms + since_ms;
        let angles = r#""roll":0.0,"pitch":0.0,"yaw":0.0"#;
        let place = r#""x":500.0,"y":0.0,"z":1.0,"vx":0.0,"vy":0.0,"vz":0.0"#;
        for (name, fields) in [("LOCAL_POSITION_NED", place), ("ATTITUDE", angles)] {
            let payload = json(name, boot_ms, fields).into_bytes();
            put(&format!("mavlink/1/1/{name}"), payload);
        }
    });
    let status = run.wait_for_source("poses", |source| count(source, "accepted") > 250);
    let poses = &status["poses"];
    assert_eq!(poses["source"]["link"], "up, raw MAVLink", "{poses}");
    assert_eq!(poses["guard"]["off_track"], 0, "{poses}");
    assert_eq!(poses["guard"]["epoch"], 0, "{poses}");
    let (maps, log) = run.finish();
    assert_eq!(maps, ["map.ply"], "{log}");
}
