//! Nothing that is wrong goes by in silence: each condition is told in a sentence that says what to
//! do, and shows in the exit code.

use std::io::Write;
use std::net::TcpListener;
use std::time::Duration;

use echosplat_firmware_protocol::Message;
use echosplat_model::{StampedPose, Timestamp};

use crate::fake_sonar::{FakeSonar, FakeVehicle, encoded, now, pose_at, profile, profile_of};
use crate::harness::{Program, bus_at, free_port, wait_until_listening};

const LONG: Duration = Duration::from_secs(60);

/// A service with this sonar, on a bus of its own.
fn service(sonar: &str, bus_port: u16) -> Program {
    let bus = bus_at(bus_port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let mut service = Program::echosplat(&[&["run", "--sonar", sonar][..], &bus].concat());
    wait_until_listening(&mut service, bus_port);
    service
}

/// The service tells `words`, and ends with 3 within five seconds of being asked to.
fn told(mut service: Program, words: &[&str]) {
    for word in words {
        service.wait_for_text(word, LONG);
    }
    service.terminate();
    service.wait_exit_code(3, Duration::from_secs(10));
}

/// What is told of a sonar that sends these bytes, with sound poses.
fn told_of_sonar(bytes: impl Fn(u32) -> Vec<u8> + Send + 'static, words: &[&str]) {
    let sonar = FakeSonar::start(bytes);
    let port = free_port();
    let service = service(&sonar.url(), port);
    let _vehicle = FakeVehicle::start(port, |seconds| Some(pose_at(now(), seconds)));
    told(service, words);
}

/// What is told of these poses, beside a sound sonar.
fn told_of_poses(pose: impl Fn(f64) -> Option<StampedPose> + Send + 'static, words: &[&str]) {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let service = service(&sonar.url(), port);
    let _vehicle = FakeVehicle::start(port, pose);
    told(service, words);
}

#[test]
fn a_sonar_that_is_not_there() {
    let port = free_port();
    let nowhere = format!("tcp://127.0.0.1:{}", free_port());
    told(
        service(&nowhere, port),
        &["no pings", "no link", "echosplat probe"],
    );
}

#[test]
fn a_link_that_brings_nothing() {
    told_of_sonar(|_| Vec::new(), &["is connected and sends nothing"]);
}

#[test]
fn bytes_that_are_no_frames() {
    let noise = |i: u32| {
        (0..500_u32)
            .map(|k| ((i * 500 + k).wrapping_mul(2_654_435_761) >> 13) as u8)
            .collect()
    };
    told_of_sonar(noise, &["bytes that are no Ping frames", "baud rate"]);
    told_of_sonar(|_| vec![0; 500], &["bytes that are no Ping frames"]);
}

#[test]
fn status_without_profiles() {
    let status = |_| encoded(&Message::Nop);
    told_of_sonar(status, &["answers, but sends no profiles"]);
}

#[test]
fn one_ping_again_and_again() {
    told_of_sonar(|_| profile(7, |_| {}), &["none is new", "duplicate"]);
}

#[test]
fn profiles_that_no_sonar_makes() {
    let silent_water = |i| profile(i, |p| p.sos_dmps = 0);
    told_of_sonar(silent_water, &["speed of sound 0"]);
    told_of_sonar(|i| profile(i, |p| p.max_pwr_db = f32::NAN), &["scale"]);
    told_of_sonar(|i| profile(i, |p| p.pulse_duration_sec = -1.0), &["pulse"]);
    told_of_sonar(|i| profile(i, |p| p.length_mm = 0), &["range"]);
    told_of_sonar(|i| profile(i, |p| p.gain_index = 300), &["gain"]);
}

#[test]
fn profiles_without_life() {
    told_of_sonar(
        |i| profile_of(i, &[0; 1200], |_| {}),
        &["every bin of a ping has held the same value"],
    );
    let frozen = |i| {
        let results: Vec<u8> = (0..1200).map(|k| (k * 7 % 251) as u8).collect();
        profile_of(i, &results, |_| {})
    };
    told_of_sonar(frozen, &["the same profile under new numbers"]);
}

#[test]
fn poses_that_never_come_or_stop() {
    told_of_poses(|_| None, &["no poses from zenoh://", "pose.url"]);
    let stopping = |seconds: f64| (seconds < 2.0).then(|| pose_at(now(), seconds));
    told_of_poses(stopping, &["no pose from zenoh:// for"]);
}

#[test]
fn poses_of_another_time() {
    let hour_ago = |seconds: f64| Some(pose_at(now().offset_by(-3600.0), seconds));
    told_of_poses(hour_ago, &["have no time in common", "--time-offset-s -3"]);
}

/// What is told of these poses, and what is not told beside it.
fn told_of_stamps(stamp: impl Fn(i64) -> i64 + Send + 'static, words: &[&str]) {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let mut service = service(&sonar.url(), port);
    let _vehicle = FakeVehicle::start(port, move |seconds| {
        let mut pose = pose_at(now(), seconds);
        pose.time = Timestamp::from_nanos(stamp(pose.time.nanos()));
        Some(pose)
    });
    service.wait_for_text(words[0], LONG);
    // What a slower notice would be told by then.
    std::thread::sleep(Duration::from_secs(4));
    for wrong in [
        "--time-offset-s",
        "second source",
        "two sources",
        "too far apart",
        "ask for more",
    ] {
        assert!(
            !service.stderr().contains(wrong),
            "{wrong}\n{}",
            service.account()
        );
    }
    told(service, words);
}

#[test]
fn poses_without_a_stamp_and_of_another_unit() {
    told_of_stamps(
        |_| 0,
        &["poses so far are stamped 0", "leaves their time out"],
    );
    told_of_stamps(
        |nanos| nanos / 1_000_000,
        &["which is the time in milliseconds", "1000000 times as much"],
    );
}

/// A DVL that sees the bottom, and after two seconds sends nothing more.
#[test]
fn a_dvl_that_falls_silent() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("loopback has free ports");
    let dvl = format!("dvl://{}", listener.local_addr().expect("it is bound"));
    let _dvl = std::thread::spawn(move || {
        let (mut first, _) = listener.accept()?;
        for i in 0..10 {
            let report = format!(
                "{{\"ts\":{:.1},\"x\":{i},\"y\":0,\"z\":1,\"std\":0.01,\"roll\":0,\"pitch\":0,\"yaw\":0,\
                 \"type\":\"position_local\",\"status\":0,\"format\":\"json_v3.1\"}}\r\n",
                f64::from(i) * 0.2
            );
            first.write_all(report.as_bytes())?;
            std::thread::sleep(Duration::from_millis(200));
        }
        // Held, and then connected again.
        let again = listener.accept()?;
        std::thread::sleep(LONG);
        std::io::Result::Ok((first, again))
    });
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let bus = bus_at(port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let url = sonar.url();
    let arguments = [&["run", "--sonar", &url, "--pose", &dvl][..], &bus].concat();
    let mut service = Program::echosplat(&arguments);
    service.wait_for_text("nothing from the DVL for", LONG);
    // Past the time after which a DVL is told to see the bottom, and that after which it is called again.
    service.wait_for_text("it sends no reports; trying again", LONG);
    assert!(
        !service.stderr().contains("bottom"),
        "{}",
        service.account()
    );
    told(service, &["is it powered"]);
}

#[test]
fn a_second_publisher_of_poses() {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let service = service(&sonar.url(), port);
    let _first = FakeVehicle::start(port, |seconds| Some(pose_at(now(), seconds)));
    let aside = |seconds: f64| {
        let mut pose = pose_at(now(), seconds);
        pose.world_from_vehicle.translation_m.x += 2.0;
        Some(pose)
    };
    let _second = FakeVehicle::start(port, aside);
    told(
        service,
        &["a second source sends poses 2.0 m from the first"],
    );
}

#[test]
fn poses_that_freeze_while_the_view_changes() {
    let wandering = |i: u32| {
        let at = i * 3 % 600;
        let power = |bin: u32| {
            if bin.abs_diff(at) < 8 {
                60_000_u16
            } else {
                9_000
            }
        };
        let mixed =
            |bin: u32| ((bin ^ i.wrapping_mul(7919)).wrapping_mul(2_654_435_761) >> 20) as u16;
        let results: Vec<u8> = (0..600)
            .flat_map(|bin| (power(bin) + mixed(bin)).to_le_bytes())
            .collect();
        profile_of(i, &results, |_| {})
    };
    let sonar = FakeSonar::start(wandering);
    let port = free_port();
    let service = service(&sonar.url(), port);
    let _vehicle = FakeVehicle::start(port, |seconds| Some(pose_at(now(), seconds.min(1.0))));
    told(service, &["poses have not changed for"]);
}

#[test]
fn one_stamp_an_hour_ahead_does_not_end_mapping() {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let mut service = service(&sonar.url(), port);
    let once = std::sync::atomic::AtomicBool::new(false);
    let _vehicle = FakeVehicle::start(port, move |seconds| {
        use std::sync::atomic::Ordering::Relaxed;
        let is_odd = seconds > 2.0 && !once.swap(true, Relaxed);
        let ahead_s = if is_odd { 3600.0 } else { 0.0 };
        if seconds < 2.0 {
            once.store(false, Relaxed);
        }
        Some(pose_at(now().offset_by(ahead_s), seconds))
    });
    service.wait_for_text("far from the clock", LONG);
    std::thread::sleep(Duration::from_secs(2));
    service.terminate();
    service.wait_exit(Duration::from_secs(10));
    let stdout = service.stdout();
    let received: u64 = first_number(&stdout, " pings received");
    let mapped: u64 = first_number(&stdout, " mapped");
    assert!(mapped * 10 > received * 8, "{}", service.account());
}

/// The number right before `words`.
fn first_number(text: &str, words: &str) -> u64 {
    let before = text.split(words).next().unwrap_or_default();
    let digits = before.rsplit(|c: char| !c.is_ascii_digit()).next();
    digits.unwrap_or_default().parse().unwrap_or(0)
}

#[test]
fn a_second_service_of_the_same_name_is_refused() {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let mut first = service(&sonar.url(), port);
    first.wait_for_text("sonar link is up", LONG);
    let bus = bus_at(port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let url = sonar.url();
    let second = [&["run", "--sonar", &url][..], &bus].concat();
    let mut refused = Program::echosplat(&second);
    refused.wait_exit_code(2, LONG);
    assert!(
        refused.stderr().contains("(--node)"),
        "{}",
        refused.account()
    );
    let mut advised = Program::echosplat(&[&second[..], &["--node", "another"]].concat());
    advised.wait_for_text("sonar link is up", LONG);
}

#[test]
fn a_replay_without_poses_says_what_to_give() {
    let log = crate::dive::file("dive.svlog");
    let mut replay = Program::echosplat(&["replay", &log]);
    replay.wait_exit_code(2, LONG);
    assert!(
        replay.stderr().contains("--poses F.tum"),
        "{}",
        replay.account()
    );
    let poses = crate::dive::file("dive.tum");
    Program::echosplat(&["replay", &log, "--poses", &poses, "--finished-only"])
        .wait_exit_code(0, LONG);
}
