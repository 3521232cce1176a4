//! Parts of the service that panic or hang, as a drill asks: it is told, the part is begun again or
//! the run ends, and map and recording are whole either way. And what systemd is told of it.

use std::fs;
use std::net::TcpListener;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use echosplat_recording::mcap::{Ending, Record, Recording, RecordingReader};
use echosplat_recording::ply;
use tempfile::TempDir;

use crate::fake_sonar::{FakeSonar, FakeVehicle, now, pose_at, profile};
use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::link::newest_count;

const LONG: Duration = Duration::from_secs(60);
/// Longest that an end that was asked for takes; a run is ended at once after 10 s and 3 s of saving.
const END: Duration = Duration::from_secs(15);
/// As the services here are configured.
const HANG_LIMIT_S: f64 = 2.0;

/// A service that maps and records a sonar with poses, where one part has a drill.
struct Drilled {
    service: Program,
    folder: TempDir,
    _sonar: FakeSonar,
    _vehicle: FakeVehicle,
    systemd: Systemd,
}

/// systemd's side: what it was told, read by a thread so that the service never finds it full.
struct Systemd {
    told: Arc<Mutex<String>>,
    is_over: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl Systemd {
    fn listening(path: &Path) -> Self {
        let socket = UnixDatagram::bind(path).expect("a socket can be made");
        let wait = Some(Duration::from_millis(20));
        socket.set_read_timeout(wait).expect("a socket");
        let (told, is_over) = (Arc::new(Mutex::new(String::new())), Arc::default());
        let (sink, ends) = (Arc::clone(&told), Arc::clone(&is_over));
        let reader = std::thread::spawn(move || {
            let mut message = [0; 4096];
            while !AtomicBool::load(&ends, Ordering::Relaxed) {
                if let Ok(count) = socket.recv(&mut message) {
                    let text = String::from_utf8_lossy(&message[..count]);
                    *sink.lock().expect("no reader panics") += &text;
                }
            }
        });
        Self {
            told,
            is_over,
            reader: Some(reader),
        }
    }

    /// What it was told since it was last asked.
    fn told(&self) -> String {
        std::mem::take(&mut *self.told.lock().expect("no reader panics"))
    }
}

impl Drop for Systemd {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(reader) = self.reader.take() {
            let _ = reader.join();
        }
    }
}

impl Drilled {
    /// `drill` is the part and what befalls it, as in `mapper:hang`; poses come over the bus unless
    /// `more` says otherwise. Returns once pings are mapped, or at once without poses of the bus.
    fn start(drill: &str, more: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let path = |name: &str| folder.path().join(name).display().to_string();
        let settings =
            format!("[bus]\nros_domain_id = 0\n[pipeline]\nhang_limit_s = {HANG_LIMIT_S:?}\n");
        fs::write(path("my.toml"), settings).expect("the folder is writable");
        let systemd = Systemd::listening(&folder.path().join("notify"));
        let sonar = FakeSonar::start(|i| profile(i, |_| {}));
        let (port, url) = (free_port(), sonar.url());
        let bus = bus_at(port);
        let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
        let (map, record, config) = (path("map.ply"), path("log"), path("my.toml"));
        let own = ["run", "--verbose", "--sonar", &url, "--map", &map];
        let files = ["--record", &record, "--config", &config];
        let mut command = Command::new(env!("CARGO_BIN_EXE_echosplat"));
        command.args([&own[..], &files, &bus, more].concat());
        command.env("ECHOSPLAT_DRILL", format!("{drill}:{}", path("now")));
        command.env("NOTIFY_SOCKET", path("notify"));
        command.env("WATCHDOG_USEC", "3000000");
        let mut service = Program::start(command);
        wait_until_listening(&mut service, port);
        let vehicle = FakeVehicle::start(port, |seconds| Some(pose_at(now(), seconds)));
        let mut drilled = Self {
            service,
            folder,
            _sonar: sonar,
            _vehicle: vehicle,
            systemd,
        };
        if more.is_empty() {
            drilled.wait_mapped(40);
        }
        drilled
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The drill begins.
    fn begin(&self) {
        fs::write(self.path("now"), "").expect("the folder is writable");
    }

    /// Waits until it has begun.
    fn wait_begun(&mut self) {
        self.wait_told("the drill begins: the part `mapper` hangs");
    }

    /// Waits until so many more pings are in the map.
    fn wait_mapped(&mut self, more: u64) {
        let mapped = |service: &Program| newest_count(&service.stderr(), "pings_mapped");
        let before = mapped(&self.service).unwrap_or(0);
        self.service
            .wait_for("more pings in the map", LONG, |service| {
                mapped(service).filter(|&count| count >= before + more)
            });
    }

    fn wait_told(&mut self, words: &str) {
        self.service.wait_for_text(words, LONG);
    }

    /// Asked to end, it ends in time with this code, map and recording whole.
    fn ends_when_asked(mut self, code: i32, ending: Ending) {
        self.service.terminate();
        self.ends(code, ending);
    }

    fn ends(&mut self, code: i32, ending: Ending) {
        self.service.wait_exit_code(code, END + LONG);
        self.is_whole(ending);
    }

    /// The map is there and can be read, and so can every file of the recording; `ending` is that
    /// of the last.
    fn is_whole(&self, ending: Ending) {
        let account = || self.service.account();
        let map = ply::read_map(&self.path("map.ply"));
        assert!(map.is_ok(), "{map:?}\n{}", account());
        let entries = fs::read_dir(self.path("log"))
            .expect("a recording")
            .flatten();
        let mut files: Vec<_> = entries.map(|entry| entry.path()).collect();
        files.sort();
        let scan = Recording::scan(&files).expect("every file can be read");
        assert!(scan.counts.raw_bytes > 40 * 1200, "{:?}", scan.counts);
        assert!(!scan.poses.is_empty(), "{}", account());
        let last = files.pop().expect("a file");
        let mut reader = RecordingReader::open(&[last]).expect("it is a recording");
        while reader.next_message().expect("it can be read").is_some() {}
        assert_eq!(reader.ending(), Some(ending), "{}", account());
    }
}

#[test]
fn a_service_that_was_stopped_goes_on() {
    let mut drilled = Drilled::start("mapper:hang", &[]);
    drilled
        .service
        .stop_for(Duration::from_secs_f64(2.5 * HANG_LIMIT_S));
    drilled.wait_mapped(40);
    let told = drilled.service.stderr();
    assert!(
        !told.contains("has hung") && !told.contains("has not come back"),
        "{told}"
    );
    // A part that hangs after it is found as ever.
    drilled.begin();
    drilled.wait_told("the part `mapper` has not come back from its work");
    drilled.ends(1, Ending::Complete);
}

#[test]
fn a_source_that_panics_is_begun_again() {
    for part in ["sonar", "poses"] {
        let mut drilled = Drilled::start(&format!("{part}:panic"), &[]);
        drilled.begin();
        drilled.wait_told(&format!("the part `{part}` failed (a drill"));
        drilled.wait_mapped(80);
        drilled.ends_when_asked(3, Ending::Complete);
    }
}

#[test]
fn a_sonar_that_hangs_is_replaced() {
    let mut drilled = Drilled::start("sonar:hang", &[]);
    drilled.begin();
    drilled.wait_told("the part `sonar` hung, and another has taken its place");
    drilled.wait_mapped(80);
    drilled.ends_when_asked(3, Ending::Complete);
}

/// A DVL that takes connections and says nothing.
#[test]
fn a_link_to_a_vehicle_that_panics_or_hangs_is_made_again() {
    let what = ["failed (a drill", "hung, and another"];
    for (drill, words) in ["poses:panic", "poses:hang"].into_iter().zip(what) {
        let dvl = TcpListener::bind("127.0.0.1:0").expect("loopback has free ports");
        let url = format!("dvl://{}", dvl.local_addr().expect("it is bound"));
        let mut drilled = Drilled::start(drill, &["--pose", &url]);
        let first = dvl.accept();
        drilled.begin();
        drilled.wait_told(&format!("the part `poses` {words}"));
        let second = dvl.accept();
        assert!(first.is_ok() && second.is_ok());
        drilled.service.terminate();
        drilled.service.wait_exit_code(3, END);
    }
}

#[test]
fn what_only_publishes_costs_the_map_nothing() {
    let drills = [
        "bus-map:panic",
        "bus-map:hang",
        "bus-pings:panic",
        "bus-pings:hang",
        "bus-ros:panic",
        "bus-ros:hang",
    ];
    for drill in drills.into_iter().chain(["recorder-sync:panic"]) {
        let mut drilled = Drilled::start(drill, &[]);
        drilled.begin();
        let (part, fault) = drill.split_once(':').expect("two words");
        drilled.wait_told(&match fault {
            "panic" => format!("the part `{part}` failed (a drill"),
            _ => format!("the part `{part}` has not come back from its work"),
        });
        drilled.wait_mapped(40);
        assert!(drilled.systemd.told().contains("WATCHDOG=1"), "{drill}");
        drilled.ends_when_asked(0, Ending::Complete);
    }
}

#[test]
fn a_recorder_that_panics_goes_on_in_a_new_file() {
    let mut drilled = Drilled::start("recorder:panic", &[]);
    drilled.begin();
    drilled.wait_told("the part `recorder` failed (a drill");
    drilled.wait_mapped(40);
    let files = fs::read_dir(drilled.path("log")).expect("a recording");
    assert_eq!(files.count(), 2, "{}", drilled.service.account());
    drilled.ends_when_asked(3, Ending::Complete);
}

#[test]
fn a_recorder_that_hangs_ends_the_run() {
    let mut drilled = Drilled::start("recorder:hang", &[]);
    drilled.begin();
    drilled.wait_told("the part `recorder` has not come back from its work");
    drilled.ends(1, Ending::Cut);
}

#[test]
fn a_mapper_that_panics_ends_the_run() {
    let mut drilled = Drilled::start("mapper:panic", &[]);
    drilled.begin();
    drilled.ends(1, Ending::Complete);
    let stderr = drilled.service.stderr();
    assert!(
        stderr.contains("the part `mapper` failed: a drill"),
        "{stderr}"
    );
}

#[test]
fn a_mapper_that_hangs_ends_the_run_and_is_no_longer_vouched_for() {
    let mut drilled = Drilled::start("mapper:hang", &[]);
    let told = drilled.systemd.told();
    let words = ["READY=1\n", "WATCHDOG=1\n", "STATUS=", " pings in the map"];
    for words in words {
        assert!(told.contains(words), "{words} is not in {told}");
    }
    drilled.begin();
    let began = Instant::now();
    drilled.ends(1, Ending::Complete);
    let took_s = began.elapsed().as_secs_f64();
    let told = drilled.systemd.told();
    assert!(told.contains("STOPPING=1\n"), "{told}");
    let feeds = told.matches("WATCHDOG=1").count();
    assert!(
        feeds <= 3,
        "fed {feeds} times in {took_s} s while the mapper hung"
    );
    let stderr = drilled.service.stderr();
    let words = "the part `mapper` has not come back from its work for 2 s";
    assert!(stderr.contains(words), "{stderr}");
    println!("a hung mapper: {took_s:.1} s from its last beat to the end of the program");
}

#[test]
fn who_watches_over_the_others_is_watched_too() {
    let mut drilled = Drilled::start("run:hang", &[]);
    drilled.begin();
    drilled.wait_told("the thread that watches over the run has hung for 2 s");
    drilled.ends(1, Ending::Complete);
}

#[test]
fn a_panic_of_who_watches_over_the_others_ends_the_run() {
    let mut drilled = Drilled::start("run:panic", &[]);
    drilled.begin();
    drilled.ends(1, Ending::Complete);
    let stderr = drilled.service.stderr();
    assert!(stderr.contains("the part `run` failed"), "{stderr}");
}

#[test]
fn one_request_ends_a_run_whose_mapper_hangs() {
    let mut drilled = Drilled::start("mapper:hang", &[]);
    drilled.begin();
    drilled.wait_begun();
    let began = Instant::now();
    drilled.service.terminate();
    let status = drilled.service.wait_exit(END);
    assert!(status.code().is_some_and(|code| code != 2), "{status}");
    drilled.is_whole(Ending::Complete);
    println!(
        "asked to end with a hung mapper: {:.1} s",
        began.elapsed().as_secs_f64()
    );
}

#[test]
fn a_second_request_ends_at_once_with_map_and_recording() {
    let mut drilled = Drilled::start("mapper:hang", &[]);
    drilled.begin();
    drilled.wait_begun();
    drilled.service.terminate();
    std::thread::sleep(Duration::from_millis(1_200));
    drilled.service.terminate();
    let began = Instant::now();
    drilled.ends(128 + 15, Ending::Complete);
    println!(
        "asked twice with a hung mapper: {:.1} s",
        began.elapsed().as_secs_f64()
    );
}

/// What is said of a drill that cannot be.
fn refused(drill: &str) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_echosplat"));
    command.args(["run", "--sonar", "tcp://127.0.0.1:1", "--pose", "none"]);
    command
        .args(bus_at(free_port()))
        .env("ECHOSPLAT_DRILL", drill);
    let mut program = Program::start(command);
    program.wait_exit_code(2, LONG);
    program.stderr()
}

#[test]
fn a_drill_that_is_none_is_refused() {
    let said = refused("mapper");
    assert!(said.contains("mapper:hang:/tmp/now"), "{said}");
    let said = refused("maper:hang:/tmp/now");
    assert!(
        said.contains("`maper`") && said.contains(" mapper, "),
        "{said}"
    );
}

#[test]
fn a_drill_is_told_and_leaves_the_file_and_every_part_can_have_one() {
    let mut drilled = Drilled::start("poses:panic", &[]);
    drilled.wait_told("a drill is armed (ECHOSPLAT_DRILL): the part `poses` panics once");
    fs::write(drilled.path("now"), "precious").expect("the folder is writable");
    drilled.wait_told("the drill begins: the part `poses` panics");
    drilled.wait_told("the part `poses` failed (a drill");
    drilled.wait_mapped(40);
    drilled.service.terminate();
    drilled.service.wait_exit_code(3, END);
    let kept = fs::read_to_string(drilled.path("now")).expect("it is left alone");
    assert_eq!(kept, "precious");

    let entries = fs::read_dir(drilled.path("log")).expect("a recording");
    let files: Vec<_> = entries.flatten().map(|entry| entry.path()).collect();
    let mut reader = RecordingReader::open(&files).expect("it is a recording");
    let known = refused("nobody:hang:/tmp/now");
    let mut last = None;
    while let Some(recorded) = reader.next_message().expect("it can be read") {
        if let Record::Status(status) = recorded.record {
            last = Some(status);
        }
    }
    let status = last.expect("a status a second");
    let armed = status["drill"].as_str().unwrap_or_default();
    assert!(armed.contains("the part `poses` panics once"), "{status}");
    let parts = status["parts"].as_array().expect("a list");
    assert!(parts.len() > 8, "{parts:?}");
    for part in parts {
        let name = part["name"].as_str().expect("a name");
        assert!(known.contains(name), "{name} is not in {known}");
    }
}
