//! A driver on the vehicle and a mapper elsewhere give the map that one process gives, whatever
//! happens to mapper and link meanwhile, and whoever else is under the same router.

use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use echosplat_model::Timestamp;
use echosplat_recording::mcap::{Profile, Record, Recording, RecordingFile, RecordingReader};
use serde_json::{Value, json};

use crate::harness::{Program, free_port, wait_until_listening};
use crate::link::newest_count;
use crate::namespaces::{End, Namespaces};

const LONG: Duration = Duration::from_secs(240);
/// Of the dive, seconds: in less, next to nothing is seen from enough places.
const DIVE_S: &str = "24";

fn setting(setting: String) -> [String; 2] {
    ["--zenoh".to_owned(), setting]
}

fn listen_at(port: u16) -> [String; 2] {
    setting(format!("listen/endpoints=[\"tcp/127.0.0.1:{port}\"]"))
}

fn connect_to(port: u16) -> [String; 2] {
    setting(format!("connect/endpoints=[\"tcp/127.0.0.1:{port}\"]"))
}

fn nowhere(direction: &str) -> [String; 2] {
    setting(format!("{direction}/endpoints=[]"))
}

/// Only at this port, whoever comes.
fn host(port: u16) -> Vec<String> {
    [listen_at(port), nowhere("connect")].concat()
}

/// Only to this port, as soon as somebody is there.
fn guest(port: u16) -> Vec<String> {
    [nowhere("listen"), connect_to(port)].concat()
}

fn run(role: &str, node: &str, bus: &[String], more: &[&str]) -> Program {
    let own = ["run", "--verbose", "--role", role, "--node", node];
    let own = own.iter().chain(more).map(ToString::to_string);
    Program::echosplat(&own.chain(bus.iter().cloned()).collect::<Vec<_>>())
}

fn dive(seed: &str) -> [&str; 6] {
    [
        "--sonar",
        "sim://fence",
        "--seed",
        seed,
        "--duration",
        DIVE_S,
    ]
}

fn driver(node: &str, seed: &str, bus: &[String], more: &[&str]) -> Program {
    run("driver", node, bus, &[&dive(seed)[..], more].concat())
}

fn path(path: &Path) -> &str {
    path.to_str().expect("a path in words")
}

/// Both files of a map.
fn files_of(map: &Path) -> [Vec<u8>; 2] {
    let files = [map.to_owned(), map.with_extension("ambiguous.ply")];
    files.map(|file| fs::read(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display())))
}

fn assert_same(map: &Path, reference: &Path, who: &Program) {
    let [asserted, ambiguous] = files_of(map);
    let [as_asserted, as_ambiguous] = files_of(reference);
    let same = asserted == as_asserted && ambiguous == as_ambiguous;
    let lengths = [&asserted, &as_asserted, &ambiguous, &as_ambiguous].map(Vec::len);
    assert!(same, "another map, of {lengths:?} bytes\n{}", who.account());
}

/// The map that one process makes of the dive with this seed.
fn of_one_process(seed: &'static str) -> &'static Path {
    static MAPS: [OnceLock<PathBuf>; 2] = [OnceLock::new(), OnceLock::new()];
    MAPS[usize::from(seed == "2")].get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("roles");
        fs::create_dir_all(&folder).expect("a folder for maps");
        let map = folder.join(format!("one-{seed}.ply"));
        let more = [&dive(seed)[..], &["--map", path(&map)]].concat();
        let mut program = run("all", "one", &host(free_port()), &more);
        program.wait_exit_code(0, LONG);
        assert!(files_of(&map)[0].len() > 10_000, "{}", program.account());
        map
    })
}

#[test]
fn driver_and_mapper_give_the_map_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply");
    let port = free_port();
    let mut mapper = run("mapper", "rov", &host(port), &["--map", path(&map)]);
    mapper.wait_for_text("waiting for the driver", LONG);
    let mut driver = driver("rov", "1", &guest(port), &[]);
    driver.wait_exit_code(0, LONG);
    mapper.wait_exit_code(0, LONG);
    assert_same(&map, of_one_process("1"), &mapper);
    let account = driver.stdout();
    assert!(account.contains(" 0 that a mapper missed"), "{account}");
}

/// The recording that a program writes into a folder.
fn only_file(folder: &Path) -> PathBuf {
    let mut files = fs::read_dir(folder)
        .expect("the folder is there")
        .flatten()
        .map(|e| e.path());
    files
        .find(|file| file.extension().is_some_and(|end| end == "mcap"))
        .expect("a recording")
}

#[test]
fn a_mapper_that_is_killed_in_mid_dive_goes_on_from_its_recording() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply");
    let record = folder.path().join("recordings");
    let port = free_port();
    let mut driver = driver("rov", "1", &host(port), &[]);
    wait_until_listening(&mut driver, port);
    // Late, so that the driver's memory has the beginning.
    driver.wait_for("some of the dive", LONG, |driver| {
        newest_count(&driver.stderr(), "pings_heard").filter(|&count| count > 100)
    });
    let mut first = run("mapper", "rov", &guest(port), &["--record", path(&record)]);
    first.wait_for("a part of the map", LONG, |first| {
        newest_count(&first.stderr(), "pings_mapped").filter(|&count| count > 300)
    });
    drop(first);
    let recording = only_file(&record);
    let more = ["--resume", path(&recording), "--map", path(&map)];
    let mut second = run("mapper", "rov", &guest(port), &more);
    second.wait_for_text("the recording is read; going on with record", LONG);
    driver.wait_exit_code(0, LONG);
    second.wait_exit_code(0, LONG);
    assert_same(&map, of_one_process("1"), &second);
}

#[test]
fn a_mapper_that_starts_late_goes_on_from_the_drivers_recording() {
    let folder = tempfile::tempdir().unwrap();
    let (map, replayed) = (
        folder.path().join("map.ply"),
        folder.path().join("replayed.ply"),
    );
    let record = folder.path().join("recordings");
    let port = free_port();
    let mut driver = driver("rov", "1", &host(port), &["--record", path(&record)]);
    wait_until_listening(&mut driver, port);
    driver.wait_for("some of the dive", LONG, |driver| {
        newest_count(&driver.stderr(), "pings_heard").filter(|&count| count > 200)
    });
    let recording = only_file(&record);
    let copy = folder.path().join("copy.mcap");
    fs::copy(&recording, &copy).unwrap();
    let more = ["--resume", path(&copy), "--map", path(&map)];
    let mut mapper = run("mapper", "rov", &guest(port), &more);
    driver.wait_exit_code(0, LONG);
    mapper.wait_exit_code(0, LONG);
    assert_same(&map, of_one_process("1"), &mapper);

    let arguments = ["replay", path(&recording), "--map", path(&replayed)];
    let mut replay = Program::echosplat(&arguments);
    replay.wait_exit_code(0, LONG);
    assert_same(&replayed, of_one_process("1"), &replay);
}

/// Copies a recording, with these events at its end.
fn copy_with(recording: &Path, copy: &Path, events: &[Value]) {
    let mut reader = RecordingReader::open(&[recording]).expect("a recording");
    let mut file = RecordingFile::create(copy, "map", Profile::Full).expect("there is room");
    let mut write = |time, record: &Record| {
        let written = file.writer().write(time, record);
        written.expect("there is room");
    };
    let mut last = Timestamp::ZERO;
    while let Some(message) = reader.next_message().expect("it can be read") {
        last = message.host_time;
        write(last, &message.record);
    }
    for event in events {
        write(last, &Record::Event(event.clone()));
    }
    file.finish().expect("there is room");
}

#[test]
fn a_mapper_that_resumes_gives_up_what_its_recording_says_it_did() {
    let folder = tempfile::tempdir().unwrap();
    let [resumed, replayed, record, of_driver] =
        ["resumed.ply", "replayed.ply", "mapper", "driver"].map(|name| folder.path().join(name));
    let port = free_port();
    let mut driver = driver("rov", "1", &host(port), &["--record", path(&of_driver)]);
    wait_until_listening(&mut driver, port);
    driver.wait_for("some of the dive", LONG, |driver| {
        newest_count(&driver.stderr(), "pings_heard").filter(|&count| count > 300)
    });
    let copy = folder.path().join("copy.mcap");
    let events = [
        json!({ "event": "ping_shed", "ping": 40, "through": 140 }),
        json!({ "event": "work_shed", "ping": 150, "is_shed": true }),
    ];
    copy_with(&only_file(&of_driver), &copy, &events);
    let more = ["--resume", path(&copy), "--map", path(&resumed)];
    let more = [&more[..], &["--record", path(&record)]].concat();
    let mut mapper = run("mapper", "rov", &guest(port), &more);
    driver.wait_exit_code(0, LONG);
    // One ping in ten is missing in the map.
    mapper.wait_exit_code(3, LONG);

    let own = only_file(&record);
    let arguments = [
        "replay",
        path(&copy),
        path(&own),
        "--map",
        path(&replayed),
        "--json",
    ];
    let mut replay = Program::echosplat(&arguments);
    replay.wait_exit_code(3, LONG);
    assert_same(&resumed, &replayed, &mapper);
    let told = work_shed_in(&own);
    assert!(told.len() == 1 && told[0]["is_shed"] == false, "{told:?}");
    let summary = replay.only_json();
    assert_eq!(summary["ledger"]["shed"], 101, "{summary}");
}

#[test]
fn a_mapper_that_is_behind_puts_off_work_and_its_recording_gives_its_map() {
    let folder = tempfile::tempdir().unwrap();
    let [map, replayed, record, config] =
        ["map.ply", "replayed.ply", "mapper", "short.toml"].map(|name| folder.path().join(name));
    fs::write(&config, "[pipeline]\nqueue_pings = 8\n").unwrap();
    let (port, sonar_port) = (free_port(), free_port());
    let sonar = format!("tcp://127.0.0.1:{sonar_port}");
    let mut driver = run("driver", "rov", &host(port), &["--sonar", &sonar]);
    wait_until_listening(&mut driver, port);
    let _emulated = emulated(&sonar, port);
    driver.wait_for("some of the dive", LONG, |driver| {
        newest_count(&driver.stderr(), "pings_heard").filter(|&count| count > 200)
    });
    let more = ["--map", path(&map), "--record", path(&record)];
    let more = [&more[..], &["--config", path(&config)]].concat();
    let mut mapper = run("mapper", "rov", &guest(port), &more);
    mapper.wait_for("pings in the map", LONG, |mapper| {
        newest_count(&mapper.stderr(), "pings_mapped").filter(|&count| count > 300)
    });
    driver.interrupt();
    driver.wait_exit(LONG);
    let code = mapper.wait_exit(LONG).code();
    assert!(matches!(code, Some(0 | 3)), "{}", mapper.account());

    let own = only_file(&record);
    let told = work_shed_in(&own);
    assert!(!told.is_empty() && told[0]["is_shed"] == true, "{told:?}");
    let arguments = ["replay", path(&own), "--map", path(&replayed)];
    let mut replay = Program::echosplat(&arguments);
    let code = replay.wait_exit(LONG).code();
    assert!(matches!(code, Some(0 | 3)), "{}", replay.account());
    assert_same(&map, &replayed, &mapper);
}

/// What a recording says of work put off, and done again.
fn work_shed_in(recording: &Path) -> Vec<Value> {
    let scan = Recording::scan(&[recording]).expect("a recording");
    let events = scan.events.into_iter().map(|(_, event)| event);
    events
        .filter(|event| event["event"] == "work_shed")
        .collect()
}

/// A tether that can be cut: passes bytes on, and ends all that it passes on.
struct Tether {
    is_cut: Arc<AtomicBool>,
    port: u16,
}

impl Tether {
    fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let own_port = listener.local_addr().expect("it is bound").port();
        let is_cut = Arc::new(AtomicBool::new(false));
        let cut = Arc::clone(&is_cut);
        std::thread::spawn(move || {
            for near in listener.incoming().flatten() {
                let far = TcpStream::connect(("127.0.0.1", port));
                let Some(far) = far.ok().filter(|_| !cut.load(Ordering::Relaxed)) else {
                    continue;
                };
                let ends = (
                    near.try_clone().expect("a second handle"),
                    far.try_clone().expect("a second handle"),
                );
                pass_on(near, far, Arc::clone(&cut));
                pass_on(ends.1, ends.0, Arc::clone(&cut));
            }
        });
        Self {
            is_cut,
            port: own_port,
        }
    }

    fn cut(&self, is_cut: bool) {
        self.is_cut.store(is_cut, Ordering::Relaxed);
    }
}

fn pass_on(mut from: TcpStream, mut to: TcpStream, cut: Arc<AtomicBool>) {
    from.set_read_timeout(Some(Duration::from_millis(20)))
        .expect("a limit of more than 0");
    std::thread::spawn(move || {
        let mut block = [0; 16_384];
        while !cut.load(Ordering::Relaxed) {
            match from.read(&mut block) {
                Ok(0) => break,
                Ok(count) if to.write_all(&block[..count]).is_err() => break,
                Err(error) if error.kind() != std::io::ErrorKind::WouldBlock => break,
                _ => {}
            }
        }
        let _ = from.shutdown(std::net::Shutdown::Both);
        let _ = to.shutdown(std::net::Shutdown::Both);
    });
}

#[test]
fn what_is_heard_while_the_link_is_cut_comes_afterwards() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply");
    let port = free_port();
    let tether = Tether::to(port);
    let mut driver = driver("rov", "1", &host(port), &[]);
    wait_until_listening(&mut driver, port);
    let mut mapper = run("mapper", "rov", &guest(tether.port), &["--map", path(&map)]);
    mapper.wait_for("a part of the map", LONG, |mapper| {
        newest_count(&mapper.stderr(), "pings_mapped").filter(|&count| count > 100)
    });
    tether.cut(true);
    mapper.wait_for_text("the driver has not answered", LONG);
    let heard = newest_count(&driver.stderr(), "pings_heard").unwrap();
    driver.wait_for("more of the dive", LONG, |driver| {
        newest_count(&driver.stderr(), "pings_heard").filter(|&count| count > heard + 80)
    });
    tether.cut(false);
    driver.wait_exit_code(0, LONG);
    mapper.wait_exit_code(0, LONG);
    assert_same(&map, of_one_process("1"), &mapper);
}

#[test]
fn vehicles_under_one_router_have_each_their_own_map() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let mode = |mode: &str| setting(format!("mode=\"{mode}\""));
    let router = [host(port), mode("router").to_vec()].concat();
    let watch = ["watch", "--node", "nobody"].map(str::to_owned);
    let mut router = Program::echosplat(&[watch.to_vec(), router].concat());
    wait_until_listening(&mut router, port);
    let client = [guest(port), mode("client").to_vec()].concat();
    let split = [("rov-1", "1"), ("rov-2", "2")].map(|(node, seed)| {
        let map = folder.path().join(format!("{node}.ply"));
        let mapper = run("mapper", node, &client, &["--map", path(&map)]);
        (driver(node, seed, &client, &[]), mapper, map, seed)
    });
    let whole = [("rov-3", "1"), ("rov-4", "2")].map(|(node, seed)| {
        let map = folder.path().join(format!("{node}.ply"));
        let more = [&dive(seed)[..], &["--map", path(&map)]].concat();
        (run("all", node, &client, &more), map, seed)
    });
    for (mut driver, mut mapper, map, seed) in split {
        driver.wait_exit_code(0, LONG);
        mapper.wait_exit_code(0, LONG);
        assert_same(&map, of_one_process(seed), &mapper);
    }
    for (mut program, map, seed) in whole {
        program.wait_exit_code(0, LONG);
        assert_same(&map, of_one_process(seed), &program);
    }
    assert_ne!(files_of(of_one_process("1")), files_of(of_one_process("2")));
}

#[test]
fn two_network_namespaces_and_ten_megabits_give_the_map_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply");
    let Some(namespaces) = Namespaces::with_link_of("10mbit") else {
        return;
    };
    let run = ["run", "--verbose", "--node", "rov"];
    let mapper = ["--role", "mapper", "--map", path(&map)];
    let mapper = [&run[..], &mapper, &Namespaces::guest()].concat();
    let mut mapper = namespaces.echosplat(End::Shore, &mapper);
    let driver = [
        &run[..],
        &["--role", "driver"],
        &dive("1"),
        &Namespaces::host(),
    ]
    .concat();
    let mut driver = namespaces.echosplat(End::Vehicle, &driver);
    driver.wait_exit_code(0, LONG);
    mapper.wait_exit_code(0, LONG);
    assert_same(&map, of_one_process("1"), &mapper);
    let account = driver.stdout();
    assert!(account.contains(" 0 that a mapper missed"), "{account}");
}

/// A sonar at this address, on the host's clock, and its poses.
fn emulated(sonar: &str, port: u16) -> Program {
    let emulate = [
        "emulate",
        "--publish-poses",
        "--node",
        "rov",
        "--listen",
        sonar,
    ];
    let emulate = emulate.map(str::to_owned).to_vec();
    let mut emulated = Program::echosplat(&[emulate, guest(port)].concat());
    emulated.wait_for_text("listening on", LONG);
    emulated
}

#[test]
fn the_map_goes_on_where_the_driver_was_killed_and_started_again() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply");
    let (port, sonar_port) = (free_port(), free_port());
    let sonar = format!("tcp://127.0.0.1:{sonar_port}");
    let start = || {
        let mut driver = run("driver", "rov", &host(port), &["--sonar", &sonar]);
        wait_until_listening(&mut driver, port);
        driver
    };
    let first = start();
    let _emulated = emulated(&sonar, port);
    let mut mapper = run("mapper", "rov", &guest(port), &["--map", path(&map)]);
    let mut wait_mapped_beyond = |count| {
        mapper.wait_for("more pings in the map", LONG, |mapper| {
            newest_count(&mapper.stderr(), "pings_mapped").filter(|&mapped| mapped > count)
        })
    };
    let mapped = wait_mapped_beyond(100);
    drop(first);
    let _second = start();
    wait_mapped_beyond(mapped + 100);
    let told = mapper.stderr();
    assert!(
        told.contains("the driver was started again; the map goes on"),
        "{told}"
    );
    mapper.interrupt();
    let code = mapper.wait_exit(LONG).code();
    assert!(matches!(code, Some(0 | 3)), "{}", mapper.account());
}

#[test]
fn what_the_other_role_does_is_refused_by_name() {
    for (role, option, whose) in [
        ("driver", "--map", "mapper"),
        ("mapper", "--sonar", "driver"),
        ("all", "--resume", "mapper"),
    ] {
        let mut program = run(role, "rov", &host(free_port()), &[option, "x"]);
        program.wait_exit_code(2, LONG);
        let told = program.stderr();
        assert!(
            told.contains(&format!("{option} is for --role {whose}")),
            "{told}"
        );
    }
    let file = crate::dive::file("dive.svlog");
    let mut program = run("mapper", "rov", &host(free_port()), &["--resume", &file]);
    program.wait_exit_code(2, LONG);
    assert!(
        program.stderr().contains("--resume"),
        "{}",
        program.account()
    );
}
