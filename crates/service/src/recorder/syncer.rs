//! Makes what was written survive a power cut, on a thread of its own: a disk may take seconds.
//! The same thread sees whether the files are still where they were begun.

use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use echosplat_liveness::Heartbeat;

use super::progress::Progress;

/// Time between two syncs.
const SYNC_EVERY: Duration = Duration::from_millis(500);

/// The other side of the thread. Dropping it ends the thread, without waiting.
pub(super) struct Syncer(Arc<Shared>);

#[derive(Default)]
struct Shared {
    files: Mutex<Files>,
    ended: Condvar,
    vanished: AtomicBool,
}

#[derive(Default)]
struct Files {
    /// Those being written.
    open: Vec<(PathBuf, Arc<File>)>,
    /// Those that got their end since the last sync.
    closed: Vec<Arc<File>>,
    is_over: bool,
}

impl Syncer {
    pub(super) fn start(progress: Arc<Progress>, heartbeat: Heartbeat) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let of_thread = Arc::clone(&shared);
        std::thread::Builder::new()
            .name("recorder-sync".to_owned())
            .spawn(move || heartbeat.run_again(|| of_thread.run(&progress, &heartbeat)))?;
        Ok(Self(shared))
    }

    /// From now on these are the files being written; those before are synced once more.
    pub(super) fn watch(&self, files: Vec<(PathBuf, File)>) {
        let open = files.into_iter().map(|(path, file)| (path, Arc::new(file)));
        let mut state = self.0.lock();
        let before = std::mem::replace(&mut state.open, open.collect());
        state
            .closed
            .extend(before.into_iter().map(|(_, file)| file));
        self.0.vanished.store(false, Ordering::Relaxed);
    }

    /// Whether a file is no longer where it was begun.
    pub(super) fn has_vanished(&self) -> bool {
        self.0.vanished.load(Ordering::Relaxed)
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        self.0.lock().is_over = true;
        self.0.ended.notify_all();
    }
}

impl Shared {
    fn run(&self, progress: &Progress, heartbeat: &Heartbeat) {
        loop {
            heartbeat.beat();
            let state = self.lock();
            let waited = self
                .ended
                .wait_timeout_while(state, SYNC_EVERY, |files| !files.is_over);
            let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
            let is_over = state.is_over;
            let open = state.open.clone();
            let closed = std::mem::take(&mut state.closed);
            drop(state);
            let seen = progress.counters().messages;
            let all = open.iter().map(|(_, file)| file).chain(&closed);
            let failed = all
                .filter_map(|file| file.sync_data().err())
                .reduce(|_, newest| newest);
            progress.synced(failed.map(|error| error.to_string()));
            match open.iter().all(|(path, file)| is_there(path, file)) {
                true => progress.seen(seen),
                false => self.note_vanished(&open),
            }
            if is_over {
                return;
            }
        }
    }

    /// Unless other files are written by now.
    fn note_vanished(&self, looked_at: &[(PathBuf, Arc<File>)]) {
        let state = self.lock();
        let is_same = |(a, b): (&(PathBuf, _), &(PathBuf, _))| a.0 == b.0;
        if state.open.iter().zip(looked_at).all(is_same) {
            self.vanished.store(true, Ordering::Relaxed);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Files> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn is_there(path: &Path, file: &File) -> bool {
    let (Ok(named), Ok(open)) = (std::fs::metadata(path), file.metadata()) else {
        return false;
    };
    (named.dev(), named.ino()) == (open.dev(), open.ino())
}
