//! The first hour without a sonar: `emulate` in one terminal, then `probe`, then `run`, and again.

use std::process::Command;
use std::time::Duration;

use crate::dive::file;
use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::python::tool;

const LONG: Duration = Duration::from_secs(120);

/// A sonar and a bus of a test's own.
struct Place {
    sonar: String,
    sonar_port: u16,
    bus_port: u16,
    bus: [String; 4],
}

impl Place {
    fn new() -> Self {
        let (sonar_port, bus_port) = (free_port(), free_port());
        Self {
            sonar: format!("tcp://127.0.0.1:{sonar_port}"),
            sonar_port,
            bus_port,
            bus: bus_at(bus_port),
        }
    }

    fn with_bus(&self, own: &[&str]) -> Vec<String> {
        let own = own.iter().map(ToString::to_string);
        own.chain(self.bus.iter().cloned()).collect()
    }

    fn emulate(&self, seconds: &str, more: &[&str]) -> Program {
        let own = ["emulate", "--duration", seconds, "--listen", &self.sonar];
        let mut emulated = Program::echosplat(&self.with_bus(&[&own, more].concat()));
        emulated.wait_for_text("listening on", LONG);
        emulated
    }

    fn run(&self, more: &[&str]) -> Program {
        let own = ["run", "--sonar", &self.sonar, "--verbose"];
        Program::echosplat(&self.with_bus(&[&own, more].concat()))
    }

    fn probe(&self) {
        let mut probed = Program::echosplat(&["probe", "--sonar", &self.sonar]);
        probed.wait_exit_code(0, LONG);
        let words = probed.stdout();
        assert!(words.contains("one ping"), "{}", probed.account());
    }
}

/// Runs for 5 s of the dive; returns how many pings were received.
fn all_mapped(place: &Place) -> u64 {
    let mut service = place.run(&["--duration", "5"]);
    service.wait_exit_code(0, LONG);
    let account = service.account();
    let said = service.stdout();
    let line = said.lines().next().unwrap_or_default();
    let counts: Vec<u64> = line
        .split(|c: char| !c.is_ascii_digit())
        .filter_map(|digits| digits.parse().ok())
        .collect();
    // "N pings received, N mapped, 0 without a pose"
    let [received, mapped, without_pose] = counts[..] else {
        panic!("another first line\n{account}");
    };
    assert!(mapped >= 150 && without_pose == 0, "{account}");
    assert!(!account.contains("are stamped"), "{account}");
    received
}

#[test]
fn emulate_then_probe_then_run_and_run_again_loses_no_ping() {
    let place = Place::new();
    let mut emulated = place.emulate("60", &["--publish-poses"]);
    place.probe();
    let mut received = all_mapped(&place);
    place.probe();
    received += all_mapped(&place);
    // One that is killed leaves the sonar pinging.
    let mut killed = place.run(&[]);
    killed.wait_for_text("pings_mapped=", LONG);
    drop(killed);
    received += all_mapped(&place);
    emulated.terminate();
    emulated.wait_exit_code(0, LONG);
    let seen = emulated.only_json();
    assert!(seen["pings"].as_u64() >= Some(received), "{seen}");
    assert_eq!(seen["is_pinging"], false, "{seen}");
}

#[test]
fn a_dive_that_is_over_begins_anew_for_the_next_run() {
    let place = Place::new();
    let mut emulated = place.emulate("2", &["--publish-poses"]);
    for _ in 0..2 {
        let mut service = place.run(&[]);
        emulated.wait_for_text("the dive is over", LONG);
        service.wait_for("most of the dive in the map", LONG, |service| {
            crate::link::newest_count(&service.stderr(), "pings_mapped")
                .filter(|&mapped| mapped > 60)
        });
        service.interrupt();
        service.wait_exit(LONG);
    }
    place.probe();
}

#[test]
fn poses_of_a_file_start_with_the_first_ping_of_an_emulated_sonar() {
    // Makes the environment of the tools, which may take as long as the dive.
    tool("send_poses.py", &["--help"]).wait_exit_code(0, LONG);
    let place = Place::new();
    let _emulated = place.emulate("24", &[]);
    place.probe();
    let mut service = place.run(&[]);
    wait_until_listening(&mut service, place.bus_port);
    let to = format!("tcp/127.0.0.1:{}", place.bus_port);
    let sonar = format!("127.0.0.1:{}", place.sonar_port);
    let poses = file("dive.tum");
    let mut sender = tool(
        "send_poses.py",
        &["--as", "json", "--to", &to, "--sonar", &sonar, &poses],
    );
    sender.wait_for_text("start with the first ping", LONG);
    let mapped = service.wait_for("pings in the map", LONG, |service| {
        crate::link::newest_count(&service.stderr(), "pings_mapped").filter(|&mapped| mapped > 40)
    });
    assert!(mapped > 40);
    // Each pose was sent when the dive was there: what it is late is the same for all.
    let late: Vec<i64> = sender
        .stdout()
        .lines()
        .filter_map(|line| {
            let (sent, dive) = line.split_once(' ')?;
            Some(sent.parse::<i64>().ok()? - dive.parse::<i64>().ok()?)
        })
        .skip(30)
        .collect();
    let (least, most) = (late.iter().min(), late.iter().max());
    let apart = most.zip(least).map(|(most, least)| most - least);
    assert!(
        apart.is_some_and(|apart| apart < 1_000_000_000),
        "{apart:?}"
    );
    service.interrupt();
    service.wait_exit(LONG);

    // Without it is said what is wrong.
    let mut alone = tool(
        "send_poses.py",
        &["--as", "json", "--to", &to, "--now", &poses],
    );
    alone.wait_for_text("--sonar HOST:PORT", LONG);
}

/// Of a level that is not the processor's best, which every x86 processor has.
#[test]
fn the_level_of_vector_instructions_is_told_and_can_be_held_down() {
    let replay = |level: Option<&str>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_echosplat"));
        command.args(["replay", &file("dive.svlog"), "--poses", &file("dive.tum")]);
        command.args(["--end", "1", "--json"]);
        if let Some(level) = level {
            command.env("ECHOSPLAT_SIMD", level);
        }
        Program::start(command)
    };
    let mut best = replay(None);
    best.wait_exit_code(0, LONG);
    let level = best.only_json()["simd"]
        .as_str()
        .unwrap_or_default()
        .to_owned();
    assert!(!level.is_empty(), "{}", best.account());
    assert!(
        best.stderr()
            .contains(&format!("made with {level} instructions"))
    );
    let mut wrong = replay(Some("mmx"));
    wrong.wait_exit_code(2, LONG);
    let said = wrong.stderr();
    assert!(
        said.contains("ECHOSPLAT_SIMD") && said.contains(&level),
        "{said}"
    );
    if cfg!(target_arch = "x86_64") {
        let mut held = replay(Some("sse2"));
        held.wait_exit_code(0, LONG);
        assert_eq!(held.only_json()["simd"], "sse2", "{}", held.account());
        assert!(held.stderr().contains("without fused multiply-add"));
    }
}
