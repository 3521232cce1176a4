//! Gaussians to rows of floats.

use std::io::{self, Write};

use echosplat_model::Gaussian;
use echosplat_model::glam::Vec3;

use super::{MapFile, PROPERTIES};
use crate::ramp::color_of_reflectivity;

/// Zeroth spherical harmonic, by which 3DGS scales colour.
const HARMONIC_0: f32 = 0.282_094_8;

/// Opacities of exactly 0 and 1 have no finite logit; this one reads back as them to 10⁻¹³.
const MAX_LOGIT: f64 = 30.0;

/// Most comment lines of a header, and the most characters of one: a reader takes 64 KiB of it.
const MOST_COMMENTS: usize = 32;
const LONGEST_COMMENT: usize = 256;

/// Comments that say something to a reader of maps, and so are no free text.
const OWN_COMMENTS: [&str; 3] = ["origin_m", "intensity_unit", "held_out_every"];

/// Writes one map file; a standing is not kept. What is not finite is left out.
///
/// # Errors
/// Of the writer.
pub fn write(map: &MapFile, mut writer: impl Write) -> io::Result<()> {
    let sound = || map.gaussians.iter().filter(|gaussian| gaussian.is_sound());
    let (x, y, z) = map.origin_m.into();
    writeln!(writer, "ply\nformat binary_little_endian 1.0")?;
    writeln!(writer, "comment origin_m {x:?} {y:?} {z:?}")?;
    writeln!(writer, "comment intensity_unit {:?}", map.intensity_unit)?;
    if map.notes.held_out_every > 1 {
        writeln!(
            writer,
            "comment held_out_every {}",
            map.notes.held_out_every
        )?;
    }
    for comment in map.notes.comments.iter().take(MOST_COMMENTS) {
        if let Some(line) = free_comment(comment) {
            writeln!(writer, "comment {line}")?;
        }
    }
    writeln!(writer, "element vertex {}", sound().count())?;
    for property in PROPERTIES {
        writeln!(writer, "property float {property}")?;
    }
    writeln!(writer, "end_header")?;
    for gaussian in sound() {
        let mut bytes = [0; PROPERTIES.len() * 4];
        for (field, value) in bytes.chunks_exact_mut(4).zip(row(gaussian)) {
            field.copy_from_slice(&value.to_le_bytes());
        }
        writer.write_all(&bytes)?;
    }
    writer.flush()
}

/// One line without control characters; `None` if it would be read as one of ours.
fn free_comment(text: &str) -> Option<String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let is_own = words
        .first()
        .is_some_and(|word| OWN_COMMENTS.contains(word));
    let line = words.join(" ");
    let shown = line.chars().filter(|c| !c.is_control());
    (!is_own && !words.is_empty()).then(|| shown.take(LONGEST_COMMENT).collect())
}

fn row(gaussian: &Gaussian) -> [f32; PROPERTIES.len()] {
    let mean = gaussian.mean_m;
    let normal = shortest_axis(gaussian);
    let f_dc = color_of_reflectivity(gaussian.reflectivity).map(|c| (c - 0.5) / HARMONIC_0);
    let scale = gaussian.scale_m.to_array().map(f32::ln);
    let q = gaussian.rotation;
    let [xx, xy, xz, yy, yz, zz] = gaussian.position_covariance_m2;
    [
        mean.x,
        mean.y,
        mean.z,
        normal.x,
        normal.y,
        normal.z,
        f_dc[0],
        f_dc[1],
        f_dc[2],
        logit(gaussian.opacity),
        scale[0],
        scale[1],
        scale[2],
        q.w,
        q.x,
        q.y,
        q.z,
        gaussian.reflectivity,
        gaussian.sigma_m,
        xx,
        xy,
        xz,
        yy,
        yz,
        zz,
        gaussian.probability,
    ]
}

fn logit(opacity: f32) -> f32 {
    let opacity = f64::from(opacity.clamp(0.0, 1.0));
    (opacity / (1.0 - opacity))
        .ln()
        .clamp(-MAX_LOGIT, MAX_LOGIT) as f32
}

fn shortest_axis(gaussian: &Gaussian) -> Vec3 {
    gaussian.rotation * Vec3::AXES[gaussian.scale_m.min_position()]
}
