//! Recordings and logs that are cut, damaged, doubled, foreign or written anew by other programs: what
//! they hold is mapped, and what they lack is said, with exit code 3.

use std::fs;
use std::path::Path;
use std::sync::OnceLock;
use std::time::Duration;

use serde_json::Value;

use crate::dive::{PING_COUNT, file, replay};
use crate::harness::{Program, bus_at, free_port};
use crate::python::reader;

const LONG: Duration = Duration::from_secs(120);

/// Recordings of two short simulated dives, made once.
fn recordings() -> [&'static str; 2] {
    static MADE: OnceLock<[String; 2]> = OnceLock::new();
    let made = MADE.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("damaged");
        let _ = fs::remove_dir_all(&folder);
        ["fence", "wall"].map(|scene| {
            let directory = folder.join(scene).display().to_string();
            let sonar = format!("sim://{scene}");
            let own = [
                "run",
                "--sonar",
                &sonar,
                "--duration",
                "5",
                "--record",
                &directory,
            ];
            let own = own.iter().map(ToString::to_string);
            let arguments: Vec<String> = own.chain(bus_at(free_port())).collect();
            Program::echosplat(&arguments).wait_exit_code(0, LONG);
            let mut entries = fs::read_dir(&directory).expect("it was recorded").flatten();
            entries.next().expect("a file").path().display().to_string()
        })
    });
    [&made[0], &made[1]]
}

/// What a replay came to.
struct Replayed {
    code: i32,
    summary: Value,
    said: String,
    /// The map's bytes.
    map: Option<Vec<u8>>,
}

impl Replayed {
    fn mapped(&self) -> u64 {
        self.summary["pings_mapped"].as_u64().unwrap_or(0)
    }
}

fn replayed(logs: &[&str], more: &[&str]) -> Replayed {
    let folder = tempfile::tempdir().expect("there is room for a folder");
    let map = folder.path().join("map.ply").display().to_string();
    let own = ["--json", "--no-publish", "--map", &map];
    let mut program = Program::echosplat(&[&["replay"], logs, &own, more].concat());
    let code = program.wait_exit(LONG).code().unwrap_or(-1);
    Replayed {
        code,
        summary: match code {
            0 | 3 => program.only_json(),
            _ => Value::Null,
        },
        said: program.stderr(),
        map: fs::read(map).ok(),
    }
}

/// The whole recording replayed, once.
fn whole() -> &'static Replayed {
    static WHOLE: OnceLock<Replayed> = OnceLock::new();
    WHOLE.get_or_init(|| {
        let found = replayed(&[recordings()[0]], &[]);
        assert_eq!((found.code, found.mapped()), (0, 200), "{}", found.said);
        found
    })
}

fn bytes() -> Vec<u8> {
    fs::read(recordings()[0]).expect("it was written before")
}

#[test]
fn what_a_recording_lacks_is_said_and_the_rest_is_mapped() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let write = |name: &str, parts: &[&[u8]]| {
        fs::write(path(name), parts.concat()).unwrap();
        path(name)
    };
    let all = bytes();
    let (half, two_thirds) = (all.len() / 2, all.len() * 2 / 3);
    let [whole_file, other] = recordings();
    let zeros = vec![0; 4096];
    let cut = write("cut.mcap", &[&all[..two_thirds]]);
    let hole = write("hole.mcap", &[&all[..half], &zeros, &all[half + 4096..]]);
    let first = write("first.mcap", &[&all[..half]]);
    let doubled = write("doubled.mcap", &[&all[..half], &all]);
    let behind = write("behind.mcap", &[&all, &fs::read(other).unwrap()]);
    let told = [
        (&[cut.as_str()][..], "cut.mcap ends in the middle", false),
        (&[&hole], "hole.mcap is damaged", false),
        (&[&doubled], "repeats", true),
        (&[&first, whole_file], "repeats", true),
        (&[whole_file, &first], "repeats", true),
        (&[whole_file, whole_file], "repeats", true),
        (
            &[whole_file, other],
            "does not go on from what was read before it",
            true,
        ),
        (&[&behind], "replay it by itself", true),
    ];
    for (files, words, is_whole) in told {
        let found = replayed(files, &[]);
        assert_eq!(found.code, 3, "{files:?}: {}", found.said);
        assert!(found.said.contains(words), "{files:?}: {}", found.said);
        let lossy = found.summary["lossy"].as_str().unwrap_or_default();
        assert!(lossy.contains(words), "{files:?}: {lossy}");
        // A cut or a hole may cost nothing but what was told of the dive.
        assert!(!is_whole || found.map == whole().map, "{files:?}");
        assert!(found.mapped() > 90, "{files:?}: {}", found.mapped());
    }
}

#[test]
fn what_holds_no_dive_is_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let write = |name: &str, bytes: &[u8]| {
        fs::write(path(name), bytes).unwrap();
        path(name)
    };
    let empty = write("empty.mcap", b"");
    let zeros = write("zeros.mcap", &[0; 9000]);
    let bag = write("a.bag", b"#ROSBAG V2.0\n\x00\x01");
    let database = write("a.db3", b"SQLite format 3\x00\x10\x00");
    let packed = write("a.mcap.zstd", b"\x28\xb5\x2f\xfd\x04\x00");
    let rewritten = path("no_bytes.mcap");
    rewrite(recordings()[0], &rewritten, &["--without", "/sonar/raw"]);
    let log = recordings()[0];
    for (arguments, words) in [
        (&[empty.as_str()][..], "the file is empty"),
        (&[&zeros], "not a recording"),
        (
            &[&rewritten],
            "holds no bytes of a sonar (topic /sonar/raw)",
        ),
        (&[&rewritten], "/pose (nav_msgs/msg/Odometry)"),
        (&[&bag], "a bag of ROS 1 (.bag); `mcap convert"),
        (
            &[log, "--poses", &bag],
            "a bag of ROS 1 (.bag); `mcap convert",
        ),
        (
            &[log, "--poses", &database],
            "ROS 2 keeps bags in (.db3); `mcap convert",
        ),
        (&[log, "--poses", &packed], "`zstd -d"),
        (&[log, "--poses", &packed], "a.mcap`"),
    ] {
        let found = replayed(arguments, &[]);
        assert_eq!(found.code, 2, "{arguments:?}: {}", found.said);
        assert!(found.said.contains(words), "{arguments:?}: {}", found.said);
    }
}

fn rewrite(from: &str, to: &str, more: &[&str]) {
    reader("rewrite_mcap.py", &[&[from, to], more].concat()).wait_exit_code(0, LONG);
}

#[test]
fn a_recording_that_another_program_wrote_anew_gives_the_same_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    for (name, options) in [
        ("zstd", &["--chunk-bytes", "4000000"][..]),
        ("lz4", &["--compression", "lz4", "--no-index"]),
        ("none", &["--compression", "none", "--chunk-bytes", "20000"]),
        ("topic", &["--order", "topic"]),
        ("time", &["--order", "time"]),
    ] {
        let rewritten = path(&format!("{name}.mcap"));
        rewrite(recordings()[0], &rewritten, options);
        let found = replayed(&[&rewritten], &[]);
        assert_eq!(found.code, 0, "{name}: {}", found.said);
        assert!(found.map == whole().map, "{name}");
    }
    let rewritten = path("zstd.mcap");
    let mut info = Program::echosplat(&["info", &rewritten, "--json"]);
    info.wait_exit_code(0, LONG);
    let info = info.only_json();
    assert_eq!(info["pings"], 200, "{info}");
    assert_eq!(info["replays_without_poses"], true, "{info}");
    let recovered = path("recovered.mcap");
    Program::echosplat(&["recover", &rewritten, "--out", &recovered]).wait_exit_code(0, LONG);
    assert!(replayed(&[&recovered], &[]).map == whole().map);
    // Two parts of it, each with what the other lacks.
    let (early, late) = (path("early.mcap"), path("late.mcap"));
    rewrite(recordings()[0], &early, &["--until", "3"]);
    rewrite(
        recordings()[0],
        &late,
        &["--from", "2", "--compression", "lz4"],
    );
    let found = replayed(&[&early, &late], &[]);
    assert!(
        found.code == 3 && found.said.contains("repeats"),
        "{}",
        found.said
    );
    assert!(found.map == whole().map);
    let found = replayed(&[&late], &[]);
    assert!(
        found.said.contains("late.mcap holds no settings"),
        "{}",
        found.said
    );
}

#[test]
fn info_says_that_a_simulated_recording_replays_and_what_a_damaged_one_lacks() {
    let info = |file: &str| {
        let mut info = Program::echosplat(&["info", file, "--json"]);
        info.wait_exit_code(0, LONG);
        info.only_json()
    };
    let found = info(recordings()[0]);
    assert_eq!(found["replays_without_poses"], true, "{found}");
    assert_eq!(found["losses"].as_array().map(Vec::len), Some(0), "{found}");
    let folder = tempfile::tempdir().unwrap();
    let cut = folder.path().join("cut.mcap").display().to_string();
    let all = bytes();
    fs::write(&cut, &all[..all.len() / 2]).unwrap();
    let found = info(&cut);
    let said = found["losses"][0].as_str().unwrap_or_default();
    assert!(said.contains("cut.mcap ends in the middle"), "{found}");
}

#[test]
fn no_damaged_byte_of_the_magic_costs_a_pose() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let all = bytes();
    let places = (0..8).map(|at| vec![at]).chain([(0..8).collect()]);
    for (index, places) in places.enumerate() {
        let mut bytes = all.clone();
        for at in places {
            bytes[at] ^= 0x41;
        }
        let damaged = path("damaged.mcap");
        fs::write(&damaged, &bytes).unwrap();
        let recovered = path(&format!("{index}.mcap"));
        let mut recover = Program::echosplat(&["recover", &damaged, "--out", &recovered]);
        recover.wait_exit_code(0, LONG);
        assert!(replayed(&[&recovered], &[]).map == whole().map, "{index}");
        if index % 4 == 0 {
            assert!(replayed(&[&damaged], &[]).map == whole().map, "{index}");
        }
    }
    // What is a log is never written under the name of a recording.
    let log = path("log.mcap");
    fs::copy(file("dive.svlog"), &log).unwrap();
    let mut recover = Program::echosplat(&["recover", &log, "--out", &path("r.mcap")]);
    recover.wait_exit_code(2, LONG);
    let said = recover.stderr();
    assert!(
        said.contains("is a log (svlog)") && said.contains(".svlog"),
        "{said}"
    );
    Program::echosplat(&["recover", &log]).wait_exit_code(0, LONG);
    assert!(folder.path().join("log.recovered.svlog").is_file());
    assert!(!folder.path().join("r.mcap").exists());
}

#[test]
fn a_log_that_holds_its_pings_twice_is_mapped_once_and_it_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let log = fs::read(file("dive.svlog")).unwrap();
    let doubled = path("doubled.svlog");
    fs::write(&doubled, [&log[..log.len() / 2], &log].concat()).unwrap();
    let map = path("map.ply");
    let more = ["--no-publish", "--map", &map];
    Program::echosplat(&replay(&more)).wait_exit_code(0, LONG);
    let poses = file("dive.tum");
    let twice = [file("dive.svlog"), file("dive.svlog")];
    for logs in [&[doubled.as_str()][..], &[&twice[0], &twice[1]]] {
        let found = replayed(logs, &["--poses", &poses]);
        assert_eq!(found.code, 3, "{logs:?}: {}", found.said);
        assert_eq!(found.mapped(), PING_COUNT, "{logs:?}");
        assert!(
            found.map.as_deref() == fs::read(&map).ok().as_deref(),
            "{logs:?}"
        );
    }
    let said = replayed(&[&twice[0], &twice[1]], &["--poses", &poses]).said;
    assert!(said.contains("960 of 1920 pings came twice"), "{said}");
}
