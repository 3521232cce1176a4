//! The heartbeat of one part.

use std::any::Any;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use std::time::{Duration, Instant};

use crate::drill;

/// How long a part that works may be silent, unless its watcher says otherwise.
const DEFAULT_LIMIT: Duration = Duration::from_secs(15);
/// A part that panics more often than this within [`PANIC_WINDOW`] is not started again.
const MAX_PANICS: usize = 5;
const PANIC_WINDOW: Duration = Duration::from_secs(60);
/// Of those that hang and are replaced.
const MAX_REPLACEMENTS: u64 = 5;

/// Watchers ask every 20 or 50 ms. Where none has asked for longer than this, none could run, and no part either: the
/// program was stopped.
const STOPPED: Duration = Duration::from_secs(1);

/// It waits for something outside.
const RESTING: u64 = u64::MAX;
/// It has done its work.
const ENDED: u64 = u64::MAX - 1;
/// It panicked and is not started again.
const FAILED: u64 = u64::MAX - 2;
/// Nobody has asked yet.
const NEVER: u64 = u64::MAX;

/// Shown by a part as it works, read by whoever watches over it; clones are the same heartbeat.
/// A beat costs a look at the clock and an atomic store.
#[derive(Debug, Clone)]
pub struct Heartbeat(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    name: &'static str,
    begin: Instant,
    limit_ms: AtomicU64,
    /// Since `begin`: until when the newest beat holds without the limit, or what the part is
    /// in place of working.
    beat_ms: AtomicU64,
    /// Since `begin`: when somebody asked last.
    asked_ms: AtomicU64,
    replacements: AtomicU64,
    panics: Mutex<Panics>,
}

#[derive(Debug, Default)]
struct Panics {
    count: u64,
    newest: Option<String>,
    /// Within the window.
    recent: VecDeque<Instant>,
}

/// What a part is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Condition {
    /// It waits for something outside, as long as that takes.
    Resting,
    /// It works, and says so.
    Working,
    /// It has work and has said nothing for so long.
    Hung(Duration),
    /// It has done its work.
    Ended,
    /// It panicked and is not started again.
    Failed,
}

/// A piece of work that panicked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Panicked {
    /// What it panicked with.
    pub message: String,
    /// Whether it has panicked so often of late that starting it again is no use.
    pub is_hopeless: bool,
}

impl std::fmt::Display for Panicked {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "it panicked: {}", self.message)
    }
}

impl Heartbeat {
    /// Of a part that rests until it begins.
    #[must_use]
    pub fn new(name: &'static str) -> Self {
        Self(Arc::new(Shared {
            name,
            begin: Instant::now(),
            limit_ms: AtomicU64::new(millis(DEFAULT_LIMIT)),
            beat_ms: AtomicU64::new(RESTING),
            asked_ms: AtomicU64::new(NEVER),
            replacements: AtomicU64::new(0),
            panics: Mutex::default(),
        }))
    }

    /// Whether the other is a clone of this one.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    /// Of the part.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.0.name
    }

    /// How long the part may be silent while it works, from now on.
    pub fn set_limit(&self, limit: Duration) {
        self.0.limit_ms.store(millis(limit), Ordering::Relaxed);
    }

    /// The part is alive and has work.
    pub fn beat(&self) {
        self.beat_allowing(Duration::ZERO);
    }

    /// The same, and its next step may take so much longer than others.
    pub fn beat_allowing(&self, longer: Duration) {
        let until = millis(self.0.begin.elapsed()).saturating_add(millis(longer));
        self.0.beat_ms.store(until, Ordering::Relaxed);
        drill::at_beat(self.0.name);
    }

    /// The part waits for something outside, and is not missed until its next beat.
    pub fn rest(&self) {
        self.0.beat_ms.store(RESTING, Ordering::Relaxed);
    }

    /// The part has done its work, unless it was given up.
    pub fn end(&self) {
        let end = |before| (before != FAILED).then_some(ENDED);
        // One that was given up stays so.
        let _ = self
            .0
            .beat_ms
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, end);
    }

    /// The part is given up: it has panicked, and is not started again.
    pub fn fail(&self) {
        self.0.beat_ms.store(FAILED, Ordering::Relaxed);
    }

    /// What the part is doing now. To be asked several times a second while it is watched: a second in which nobody asks
    /// does not count as silence.
    #[must_use]
    pub fn condition(&self) -> Condition {
        let now_ms = millis(self.0.begin.elapsed());
        self.pass_over_stop(now_ms);
        let until = match self.0.beat_ms.load(Ordering::Relaxed) {
            RESTING => return Condition::Resting,
            ENDED => return Condition::Ended,
            FAILED => return Condition::Failed,
            until => until,
        };
        let silent_ms = now_ms.saturating_sub(until);
        match silent_ms > self.0.limit_ms.load(Ordering::Relaxed) {
            true => Condition::Hung(Duration::from_millis(silent_ms)),
            false => Condition::Working,
        }
    }

    /// Counts the newest beat as so much later as the program was stopped since somebody asked last.
    fn pass_over_stop(&self, now_ms: u64) {
        let before_ms = self.0.asked_ms.swap(now_ms, Ordering::Relaxed);
        let gap_ms = now_ms.saturating_sub(before_ms);
        if before_ms == NEVER || gap_ms <= millis(STOPPED) {
            return;
        }
        let later = |beat_ms: u64| {
            (beat_ms < FAILED).then(|| beat_ms.saturating_add(gap_ms).min(FAILED - 1))
        };
        // What does not work has no beat.
        let _ = self
            .0
            .beat_ms
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, later);
    }

    /// Whether whoever has started the part may put another in the place of one that hangs:
    /// it does, and not for the sixth time, since what it holds is never given back.
    #[must_use]
    pub fn is_to_be_replaced(&self) -> bool {
        matches!(self.condition(), Condition::Hung(_)) && self.replacements() < MAX_REPLACEMENTS
    }

    /// Another has the place of one that hung; the heartbeat is its now.
    pub fn replaced(&self) {
        self.rest();
        self.0.replacements.fetch_add(1, Ordering::Relaxed);
    }

    /// How often one that hung was replaced.
    #[must_use]
    pub fn replacements(&self) -> u64 {
        self.0.replacements.load(Ordering::Relaxed)
    }

    /// How often the part has panicked, and what with the last time.
    #[must_use]
    pub fn panics(&self) -> (u64, Option<String>) {
        let panics = self.lock();
        (panics.count, panics.newest.clone())
    }

    /// Does a piece of the part's work and outlives its panic, which is kept and given back. What
    /// the work left half done is the caller's to mend. The panic hook has told where it was.
    ///
    /// # Errors
    /// If the work panicked.
    pub fn survive<T>(&self, work: impl FnOnce() -> T) -> Result<T, Panicked> {
        catch_unwind(AssertUnwindSafe(work)).map_err(|payload| self.panicked(&*payload))
    }

    /// The same for a task: what `work` does at each step.
    ///
    /// # Errors
    /// If the work panicked.
    pub async fn survive_task<T>(&self, work: impl Future<Output = T>) -> Result<T, Panicked> {
        let mut work = pin!(work);
        poll_fn(|context| {
            let step = catch_unwind(AssertUnwindSafe(|| work.as_mut().poll(context)));
            match step {
                Ok(step) => step.map(Ok),
                Err(payload) => Poll::Ready(Err(self.panicked(&*payload))),
            }
        })
        .await
    }

    /// Does all of the part's work, once; `None` if it panicked, and the part has failed.
    pub fn run_once<T>(&self, work: impl FnOnce() -> T) -> Option<T> {
        let done = self.survive(work).ok();
        match done {
            Some(_) => self.end(),
            None => self.fail(),
        }
        done
    }

    /// Does all of the part's work, again after each panic, with a pause between. Gives up where
    /// that is no use: the part has failed then.
    pub fn run_again(&self, mut work: impl FnMut()) {
        loop {
            match self.survive(&mut work) {
                Ok(()) => return self.end(),
                Err(panicked) if panicked.is_hopeless => return self.fail(),
                Err(_) => std::thread::sleep(PAUSE),
            }
        }
    }

    fn panicked(&self, payload: &(dyn Any + Send)) -> Panicked {
        let text = payload.downcast_ref::<&str>().map(ToString::to_string);
        let message = text
            .or_else(|| payload.downcast_ref::<String>().cloned())
            .unwrap_or_else(|| "without words".to_owned());
        let now = Instant::now();
        let mut panics = self.lock();
        panics.count += 1;
        panics.newest = Some(message.clone());
        panics.recent.push_back(now);
        let is_old = |at: &Instant| now.saturating_duration_since(*at) > PANIC_WINDOW;
        while panics.recent.front().is_some_and(is_old) {
            panics.recent.pop_front();
        }
        Panicked {
            message,
            is_hopeless: panics.recent.len() > MAX_PANICS,
        }
    }

    fn lock(&self) -> MutexGuard<'_, Panics> {
        self.0.panics.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Between a panic and the next try, so that one that comes at once does not take the processor.
const PAUSE: Duration = Duration::from_millis(100);

fn millis(duration: Duration) -> u64 {
    // The largest values say something else.
    u64::try_from(duration.as_millis()).map_or(FAILED - 1, |millis| millis.min(FAILED - 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::task::{Context, Waker};

    fn silent(heartbeat: &Heartbeat) {
        heartbeat.set_limit(Duration::ZERO);
        std::thread::sleep(Duration::from_millis(5));
    }

    #[test]
    fn who_works_and_is_silent_hangs_and_who_rests_does_not() {
        let heartbeat = Heartbeat::new("a");
        silent(&heartbeat);
        assert_eq!(heartbeat.condition(), Condition::Resting);
        heartbeat.set_limit(Duration::from_secs(60));
        heartbeat.beat();
        assert_eq!(heartbeat.condition(), Condition::Working);
        silent(&heartbeat);
        assert!(matches!(heartbeat.condition(), Condition::Hung(_)));
        heartbeat.beat_allowing(Duration::from_secs(60));
        silent(&heartbeat);
        assert_eq!(heartbeat.condition(), Condition::Working);
        heartbeat.end();
        assert_eq!(heartbeat.condition(), Condition::Ended);
    }

    #[test]
    fn a_program_that_was_stopped_did_not_hang_and_one_that_hangs_after_it_does() {
        let heartbeat = Heartbeat::new("a");
        heartbeat.set_limit(Duration::from_millis(500));
        heartbeat.beat();
        assert_eq!(heartbeat.condition(), Condition::Working);
        // Nothing of it runs meanwhile.
        std::thread::sleep(STOPPED + Duration::from_millis(200));
        assert_eq!(heartbeat.condition(), Condition::Working);
        let begin = Instant::now();
        while heartbeat.condition() == Condition::Working {
            assert!(begin.elapsed() < Duration::from_secs(20));
            std::thread::sleep(Duration::from_millis(20));
        }
        assert!(matches!(heartbeat.condition(), Condition::Hung(_)));
    }

    #[test]
    fn what_hangs_again_and_again_is_replaced_five_times() {
        let heartbeat = Heartbeat::new("a");
        for _ in 0..5 {
            heartbeat.beat();
            silent(&heartbeat);
            assert!(heartbeat.is_to_be_replaced());
            heartbeat.replaced();
            assert_eq!(heartbeat.condition(), Condition::Resting);
        }
        heartbeat.beat();
        silent(&heartbeat);
        assert!(!heartbeat.is_to_be_replaced());
    }

    #[test]
    fn a_panic_is_outlived_and_told() {
        let heartbeat = Heartbeat::new("a");
        let mut tries = 0;
        heartbeat.run_again(|| {
            tries += 1;
            assert!(tries == 3, "try {tries}");
        });
        assert_eq!(tries, 3);
        assert_eq!(heartbeat.condition(), Condition::Ended);
        assert_eq!(heartbeat.panics(), (2, Some("try 2".to_owned())));
    }

    #[test]
    fn a_task_outlives_the_panic_of_one_of_its_steps() {
        let heartbeat = Heartbeat::new("a");
        let mut steps = 0;
        let mut work = pin!(heartbeat.survive_task(poll_fn(|_| {
            steps += 1;
            assert!(steps == 1, "step {steps}");
            Poll::<()>::Pending
        })));
        let mut context = Context::from_waker(Waker::noop());
        assert!(work.as_mut().poll(&mut context).is_pending());
        let Poll::Ready(Err(panicked)) = work.as_mut().poll(&mut context) else {
            panic!("the second step panics");
        };
        assert_eq!(
            (panicked.message.as_str(), panicked.is_hopeless),
            ("step 2", false)
        );
        assert_eq!(heartbeat.panics().0, 1);
    }

    #[test]
    fn one_that_panics_again_and_again_is_given_up() {
        let heartbeat = Heartbeat::new("a");
        let mut tries = 0;
        heartbeat.run_again(|| {
            tries += 1;
            panic!("always");
        });
        assert_eq!((tries, heartbeat.condition()), (6, Condition::Failed));
        assert_eq!(Heartbeat::new("b").run_once(|| 7), Some(7));
    }
}
