//! The extension of `BlueOS`, without a container: what its files say, and what it runs.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use serde_json::Value;

use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::web_client::ask;

const LONG: Duration = Duration::from_secs(60);
const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../blueos");

/// Value of a label of the image, its lines put together as Docker does.
fn label(name: &str) -> String {
    let file = std::fs::read_to_string(format!("{FOLDER}/Dockerfile")).expect("it is there");
    let joined = file.replace("\\\n", "");
    let start = format!("LABEL {name}=");
    let line = joined.lines().find_map(|line| line.strip_prefix(&start));
    let line = line.unwrap_or_else(|| panic!("no label {name}"));
    line.trim_matches(['\'', '"']).to_owned()
}

#[test]
fn its_labels_are_what_blueos_reads() {
    let json = |name| serde_json::from_str::<Value>(&label(name)).unwrap();
    let permissions = json("permissions");
    assert_eq!(permissions["HostConfig"]["NetworkMode"], "host");
    assert!(permissions["HostConfig"]["Privileged"].is_null());
    assert!(json("authors")[0]["name"].is_string() && json("company")["name"].is_string());
    assert!(json("tags").as_array().is_some_and(|tags| tags.len() <= 10));
    assert_eq!(label("version"), env!("CARGO_PKG_VERSION"));
}

#[test]
fn it_starts_with_its_own_configuration_and_keeps_the_owners() {
    let data = tempfile::tempdir().unwrap();
    let own = data.path().join("echosplat.toml");
    let program = Path::new(env!("CARGO_BIN_EXE_echosplat"));
    let path = std::env::var("PATH").unwrap_or_default();
    let port = free_port();
    // Another service of its name may be where the bus is unless configured.
    let bus = bus_at(free_port());
    let start = |more: &[&str]| {
        let mut command = Command::new("sh");
        command
            .arg(format!("{FOLDER}/start.sh"))
            .args(["--web", &port.to_string()])
            .args(&bus)
            .args(more);
        command.env(
            "PATH",
            format!("{}:{path}", program.parent().unwrap().display()),
        );
        command.env("ECHOSPLAT_DATA", data.path());
        command.env("ECHOSPLAT_GIVEN", format!("{FOLDER}/echosplat.toml"));
        Program::start(command)
    };
    let simulated = ["--sonar", "sim://fence", "--pose", "zenoh://"];
    let mut service = start(&simulated);
    wait_until_listening(&mut service, port);
    let about = ask(port, "GET", "/register_service", &[]).body;
    assert_eq!(
        serde_json::from_slice::<Value>(&about).unwrap()["name"],
        "EchoSplat"
    );
    service.wait_for("a recording", LONG, |_| {
        let mut files = std::fs::read_dir(data.path().join("recordings")).ok()?;
        files.next()?.ok()
    });
    service.interrupt();
    service.wait_exit(LONG);

    let given = std::fs::read_to_string(&own).unwrap();
    std::fs::write(
        &own,
        given.replace("range_length_m = 10.0", "range_length_m = 1000.0"),
    )
    .unwrap();
    let mut service = start(&simulated);
    service.wait_exit_code(2, LONG);
    assert!(
        service.stderr().contains("session.range_length_m"),
        "{}",
        service.account()
    );
}
