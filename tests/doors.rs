//! One rule of what a Gaussian is, whichever way it comes in: by the bus into `watch`, or by a file into
//! every command that reads maps.

use std::fs;
use std::time::Duration;

use echosplat_bus::point_cloud;
use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{Gaussian, Standing, Timestamp};
use echosplat_recording::ply::{self, MapFile, read_map};
use serde_json::json;
use zenoh::Wait;
use zenoh::query::Query;

use crate::harness::{Program, free_port};

const LONG: Duration = Duration::from_secs(60);

fn sound(id: u32) -> Gaussian {
    Gaussian {
        id,
        mean_m: Vec3::new(id as f32 * 0.1, 2.0, 0.0),
        rotation: Quat::IDENTITY,
        scale_m: Vec3::splat(0.05),
        opacity: 0.5,
        reflectivity: 0.1,
        sigma_m: 0.05,
        position_covariance_m2: Gaussian::known_alike_m2(0.05),
        probability: 1.0,
        standing: Standing::Confident,
        why: echosplat_model::Why::default(),
    }
}

type Change = fn(&mut Gaussian, f32);

/// Every number of a Gaussian.
const FIELDS: [(&str, Change); 15] = [
    ("x", |g, v| g.mean_m.x = v),
    ("z", |g, v| g.mean_m.z = v),
    ("scale_0", |g, v| g.scale_m.x = v),
    ("scale_2", |g, v| g.scale_m.z = v),
    ("rotation", |g, v| {
        g.rotation = Quat::from_xyzw(0.0, 0.0, 0.0, v);
    }),
    ("rot_1", |g, v| g.rotation.x = v),
    ("opacity", |g, v| g.opacity = v),
    ("reflectivity", |g, v| g.reflectivity = v),
    ("sigma", |g, v| g.sigma_m = v),
    ("cov_xx", |g, v| g.position_covariance_m2[0] = v),
    ("cov_xy", |g, v| g.position_covariance_m2[1] = v),
    ("cov_zz", |g, v| g.position_covariance_m2[5] = v),
    ("probability", |g, v| g.probability = v),
    ("all rotation", |g, v| {
        g.rotation = Quat::from_xyzw(v, v, v, v);
    }),
    ("all scales", |g, v| g.scale_m = Vec3::splat(v)),
];

fn values() -> impl Iterator<Item = f32> {
    let subnormal = f32::MIN_POSITIVE / 4.0;
    let all = [
        f32::NAN,
        f32::INFINITY,
        f32::MAX,
        3e38,
        1e9,
        2.0,
        0.5,
        subnormal,
        0.0,
    ];
    all.into_iter().flat_map(|value| [value, -value])
}

/// Every field with every value, beside as many that are sound.
fn strange() -> Vec<Gaussian> {
    let mut gaussians = Vec::new();
    for (_, change) in FIELDS {
        for value in values() {
            let id = gaussians.len() as u32;
            gaussians.push(sound(id));
            let mut odd = sound(id + 1);
            change(&mut odd, value);
            gaussians.push(odd);
        }
    }
    gaussians
}

/// A service that answers with these Gaussians, whatever they are.
fn serve(port: u16, gaussians: &[Gaussian]) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let endpoint = format!("[\"tcp/127.0.0.1:{port}\"]");
    for (key, value) in [
        ("listen/endpoints", endpoint.as_str()),
        ("scouting/multicast/enabled", "false"),
    ] {
        config
            .insert_json5(key, value)
            .expect("zenoh has the setting");
    }
    let session = zenoh::open(config).wait().expect("zenoh opens");
    let payload = point_cloud::encode(gaussians, Timestamp::ZERO, "map");
    let attachment = json!({
        "epoch": 1, "sequence": 1, "tile": "0_0_0", "chunk": 0, "chunks": 1, "removed": [],
        "through_ping": 1, "time_ns": 1, "origin_m": [0.0, 0.0, 0.0], "intensity_unit": 1.0,
        "final": true, "part": 0, "parts": 1
    });
    let key = "echosplat/odd/map/snapshot";
    let answer = move |query: Query| {
        let reply = query.reply(key, payload.clone());
        let reply = reply.attachment(attachment.to_string());
        reply.wait().expect("whoever asked is there");
    };
    let queryable = session.declare_queryable(key).callback(answer);
    queryable.background().wait().expect("it can be asked");
    session
}

#[test]
fn watch_saves_nothing_that_info_refuses_and_says_what_it_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let port = free_port();
    let gaussians = strange();
    let _service = serve(port, &gaussians);
    let connect = format!("connect/endpoints=[\"tcp/127.0.0.1:{port}\"]");
    let map = path("map.ply");
    let mut watch = Program::echosplat(&[
        "watch",
        "--node",
        "odd",
        "--until-final",
        "--map",
        &map,
        "--zenoh",
        &connect,
    ]);
    watch.wait_exit_code(3, LONG);
    let said = watch.stdout();
    assert!(
        said.contains("Gaussian was left out that cannot be"),
        "{}",
        watch.account()
    );
    let saved = read_map(map.as_ref()).unwrap();
    assert_eq!(saved.refused.count, 0, "{}", saved.refused);
    assert!(saved.gaussians.len() >= gaussians.len() / 2);
    assert!(saved.gaussians.len() < gaussians.len());
    for command in [
        &["info", &map][..],
        &["export", &map, &path("a.splat")],
        &["export", &map, &path("a.npz")],
        &["export", &map, &path("a.pcd")],
        &["export", &map, &path("a.ply")],
        &["export", &map, &path("mesh.ply"), "--mesh"],
    ] {
        Program::echosplat(command).wait_exit_code(0, LONG);
    }
    let exported = ply::read(&fs::read(path("a.ply")).unwrap()[..]).unwrap();
    assert_eq!(exported.refused.count, 0, "{}", exported.refused);
    assert_eq!(exported.gaussians.len(), saved.gaussians.len());
}

/// A map of other programs: rows as they come, one of them odd.
fn map_with(row: &[f32; 11]) -> Vec<u8> {
    let names = [
        "x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",
        "rot_3",
    ];
    let good = [1.0, 2.0, 0.0, 0.0, -3.0, -3.0, -3.0, 1.0, 0.0, 0.0, 0.0];
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n".to_vec();
    for name in names {
        bytes.extend(format!("property float {name}\n").bytes());
    }
    bytes.extend(b"end_header\n");
    let rows = [&good, row, &good].into_iter().flatten();
    bytes.extend(rows.flat_map(|value| value.to_le_bytes()));
    bytes
}

#[test]
fn every_command_that_reads_a_map_leaves_out_the_same_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (map, scene, poses) = (path("map.ply"), path("scene.toml"), path("poses.tum"));
    let wall = "name = \"wall\"\n[[box]]\ncenter_m = [0, 2.5, 0]\nsize_m = [20, 1, 3]\n";
    fs::write(&scene, wall).unwrap();
    fs::write(&poses, "0 0 0 0 0 0 0 1\n").unwrap();
    let zero_rotation = [1.0, 2.0, 0.0, 0.0, -3.0, -3.0, -3.0, 0.0, 0.0, 0.0, 0.0];
    let far = [3e38, 2.0, 0.0, 0.0, -3.0, -3.0, -3.0, 1.0, 0.0, 0.0, 0.0];
    for (row, words) in [
        (zero_rotation, "no quaternion with a length"),
        (far, "100000 m"),
    ] {
        fs::write(&map, map_with(&row)).unwrap();
        for command in [
            &["info", &map][..],
            &["export", &map, &path("a.splat")],
            &["export", &map, &path("a.npz")],
            &["export", &map, &path("a.pcd")],
            &["export", &map, &path("a.ply")],
            &["export", &map, &path("mesh.ply"), "--mesh"],
            &["evaluate", &map, "--truth", &scene],
            &["render", &map, "--poses", &poses, "--json"],
        ] {
            let mut program = Program::echosplat(command);
            program.wait_exit_code(3, LONG);
            let said = program.stdout() + &program.stderr();
            let is_named = said.contains("vertex 1 is no Gaussian") && said.contains(words);
            assert!(is_named, "{}", program.account());
        }
        let exported = ply::read(&fs::read(path("a.ply")).unwrap()[..]).unwrap();
        assert_eq!((exported.gaussians.len(), exported.refused.count), (2, 0));
        assert_eq!(fs::metadata(path("a.splat")).unwrap().len(), 2 * 32);
    }
    // Of what is no map at all nothing is made.
    let none = MapFile {
        gaussians: vec![sound(0)],
        ..MapFile::default()
    };
    let mut bytes = Vec::new();
    ply::write(&none, &mut bytes).unwrap();
    let row = bytes.len() - ply::ROW_BYTES;
    bytes[row..row + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&map, bytes).unwrap();
    let mut refused = Program::echosplat(&["export", &map, &path("b.splat")]);
    refused.wait_exit_code(2, LONG);
    assert!(
        refused.stderr().contains("none of its 1 vertices"),
        "{}",
        refused.account()
    );
}
