//! Satellite receivers place maps: NMEA in a log and over UDP, and `NavSatFix` in a bag and over `rmw_zenoh`.

use std::fs;
use std::net::UdpSocket;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use echosplat_firmware_protocol::{Frame, Message, Text, id};
use echosplat_model::glam::DVec3;
use echosplat_model::{StampedPose, Timestamp};
use echosplat_recording::ply::read_map;
use echosplat_recording::tum;
use echosplat_ros::{NavSatFix, odometry};

use crate::fake_sonar::{FakeSonar, FakeVehicle, encoded, now, pose_at, profile};
use crate::harness::{Program, bus_at, free_port, wait_until_listening};

const LONG: Duration = Duration::from_secs(120);
const SAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/sample-dive/");

/// Where the world of these tests lies, and metres of a degree of latitude and of longitude there (WGS 84).
const LATITUDE_DEG: f64 = 60.17;
const LONGITUDE_DEG: f64 = 24.94;
const METRES_OF_DEGREES: [f64; 2] = [111_415.0, 55_528.0];

fn sentence(body: &str) -> String {
    let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${body}*{sum:02X}\r\n")
}

/// Degrees north and east of a place in the world, metres.
fn degrees(world_m: DVec3) -> [f64; 2] {
    let [north, east] = METRES_OF_DEGREES;
    [
        LATITUDE_DEG + world_m.y / north,
        LONGITUDE_DEG + world_m.x / east,
    ]
}

/// GGA of an antenna at a place of the world whose origin is 2 m above mean sea level.
fn gga(second: u32, world_m: DVec3) -> String {
    let [latitude, longitude] = degrees(world_m);
    let minutes = |deg: f64| (deg.floor(), deg.fract() * 60.0);
    let ((lat, lat_min), (lon, lon_min)) = (minutes(latitude), minutes(longitude));
    let [h, m, s] = [second / 3600, second / 60 % 60, second % 60];
    sentence(&format!(
        "GPGGA,{h:02}{m:02}{s:02}.00,{lat:02}{lat_min:010.7},N,{lon:03}{lon_min:010.7},E,1,08,1.0,{:.3},M,17.0,M,,",
        2.0 + world_m.z
    ))
}

/// Errors of metres, a tenth of them wild; the same at each run.
fn noise(i: u32) -> DVec3 {
    let unit = |salt: u32| f64::from((i + salt).wrapping_mul(2_654_435_761) >> 16) / 65_536.0 - 0.5;
    match i % 10 {
        7 => DVec3::new(300.0, 0.0, 80.0),
        _ => 4.0 * DVec3::new(unit(1), unit(1_000), unit(77_777)),
    }
}

fn sample_poses() -> Vec<StampedPose> {
    let text = fs::read(format!("{SAMPLE}poses.tum")).expect("the sample dive");
    tum::read(&text[..]).expect("its poses").poses
}

/// The sample dive's log with packets in front of the profile that follows so many seconds after its beginning.
fn log_with(path: &Path, packets: &dyn Fn(u32) -> Vec<Vec<u8>>) {
    let bytes = fs::read(format!("{SAMPLE}dive.svlog")).expect("the sample dive");
    let (mut rest, mut out, mut pings) = (&bytes[..], Vec::new(), 0);
    while rest.len() > 8 {
        let length = 10 + usize::from(u16::from_le_bytes([rest[2], rest[3]]));
        let (frame, after) = rest.split_at(length);
        if Frame::from_bytes(frame).expect("a frame").message_id() == id::OS_MONO_PROFILE {
            if pings % 5 == 0 {
                packets(pings / 5)
                    .iter()
                    .for_each(|packet| out.extend_from_slice(packet));
            }
            pings += 1;
        }
        out.extend_from_slice(frame);
        rest = after;
    }
    fs::write(path, out).expect("a file of ours");
}

fn nmea(text: &str) -> Vec<u8> {
    encoded(&Message::Nmea(text.into()))
}

/// Fixes of the sample dive's vehicle, one a second.
fn packets_of(poses: &[StampedPose], second: u32) -> Vec<Vec<u8>> {
    let at = Timestamp::from_secs_f64(second.into());
    let pose = poses
        .iter()
        .find(|pose| pose.time >= at)
        .expect("poses go on");
    let there = pose.world_from_vehicle.translation_m + noise(second);
    vec![nmea(&gga(40_000 + second, there))]
}

fn replay(arguments: &[&str], code: i32) -> Program {
    let own = ["replay", "--finished-only", "--end", "60"];
    let mut program = Program::echosplat(&[&own[..], arguments].concat());
    program.wait_exit_code(code, LONG);
    program
}

#[test]
fn nmea_in_a_log_places_the_map_whatever_noise_is_between() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let poses = sample_poses();
    let wrong = |second: u32| {
        let noise: Vec<u8> = (0..700_u32)
            .map(|i| ((i + second).wrapping_mul(2_654_435_761) >> 13) as u8)
            .collect();
        vec![
            encoded(&Message::Nmea(Text::from_bytes(&noise))),
            nmea("$GPGGA,1234"),
            nmea(&sentence(
                "GPGGA,000002,9510.2,N,02456.4,E,1,08,1.0,2.5,M,17.0,M,,",
            )),
            nmea(&sentence("GPGGA,000003,,,,,0,00,,,,,,,")),
            nmea(&sentence("GPVTG,77.5,T,,M,0.0,N,0.0,K,A")),
            nmea(&sentence("HCHDG,98.3,0.0,E,12.6,W")),
            nmea(&gga(second, DVec3::ZERO).replace("6010", "6011")),
        ]
    };
    let log = path("nmea.svlog");
    log_with(Path::new(&log), &|second| {
        [packets_of(&poses, second), wrong(second)].concat()
    });
    let tum = format!("{SAMPLE}poses.tum");
    for name in ["map.ply", "again.ply"] {
        let told = replay(&[&log, "--poses", &tum, "--map", &path(name)], 0);
        for words in [
            "GNSS messages in it cannot be used; the first: NMEA",
            "17.0 m above the ellipsoid",
        ] {
            assert!(told.stderr().contains(words), "{}", told.account());
        }
    }
    let map = read_map(&folder.path().join("map.ply")).unwrap();
    let place = map.notes.georeference.expect("fixes tell it");
    assert!(
        (place.place.latitude_deg - LATITUDE_DEG).abs() * METRES_OF_DEGREES[0] < 2.0,
        "{place:?}"
    );
    assert!(
        (place.place.longitude_deg - LONGITUDE_DEG).abs() * METRES_OF_DEGREES[1] < 2.0,
        "{place:?}"
    );
    assert!(
        (place.place.height_m - 2.0).abs() < 2.0 && place.datum.name() == "msl",
        "{place:?}"
    );
    assert!(
        (place.x_heading_deg - 90.0).abs() < 1e-9 && place.source.contains("30 GNSS fixes"),
        "{place:?}"
    );
    let [first, again] = ["map.ply", "again.ply"].map(|name| fs::read(path(name)).unwrap());
    assert!(first == again, "a replay gives the same bytes");
    // Its owner's word goes before, and is contradicted aloud.
    let told = replay(
        &[
            &log,
            "--poses",
            &tum,
            "--map",
            &path("owned.ply"),
            "--origin",
            "60.18,24.94,0",
        ],
        0,
    );
    assert!(told.stderr().contains("which stays"), "{}", told.account());
    let owned = read_map(&folder.path().join("owned.ply")).unwrap();
    let latitude_deg = owned.notes.georeference.unwrap().place.latitude_deg;
    assert!((latitude_deg - 60.18).abs() < 1e-12);
}

#[test]
fn fixes_alone_are_no_poses() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let poses = sample_poses();
    let log = path("nmea.svlog");
    log_with(Path::new(&log), &|second| packets_of(&poses, second));
    let told = replay(&[&log, "--map", &path("map.ply")], 2);
    for words in [
        "replay needs poses",
        "NMEA sentences with 240 fixes",
        "are no poses",
    ] {
        assert!(told.stderr().contains(words), "{}", told.account());
    }
}

/// A file of channels and messages in CDR, as bags of ROS 2 are.
struct Bag(Vec<u8>);

impl Bag {
    fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
    }

    fn record(&mut self, kind: u8, parts: &[&[u8]]) {
        let body = parts.concat();
        self.0.push(kind);
        self.0.extend((body.len() as u64).to_le_bytes());
        self.0.extend(body);
    }

    fn new(channels: &[(&str, &str)]) -> Self {
        let mut bag = Self(b"\x89MCAP0\r\n".to_vec());
        bag.record(
            1,
            &[&Self::text("ros2"), &Self::text("somebody's recorder")],
        );
        for (index, (topic, schema)) in channels.iter().enumerate() {
            let id = [index as u8 + 1, 0];
            let schema = [Self::text(schema), Self::text("ros2msg"), Self::text("")].concat();
            let ends = [Self::text("cdr"), vec![0; 4]].concat();
            bag.record(3, &[&id, &schema]);
            bag.record(4, &[&id, &id, &Self::text(topic), &ends]);
        }
        bag
    }

    fn message(&mut self, channel: u8, time: Timestamp, data: &[u8]) {
        let time = (time.nanos().max(0) as u64).to_le_bytes();
        self.record(5, &[&[channel, 0], &[0; 4], &time, &time, data]);
    }

    fn write(mut self, path: &str) {
        self.record(15, &[&[0; 4]]);
        fs::write(path, self.0).expect("a file of ours");
    }
}

#[test]
fn nav_sat_fix_of_a_bag_places_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let mut bag = Bag::new(&[
        ("/rov/odom", "nav_msgs/msg/Odometry"),
        ("/gps/fix", "sensor_msgs/msg/NavSatFix"),
        ("/other/fix", "sensor_msgs/msg/NavSatFix"),
    ]);
    let poses = sample_poses();
    for (index, pose) in poses
        .iter()
        .enumerate()
        .filter(|(_, pose)| pose.time > Timestamp::ZERO)
    {
        bag.message(1, pose.time, &odometry::encode(pose, "map", "base_link"));
        if index % 10 != 0 {
            continue;
        }
        let [latitude_deg, longitude_deg] = degrees(pose.world_from_vehicle.translation_m);
        let second = index as u32 / 10;
        let fix = NavSatFix {
            stamp: pose.time,
            // Without a fix its numbers mean nothing.
            status: if second % 4 == 3 { -1 } else { 0 },
            latitude_deg: if second % 4 == 3 { 95.0 } else { latitude_deg },
            longitude_deg,
            altitude_m: 19.0 + pose.world_from_vehicle.translation_m.z,
            covariance_m2: [0.25, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 1.0],
            covariance_type: 2,
        };
        bag.message(2, pose.time, &fix.encode("gps"));
        if second == 5 {
            let nan = NavSatFix {
                latitude_deg: f64::NAN,
                status: 0,
                ..fix
            };
            bag.message(2, pose.time, &nan.encode("gps"));
            bag.message(2, pose.time, &[7; 30]);
            bag.message(
                3,
                pose.time,
                &NavSatFix {
                    latitude_deg: 10.0,
                    status: 0,
                    ..fix
                }
                .encode("gps"),
            );
        }
    }
    bag.write(&path("bag.mcap"));
    let (log, bag) = (format!("{SAMPLE}dive.svlog"), path("bag.mcap"));
    let told = replay(&[&log, "--poses", &bag, "--map", &path("map.ply")], 0);
    assert!(
        told.stderr()
            .contains("2 GNSS messages in it cannot be used"),
        "{}",
        told.account()
    );
    let map = read_map(&folder.path().join("map.ply")).unwrap();
    let place = map.notes.georeference.expect("fixes tell it");
    assert!(
        (place.place.latitude_deg - LATITUDE_DEG).abs() * METRES_OF_DEGREES[0] < 0.2,
        "{place:?}"
    );
    assert!(
        (place.place.height_m - 19.0).abs() < 0.1 && place.datum.name() == "ellipsoid",
        "{place:?}"
    );
}

/// NMEA over UDP beside poses on the bus; in mid-dive the estimator begins elsewhere.
#[test]
fn nmea_over_udp_places_each_world_by_its_own_fixes_and_the_recording_knows() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (port, nmea_port) = (free_port(), free_port());
    let toml = format!(
        "[georeference]\ngnss = \"udp://127.0.0.1:{nmea_port}\"\nantenna_m = [0.0, 0.0, 0.2]\n"
    );
    fs::write(path("my.toml"), toml).unwrap();
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let (url, config, records, map) = (
        sonar.url(),
        path("my.toml"),
        path("records"),
        path("map.ply"),
    );
    let own = [
        "run", "--sonar", &url, "--config", &config, "--record", &records, "--map", &map,
    ];
    let bus = bus_at(port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let mut service = Program::echosplat(&[&own[..], &bus].concat());
    wait_until_listening(&mut service, port);
    let begin = Instant::now();
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    let send = move |text: &[u8]| drop(receiver.send_to(text, ("127.0.0.1", nmea_port)));
    send(&[0xff; 300]);
    send(b"$GPGGA,12");
    let is_reset = Arc::new(AtomicBool::new(false));
    let reset = Arc::clone(&is_reset);
    let _vehicle = FakeVehicle::start(port, move |seconds| {
        let mut pose = pose_at(now(), seconds);
        if reset.load(Ordering::Relaxed) {
            pose.epoch = 1;
            pose.world_from_vehicle.translation_m.x += 1_000.0;
        }
        Some(pose)
    });
    let mut second = 0;
    service.wait_for("a place, and a new map without one", LONG, |service| {
        let log = service.stderr();
        if log.contains("30 GNSS fixes beside poses") {
            is_reset.store(true, Ordering::Relaxed);
            return log.contains("no place on Earth until").then_some(());
        }
        let seconds = begin.elapsed().as_secs_f64();
        if seconds >= f64::from(second) {
            let there = DVec3::new(0.0, 0.3 * seconds, 0.2);
            send(gga(second, there + noise(second)).as_bytes());
            second += 1;
        }
        None
    });
    service.terminate();
    service.wait_exit(Duration::from_secs(30));
    let place_of = |name: &str| {
        read_map(&folder.path().join(name))
            .unwrap()
            .notes
            .georeference
    };
    let place = place_of("map.1.ply").expect("the first world has a place");
    assert!(
        (place.place.latitude_deg - LATITUDE_DEG).abs() * METRES_OF_DEGREES[0] < 3.0,
        "{place:?}"
    );
    assert_eq!(place_of("map.ply"), None, "the second has none");
    let record = fs::read_dir(&records)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .next()
        .unwrap();
    let record = record.display().to_string();
    let mut again = Program::echosplat(&[
        "replay",
        &record,
        "--map",
        &path("again.ply"),
        "--finished-only",
    ]);
    again.wait_exit(LONG);
    assert_eq!(place_of("again.1.ply"), Some(place), "{}", again.account());
    assert_eq!(place_of("again.ply"), None);
}
