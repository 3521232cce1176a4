//! numpy's archive of arrays: a zip of `.npy` files, not compressed.

use std::io::{self, Write};

use echosplat_model::{Gaussian, Standing};
use rawzip::ZipArchiveWriter;

use super::{sound, world_m};
use crate::ply::MapFile;

/// Format 1.0 of `numpy.lib.format`: magic, version, length of the header, which ends on 64 bytes.
const MAGIC: &[u8; 8] = b"\x93NUMPY\x01\x00";
const ALIGNED_TO: usize = 64;
/// Of the archive: which arrays there are, and what they mean.
const VERSION: u32 = 1;

/// Writes the arrays `position` (f8, shape `[n, 3]`, world, metres), `sigma_m` (f4, `[n]`, may be
/// infinite), `position_covariance_m2` (f4, `[n, 6]`: xx xy xz yy yz zz, world axes), `probability` (f4, `[n]`, that there is
/// surface within 0.10 m), `confident` (bool, `[n]`), `opacity` (f4, `[n]`), `scale` (f4, `[n, 3]`, one sigma,
/// metres), `rotation` (f4, `[n, 4]`, w x y z), `reflectivity` (f4, `[n]`, linear) and `id` (u4, `[n]`). `format_version` (u4,
/// one number, no array) is the version of all this; archives without are of the first.
///
/// # Errors
/// Of the writer.
pub fn write_npz(map: &MapFile, writer: impl Write) -> io::Result<()> {
    let mut archive = Archive {
        zip: ZipArchiveWriter::new(writer),
        count: sound(map).count(),
    };
    let all = || sound(map);
    let world = |g: &Gaussian| world_m(map.origin_m, g).to_array();
    archive.array("position", "<f8", all().map(world), f64::to_le_bytes)?;
    let single = f32::to_le_bytes;
    archive.array("sigma_m", "<f4", all().map(|g| [g.sigma_m]), single)?;
    let covariance = all().map(|g| g.position_covariance_m2);
    archive.array("position_covariance_m2", "<f4", covariance, single)?;
    archive.array("probability", "<f4", all().map(|g| [g.probability]), single)?;
    let confident = all().map(|g| [g.standing == Standing::Confident]);
    archive.array("confident", "|b1", confident, |is| [u8::from(is)])?;
    archive.array("opacity", "<f4", all().map(|g| [g.opacity]), single)?;
    archive.array("scale", "<f4", all().map(|g| g.scale_m.to_array()), single)?;
    let rotation = all().map(|g| [g.rotation.w, g.rotation.x, g.rotation.y, g.rotation.z]);
    archive.array("rotation", "<f4", rotation, single)?;
    let reflectivity = all().map(|g| [g.reflectivity]);
    archive.array("reflectivity", "<f4", reflectivity, single)?;
    archive.array("id", "<u4", all().map(|g| [g.id]), u32::to_le_bytes)?;
    archive.file(
        "format_version",
        &header("<u4", "()"),
        VERSION.to_le_bytes(),
    )?;
    archive.zip.finish().map_err(io::Error::other)?.flush()
}

struct Archive<W> {
    zip: ZipArchiveWriter<W>,
    /// Rows of every array.
    count: usize,
}

impl<W: Write> Archive<W> {
    /// One array of `WIDTH` values a row.
    fn array<T, const WIDTH: usize, const BYTES: usize>(
        &mut self,
        name: &str,
        kind: &str,
        rows: impl Iterator<Item = [T; WIDTH]>,
        bytes_of: impl Fn(T) -> [u8; BYTES],
    ) -> io::Result<()> {
        let header = header(kind, &shape(self.count, WIDTH));
        self.file(name, &header, rows.flatten().flat_map(bytes_of))
    }

    fn file(
        &mut self,
        name: &str,
        header: &[u8],
        content: impl IntoIterator<Item = u8>,
    ) -> io::Result<()> {
        let name = format!("{name}.npy");
        let file = self.zip.new_file(&name);
        let (mut entry, config) = file.start().map_err(io::Error::other)?;
        let mut out = config.wrap(io::BufWriter::new(&mut entry));
        out.write_all(header)?;
        for byte in content {
            out.write_all(&[byte])?;
        }
        let (mut buffer, descriptor) = out.finish().map_err(io::Error::other)?;
        buffer.flush()?;
        drop(buffer);
        entry.finish(descriptor).map_err(io::Error::other)?;
        Ok(())
    }
}

fn shape(count: usize, width: usize) -> String {
    match width {
        1 => format!("({count},)"),
        _ => format!("({count}, {width})"),
    }
}

fn header(kind: &str, shape: &str) -> Vec<u8> {
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    let before = MAGIC.len() + size_of::<u16>();
    // One byte for the end of the line.
    let whole = (before + text.len() + 1).next_multiple_of(ALIGNED_TO);
    while before + text.len() + 1 < whole {
        text.push(' ');
    }
    text.push('\n');
    let length = u16::try_from(text.len()).unwrap_or(u16::MAX);
    [&MAGIC[..], &length.to_le_bytes(), text.as_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_end_where_numpy_wants_them() {
        for (count, width) in [(0, 1), (17_900, 3), (usize::MAX, 4)] {
            let header = header("<f4", &shape(count, width));
            assert_eq!(header.len() % ALIGNED_TO, 0);
            let length = u16::from_le_bytes([header[8], header[9]]);
            assert_eq!(usize::from(length) + 10, header.len());
            assert_eq!(header.last(), Some(&b'\n'));
        }
    }

    #[test]
    fn every_array_is_in_the_archive() {
        let mut bytes = Vec::new();
        write_npz(&super::super::tests::map(), &mut bytes).unwrap();
        let archive = rawzip::ZipArchive::from_slice(&bytes).unwrap();
        assert_eq!(archive.entries_hint(), 11);
        let at = |needle: &[u8]| bytes.windows(needle.len()).any(|w| w == needle);
        assert!(at(
            b"'descr': '<u4', 'fortran_order': False, 'shape': (), }"
        ));
        assert!(at(b"'shape': (1, 3)") && at(&1_000_001.0_f64.to_le_bytes()));
    }
}
