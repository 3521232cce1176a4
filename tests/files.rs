//! What the program leaves on disk: maps that replace one another, exports that others read, dives
//! that stand alone.

use std::fs;
use std::path::Path;
use std::time::Duration;

use echosplat_model::glam::{DVec3, Quat, Vec3};
use echosplat_model::{Gaussian, Standing};
use echosplat_recording::ply::{MapNotes, read_map, write_map};

use crate::dive::replay;
use crate::harness::Program;
use crate::python::python;

const LONG: Duration = Duration::from_secs(120);

/// Reads map and archive with nothing but numpy, and compares every number of theirs.
const COMPARE: &str = r#"
import sys
import numpy as np

PROPERTIES = ("x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 "
              "rot_0 rot_1 rot_2 rot_3 reflectivity sigma cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz "
              "probability").split()
COLORS = "red green blue alpha".split()
WHY = "reason clear_observations measured".split()

def rows(path):
    header, _, body = open(path, "rb").read().partition(b"end_header\n")
    origin = next(line for line in header.split(b"\n") if line.startswith(b"comment origin_m"))
    found = np.frombuffer(body, np.dtype([(name, "<f4") for name in PROPERTIES] + [(name, "u1") for name in COLORS]
                                        + [(name, "<f8") for name in WHY]))
    return np.array([float(word) for word in origin.split()[2:]]), found

folder = sys.argv[1]
origin, confident = rows(folder + "/map.ply")
_, ambiguous = rows(folder + "/map.ambiguous.ply")
together = np.concatenate([confident, ambiguous])
columns = lambda table, names: np.stack([table[name] for name in names.split()], axis=1)
for file, table in (("confident", confident), ("all", together)):
    with np.load(f"{folder}/{file}.npz", allow_pickle=False) as found:
        assert sorted(found) == sorted(
            "position sigma_m position_covariance_m2 probability confident opacity scale rotation reflectivity id "
            "format_version".split())
        assert found["format_version"] == 1
        assert found["position"].dtype == np.float64
        expected = origin + columns(table, "x y z").astype(float)
        np.testing.assert_array_equal(found["position"], expected)
        np.testing.assert_array_equal(found["sigma_m"], table["sigma"])
        covariance = columns(table, "cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz")
        np.testing.assert_array_equal(found["position_covariance_m2"], covariance)
        np.testing.assert_array_equal(found["probability"], table["probability"])
        np.testing.assert_array_equal(found["reflectivity"], table["reflectivity"])
        np.testing.assert_allclose(found["opacity"], 1 / (1 + np.exp(-table["opacity"])), 1e-5)
        np.testing.assert_allclose(found["scale"], np.exp(columns(table, "scale_0 scale_1 scale_2")), 1e-5)
        np.testing.assert_allclose(found["rotation"], columns(table, "rot_0 rot_1 rot_2 rot_3"), 1e-5)
        color = np.clip(0.5 + 0.2820948 * columns(table, "f_dc_0 f_dc_1 f_dc_2"), 0, 1)
        np.testing.assert_allclose(columns(table, "red green blue"), 255 * color, atol=0.51)
        assert found["confident"].dtype == bool
        np.testing.assert_array_equal(found["confident"], np.arange(len(table)) < len(confident))
        np.testing.assert_array_equal(found["id"], np.arange(len(table)))
print("same")
"#;

fn gaussian(index: u16, standing: Standing) -> Gaussian {
    let step = f32::from(index);
    Gaussian {
        id: index.into(),
        mean_m: Vec3::new(step, -0.5 * step, 0.1 * step),
        rotation: Quat::from_rotation_z(0.1 * step),
        scale_m: Vec3::new(0.01, 0.02, 0.03) * (1.0 + step),
        opacity: 0.3 + 0.005 * step,
        reflectivity: 0.01 * (1.0 + step),
        sigma_m: if index == 3 { f32::INFINITY } else { 0.05 },
        position_covariance_m2: [4e-4, 1e-5 * step, -1e-5, 9e-4, 2e-5, 25e-4],
        probability: 0.005 * step,
        standing,
        why: echosplat_model::Why::default(),
    }
}

/// A map of 90 confident and 10 ambiguous Gaussians.
fn write_some_map(path: &Path, origin_m: DVec3) {
    let standing = |index| match index % 10 {
        9 => Standing::Ambiguous,
        _ => Standing::Confident,
    };
    let all: Vec<Gaussian> = (0..100).map(|i| gaussian(i, standing(i))).collect();
    let written = write_map(path, origin_m, 1.0, &all, &MapNotes::default());
    written.expect("the test's own folder can be written to");
}

fn export(arguments: &[&str]) -> Program {
    let mut program = Program::echosplat(&[&["export"], arguments].concat());
    program.wait_exit_code(0, LONG);
    program
}

#[test]
fn numpy_reads_what_is_exported() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    write_some_map(
        &folder.path().join("map.ply"),
        DVec3::new(5e5, 4.1e6, -20.5),
    );
    export(&[&path("map.ply"), &path("confident.npz")]);
    export(&[&path("map.ply"), &path("all.npz"), "--all"]);
    let mut compared = Program::start(python(&["-c", COMPARE], &[path("")]));
    compared.wait_exit_code(0, LONG);
    assert_eq!(compared.stdout().trim(), "same", "{}", compared.account());
}

#[test]
fn exports_are_in_the_worlds_coordinates_where_their_precision_allows() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let near = DVec3::new(100.0, 200.0, -30.0);
    write_some_map(&folder.path().join("map.ply"), near);
    export(&[&path("map.ply"), &path("world.ply"), "--all"]);
    let world = read_map(&folder.path().join("world.ply")).unwrap();
    assert_eq!((world.origin_m, world.gaussians.len()), (DVec3::ZERO, 100));
    assert_eq!(world.gaussians[1].mean_m, Vec3::new(101.0, 199.5, -29.9));
    export(&[&path("map.ply"), &path("map.splat"), "--confident"]);
    assert_eq!(fs::metadata(path("map.splat")).unwrap().len(), 90 * 32);
    export(&[&path("map.ply"), &path("map.pcd")]);
    let cloud = fs::read(path("map.pcd")).unwrap();
    let head = String::from_utf8_lossy(&cloud);
    assert!(head.contains("# origin_m 0.0 0.0 0.0\n"), "{head}");
    assert!(head.contains("SIZE 4 4 4 4 4 4\n") && head.contains("POINTS 90\n"));
    export(&[&path("map.ply"), &path("up.ply"), "--all", "--up", "-y"]);
    let head = fs::read(path("up.ply")).unwrap();
    assert!(String::from_utf8_lossy(&head[..400]).contains("comment up_axis -y\n"));
    let upright = read_map(&folder.path().join("up.ply")).unwrap();
    assert_eq!(upright.gaussians[1].mean_m, world.gaussians[1].mean_m);

    write_some_map(&folder.path().join("map.ply"), DVec3::new(2e4, 0.0, 0.0));
    let told = export(&[&path("map.ply"), &path("far.ply")]);
    assert!(
        told.stderr().contains("count from 20000.0 0.0 0.0 m"),
        "{}",
        told.account()
    );
    let far = read_map(&folder.path().join("far.ply")).unwrap();
    assert_eq!(far.origin_m, DVec3::new(2e4, 0.0, 0.0));
}

#[test]
fn a_map_that_asserts_nothing_is_put_over_none_that_does() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("keep.ply");
    write_some_map(&map, DVec3::ZERO);
    let before = fs::read(&map).unwrap();
    let map_argument = map.display().to_string();
    let more = ["--no-publish", "--duration", "0.5", "--map", &map_argument];
    let mut short = Program::echosplat(&replay(&more));
    short.wait_exit_code(0, LONG);
    let said = short.stderr();
    assert!(
        said.contains("keep.ply") && said.contains("kept"),
        "{}",
        short.account()
    );
    assert_eq!(fs::read(&map).unwrap(), before);
}

#[test]
fn two_runs_write_one_map_through_a_link_without_meeting() {
    let folder = tempfile::tempdir().unwrap();
    let (link, target) = (
        folder.path().join("map.ply"),
        folder.path().join("target.ply"),
    );
    std::os::unix::fs::symlink("target.ply", &link).unwrap();
    // Left behind by a run that was killed.
    fs::write(folder.path().join(".target.ply.aaaaaa.part"), "half").unwrap();
    let link_argument = link.display().to_string();
    let arguments = replay(&["--no-publish", "--hold-out", "20", "--map", &link_argument]);
    let mut runs = [
        Program::echosplat(&arguments),
        Program::echosplat(&arguments),
    ];
    for run in &mut runs {
        run.wait_exit_code(0, LONG);
    }
    assert!(link.is_symlink());
    let map = read_map(&target).unwrap();
    assert_eq!(map.notes.held_out_every, 20);
    assert!(!map.gaussians.is_empty());
    let left = fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 4, "link, target, ambiguous part and what was there");
}

#[test]
fn a_dive_among_meshes_stands_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir_all(path("scene/parts")).unwrap();
    let plate = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nf 1 2 3\nf 1 3 4\n";
    fs::write(path("scene/parts/plate.obj"), plate).unwrap();
    let scene = "name = \"plate\"\n[[mesh]]\nfile = \"parts/plate.obj\"\n";
    fs::write(path("scene/plate.toml"), scene).unwrap();
    let argument = |name: &str| path(name).display().to_string();
    let (scene, out) = (argument("scene/plate.toml"), argument("dive"));
    let simulate = [
        "simulate",
        "--scene",
        &scene,
        "--duration",
        "2",
        "--out",
        &out,
    ];
    Program::echosplat(&simulate).wait_exit_code(0, LONG);

    fs::remove_dir_all(path("scene")).unwrap();
    fs::rename(path("dive"), path("elsewhere")).unwrap();
    write_some_map(&path("map.ply"), DVec3::ZERO);
    let (map, truth) = (argument("map.ply"), argument("elsewhere"));
    let evaluate = ["evaluate", &map, "--truth", &truth, "--aligned"];
    let mut judged = Program::echosplat(&[&evaluate[..], &["--json"]].concat());
    judged.wait_exit_code(0, LONG);
    let said = judged.only_json();
    let (raw, aligned) = (&said["accuracy_m"], &said["aligned"]["accuracy_m"]);
    let is_nearer = aligned
        .as_f64()
        .zip(raw.as_f64())
        .is_some_and(|(a, b)| a <= b);
    assert!(is_nearer, "{}", judged.account());
    let mut told = Program::echosplat(&evaluate);
    told.wait_exit_code(0, LONG);
    assert!(
        told.stdout().contains("moved onto the truth"),
        "{}",
        told.account()
    );
}

/// Also a map that asserts nothing, which would not take an earlier one's place.
#[test]
fn a_map_whose_place_has_become_a_directory_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (map, log) = (path("map.ply"), path("log"));
    let files = ["--map", &map, "--record", &log];
    let slowly = [
        "--no-publish",
        "--rate",
        "1",
        "--duration",
        "3",
        "--verbose",
    ];
    let mut program = Program::echosplat(&replay(&[&files[..], &slowly].concat()));
    // It was looked at the place for the last time before this.
    program.wait_for_text("pings_mapped=", LONG);
    fs::create_dir(&map).unwrap();
    program.wait_exit_code(1, LONG);
    let told = program.stderr();
    let last = told.lines().last().unwrap_or_default();
    assert!(last.contains("map.ply: it is a directory"), "{told}");
    let left = fs::read_dir(&map).unwrap().count();
    assert_eq!(left, 0, "{}", program.account());
}
