use super::*;
use crate::random::{Purpose, Random};

fn scene(toml: &str) -> Scene {
    Scene::parse(toml, None).unwrap()
}

const SOLIDS: [(&str, &str); 6] = [
    ("sphere", "[[sphere]]\ncenter_m = [1, 2, 3]\nradius_m = 0.7"),
    (
        "capsule",
        "[[capsule]]\nfrom_m = [1, 2, 3]\nto_m = [2, 1, 4]\nradius_m = 0.4",
    ),
    (
        "cylinder",
        "[[cylinder]]\nfrom_m = [1, 2, 3]\nto_m = [2, 1, 4]\nradius_m = 0.4",
    ),
    (
        "box",
        "[[box]]\ncenter_m = [1, 2, 3]\nsize_m = [1, 0.5, 2]\nyaw_pitch_roll_deg = [30, 20, 10]",
    ),
    (
        "plane",
        "[[plane]]\npoint_m = [0, 0, 2]\nnormal = [0.1, 0.2, 1]",
    ),
    (
        "height field",
        "[[height_field]]\ncenter_m = [1, 2, 3]\nsize_m = [2, 3]\ncell_m = 0.2\n\
         waves = [{ amplitude_m = 0.2, wavelength_m = 1.5, heading_deg = 30 }]",
    ),
];

fn solid(entry: &str) -> Scene {
    scene(&format!("name = \"s\"\n{entry}"))
}

fn around(random: &mut Random, reach_m: f64) -> DVec3 {
    let mut offset = || random.between(-reach_m, reach_m);
    DVec3::new(1.0 + offset(), 2.0 + offset(), 3.0 + offset())
}

#[test]
fn the_distance_of_each_solid_is_that_to_a_dense_sample_of_it() {
    for (name, entry) in SOLIDS {
        let scene = solid(entry);
        let spacing_m = 0.03;
        let sample = scene.sample_surface(spacing_m, 1);
        assert!(sample.len() > 500, "{name}: {}", sample.len());
        let mut random = Random::new(1, Purpose::Plan, 0);
        for _ in 0..200 {
            let point = around(&mut random, 1.5);
            let distance_m = scene.distance(point);
            let sampled_m = sample
                .iter()
                .map(|place| place.position.distance(point))
                .fold(f64::INFINITY, f64::min);
            // The sample is on the surface, so never nearer; and dense, so not much farther.
            assert!(sampled_m > distance_m - 1e-9, "{name} at {point}");
            assert!(
                sampled_m < distance_m + 2.5 * spacing_m,
                "{name} at {point}"
            );
        }
    }
}

#[test]
fn samples_lie_on_the_surface_and_their_normals_point_out_of_it() {
    for (name, entry) in SOLIDS {
        let scene = solid(entry);
        for place in scene.sample_surface(0.1, 2) {
            let (distance_m, normal, _) = scene.nearest(place.position + place.normal * 1e-4);
            assert!((distance_m - 1e-4).abs() < 1e-9, "{name}: {distance_m}");
            assert!(normal.dot(place.normal) > 0.99, "{name}");
            assert!(!scene.contains(place.position + place.normal * 1e-4, 0.0));
        }
    }
}

#[test]
fn a_cast_ends_on_the_surface_and_crosses_none_before() {
    for (name, entry) in SOLIDS {
        let scene = solid(entry);
        let mut random = Random::new(2, Purpose::Plan, 0);
        let mut hits = 0;
        for _ in 0..2000 {
            let origin = around(&mut random, 4.0);
            let target = around(&mut random, 1.0);
            let direction = (target - origin).normalize();
            let hit = scene.cast(origin, direction, 20.0);
            // March by the exact distance: it cannot pass a surface.
            let mut marched_m = 0.0;
            for _ in 0..4000 {
                let step_m = scene.distance(origin + direction * marched_m);
                marched_m += step_m;
                if step_m < 1e-7 || marched_m > 20.0 {
                    break;
                }
            }
            match hit {
                Some(hit) => {
                    hits += 1;
                    assert!(scene.distance(hit.position) < 1e-9, "{name}");
                    let short_m = hit.distance_m - marched_m;
                    assert!(short_m.abs() < 1e-3, "{name}: {short_m}");
                    assert!((hit.normal.length() - 1.0).abs() < 1e-9);
                }
                None => assert!(marched_m > 19.9, "{name}: {marched_m}"),
            }
        }
        assert!(hits > 100, "{name}: {hits}");
    }
}

#[test]
fn the_tree_agrees_with_looking_at_every_part() {
    let truss = Scene::named("truss").unwrap();
    let mut random = Random::new(3, Purpose::Plan, 0);
    for _ in 0..3000 {
        let origin = around(&mut random, 30.0);
        let direction = (around(&mut random, 15.0) - origin).normalize();
        let all = truss
            .parts
            .iter()
            .filter_map(|part| part.shape.cast(origin, direction, 100.0))
            .map(|crossing| crossing.distance)
            .fold(f64::INFINITY, f64::min);
        let hit_m = truss
            .cast(origin, direction, 100.0)
            .map_or(f64::INFINITY, |h| h.distance_m);
        assert_eq!(hit_m.to_bits(), all.to_bits());
        let nearest_m = truss
            .parts
            .iter()
            .map(|part| part.shape.closest(origin).signed)
            .fold(f64::INFINITY, f64::min);
        if nearest_m > 0.0 {
            assert_eq!(truss.distance(origin).to_bits(), nearest_m.to_bits());
        }
    }
}

#[test]
fn the_same_scene_far_away_is_the_same_to_a_micrometre() {
    // Inside the rod the ray leaves by its far side.
    let place = DVec3::new(1e6, -2e6, 30.0);
    let far = solid(&format!(
        "[[sphere]]\ncenter_m = [{}, {}, {}]\nradius_m = 0.5",
        place.x, place.y, place.z
    ));
    let hit = far.cast(place - DVec3::X * 7.0, DVec3::X, 10.0).unwrap();
    assert!((hit.distance_m - 6.5).abs() < 1e-6);
    assert!(far.cast(place - DVec3::X * 7.0, DVec3::X, 6.4).is_none());
    let inside = far.cast(place, DVec3::Y, 10.0).unwrap();
    assert!((inside.distance_m - 0.5).abs() < 1e-6);
}

#[test]
fn what_is_buried_is_no_surface() {
    let scene = scene(
        "name = \"t\"\n\
         [[plane]]\npoint_m = [0, 0, 0]\n\
         [[cylinder]]\nfrom_m = [0, 0, -1]\nto_m = [0, 0, 2]\nradius_m = 0.2\n\
         [[sphere]]\ncenter_m = [0, 0, 2]\nradius_m = 0.3",
    );
    for place in scene.sample_surface(0.05, 1) {
        assert!(
            place.position.z > -1e-6,
            "below the floor: {}",
            place.position
        );
        let across = place.position.truncate().length();
        assert!(
            across > 0.2 - 1e-6 || place.position.z > 2.2,
            "{}",
            place.position
        );
    }
    // Inside the union, 0.1 m below the sphere's middle: the rod's side is 0.2 m away but buried
    // there; the sphere's surface is √(0.3²) − 0.1 … at its bottom buried too, so its side counts.
    let (inside_m, _, _) = scene.nearest(DVec3::new(0.05, 0.0, 1.95));
    assert!(inside_m > 0.22, "{inside_m}");
    // Below the floor, beside the buried end of the rod, only the floor is there.
    let (below_m, _, is_seabed) = scene.nearest(DVec3::new(0.3, 0.0, -0.5));
    assert!(is_seabed && (below_m - 0.5).abs() < 1e-12);
    // Inside the rod's buried end, only the crease around its foot is.
    let (foot_m, _, is_seabed) = scene.nearest(DVec3::new(0.15, 0.0, -0.1));
    assert!(
        !is_seabed && (foot_m - 0.05f64.hypot(0.1)).abs() < 1e-6,
        "{foot_m}"
    );
}

#[test]
fn the_built_in_scenes_are_what_their_names_say() {
    for (name, _) in BUILT_IN_SCENES {
        let scene = Scene::named(name).unwrap();
        assert_eq!(scene.name(), name);
        assert_eq!(scene.is_empty(), name == "empty");
        let stands_on_it = name.starts_with("pi") || matches!(name, "dolphin" | "quay-corner");
        assert_eq!(scene.has_seabed(), stands_on_it, "{name}");
    }
    let bounds = |name: &str| Scene::named(name).unwrap().bounds().unwrap();
    let (low, high) = bounds("fence");
    assert!(high.distance(DVec3::new(3.1, 0.1, 2.0)) < 1e-9);
    assert!(low.distance(DVec3::new(-3.1, -0.1, -2.0)) < 1e-9);
    let (low, high) = bounds("truss");
    assert!((high - low).distance(DVec3::new(20.6, 20.6, 40.4)) < 1e-9);
    assert_eq!(
        Scene::named("truss").unwrap().parts.len(),
        4 + 5 * 4 + 4 * 4
    );
    let specular = Scene::named("fence-specular").unwrap();
    let plain = Scene::named("fence").unwrap();
    assert_eq!(specular.parts.len(), plain.parts.len());
    assert!(
        specular
            .parts
            .iter()
            .all(|part| part.material.specular > 1.0)
    );
}

#[test]
fn the_span_of_the_pipe_is_free_and_the_rest_is_not() {
    let scene = Scene::named("pipeline").unwrap();
    let under = |x: f64| {
        let pipe = scene
            .cast(DVec3::new(x, 0.0, 0.0), -DVec3::Z, 10.0)
            .unwrap();
        assert!(!pipe.is_seabed);
        let bottom = pipe.position - DVec3::Z * 0.3505;
        let ground = scene.cast(bottom, -DVec3::Z, 10.0);
        ground.map_or(0.0, |hit| hit.distance_m)
    };
    assert!(under(0.0) > 0.25);
    assert!(under(6.5) < 0.1 || under(6.5) > 5.0);
}

fn message(toml: &str) -> String {
    match Scene::parse(toml, None) {
        Ok(_) => panic!("taken: {toml}"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn errors_name_line_and_key_and_what_is_allowed() {
    for (toml, words) in [
        (
            "name = \"a\"\n[[sphere]]\ncenter_m = [0, 0, 0]\nradius = 1",
            vec!["line 4", "radius", "radius_m"],
        ),
        (
            "name = \"a\"\n[[sphere]]\ncenter_m = [0, 0, 0]\nradius_m = -1",
            vec!["line 4", "-1", "allowed"],
        ),
        (
            "name = \"a\"\n[[sphere]]\ncenter_m = [0, nan, 0]\nradius_m = 1",
            vec!["line 3", "NaN", "allowed"],
        ),
        ("name = \"a\"\n[[sphere]]\nradius_m = 1", vec!["center_m"]),
        (
            "name = \"a\"\n[[torus]]\nradius_m = 1",
            vec!["line 2", "torus", "cylinder"],
        ),
        (
            "name = \"a\"\n\n[[capsule]]\nfrom_m = [1, 1, 1]\nto_m = [1, 1, 1]\nradius_m = 1",
            vec!["line 3", "from_m", "sphere"],
        ),
        (
            "name = \"a\"\n[[box]]\ncenter_m = [0, 0, 0]\nsize_m = [1, 1, 1]\nreflectivity = 2",
            vec!["line 5", "2", "0 to 1"],
        ),
        (
            "name = \"a\"\n[[height_field]]\ncenter_m = [0, 0, 0]\nsize_m = [1e4, 1e4]\ncell_m = 0.01",
            vec!["line 2", "cell_m", "1000000"],
        ),
        (
            "name = \"a\"\n[[plane]]\npoint_m = [0, 0, 0]\nnormal = [0, 0, 0]",
            vec!["line 4", "normal"],
        ),
        ("[[plane]]\npoint_m = [0, 0, 0]", vec!["name"]),
    ] {
        let message = message(toml);
        for word in words {
            assert!(message.contains(word), "`{word}` is not in: {message}");
        }
    }
    assert!(matches!(
        Scene::named("gate"),
        Err(SceneError::UnknownName { .. })
    ));
    let missing = Scene::load("/nonexistent/scene.toml").err().unwrap();
    assert!(missing.to_string().contains("/nonexistent/scene.toml"));
}

#[test]
fn a_mesh_is_found_beside_its_scene_and_placed() {
    let dir = tempfile::tempdir().unwrap();
    let obj = "v 0 0 0\nv 100 0 0\nv 100 100 0\nv 0 100 0\nf 1 2 3 4\n";
    std::fs::write(dir.path().join("plate.OBJ"), obj).unwrap();
    let toml = "name = \"m\"\n[[mesh]]\nfile = \"plate.OBJ\"\nscale = 0.01\n\
                translation_m = [5, 0, 0]\nyaw_pitch_roll_deg = [90, 0, 0]\nreflectivity = 0.5";
    let path = dir.path().join("scene.toml");
    std::fs::write(&path, toml).unwrap();
    let scene = Scene::load(&path).unwrap();
    // Turned by 90° the plate covers x from 4 to 5 and y from 0 to 1.
    let hit = scene
        .cast(DVec3::new(4.5, 0.5, 3.0), -DVec3::Z, 10.0)
        .unwrap();
    assert!((hit.distance_m - 3.0).abs() < 1e-12 && hit.normal.z > 0.99);
    assert!((hit.reflectivity - 0.5).abs() < 1e-12);
    assert!(
        scene
            .cast(DVec3::new(5.5, 0.5, 3.0), -DVec3::Z, 10.0)
            .is_none()
    );
    let bare = Scene::from_mesh(dir.path().join("plate.OBJ")).unwrap();
    assert!((bare.distance(DVec3::new(50.0, 50.0, 7.0)) - 7.0).abs() < 1e-12);
    let missing = Scene::parse(toml, Some(&dir.path().join("elsewhere")))
        .err()
        .unwrap();
    assert!(missing.to_string().contains("plate.OBJ"), "{missing}");
}

#[test]
fn inside_a_joint_the_way_out_is_through_the_solids_that_join() {
    let truss = Scene::named("truss").unwrap();
    // In a leg, where a brace and a horizontal end in it; and in a horizontal, where the walk goes to
    // and fro between it and a brace.
    for place in [
        DVec3::new(9.776, -9.926, 10.089),
        DVec3::new(9.282_375, -9.984_904, -9.917_978),
    ] {
        let (distance_m, ..) = truss.nearest(place);
        assert!(distance_m < 0.35, "{place}: {distance_m}");
    }
}

#[test]
fn no_way_out_of_a_joint_is_shorter_than_the_sampled_one() {
    let crossing = scene(
        "name = \"s\"\n[[cylinder]]\nfrom_m = [-1, 0, 0]\nto_m = [1, 0, 0]\nradius_m = 0.2\n\
         [[cylinder]]\nfrom_m = [0, -1, 0]\nto_m = [0, 1, 0]\nradius_m = 0.2",
    );
    let surface = crossing.sample_surface(0.02, 1);
    let mut random = Random::new(1, Purpose::Surface, 0);
    for _ in 0..200 {
        let mut offset = || random.between(-0.19, 0.19);
        let point = DVec3::new(offset(), offset(), offset());
        let (found_m, ..) = crossing.nearest(point);
        let sampled = surface.iter().map(|s| s.position.distance(point));
        let shortest_m = sampled.fold(f64::INFINITY, f64::min);
        assert!(
            found_m > shortest_m - 0.03 && found_m < shortest_m + 0.2,
            "{point}: {found_m} against {shortest_m}"
        );
    }
}
