//! Maps as files, with errors that name them.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use echosplat_georeference::Georeference;
use echosplat_model::glam::DVec3;
use echosplat_model::{Snapshot, Standing, Timestamp};
use echosplat_recording::ply::{self, MapFile, ambiguous_path, is_worth_keeping};

use crate::exit::{Finish, Usage};
use crate::files;

pub use echosplat_recording::ply::MapNotes;

/// What is said in every map of a run. Where on Earth it lies may become known while it goes on.
#[derive(Debug, Clone, Default)]
pub struct RunNotes {
    notes: MapNotes,
    learned: Arc<OnceLock<Georeference>>,
}

impl RunNotes {
    /// Has all copies say from now on where the maps lie; whether that was not known yet.
    pub(crate) fn learn(&self, place: Georeference) -> bool {
        self.notes.georeference.is_none() && self.learned.set(place).is_ok()
    }

    fn now(&self) -> MapNotes {
        let mut notes = self.notes.clone();
        let learned = || self.learned.get().cloned();
        notes.georeference = notes.georeference.or_else(learned);
        notes
    }
}

impl From<MapNotes> for RunNotes {
    fn from(notes: MapNotes) -> Self {
        Self {
            notes,
            learned: Arc::default(),
        }
    }
}

/// Where a map went.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The file of what it asserts; `None` if an earlier map was worth more.
    pub path: Option<PathBuf>,
    /// Whether an earlier map stands at the place asked for.
    pub earlier_kept: bool,
}

/// Refuses a map that could not be written before hours are spent on it.
///
/// # Errors
/// If its directory cannot be made or written to, or something else than a file is there.
pub(crate) fn prepare(map: &Path) -> anyhow::Result<()> {
    files::prepare("--map", map)?;
    files::prepare("--map", &ambiguous_path(map))
}

/// Writes what the map asserts to `map` and the ambiguous rest beside it. A map that asserts nothing
/// never takes the place of one that does: it goes to `map.new.ply`, or nowhere if it is empty.
///
/// # Errors
/// If one of the two cannot be written; an earlier map is then as it was.
pub fn write(snapshot: &Snapshot, map: &Path, notes: &RunNotes) -> anyhow::Result<Written> {
    check_replaceable(map)?;
    let sound = || snapshot.gaussians.iter().filter(|g| g.is_sound());
    let asserts = sound().any(|g| g.standing == Standing::Confident);
    if asserts || !is_worth_keeping(map) {
        write_to(snapshot, map, notes)?;
        return Ok(Written {
            path: Some(map.to_owned()),
            earlier_kept: false,
        });
    }
    let beside = new_path(map);
    let path = sound().next().is_some().then_some(beside);
    if let Some(path) = &path {
        write_to(snapshot, path, notes)?;
    }
    let rest = path.as_ref().map(|path| ambiguous_path(path));
    tracing::warn!(
        map = %map.display(),
        ambiguous = rest.map(|path| path.display().to_string()),
        "this map asserts nothing, so the earlier one is kept"
    );
    Ok(Written {
        path,
        earlier_kept: true,
    })
}

/// # Errors
/// If something else than a file stands by now where the map or its ambiguous part goes.
pub(crate) fn check_replaceable(map: &Path) -> anyhow::Result<()> {
    for path in [map, &ambiguous_path(map)] {
        files::replaceable(path)
            .map_err(|why| anyhow::anyhow!("cannot write {}: {why}", path.display()))?;
    }
    Ok(())
}

fn write_to(snapshot: &Snapshot, map: &Path, notes: &RunNotes) -> anyhow::Result<()> {
    check_replaceable(map)?;
    let (origin_m, unit) = (snapshot.origin_m, snapshot.intensity_unit);
    let written = ply::write_map(map, origin_m, unit, &snapshot.gaussians, &notes.now())
        .map_err(|error| files::cannot_write(map, &error))?;
    tracing::info!(
        map = %map.display(),
        confident = written.confident_count,
        ambiguous = written.ambiguous_count,
        left_out = written.left_out_count,
        "map written"
    );
    Ok(())
}

/// `map.new.ply` of a `map.ply`.
fn new_path(map: &Path) -> PathBuf {
    numbered(map, "new")
}

/// Where the map of an earlier epoch is kept: `map.1.ply` of a `map.ply`, or with the next number
/// that no file has.
pub(crate) fn epoch_path(map: &Path, epoch: u32) -> PathBuf {
    let is_free = |path: &PathBuf| !path.exists() && !ambiguous_path(path).exists();
    let paths = (epoch..=u32::MAX).map(|number| numbered(map, &number.to_string()));
    let mut free = paths.filter(is_free);
    free.next().unwrap_or_else(|| new_path(map))
}

/// With a word before its extension.
fn numbered(map: &Path, word: &str) -> PathBuf {
    let extension = map.extension().map(|e| e.to_string_lossy().into_owned());
    map.with_extension(format!("{word}.{}", extension.as_deref().unwrap_or("ply")))
}

/// A map of nothing, as it is before the first ping.
pub(crate) fn empty() -> Snapshot {
    Snapshot {
        epoch: 0,
        sequence: 0,
        time: Timestamp::ZERO,
        through_ping: 0,
        origin_m: DVec3::ZERO,
        intensity_unit: 1.0,
        gaussians: Vec::new(),
    }
}

/// Reads a map and its ambiguous part; a missing or foreign file is the user's mistake. What is left
/// out of it is told here, and [`finish_of`] what that means.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn read(map: &Path) -> anyhow::Result<MapFile> {
    let refused = |why: String| Usage::error(format!("map {}: {why}", map.display()));
    echosplat_input::readable(map).map_err(refused)?;
    let file = ply::read_map(map).map_err(|error| refused(error.to_string()))?;
    if file.refused.count > 0 {
        tracing::warn!("map {}: {}", map.display(), file.refused);
    }
    if !file.lacks.is_empty() {
        tracing::warn!("map {} has no {}", map.display(), file.lacks.join("; no "));
    }
    Ok(file)
}

/// How a command ends that used this map: lossy if something of it was left out.
#[must_use]
pub(crate) fn finish_of(map: &MapFile) -> Finish {
    match map.refused.count {
        0 => Finish::Done,
        _ => Finish::Lossy,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::{DVec3, Quat, Vec3};
    use echosplat_model::{Gaussian, Timestamp};

    fn snapshot(standings: &[Standing]) -> Snapshot {
        let gaussian = |standing: &Standing| Gaussian {
            id: 0,
            mean_m: Vec3::X,
            rotation: Quat::IDENTITY,
            scale_m: Vec3::splat(0.1),
            opacity: 0.5,
            reflectivity: 0.5,
            sigma_m: 0.1,
            position_covariance_m2: Gaussian::known_alike_m2(0.1),
            probability: 1.0,
            standing: *standing,
            why: echosplat_model::Why::default(),
        };
        Snapshot {
            epoch: 0,
            sequence: 0,
            time: Timestamp::ZERO,
            through_ping: 0,
            origin_m: DVec3::ZERO,
            intensity_unit: 1.0,
            gaussians: standings.iter().map(gaussian).collect(),
        }
    }

    fn held(map: &Path) -> (usize, u64) {
        let read = read(map).unwrap();
        (read.gaussians.len(), read.notes.held_out_every)
    }

    #[test]
    fn a_map_that_asserts_nothing_replaces_none_that_does() {
        use Standing::{Ambiguous, Confident};
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("map.ply");
        let notes = RunNotes::from(MapNotes {
            held_out_every: 20,
            ..MapNotes::default()
        });
        let write = |standings: &[Standing]| write(&snapshot(standings), &map, &notes).unwrap();
        let there = Written {
            path: Some(map.clone()),
            earlier_kept: false,
        };
        // Nothing over nothing, and something over nothing.
        for standings in [&[][..], &[], &[Ambiguous], &[Confident, Ambiguous]] {
            assert_eq!(write(standings), there);
            assert_eq!(held(&map), (standings.len(), 20));
        }
        let kept = |path: Option<PathBuf>| Written {
            path,
            earlier_kept: true,
        };
        assert_eq!(write(&[]), kept(None));
        let beside = folder.path().join("map.new.ply");
        assert_eq!(write(&[Ambiguous; 3]), kept(Some(beside.clone())));
        assert_eq!(held(&map), (2, 20));
        assert_eq!(held(&beside), (3, 20));
        assert_eq!(write(&[Confident]), there);
        assert_eq!(held(&map), (1, 20));
    }

    #[test]
    fn maps_of_earlier_epochs_have_names_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("map.ply");
        let name = |path: PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(name(epoch_path(&map, 1)), "map.1.ply");
        std::fs::write(folder.path().join("map.1.ply"), "").unwrap();
        std::fs::write(folder.path().join("map.2.ambiguous.ply"), "").unwrap();
        assert_eq!(name(epoch_path(&map, 1)), "map.3.ply");
        assert_eq!(name(epoch_path(&folder.path().join("map"), 4)), "map.4.ply");
    }

    #[test]
    fn what_cannot_be_written_leaves_the_earlier_map() {
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("map.ply");
        let notes = RunNotes::default();
        write(&snapshot(&[Standing::Confident]), &map, &notes).unwrap();
        // Where the ambiguous part would go is a directory by now.
        let beside = ambiguous_path(&map);
        std::fs::remove_file(&beside).unwrap();
        std::fs::create_dir(&beside).unwrap();
        let failed = write(&snapshot(&[Standing::Confident; 2]), &map, &notes);
        assert!(failed.unwrap_err().to_string().contains("a directory"));
        std::fs::remove_dir(&beside).unwrap();
        assert_eq!(held(&map).0, 1);
    }
}
