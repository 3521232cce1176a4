//! Logs as the vendor's Python client writes them: the session packet is stamped when the log is opened, and the first
//! ping comes when somebody presses a key.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use echosplat_firmware_protocol::{Frame, Message};
use serde_json::{Value, json};

use crate::dive::dive;
use crate::harness::Program;

const LONG: Duration = Duration::from_secs(240);
/// 2024-05-01 12:00, when the first ping is sent.
const FIRST_PING_S: f64 = 1_714_564_800.0;

/// Its files, `late_s` after the log was opened.
struct ClientDive {
    log: String,
    poses: String,
    map: PathBuf,
}

impl ClientDive {
    fn of(dive: &Path, name: &str, late_s: f64) -> Self {
        let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        fs::create_dir_all(&directory).expect("a directory of ours");
        let [log, poses, map] = ["client.svlog", "poses.tum", "map.ply"].map(|f| directory.join(f));
        fs::write(&log, with_packet_of(&dive.join("dive.svlog"), late_s)).expect("a file of ours");
        fs::write(&poses, on_unix_time(&dive.join("dive.tum"))).expect("a file of ours");
        Self {
            log: log.display().to_string(),
            poses: poses.display().to_string(),
            map,
        }
    }

    /// What a replay says that ends with this code.
    fn replayed(&self, more: &[&str], code: i32) -> Value {
        let map = self.map.display().to_string();
        let own = [
            "replay",
            &self.log,
            "--poses",
            &self.poses,
            "--map",
            &map,
            "--json",
        ];
        let mut program = Program::echosplat(&[&own[..], more].concat());
        program.wait_exit_code(code, LONG);
        program.only_json()
    }
}

/// The log with the client's session packet in front instead of its own.
fn with_packet_of(log: &Path, late_s: f64) -> Vec<u8> {
    let bytes = fs::read(log).expect("a log of ours");
    let payload = usize::from(u16::from_le_bytes([bytes[2], bytes[3]]));
    let (own, frames) = bytes.split_at(8 + payload + 2);
    assert_eq!(Frame::from_bytes(own).expect("a frame").message_id(), 10);
    let opened_ms = (1e3 * (FIRST_PING_S - late_s)) as i64;
    let time = echosplat_model::Timestamp::from_millis(opened_ms).nanos();
    let (second, micros) = (
        time.div_euclid(1_000_000_000),
        time.rem_euclid(1_000_000_000) / 1_000,
    );
    let of_day = second.rem_euclid(86_400);
    let packet = json!({
        "session_id": 1, "session_uptime": 0.0,
        "session_devices": [{"url": "tcp://192.168.2.92:51200", "product_id": "os450"}],
        "session_platform": null, "session_clients": [], "session_plan_name": null, "is_recording": true,
        "sonarlink_version": "", "os_hostname": "rov", "os_uptime": null, "os_platform": "linux",
        "process_path": "/usr/bin/python3", "process_version": "v3.11.2", "process_uptime": 0.31,
        "timestamp": format!(
            "2024-05-01T{:02}:{:02}:{:02}.{micros:06}+00:00", of_day / 3600, of_day / 60 % 60, of_day % 60
        ),
        "timestamp_timezone_offset": 0.0,
    });
    let text = packet.to_string();
    let message = Message::Json(text.as_str().into());
    let mut packet = vec![0; message.encoded_byte_count()];
    let length = message.encode(0, 0, &mut packet).expect("it fits");
    [&packet[..length], frames].concat()
}

fn on_unix_time(poses: &Path) -> String {
    let text = fs::read_to_string(poses).expect("a file of ours");
    let shifted = |line: &str| {
        let (time, rest) = line.split_once(' ').expect("a stamp and a pose");
        let time: f64 = time.parse().expect("seconds");
        format!("{:.9} {rest}\n", time + FIRST_PING_S)
    };
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .map(shifted)
        .collect()
}

fn notice(said: &Value) -> Option<&str> {
    let notices = said["notices"].as_array().expect("notices");
    let notice = notices
        .iter()
        .find(|notice| notice["code"] == "log-clock")?;
    notice["sentence"].as_str()
}

#[test]
fn pings_that_came_later_than_the_log_was_opened_are_mapped_where_they_were_heard() {
    let truth = dive().join("truth").display().to_string();
    for late_s in [0.6, 12.0] {
        let client = ClientDive::of(dive(), &format!("client-{late_s}"), late_s);
        let said = client.replayed(&["--truth", &truth], 0);
        let told = notice(&said).unwrap_or_else(|| panic!("{said}"));
        let advice = told.split("--time-offset-s ").nth(1).expect("what to set");
        let offset_s: f64 = advice.parse().expect("seconds");
        assert!((offset_s - late_s).abs() < 0.05, "{told}");
        let beyond = &said["metrics"]["confident_false_share"];
        assert!(
            beyond.as_f64().is_some_and(|beyond| beyond < 0.05),
            "{said}"
        );
        let map = fs::read(&client.map).expect("a map");
        let as_advised = client.replayed(&["--time-offset-s", advice], 0);
        assert_eq!(notice(&as_advised), None);
        assert!(map == fs::read(&client.map).expect("a map"), "another map");
    }
}

#[test]
fn a_log_whose_first_ping_came_at_once_is_mapped_as_ever() {
    let client = ClientDive::of(dive(), "client-0", 0.0);
    let said = client.replayed(&[], 0);
    assert_eq!(notice(&said), None, "{said}");
    let map = fs::read(&client.map).expect("a map");
    client.replayed(&["--time-offset-s", "0"], 0);
    assert!(map == fs::read(&client.map).expect("a map"), "another map");
}

#[test]
fn where_pings_do_not_tell_what_to_run_is_said_and_the_replay_counts_as_lossy() {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("client-empty-dive");
    let out = directory.display().to_string();
    let dive = [
        "simulate",
        "--scene",
        "empty",
        "--duration",
        "8",
        "--out",
        &out,
    ];
    Program::echosplat(&dive).wait_exit_code(0, LONG);
    // So little that all pings have poses.
    let client = ClientDive::of(&directory, "client-empty", 0.1);
    let said = client.replayed(&[], 3);
    let told = notice(&said).unwrap_or_else(|| panic!("{said}"));
    let command = format!(
        "echosplat calibrate {} --poses {} --only time",
        client.log, client.poses
    );
    assert!(told.contains(&command), "{told}");
    assert_eq!(notice(&client.replayed(&["--time-offset-s", "0"], 0)), None);
}

#[test]
fn calibrate_finds_how_much_later_pings_came() {
    let client = ClientDive::of(dive(), "client-calibrated", 21.0);
    let asked = [
        "calibrate",
        &client.log,
        "--poses",
        &client.poses,
        "--only",
        "time",
        "--json",
    ];
    let mut program = Program::echosplat(&asked);
    program.wait_exit_code(0, LONG);
    let said = program.only_json();
    let found = &said["parameters"][0];
    assert_eq!(found["verdict"], "off", "{found}");
    let fits_s = found["fits"].as_f64();
    assert!(
        fits_s.is_some_and(|fits_s| (fits_s - 21.0).abs() < 0.05),
        "{found}"
    );
}
