//! Maps as files, with errors that name them.

use std::path::Path;

use anyhow::Context;
use echosplat_model::Snapshot;
use echosplat_recording::ply::{self, MapFile};

use crate::exit::Usage;

/// Refuses a map that could not be written before hours are spent on it.
///
/// # Errors
/// If the directory of `map` cannot be made.
pub(crate) fn prepare(map: &Path) -> anyhow::Result<()> {
    let directory = map.parent().unwrap_or(Path::new(""));
    if map.file_name().is_none() || map.is_dir() {
        let message = format!("--map {}: it must name a file", map.display());
        return Err(Usage::error(message));
    }
    if directory.as_os_str().is_empty() {
        return Ok(());
    }
    std::fs::create_dir_all(directory).map_err(|error| {
        let map = map.display();
        Usage::error(format!(
            "--map {map}: its directory cannot be made: {error}"
        ))
    })
}

/// Writes what the map asserts to `map` and the ambiguous rest beside it.
///
/// # Errors
/// If one of the two cannot be written.
pub(crate) fn write(snapshot: &Snapshot, map: &Path) -> anyhow::Result<()> {
    let (origin_m, unit) = (snapshot.origin_m, snapshot.intensity_unit);
    let written = ply::write_map(map, origin_m, unit, &snapshot.gaussians)
        .with_context(|| format!("cannot write the map {}", map.display()))?;
    tracing::info!(
        map = %map.display(),
        confident = written.confident_count,
        ambiguous = written.ambiguous_count,
        left_out = written.left_out_count,
        "map written"
    );
    Ok(())
}

/// Reads a map and its ambiguous part; a missing or foreign file is the user's mistake.
///
/// # Errors
/// Names the file and what is wrong with it.
pub(crate) fn read(map: &Path) -> anyhow::Result<MapFile> {
    ply::read_map(map).map_err(|error| Usage::error(format!("map {}: {error}", map.display())))
}
