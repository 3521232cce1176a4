//! The map as it was at moments of the dive, a file each: for time-lapses and for judging.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::Context;
use crossbeam_channel::{Sender, bounded};
use echosplat_liveness::Heartbeat;

use super::outlet::{Observed, Observer, Schedule};
use crate::exit::Usage;
use crate::maps::{self, RunNotes};

/// Maps that wait for the disk; beyond it the dive waits, since each was asked for.
const QUEUE: usize = 4;

/// Where maps go and how often one is kept.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Album {
    every_s: u32,
    folder: PathBuf,
}

/// Writes maps, on a thread of its own.
#[derive(Debug)]
pub(crate) struct AlbumWriter {
    maps: Option<Sender<(Observed, PathBuf)>>,
    thread: JoinHandle<Option<()>>,
    heartbeat: Heartbeat,
    fault: Arc<Mutex<Option<String>>>,
}

impl Album {
    /// Of what follows `--maps-every`.
    ///
    /// # Errors
    /// If the first is no whole number of seconds above 0.
    pub(crate) fn parse(words: Option<&[String]>) -> anyhow::Result<Option<Self>> {
        let Some(words) = words else { return Ok(None) };
        let [seconds, folder] = words else {
            return Err(Usage::error("--maps-every takes SECONDS and DIR"));
        };
        let every_s = seconds.parse().ok().filter(|&seconds: &u32| seconds > 0);
        let every_s = every_s.ok_or_else(|| {
            Usage::error(format!(
                "--maps-every {seconds}: give whole seconds, 1 or more"
            ))
        })?;
        Ok(Some(Self {
            every_s,
            folder: folder.into(),
        }))
    }

    /// Makes the folder and begins to write into it; the observer takes what is to be kept.
    ///
    /// # Errors
    /// If the folder or the thread cannot be made.
    pub(crate) fn open(self, notes: RunNotes) -> anyhow::Result<(AlbumWriter, Observer)> {
        let folder = &self.folder;
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let (sender, receiver) = bounded::<(Observed, PathBuf)>(QUEUE);
        let fault = Arc::new(Mutex::new(None));
        let told = Arc::clone(&fault);
        let write_all = move || {
            for (observed, path) in receiver {
                if let Err(error) = maps::write(&observed.snapshot, &path, &notes) {
                    let words = crate::exit::one_line(&error);
                    told.lock()
                        .unwrap_or_else(PoisonError::into_inner)
                        .get_or_insert(words);
                }
            }
        };
        let heartbeat = Heartbeat::new("maps-every");
        let beats = heartbeat.clone();
        let thread = std::thread::Builder::new()
            .name("maps-every".to_owned())
            .spawn(move || beats.run_once(write_all))
            .context("cannot start the thread that keeps maps")?;
        let maps = sender.clone();
        let observer = Observer {
            schedule: Schedule::Multiples(f64::from(self.every_s)),
            take: Box::new(move |observed| {
                let path = self.path(observed.moment.dive_s);
                let _ = maps.send((observed, path));
            }),
        };
        let writer = AlbumWriter {
            maps: Some(sender),
            thread,
            heartbeat,
            fault,
        };
        Ok((writer, observer))
    }

    /// `DIR/0120.ply` of a map made so long after the first ping, or a little later.
    fn path(&self, dive_s: f64) -> PathBuf {
        let multiple = (dive_s / f64::from(self.every_s)).floor() as u64 * u64::from(self.every_s);
        self.folder.join(format!("{multiple:04}.ply"))
    }
}

impl AlbumWriter {
    /// Whether its thread is alive.
    pub(crate) fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// What the disk refused first.
    pub(crate) fn fault(&self) -> Option<String> {
        let fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner);
        fault.clone()
    }

    /// Waits for the last map, once the observer is gone.
    ///
    /// # Errors
    /// If one could not be written.
    pub(crate) fn finish(mut self) -> anyhow::Result<()> {
        self.maps = None;
        let fault = Arc::clone(&self.fault);
        self.thread
            .join()
            .ok()
            .flatten()
            .context("the thread that keeps maps panicked; the log above says where")?;
        let fault = fault.lock().unwrap_or_else(PoisonError::into_inner).take();
        fault.map_or(Ok(()), |words| Err(anyhow::anyhow!(words)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(words: [&str; 2]) -> Vec<String> {
        words.map(str::to_owned).to_vec()
    }

    #[test]
    fn a_map_is_named_by_the_moment_that_was_asked_for() {
        let album = Album::parse(Some(&words(["30", "out"]))).unwrap().unwrap();
        let name = |dive_s: f64| album.path(dive_s);
        assert_eq!(name(120.07), PathBuf::from("out/0120.ply"));
        assert_eq!(name(12_000.0), PathBuf::from("out/12000.ply"));
    }

    #[test]
    fn seconds_that_are_none_are_refused() {
        for seconds in ["0", "-1", "1.5", "often"] {
            let refused = Album::parse(Some(&words([seconds, "out"]))).unwrap_err();
            assert!(refused.to_string().contains("whole seconds"), "{refused}");
        }
    }
}
