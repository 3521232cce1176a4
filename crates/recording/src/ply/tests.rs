use super::*;
use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{MAX_PLACE_M, Reason, SCALE_LIMITS_M, Why};
use proptest::prelude::*;
use std::fs::File;

fn gaussian(id: u32, mean_m: Vec3) -> Gaussian {
    Gaussian {
        id,
        mean_m,
        rotation: Quat::from_rotation_y(0.3) * Quat::from_rotation_x(1.0),
        scale_m: Vec3::new(0.1, 0.02, 0.3),
        opacity: 0.7,
        reflectivity: 0.01,
        sigma_m: 0.05,
        position_covariance_m2: [4e-4, 1e-5, -1e-5, 9e-4, 2e-5, 25e-4],
        probability: 0.75,
        standing: Standing::Confident,
        why: Why::of(Reason::ClearlySeen, 12.0, 0.4),
    }
}

fn map(gaussians: Vec<Gaussian>) -> MapFile {
    MapFile {
        origin_m: DVec3::new(500_000.125, -6_000_000.1, 1e-17),
        intensity_unit: 0.000_3,
        gaussians,
        ..MapFile::default()
    }
}

fn bytes_of(map: &MapFile) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(map, &mut bytes).unwrap();
    bytes
}

fn assert_close(a: &Gaussian, b: &Gaussian) {
    let near =
        |a: f32, b: f32| (a - b).abs() <= 1e-5 * b.abs() + 1e-7 || a.to_bits() == b.to_bits();
    assert_eq!(a.mean_m, b.mean_m);
    assert!(a.rotation.angle_between(b.rotation) < 2e-3, "{a:?} {b:?}");
    assert!(
        a.scale_m
            .abs_diff_eq(b.scale_m, 1e-4 * b.scale_m.max_element())
    );
    assert!(near(a.opacity, b.opacity), "{} {}", a.opacity, b.opacity);
    assert_eq!(a.reflectivity.to_bits(), b.reflectivity.to_bits());
    assert_eq!(a.sigma_m.to_bits(), b.sigma_m.to_bits());
    assert_eq!(
        a.position_covariance_m2.map(f32::to_bits),
        b.position_covariance_m2.map(f32::to_bits)
    );
    assert!((a.probability - b.probability).abs() < 1e-6);
    assert_eq!(a.why, b.why);
}

/// A file with the given header lines and rows of floats.
fn file(header: &[&str], floats: &[f32]) -> Vec<u8> {
    let mut bytes = b"ply\nformat binary_little_endian 1.0\n".to_vec();
    for line in header {
        bytes.extend_from_slice(line.as_bytes());
        bytes.push(b'\n');
    }
    bytes.extend_from_slice(b"end_header\n");
    bytes.extend(floats.iter().flat_map(|f| f.to_le_bytes()));
    bytes
}

#[test]
fn the_header_is_the_documented_one() {
    let bytes = bytes_of(&map(vec![gaussian(0, Vec3::X)]));
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.starts_with(
        "ply\nformat binary_little_endian 1.0\ncomment echosplat_map 1\ncomment origin_m 500000.125 -6000000.1 1e-17\n\
         comment intensity_unit 0.0003\nelement vertex 1\nproperty float x\nproperty float y\n"
    ));
    let end = b"property float sigma\nproperty float cov_xx\nproperty float cov_xy\nproperty float cov_xz\n\
          property float cov_yy\nproperty float cov_yz\nproperty float cov_zz\nproperty float probability\n\
          property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n\
          property double reason\nproperty double clear_observations\nproperty double measured\nend_header\n";
    let at = bytes.windows(end.len()).position(|w| w == end).unwrap();
    assert_eq!(bytes.len() - at - end.len(), 26 * 4 + 4 + 3 * 8);
    assert_eq!(ROW_BYTES, 132);
}

#[test]
fn a_map_of_a_newer_version_is_refused_and_one_without_is_the_first() {
    let bytes = bytes_of(&map(vec![gaussian(0, Vec3::X)]));
    let said = b"comment echosplat_map 1\n";
    let at = bytes.windows(said.len()).position(|w| w == said).unwrap();
    let with = |comment: &[u8]| [&bytes[..at], comment, &bytes[at + said.len()..]].concat();
    let old = read(&with(b"")[..]).unwrap();
    assert_eq!(old, read(&bytes[..]).unwrap());
    let newer = with(b"comment echosplat_map 2\n");
    let error = read(&newer[..]).unwrap_err().to_string();
    assert!(
        error.contains("version 2 of a map") && error.contains("up to version 1"),
        "{error}"
    );
    // No comment of a user takes the place of ours.
    let notes = MapNotes {
        comments: vec!["echosplat_map 7".to_owned(), "echosplat_mesh 7".to_owned()],
        ..MapNotes::default()
    };
    let told = MapFile {
        notes,
        ..map(vec![])
    };
    assert!(read(&bytes_of(&told)[..]).is_ok());
}

#[test]
fn a_fault_of_the_ambiguous_part_names_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.ply");
    write_map(&path, DVec3::ZERO, 1.0, &[], &MapNotes::default()).unwrap();
    let newer = "ply\nformat ascii 1.0\ncomment echosplat_map 3\nelement vertex 0\nend_header\n";
    std::fs::write(ambiguous_path(&path), newer).unwrap();
    let error = read_map(&path).unwrap_err().to_string();
    assert!(
        error.contains("in map.ambiguous.ply beside it: made by a newer EchoSplat"),
        "{error}"
    );
}

#[test]
fn a_row_holds_logit_logarithms_and_w_first() {
    let mut one = gaussian(0, Vec3::new(1.0, 2.0, 3.0));
    one.opacity = 0.5;
    one.scale_m = Vec3::new(1.0, 0.5, 2.0);
    one.rotation = Quat::IDENTITY;
    let bytes = bytes_of(&map(vec![one]));
    let (floats, rest) = bytes[bytes.len() - ROW_BYTES..].split_at(104);
    let (color, why) = rest.split_at(4);
    assert_eq!(color[3], 255);
    let why = why
        .chunks_exact(8)
        .map(|b| f64::from_le_bytes(b.try_into().unwrap()));
    assert!(why.eq([2.0, 12.0, 40.0]));
    let row: Vec<f32> = floats
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect();
    assert_eq!(row[..6], [1.0, 2.0, 3.0, 0.0, 1.0, 0.0]);
    assert_eq!(row[9..11], [0.0, 0.0]);
    assert_eq!(row[13..17], [1.0, 0.0, 0.0, 0.0]);
    assert_eq!(row[17..19], [0.01, 0.05]);
    assert_eq!(row[19..], [4e-4, 1e-5, -1e-5, 9e-4, 2e-5, 25e-4, 0.75]);
    let channels = row[6..9].iter().zip(color);
    for (f_dc, byte) in channels {
        let expected = 255.0 * (0.5 + 0.282_094_8 * f_dc);
        assert!(
            (f32::from(*byte) - expected).abs() < 0.51,
            "{row:?} {color:?}"
        );
    }
}

#[test]
fn extremes_survive_and_nan_is_left_out() {
    let mut all = Vec::new();
    for (opacity, scale, sigma) in [
        (0.0, *SCALE_LIMITS_M.start(), f32::INFINITY),
        (1.0, *SCALE_LIMITS_M.end(), 0.0),
        (1e-9, 1e-3, 1e-9),
        (0.999_999, 1.0, f32::MAX),
    ] {
        let mut g = gaussian(all.len() as u32, Vec3::splat(-MAX_PLACE_M));
        (g.opacity, g.scale_m, g.sigma_m) = (opacity, Vec3::splat(scale), sigma);
        all.push(g);
    }
    let mut bad = gaussian(9, Vec3::ZERO);
    bad.mean_m.x = f32::NAN;
    let mut with_bad = all.clone();
    with_bad.insert(1, bad);
    let back = read(&bytes_of(&map(with_bad))[..]).unwrap();
    assert_eq!(back.origin_m, map(vec![]).origin_m);
    assert_eq!(back.intensity_unit.to_bits(), 0.000_3_f32.to_bits());
    assert_eq!(back.gaussians.len(), 4);
    for (a, b) in back.gaussians.iter().zip(&all) {
        assert_close(a, b);
    }
}

#[test]
fn other_orders_and_more_properties_are_read() {
    let mut header = vec![
        "comment made elsewhere",
        "element camera 1",
        "property double d",
    ];
    header.push("element vertex 1");
    let names = [
        "rot_3", "rot_2", "rot_1", "rot_0", "extra", "z", "y", "x", "scale_2", "scale_1",
        "scale_0", "opacity",
    ];
    let lines: Vec<String> = names
        .iter()
        .map(|n| format!("property float {n}"))
        .collect();
    header.extend(lines.iter().map(String::as_str));
    header.push("property uchar flag");
    header.push("element face 7");
    header.push("property list uchar int vertex_indices");
    let mut bytes = file(&header, &[0.0, 0.0]);
    for value in [
        0.0, 0.0, 0.0, 2.0, 9.0, 3.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0_f32,
    ] {
        bytes.extend(value.to_le_bytes());
    }
    bytes.push(7);
    let back = read(&bytes[..]).unwrap();
    assert_eq!(back.gaussians[0].mean_m, Vec3::new(1.0, 2.0, 3.0));
    assert_eq!(back.gaussians[0].rotation, Quat::IDENTITY);
    assert_eq!(back.gaussians[0].scale_m, Vec3::ONE);
    assert!(back.gaussians[0].sigma_m.is_infinite());
    assert_eq!(back.gaussians[0].why, Why::default());
}

#[test]
fn a_claimed_size_is_not_believed() {
    let mut bytes = bytes_of(&map(vec![gaussian(0, Vec3::X)]));
    let at = bytes.windows(8).position(|w| w == b"vertex 1").unwrap();
    bytes.splice(at + 7..at + 8, b"18446744073709551615".iter().copied());
    let error = read(&bytes[..]).unwrap_err();
    assert!(
        matches!(error, MapFileError::Ply(PlyError::Cut { found: 1, .. })),
        "{error}"
    );
}

#[test]
fn errors_say_what_was_found_and_what_is_needed() {
    let error = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
    assert_eq!(error(b""), "the file is empty");
    assert!(error(b"BR\x01\x00").contains("not a PLY: starts with `BR`"));
    assert!(error(b"ply\nformat ascii 1.0\nend_header\n").contains("no `element vertex`"));
    assert!(error(b"ply\nformat").contains("not a PLY") || error(b"ply\n").contains("end_header"));
    let no_opacity = file(
        &[
            "element vertex 1",
            "property float x",
            "property float y",
            "property float z",
        ],
        &[],
    );
    assert!(error(&no_opacity).contains("no property `opacity`"));
    let no_bytes = file(&["element vertex 18446744073709551615"], &[]);
    assert!(error(&no_bytes).contains("no property `x`"));
    let none = of_row(&[0.0; ROW.len()]);
    assert_eq!(
        error(&none),
        "none of its 1 vertices is a Gaussian; vertex 0: its rotation is no quaternion with a length"
    );
}

/// What every map has, in this order.
const ROW: [&str; 11] = [
    "x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
];

/// A file of these rows, one after another.
fn of_row(floats: &[f32]) -> Vec<u8> {
    let mut header = vec![format!("element vertex {}", floats.len() / ROW.len())];
    header.extend(ROW.map(|name| format!("property float {name}")));
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    file(&header, floats)
}

/// One rule at both ends: whatever number stands in a row, what is read is sound, and is written and
/// read again as it is.
#[test]
fn what_is_no_gaussian_is_left_out_counted_and_named() {
    let good = [0.0, 0.0, 0.0, 0.0, -2.0, -2.0, -2.0, 1.0, 0.0, 0.0, 0.0];
    let subnormal = f32::MIN_POSITIVE / 4.0;
    let values = [
        f32::NAN,
        f32::INFINITY,
        f32::MAX,
        1e6,
        2.0,
        1.0,
        subnormal,
        0.0,
    ];
    for field in 0..ROW.len() {
        for value in values.into_iter().flat_map(|value| [value, -value]) {
            let mut bad = good;
            bad[field] = value;
            let back = read(&of_row(&[good, bad, good].concat())[..]).unwrap();
            let refused = back.refused;
            assert_eq!(back.gaussians.len() as u64 + refused.count, 3);
            assert!(back.gaussians.iter().all(Gaussian::is_sound));
            let is_named = refused.first.is_none_or(|(vertex, _)| vertex == 1);
            assert!(
                is_named && refused.count < 2,
                "{} {value}: {refused}",
                ROW[field]
            );
            let again = read(&bytes_of(&back)[..]).unwrap();
            assert_eq!(again.gaussians.len(), back.gaussians.len());
            assert_eq!(again.refused.count, 0, "{} {value}", ROW[field]);
        }
    }
    let mut three = [good; 5];
    three[1][7] = 0.0;
    three[3][0] = f32::NAN;
    let back = read(&of_row(&three.concat())[..]).unwrap();
    assert_eq!(
        back.refused.to_string(),
        "2 vertices are no Gaussians and left out; the first is vertex 1: its rotation is no \
         quaternion with a length"
    );
}

#[test]
fn every_cut_is_an_error_that_says_so() {
    let bytes = bytes_of(&map(vec![gaussian(0, Vec3::X), gaussian(1, Vec3::Y)]));
    for end in 0..bytes.len() {
        assert!(read(&bytes[..end]).is_err(), "cut at {end}");
    }
}

#[test]
fn what_was_kept_from_a_map_is_in_its_header() {
    let mut with_notes = map(vec![gaussian(0, Vec3::X)]);
    with_notes.notes = MapNotes {
        held_out_every: 20,
        comments: vec![
            "made of\na \u{1b}[31mdive".to_owned(),
            "origin_m 1 2 3".to_owned(),
            String::new(),
            "x".repeat(100_000),
        ],
        ..MapNotes::default()
    };
    let bytes = bytes_of(&with_notes);
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.contains("\ncomment held_out_every 20\ncomment made of a [31mdive\ncomment xxx"));
    let back = read(&bytes[..]).unwrap();
    assert_eq!(back.notes.held_out_every, 20);
    assert_eq!(back.origin_m, with_notes.origin_m);
    assert_eq!(
        read(&bytes_of(&map(vec![]))[..]).unwrap().notes,
        MapNotes::default()
    );
    let odd = file(&["comment held_out_every often", "element vertex 0"], &[]);
    assert!(
        read(&odd[..])
            .unwrap_err()
            .to_string()
            .contains("held_out_every")
    );
}

#[test]
fn a_map_without_gaussians_is_not_worth_keeping() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    assert!(!is_worth_keeping(&path));
    for (bytes, is_worth) in [
        (bytes_of(&map(vec![])), false),
        (Vec::new(), false),
        (bytes_of(&map(vec![gaussian(0, Vec3::X)])), true),
        (b"a letter".to_vec(), true),
    ] {
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(is_worth_keeping(&path), is_worth);
    }
}

#[test]
fn a_map_is_two_files_and_reads_back_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.ply");
    let mut all = vec![
        gaussian(4, Vec3::X),
        gaussian(7, Vec3::Y),
        gaussian(9, Vec3::Z),
    ];
    all[1].standing = Standing::Ambiguous;
    all[2].scale_m.x = f32::NAN;
    let written = write_map(&path, DVec3::X, 8.0, &all, &MapNotes::default()).unwrap();
    let counts = (
        written.confident_count,
        written.ambiguous_count,
        written.left_out_count,
    );
    assert_eq!(counts, (1, 1, 1));
    assert_eq!(read(File::open(&path).unwrap()).unwrap().gaussians.len(), 1);
    let back = read_map(&path).unwrap();
    assert_eq!(back.refused, Refused::default());
    assert_eq!(back.origin_m, DVec3::X);
    assert_eq!(back.intensity_unit.to_bits(), 8.0_f32.to_bits());
    assert_eq!(back.gaussians[1].standing, Standing::Ambiguous);
    assert_eq!(back.gaussians[1].mean_m, Vec3::Y);
    assert!(folder.path().join("out.ambiguous.ply").exists());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
}

proptest! {
    #[test]
    fn damage_never_panics(at in 0..600usize, value in any::<u8>(), junk in proptest::collection::vec(any::<u8>(), 0..200)) {
        let mut bytes = bytes_of(&map(vec![gaussian(0, Vec3::X)]));
        if let Some(byte) = bytes.get_mut(at) {
            *byte = value;
        }
        let _ = read(&bytes[..]);
        let _ = read(&junk[..]);
    }
}

/// As editors of point clouds save: their own names, doubles, text, and none of the comments.
#[test]
fn a_map_that_an_editor_saved_again_is_read_and_says_what_it_lacks() {
    let names = [
        "scalar_opacity",
        "scalar_scale_0",
        "scalar_scale_1",
        "scalar_scale_2",
        "scalar_rot_0",
        "scalar_rot_1",
        "scalar_rot_2",
        "scalar_rot_3",
    ];
    let mut text =
        "ply\nformat ascii 1.0\ncomment made by an editor\nelement vertex 1\n".to_owned();
    for name in ["x", "y", "z"] {
        text += &format!("property double {name}\n");
    }
    for name in names {
        text += &format!("property float {name}\n");
    }
    text += "end_header\n1 2 -3 0 -3 -3 -3 1 0 0 0\n";
    let map = read(text.as_bytes()).unwrap();
    let one = &map.gaussians[0];
    assert_eq!(one.mean_m, Vec3::new(1.0, 2.0, -3.0));
    assert!((one.opacity - 0.5).abs() < 1e-6 && one.sigma_m.is_infinite());
    assert!((one.scale_m.x - (-3.0_f32).exp()).abs() < 1e-6);
    let lacks = map.lacks.join("; ");
    for what in ["origin_m", "sigma", "reflectivity", "probability"] {
        assert!(lacks.contains(what), "{lacks}");
    }
    let own = read(&bytes_of(&self::map(vec![gaussian(0, Vec3::X)]))[..]).unwrap();
    assert_eq!(own.lacks, [""; 0]);
    let list = text.replace("float scalar_opacity", "list uchar float scalar_opacity");
    let error = read(list.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("expected a number"), "{error}");
}

/// As scripts read files of 3D Gaussian splatting that know of nothing but floats.
#[test]
fn a_program_that_takes_every_column_for_a_float_finds_the_rows() {
    let sent: Vec<Gaussian> = (0..5)
        .map(|id| gaussian(id, Vec3::new(id as f32, -2.0, 0.5)))
        .collect();
    let bytes = bytes_of(&map(sent.clone()));
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|w| w == end).unwrap();
    let (header, body) = (&bytes[..at], &bytes[at + end.len()..]);
    let columns = String::from_utf8_lossy(header).matches("property ").count();
    assert_eq!(body.len(), sent.len() * columns * 4);
    let float = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
    for (row, sent) in body.chunks_exact(4 * columns).zip(&sent) {
        let floats: Vec<f32> = row.chunks_exact(4).map(float).collect();
        assert_eq!(floats[..3], sent.mean_m.to_array());
        assert_eq!(floats[18].to_bits(), sent.sigma_m.to_bits());
        assert_eq!(floats[25].to_bits(), sent.probability.to_bits());
    }
}

/// Of every reason, also as an editor saves bytes: as floats with a name of its own, beyond a byte too.
#[test]
fn the_reason_of_a_verdict_comes_back() {
    let with = |(id, reason): (usize, Reason)| Gaussian {
        why: Why::of(reason, id as f32, 0.5),
        ..gaussian(id as u32, Vec3::X)
    };
    let sent: Vec<Gaussian> = Reason::ALL
        .into_iter()
        .enumerate()
        .skip(1)
        .map(with)
        .collect();
    let bytes = bytes_of(&map(sent.clone()));
    let back = read(&bytes[..]).unwrap();
    for (back, sent) in back.gaussians.iter().zip(&sent) {
        assert_eq!(back.why, sent.why);
    }
    let good = [0.0, 0.0, 0.0, 0.0, -2.0, -2.0, -2.0, 1.0, 0.0, 0.0, 0.0];
    let rows = [
        &good[..],
        &[8.0, 9.0, 40.0],
        &good,
        &[f32::NAN, 300.0, -1.0],
    ]
    .concat();
    // As an editor saves them, and as earlier versions named them.
    for (editor, names) in [("scalar_", WHY), ("", WHY_BEFORE)] {
        let mut header = vec!["element vertex 2".to_owned()];
        header.extend(ROW.map(|name| format!("property float {name}")));
        header.extend(names.map(|name| format!("property float {editor}{name}")));
        let header: Vec<&str> = header.iter().map(String::as_str).collect();
        let back = read(&file(&header, &rows)[..]).unwrap();
        let wide = Why::of(Reason::WidePlace, 9.0, 0.4);
        assert_eq!(back.gaussians[0].why, wide);
        assert_eq!(back.gaussians[1].why, Why::default());
    }
}
