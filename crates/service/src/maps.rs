//! Maps as files, with errors that name them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use echosplat_georeference::Georeference;
use echosplat_model::glam::DVec3;
use echosplat_model::{Snapshot, Standing, Timestamp};
use echosplat_recording::ply::{self, MapFile, ambiguous_path, is_worth_keeping};

use crate::exit::{Finish, Usage};
use crate::files;

pub use echosplat_recording::ply::MapNotes;

/// What is said in every map of a run. Where on Earth a map lies may become known while it goes on, and is then said of
/// maps of the same epoch of poses alone: those of another count from elsewhere.
#[derive(Debug, Clone, Default)]
pub struct RunNotes {
    notes: MapNotes,
    learned: Arc<Mutex<Learned>>,
}

#[derive(Debug, Default)]
struct Learned {
    /// By the epoch of poses.
    places: BTreeMap<u32, Georeference>,
    /// Epoch of poses of each map, by the epoch of its snapshots.
    maps: BTreeMap<u64, u32>,
}

/// Epochs that are remembered; beyond, the oldest go.
const MOST_EPOCHS: usize = 4_096;

impl RunNotes {
    /// Has all copies say from now on where the maps of this epoch of poses lie, unless that is known; then what is.
    pub(crate) fn learn(&self, epoch: u32, place: &Georeference) -> Option<Georeference> {
        if let Some(given) = &self.notes.georeference {
            return Some(given.clone());
        }
        let mut learned = self.lock();
        if let Some(known) = learned.places.get(&epoch) {
            return Some(known.clone());
        }
        if learned.places.len() == MOST_EPOCHS {
            learned.places.pop_first();
        }
        learned.places.insert(epoch, place.clone());
        None
    }

    /// Snapshots with this epoch are of a map made of poses of that epoch from now on. Tells what that means for its place on
    /// Earth, if maps went before.
    pub(crate) fn map_begins(&self, map: u64, poses: u32) {
        let mut learned = self.lock();
        let is_first = learned.maps.is_empty();
        if learned.maps.len() == MOST_EPOCHS {
            learned.maps.pop_first();
        }
        learned.maps.insert(map, poses);
        if is_first {
            return;
        }
        if self.notes.georeference.is_some() {
            tracing::warn!(
                "a new epoch of poses: the map that begins keeps the place on Earth that was given for the one before; if \
                 poses count from elsewhere now, `echosplat georeference` puts the right one into it"
            );
        } else if !learned.places.is_empty() && !learned.places.contains_key(&poses) {
            tracing::warn!(
                "a new epoch of poses, which may count from elsewhere: the map that begins has no place on Earth until \
                 the vehicle or a receiver tells it again"
            );
        }
    }

    /// Where on Earth the map of snapshots with this epoch lies, if that is known.
    pub(crate) fn place_of(&self, map: u64) -> Option<Georeference> {
        self.of_map(map).georeference
    }

    fn of_map(&self, map: u64) -> MapNotes {
        let mut notes = self.notes.clone();
        let learned = self.lock();
        let poses = learned.maps.get(&map);
        let place = poses.and_then(|poses| learned.places.get(poses));
        notes.georeference = notes.georeference.or_else(|| place.cloned());
        notes
    }

    fn lock(&self) -> MutexGuard<'_, Learned> {
        self.learned.lock().unwrap_or_else(PoisonError::into_inner)
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
    let written = ply::write_map(
        map,
        origin_m,
        unit,
        &snapshot.gaussians,
        &notes.of_map(snapshot.epoch),
    )
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
/// out of it is told here; what that means is told when the command ends.
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
    fn a_place_that_was_learned_is_that_of_one_epoch_of_poses() {
        use echosplat_georeference::{Datum, Place};
        let place = |latitude_deg: f64| {
            let place = Place::new(latitude_deg, 24.94, 0.0).unwrap();
            Georeference::at_origin(place, Datum::MeanSea, "test")
        };
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("map.ply");
        let written = |notes: &RunNotes, epoch: u64| {
            let snapshot = Snapshot {
                epoch,
                ..snapshot(&[Standing::Confident])
            };
            write(&snapshot, &map, notes).unwrap();
            read(&map).unwrap().notes.georeference
        };
        let notes = RunNotes::default();
        notes.map_begins(70, 0);
        assert_eq!(written(&notes, 70), None);
        assert_eq!(notes.learn(0, &place(60.0)), None);
        assert_eq!(
            notes.learn(0, &place(61.0)),
            Some(place(60.0)),
            "the first stays"
        );
        assert_eq!(written(&notes, 70), Some(place(60.0)));
        notes.map_begins(71, 2);
        assert_eq!(written(&notes, 71), None, "another world");
        assert_eq!(written(&notes, 70), Some(place(60.0)));
        assert_eq!(notes.learn(2, &place(62.0)), None);
        assert_eq!(written(&notes, 71), Some(place(62.0)));
        // What its owner gave is the owner's word for all.
        let given = RunNotes::from(MapNotes {
            georeference: Some(place(59.0)),
            ..MapNotes::default()
        });
        given.map_begins(70, 0);
        given.map_begins(71, 1);
        assert_eq!(given.learn(1, &place(62.0)), Some(place(59.0)));
        assert_eq!(written(&given, 71), Some(place(59.0)));
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
