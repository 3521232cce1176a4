//! What earlier versions wrote is read by this one: the files in `tests/written`, one folder a version.

use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Duration;

use echosplat_model::Standing;
use echosplat_model::glam::Vec3;
use echosplat_recording::mcap::{Ending, Record, Recording, RecordingReader, Scan};
use echosplat_recording::ply::{self, MapFile};
use echosplat_recording::svlog::{SvlogReader, Tail};
use echosplat_recording::tum;
use serde_json::Value;

use crate::harness::Program;
use crate::python::python;

const LONG: Duration = Duration::from_secs(120);
/// Pings of the dive: ten seconds at sixteen a second.
const PING_COUNT: u64 = 159;
/// Of the second that a service ran.
const LIVE_PING_COUNT: u64 = 40;
/// Sums of rounded numbers differ by the order in which they are added.
const ROUNDING: f64 = 1e-5;

/// The files of one version.
struct Written {
    folder: PathBuf,
    /// What they hold, by a reader of its own.
    holds: Value,
    summary: Value,
}

impl Written {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    fn scan(&self, name: &str) -> Scan {
        let scan = Recording::scan(&[self.path(name)]);
        scan.unwrap_or_else(|error| panic!("{error}"))
    }

    /// The map with its ambiguous part.
    fn map(&self) -> MapFile {
        ply::read_map(&self.path("map.ply")).unwrap_or_else(|error| panic!("{error}"))
    }

    fn count(&self, pointer: &str) -> usize {
        let found = self.holds.pointer(pointer).and_then(Value::as_u64);
        let found = found.and_then(|count| count.try_into().ok());
        found.unwrap_or_else(|| panic!("{} of {}", pointer, self.folder.display()))
    }

    fn number(&self, pointer: &str) -> f64 {
        let found = self.holds.pointer(pointer).and_then(Value::as_f64);
        found.unwrap_or_else(|| panic!("{} of {}", pointer, self.folder.display()))
    }
}

/// Of each version, by their names.
fn versions() -> Vec<Written> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/written");
    let entries = fs::read_dir(folder).expect("the folder is there").flatten();
    let folders = entries
        .map(|entry| entry.path())
        .filter(|path| path.is_dir());
    let mut folders: Vec<PathBuf> = folders.collect();
    folders.sort();
    assert!(folders.len() >= 2, "{folders:?}");
    let json = |path: PathBuf| -> Value {
        let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path:?}: {error}"));
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{path:?}: {error}"))
    };
    let written = |folder: PathBuf| Written {
        holds: json(folder.join("holds.json")),
        summary: json(folder.join("summary.json")),
        folder,
    };
    folders.into_iter().map(written).collect()
}

fn mean(numbers: impl Iterator<Item = f64>) -> f64 {
    let numbers: Vec<f64> = numbers.filter(|number| number.is_finite()).collect();
    numbers.iter().sum::<f64>() / numbers.len() as f64
}

fn assert_near(found: f64, expected: f64, what: &str) {
    let is_near = (found - expected).abs() <= ROUNDING * expected.abs().max(1.0);
    assert!(is_near, "{what}: {found} for {expected}");
}

/// What a map holds is what the other reader found there under `name`.
fn assert_holds(written: &Written, map: &MapFile, name: &str) {
    let what = written.text(name);
    let expected = |member: &str| written.number(&format!("/{name}/{member}"));
    let count = written.count(&format!("/{name}/gaussians"));
    assert_eq!(map.gaussians.len(), count, "{what}");
    assert_eq!(map.refused.count, 0, "{what}: {}", map.refused);
    assert!(map.lacks.is_empty(), "{what}: {:?}", map.lacks);
    let all = || map.gaussians.iter();
    for axis in 0..3 {
        let found = mean(all().map(|g| f64::from(g.mean_m[axis])));
        assert_near(found, expected(&format!("mean_m/{axis}")), &what);
        let origin = map.origin_m[axis];
        assert_near(origin, expected(&format!("origin_m/{axis}")), &what);
    }
    let sigma = mean(all().map(|g| f64::from(g.sigma_m)));
    assert_near(sigma, expected("sigma"), &what);
    let probability = mean(all().map(|g| f64::from(g.probability)));
    assert_near(probability, expected("probability"), &what);
    let reflectivity = mean(all().map(|g| f64::from(g.reflectivity)));
    assert_near(reflectivity, expected("reflectivity"), &what);
}

#[test]
fn maps_hold_what_was_written() {
    for written in versions() {
        for name in ["map.ply", "map.ambiguous.ply", "world.ply"] {
            let file = File::open(written.path(name)).unwrap();
            let map = ply::read(BufReader::new(file)).unwrap();
            assert_holds(&written, &map, name);
        }
        let both = written.map();
        let count = |standing| {
            both.gaussians
                .iter()
                .filter(|g| g.standing == standing)
                .count()
        };
        let told = |name: &str| written.summary[name].as_u64();
        assert_eq!(Some(count(Standing::Confident) as u64), told("gaussians"));
        assert_eq!(Some(count(Standing::Ambiguous) as u64), told("ambiguous"));
        assert!(
            count(Standing::Confident) > 20,
            "{}",
            written.text("map.ply")
        );
    }
}

#[test]
fn trajectories_hold_what_was_written() {
    for written in versions() {
        let file = File::open(written.path("dive.tum")).unwrap();
        let poses = tum::read(BufReader::new(file)).unwrap().poses;
        assert_eq!(poses.len(), written.count("/dive.tum/poses"));
        let first = &poses[0];
        let place = first.world_from_vehicle.translation_m.to_array();
        let turn = first.world_from_vehicle.rotation.to_array();
        let numbers = [&[first.time.as_secs_f64()][..], &place, &turn].concat();
        for (index, number) in numbers.into_iter().enumerate() {
            let expected = written.number(&format!("/dive.tum/first/{index}"));
            assert_near(number, expected, &format!("number {index}"));
        }
    }
}

#[test]
fn logs_hold_every_ping() {
    for written in versions() {
        for (name, ping_count) in [("dive.svlog", PING_COUNT), ("live.svlog", LIVE_PING_COUNT)] {
            let mut log = SvlogReader::new(File::open(written.path(name)).unwrap()).unwrap();
            while log.next_piece().unwrap().is_some() {}
            assert_eq!(log.tail(), Some(Tail::Whole));
            // And the session's packet.
            assert_eq!(log.frame_count(), ping_count + 1, "{}", written.text(name));
        }
    }
}

#[test]
fn recordings_hold_bytes_poses_settings_and_what_happened() {
    for written in versions() {
        let scan = written.scan("recording.mcap");
        let what = written.text("recording.mcap");
        assert_eq!(scan.losses(false), [""; 0], "{what}");
        assert_eq!(scan.poses.len(), written.count("/dive.tum/poses"));
        let place = scan.poses[0].0.world_from_vehicle.translation_m;
        for axis in 0..3 {
            let expected = written.number(&format!("/dive.tum/first/{}", axis + 1));
            assert_near(place[axis], expected, &what);
        }
        let settings = scan.settings.as_deref().unwrap_or_default();
        assert!(settings.contains("resolution_m = 0.1"), "{what}");
        let status = scan.last_status.expect("there is one");
        assert_eq!(status["pings_received"], PING_COUNT, "{what}");
        assert_eq!(status["final"], true, "{what}");
        let mut reader = RecordingReader::open(&[written.path("recording.mcap")]).unwrap();
        let mut raw = Vec::new();
        while let Some(recorded) = reader.next_message().unwrap() {
            if let Record::Raw(bytes) = recorded.record {
                raw.extend_from_slice(&bytes);
            }
        }
        assert_eq!(reader.ending(), Some(Ending::Complete), "{what}");
        assert!(
            raw == fs::read(written.path("dive.svlog")).unwrap(),
            "{what}"
        );

        let live = written.scan("live.mcap");
        assert_eq!(live.losses(false), [""; 0], "{what}");
        assert!(live.counts.link_ups >= 1 && live.counts.statuses >= 1);
        assert!(!live.poses.is_empty() && live.counts.raw > 0);
    }
}

/// The summary of a replay that ended well, and its map.
fn replayed(arguments: &[&str]) -> (Value, Vec<u8>) {
    let folder = tempfile::tempdir().expect("there is room for a folder");
    let map = folder.path().join("map.ply").display().to_string();
    let own = ["--json", "--map", &map];
    let mut program = Program::echosplat(&[&["replay"], arguments, &own].concat());
    program.wait_exit_code(0, LONG);
    let map = fs::read(map).unwrap_or_else(|_| panic!("no map\n{}", program.account()));
    (program.only_json(), map)
}

#[test]
fn old_recordings_replay_to_the_map_that_their_log_gives_now() {
    for written in versions() {
        let recording = written.text("recording.mcap");
        let (of_recording, map) = replayed(&[&recording]);
        assert_eq!(
            of_recording["pings_mapped"],
            written.summary["pings_mapped"]
        );
        let (log, poses) = (written.text("dive.svlog"), written.text("dive.tum"));
        let config = written.text("config.toml");
        let (of_log, same) = replayed(&[&log, "--poses", &poses, "--config", &config]);
        assert_eq!(of_log["pings_mapped"], of_recording["pings_mapped"]);
        assert!(map == same, "{recording}");
        // Another version works out another map, of the same place.
        let (now, then) = (ply::read(&map[..]).unwrap(), written.map());
        let middle = |map: &MapFile| {
            let sum: Vec3 = map.gaussians.iter().map(|g| g.mean_m).sum();
            map.origin_m + (sum / map.gaussians.len() as f32).as_dvec3()
        };
        let apart_m = middle(&now).distance(middle(&then));
        assert!(apart_m < 1.0, "{recording}: {apart_m}");
        let (live, _) = replayed(&[&written.text("live.mcap")]);
        let status = written.scan("live.mcap").last_status.unwrap();
        assert_eq!(live["pings_mapped"], status["pings_mapped"]);
    }
}

#[test]
fn old_configurations_are_taken() {
    for written in versions() {
        let config = written.text("config.toml");
        Program::echosplat(&["check", &config]).wait_exit_code(0, LONG);
    }
}

#[test]
fn old_truths_and_meshes_judge_a_map() {
    for written in versions() {
        let map = written.text("map.ply");
        let folder = written.folder.display().to_string();
        for mesh in ["mesh.ply", "mesh.obj"] {
            let mesh = written.text(mesh);
            let evaluate = [
                "evaluate", &map, "--truth", &folder, "--mesh", &mesh, "--json",
            ];
            let mut judged = Program::echosplat(&evaluate);
            judged.wait_exit_code(0, LONG);
            let judged = judged.only_json();
            let accuracy_m = judged["accuracy_m"].as_f64().expect("it is judged");
            assert!(accuracy_m < 0.5, "{mesh}: {judged}");
            assert!(judged["mesh"].is_object(), "{mesh}: {judged}");
            // Of its triangles, and not only of its corners.
            let against = ["evaluate", &map, "--truth", &mesh, "--json"];
            Program::echosplat(&against).wait_exit_code(0, LONG);
        }
        let obj = fs::read_to_string(written.path("mesh.obj")).unwrap();
        let count = |kind: &str| obj.lines().filter(|line| line.starts_with(kind)).count();
        assert_eq!(count("f "), written.count("/mesh.ply/triangles"));
    }
}

#[test]
fn old_point_clouds_and_splats_hold_the_map() {
    for written in versions() {
        let map = written.map();
        let count = map.gaussians.len();
        let cloud = fs::read(written.path("map.pcd")).unwrap();
        let end = b"DATA binary\n";
        let at = cloud.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let head = String::from_utf8_lossy(&cloud[..at]);
        assert!(head.contains(&format!("POINTS {count}\n")), "{head}");
        assert!(
            head.contains("FIELDS x y z intensity opacity sigma\n"),
            "{head}"
        );
        let sizes = head
            .lines()
            .find_map(|line| line.strip_prefix("SIZE "))
            .unwrap();
        let size: usize = sizes
            .split(' ')
            .map(|size| size.parse::<usize>().unwrap())
            .sum();
        assert_eq!(cloud.len() - at, count * size, "{head}");
        let splat = fs::read(written.path("map.splat")).unwrap();
        assert_eq!(splat.len(), count * 32);
        for (gaussian, record) in map.gaussians.iter().zip(splat.chunks(32)) {
            let world = map.origin_m.as_vec3() + gaussian.mean_m;
            let x = f32::from_le_bytes(record[..4].try_into().unwrap());
            assert!((x - world.x).abs() < 1e-4, "{x} for {}", world.x);
        }
    }
}

/// Compares an archive with what Rust has read of the map: count, mean place, mean sigma.
const ARCHIVE: &str = r#"
import json, sys
import numpy as np
with np.load(sys.argv[1], allow_pickle=False) as found:
    sigma = found["sigma_m"]
    print(json.dumps({
        "count": len(found["position"]), "mean": found["position"].mean(axis=0).tolist(),
        "sigma": float(sigma[np.isfinite(sigma)].astype(float).mean()), "confident": int(found["confident"].sum()),
        "version": int(found["format_version"]) if "format_version" in found else 1}))
"#;

#[test]
fn old_archives_hold_the_map() {
    for written in versions() {
        let map = written.map();
        let mut read = Program::start(python(&["-c", ARCHIVE], &[written.text("map.npz")]));
        read.wait_exit_code(0, LONG);
        let found = read.only_json();
        assert_eq!(found["count"], map.gaussians.len());
        assert_eq!(found["confident"], written.summary["gaussians"]);
        assert_eq!(found["version"], 1);
        let sigma = mean(map.gaussians.iter().map(|g| f64::from(g.sigma_m)));
        assert_near(found["sigma"].as_f64().unwrap(), sigma, "sigma");
        for axis in 0..3 {
            let places = map.gaussians.iter().map(|g| f64::from(g.mean_m[axis]));
            let expected = map.origin_m[axis] + mean(places);
            assert_near(found["mean"][axis].as_f64().unwrap(), expected, "mean");
        }
    }
}

#[test]
fn info_says_what_old_files_hold_each_with_its_name_once() {
    for written in versions() {
        let names = [
            "recording.mcap",
            "dive.svlog",
            "map.ply",
            "dive.tum",
            "live.mcap",
        ];
        let files = names.map(|name| written.text(name));
        let mut arguments = vec!["info"];
        arguments.extend(files.iter().map(String::as_str));
        let mut info = Program::echosplat(&arguments);
        info.wait_exit_code(0, LONG);
        let said = info.stdout();
        for file in &files {
            assert_eq!(said.matches(file.as_str()).count(), 1, "{file}\n{said}");
        }
        arguments.push("--json");
        let mut info = Program::echosplat(&arguments);
        info.wait_exit_code(0, LONG);
        let found = info.only_json();
        let found: Vec<_> = found["found"].as_array().expect("several").iter().collect();
        let of = |name: usize| {
            let is_it = |facts: &&&Value| facts["name"] == files[name].as_str();
            *found
                .iter()
                .find(is_it)
                .unwrap_or_else(|| panic!("{}", files[name]))
        };
        assert_eq!(of(0)["pings"], PING_COUNT);
        assert_eq!(of(0)["replays_without_poses"], true);
        assert_eq!(of(1)["pings"], PING_COUNT);
        assert_eq!(of(2)["gaussians"], written.summary["gaussians"]);
        assert_eq!(of(3)["poses"], written.count("/dive.tum/poses"));
        assert!(of(4)["pings"].as_u64() > Some(0));
    }
}
