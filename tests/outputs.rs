//! Standard output and standard error as they are outside of tests: not read, held, closed or full.

use std::fs::{self, File};
use std::io::{PipeReader, Read, Write, pipe};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use echosplat_recording::ply::read_map;

use crate::dive::{file, replay};
use crate::harness::{Program, bus_at, free_port};
use crate::python::python;
use crate::web_client::ask;

const LONG: Duration = Duration::from_secs(60);
/// Longest that an end that was asked for takes.
const END: Duration = Duration::from_secs(15);
/// What a pipe of Linux holds, but for less than a line of the log.
const NEARLY_FULL: usize = 65_536 - 60;

/// Runs in a terminal that holds its output from the first line on (Ctrl-S), asks it to end once it has
/// written a file of its recording, and says its exit code.
const HELD_TERMINAL: &str = r#"
import os, pty, signal, sys, time
folder, command = sys.argv[1], sys.argv[2:]
child, terminal = pty.fork()
if child == 0:
    os.execv(command[0], command)
os.read(terminal, 1)
os.write(terminal, b"\x13")
def wait(what, bound, holds):
    end = time.time() + bound
    while not holds():
        assert time.time() < end, what
        time.sleep(0.05)
recorded = lambda: sum(entry.stat().st_size for entry in os.scandir(folder)) if os.path.isdir(folder) else 0
wait("recording", 60, lambda: recorded() > 500_000)
os.kill(child, signal.SIGTERM)
ended = []
wait("end", 15, lambda: ended.append(os.waitpid(child, os.WNOHANG)) or ended[-1][0] == child)
print(os.waitstatus_to_exitcode(ended[-1][1]))
"#;

/// A running program whose outputs the test keeps to itself; killed when dropped.
struct Unread(Child);

impl Unread {
    fn start(arguments: &[&str], stdout: impl Into<Stdio>, stderr: impl Into<Stdio>) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_echosplat"));
        command.args(arguments).stdin(Stdio::null());
        command.stdout(stdout).stderr(stderr);
        Self(command.spawn().expect("our program starts"))
    }

    fn terminate(&self) {
        let id = self.0.id().to_string();
        let sent = Command::new("kill").args(["-s", "TERM", &id]).status();
        assert!(sent.is_ok_and(|status| status.success()), "kill");
    }

    fn wait_exit(&mut self, bound: Duration) -> ExitStatus {
        let began = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().expect("it is our child") {
                return status;
            }
            assert!(began.elapsed() < bound, "still running after {bound:?}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Unread {
    fn drop(&mut self) {
        // It may have ended already; either way it is gone afterwards.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A pipe that takes no other line; nobody reads it.
fn nearly_full_pipe() -> (PipeReader, Stdio) {
    let (reader, mut writer) = pipe().expect("the system gives pipes");
    writer
        .write_all(&vec![b'x'; NEARLY_FULL])
        .expect("that much fits");
    (reader, writer.into())
}

/// The service with a simulated sonar and its page, and where the page is.
fn service(folder: &Path, more: &[&str]) -> (Vec<String>, u16) {
    let path = |name: &str| folder.join(name).display().to_string();
    let port = free_port();
    let own = ["run", "--sonar", "sim://fence", "--map", &path("map.ply")];
    let web = ["--web".to_owned(), port.to_string()];
    let arguments = own.iter().chain(more).map(ToString::to_string);
    (
        arguments.chain(web).chain(bus_at(free_port())).collect(),
        port,
    )
}

fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < LONG, "{what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A figure of the status; 0 before there is one.
fn metric(port: u16, name: &str) -> f64 {
    let metrics = ask(port, "GET", "/metrics", &[]).text();
    let line = format!("echosplat_{name} ");
    let value = metrics.lines().find_map(|found| found.strip_prefix(&line));
    value.and_then(|value| value.parse().ok()).unwrap_or(0.0)
}

/// Waits until so many pings are in the map.
fn wait_mapped(port: u16, pings: u64) {
    wait_until("a page", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    wait_until("pings in the map", || {
        metric(port, "pings_mapped") >= pings as f64
    });
}

#[test]
fn a_log_that_nobody_reads_stops_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (arguments, port) = service(folder.path(), &["-vv"]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (mut log, stderr) = nearly_full_pipe();
    let mut service = Unread::start(&arguments, Stdio::null(), stderr);
    wait_mapped(port, 100);
    let metrics = ask(port, "GET", "/metrics", &[]).text();
    assert!(
        metrics.contains("echosplat_log_lines_dropped "),
        "{metrics}"
    );
    service.terminate();
    assert_eq!(service.wait_exit(END).code(), Some(0));
    assert!(read_map(&folder.path().join("map.ply")).is_ok());
    let mut held = Vec::new();
    log.read_to_end(&mut held).unwrap();
    assert!(held.len() <= 65_536);
}

#[test]
fn a_terminal_that_is_held_keeps_no_program_from_ending() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("log").display().to_string();
    let (arguments, _) = service(folder.path(), &["--record", &record]);
    let own = [record, env!("CARGO_BIN_EXE_echosplat").to_owned()];
    let all: Vec<String> = own.into_iter().chain(arguments).collect();
    let mut terminal = Program::start(python(&["-c", HELD_TERMINAL], &all));
    terminal.wait_exit_code(0, 2 * LONG);
    // Its last words are not read: that is told as a failure, and the map is there.
    assert_eq!(terminal.stdout().trim(), "1", "{}", terminal.account());
    assert!(read_map(&folder.path().join("map.ply")).is_ok());
}

#[test]
fn last_words_that_nobody_reads_are_waited_for_within_a_bound() {
    let folder = tempfile::tempdir().unwrap();
    let (arguments, port) = service(folder.path(), &[]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (mut log, stderr) = pipe().unwrap();
    let (_unread, stdout) = nearly_full_pipe();
    let mut service = Unread::start(&arguments, stdout, stderr);
    wait_mapped(port, 40);
    service.terminate();
    assert_eq!(service.wait_exit(END).code(), Some(1));
    let mut told = String::new();
    log.read_to_string(&mut told).unwrap();
    let words = "cannot write to standard output: nobody reads it";
    assert!(
        told.contains(words) && told.contains("map written"),
        "{told}"
    );
    assert!(read_map(&folder.path().join("map.ply")).is_ok());
}

/// Commands that say something, and do nothing else that takes long.
fn talkers() -> Vec<Vec<String>> {
    let log = file("dive.svlog");
    let config = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/default.toml");
    [
        &["config"][..],
        &["config", "--basic"],
        &["check", config],
        &["info", &log],
        &["info", &log, "--json"],
        &["completions", "zsh"],
        &["--help"],
        &["--version"],
        &["replay", "--help"],
    ]
    .map(|arguments| arguments.iter().map(ToString::to_string).collect())
    .to_vec()
}

#[test]
fn what_cannot_be_written_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("dive").display().to_string();
    let mut all = talkers();
    all.push(replay(&["--no-publish", "--duration", "0.5", "--json"]));
    all.push(
        ["simulate", "--duration", "1", "--out", &out]
            .map(str::to_owned)
            .to_vec(),
    );
    for arguments in &all {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let full = File::options().write(true).open("/dev/full").unwrap();
        let (mut log, stderr) = pipe().unwrap();
        let mut program = Unread::start(&arguments, full, stderr);
        let code = program.wait_exit(LONG).code();
        let mut told = String::new();
        log.read_to_string(&mut told).unwrap();
        assert_eq!(code, Some(1), "{arguments:?}\n{told}");
        let last = told.lines().last().unwrap_or_default();
        let words = "cannot write to standard output: the disk is full";
        assert!(last.contains(words), "{arguments:?}\n{told}");
    }
}

#[test]
fn a_reader_who_has_enough_is_no_error() {
    for arguments in talkers() {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let (reader, stdout) = pipe().unwrap();
        drop(reader);
        let (mut log, stderr) = pipe().unwrap();
        let mut program = Unread::start(&arguments, stdout, stderr);
        assert_eq!(program.wait_exit(LONG).code(), Some(0), "{arguments:?}");
        let mut told = String::new();
        log.read_to_string(&mut told).unwrap();
        assert_eq!(told, "", "{arguments:?}");
    }
}

/// A reader who comes late has everything all the same.
#[test]
fn a_slow_reader_gets_all_of_it() {
    let (mut late, stdout) = nearly_full_pipe();
    let mut program = Unread::start(&["completions", "zsh"], stdout, Stdio::null());
    std::thread::sleep(Duration::from_millis(1500));
    let mut text = Vec::new();
    late.read_to_end(&mut text).unwrap();
    assert_eq!(program.wait_exit(LONG).code(), Some(0));
    let mut direct = Program::echosplat(&["completions", "zsh"]);
    direct.wait_exit_code(0, LONG);
    assert!(text[NEARLY_FULL..] == *direct.stdout().as_bytes());
}

/// A map and its recording on a disk that is too small for both; needs root, as mounting does.
#[test]
fn a_recording_that_fills_the_disk_leaves_room_for_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = Tmpfs::mount(folder.path(), 2_880_000) else {
        return;
    };
    let path = |name: &str| disk.0.join(name).display().to_string();
    let (map, record) = (path("map.ply"), path("log"));
    let more = ["--no-publish", "--map", &map, "--record", &record];
    let mut program = Program::echosplat(&replay(&more));
    program.wait_exit_code(3, 2 * LONG);
    let told = program.stderr();
    for words in [
        "disk nearly full",
        "the map may need",
        "map written",
        "the recording lacks",
    ] {
        assert!(told.contains(words), "no {words}: {}", program.account());
    }
    let kept = read_map(Path::new(&map)).expect("a whole map");
    assert!(kept.gaussians.len() > 1000, "{}", program.account());
}

/// A disk of limited size; gone when dropped.
struct Tmpfs(std::path::PathBuf);

impl Tmpfs {
    /// Says so and gives `None` where this user cannot have one.
    fn mount(folder: &Path, bytes: u64) -> Option<Self> {
        let path = folder.join("disk");
        fs::create_dir(&path).expect("the folder is writable");
        let size = format!("size={bytes}");
        let mut command = Command::new("mount");
        command
            .args(["-t", "tmpfs", "-o", &size, "tmpfs"])
            .arg(&path);
        let is_mounted = command.output().is_ok_and(|done| done.status.success());
        if !is_mounted {
            crate::browser::say("passed over: a disk of limited size needs root");
        }
        is_mounted.then_some(Self(path))
    }
}

impl Drop for Tmpfs {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).output();
    }
}
