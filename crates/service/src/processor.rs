//! What the kernel says this process has used. Where there is no `/proc`, it says nothing.

use std::time::Duration;

/// The most memory the process ever held; 0 where the kernel does not say.
#[must_use]
pub fn peak_memory_bytes() -> u64 {
    kernel::memory_kib().map_or(0, |[_, peak]| 1024 * peak)
}

/// The memory the process holds now; 0 where the kernel does not say.
#[must_use]
pub fn memory_bytes() -> u64 {
    kernel::memory_kib().map_or(0, |[now, _]| 1024 * now)
}

/// The memory that another process holds now; 0 where the kernel does not say.
#[must_use]
pub fn memory_bytes_of(process: u32) -> u64 {
    kernel::memory_kib_of(process).map_or(0, |kib| 1024 * kib)
}

/// Files and sockets that another process has open; 0 where the kernel does not say.
#[must_use]
pub fn descriptor_count_of(process: u32) -> usize {
    kernel::descriptor_count_of(process).unwrap_or(0)
}

/// Processor seconds of all threads whose name starts with `prefix`, in steps of 10 ms.
/// `None` where the kernel does not say.
pub(crate) fn thread_seconds(prefix: &str) -> Option<f64> {
    kernel::thread_seconds(prefix)
}

/// What the calling thread took of the processor so far; `None` where the kernel does not say. Costs less than a microsecond.
pub(crate) fn own_thread_time() -> Option<Duration> {
    kernel::own_thread_time()
}

/// What another thread takes of the processor, to be asked again and again. While that thread works it may be late by a tick.
#[derive(Debug)]
pub(crate) struct ThreadClock(Option<kernel::ThreadFile>);

impl ThreadClock {
    /// Of the calling thread, for others to ask.
    pub(crate) fn of_this_thread() -> Self {
        Self(kernel::ThreadFile::of_this_thread())
    }

    /// So far; `None` where the kernel does not say, and once the thread has ended. Costs some microseconds.
    pub(crate) fn time(&self) -> Option<Duration> {
        self.0.as_ref()?.time()
    }
}

/// Processor seconds of the whole process so far, in steps of 10 ms; 0 where the kernel does not
/// say.
#[must_use]
pub fn process_seconds() -> f64 {
    kernel::process_seconds().unwrap_or(0.0)
}

/// Lets [`peak_memory_bytes`] count anew from what is held now, where the kernel allows it: one
/// without that keeps the peak of the whole process, which is no less.
pub fn forget_peak_memory() {
    kernel::forget_peak_memory();
}

/// From now on this thread, and those that it starts, work where all others leave time; without a change where the
/// kernel does not know priorities of threads.
pub(crate) fn give_way() {
    kernel::give_way();
}

/// The processor's own name.
#[must_use]
pub fn model_name() -> String {
    kernel::model_name().unwrap_or_else(|| "unknown".to_owned())
}

/// Threads it runs at once.
#[must_use]
pub fn core_count() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Processor, number of threads it runs at once, and this program's version.
pub(crate) fn description() -> Vec<(String, String)> {
    vec![
        (
            "processor".to_owned(),
            format!("{} × {}", core_count(), model_name()),
        ),
        ("echosplat".to_owned(), crate::arguments::VERSION.to_owned()),
    ]
}

#[cfg(target_os = "linux")]
mod kernel {
    use std::fs::File;
    use std::os::unix::fs::FileExt;
    use std::time::Duration;

    use procfs::process::{ClearRefs, Process, Stat};
    use procfs::{CpuInfo, Current};
    use rustix::time::{ClockId, clock_gettime};

    /// The least that there is.
    const LEAST_PRIORITY: i32 = 19;

    /// Held now, and the most so far.
    pub(super) fn memory_kib() -> Option<[u64; 2]> {
        let status = Process::myself().ok()?.status().ok()?;
        Some([status.vmrss?, status.vmhwm?])
    }

    pub(super) fn memory_kib_of(process: u32) -> Option<u64> {
        other(process)?.status().ok()?.vmrss
    }

    pub(super) fn descriptor_count_of(process: u32) -> Option<usize> {
        other(process)?.fd_count().ok()
    }

    fn other(process: u32) -> Option<Process> {
        Process::new(process.try_into().ok()?).ok()
    }

    pub(super) fn thread_seconds(prefix: &str) -> Option<f64> {
        let tasks = Process::myself().ok()?.tasks().ok()?;
        // One that has ended meanwhile has none.
        let stats = tasks.flatten().filter_map(|task| task.stat().ok());
        let named = stats.filter(|stat| stat.comm.starts_with(prefix));
        Some(named.map(|stat| seconds(&stat)).sum())
    }

    pub(super) fn own_thread_time() -> Option<Duration> {
        let time = clock_gettime(ClockId::ThreadCPUTime);
        Some(Duration::new(
            time.tv_sec.try_into().ok()?,
            time.tv_nsec.try_into().ok()?,
        ))
    }

    /// Of the scheduler, in nanoseconds; it goes on telling of the thread that opened it.
    #[derive(Debug)]
    pub(super) struct ThreadFile(File);

    impl ThreadFile {
        pub(super) fn of_this_thread() -> Option<Self> {
            let file = File::open("/proc/thread-self/schedstat").ok()?;
            Some(Self(file))
        }

        pub(super) fn time(&self) -> Option<Duration> {
            // Three numbers of at most twenty digits.
            let mut text = [0; 64];
            let length = self.0.read_at(&mut text, 0).ok()?;
            let text = std::str::from_utf8(&text[..length]).ok()?;
            let nanos = text.split_ascii_whitespace().next()?.parse().ok()?;
            Some(Duration::from_nanos(nanos))
        }
    }

    pub(super) fn process_seconds() -> Option<f64> {
        Some(seconds(&Process::myself().ok()?.stat().ok()?))
    }

    pub(super) fn forget_peak_memory() {
        let _ = Process::myself().and_then(|process| process.clear_refs(ClearRefs::PeakRSS));
    }

    pub(super) fn give_way() {
        // Of the calling thread alone, and less is always allowed.
        let _ = rustix::process::setpriority_process(None, LEAST_PRIORITY);
    }

    pub(super) fn model_name() -> Option<String> {
        Some(CpuInfo::current().ok()?.model_name(0)?.to_owned())
    }

    /// User plus system time.
    fn seconds(stat: &Stat) -> f64 {
        (stat.utime + stat.stime) as f64 / procfs::ticks_per_second() as f64
    }
}

#[cfg(not(target_os = "linux"))]
mod kernel {
    pub(super) fn memory_kib() -> Option<[u64; 2]> {
        None
    }

    pub(super) fn memory_kib_of(_process: u32) -> Option<u64> {
        None
    }

    pub(super) fn descriptor_count_of(_process: u32) -> Option<usize> {
        None
    }

    pub(super) fn thread_seconds(_prefix: &str) -> Option<f64> {
        None
    }

    pub(super) fn own_thread_time() -> Option<std::time::Duration> {
        None
    }

    #[derive(Debug)]
    pub(super) struct ThreadFile;

    impl ThreadFile {
        pub(super) fn of_this_thread() -> Option<Self> {
            None
        }

        pub(super) fn time(&self) -> Option<std::time::Duration> {
            let Self = self;
            None
        }
    }

    pub(super) fn process_seconds() -> Option<f64> {
        None
    }

    pub(super) fn forget_peak_memory() {}

    pub(super) fn give_way() {}

    pub(super) fn model_name() -> Option<String> {
        None
    }
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use super::*;

    /// Keeps a thread of this name at work until it has been seen to be.
    fn busy(name: &str, is_seen: impl Fn() -> bool + Send + 'static) {
        let thread = std::thread::Builder::new().name(name.to_owned());
        let work = move || (0..1_000_000).any(|_| is_seen());
        let seen = thread.spawn(work).unwrap().join().unwrap();
        assert!(seen, "{name}");
    }

    #[test]
    fn time_is_that_of_the_threads_of_a_name() {
        let before_s = process_seconds();
        busy("busy (1) of", || {
            thread_seconds("busy (1)").is_some_and(|seconds| seconds > 0.0)
        });
        assert_eq!(thread_seconds("no such thread"), Some(0.0));
        assert!(process_seconds() > before_s);
    }

    #[test]
    fn a_thread_tells_its_own_time_and_another_reads_it_on_its_clock() {
        let (clocks, clock) = std::sync::mpsc::channel();
        let (ends, end) = std::sync::mpsc::channel::<()>();
        let work = move || {
            while own_thread_time().is_some_and(|time| time < Duration::from_millis(20)) {}
            clocks.send(ThreadClock::of_this_thread()).unwrap();
            _ = end.recv();
        };
        let thread = std::thread::spawn(work);
        let clock = clock.recv().unwrap();
        // It sleeps by and by, and then what it took is told in full.
        while clock
            .time()
            .is_some_and(|time| time < Duration::from_millis(19))
        {
            std::thread::yield_now();
        }
        drop(ends);
        thread.join().unwrap();
        // The kernel lets go of it a little after it was joined.
        let is_gone = || {
            std::thread::yield_now();
            clock.time().is_none()
        };
        assert!((0..1_000_000).any(|_| is_gone()));
    }

    #[test]
    fn a_thread_that_gives_way_does_so_alone_and_with_those_it_starts() {
        let priority = || rustix::process::getpriority_process(None).unwrap();
        let before = priority();
        let below = move || std::thread::spawn(priority).join().unwrap();
        let given_way = std::thread::spawn(move || {
            give_way();
            (priority(), below())
        });
        assert_eq!(given_way.join().unwrap(), (19, 19));
        assert_eq!(priority(), before);
    }

    #[test]
    fn memory_held_now_is_no_more_than_the_most() {
        let (now, peak) = (memory_bytes(), peak_memory_bytes());
        assert!(now > 1 << 20 && peak >= now, "{now} {peak}");
        assert!(core_count() >= 1 && !model_name().is_empty());
    }
}
