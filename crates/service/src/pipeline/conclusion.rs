//! The end of a run: its last map is written and published, and the last of everything told.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use echosplat_model::Snapshot;

use super::ending::Ending;
use super::run::Run;
use super::{Outcome, diagnosis};
use crate::maps;
use crate::recorder::Recorder;
use crate::signals::Stop;

/// How long publishing the final map may take.
const FLUSH_LIMIT: Duration = Duration::from_secs(30);
/// How long telling nodes of ROS of it may take.
const ROS_LIMIT: Duration = Duration::from_secs(2);
/// Those who lost part of the final map ask for it again within so long, and have it after so long:
/// over a link that takes what it gets at once, and over a slow one, where that is underway for
/// seconds before it shows that a part is missing.
const LINGER: Linger = Linger {
    quiet: Duration::from_millis(500),
    limit: Duration::from_secs(5),
};
const LINGER_ON_SLOW_LINK: Linger = Linger {
    quiet: Duration::from_secs(4),
    limit: Duration::from_secs(40),
};
/// Publishing the final map takes longer on a slow link.
const SLOW_FLUSH: Duration = Duration::from_secs(1);
/// How often is looked again whether somebody asks.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

/// How long it is stayed for those who ask.
#[derive(Debug, Clone, Copy)]
struct Linger {
    /// After the newest answer.
    quiet: Duration,
    /// At most.
    limit: Duration,
}

impl Run {
    /// Takes the finished map, or the map as it stands if there is no time for more, writes and
    /// publishes it whole, and tells the last of everything.
    pub(super) fn conclude(mut self, ending: &Ending, stop: &Stop) -> anyhow::Result<Outcome> {
        let worker = self.worker.take().context("a run ends once")?;
        let worker_ended = worker.is_finished();
        // A panic in it is told by its heartbeat.
        let finished = match worker_ended {
            true => worker.join().ok().flatten(),
            false => None,
        };
        let snapshot = finished.unwrap_or_else(|| self.map_as_it_stands());
        let status = self.status(false);
        let frames = self.diagnosis.frames(&status).into_iter();
        let found = frames.chain(diagnosis::calibration(&status));
        let found = found.chain(self.known.clone());
        self.note(found.collect(), Instant::now());
        self.keep_room(Some(&snapshot));
        let written = self.write_map(&snapshot);
        let tracked = self.write_track();
        self.recorder.iter().for_each(Recorder::release_room);
        let kept = match self.album.take().filter(|_| worker_ended) {
            Some(album) => album.finish(),
            None => Ok(()),
        };
        if let Some(page) = &self.hooks.page {
            page.map_is_final();
        }
        let linger = self.publish_final(ending);
        self.tell(true)?;
        let status = self.status(true);
        if let Some(recorder) = &self.recorder {
            recorder.finish();
        }
        if let Some(why) = ending.failure() {
            written?;
            return Err(anyhow!("{why}; map and recording hold what came before"));
        }
        if let Some(on_final) = self.hooks.on_final.take() {
            on_final(&snapshot);
        }
        if let Some(linger) = linger.filter(|_| !ending.is_asked()) {
            self.stay(linger, stop);
        }
        drop(self.published.alive);
        written?;
        tracked?;
        kept?;
        let place = self.notes.place_of(snapshot.epoch);
        Ok(Outcome {
            snapshot,
            place,
            status,
        })
    }

    fn map_as_it_stands(&self) -> Arc<Snapshot> {
        tracing::warn!(
            "ended before the dive was gone through once more: the map is written as it stands; \
             `echosplat replay` of the recording finishes it"
        );
        let newest = self.shared.newest_map();
        newest.unwrap_or_else(|| Arc::new(maps::empty()))
    }

    fn write_track(&self) -> anyhow::Result<()> {
        let Some(path) = &self.track else {
            return Ok(());
        };
        let Some(track) = self.shared.take_track() else {
            tracing::warn!(
                "the map was not finished, so {} is not written: `echosplat replay --track` of the recording writes it",
                path.display()
            );
            return Ok(());
        };
        if track.is_empty() {
            // An earlier way at the same place is worth more than nothing.
            tracing::warn!("no ping was mapped, so no way is written");
            return Ok(());
        }
        track.write(path)?;
        tracing::info!(track = %path.display(), "way written");
        Ok(())
    }

    fn write_map(&mut self, snapshot: &Snapshot) -> anyhow::Result<()> {
        let Some(keeper) = self.keeper.take() else {
            return Ok(());
        };
        let mut is_written = self.saving.is_written();
        // A mapper that hangs may not have reported the pings of the map that it handed on.
        let holds_nothing = snapshot.gaussians.is_empty();
        if holds_nothing && self.shared.report().pings_mapped == 0 {
            // An earlier map at the same place is worth more than nothing.
            tracing::warn!("no ping was mapped, so no map is written");
            return maps::check_replaceable(keeper.map());
        }
        keeper.finish(snapshot)?;
        *is_written = true;
        Ok(())
    }

    /// Says how long to stay afterwards; `None` without a bus.
    fn publish_final(&self, ending: &Ending) -> Option<Linger> {
        let publisher = self.published.map.as_ref()?;
        let begin = Instant::now();
        match publisher.flush(ending.limited(FLUSH_LIMIT)) {
            Ok(report) => tracing::debug!(?report, "the final map is published"),
            Err(error) => tracing::warn!(%error, "subscribers may not have the final map"),
        }
        let is_slow = publisher.is_slowed() || begin.elapsed() > SLOW_FLUSH;
        if let Some(ros) = &self.published.ros
            && !ros.flush(ending.limited(ROS_LIMIT))
        {
            tracing::warn!("nodes of ROS may not have the final map");
        }
        Some(if is_slow { LINGER_ON_SLOW_LINK } else { LINGER })
    }

    /// Stays until nobody asks any more, or the user wants an end.
    fn stay(&self, linger: Linger, stop: &Stop) {
        let Some(publisher) = &self.published.map else {
            return;
        };
        let begin = Instant::now();
        let is_quiet = || {
            let newest = publisher.answered().map_or(begin, |at| at.max(begin));
            newest.elapsed() >= linger.quiet
        };
        while !is_quiet() && begin.elapsed() < linger.limit && !stop.is_set() {
            std::thread::sleep(LOOK_AGAIN);
        }
    }
}
