use std::sync::Arc;

use echosplat_simulator::{Scene, SurfacePoint};
use glam::DQuat;

use super::*;

fn at(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

fn map(positions: &[DVec3]) -> MapPoints {
    MapPoints::of_positions(positions.iter().copied())
}

fn near(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

fn scene(toml: &str) -> Arc<Scene> {
    let toml = format!("name = \"test\"\n{toml}");
    Arc::new(Scene::parse(&toml, None).unwrap())
}

fn seen(position: DVec3, is_seabed: bool) -> SurfacePoint {
    SurfacePoint {
        position,
        normal: DVec3::Z,
        is_seabed,
    }
}

/// A ball of radius 1 at the origin.
fn ball() -> Arc<Scene> {
    scene("[[sphere]]\ncenter_m = [0, 0, 0]\nradius_m = 1.0\n")
}

#[test]
fn distances_are_those_worked_out_by_hand() {
    // Truth → map: 0, 1 and 2 m. Map → truth: 0 and 0.5 m.
    let truth = Truth::from_points(&[at(0., 0., 0.), at(1., 0., 0.), at(2., 0., 0.)]);
    let metrics = evaluate_raw(&map(&[at(0., 0., 0.), at(0., 0.5, 0.)]), &truth);
    assert!(near(metrics.accuracy_m, 0.25));
    assert!(near(metrics.completeness_m, 1.0));
    assert!(near(metrics.cd_m, 0.625) && near(metrics.cd_sum_m, 1.25));
    assert!(near(metrics.hd_m, 2.0));
    assert!(near(metrics.map_to_truth.max_m, 0.5) && near(metrics.p95_m, 2.0));
    assert!(near(metrics.precision_5cm, 0.5) && near(metrics.recall_5cm, 1.0 / 3.0));
    assert!(near(metrics.f_5cm, 0.4));
    assert!(near(metrics.confident_false_share, 0.5));
    assert_eq!(metrics.confident_false_count, 1);
    assert_eq!((metrics.point_count, metrics.truth_sample_count), (2, 3));
}

#[test]
fn swapping_map_and_truth_swaps_accuracy_and_completeness() {
    let a = [at(0., 0., 0.), at(1., 2., 0.), at(4., 0., 1.)];
    let b = [at(0.1, 0., 0.), at(3., 0., 1.)];
    let forth = evaluate_raw(&map(&a), &Truth::from_points(&b));
    let back = evaluate_raw(&map(&b), &Truth::from_points(&a));
    assert!(near(forth.accuracy_m, back.completeness_m));
    assert!(near(forth.completeness_m, back.accuracy_m));
    assert!(near(forth.cd_m, back.cd_m) && near(forth.hd_m, back.hd_m));
    assert!(near(forth.f_10cm, back.f_10cm));
}

#[test]
fn an_empty_map_is_infinitely_wrong_and_null_in_json() {
    for (points, truth) in [
        (vec![], Truth::from_points(&[DVec3::ZERO])),
        (vec![DVec3::ZERO], Truth::from_points(&[])),
        (vec![], Truth::from_scene(&scene(""), None)),
    ] {
        let metrics = evaluate(&map(&points), &truth);
        assert!(metrics.cd_m.is_infinite() && metrics.hd_m.is_infinite());
        assert!(metrics.paper.is_none() && metrics.f_5cm < 1e-9);
        let json = serde_json::to_string(&metrics).unwrap();
        assert!(json.contains("\"cd_m\":null"), "{json}");
        assert_eq!(serde_json::from_str::<Metrics>(&json).unwrap(), metrics);
    }
    let nothing = evaluate(&map(&[]), &Truth::from_scene(&scene(""), None));
    assert!(near(nothing.confident_false_share, 0.0));
    let phantom = evaluate(&map(&[DVec3::ONE]), &Truth::from_scene(&scene(""), None));
    assert!(near(phantom.confident_false_share, 1.0));
}

#[test]
fn a_scenes_truth_is_exact_between_its_samples() {
    let truth = Truth::from_scene(&ball(), Some(vec![seen(at(0., 0., 1.), false)]));
    let inside = at(0.6, 0., 0.);
    let metrics = evaluate_raw(&map(&[at(0., 1.25, 0.), inside]), &truth);
    assert!(near(metrics.accuracy_m, (0.25 + 0.4) / 2.0));
    assert!(near(metrics.confident_false_share, 0.5));
    assert!(near(metrics.completeness_m, (1.0_f64 + 0.36).sqrt()));
}

#[test]
fn the_structure_is_the_headline_where_there_is_a_seabed() {
    let scene =
        scene("[[sphere]]\ncenter_m = [0, 0, 5]\nradius_m = 1.0\n[[plane]]\npoint_m = [0, 0, 0]\n");
    let samples = vec![seen(at(0., 0., 6.), false), seen(at(3., 0., 0.), true)];
    let truth = Truth::from_scene(&scene, Some(samples));
    let metrics = evaluate_raw(&map(&[at(0., 0., 6.1), at(3., 0., 0.2)]), &truth);
    assert!(near(metrics.accuracy_m, 0.1) && near(metrics.cd_m, 0.1));
    assert!(near(metrics.seabed.unwrap().cd_m, 0.2));
    assert!(near(metrics.whole.unwrap().cd_m, 0.15));
    assert_eq!(metrics.whole.unwrap().point_count, 2);
    let floor_only = evaluate_raw(&map(&[at(3., 0., 0.)]), &truth);
    assert!(floor_only.cd_m.is_infinite());
    assert!(near(floor_only.seabed.unwrap().cd_m, 0.0));
}

#[test]
fn normals_of_structure_and_seabed_are_told_apart() {
    let scene =
        scene("[[sphere]]\ncenter_m = [0, 0, 5]\nradius_m = 1.0\n[[plane]]\npoint_m = [0, 0, 0]\n");
    let samples = vec![seen(at(0., 0., 6.), false), seen(at(3., 0., 0.), true)];
    let truth = Truth::from_scene(&scene, Some(samples));
    let disc = |position, axis| MapPoint {
        position,
        shortest_axis: Some(axis),
    };
    let points = MapPoints {
        confident: vec![
            disc(at(0., 0., 6.), at(1., 0., 0.)),
            disc(at(3., 0., 0.), at(0., 0., 1.)),
            disc(at(4., 0., 0.), at(0., 0., -1.)),
        ],
        ..MapPoints::default()
    };
    let metrics = evaluate_raw(&points, &truth);
    let share = |normals: Option<Normals>| normals.unwrap().within_20deg_share;
    assert!(near(share(metrics.structure_normals), 0.0));
    assert!(near(share(metrics.seabed_normals), 1.0));
    assert!(near(share(metrics.normals), 2.0 / 3.0));
    let no_seabed = evaluate_raw(&points, &Truth::from_points(&[at(0., 0., 0.)]));
    assert_eq!(
        (no_seabed.structure_normals, no_seabed.seabed_normals),
        (None, None)
    );
}

#[test]
fn ambiguous_gaussians_cover_truth_and_assert_nothing() {
    let truth = Truth::from_points(&[at(0., 0., 0.), at(1., 0., 0.)]);
    let points = MapPoints {
        ambiguous: vec![at(0., 0.2, 0.), at(9., 9., 9.)],
        ..MapPoints::default()
    };
    let metrics = evaluate_raw(&points, &truth);
    assert!(near(metrics.ambiguous_cover_share, 0.5));
    assert!(near(metrics.confident_false_share, 0.0));
    assert_eq!((metrics.confident_count, metrics.ambiguous_count), (0, 2));
}

#[test]
fn flat_gaussians_are_asked_for_the_normal() {
    let tilted = |angle: f64| MapPoint {
        position: at(0., 0., 1.),
        shortest_axis: Some(DQuat::from_rotation_x(angle) * -DVec3::Z),
    };
    let dot = MapPoint {
        position: at(0., 1., 0.),
        shortest_axis: None,
    };
    let points = MapPoints {
        confident: vec![tilted(0.1), tilted(0.2), tilted(1.0), dot],
        ..MapPoints::default()
    };
    let normals = evaluate_raw(&points, &Truth::from_scene(&ball(), None))
        .normals
        .unwrap();
    assert!((normals.median_deg - 0.2_f64.to_degrees()).abs() < 1e-6);
    assert!(near(normals.within_20deg_share, 2.0 / 3.0));
    assert_eq!(normals.flat_count, 3);
}

#[test]
fn the_papers_protocol_forgives_a_shift_and_crops_and_the_headline_does_not() {
    let block = scene("[[box]]\ncenter_m = [0, 0, 0]\nsize_m = [2, 3, 4]\n");
    let truth = Truth::from_scene(&block, None);
    let shift = at(0.03, -0.02, 0.04);
    let samples = truth.seen().iter().step_by(7);
    let mut points: Vec<DVec3> = samples.map(|sample| sample.position + shift).collect();
    points.push(at(50., 0., 0.));
    let metrics = evaluate(&map(&points), &truth);
    let paper = metrics.paper.unwrap();
    assert!(metrics.hd_m > 40.0 && paper.hd_m < 0.3, "{paper:?}");
    assert!(paper.cd_m < metrics.cd_m && paper.cropped_count >= 1);
    assert!(paper.icp_iterations > 0);
}

#[test]
fn a_mesh_and_a_file_of_points_are_truths_too() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let mesh = file("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let truth = Truth::load(&mesh).unwrap();
    assert!(near(truth.nearest(at(0.2, 0.2, 0.5)).0, 0.5));
    let points = file("a.xyz", "0 0 0\n1 0 0\n");
    assert!(near(
        Truth::load(&points).unwrap().nearest(at(0., 2., 0.)).0,
        2.0
    ));
    let scene = file(
        "a.toml",
        "name = \"a\"\n[[sphere]]\ncenter_m = [0,0,0]\nradius_m = 1\n",
    );
    assert!(near(
        Truth::load(&scene).unwrap().nearest(at(0., 0., 3.)).0,
        2.0
    ));
    let wrong = Truth::load(&file("b.xyz", "1 2\n"))
        .err()
        .unwrap()
        .to_string();
    assert!(wrong.contains("b.xyz: line 1"), "{wrong}");
    assert!(Truth::load(&folder.path().join("none.ply")).is_err());
}
