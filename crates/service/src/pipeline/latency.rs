//! How long pings take to show in the map.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use serde::Serialize;

/// Newest measurements that percentiles are taken of.
const KEPT: usize = 4096;

/// Pings on their way, and how long those before them took.
#[derive(Debug, Default)]
pub(crate) struct Latency {
    /// Arrivals of pings that no map holds yet.
    unmapped: VecDeque<Instant>,
    /// Arrivals of pings that a map holds which is not sent yet, with its sequence.
    unsent: VecDeque<(u64, Instant)>,
    seconds: VecDeque<f32>,
}

/// Seconds from a ping's arrival to the first message of the map that holds it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct LatencyReport {
    pub(crate) p50: f32,
    pub(crate) p90: f32,
    pub(crate) p99: f32,
    pub(crate) max: f32,
    pub(crate) measured: usize,
}

impl Latency {
    /// A ping arrived and goes into the map. Beyond 4096 the oldest is no longer measured.
    pub(crate) fn arrived(&mut self, at: Instant) {
        push_bounded(&mut self.unmapped, at);
    }

    /// A map that holds all of them is to be sent.
    pub(crate) fn offered(&mut self, sequence: u64) {
        for at in self.unmapped.drain(..) {
            push_bounded(&mut self.unsent, (sequence, at));
        }
    }

    /// Maps up to this one are on their way since `now`.
    pub(crate) fn published(&mut self, through: u64, now: Instant) {
        while let Some(&(sequence, at)) = self.unsent.front()
            && sequence <= through
        {
            self.unsent.pop_front();
            let took: Duration = now.saturating_duration_since(at);
            push_bounded(&mut self.seconds, took.as_secs_f32());
        }
    }

    pub(crate) fn report(&self) -> LatencyReport {
        let mut sorted: Vec<f32> = self.seconds.iter().copied().collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let at = |share: f32| {
            let index = (share * sorted.len() as f32) as usize;
            let index = index.min(sorted.len().saturating_sub(1));
            sorted.get(index).copied().unwrap_or(0.0)
        };
        LatencyReport {
            p50: at(0.5),
            p90: at(0.9),
            p99: at(0.99),
            max: at(1.0),
            measured: sorted.len(),
        }
    }
}

fn push_bounded<T>(queue: &mut VecDeque<T>, value: T) {
    if queue.len() >= KEPT {
        queue.pop_front();
    }
    queue.push_back(value);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_what_was_published() {
        let mut latency = Latency::default();
        let begin = Instant::now();
        for i in 0..100 {
            latency.arrived(begin + Duration::from_millis(i));
        }
        latency.published(7, begin + Duration::from_millis(100));
        assert_eq!(latency.report().measured, 0);
        latency.offered(8);
        latency.published(7, begin + Duration::from_millis(100));
        assert_eq!(latency.report().measured, 0);
        latency.published(8, begin + Duration::from_millis(100));
        let report = latency.report();
        assert_eq!(report.measured, 100);
        assert!((report.p50 - 0.051).abs() < 1e-4);
        assert!((report.max - 0.1).abs() < 1e-4);
    }

    #[test]
    fn memory_is_bounded() {
        let mut latency = Latency::default();
        let now = Instant::now();
        for _ in 0..3 * KEPT {
            latency.arrived(now);
        }
        latency.offered(1);
        latency.published(1, now);
        assert_eq!(latency.report().measured, KEPT);
    }
}
