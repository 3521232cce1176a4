use std::io::Cursor;

use echosplat_georeference::{Crs, Datum, Georeference, Place};
use echosplat_model::glam::{DVec3, Vec3};
use echosplat_model::{Gaussian, Pose, StampedPose, Timestamp};
use serde_json::Value;

use super::*;
use crate::export::tests::map;
use crate::export::{write_gaussians_glb, write_mesh_glb};
use crate::ply::{MapFile, georeference_map, read_map, write_map};

fn at(latitude: f64, longitude: f64) -> Placed {
    let place = Place::new(latitude, longitude, 0.0).unwrap();
    Placed {
        crs: Crs::utm_of(&place).unwrap(),
        georeference: Georeference::at_origin(place, Datum::Surface, "test"),
    }
}

/// Places 10 m apart in a row to the east, and one below the first.
fn row_of(count: u16) -> MapFile {
    let one = map().gaussians[0];
    let gaussian = |i: u16| Gaussian {
        mean_m: Vec3::new(10.0 * f32::from(i), 0.0, -2.0),
        ..one
    };
    let below = Gaussian {
        mean_m: Vec3::new(0.0, 0.0, -9.0),
        ..one
    };
    MapFile {
        gaussians: (0..count).map(gaussian).chain([below]).collect(),
        ..MapFile::default()
    }
}

fn poses(x_m: &[f64]) -> Vec<StampedPose> {
    let pose = |(index, x): (usize, &f64)| StampedPose {
        time: Timestamp::from_millis(100 * index as i64),
        world_from_vehicle: Pose {
            translation_m: DVec3::X * *x,
            ..Pose::IDENTITY
        },
        uncertainty: None,
        epoch: 0,
    };
    x_m.iter().enumerate().map(pose).collect()
}

#[test]
fn a_cell_shows_its_highest_and_overviews_too() {
    let placed = at(60.0, 25.0);
    let raster = Raster::of(&row_of(100), &placed, 0.5).unwrap();
    assert_eq!(raster.cell_count(), 100);
    let [height_m, depth_m, ..] = raster.cells.values().next().unwrap();
    assert!((height_m + 2.0).abs() < 0.1 && (depth_m - 2.0).abs() < 0.1);
    let half = raster.halved();
    assert_eq!(half.cell_count(), 100);
    let mut bytes = Vec::new();
    write_geotiff(&raster, &placed, &mut bytes).unwrap();
    assert_eq!(&bytes[..8], b"II\x2a\0\x08\0\0\0");
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.contains("<Item name=\"HEIGHT_DATUM\">surface</Item>"));
    // The first directory says that another one, of the overview, follows.
    let count = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let next = 10 + 12 * count;
    assert!(u32::from_le_bytes(bytes[next..next + 4].try_into().unwrap()) > 0);
}

#[test]
fn a_raster_has_no_more_cells_than_memory() {
    let placed = at(60.0, 25.0);
    let mut wide = row_of(2);
    wide.gaussians[0].mean_m = Vec3::new(9_000.0, 9_000.0, 0.0);
    let refused = Raster::of(&wide, &placed, 0.01).unwrap_err();
    assert!(matches!(refused, RasterError::Large { .. }));
    let nothing = Raster::of(&MapFile::default(), &placed, 0.1);
    assert_eq!(nothing.unwrap_err(), RasterError::Empty);
}

#[test]
fn what_crosses_the_antimeridian_is_cut_there_in_geojson_and_whole_in_las() {
    let placed = at(-16.79, 179.9999);
    let features = features_of(
        &row_of(20),
        &poses(&[-40.0, -20.0, 20.0, 60.0]),
        &placed.georeference,
    );
    let mut bytes = Vec::new();
    write_geojson(&features, &mut bytes).unwrap();
    let document: Value = serde_json::from_slice(&bytes).unwrap();
    let track = &document["features"][0]["geometry"];
    assert_eq!(track["type"], "MultiLineString");
    let lines = track["coordinates"].as_array().unwrap();
    let ends: Vec<f64> = lines
        .iter()
        .flat_map(|line| line.as_array().unwrap())
        .map(|position| position[0].as_f64().unwrap())
        .collect();
    assert_eq!(ends.len(), 6);
    assert!(
        (ends[2] - 180.0).abs() < 1e-12 && (ends[3] + 180.0).abs() < 1e-12,
        "{ends:?}"
    );
    let degrees = Placed {
        crs: Crs::of_code(4326).unwrap(),
        ..placed
    };
    let map = row_of(20);
    let points = degrees.gaussians(&map).unwrap();
    let east = |index: usize| points[index].0.x;
    assert!(east(0) < 180.0 && east(19) > 180.0 && east(19) < 180.01);
}

#[test]
fn las_coordinates_lose_nothing() {
    let placed = at(60.0, 25.0);
    let map = row_of(50);
    for compression in [Compression::None, Compression::Laz] {
        let mut out = Cursor::new(Vec::new());
        write_las(&map, &placed, compression, &mut out).unwrap();
        let bytes = out.into_inner();
        assert_eq!(&bytes[..4], b"LASF");
        let count = u64::from_le_bytes(bytes[247..255].try_into().unwrap());
        assert_eq!(count, 51);
    }
    let points = placed.gaussians(&map).unwrap();
    let mut out = Cursor::new(Vec::new());
    write_las(&map, &placed, Compression::None, &mut out).unwrap();
    let bytes = out.into_inner();
    let first = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    let number = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    for (index, (at, _)) in points.iter().enumerate() {
        let row = first + 52 * index;
        for axis in 0..3 {
            let steps = i32::from_le_bytes(
                bytes[row + 4 * axis..row + 4 * axis + 4]
                    .try_into()
                    .unwrap(),
            );
            let told = f64::from(steps) * number(131 + 8 * axis) + number(155 + 8 * axis);
            assert!((told - at[axis]).abs() < 1e-4);
        }
    }
}

#[test]
fn a_track_has_latitude_and_true_heading() {
    let mut placed = at(60.0, 25.0);
    placed.georeference.x_heading_deg = 30.0;
    let mut bytes = Vec::new();
    write_track_csv(&poses(&[0.0, 10.0]), &placed, &mut bytes).unwrap();
    let text = String::from_utf8(bytes).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].starts_with(
        "time_s,latitude_deg,longitude_deg,height_surface_m,heading_deg,east_epsg32635"
    ));
    assert!(
        lines[1].starts_with("0,60.000000000,25.000000000,0.0000,30.000,"),
        "{}",
        lines[1]
    );
    let mut tum = Vec::new();
    write_track_tum(&poses(&[0.0]), &mut tum).unwrap();
    assert_eq!(crate::tum::read(&tum[..]).unwrap().poses.len(), 1);
}

#[test]
fn kml_says_what_heights_are_over() {
    let placed = at(60.0, 25.0);
    let features = features_of(&row_of(3), &[], &placed.georeference);
    assert!(features.is_empty(), "three in a row have no extent");
    let feature = Feature {
        name: "a < b & c".to_owned(),
        shape: Shape::Point(placed.georeference.place),
        facts: vec![("height_datum", "surface".into())],
    };
    let mut bytes = Vec::new();
    write_kml(&[feature], &mut bytes).unwrap();
    let text = String::from_utf8(bytes).unwrap();
    assert!(text.contains("a &lt; b &amp; c") && text.contains("height_datum: \"surface\""));
    assert!(text.contains("<coordinates>25.000000000,60.000000000,0.0000</coordinates>"));
}

fn glb_document(bytes: &[u8]) -> Value {
    assert_eq!(&bytes[..4], b"glTF");
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).unwrap()
}

#[test]
fn gaussians_in_gltf_are_points_too() {
    let mut map = row_of(2);
    map.gaussians[0].sigma_m = f32::INFINITY;
    map.notes.georeference = Some(at(60.0, 25.0).georeference);
    let mut bytes = Vec::new();
    write_gaussians_glb(&map, &mut bytes).unwrap();
    let document = glb_document(&bytes);
    let primitive = &document["meshes"][0]["primitives"][0];
    assert_eq!(primitive["mode"], 0);
    assert_eq!(
        document["accessors"][0]["max"],
        serde_json::json!([10.0, -2.0, 0.0])
    );
    assert!(primitive["attributes"]["KHR_gaussian_splatting:SCALE"].is_number());
    // Dark colours would lose their differences in bytes of light.
    let shown = primitive["attributes"]["COLOR_0"].as_u64().unwrap() as usize;
    let shown = &document["accessors"][shown];
    assert_eq!(
        (&shown["componentType"], &shown["normalized"]),
        (&5123.into(), &true.into())
    );
    assert!(
        document["asset"]["extras"]["georeference"]
            .as_str()
            .unwrap()
            .starts_with("wgs84 60.0 25.0")
    );
    let mut empty = Vec::new();
    write_gaussians_glb(&MapFile::default(), &mut empty).unwrap();
    assert_eq!(glb_document(&empty)["scenes"], serde_json::json!([{}]));
    let mut mesh = Vec::new();
    let surface = echosplat_surface::surface_of(&[], echosplat_surface::CELL_M).unwrap();
    write_mesh_glb(&surface, DVec3::ZERO, None, &mut mesh).unwrap();
    assert!(glb_document(&mesh).get("meshes").is_none());
}

#[test]
fn a_map_gets_its_place_and_keeps_every_other_byte() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("map.ply"), folder.path().join("out.ply"));
    let gaussians = row_of(5).gaussians;
    write_map(
        &path,
        DVec3::X,
        2.0,
        &gaussians,
        &crate::ply::MapNotes::default(),
    )
    .unwrap();
    let place = at(-16.79, 179.9999).georeference;
    georeference_map(&path, &out, &place).unwrap();
    let (before, after) = (std::fs::read(&path).unwrap(), std::fs::read(&out).unwrap());
    let body = |bytes: &[u8]| {
        let end = b"end_header\n";
        let at = bytes.windows(end.len()).position(|window| window == end);
        bytes[at.unwrap()..].to_vec()
    };
    assert_eq!(body(&before), body(&after));
    assert_eq!(
        read_map(&out).unwrap().notes.georeference,
        Some(place.clone())
    );
    // A second one takes the place of the first.
    let moved = at(60.0, 25.0).georeference;
    georeference_map(&out, &out, &moved).unwrap();
    let text = String::from_utf8_lossy(&std::fs::read(&out).unwrap()).into_owned();
    assert_eq!(text.matches("comment georeference").count(), 1);
    assert_eq!(read_map(&out).unwrap().notes.georeference, Some(moved));
    std::fs::write(&path, "ply\nformat").unwrap();
    assert!(georeference_map(&path, &out, &place).is_err());
}
