//! Room that the map needs on the disk that the recording fills.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// So much is kept at least, or half of a smaller disk, since a map that is small yet grows while the recording
/// waits: 160,000 Gaussians.
const LEAST_BYTES: u64 = 16 << 20;
const LEAST_SHARE: u64 = 2;
/// So much more has to be free before the recording goes on: it shall not stop again at once.
const SLACK_BYTES: u64 = 1 << 20;
/// After so long, or so many bytes written, it is looked again how much is free.
const LOOK_EVERY: Duration = Duration::from_millis(100);
const LOOK_AFTER_BYTES: u64 = 256 << 10;

/// What is kept free for the map; clones are the same.
#[derive(Debug, Clone, Default)]
pub(super) struct Room(Arc<Mutex<Option<Kept>>>);

#[derive(Debug, Clone)]
struct Kept {
    map: PathBuf,
    bytes: u64,
}

/// How much room there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Disk {
    /// Tells it from others.
    pub(super) device: u64,
    pub(super) size_bytes: u64,
    pub(super) free_bytes: u64,
}

/// Says how much room there is where a path is, if that is known.
pub(super) type Look = fn(&Path) -> Option<Disk>;

impl Room {
    /// From now on room is kept for a map of so many bytes at this place.
    pub(super) fn keep(&self, map: &Path, bytes: u64) {
        let map = map.to_owned();
        *self.lock() = Some(Kept { map, bytes });
    }

    /// The map is written, and needs no room any more.
    pub(super) fn release(&self) {
        *self.lock() = None;
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Kept>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How much is free, and how much of it is the map's.
    fn state(&self, recording: &Path, look: Look) -> Option<(u64, u64)> {
        let kept = self.lock().clone()?;
        let disk = look(&kept.map)?;
        let is_shared = look(recording).is_some_and(|other| other.device == disk.device);
        // While a map is replaced, both are there. What it gains until then is taken for what it has.
        let least = LEAST_BYTES.min(disk.size_bytes / LEAST_SHARE);
        let needed = (2 * kept.bytes).max(least);
        is_shared.then_some((disk.free_bytes, needed))
    }
}

/// Of the thread that writes: whether it has to wait.
pub(super) struct Watch {
    room: Room,
    look: Look,
    looked: Option<Instant>,
    written_bytes: u64,
    is_short: bool,
}

/// Too little is free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shortage {
    pub(super) free_bytes: u64,
    /// Of the map.
    pub(super) needed_bytes: u64,
}

impl Watch {
    pub(super) fn new(room: Room, look: Look) -> Self {
        Self {
            room,
            look,
            looked: None,
            written_bytes: 0,
            is_short: false,
        }
    }

    /// Before so many bytes are written at `recording`: `None` where there is room for them and for the map.
    pub(super) fn shortage(&mut self, recording: &Path, bytes: u64) -> Option<Shortage> {
        self.written_bytes += bytes;
        let is_fresh = self.looked.is_some_and(|at| at.elapsed() < LOOK_EVERY);
        if !self.is_short && is_fresh && self.written_bytes < LOOK_AFTER_BYTES {
            return None;
        }
        self.looked = Some(Instant::now());
        let found = self.room.state(recording, self.look);
        // What is written until the next look, and what one whose turn has come takes now.
        let ahead = LOOK_AFTER_BYTES + bytes;
        let slack = if self.is_short { SLACK_BYTES } else { 0 };
        let found = found.filter(|(free, needed)| free.saturating_sub(ahead) < needed + slack);
        self.is_short = found.is_some();
        self.written_bytes = 0;
        found.map(|(free_bytes, needed_bytes)| Shortage {
            free_bytes,
            needed_bytes,
        })
    }
}

/// Asks the system; of a file that is not there yet, where its folder is.
#[cfg(target_os = "linux")]
pub(super) fn look(path: &Path) -> Option<Disk> {
    use std::os::unix::fs::MetadataExt;
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let device = std::fs::metadata(folder).ok()?.dev();
    let found = rustix::fs::statvfs(folder).ok()?;
    Some(Disk {
        device,
        size_bytes: found.f_blocks * found.f_frsize,
        free_bytes: found.f_bavail * found.f_frsize,
    })
}

#[cfg(not(target_os = "linux"))]
pub(super) fn look(_: &Path) -> Option<Disk> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    static FREE: AtomicU64 = AtomicU64::new(0);

    fn fake(path: &Path) -> Option<Disk> {
        let device = u64::from(path.starts_with("other"));
        Some(Disk {
            device,
            size_bytes: 1 << 30,
            free_bytes: FREE.load(Ordering::Relaxed),
        })
    }

    #[test]
    fn the_recording_waits_where_the_map_needs_what_is_free() {
        let room = Room::default();
        let mut watch = Watch::new(room.clone(), fake);
        let mut short = |free: u64, recording: &str| {
            FREE.store(free, Ordering::Relaxed);
            // Enough to be looked at.
            watch.shortage(Path::new(recording), LOOK_AFTER_BYTES)
        };
        assert_eq!(short(0, "log/a.mcap"), None, "no map is kept");
        room.keep(Path::new("map.ply"), 30 << 20);
        assert_eq!(short(0, "other/a.mcap"), None, "it is on another disk");
        let found = short(60 << 20, "log/a.mcap");
        let expected = Shortage {
            free_bytes: 60 << 20,
            needed_bytes: 60 << 20,
        };
        assert_eq!(found, Some(expected));
        let enough = (60 << 20) + 2 * LOOK_AFTER_BYTES;
        assert!(short(enough, "log/a.mcap").is_some(), "not at once again");
        assert_eq!(short(enough + SLACK_BYTES, "log/a.mcap"), None);
        room.keep(Path::new("map.ply"), 1000);
        assert!(short(LEAST_BYTES, "log/a.mcap").is_some(), "it may grow");
        room.release();
        assert_eq!(short(0, "log/a.mcap"), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_system_says_how_much_is_free() {
        let folder = tempfile::tempdir().unwrap();
        let of = |name: &str| look(&folder.path().join(name)).unwrap();
        let (map, log) = (of("map.ply"), of("a.mcap"));
        assert_eq!(map.device, log.device);
        assert!(map.free_bytes <= map.size_bytes && map.size_bytes > 0);
        assert_eq!(look(Path::new("/no/such/folder/map.ply")), None);
    }
}
