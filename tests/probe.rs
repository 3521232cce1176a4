//! `echosplat probe` finds an emulated unit over each kind of link, and says what is in the way of
//! others.

use std::io::Write;
use std::net::TcpListener;
use std::time::{Duration, Instant};

use crate::harness::{Program, free_port};

const READY: Duration = Duration::from_secs(60);

/// Emulates at `url`, probes it, and holds what both say against each other.
fn found_at(url: &str) {
    let arguments = ["emulate", "--duration", "30", "--listen", url];
    let mut emulated = Program::echosplat(&arguments);
    emulated.wait_for_text("listening", READY);
    let mut probed = Program::echosplat(&["probe", "--json", "--sonar", url]);
    probed.wait_exit_code(0, READY);
    let said = probed.only_json();
    let unit = &said["found"][0];
    let account = probed.account();
    assert_eq!(unit["identity"]["device_type"], 104, "{account}");
    assert_eq!(unit["identity"]["product"], "OmniScan 450", "{account}");
    assert_eq!(unit["was_pinging"], false, "{account}");
    assert_eq!(unit["profile"]["bin_count"], 600, "{account}");
    assert_eq!(unit["profile"]["range_length_m"], 10.0, "{account}");
    let level = |key: &str| unit["profile"][key].as_f64().expect("it is a number");
    assert!(level("noise_db") < level("strongest_db"), "{account}");

    let mut in_words = Program::echosplat(&["probe", "--sonar", url]);
    in_words.wait_exit_code(0, READY);
    let words = in_words.stdout();
    assert!(
        words.contains("OmniScan 450 (type 104), revision 2, firmware 1.5.6"),
        "{words}"
    );
    assert!(words.contains("600 bins"), "{words}");

    emulated.terminate();
    emulated.wait_exit_code(0, READY);
    let seen = emulated.only_json();
    // What was started was stopped.
    assert_eq!(seen["is_pinging"], false, "{seen}");
    assert!(seen["disables"].as_u64() >= Some(2), "{seen}");
}

#[test]
fn a_unit_is_found_over_tcp() {
    found_at(&format!("tcp://127.0.0.1:{}", free_port()));
}

#[test]
fn a_unit_is_found_over_udp() {
    found_at(&format!("udp://127.0.0.1:{}", free_port()));
}

#[test]
fn a_unit_is_found_on_a_serial_line() {
    let folder = tempfile::tempdir().expect("temporary directories can be made");
    let link = folder.path().join("sonar");
    found_at(&format!("serial://{}", link.display()));
}

#[test]
fn what_is_in_the_way_is_said_of_each_place_and_in_time() {
    let folder = tempfile::tempdir().expect("temporary directories can be made");
    let file = folder.path().join("file");
    std::fs::write(&file, "x").expect("files can be written");
    // One that listens and says nothing, one that talks of something else.
    let mute = TcpListener::bind("127.0.0.1:0").expect("loopback has free ports");
    let web = TcpListener::bind("127.0.0.1:0").expect("loopback has free ports");
    let address = |listener: &TcpListener| listener.local_addr().expect("it is bound");
    let (mute_at, web_at) = (address(&mute), address(&web));
    let answering = std::thread::spawn(move || {
        let (mut stream, _) = web.accept().expect("it is connected to");
        let _ = stream.write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n");
        std::thread::sleep(Duration::from_secs(1));
    });
    let arguments = [
        "probe".to_owned(),
        "--timeout".to_owned(),
        "2".to_owned(),
        format!("--sonar=tcp://127.0.0.1:{}", free_port()),
        format!("--sonar=udp://127.0.0.1:{}", free_port()),
        format!("--sonar=tcp://{mute_at}"),
        format!("--sonar=tcp://{web_at}"),
        format!("--sonar=serial://{}", file.display()),
        format!("--sonar=serial://{}", folder.path().join("none").display()),
    ];
    let began = Instant::now();
    let mut probed = Program::echosplat(&arguments);
    probed.wait_exit_code(1, READY);
    let account = probed.account();
    // 2 s, time to close, and time to start.
    assert!(began.elapsed() < Duration::from_secs(10), "{account}");
    answering.join().expect("it answers");
    let said = probed.stdout();
    let lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines.len(), 6, "{account}");
    for (line, words) in lines.iter().zip([
        "nothing listens on that port",
        "nothing listens on that port",
        "connected, but nothing answers",
        "not as a Ping device",
        "is a file, not a serial line",
        "is the adapter plugged in?",
    ]) {
        assert!(line.contains(words), "no {words:?} in {line:?}\n{account}");
    }
    assert!(
        probed.stderr().contains("no sonar found at 6 places"),
        "{account}"
    );
}
