//! A zenoh router that is not there: the dive goes on without it, and meets it whenever it comes.

use std::fs;
use std::time::Duration;

use zenoh::Wait;

use crate::fake_sonar::{FakeSonar, now, pose_at, profile};
use crate::harness::{Program, free_port};

const LONG: Duration = Duration::from_secs(60);

fn router(port: u16) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config
            .insert_json5(key, &value)
            .expect("zenoh has the setting");
    }
    zenoh::open(config).wait().expect("zenoh opens")
}

/// Poses of the next minutes on the host's clock.
fn trajectory() -> String {
    let begin = now();
    let row = |index: u32| {
        let since_s = f64::from(index) * 0.1;
        let pose = pose_at(begin.offset_by(since_s), since_s);
        let (t, q) = (
            pose.world_from_vehicle.translation_m,
            pose.world_from_vehicle.rotation,
        );
        let nanos = pose.time.nanos();
        let (seconds, rest) = (nanos / 1_000_000_000, nanos % 1_000_000_000);
        format!(
            "{seconds}.{rest:09} {} {} {} {} {} {} {}\n",
            t.x, t.y, t.z, q.x, q.y, q.z, q.w
        )
    };
    (0..3000).map(row).collect()
}

/// How many pings were in the map at the end.
fn mapped(service: &Program) -> u64 {
    let stdout = service.stdout();
    let before = stdout.split(" mapped").next().unwrap_or_default();
    let digits = before.rsplit(' ').next().unwrap_or_default();
    digits.parse().unwrap_or(0)
}

#[test]
fn a_router_that_comes_goes_and_comes_back() {
    let folder = tempfile::tempdir().expect("there is room");
    let port = free_port();
    let path = |name: &str| folder.path().join(name).display().to_string();
    // As the file that zenoh itself gives has it.
    let zenoh = format!(
        "{{ mode: 'client', connect: {{ endpoints: ['tcp/127.0.0.1:{port}'], timeout_ms: {{ router: -1, peer: -1, \
         client: 0 }}, exit_on_failure: {{ router: false, peer: false, client: true }} }} }}"
    );
    fs::write(path("zenoh.json5"), zenoh).expect("the folder is writable");
    fs::write(path("poses.tum"), trajectory()).expect("the folder is writable");
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let (url, poses) = (sonar.url(), format!("tum://{}", path("poses.tum")));
    let mut service = Program::echosplat(&[
        "run",
        "--sonar",
        &url,
        "--pose",
        &poses,
        "--zenoh-config",
        &path("zenoh.json5"),
        "--record",
        &path("recordings"),
        "--map",
        &path("map.ply"),
    ]);
    let absent = format!("zenoh reaches nobody at tcp/127.0.0.1:{port} (connection refused");
    service.wait_for_text(&absent, LONG);
    service.wait_for_text("sonar link is up", LONG);
    let times = |service: &Program, words: &str| service.stderr().matches(words).count();
    for round in 1..=2 {
        let router = router(port);
        service.wait_for("the router", LONG, |service| {
            (times(service, "INFO over: zenoh reaches nobody") == round).then_some(())
        });
        router.close().wait().expect("it closes");
        service.wait_for("its end", LONG, |service| {
            (times(service, "WARN zenoh reaches nobody") == round + 1).then_some(())
        });
    }
    service.terminate();
    service.wait_exit_code(0, LONG);
    assert!(mapped(&service) > 100, "{}", service.account());
    let recordings = fs::read_dir(path("recordings")).expect("it is recorded");
    let bytes: u64 = recordings
        .map(|file| file.and_then(|file| file.metadata()).map_or(0, |m| m.len()))
        .sum();
    assert!(bytes > 100_000, "{bytes}");
    assert!(folder.path().join("map.ply").is_file());
}

#[test]
fn a_name_that_is_wrong_and_a_port_that_another_holds_end_no_dive() {
    let held = std::net::TcpListener::bind("127.0.0.1:0").expect("loopback has free ports");
    let held_port = held.local_addr().expect("it is bound").port();
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    for (endpoint, why) in [
        (
            "tcp/no-such-router.invalid:7447".to_owned(),
            "no-such-router.invalid is not found",
        ),
        (
            format!("tcp/127.0.0.1:{held_port}"),
            "does not answer as zenoh does",
        ),
    ] {
        let connect = format!("connect/endpoints=[\"{endpoint}\"]");
        let mut service = Program::echosplat(&[
            "run",
            "--sonar",
            &sonar.url(),
            "--pose",
            "none",
            "--zenoh",
            "mode=\"client\"",
            "--zenoh",
            &connect,
            "--zenoh",
            "listen/endpoints=[]",
            "--zenoh",
            "connect/exit_on_failure=true",
        ]);
        service.wait_for_text(&format!("zenoh reaches nobody at {endpoint}"), LONG);
        service.wait_for_text(why, LONG);
        service.wait_for_text("sonar link is up", LONG);
    }
}
