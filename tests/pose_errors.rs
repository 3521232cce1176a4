//! Poses that say how wrong they may be, and poses that are wrong: what of them costs the map something, and that it is told.

use std::io::BufReader;
use std::path::Path;
use std::time::Duration;

use echosplat_model::{PoseCovariance, StampedPose, Timestamp};
use echosplat_recording::mcap::{Profile, Record, RecordingFile};
use echosplat_recording::tum;
use serde_json::Value;

use crate::dive::file;
use crate::fake_sonar::{FakeSonar, FakeVehicle, now, pose_at, profile};
use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::link::newest_count;

const LONG: Duration = Duration::from_secs(120);

/// Variances along x, y, z and about them.
fn diagonal([x, y, z, roll, pitch, yaw]: [f64; 6]) -> PoseCovariance {
    PoseCovariance {
        position_m2: [x, 0.0, 0.0, y, 0.0, z],
        attitude_rad2: [roll, pitch, yaw],
    }
}

/// The map of the short dive, its poses in an MCAP file with what `told` says of them so long after the first.
fn mapped(
    folder: &Path,
    told: impl Fn(f64) -> Option<PoseCovariance>,
    more: &[&str],
) -> (Value, Vec<u8>) {
    let text = std::fs::File::open(file("dive.tum")).expect("the dive is there");
    let poses = tum::read(BufReader::new(text)).expect("of poses").poses;
    let path = folder.join("poses.mcap");
    // Of the call before.
    let _ = std::fs::remove_file(&path);
    let mut recording = RecordingFile::create(&path, "map", Profile::Full).expect("a new file");
    for pose in &poses {
        let seconds = pose.time.seconds_since(poses[0].time);
        let uncertainty = told(seconds);
        let record = Record::Pose(StampedPose {
            uncertainty,
            ..*pose
        });
        let at = pose.time.max(Timestamp::ZERO);
        recording.writer().write(at, &record).expect("room");
    }
    recording.finish().expect("room");
    let (poses, map) = (path.display().to_string(), folder.join("map.ply"));
    let (log, map_name) = (file("dive.svlog"), map.display().to_string());
    let own = [
        "replay", &log, "--poses", &poses, "--map", &map_name, "--rate", "0", "--json",
    ];
    let mut replay = Program::echosplat(&[&own[..], more].concat());
    replay.wait_exit_code(0, LONG);
    (replay.json(), std::fs::read(map).expect("a map"))
}

fn notices(summary: &Value) -> Vec<&str> {
    let notices = summary["notices"].as_array().expect("all of them");
    notices
        .iter()
        .filter_map(|n| n["sentence"].as_str())
        .collect()
}

#[test]
fn covariances_of_good_poses_cost_the_map_next_to_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (plain, without) = mapped(folder.path(), |_| None, &[]);
    let expected = plain["gaussians"].as_f64().unwrap();
    assert!(expected > 500.0, "{expected}");
    let unmeasured = |_| Some(diagonal([4e-4, 4e-4, 1e6, 1e6, f64::NAN, 9999.0]));
    let drift = |s: f64| {
        let xy = 0.05 * s + 1e-4;
        Some(diagonal([xy, xy, 1e-4, 1e-5, 1e-5, 1e-5]))
    };
    let constant = |_| Some(PoseCovariance::alike(0.5, 0.1));
    let all: [&dyn Fn(f64) -> Option<PoseCovariance>; 3] = [&unmeasured, &drift, &constant];
    for (index, told) in all.into_iter().enumerate() {
        let (summary, _) = mapped(folder.path(), told, &[]);
        let share = summary["gaussians"].as_f64().unwrap() / expected;
        assert!((0.95..1.05).contains(&share), "{index}: {share}");
        let unusable = &summary["poses"]["covariances"]["unusable_yaw"];
        let count = summary["poses"]["covariances"]["given"].as_u64().unwrap();
        let expected = if index == 0 { count } else { 0 };
        assert_eq!(
            (unusable.as_u64().unwrap(), count > 1_000),
            (expected, true)
        );
    }
    let settings = folder.path().join("ignore.toml");
    std::fs::write(&settings, "[pose]\ncovariances = \"ignore\"\n").unwrap();
    let settings = settings.display().to_string();
    let risen = |s: f64| {
        Some(PoseCovariance::alike(
            if s > 8.0 { 0.7 } else { 0.01 },
            0.003,
        ))
    };
    let (summary, _) = mapped(folder.path(), risen, &[]);
    let told = notices(&summary).join("; ");
    assert!(told.contains("pose.covariances = \"ignore\""), "{told}");
    let (summary, ignored) = mapped(folder.path(), risen, &["--config", &settings]);
    assert_eq!(notices(&summary), [""; 0]);
    assert!(ignored == without, "as if the poses had none");
}

/// A service whose poses come from `pose`; what it said and mapped by when so many pings are in the map.
fn lived(pose: impl Fn(f64) -> Option<StampedPose> + Send + 'static, words: &[&str]) -> Program {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let (bus, url) = (bus_at(port), sonar.url());
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let own = ["run", "--sonar", &url, "--verbose"];
    let mut service = Program::echosplat(&[&own[..], &bus].concat());
    wait_until_listening(&mut service, port);
    let _vehicle = FakeVehicle::start(port, pose);
    for word in words {
        service.wait_for_text(word, LONG);
    }
    service.wait_for("pings in the map", LONG, |service| {
        newest_count(&service.stderr(), "pings_mapped").filter(|&count| count > 150)
    });
    service.terminate();
    service.wait_exit(Duration::from_secs(10));
    service
}

/// Of the pings received nearly all are in the map.
fn maps_nearly_all(service: &Program) {
    let number = |words: &str| {
        let stdout = service.stdout();
        let before = stdout.split(words).next().unwrap_or_default();
        let digits = before.rsplit(|c: char| !c.is_ascii_digit()).next();
        digits.unwrap_or_default().parse().unwrap_or(0_u64)
    };
    let (received, mapped) = (number(" pings received"), number(" mapped"));
    assert!(mapped * 10 > received * 8, "{}", service.account());
}

#[test]
fn an_axis_that_nobody_measures_costs_a_live_map_nothing() {
    let told = |seconds: f64| {
        Some(StampedPose {
            uncertainty: Some(diagonal([4e-4, 4e-4, 1.7e308, f64::NAN, -1.0, 9999.0])),
            ..pose_at(now(), seconds)
        })
    };
    let service = lived(told, &[]);
    maps_nearly_all(&service);
    assert!(
        !service.stderr().contains("pose-covariance"),
        "{}",
        service.account()
    );
}

#[test]
fn a_covariance_that_rises_at_once_is_named_live() {
    let told = |seconds: f64| {
        let sigma_m = if seconds > 3.0 { 3.0 } else { 0.02 };
        Some(StampedPose {
            uncertainty: Some(PoseCovariance::alike(sigma_m, 0.003)),
            ..pose_at(now(), seconds)
        })
    };
    lived(
        told,
        &["the covariance of the poses rose", "pose.covariances"],
    );
}

#[test]
fn stray_stamps_and_epochs_cost_a_live_map_nothing_but_themselves() {
    let count = std::sync::atomic::AtomicU32::new(0);
    let every = move |n: u32| count.fetch_add(1, std::sync::atomic::Ordering::Relaxed) % n == n - 1;
    let ahead = move |seconds: f64| {
        let ahead_s = if every(20) { 1.0 } else { 0.0 };
        Some(pose_at(now().offset_by(ahead_s), seconds))
    };
    maps_nearly_all(&lived(ahead, &["far from the clock", "+1.0"]));
    let count = std::sync::atomic::AtomicU32::new(0);
    let is_odd = move || count.fetch_add(1, std::sync::atomic::Ordering::Relaxed) % 2 == 1;
    let epochs = move |seconds: f64| {
        let epoch = if is_odd() { 7 } else { 0 };
        Some(StampedPose {
            epoch,
            ..pose_at(now(), seconds)
        })
    };
    let service = lived(epochs, &["poses of another epoch (", "second sender"]);
    maps_nearly_all(&service);
    assert!(
        !service.stderr().contains("a new map begins"),
        "{}",
        service.account()
    );
}
