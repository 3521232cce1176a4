//! Cloud-optimised `GeoTIFF`.
//!
//! Written here: the crate `geotiff-writer` cannot name bands, averages NaN into overviews, and brings JPEG, LERC and
//! `ndarray` along.

use std::io::{self, Write};

use echosplat_georeference::{Datum, LengthUnit};
use flate2::write::ZlibEncoder;

use super::Placed;
use super::raster::{Cell, Raster};

/// Cells along the edge of a tile.
const TILE: u32 = 256;
/// What a cell is called where nothing is.
const NODATA: Cell = [f32::NAN; 4];
const BANDS: [&str; 4] = ["height", "depth", "probability", "sigma"];

/// Types of a TIFF's values, by their numbers.
const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const DOUBLE: u16 = 12;

/// One entry of a directory: tag, type, count, bytes.
type Entry = (u16, u16, u32, Vec<u8>);

/// A level of the pyramid: its cells and its tiles, compressed, row by row.
struct Level {
    raster: Raster,
    tiles: Vec<Vec<u8>>,
}

/// Writes a cloud-optimised `GeoTIFF` of four bands of f32: `height`, `depth`, `probability` and `sigma`, NaN where nothing
/// is. Tiles of 256 cells, overviews down to one tile, directories before the data, coarse levels first.
///
/// # Errors
/// Of the writer.
pub fn write_geotiff(raster: &Raster, placed: &Placed, mut writer: impl Write) -> io::Result<()> {
    let mut levels = vec![Level::of(raster.clone())?];
    while let Some(last) = levels.last()
        && last.raster.width.max(last.raster.height) > TILE
    {
        let half = last.raster.halved();
        levels.push(Level::of(half)?);
    }
    // Directories have one length whatever their offsets are.
    let directories = |offsets: &[Vec<u32>]| -> io::Result<Vec<u8>> {
        let mut bytes = b"II\x2a\0\x08\0\0\0".to_vec();
        for (index, level) in levels.iter().enumerate() {
            let entries = entries(level, index > 0, placed, &offsets[index]);
            let is_last = index + 1 == levels.len();
            append_directory(&mut bytes, entries, is_last)?;
        }
        Ok(bytes)
    };
    let none: Vec<Vec<u32>> = levels
        .iter()
        .map(|level| vec![0; level.tiles.len()])
        .collect();
    let mut end = directories(&none)?.len();
    let mut offsets = none;
    for (level, offsets) in levels.iter().zip(&mut offsets).rev() {
        for (tile, offset) in level.tiles.iter().zip(offsets) {
            *offset = short(end)?;
            end += tile.len();
        }
    }
    writer.write_all(&directories(&offsets)?)?;
    for tile in levels.iter().rev().flat_map(|level| &level.tiles) {
        writer.write_all(tile)?;
    }
    writer.flush()
}

/// A place in the file, which four bytes must hold.
fn short(at: usize) -> io::Result<u32> {
    u32::try_from(at)
        .map_err(|_| io::Error::other("the raster takes more than 4 GB: take larger cells"))
}

impl Level {
    fn of(raster: Raster) -> io::Result<Self> {
        let mut tiles = Vec::new();
        let empty = compressed(&[NODATA; (TILE * TILE) as usize])?;
        for top in (0..raster.height).step_by(TILE as usize) {
            for left in (0..raster.width).step_by(TILE as usize) {
                let mut cells = vec![NODATA; (TILE * TILE) as usize];
                let mut is_empty = true;
                for row in top..(top + TILE).min(raster.height) {
                    for (&(_, column), told) in raster.cells.range((row, left)..(row, left + TILE))
                    {
                        cells[((row - top) * TILE + column - left) as usize] = *told;
                        is_empty = false;
                    }
                }
                tiles.push(if is_empty {
                    empty.clone()
                } else {
                    compressed(&cells)?
                });
            }
        }
        Ok(Self { raster, tiles })
    }
}

fn compressed(cells: &[Cell]) -> io::Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    for value in cells.iter().flatten() {
        encoder.write_all(&value.to_le_bytes())?;
    }
    encoder.finish()
}

fn shorts(values: &[u16]) -> (u16, u32, Vec<u8>) {
    let bytes = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    (SHORT, values.len() as u32, bytes)
}

fn longs(values: &[u32]) -> (u16, u32, Vec<u8>) {
    let bytes = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    (LONG, values.len() as u32, bytes)
}

fn doubles(values: &[f64]) -> (u16, u32, Vec<u8>) {
    let bytes = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    (DOUBLE, values.len() as u32, bytes)
}

fn text(text: &str) -> (u16, u32, Vec<u8>) {
    let mut bytes = text.as_bytes().to_vec();
    bytes.push(0);
    (ASCII, bytes.len() as u32, bytes)
}

/// In the order of their tags.
fn entries(level: &Level, is_overview: bool, placed: &Placed, offsets: &[u32]) -> Vec<Entry> {
    let raster = &level.raster;
    let lengths: Vec<u32> = level.tiles.iter().map(|tile| tile.len() as u32).collect();
    let mut found = Vec::new();
    let mut add = |tag, (kind, count, bytes): (u16, u32, Vec<u8>)| {
        found.push((tag, kind, count, bytes));
    };
    add(254, longs(&[u32::from(is_overview)]));
    add(256, longs(&[raster.width]));
    add(257, longs(&[raster.height]));
    add(258, shorts(&[32; 4]));
    // Deflate, grey, values of a cell side by side.
    add(259, shorts(&[8]));
    add(262, shorts(&[1]));
    add(277, shorts(&[4]));
    add(284, shorts(&[1]));
    add(322, shorts(&[TILE as u16]));
    add(323, shorts(&[TILE as u16]));
    add(324, longs(offsets));
    add(325, longs(&lengths));
    add(338, shorts(&[0; 3]));
    // IEEE floating point.
    add(339, shorts(&[3; 4]));
    if !is_overview {
        add(33550, doubles(&[raster.cell.x, raster.cell.y, 0.0]));
        let corner = raster.corner;
        add(33922, doubles(&[0.0, 0.0, 0.0, corner.x, corner.y, 0.0]));
        add(34735, shorts(&geo_keys(placed)));
        add(42112, text(&metadata(placed)));
    }
    add(42113, text("nan"));
    found
}

/// The directory of the CRS: its version, then key, 0, count and value of each.
fn geo_keys(placed: &Placed) -> Vec<u16> {
    let code = placed.crs.code();
    let mut keys = match placed.crs.unit() {
        LengthUnit::Metres(_) => vec![[1024, 1], [1025, 1], [3072, code]],
        LengthUnit::Degrees => vec![[1024, 2], [1025, 1], [2048, code]],
    };
    if placed.georeference.datum == Datum::MeanSea {
        keys.extend([[4096, 5714], [4099, 9001]]);
    }
    let mut values = vec![1, 1, 0, keys.len() as u16];
    for [key, value] in keys {
        values.extend([key, 0, 1, value]);
    }
    values
}

/// Names of the bands, and what heights are over, as GDAL reads them.
fn metadata(placed: &Placed) -> String {
    let bands = BANDS.iter().enumerate().map(|(index, band)| {
        format!(r#"<Item name="DESCRIPTION" sample="{index}" role="description">{band}</Item>"#)
    });
    let bands: String = bands.collect();
    let datum = placed.georeference.datum;
    let heights = placed.heights_in_words();
    format!(
        r#"<GDALMetadata><Item name="HEIGHT_DATUM">{datum}</Item><Item name="HEIGHTS">{heights}</Item>{bands}</GDALMetadata>"#
    )
}

fn append_directory(bytes: &mut Vec<u8>, entries: Vec<Entry>, is_last: bool) -> io::Result<()> {
    let begin = bytes.len();
    let directory_bytes = 2 + 12 * entries.len() + 4;
    let mut values: Vec<u8> = Vec::new();
    let mut directory = Vec::with_capacity(directory_bytes);
    directory.extend((entries.len() as u16).to_le_bytes());
    for (tag, kind, count, mut value) in entries {
        directory.extend(tag.to_le_bytes());
        directory.extend(kind.to_le_bytes());
        directory.extend(count.to_le_bytes());
        if value.len() <= 4 {
            value.resize(4, 0);
            directory.extend(value);
        } else {
            let at = begin + directory_bytes + values.len();
            directory.extend(short(at)?.to_le_bytes());
            values.extend(value);
            // Values begin at even places.
            values.resize(values.len().next_multiple_of(8), 0);
        }
    }
    // Each directory begins at a multiple of 8, so that its values do not move with it.
    let end = (begin + directory_bytes + values.len()).next_multiple_of(8);
    let next = if is_last { 0 } else { short(end)? };
    directory.extend(next.to_le_bytes());
    bytes.extend(directory);
    bytes.extend(values);
    bytes.resize(end, 0);
    Ok(())
}
