//! A map's place on Earth: put in, told, and read back from what is exported, against PROJ 9.5.1 (pyproj 3.7.2).

use std::fs;
use std::path::Path;
use std::time::Duration;

use echosplat_model::glam::{DVec3, Quat, Vec3};
use echosplat_model::{Gaussian, Standing};
use echosplat_recording::ply::{MapNotes, read_map, write_map};
use serde_json::Value;

use crate::harness::Program;

const LONG: Duration = Duration::from_secs(120);

/// Of the map that is placed: its origin, and two Gaussians of it.
const ORIGIN_M: DVec3 = DVec3::new(100.0, -300.0, -7.0);
const SECOND_M: Vec3 = Vec3::new(20.0, -40.0, 0.0);

struct Known {
    /// `LAT,LON,ALT` of the world's origin.
    origin: &'static str,
    code: u64,
    /// East and north of the Gaussian 120 m east and 340 m south of it, metres.
    projected: (f64, f64),
    /// Its longitude and latitude, degrees.
    degrees: (f64, f64),
}

/// 60° north, south of the equator, and on the antimeridian.
const KNOWN: [Known; 3] = [
    Known {
        origin: "60.17,24.94,12.5",
        code: 32635,
        projected: (385_809.732_786, 6_671_783.248_757),
        degrees: (24.942_161_435_087, 60.166_948_335_278),
    },
    Known {
        origin: "-33.86,151.21,-8.25",
        code: 32756,
        projected: (334_542.287_799, 6_251_587.521_356),
        degrees: (151.211_296_841_048, -33.863_065_275_909),
    },
    Known {
        origin: "-16.79,179.9999,3",
        code: 32760,
        projected: (819_910.059_117, 8_140_913.954_305),
        degrees: (-179.998_974_316_820, -16.793_072_278_569),
    },
];

fn gaussian(mean_m: Vec3) -> Gaussian {
    Gaussian {
        id: 0,
        mean_m,
        rotation: Quat::IDENTITY,
        scale_m: Vec3::splat(0.05),
        opacity: 0.5,
        reflectivity: 0.1,
        sigma_m: 0.05,
        position_covariance_m2: Gaussian::known_alike_m2(0.05),
        probability: 0.9,
        standing: Standing::Confident,
        why: echosplat_model::Why::default(),
    }
}

fn write_a_map(path: &Path) {
    let places = [Vec3::ZERO, SECOND_M, Vec3::new(3.0, 5.0, -1.0)];
    let all = places.map(gaussian);
    let written = write_map(path, ORIGIN_M, 1.0, &all, &MapNotes::default());
    written.expect("the test's own folder can be written to");
}

fn done(arguments: &[&str]) -> Program {
    let mut program = Program::echosplat(arguments);
    program.wait_exit_code(0, LONG);
    program
}

/// Little-endian numbers at a place of a file.
fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

fn i32_at(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

/// East and north of the point with this number in a LAS file.
fn las_point(bytes: &[u8], number: usize) -> (f64, f64) {
    let first = i32_at(bytes, 96) as usize;
    let row_bytes = usize::from(u16::from_le_bytes([bytes[105], bytes[106]]));
    let row = first + number * row_bytes;
    let axis = |axis: usize| {
        let (scale, offset) = (f64_at(bytes, 131 + 8 * axis), f64_at(bytes, 155 + 8 * axis));
        f64::from(i32_at(bytes, row + 4 * axis)) * scale + offset
    };
    (axis(0), axis(1))
}

#[test]
fn a_map_that_is_placed_is_told_where_proj_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    for known in KNOWN {
        write_a_map(&folder.path().join("map.ply"));
        let before = read_map(&folder.path().join("map.ply")).unwrap();
        let told = done(&[
            "georeference",
            &path("map.ply"),
            "--origin",
            known.origin,
            "--json",
        ]);
        let told: Value = serde_json::from_str(&told.stdout()).unwrap();
        assert_eq!(told["epsg"], known.code, "{told}");
        let after = read_map(&folder.path().join("map.ply")).unwrap();
        assert_eq!(after.gaussians, before.gaussians);
        done(&["export", &path("map.ply"), &path("map.las")]);
        done(&["export", &path("map.ply"), &path("map.laz")]);
        done(&[
            "export",
            &path("map.ply"),
            &path("degrees.las"),
            "--crs",
            "EPSG:4326",
        ]);
        let bytes = fs::read(folder.path().join("map.las")).unwrap();
        let (east_m, north_m) = las_point(&bytes, 1);
        let off_m = (east_m - known.projected.0).hypot(north_m - known.projected.1);
        assert!(off_m < 0.001, "{}: {east_m} {north_m}", known.origin);
        let packed = fs::read(folder.path().join("map.laz")).unwrap();
        assert_eq!(&packed[..4], b"LASF");
        assert_eq!(packed[104], bytes[104] | 0x80);
        let bytes = fs::read(folder.path().join("degrees.las")).unwrap();
        let (east, north) = las_point(&bytes, 1);
        let off_deg = ((east - known.degrees.0).rem_euclid(360.0))
            .min((known.degrees.0 - east).rem_euclid(360.0));
        assert!(
            off_deg < 2e-9 && (north - known.degrees.1).abs() < 2e-9,
            "{east} {north}"
        );
    }
}

#[test]
fn grid_convergence_and_declination_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    write_a_map(&folder.path().join("map.ply"));
    let map = path("map.ply");
    let own = [
        "georeference",
        &map,
        "--origin",
        "60.17,24.94,0",
        "--date",
        "2026-11-30",
    ];
    let told = done(&own);
    for words in [
        "north of this grid is -1.787 degrees",
        "magnetic north is +",
        "on 2026-11-30",
    ] {
        assert!(told.stdout().contains(words), "{}", told.account());
    }
    let json = |more: &[&str]| -> Value {
        let told = done(&[&own[..], &["--json"], more].concat());
        serde_json::from_str(&told.stdout()).unwrap()
    };
    let declination_deg = json(&[])["declination_deg"].as_f64().unwrap();
    assert!((8.5..11.5).contains(&declination_deg), "{declination_deg}");
    let turned = json(&["--heading", "37", "--magnetic"])["x_heading_deg"]
        .as_f64()
        .unwrap();
    assert!((turned - 37.0 - declination_deg).abs() < 1e-6, "{turned}");
    let old = ["georeference", &map, "--date", "2019-01-01"];
    assert!(
        done(&old)
            .stdout()
            .contains("no declination for 2019-01-01")
    );
    let mut refused = Program::echosplat(&[&old[..], &["--heading", "37", "--magnetic"]].concat());
    refused.wait_exit_code(2, LONG);
    assert!(
        refused.stderr().contains("holds from 20"),
        "{}",
        refused.account()
    );
    let exported = done(&["export", &map, &path("map.las")]);
    assert!(
        exported.account().contains("whose north is -1.787 degrees"),
        "{}",
        exported.account()
    );
}

#[test]
fn ties_find_what_an_origin_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    write_a_map(&folder.path().join("map.ply"));
    // Places 100 m apart, whose latitudes are those of PROJ.
    let ties = [
        "0,0,0=60.17,24.94,0",
        "120,-340,-7=60.166948335278,24.942161435087,7",
        "0,100,0=60.170897552,24.94,0",
    ];
    let ties: Vec<&str> = ties.iter().flat_map(|tie| ["--tie", tie]).collect();
    let told = done(&[&["georeference", &path("map.ply"), "--json"], &ties[..]].concat());
    let told: Value = serde_json::from_str(&told.stdout()).unwrap();
    let heading = told["x_heading_deg"].as_f64().unwrap();
    assert!((heading - 90.0).abs() < 0.1, "{told}");
    let residuals = told["residuals_enu_m"].as_array().unwrap();
    let largest = residuals
        .iter()
        .flat_map(|r| r.as_array().unwrap())
        .map(|x| x.as_f64().unwrap().abs());
    assert!(largest.fold(0.0, f64::max) < 0.05, "{told}");
    // What is in the map is told again without asking for anything.
    let again = done(&["georeference", &path("map.ply")]);
    assert!(again.stdout().contains("3 ties"), "{}", again.account());
}

#[test]
fn a_dive_bears_the_place_that_its_owner_gave() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/sample-dive/");
    let (log, poses) = (format!("{sample}dive.svlog"), format!("{sample}poses.tum"));
    done(&[
        "replay",
        &log,
        "--poses",
        &poses,
        "--map",
        &path("map.ply"),
        "--finished-only",
        "--origin",
        "60.17,24.94,0",
        "--datum",
        "msl",
        "--heading",
        "37.5",
        "--record",
        &path("records"),
    ]);
    let map = read_map(&folder.path().join("map.ply")).unwrap();
    let place = map.notes.georeference.expect("the run was given one");
    assert!((place.x_heading_deg - 37.5).abs() < 1e-12);
    assert_eq!(place.datum.name(), "msl");
    for name in ["track.geojson", "track.kml", "track.csv", "track.tum"] {
        done(&["export", &path("map.ply"), &path(name), "--track", &poses]);
    }
    for (name, more) in [
        ("map.tif", None),
        ("map.glb", None),
        ("mesh.glb", Some("--mesh")),
    ] {
        let (map, out) = (path("map.ply"), path(name));
        let arguments = ["export", &map, &out].into_iter().chain(more);
        done(&arguments.collect::<Vec<_>>());
    }
    let shapes: Value =
        serde_json::from_slice(&fs::read(folder.path().join("track.geojson")).unwrap()).unwrap();
    let features = shapes["features"].as_array().unwrap();
    assert_eq!(features.len(), 2);
    assert_eq!(features[0]["geometry"]["type"], "LineString");
    assert_eq!(features[0]["properties"]["height_datum"], "msl");
    let track = fs::read_to_string(folder.path().join("track.csv")).unwrap();
    assert!(
        track.starts_with("time_s,latitude_deg,longitude_deg,height_msl_m"),
        "{track:.200}"
    );
    // The recording of the dive says it too: its map comes out placed again.
    let records = fs::read_dir(folder.path().join("records")).unwrap();
    let record = records.map(|entry| entry.unwrap().path()).next().unwrap();
    let record = record.display().to_string();
    done(&[
        "replay",
        &record,
        "--map",
        &path("again.ply"),
        "--finished-only",
    ]);
    let again = read_map(&folder.path().join("again.ply")).unwrap();
    assert_eq!(again.notes.georeference, Some(place));
}
