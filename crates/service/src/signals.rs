//! Ctrl-C, SIGTERM and a terminal that is closed: the first asks for an orderly end, as a run does that
//! cannot go on. A later one ends the program at once, and so does the time that an orderly end may
//! take, and a run whose own thread hangs: after what can be saved was saved.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::Context;
use echosplat_liveness::{Condition, Heartbeat};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::low_level;
use tokio::select;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::task::block_in_place;
use tokio::time::{Instant, interval};
use tokio_util::sync::CancellationToken;

use crate::{logging, runtime};

/// Shells and supervisors send one request several times over; only a later one is impatience.
const ONE_REQUEST: Duration = Duration::from_secs(1);
/// How often it is asked whether the run's own thread hangs, and whether its time is up.
const LOOK: Duration = Duration::from_millis(50);
/// How long an orderly end of a run may take beside finishing its map.
const ORDERLY_END: Duration = Duration::from_millis(7_500);
/// How long saving may take before an end at once.
const SAVING: Duration = Duration::from_secs(3);
/// Exit code of a run that did not end in order within its time.
const NOT_IN_ORDER: i32 = 1;

static IS_ATTENDED: AtomicBool = AtomicBool::new(false);
static IS_ASKED: AtomicBool = AtomicBool::new(false);

/// Who attends to Ctrl-C, SIGTERM and SIGHUP.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Attended {
    /// The system, which ends the program at once.
    BySystem,
    /// A task of the program; none has come yet.
    ByUs,
    /// The same, and one has come.
    Asked,
}

/// As it is now.
pub(crate) fn attended() -> Attended {
    match (
        IS_ATTENDED.load(Ordering::Relaxed),
        IS_ASKED.load(Ordering::Relaxed),
    ) {
        (false, _) => Attended::BySystem,
        (true, false) => Attended::ByUs,
        (true, true) => Attended::Asked,
    }
}

/// What saves a run's map and recording, whatever its threads are doing.
pub(crate) type LastWill = Box<dyn FnOnce() + Send>;

/// Whether the program shall end; cheap to copy and to ask.
#[derive(Clone, Default)]
pub struct Stop(Arc<Shared>);

#[derive(Default)]
struct Shared {
    asked: CancellationToken,
    run: Mutex<Option<RunUnderWay>>,
}

struct RunUnderWay {
    last_will: LastWill,
    /// Of the thread that watches over all other parts.
    heartbeat: Heartbeat,
    /// How long an orderly end may take.
    ends_within: Duration,
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
    /// If the handlers cannot be installed, or there are no threads for the task that attends to
    /// them.
    pub fn on_signals() -> anyhow::Result<Self> {
        let stop = Self::default();
        let runtime = runtime::handle()?;
        let _here = runtime.enter();
        let signals = Signals::handled();
        let signals = signals.context("cannot handle Ctrl-C, SIGTERM and SIGHUP")?;
        runtime.spawn(Arc::clone(&stop.0).attend(signals));
        IS_ATTENDED.store(true, Ordering::Relaxed);
        Ok(stop)
    }

    /// Whether to end; to be asked now and then.
    pub fn is_set(&self) -> bool {
        self.0.asked.is_cancelled()
    }

    /// The run cannot go on: as if a signal had come.
    pub(crate) fn ask(&self) {
        self.0.asked.cancel();
    }

    /// From now on a run is under way: once asked to end it may finish its map for `finish_within`
    /// and has 7.5 s for all else, and `last_will` is done before it is ended at once. It is ended at
    /// once, too, where the thread that watches over it hangs.
    pub(crate) fn run_begins(
        &self,
        last_will: LastWill,
        heartbeat: Heartbeat,
        finish_within: Duration,
    ) {
        *self.0.run() = Some(RunUnderWay {
            last_will,
            heartbeat,
            ends_within: finish_within + ORDERLY_END,
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
    async fn attend(self: Arc<Self>, mut signals: Signals) {
        let mut look = interval(LOOK);
        let mut asked_at = None;
        loop {
            let raised = select! {
                number = signals.next() => Some(number),
                _ = look.tick() => None,
            };
            self.look_after_run();
            if raised.is_some() {
                IS_ASKED.store(true, Ordering::Relaxed);
                echosplat_input::end_waiting();
            }
            match asked_at {
                Some(first) => self.end_if_it_is_time(first, raised),
                None if raised.is_some() => self.asked.cancel(),
                None => {}
            }
            if self.asked.is_cancelled() {
                asked_at.get_or_insert_with(Instant::now);
            }
        }
    }

    /// Asked to end at `first`, and perhaps just now again.
    fn end_if_it_is_time(&self, first: Instant, raised: Option<i32>) {
        if let Some(number) = raised.filter(|_| first.elapsed() > ONE_REQUEST) {
            tracing::warn!("asked to end again: ending at once");
            self.end_at_once(128 + number);
        }
        let ends_within = self.run().as_ref().map(|run| run.ends_within);
        if let Some(limit) = ends_within.filter(|&limit| first.elapsed() > limit) {
            tracing::error!(
                "the run did not end within {} s of being asked to: ending at once",
                limit.as_secs()
            );
            self.end_at_once(NOT_IN_ORDER);
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
                let _ = block_in_place(|| waits.recv_timeout(SAVING));
            }
        }
        block_in_place(logging::flush_at_once);
        low_level::exit(code)
    }
}

/// The signals that ask the program to end.
struct Signals {
    interrupt: Signal,
    terminate: Signal,
    hangup: Signal,
}

impl Signals {
    /// To be called where tasks can be begun.
    fn handled() -> io::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hangup: signal(SignalKind::hangup())?,
        })
    }

    /// The number of the next one.
    async fn next(&mut self) -> i32 {
        select! {
            _ = self.interrupt.recv() => SIGINT,
            _ = self.terminate.recv() => SIGTERM,
            _ = self.hangup.recv() => SIGHUP,
        }
    }
}
