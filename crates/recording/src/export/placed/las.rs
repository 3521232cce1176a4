//! LAS 1.4 and LAZ.
//!
//! The header is written here: a few fixed fields, for which the crate `las` would bring a library of dates. `laz` compresses.

use std::io::{self, Seek, Write};

use echosplat_georeference::{CrsError, LengthUnit};
use echosplat_model::glam::DVec3;
use echosplat_model::{Gaussian, Standing};
use laz::{LasZipCompressor, LazItemRecordBuilder, LazItemType, LazVlr};

use super::Placed;
use crate::export::reflectivity_db;
use crate::ply::MapFile;
use crate::ramp::color_of_reflectivity;

/// Bytes of a header of LAS 1.4.
const HEADER_BYTES: usize = 375;
/// Points with a colour and sixteen kinds of return, of LAS 1.4.
const POINT_FORMAT: u8 = 7;
/// Bytes of such a point without what is added.
const POINT_BYTES: usize = 36;
/// Set in the format's number where points are compressed.
const COMPRESSED: u8 = 0x80;
/// The CRS is well-known text, as LAS 1.4 wants it for such points.
const WKT_ENCODING: u16 = 1 << 4;

/// Extra dimensions, each an f32: name, and what it is.
const EXTRA: [(&str, &str); 4] = [
    ("sigma", "one sigma of the place, m"),
    ("probability", "of surface within 0.10 m"),
    ("opacity", "share of sound that is stopped"),
    ("reflectivity", "linear"),
];
/// Bytes that describe one of them.
const EXTRA_RECORD_BYTES: usize = 192;
/// The number of f32 among the types of extra dimensions.
const EXTRA_F32: u8 = 9;

/// Metres; coordinates are whole numbers of it.
const STEP_M: f64 = 1e-4;
/// Degrees; about 0.1 mm.
const STEP_DEG: f64 = 1e-9;
/// Coordinates beyond so many steps from the offset are told in coarser ones.
const MOST_STEPS: f64 = 2e9;

/// Weakest reflectivity that an intensity tells, dB; the strongest is 0.
const WEAKEST_DB: f32 = -40.0;

/// Whether points are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compression {
    /// LAS.
    None,
    /// LAZ.
    Laz,
}

/// How whole numbers become coordinates.
struct Steps {
    scale: DVec3,
    offset: DVec3,
    least: DVec3,
    most: DVec3,
}

/// Writes LAS 1.4, point format 7: places to a tenth of a millimetre (whole UTM coordinates lose nothing), `intensity`
/// and colour by reflectivity from −40 to 0 dB, user data 1 if confident, and the extra dimensions `sigma` (metres, may be
/// infinite), `probability`, `opacity` and `reflectivity`. The CRS is well-known text; what heights are over is said in a
/// text record.
///
/// # Errors
/// Of the writer; and, before anything is written, if the projection does not show a place.
pub fn write_las(
    map: &MapFile,
    placed: &Placed,
    compression: Compression,
    mut writer: impl Write + Seek + Send + Sync,
) -> io::Result<()> {
    let wrong = |error: CrsError| io::Error::other(error);
    let points = placed.gaussians(map).map_err(wrong)?;
    let steps = Steps::of(&points, placed.crs.unit());
    let laz = match compression {
        Compression::None => None,
        Compression::Laz => Some(laz_record()?),
    };
    let records = records(placed, laz.as_ref())?;
    writer.write_all(&header(&points, &steps, &records, laz.is_some()))?;
    for record in &records {
        writer.write_all(record)?;
    }
    let rows = points
        .iter()
        .map(|(at, gaussian)| row(*at, gaussian, &steps));
    match laz {
        None => {
            for row in rows {
                writer.write_all(&row)?;
            }
        }
        Some(laz) => {
            let mut compressor =
                LasZipCompressor::new(&mut writer, laz).map_err(io::Error::other)?;
            for row in rows {
                compressor.compress_one(&row)?;
            }
            compressor.done()?;
        }
    }
    writer.flush()
}

impl Steps {
    fn of(points: &[(DVec3, &Gaussian)], unit: LengthUnit) -> Self {
        let first = points.first().map_or(DVec3::ZERO, |(at, _)| *at);
        let bounds = points
            .iter()
            .fold((first, first), |(least, most), (at, _)| {
                (least.min(*at), most.max(*at))
            });
        let (least, most) = bounds;
        let finest = match unit {
            LengthUnit::Degrees => DVec3::new(STEP_DEG, STEP_DEG, STEP_M),
            LengthUnit::Metres(_) => DVec3::splat(STEP_M),
        };
        let offset = (0.5 * (least + most)).floor();
        let reach = (most - offset).max(offset - least);
        let mut scale = finest;
        for axis in 0..3 {
            while reach[axis] > MOST_STEPS * scale[axis] {
                scale[axis] *= 10.0;
            }
        }
        Self {
            scale,
            offset,
            least,
            most,
        }
    }

    fn of_place(&self, at: DVec3) -> [i32; 3] {
        ((at - self.offset) / self.scale)
            .round()
            .to_array()
            .map(|steps| steps as i32)
    }
}

fn laz_record() -> io::Result<LazVlr> {
    let extra_bytes = u16::try_from(EXTRA.len() * size_of::<f32>()).map_err(io::Error::other)?;
    let items = LazItemRecordBuilder::new()
        .add_item(LazItemType::Point14)
        .add_item(LazItemType::RGB14)
        .add_item(LazItemType::Byte14(extra_bytes))
        .build();
    Ok(LazVlr::from_laz_items(items))
}

/// The records between header and points, whole.
fn records(placed: &Placed, laz: Option<&LazVlr>) -> io::Result<Vec<Vec<u8>>> {
    let mut wkt = placed.wkt().into_bytes();
    wkt.push(0);
    let mut records = vec![
        record("LASF_Projection", 2112, "WKT of the CRS", &wkt)?,
        record("LASF_Spec", 4, "extra dimensions", &extra_dimensions())?,
        record(
            "LASF_Spec",
            3,
            "heights",
            placed.heights_in_words().as_bytes(),
        )?,
    ];
    if let Some(laz) = laz {
        let mut bytes = Vec::new();
        laz.write_to(&mut bytes)?;
        records.push(record(
            LazVlr::USER_ID,
            LazVlr::RECORD_ID,
            "laszip",
            &bytes,
        )?);
    }
    Ok(records)
}

fn record(user: &str, id: u16, what: &str, data: &[u8]) -> io::Result<Vec<u8>> {
    let length = u16::try_from(data.len()).map_err(io::Error::other)?;
    let mut bytes = vec![0; 2];
    bytes.extend(padded::<16>(user));
    bytes.extend(id.to_le_bytes());
    bytes.extend(length.to_le_bytes());
    bytes.extend(padded::<32>(what));
    bytes.extend(data);
    Ok(bytes)
}

fn padded<const N: usize>(text: &str) -> [u8; N] {
    let mut bytes = [0; N];
    let length = text.len().min(N);
    bytes[..length].copy_from_slice(&text.as_bytes()[..length]);
    bytes
}

fn extra_dimensions() -> Vec<u8> {
    let mut bytes = Vec::new();
    for (name, what) in EXTRA {
        let mut one = vec![0, 0, EXTRA_F32, 0];
        one.extend(padded::<32>(name));
        one.resize(EXTRA_RECORD_BYTES - 32, 0);
        one.extend(padded::<32>(what));
        bytes.extend(one);
    }
    bytes
}

fn header(
    points: &[(DVec3, &Gaussian)],
    steps: &Steps,
    records: &[Vec<u8>],
    is_compressed: bool,
) -> Vec<u8> {
    let record_bytes: usize = records.iter().map(Vec::len).sum();
    let count = points.len() as u64;
    let mut bytes = Vec::with_capacity(HEADER_BYTES);
    bytes.extend(b"LASF");
    bytes.extend(0_u16.to_le_bytes());
    bytes.extend(WKT_ENCODING.to_le_bytes());
    bytes.extend([0; 16]);
    bytes.extend([1, 4]);
    bytes.extend(padded::<32>("EchoSplat, map of Gaussians"));
    bytes.extend(padded::<32>(concat!(
        "echosplat ",
        env!("CARGO_PKG_VERSION")
    )));
    // Day and year: 0 is unknown.
    bytes.extend([0; 4]);
    bytes.extend((HEADER_BYTES as u16).to_le_bytes());
    bytes.extend(((HEADER_BYTES + record_bytes) as u32).to_le_bytes());
    bytes.extend((records.len() as u32).to_le_bytes());
    bytes.push(POINT_FORMAT | if is_compressed { COMPRESSED } else { 0 });
    bytes.extend(((POINT_BYTES + EXTRA.len() * size_of::<f32>()) as u16).to_le_bytes());
    // Counts as versions before 1.4 have them: 0 for such points.
    bytes.extend([0; 24]);
    for vector in [steps.scale, steps.offset] {
        vector
            .to_array()
            .iter()
            .for_each(|x| bytes.extend(x.to_le_bytes()));
    }
    for axis in 0..3 {
        bytes.extend(steps.most[axis].to_le_bytes());
        bytes.extend(steps.least[axis].to_le_bytes());
    }
    // No waveforms, no records behind the points.
    bytes.extend([0; 20]);
    bytes.extend(count.to_le_bytes());
    bytes.extend(count.to_le_bytes());
    bytes.resize(HEADER_BYTES, 0);
    bytes
}

fn row(at: DVec3, gaussian: &Gaussian, steps: &Steps) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(POINT_BYTES + EXTRA.len() * size_of::<f32>());
    for steps in steps.of_place(at) {
        bytes.extend(steps.to_le_bytes());
    }
    let strength = 1.0 - (reflectivity_db(gaussian) / WEAKEST_DB).clamp(0.0, 1.0);
    bytes.extend(shade(strength));
    // The only return of its kind, of no class, unclassified (1), then user data.
    bytes.extend([
        0x11,
        0,
        1,
        u8::from(gaussian.standing == Standing::Confident),
    ]);
    bytes.extend([0; 12]);
    for channel in color_of_reflectivity(gaussian.reflectivity) {
        bytes.extend(shade(channel));
    }
    for value in [
        gaussian.sigma_m,
        gaussian.probability,
        gaussian.opacity,
        gaussian.reflectivity,
    ] {
        bytes.extend(value.to_le_bytes());
    }
    bytes
}

fn shade(share: f32) -> [u8; 2] {
    ((f32::from(u16::MAX) * share).round() as u16).to_le_bytes()
}
