//! Gaussians to rows of floats, the bytes of their colour, and the reason of their verdict.

use std::io::{self, Write};

use echosplat_model::Gaussian;
use echosplat_model::glam::Vec3;
use echosplat_ply::{Element, Format, Header, Scalar, write_floats};

use super::{COLORS, MapFile, PROPERTIES, WHY, notes};
use crate::ramp::{bytes_of_color, color_of_reflectivity};

/// Zeroth spherical harmonic, by which 3DGS scales colour.
pub(crate) const HARMONIC_0: f32 = 0.282_094_8;

/// Opacities of exactly 0 and 1 have no finite logit; this one reads back as them to 10⁻¹³.
const MAX_LOGIT: f64 = 30.0;

/// How much of a point cloud tools show; what it stops of the sound is another matter.
const OPAQUE: u8 = u8::MAX;

/// Writes one map file; a standing is not kept. What is not sound is left out.
///
/// # Errors
/// Of the writer.
pub fn write(map: &MapFile, mut writer: impl Write) -> io::Result<()> {
    let sound = || map.gaussians.iter().filter(|gaussian| gaussian.is_sound());
    let vertex = Element::of_floats("vertex", sound().count(), &PROPERTIES);
    let header = Header {
        format: Format::LittleEndian,
        comments: notes::comments(map),
        elements: vec![vertex.with(Scalar::U8, &COLORS).with(Scalar::F64, &WHY)],
    };
    header.write(&mut writer)?;
    for gaussian in sound() {
        let color = color_of_reflectivity(gaussian.reflectivity);
        write_floats(&mut writer, &row(gaussian, color))?;
        let [red, green, blue] = bytes_of_color(color);
        writer.write_all(&[red, green, blue, OPAQUE])?;
        for number in gaussian.why.bytes() {
            writer.write_all(&f64::from(number).to_le_bytes())?;
        }
    }
    writer.flush()
}

fn row(gaussian: &Gaussian, color: [f32; 3]) -> [f32; PROPERTIES.len()] {
    let mean = gaussian.mean_m;
    let normal = shortest_axis(gaussian);
    let f_dc = color.map(|c| (c - 0.5) / HARMONIC_0);
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
