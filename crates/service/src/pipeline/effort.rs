//! What each kind of work takes: the mapper counts it, and it is timed here.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use echosplat_mapper::{Counted, Mapper, Task, TaskEnd};
use serde::Serialize;
use tracing::field::Empty;

use crate::processor::{ThreadClock, own_thread_time};

/// Threads that publish, by how their names begin, and what their work is called.
const PUBLISHING: [(&str, &str); 2] = [("bus-", "publish_bus"), ("web-", "publish_web")];

/// What one kind of work took so far.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Took {
    counted: Counted,
    /// From its begin to its end, on the thread that did it.
    thread: Duration,
    /// On all threads that did it; `None` where the kernel does not say.
    processor: Option<Duration>,
}

/// As a status has it.
#[derive(Serialize)]
struct Told {
    #[serde(flatten)]
    counted: Option<Counted>,
    #[serde(skip_serializing_if = "Option::is_none")]
    thread_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    processor_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ns_per_visit: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ns_per_candidate: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ns_per_voxel_look: Option<f64>,
}

impl Serialize for Took {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let ns = self.processor.unwrap_or(self.thread).as_nanos() as f64;
        // Tenths of a nanosecond are noise.
        let per = |count: u64| (count > 0).then(|| (10.0 * ns / count as f64).round() / 10.0);
        let is_counted = self.counted.times > 0;
        let told = Told {
            counted: is_counted.then_some(self.counted),
            thread_s: is_counted.then(|| seconds(self.thread)),
            processor_s: self.processor.map(seconds),
            ns_per_visit: per(self.counted.visits),
            ns_per_candidate: per(self.counted.candidates),
            ns_per_voxel_look: per(self.counted.voxel_looks),
        };
        told.serialize(serializer)
    }
}

/// To a microsecond.
fn seconds(time: Duration) -> f64 {
    time.as_micros() as f64 * 1e-6
}

impl Took {
    fn add(&mut self, counted: Counted, thread: Duration, processor: Option<Duration>) {
        let both = self.processor.zip(processor);
        self.processor = match *self == Self::default() {
            true => processor,
            false => both.map(|(before, more)| before + more),
        };
        self.counted += counted;
        self.thread += thread;
    }
}

/// Adds up what one kind of work takes, on whichever thread it is done; cheap to clone.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stopwatch(Arc<Mutex<Took>>);

impl Stopwatch {
    pub(crate) fn took(&self) -> Took {
        *lock(&self.0)
    }

    /// Times `work`, which is done on this thread alone.
    pub(crate) fn time<T>(&self, visits: u64, work: impl FnOnce() -> T) -> T {
        let begun = Moment::of(&[]);
        let result = work();
        let (thread, processor) = begun.passed(&[]);
        let counted = Counted {
            times: 1,
            visits,
            ..Counted::default()
        };
        lock(&self.0).add(counted, thread, processor);
        result
    }

    /// Called as a calibrator's tasks begin, all of them on one thread. The times are those of its maps.
    pub(crate) fn of_maps(&self) -> impl Fn(Task) -> TaskEnd + Send + Sync + 'static {
        let to = Arc::clone(&self.0);
        move |task| {
            let (to, begun) = (Arc::clone(&to), Moment::of(&[]));
            Box::new(move |counted| {
                let (thread, processor) = begun.passed(&[]);
                let times = u64::from(task == Task::Evidence);
                lock(&to).add(Counted { times, ..counted }, thread, processor);
            })
        }
    }
}

/// The clocks of one thread and of those that help it, at some moment.
struct Moment {
    at: Instant,
    processor: Option<Duration>,
}

impl Moment {
    fn of(helpers: &[ThreadClock]) -> Self {
        let helped = helpers
            .iter()
            .map(ThreadClock::time)
            .sum::<Option<Duration>>();
        Self {
            at: Instant::now(),
            processor: own_thread_time()
                .zip(helped)
                .map(|(own, helped)| own + helped),
        }
    }

    /// Of the thread, and of the processor.
    fn passed(&self, helpers: &[ThreadClock]) -> (Duration, Option<Duration>) {
        let now = Self::of(helpers);
        let processor = now.processor.zip(self.processor);
        let processor = processor.map(|(now, then)| now.saturating_sub(then));
        (now.at - self.at, processor)
    }
}

/// Times the mapper's tasks.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meter(Arc<Mutex<BTreeMap<&'static str, Took>>>);

impl Meter {
    /// Times what `mapper` does from now on; to be called on the thread of its pool that will call it.
    pub(crate) fn watch(&self, mapper: &mut Mapper) {
        let own = rayon::current_thread_index();
        let clocks = mapper.pool().broadcast(|thread| {
            let is_helper = Some(thread.index()) != own;
            is_helper.then(ThreadClock::of_this_thread)
        });
        let helpers: Arc<[ThreadClock]> = clocks.into_iter().flatten().collect();
        let to = Arc::clone(&self.0);
        mapper.on_task(move |task| begin(task, &helpers, &to));
    }

    /// What all took, and what took no time of the mapper's.
    pub(crate) fn report(&self, others: &[(&'static str, Took)]) -> EffortReport {
        let mut found = lock(&self.0).clone();
        found.extend(others.iter().copied());
        found.retain(|_, took| took.counted.times > 0);
        EffortReport(found)
    }
}

/// Begins to time a task, within a span that has its counts once it ends.
fn begin(
    task: Task,
    helpers: &Arc<[ThreadClock]>,
    to: &Arc<Mutex<BTreeMap<&'static str, Took>>>,
) -> TaskEnd {
    let (helpers, to) = (Arc::clone(helpers), Arc::clone(to));
    let span = tracing::trace_span!(
        "task",
        name = task.name(),
        visits = Empty,
        candidates = Empty,
        voxel_looks = Empty
    );
    let span = span.entered();
    let begun = Moment::of(&helpers);
    Box::new(move |counted| {
        let (thread, processor) = begun.passed(&helpers);
        span.record("visits", counted.visits);
        span.record("candidates", counted.candidates);
        span.record("voxel_looks", counted.voxel_looks);
        let mut of_all = lock(&to);
        of_all
            .entry(task.name())
            .or_default()
            .add(counted, thread, processor);
    })
}

/// By the name of the work.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub(crate) struct EffortReport(BTreeMap<&'static str, Took>);

/// What publishing took by the newest look; threads that have ended keep what they had.
#[derive(Debug, Default)]
pub(crate) struct Publishing([Duration; PUBLISHING.len()]);

impl Publishing {
    /// Adds it to what is told, where anything is published.
    pub(crate) fn tell(&mut self, report: &mut EffortReport) {
        for ((prefix, name), took) in PUBLISHING.into_iter().zip(&mut self.0) {
            let now_s = crate::processor::thread_seconds(prefix).unwrap_or(0.0);
            *took = (*took).max(Duration::from_secs_f64(now_s));
            if !took.is_zero() {
                let published = Took {
                    processor: Some(*took),
                    ..Took::default()
                };
                report.0.insert(name, published);
            }
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_timed_adds_up_and_is_told_by_visit() {
        let stopwatch = Stopwatch::default();
        for visits in [3, 5] {
            stopwatch.time(visits, || std::thread::sleep(Duration::from_millis(2)));
        }
        let took = stopwatch.took();
        assert_eq!((took.counted.times, took.counted.visits), (2, 8));
        assert!(took.thread >= Duration::from_millis(4));
        let report = Meter::default().report(&[("frame_check", took)]);
        let told = serde_json::to_value(report).unwrap();
        let told = &told["frame_check"];
        assert_eq!((&told["times"], &told["visits"]), (&2.into(), &8.into()));
        assert!(
            told["ns_per_visit"].is_number() && told["candidates"].is_null(),
            "{told}"
        );
    }

    #[test]
    fn where_one_time_is_not_known_none_is() {
        let mut took = Took::default();
        let once = Counted {
            times: 1,
            ..Counted::default()
        };
        took.add(once, Duration::ZERO, Some(Duration::from_secs(1)));
        assert_eq!(took.processor, Some(Duration::from_secs(1)));
        took.add(once, Duration::ZERO, None);
        took.add(once, Duration::ZERO, Some(Duration::from_secs(1)));
        assert_eq!(took.processor, None);
    }

    #[test]
    fn what_is_not_done_is_not_told_and_threads_that_publish_are() {
        let mut report = Meter::default().report(&[("calibrate", Took::default())]);
        assert_eq!(report, EffortReport::default());
        let mut publishing = Publishing([Duration::from_secs(2), Duration::ZERO]);
        publishing.tell(&mut report);
        let told = serde_json::to_value(report).unwrap();
        assert_eq!(told["publish_bus"]["processor_s"], 2.0);
        assert!(told["publish_bus"]["times"].is_null(), "{told}");
    }
}
