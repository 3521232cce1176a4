//! Whatever is asked for wrongly gets one line that says so, and its exit code.

use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::time::Duration;

use echosplat_model::glam::DVec3;
use echosplat_recording::ply::{MapNotes, write_map};

use crate::dive::file;
use crate::harness::Program;

const SHORT: Duration = Duration::from_secs(60);

/// One line on standard error that holds `words`, nothing on standard output, exit code 2.
fn refused(arguments: &[&str], words: &[&str]) {
    assert_eq!(refusal(arguments, words).lines().count(), 1, "{words:?}");
}

/// As [`refused`], on as many lines as it takes; what was said.
fn refusal(arguments: &[&str], words: &[&str]) -> String {
    let mut program = Program::echosplat(arguments);
    program.wait_exit_code(2, SHORT);
    let said = program.stderr();
    let account = program.account();
    for word in words {
        assert!(said.contains(word), "no {word:?}\n{account}");
    }
    assert!(
        !said.contains("panicked") && !said.contains("backtrace"),
        "{account}"
    );
    assert_eq!(program.stdout(), "", "{account}");
    said
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
    let far = written("far.tum", far);
    let mut elsewhere = Program::echosplat(&["replay", &log, "--poses", &far]);
    elsewhere.wait_exit_code(2, SHORT);
    let said = elsewhere.stderr();
    let last = said.lines().last().unwrap_or_default();
    assert!(
        last.contains("far.tum") && last.contains("no time in common"),
        "{said}"
    );
    assert!(last.contains("--time-offset-s"), "{said}");

    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp://{}", taken.local_addr().unwrap());
    refused(&["emulate", "--listen", &address], &[&address, "in use"]);
    let page = address.trim_start_matches("tcp://");
    refused(
        &["run", "--sonar", "sim://fence", "--web", page],
        &[page, "in use", "free port"],
    );
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
    let disturbed = |pair: &str, words: &[&str]| {
        refused(&["simulate", "--disturb", pair, "--out", &out], words);
    };
    disturbed("spike=3", &["`spike`", "spikes", "mount_roll_deg"]);
    disturbed("saturated_share=20", &["saturated_share", "0 to 1"]);
    disturbed("surface_m=-1", &["surface_m", "must lie above"]);
    refused(&["run", "--sonar", "192.168.2.92"], &["tcp://HOST:PORT"]);
    refused(
        &["evaluate", &text, "--truth", "fence"],
        &["text.svlog", "PLY"],
    );
    refused(&["run", "--zenoh", "no/such/key=1"], &["no/such/key"]);
    for command in ["run", "watch"] {
        refused(
            &[command, "--zenoh", "connect/endpoints=['tls/rov:7447']"],
            &["connect/endpoints", "tls/rov:7447", "built in is tcp"],
        );
    }
}

#[test]
fn all_faults_of_a_configuration_are_told_a_line_each() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("my.toml");
    let text = "[sonar]\nurrl = \"tcp://a:1\"\n[session]\nbin_count = 3\n[pose]\n\
                capacity = \"all\"\n[mapper]\nresolution_m = 1e-9\n";
    fs::write(&file, text).unwrap();
    let file = file.display().to_string();
    let words = [
        "my.toml:2: sonar.urrl: no such key; did you mean `url`?",
        "my.toml:4: session.bin_count: is 3; allowed is 200 to 1200",
        "my.toml:6: pose.capacity: is \"all\"; allowed is a whole number",
        "my.toml:8: mapper.resolution_m: is 0.000000001; allowed is 0,",
    ];
    for command in [&["check", &file][..], &["run", "--config", &file]] {
        let said = refusal(command, &words);
        assert_eq!(said.lines().count(), words.len(), "{said}");
    }
}

#[test]
fn settings_that_would_take_all_memory_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("my.toml");
    let check = |text: &str, words: &[&str]| {
        fs::write(&file, text).unwrap();
        refused(&["check", &file.display().to_string()], words);
    };
    check(
        "[bus]\nmax_gaussians = 67108864\n",
        &["my.toml:2: bus.max_gaussians", "allowed is 2.0 GiB"],
    );
    check(
        "[mapper]\nresolution_m = 0.005\n[session]\nrange_length_m = 120.0\n",
        &["my.toml:2: mapper.resolution_m", "too much memory"],
    );
    check(
        "[pose]\ncapacity = 9000000\n[mapper]\nhistory_pings = 900000\n",
        &["pose.capacity", "mapper.history_pings"],
    );
}

/// Makes a named pipe.
fn named_pipe(path: &Path) -> String {
    let made = std::process::Command::new("mkfifo").arg(path).status();
    assert!(made.is_ok_and(|status| status.success()), "mkfifo");
    path.display().to_string()
}

#[test]
fn what_is_no_regular_file_is_neither_replaced_nor_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = named_pipe(&folder.path().join("pipe"));
    let directory = folder.path().display().to_string();
    let socket = folder.path().join("socket");
    let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    let socket = socket.display().to_string();
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));
    for (map, what) in [
        (pipe.as_str(), "a named pipe"),
        (&socket, "a socket"),
        (&directory, "a directory"),
        ("/dev/null", "devices"),
        ("/dev/stdout", "devices"),
    ] {
        let replay = [
            "replay",
            &log,
            "--poses",
            &poses,
            "--no-publish",
            "--map",
            map,
        ];
        refused(&replay, &["--map", map, what]);
        refused(&["watch", "--map", map], &["--map", what]);
    }
    refused(&["run", "--map", &pipe], &["--map", "a named pipe"]);
    for device in [pipe.as_str(), "/dev/zero"] {
        let no_publish = "--no-publish";
        let words = [device, "regular file"];
        refused(&["replay", device, "--poses", &poses, no_publish], &words);
        refused(&["calibrate", device, "--poses", &poses], &words);
        refused(&["evaluate", device, "--truth", "fence"], &words);
        refused(&["export", device, &format!("{directory}/a.npz")], &words);
        let url = format!("file://{device}");
        refused(&["run", "--sonar", &url, "--pose", "none"], &words);
    }
}

#[test]
fn pings_that_a_map_was_made_of_are_not_scored() {
    let folder = tempfile::tempdir().unwrap();
    let map = |name: &str, held_out_every: u64| {
        let path = folder.path().join(name);
        let notes = MapNotes {
            held_out_every,
            ..MapNotes::default()
        };
        write_map(&path, DVec3::ZERO, 1.0, &[], &notes).unwrap();
        path.display().to_string()
    };
    let (of_all, kept) = (map("all.ply", 0), map("kept.ply", 20));
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));
    let evaluate = |map: &str, held_out: &[&str], words: &[&str]| {
        let arguments = ["evaluate", map, "--log", &log, "--poses", &poses];
        refused(&[&arguments[..], held_out].concat(), words);
    };
    let none = ["all.ply", "does not say", "--hold-out"];
    evaluate(&of_all, &["--held-out"], &none);
    evaluate(&of_all, &["--held-out", "20"], &none);
    let other = ["kept.ply", "every 20", "--held-out 10", "made of"];
    evaluate(&kept, &["--held-out", "10"], &other);
    evaluate(&kept, &["--held-back", "10"], &other);
    let without_poses = ["evaluate", &kept, "--log", &log, "--held-out"];
    refused(&without_poses, &["dive.svlog", "--poses"]);
    refused(&["calibrate", &log], &["dive.svlog", "--poses"]);
}

#[test]
fn a_map_is_exported_to_formats_there_are_and_not_over_itself() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply");
    write_map(&map, DVec3::ZERO, 1.0, &[], &MapNotes::default()).unwrap();
    let map = map.display().to_string();
    refused(
        &["export", &map, "map.stl"],
        &["map.stl", ".splat, .pcd, .npz, .ply, .glb"],
    );
    refused(&["export", &map, "map.obj"], &["map.obj", "--mesh"]);
    refused(&["export", &map, &map], &["the map itself"]);
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
    let mut basic = Program::echosplat(&["config", "--basic"]);
    basic.wait_exit_code(0, SHORT);
    assert!(basic.stdout().len() * 2 < printed.stdout().len());
    fs::write(&file, basic.stdout()).unwrap();
    Program::echosplat(&["check", &file]).wait_exit_code(0, SHORT);
    let mut version = Program::echosplat(&["--version"]);
    version.wait_exit_code(0, SHORT);
    assert!(
        version.stdout().contains("commit "),
        "{}",
        version.account()
    );
}

#[test]
fn shells_are_told_our_commands() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let mut printed = Program::echosplat(&["completions", shell]);
        printed.wait_exit_code(0, SHORT);
        let script = printed.stdout();
        for word in ["echosplat", "replay", "hold-out"] {
            assert!(script.contains(word), "{shell}: no {word}");
        }
        assert!(!script.contains("hold-back"), "{shell}");
    }
}

#[test]
fn every_command_has_a_manual_page() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().display().to_string();
    Program::echosplat(&["man", "--out", &out]).wait_exit_code(0, SHORT);
    for name in ["echosplat.1", "echosplat-replay.1"] {
        let page = fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(page.contains(".TH echosplat"), "{name}: {page}");
    }
    let replay = fs::read_to_string(folder.path().join("echosplat-replay.1")).unwrap();
    assert!(replay.contains("finished"), "{replay}");
}
