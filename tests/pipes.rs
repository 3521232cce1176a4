//! Files that are none: named pipes that somebody writes to, those that nobody does, and devices.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::thread::JoinHandle;
use std::time::Duration;

use crate::dive::file;
use crate::harness::{Program, bus_at, free_port};

const LONG: Duration = Duration::from_secs(120);
/// Longest that an end that was asked for takes.
const END: Duration = Duration::from_secs(15);

fn named_pipe(path: &Path) -> String {
    let made = Command::new("mkfifo").arg(path).status();
    assert!(made.is_ok_and(|status| status.success()), "mkfifo");
    path.display().to_string()
}

/// Every argument that is read once, in place of `FILE`, and `None` or what is written there to make it
/// right.
fn readers() -> Vec<(Vec<String>, Vec<u8>)> {
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));
    let trajectory = fs::read(&poses).expect("the dive has poses");
    let bus = bus_at(free_port());
    let [flag, listen, _, connect] = &bus;
    let replay = ["replay", &log, "--no-publish", "--duration", "2"];
    let with_poses = [&replay[..], &["--poses", &poses]].concat();
    let cases: [(Vec<&str>, &[u8]); 7] = [
        ([&replay[..], &["--poses", "FILE"]].concat(), &trajectory),
        (
            [&replay[..], &["--pose", "tum://FILE"]].concat(),
            &trajectory,
        ),
        (
            [&with_poses[..], &["--config", "FILE"]].concat(),
            b"[mapper]\nthreads = 1\n",
        ),
        (
            [&with_poses[..], &["--truth", "FILE"]].concat(),
            b"0 0 0\n1 1 1\n",
        ),
        (vec!["check", "FILE"], b"[mapper]\nthreads = 1\n"),
        (
            vec![
                "run",
                "--sonar",
                "sim://fence",
                "--duration",
                "1",
                "--zenoh-config",
                "FILE",
                flag,
                listen,
                flag,
                connect,
            ],
            b"{ mode: 'peer' }",
        ),
        (
            vec![
                "simulate",
                "--duration",
                "1",
                "--out",
                "OUT",
                "--scene",
                "FILE",
            ],
            b"name = \"ball\"\n[[sphere]]\ncenter_m = [4, 0, -3]\nradius_m = 1\n",
        ),
    ];
    let owned = |words: &[&str]| words.iter().map(ToString::to_string).collect();
    cases
        .iter()
        .map(|(words, text)| (owned(words), text.to_vec()))
        .collect()
}

fn filled(arguments: &[String], folder: &Path, path: &str) -> Vec<String> {
    let out = folder.join("out").display().to_string();
    let filled = |word: &String| word.replace("FILE", path).replace("OUT", &out);
    arguments.iter().map(filled).collect()
}

/// Writes it once somebody reads.
fn writing(path: &str, text: Vec<u8>) -> JoinHandle<()> {
    let path = path.to_owned();
    std::thread::spawn(move || {
        // Whoever reads may have enough before the end.
        let _ = fs::write(path, text);
    })
}

#[test]
fn a_pipe_is_read_like_a_file() {
    for (arguments, text) in readers() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = named_pipe(&folder.path().join("pipe"));
        let writer = writing(&pipe, text);
        let mut program = Program::echosplat(&filled(&arguments, folder.path(), &pipe));
        program.wait_exit_code(0, LONG);
        writer.join().unwrap();
    }
}

#[test]
fn a_pipe_that_nobody_writes_to_keeps_no_program_from_ending() {
    for (arguments, _) in readers() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = named_pipe(&folder.path().join("pipe"));
        let mut program = Program::echosplat(&filled(&arguments, folder.path(), &pipe));
        program.wait_for_text(&format!("waiting for the pipe {pipe}"), LONG);
        program.terminate();
        let status = program.wait_exit(END);
        // By the signal, where nothing has begun yet.
        assert!(
            matches!(status.code(), None | Some(1)),
            "{}",
            program.account()
        );
        assert!(
            !program.stderr().contains("panicked"),
            "{}",
            program.account()
        );
    }
}

#[test]
fn a_device_is_refused_and_never_read() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, _) in readers() {
        let arguments = filled(&arguments, folder.path(), "/dev/zero");
        let mut program = Program::echosplat(&arguments);
        program.wait_exit_code(2, LONG);
        let told = program.stderr();
        let last = told.lines().last().unwrap_or_default();
        assert!(
            last.contains("/dev/zero") && last.contains("it is a device"),
            "{told}"
        );
    }
}

/// A pipe can be read once: who reads a file more often says so.
#[test]
fn logs_and_maps_are_no_pipes() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = named_pipe(&folder.path().join("pipe"));
    let out = folder.path().join("map.npz").display().to_string();
    for arguments in [
        &["info", &pipe][..],
        &["recover", &pipe],
        &["replay", &pipe, "--poses", "none.tum"],
        &[
            "run",
            "--sonar",
            &format!("file://{pipe}"),
            "--pose",
            "none",
        ],
        &["evaluate", &pipe, "--truth", "fence"],
        &["export", &pipe, &out],
        &["render", &pipe, "--poses", "none.tum", "--json"],
    ] {
        let mut program = Program::echosplat(arguments);
        program.wait_exit_code(2, LONG);
        let told = program.stderr();
        assert!(
            told.contains(&pipe) && told.contains("regular file"),
            "{told}"
        );
    }
}
