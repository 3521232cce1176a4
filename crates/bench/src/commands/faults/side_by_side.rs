//! Several cases at a time.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// `make(i)` for each `i` below `count`, `jobs` of them at a time; `made` is called with each as it
/// comes. What is left out since `goes_on` says no is missing at the end.
pub(super) fn run<T: Send>(
    count: usize,
    jobs: usize,
    goes_on: impl Fn() -> bool + Sync,
    make: impl Fn(usize) -> T + Sync,
    made: impl Fn(&T) + Sync,
) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..jobs.min(count) {
            scope.spawn(|| {
                while goes_on() {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= count {
                        return;
                    }
                    let result = make(index);
                    made(&result);
                    if let Ok(mut results) = results.lock() {
                        results.push((index, result));
                    }
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_default();
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_and_an_end_leaves_out_the_rest() {
        let squares = run(50, 4, || true, |i| i * i, |_| {});
        assert_eq!(squares, (0..50).map(|i| i * i).collect::<Vec<_>>());
        let some = run(50, 1, || false, |i| i, |_| {});
        assert!(some.is_empty());
    }
}
