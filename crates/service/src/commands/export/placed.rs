//! What is told on Earth: the place of the map, and files in its coordinates.

use std::path::Path;

use echosplat_georeference::{Crs, Georeference};
use echosplat_join::StampClock;
use echosplat_model::StampedPose;
use echosplat_pose::{PoseSource, PoseUrl};
use echosplat_recording::export::placed::{
    Compression, Placed, Raster, RasterError, features_of, write_geojson, write_geotiff, write_kml,
    write_las, write_track_csv, write_track_tum,
};
use echosplat_recording::ply::MapFile;
use echosplat_recording::replace::replace_file;

use super::ExportArguments;
use crate::exit::Usage;
use crate::kind::Kind;
use crate::replayed::Replayed;
use crate::{files, inputs, placing};

/// Metres; edge of a raster's cells unless asked for otherwise.
const CELL_M: f64 = 0.1;
/// Metres; smallest and largest edge of a raster's cells.
const CELL_LIMITS_M: (f64, f64) = (0.005, 1000.0);

/// A file in coordinates of the Earth, or a track.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PlacedFormat {
    Las,
    Laz,
    GeoTiff,
    GeoJson,
    Kml,
    Csv,
    Tum,
}

/// What was written, in words.
pub(super) fn write(
    map: &MapFile,
    format: PlacedFormat,
    arguments: &ExportArguments,
) -> anyhow::Result<String> {
    let out = arguments.out.as_path();
    let poses = poses(format, arguments)?;
    if format == PlacedFormat::Tum {
        replace_file(out, |file| write_track_tum(&poses, file))
            .map_err(|error| files::cannot_write(out, &error))?;
        return Ok(format!("{} poses", poses.len()));
    }
    let placed = placed(map, arguments)?;
    let told = match format {
        PlacedFormat::Las | PlacedFormat::Laz => {
            let compression = match format {
                PlacedFormat::Laz => Compression::Laz,
                _ => Compression::None,
            };
            placed.gaussians(map).map_err(Usage::error)?;
            replace_file(out, |file| write_las(map, &placed, compression, file))
                .map_err(|error| files::cannot_write(out, &error))?;
            format!("{} points", map.gaussians.len())
        }
        PlacedFormat::GeoTiff => write_raster(map, &placed, arguments)?,
        PlacedFormat::GeoJson | PlacedFormat::Kml => {
            let features = features_of(map, &poses, &placed.georeference);
            replace_file(out, |file| match format {
                PlacedFormat::Kml => write_kml(&features, file),
                _ => write_geojson(&features, file),
            })
            .map_err(|error| files::cannot_write(out, &error))?;
            let names: Vec<&str> = features.iter().map(|f| f.name.as_str()).collect();
            match names.is_empty() {
                true => "nothing".to_owned(),
                false => names.join(" and "),
            }
        }
        PlacedFormat::Csv | PlacedFormat::Tum => {
            replace_file(out, |file| write_track_csv(&poses, &placed, file))
                .map_err(|error| files::cannot_write(out, &error))?;
            format!("{} poses", poses.len())
        }
    };
    let crs = match format {
        PlacedFormat::GeoJson | PlacedFormat::Kml => "WGS 84".to_owned(),
        _ => with_convergence(&placed),
    };
    let heights = placed.georeference.datum.in_words();
    Ok(format!("{told} in {crs}, heights above {heights}"))
}

/// The system, and how its north lies there, where that is not true north.
fn with_convergence(placed: &Placed) -> String {
    let grid = placed.crs.grid(&placed.georeference.place).ok();
    match grid.filter(|grid| grid.convergence_deg.abs() > 0.0) {
        Some(grid) => format!(
            "{}, whose north is {:+.3} degrees from true north there",
            placed.crs, grid.convergence_deg
        ),
        None => placed.crs.to_string(),
    }
}

fn write_raster(
    map: &MapFile,
    placed: &Placed,
    arguments: &ExportArguments,
) -> anyhow::Result<String> {
    let out = arguments.out.as_path();
    let cell_m = arguments.cell.unwrap_or(CELL_M);
    let (least_m, most_m) = CELL_LIMITS_M;
    if !(least_m..=most_m).contains(&cell_m) {
        return Err(Usage::error(format!(
            "--cell {cell_m}: cells of a raster have {least_m} to {most_m} m"
        )));
    }
    let raster = Raster::of(map, placed, cell_m).map_err(|error| {
        let hint = match error {
            RasterError::Large { .. } => " (--cell)",
            _ => "",
        };
        Usage::error(format!("map {}: {error}{hint}", arguments.map.display()))
    })?;
    replace_file(out, |file| write_geotiff(&raster, placed, file))
        .map_err(|error| files::cannot_write(out, &error))?;
    let (width, height) = raster.size();
    let count = raster.cell_count();
    Ok(format!(
        "{width} by {height} cells of {cell_m} m, {count} of them filled,"
    ))
}

/// Where the map lies: as asked, else as it says.
fn placed(map: &MapFile, arguments: &ExportArguments) -> anyhow::Result<Placed> {
    let asked = placing::asked(&arguments.place)?;
    let held = map.notes.georeference.clone();
    let georeference: Georeference = asked.or(held).ok_or_else(|| {
        Usage::error(format!(
            "map {}: it does not say where on Earth it lies: give --origin LAT,LON,ALT, or put that into the map \
             with `echosplat georeference`",
            arguments.map.display()
        ))
    })?;
    let georeference = match arguments.separation {
        Some(separation_m) => georeference.over_ellipsoid(separation_m),
        None => georeference,
    };
    let crs = match &arguments.crs {
        Some(text) => Crs::parse(text),
        None => Crs::utm_of(&georeference.place),
    };
    Ok(Placed {
        georeference,
        crs: crs.map_err(|error| Usage::error(format!("--crs: {error}")))?,
    })
}

/// The poses of the track, if the format has one.
fn poses(format: PlacedFormat, arguments: &ExportArguments) -> anyhow::Result<Vec<StampedPose>> {
    let needs = matches!(format, PlacedFormat::Csv | PlacedFormat::Tum);
    match &arguments.track {
        Some(path) => track(path),
        None if needs => Err(Usage::error(format!(
            "export to {}: a track needs the dive's poses: --track F.tum, a recording or a log",
            arguments.out.display()
        ))),
        None => Ok(Vec::new()),
    }
}

/// All poses of a trajectory, a recording or a log.
pub(crate) fn track(path: &Path) -> anyhow::Result<Vec<StampedPose>> {
    let is_log = matches!(Kind::of(path), Ok(Kind::Recording | Kind::Log));
    let source = match is_log {
        true => {
            Replayed::open(&[path.to_owned()])?
                .pose_source(None, None)?
                .0
        }
        false => inputs::poses(&PoseUrl::Tum(path.to_owned()), None, StampClock::Data)?,
    };
    Ok(match source {
        PoseSource::File(poses) => poses.collect(),
        PoseSource::Recorded(poses) => poses.map(|arrived| arrived.pose).collect(),
        _ => Vec::new(),
    })
}
