//! A map's surface: made, judged and refused by the program.

use std::fs;
use std::path::Path;
use std::time::Duration;

use echosplat_model::glam::{DVec3, Quat, Vec3};
use echosplat_model::{Gaussian, Standing};
use echosplat_recording::ply::{MapNotes, write_map};

use crate::harness::Program;

const LONG: Duration = Duration::from_secs(120);

fn run(arguments: &[&str], exit_code: i32) -> Program {
    let mut program = Program::echosplat(arguments);
    program.wait_exit_code(exit_code, LONG);
    program
}

/// A wall of 1 m² at y = 2, every 2.5 cm a Gaussian that is off by a centimetre to and fro; beside it
/// as many ambiguous ones.
fn write_wall(path: &Path, origin_m: DVec3) {
    let wall = (0..80 * 40).map(|number: u16| {
        let (column, row) = (number % 80, number / 80);
        let off_m = if (column + row) % 2 == 0 { 0.01 } else { -0.01 };
        let mean_m = Vec3::new(
            f32::from(column) * 0.025,
            2.0 + off_m,
            f32::from(row) * 0.025,
        );
        Gaussian {
            id: number.into(),
            mean_m,
            rotation: Quat::IDENTITY,
            scale_m: Vec3::splat(0.03),
            opacity: 0.1,
            reflectivity: 0.01,
            sigma_m: 0.05,
            position_covariance_m2: Gaussian::known_alike_m2(0.05),
            probability: 1.0,
            standing: match column < 40 {
                true => Standing::Confident,
                false => Standing::Ambiguous,
            },
            why: echosplat_model::Why::default(),
        }
    });
    let wall: Vec<Gaussian> = wall.collect();
    let written = write_map(path, origin_m, 1.0, &wall, &MapNotes::default());
    written.expect("the test's own folder can be written to");
}

#[test]
fn a_surface_is_judged_beside_its_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (map, truth) = (path("map.ply"), path("scene.toml"));
    let scene = "name = \"wall\"\n[[box]]\ncenter_m = [100, 202.5, -19.5]\nsize_m = [20, 1, 3]\n";
    fs::write(&truth, scene).unwrap();
    write_wall(Path::new(&map), DVec3::new(100.0, 200.0, -20.0));
    for mesh in [path("surface.ply"), path("surface.obj")] {
        let said = run(&["export", &map, &mesh, "--mesh"], 0);
        assert!(said.stdout().contains("triangles"), "{}", said.account());
        let judge = [
            "evaluate", &map, "--truth", &truth, "--mesh", &mesh, "--json",
        ];
        let judged = run(&judge, 0).only_json()["mesh"].clone();
        let number = |name: &str| judged[name].as_f64().unwrap_or(f64::NAN);
        assert!((number("area_m2") - 1.0).abs() < 0.1, "{judged}");
        assert!(number("accuracy_ratio") < 0.5, "{judged}");
        assert!(number("false_area_share") < 1e-9, "{judged}");
        assert!(number("bare_area_share") < 1e-9, "{judged}");
    }
    let head = fs::read(path("surface.ply")).unwrap();
    let head = String::from_utf8_lossy(&head[..400]).into_owned();
    assert!(head.contains("property float sigma\n"), "{head}");
}

#[test]
fn what_makes_no_surface_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (map, mesh) = (path("map.ply"), path("mesh.ply"));
    let notes = MapNotes::default();
    write_map(Path::new(&map), DVec3::ZERO, 1.0, &[], &notes).unwrap();
    let empty = run(&["export", &map, &mesh, "--mesh"], 0);
    assert!(
        empty.stderr().contains("no surface in 0"),
        "{}",
        empty.account()
    );
    let head = fs::read_to_string(&mesh).unwrap();
    assert!(head.contains("element vertex 0\n"), "{head}");

    write_wall(Path::new(&map), DVec3::ZERO);
    for (arguments, told) in [
        (&["mesh.obj"][..], "--mesh makes them"),
        (&["mesh.splat", "--mesh"], ".ply, .obj or .glb"),
        (&["mesh.ply", "--mesh", "--all"], "cannot be used with"),
        (&["mesh.ply", "--mesh", "--cell", "1e-6"], "0.005 to 5 m"),
        (&["mesh.ply", "--cell", "0.1"], "--mesh"),
        (&["map.npz", "--crs", "EPSG:32635"], "--crs is for"),
        (&["map.pcd", "--track", "poses.tum"], "--track is for"),
        (
            &["map.splat", "--origin", "60,25,0"],
            "--origin and --heading",
        ),
        (&["map.ply", "--separation", "18"], "--separation is for"),
        (&["map.las", "--up", "y"], "--up is for"),
    ] {
        let out = path(arguments[0]);
        let refused = run(&[&["export", &map, &out], &arguments[1..]].concat(), 2);
        assert!(refused.stderr().contains(told), "{}", refused.account());
    }
}
