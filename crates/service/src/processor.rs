//! What the kernel says this process has used.

/// The most memory the process ever held, `VmHWM` of `/proc/self/status`; 0 where there is none.
pub fn peak_memory_bytes() -> u64 {
    status_bytes("VmHWM:")
}

/// The memory the process holds now, `VmRSS`.
pub fn memory_bytes() -> u64 {
    status_bytes("VmRSS:")
}

fn status_bytes(field: &str) -> u64 {
    std::fs::read_to_string("/proc/self/status")
        .ok()
        .and_then(|status| kibibytes(&status, field))
        .map_or(0, |kib| kib * 1024)
}

fn kibibytes(status: &str, field: &str) -> Option<u64> {
    let line = status.lines().find(|line| line.starts_with(field))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Processor seconds of all threads whose name starts with `prefix`, in steps of 10 ms.
/// `None` where the kernel does not say.
pub(crate) fn thread_seconds(prefix: &str) -> Option<f64> {
    let tasks = std::fs::read_dir("/proc/self/task").ok()?;
    let ticks: u64 = tasks
        .flatten()
        .filter_map(|task| std::fs::read_to_string(task.path().join("stat")).ok())
        .filter_map(|stat| ticks_of(&stat, prefix))
        .sum();
    Some(ticks as f64 / TICKS_PER_SECOND)
}

/// `USER_HZ`, the same on every Linux architecture in use.
const TICKS_PER_SECOND: f64 = 100.0;

/// User plus system time: fields 14 and 15 of proc(5), counted behind the name in brackets.
fn ticks_of(stat: &str, prefix: &str) -> Option<u64> {
    let (head, tail) = stat.rsplit_once(')')?;
    let (_, name) = head.split_once('(')?;
    if !name.starts_with(prefix) {
        return None;
    }
    let mut fields = tail.split_whitespace().skip(11);
    let user: u64 = fields.next()?.parse().ok()?;
    let system: u64 = fields.next()?.parse().ok()?;
    Some(user + system)
}

/// Processor seconds of the whole process so far, in steps of 10 ms; 0 where the kernel does not
/// say.
pub fn process_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    ticks_of(&stat, "").unwrap_or(0) as f64 / TICKS_PER_SECOND
}

/// Lets [`peak_memory_bytes`] count anew from what is held now, where the kernel allows it.
pub fn forget_peak_memory() {
    // A kernel without it keeps the peak of the whole process, which is no less.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// The processor's own name.
pub fn model_name() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let named = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    named
        .map_or("unknown", |(_, model)| model.trim())
        .to_owned()
}

/// Threads it runs at once.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_read_behind_a_name_with_brackets() {
        let stat = "7 (mapper (1)) R 1 1 1 0 -1 0 5 0 0 0 12 30 0 0 20 0 2 0 9";
        assert_eq!(ticks_of(stat, "mapper"), Some(42));
        assert_eq!(ticks_of(stat, "sonar"), None);
        assert_eq!(ticks_of("7 (mapper) R 1", "mapper"), None);
    }

    #[test]
    fn kibibytes_are_read_by_name() {
        let status = "Name:\tx\nVmHWM:\t    1968 kB\n";
        assert_eq!(kibibytes(status, "VmHWM:"), Some(1968));
        assert_eq!(kibibytes(status, "VmRSS:"), None);
    }
}
