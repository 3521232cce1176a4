//! Maps of epochs that are over: finished on threads of their own while the next map is made, and
//! written beside it.

use std::path::PathBuf;
use std::thread::JoinHandle;

use echosplat_mapper::Mapper;

use crate::maps::{self, RunNotes};

/// Finishes and keeps the maps of earlier epochs.
#[derive(Debug, Default)]
pub(crate) struct EarlierMaps {
    /// Where the newest map goes; those before go beside it, under a number.
    map: Option<PathBuf>,
    notes: RunNotes,
    count: u32,
    /// Of those that have ended nothing is kept: each would hold on to its thread's stack.
    finishing: Vec<JoinHandle<()>>,
}

impl EarlierMaps {
    /// Beside the map at this place, if it is kept.
    pub(crate) fn beside(place: Option<(PathBuf, RunNotes)>) -> Self {
        let (map, notes) = place.unzip();
        let notes = notes.unwrap_or_default();
        Self {
            map,
            notes,
            count: 0,
            finishing: Vec::new(),
        }
    }

    /// Goes through the whole dive of `mapper` once more and writes what it gives.
    ///
    /// `epoch` is that of its snapshots.
    pub(crate) fn keep(&mut self, mut mapper: Mapper, epoch: u64) {
        let Some(map) = self.map.clone() else {
            tracing::warn!("the map of the poses before is let go; --map keeps it");
            return;
        };
        self.finishing.retain(|thread| !thread.is_finished());
        self.count += 1;
        let (notes, number) = (self.notes.clone(), self.count);
        let work = move || {
            let mut snapshot = mapper.finish();
            snapshot.epoch = epoch;
            let path = maps::epoch_path(&map, number);
            if let Err(error) = maps::write(&snapshot, &path, &notes) {
                tracing::error!("{error:#}");
            }
        };
        let thread = std::thread::Builder::new().name("earlier-map".to_owned());
        match thread.spawn(work) {
            Ok(thread) => self.finishing.push(thread),
            Err(error) => tracing::error!(%error, "the map of the poses before is lost"),
        }
    }

    /// Waits until all are written.
    pub(crate) fn finish(self) {
        for thread in self.finishing {
            if thread.join().is_err() {
                tracing::error!("finishing an earlier map panicked; the log above says where");
            }
        }
    }
}
