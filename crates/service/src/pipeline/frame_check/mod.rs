//! Whether poses can be what they are read as, looked at now and then while a dive goes on. On a
//! thread of its own that nothing waits for; what it cannot take in time it does not look at.
//!
//! Everything is timed by the pings but the rest after a check: in a replay as fast as can be, checks
//! would take the processor from the map.
//!
//! A log that has come to its end is looked at once more, and waited for: read as fast as can be, it may
//! have left no time before.
//!
//! Cost: at most one check in 15 s of the dive, one in 60 s once poses were found right, and a tenth of the
//! thread's time unless one has just been found wrong.

mod watch;

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use crossbeam_channel::{Receiver, Sender, bounded};
use echosplat_liveness::Heartbeat;
use echosplat_mapper::MapperConfig;
use echosplat_model::{Pose, PosedPing};
use echosplat_prediction::frame_check::{FrameVerdict, VehiclePing, judge, judge_tilt};

use super::effort::{Stopwatch, Took};
use watch::Watch;

/// Name of the thread; its time is not the mapper's.
const THREAD_NAME: &str = "frame-check";
/// Pings that wait.
const QUEUE: usize = 1024;
/// After a check that found nothing wrong, so many times its own length without one.
const REST: u32 = 9;
/// The last check of a log is waited for so long.
const LAST_CHECK: Duration = Duration::from_secs(10);

/// The thread, and what it found.
pub(crate) struct FrameCheck {
    /// Gone once nothing more comes.
    pings: Option<Sender<Arrived>>,
    thread_ended: Receiver<()>,
    heartbeat: Heartbeat,
    mount: Pose,
    /// Counts epochs of the poses.
    epoch: AtomicU32,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    is_over: AtomicBool,
    /// Nearer than this pings may ring, metres, as the bits of a number.
    rings_until_m: AtomicU64,
    confirmed: Mutex<Option<FrameVerdict>>,
    stopwatch: Stopwatch,
}

impl Shared {
    fn show(&self, confirmed: Option<FrameVerdict>) {
        *self
            .confirmed
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = confirmed;
    }
}

/// A ping and the epoch of its pose.
struct Arrived {
    epoch: u32,
    ping: VehiclePing,
}

impl FrameCheck {
    /// For poses that sensors were posed by with `mount`, `vehicle_from_sensor` as configured.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub(crate) fn start(config: MapperConfig, mount: Pose) -> anyhow::Result<Self> {
        let (pings, receiver) = bounded(QUEUE);
        let (ends, thread_ended) = bounded(0);
        let heartbeat = Heartbeat::new(THREAD_NAME);
        let beats = heartbeat.clone();
        let shared = Arc::new(Shared::default());
        let shown = Arc::clone(&shared);
        std::thread::Builder::new()
            .name(THREAD_NAME.to_owned())
            .spawn(move || {
                beats.run_once(|| check_all(&receiver, &config, &mount, &shown));
                drop(ends);
            })
            .context("cannot start the thread that checks how poses are read")?;
        Ok(Self {
            pings: Some(pings),
            thread_ended,
            heartbeat,
            mount,
            epoch: AtomicU32::new(0),
            shared,
        })
    }

    /// Whether its thread is alive.
    pub(crate) fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// What checks took so far.
    pub(crate) fn took(&self) -> Took {
        self.shared.stopwatch.took()
    }

    /// Never waits.
    pub(crate) fn ping(&self, posed: &PosedPing) {
        let arrived = Arrived {
            epoch: self.epoch.load(Ordering::Relaxed),
            ping: VehiclePing::of(posed, &self.mount),
        };
        // Full: a check is under way, and will do without this one.
        let _ = self.pings.as_ref().map(|pings| pings.try_send(arrived));
    }

    /// Pings may be heard to ring as far as this, metres: nothing nearer counts from the next check on.
    pub(crate) fn ring_until(&self, range_m: f64) {
        let bits = range_m.to_bits();
        self.shared.rings_until_m.store(bits, Ordering::Relaxed);
    }

    /// Nothing more comes: begins a last check of what came last.
    pub(crate) fn end(&mut self) {
        self.pings = None;
    }

    /// Waits for the last check, if [`FrameCheck::end`] began it.
    pub(crate) fn wait_for_last(&self) {
        if self.pings.is_none() {
            let _ = self.thread_ended.recv_timeout(LAST_CHECK);
        }
    }

    /// What follows belongs to a new epoch of the poses: nothing before it counts.
    pub(crate) fn begin_anew(&self) {
        self.epoch.fetch_add(1, Ordering::Relaxed);
        self.shared.show(None);
    }

    /// What two checks running have found wrong, or one beyond doubt, by the newest; gone again once
    /// two running find the poses right.
    pub(crate) fn verdict(&self) -> Option<FrameVerdict> {
        let confirmed = &self.shared.confirmed;
        *confirmed.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for FrameCheck {
    /// The thread ends after the check under way; nobody waits for it.
    fn drop(&mut self) {
        // Before the channel closes, so that nothing is looked at any more.
        self.shared.is_over.store(true, Ordering::Relaxed);
    }
}

fn check_all(pings: &Receiver<Arrived>, config: &MapperConfig, mount: &Pose, shared: &Shared) {
    let (mut watch, mut rest_until) = (Watch::default(), Instant::now());
    let check = |watch: &mut Watch| {
        let rings_until_m = f64::from_bits(shared.rings_until_m.load(Ordering::Relaxed));
        let config = &MapperConfig {
            blanking_m: config.blanking_m.max(rings_until_m),
            ..config.clone()
        };
        let window = watch.window();
        let visits = window.len() as u64;
        let stopwatch = &shared.stopwatch;
        let verdict = stopwatch.time(visits, || judge(window, mount, config));
        tracing::debug!(?verdict, "how poses are read");
        watch.checked();
        watch.frames.take(verdict);
        let is_telling = verdict.is_some_and(|verdict| verdict.is_telling);
        // Poses that are read wrong look tilted, too.
        let dive = watch.dive();
        let tilt = stopwatch.time(dive.len() as u64, || judge_tilt(dive, mount, config));
        let tilt = tilt.filter(|_| !is_telling);
        tracing::debug!(?tilt, "how the sonar is mounted");
        watch.tilt.take(tilt);
        shared.show(watch.frames.confirmed.or(watch.tilt.confirmed));
        is_telling
    };
    for arrived in pings {
        if shared.is_over.load(Ordering::Relaxed) {
            return;
        }
        watch.take(arrived);
        let now = Instant::now();
        if now < rest_until || !watch.is_due() {
            continue;
        }
        let rest = if check(&mut watch) { 0 } else { REST };
        rest_until = Instant::now() + rest * now.elapsed().max(Duration::from_millis(1));
    }
    if !shared.is_over.load(Ordering::Relaxed) && watch.has_turned() {
        check(&mut watch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_that_nobody_feeds_says_nothing_and_is_let_go() {
        let check = FrameCheck::start(MapperConfig::default(), Pose::IDENTITY).unwrap();
        check.begin_anew();
        assert_eq!(check.verdict(), None);
        drop(check);
    }
}
