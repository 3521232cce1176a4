//! Ctrl-C, SIGTERM and a terminal that is closed: the first asks for an orderly end, as a run does that
//! cannot go on. A later one ends the program at once, and so does the time that an orderly end may
//! take, and a run whose own thread hangs: after what can be saved was saved.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use echosplat_liveness::{Condition, Heartbeat};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::{flag, low_level};

/// Shells and supervisors send one request several times over; only a later one is impatience.
const ONE_REQUEST: Duration = Duration::from_secs(1);
/// How often signals are looked for.
const LOOK: Duration = Duration::from_millis(20);
/// How long an orderly end of a run may take.
const ORDERLY_END: Duration = Duration::from_secs(10);
/// How long saving may take before an end at once.
const SAVING: Duration = Duration::from_secs(3);
/// Exit code of a run that did not end in order within its time.
const NOT_IN_ORDER: i32 = 1;

/// What saves a run's map and recording, whatever its threads are doing.
pub(crate) type LastWill = Box<dyn FnOnce() + Send>;

/// Whether the program shall end; cheap to copy and to ask.
#[derive(Clone, Default)]
pub struct Stop(Arc<Shared>);

#[derive(Default)]
struct Shared {
    asked: AtomicBool,
    /// The newest signal that nobody has looked at; 0 for none.
    raised: Arc<AtomicUsize>,
    run: Mutex<Option<RunUnderWay>>,
}

struct RunUnderWay {
    last_will: LastWill,
    /// Of the thread that watches over all other parts.
    heartbeat: Heartbeat,
}

impl std::fmt::Debug for Stop {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Stop").field(&self.0.asked).finish()
    }
}

impl Stop {
    /// Set by the first Ctrl-C, SIGTERM or SIGHUP.
    ///
    /// # Errors
    /// If the handlers cannot be installed, or there is no thread to attend to them.
    pub fn on_signals() -> anyhow::Result<Self> {
        let stop = Self::default();
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            let number = usize::try_from(signal).unwrap_or(1);
            flag::register_usize(signal, Arc::clone(&stop.0.raised), number)
                .context("cannot install the handlers of Ctrl-C, SIGTERM and SIGHUP")?;
        }
        let shared = Arc::clone(&stop.0);
        std::thread::Builder::new()
            .name("signals".to_owned())
            .spawn(move || shared.attend())
            .context("cannot start the thread that attends to signals")?;
        Ok(stop)
    }

    /// Whether to end; to be asked now and then.
    pub fn is_set(&self) -> bool {
        self.0.asked.load(Ordering::Relaxed)
    }

    /// The run cannot go on: as if a signal had come.
    pub(crate) fn ask(&self) {
        self.0.asked.store(true, Ordering::Relaxed);
    }

    /// From now on a run is under way: once asked to end it has ten seconds, and `last_will` is done
    /// before it is ended at once. It is ended at once, too, where the thread that watches over it
    /// hangs.
    pub(crate) fn run_begins(&self, last_will: LastWill, heartbeat: Heartbeat) {
        *self.0.run() = Some(RunUnderWay {
            last_will,
            heartbeat,
        });
    }

    /// What the run leaves is saved.
    pub(crate) fn run_ends(&self) {
        *self.0.run() = None;
    }
}

impl Shared {
    fn run(&self) -> MutexGuard<'_, Option<RunUnderWay>> {
        self.run.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends a run whose own thread hangs.
    fn look_after_run(&self) {
        let condition = self.run().as_ref().map(|run| run.heartbeat.condition());
        if let Some(Condition::Hung(silent)) = condition {
            tracing::error!(
                "the thread that watches over the run has hung for {} s: ending at once",
                silent.as_secs()
            );
            self.end_at_once(NOT_IN_ORDER);
        }
    }

    /// Waits for signals as long as the program lives.
    fn attend(&self) {
        while !self.asked.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK);
            self.look_after_run();
            if self.raised.swap(0, Ordering::Relaxed) != 0 {
                self.asked.store(true, Ordering::Relaxed);
            }
        }
        let first = Instant::now();
        loop {
            std::thread::sleep(LOOK);
            self.look_after_run();
            let signal = self.raised.swap(0, Ordering::Relaxed);
            if signal != 0 && first.elapsed() > ONE_REQUEST {
                tracing::warn!("asked to end again: ending at once");
                self.end_at_once(i32::try_from(signal).map_or(NOT_IN_ORDER, |s| 128 + s));
            }
            if first.elapsed() > ORDERLY_END && self.run().is_some() {
                tracing::error!(
                    "the run did not end within {} s of being asked to: ending at once",
                    ORDERLY_END.as_secs()
                );
                self.end_at_once(NOT_IN_ORDER);
            }
        }
    }

    /// Saves what can be within its time, and ends without asking any other thread.
    fn end_at_once(&self, code: i32) -> ! {
        if let Some(RunUnderWay { last_will, .. }) = self.run().take() {
            let (done, waits) = crossbeam_channel::bounded::<()>(0);
            let saving = std::thread::Builder::new().name("last-will".to_owned());
            let saving = saving.spawn(move || {
                last_will();
                drop(done);
            });
            if saving.is_ok() {
                // Ends with the thread's end of the channel; nothing is ever sent.
                let _ = waits.recv_timeout(SAVING);
            }
        }
        low_level::exit(code)
    }
}
