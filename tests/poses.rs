//! Poses as vehicles send them, by senders that others wrote or in Python, put pings into the map.

use std::io::Write;
use std::net::TcpListener;
use std::time::Duration;

use crate::dive::file;
use crate::fake_sonar::{FakeSonar, profile};
use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::link::newest_count;
use crate::python::tool;

const LONG: Duration = Duration::from_secs(60);

/// A service with poses from `pose`, and a vehicle that sends them as `kind` to `to`, where `{bus}` is
/// the bus's endpoint; pings are mapped.
fn mapped(kind: &str, pose: &str, to: &str) {
    mapped_of(&[&["--as", kind, "--to", to]], pose, &[]);
}

/// The same of several senders, each with its arguments; `words` are told.
fn mapped_of(senders: &[&[&str]], pose: &str, words: &[&str]) {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let bus = bus_at(port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let url = sonar.url();
    let own = ["run", "--sonar", &url, "--pose", pose, "--verbose"];
    let mut service = Program::echosplat(&[&own[..], &bus].concat());
    wait_until_listening(&mut service, port);
    let poses = file("dive.tum");
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let start = |sender: &&[&str]| {
        let own = sender.iter().map(|own| own.replace("{bus}", &endpoint));
        let all: Vec<String> = own.chain(["--now".to_owned(), poses.clone()]).collect();
        let all: Vec<&str> = all.iter().map(String::as_str).collect();
        tool("send_poses.py", &all)
    };
    let _vehicles: Vec<_> = senders.iter().map(start).collect();
    for word in words {
        service.wait_for_text(word, LONG);
    }
    service.wait_for("pings in the map", LONG, |service| {
        newest_count(&service.stderr(), "pings_mapped").filter(|&count| count > 40)
    });
    service.interrupt();
    service.wait_exit(Duration::from_secs(10));
}

#[test]
fn a_string_put_on_the_bus_as_the_documents_show() {
    mapped("json", "zenoh://", "{bus}");
}

#[test]
fn odometry_as_rosbags_writes_it() {
    mapped("odometry", "zenoh://", "{bus}");
}

#[test]
fn an_autopilot_over_udp() {
    let port = free_port();
    let url = format!("mavlink+udp://127.0.0.1:{port}");
    mapped("mavlink-udp", &url, &format!("127.0.0.1:{port}"));
}

#[test]
fn an_autopilot_behind_a_mavlink_server() {
    mapped("mavlink-json", "mavlink+zenoh://", "{bus}");
    mapped("mavlink-raw", "mavlink+zenoh://?system=1", "{bus}");
}

#[test]
fn a_dvl_with_dead_reckoning() {
    let port = free_port();
    let url = format!("dvl://127.0.0.1:{port}");
    mapped("dvl", &url, &format!("127.0.0.1:{port}"));
}

#[test]
fn an_autopilot_that_knows_its_velocity_and_no_position() {
    let port = free_port();
    let (url, to) = (
        format!("mavlink+udp://127.0.0.1:{port}"),
        format!("127.0.0.1:{port}"),
    );
    mapped_of(
        &[&["--as", "mavlink-velocity", "--to", &to]],
        &url,
        &[
            "positions are reckoned from attitude and VISION_POSITION_DELTA, height by GLOBAL_POSITION_INT",
        ],
    );
}

#[test]
fn an_autopilot_without_a_velocity_beside_a_dvl() {
    let (port, dvl) = (free_port(), format!("127.0.0.1:{}", free_port()));
    let url = format!("mavlink+udp://127.0.0.1:{port}?velocity=dvl://{dvl}");
    let to = format!("127.0.0.1:{port}");
    mapped_of(
        &[
            &["--as", "mavlink-velocity", "--attitude-only", "--to", &to],
            &["--as", "dvl", "--to", &dvl],
        ],
        &url,
        &["positions are reckoned from attitude and the velocity of the DVL"],
    );
}

#[test]
fn attitude_and_depth_alone_are_told() {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let (port, bus) = (free_port(), bus_at(free_port()));
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let (url, pose) = (sonar.url(), format!("mavlink+udp://127.0.0.1:{port}"));
    let own = ["run", "--sonar", &url, "--pose", &pose, "--verbose"];
    let mut service = Program::echosplat(&[&own[..], &bus].concat());
    let (to, poses) = (format!("127.0.0.1:{port}"), file("dive.tum"));
    let kind = ["--as", "mavlink-velocity", "--attitude-only"];
    let _vehicle = tool(
        "send_poses.py",
        &[&kind[..], &["--to", &to, "--now", &poses]].concat(),
    );
    service.wait_for_text("no position and no velocity over ground", LONG);
    service.terminate();
    service.wait_exit_code(3, Duration::from_secs(20));
}

/// A relay that merges the reports of two DVLs, one 12 m beside the other and switched on 300 s before it.
fn merged_dvls() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("loopback has free ports");
    let port = listener.local_addr().expect("it is bound").port();
    std::thread::spawn(move || {
        let (mut client, _) = listener.accept().expect("the service connects");
        for i in 0.. {
            let seconds = f64::from(i) * 0.2;
            for (clock_s, x) in [(50.0, 0.1 * seconds), (350.0, 12.0 + 0.1 * seconds)] {
                let ts = clock_s + seconds;
                let report = format!(
                    r#"{{"ts":{ts},"x":{x},"y":0,"z":1,"std":0.01,"roll":0,"pitch":0,"yaw":0,"type":"position_local","status":0}}"#
                );
                if client
                    .write_all(format!("{report}\r\n").as_bytes())
                    .is_err()
                {
                    return;
                }
                std::thread::sleep(Duration::from_millis(100));
            }
        }
    });
    port
}

#[test]
fn two_dvls_behind_a_relay_are_told() {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let bus = bus_at(free_port());
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let (url, dvl) = (sonar.url(), format!("dvl://127.0.0.1:{}", merged_dvls()));
    let own = ["run", "--sonar", &url, "--pose", &dvl, "--verbose"];
    let mut service = Program::echosplat(&[&own[..], &bus].concat());
    service.wait_for_text("two DVLs report on the same connection, 12.0 m apart", LONG);
    service.terminate();
    service.wait_exit_code(3, Duration::from_secs(20));
}
