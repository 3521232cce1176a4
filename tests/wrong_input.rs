//! Whatever is asked for wrongly gets one line that says so, and its exit code.

use std::fs;
use std::net::TcpListener;
use std::time::Duration;

use crate::dive::file;
use crate::harness::Program;

const SHORT: Duration = Duration::from_secs(60);

/// One line on standard error that holds `words`, nothing on standard output, exit code 2.
fn refused(arguments: &[&str], words: &[&str]) {
    let mut program = Program::echosplat(arguments);
    program.wait_exit_code(2, SHORT);
    let said = program.stderr();
    let account = program.account();
    assert_eq!(said.lines().count(), 1, "{account}");
    for word in words {
        assert!(said.contains(word), "no {word:?}\n{account}");
    }
    assert!(
        !said.contains("panicked") && !said.contains("backtrace"),
        "{account}"
    );
    assert_eq!(program.stdout(), "", "{account}");
}

#[test]
fn what_cannot_be_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let written = |name: &str, text: &[u8]| {
        fs::write(path(name), text).unwrap();
        path(name)
    };
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));

    let unknown = written("unknown.toml", b"[sonar]\nurrl = \"tcp://a:1\"\n");
    refused(&["check", &unknown], &["unknown.toml:2", "urrl", "`url`"]);
    refused(&["run", "--config", &unknown], &["urrl"]);
    let range = written("range.toml", b"[session]\nbin_count = 3\n");
    refused(
        &["check", &range],
        &["range.toml:2", "bin_count", "200 to 1200"],
    );
    refused(&["check", &path("no.toml")], &["no.toml"]);

    let with_poses = |log: &str| ["replay".to_owned(), log.to_owned(), "--poses".to_owned()];
    let replay = |log: &str, poses: &str, words: &[&str]| {
        let arguments = with_poses(log);
        let arguments = arguments.iter().map(String::as_str);
        let more = [poses, "--no-publish"];
        refused(&arguments.chain(more).collect::<Vec<_>>(), words);
    };
    replay(&path("no.svlog"), &poses, &["no.svlog"]);
    let text = written("text.svlog", b"this is not a log, but a letter\n");
    replay(&text, &poses, &["text.svlog", "text file"]);
    replay(&written("empty.svlog", b""), &poses, &["empty"]);
    replay(&log, &path("no.tum"), &["no.tum"]);
    let broken = written("broken.tum", b"1 2 3\n");
    replay(&log, &broken, &["broken.tum", "line 1"]);
    let far = b"100000 0 0 0 0 0 0 1\n100001 0 0 0 0 0 0 1\n";
    replay(
        &log,
        &written("far.tum", far),
        &["far.tum", "no time in common"],
    );

    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp://{}", taken.local_addr().unwrap());
    refused(&["emulate", "--listen", &address], &[&address, "in use"]);
    refused(
        &["emulate", "--listen", "http://x"],
        &["http://x", "tcp://"],
    );

    let scene = written("scene.toml", b"name = \"x\"\n[[sphere]]\nradius = 1\n");
    let out = path("out");
    refused(
        &["simulate", "--scene", &scene, "--out", &out],
        &["scene.toml", "radius"],
    );
    refused(
        &["simulate", "--scene", "fense", "--out", &out],
        &["fense", "fence"],
    );
    refused(&["run", "--sonar", "192.168.2.92"], &["tcp://HOST:PORT"]);
    refused(
        &["evaluate", &text, "--truth", "fence"],
        &["text.svlog", "PLY"],
    );
    refused(&["run", "--zenoh", "no/such/key=1"], &["no/such/key"]);
}

#[test]
fn words_the_program_does_not_know_are_a_usage_error() {
    for arguments in [&["swim"][..], &["replay"], &["run", "--depth", "3"]] {
        let mut program = Program::echosplat(arguments);
        program.wait_exit_code(2, SHORT);
        assert!(program.stderr().contains("Usage:"), "{}", program.account());
    }
}

#[test]
fn the_printed_defaults_are_a_valid_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let mut printed = Program::echosplat(&["config"]);
    printed.wait_exit_code(0, SHORT);
    let file = folder.path().join("my.toml");
    fs::write(&file, printed.stdout()).unwrap();
    let file = file.display().to_string();
    Program::echosplat(&["check", &file]).wait_exit_code(0, SHORT);
    let mut version = Program::echosplat(&["--version"]);
    version.wait_exit_code(0, SHORT);
    assert!(
        version.stdout().contains("commit "),
        "{}",
        version.account()
    );
}
