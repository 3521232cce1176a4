//! When rounds of deltas go out, and how many bytes each may take.

use std::time::{Duration, Instant};

/// Least of a round, which takes longer where the pace is slow: what a delta costs besides its points
/// is a kilobyte.
const MIN_ROUND_BYTES: usize = 5000;

/// One round after the other, each spread over the time until the next, on average at the pace.
///
/// While much of a map is left to send, the next round waits for a newer map up to twice the interval: a ping shows with the
/// first message of a map that holds it, and a round of the older map under way would keep that message waiting.
#[derive(Debug)]
pub(super) struct Rounds {
    /// Shortest time from one round to the next.
    interval: Duration,
    begun: Option<Instant>,
    /// When a link of this pace is done with all that was sent.
    link_free: Option<Instant>,
}

impl Rounds {
    pub(super) fn new(interval: Duration) -> Self {
        Self {
            interval,
            begun: None,
            link_free: None,
        }
    }

    /// Begins a round; the bytes that it may take: what a link of `bps` carries from the last round to this one.
    pub(super) fn begin(&mut self, now: Instant, bps: f64) -> usize {
        let since_last = self.begun.map(|begun| now.saturating_duration_since(begun));
        let covered = since_last.unwrap_or(self.interval).min(2 * self.interval);
        self.begun = Some(now);
        self.link_free = self.link_free.max(Some(now));
        let bytes = bps * covered.as_secs_f64() / 8.0;
        (bytes as usize).max(MIN_ROUND_BYTES)
    }

    /// A message of so many bytes was sent.
    pub(super) fn sent(&mut self, byte_count: usize, bps: f64) {
        let seconds = 8.0 * byte_count as f64 / bps;
        let took = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
        self.link_free = self.link_free.and_then(|free| free.checked_add(took));
    }

    /// When the next message of this round may go; `None` is at once. It is when the link is free; where a newer map waits,
    /// up to an interval before that.
    pub(super) fn next_message(&self, has_newer_map: bool) -> Option<Instant> {
        match has_newer_map {
            true => self.link_free.min(self.earliest()),
            false => self.link_free,
        }
    }

    /// When the next round may begin; `None` is at once. `is_ready` is whether a newer map waits or all of the older one is sent.
    pub(super) fn next_round(&self, is_ready: bool) -> Option<Instant> {
        match is_ready {
            true => self.earliest(),
            false => self
                .begun
                .map(|begun| begun + 2 * self.interval)
                .max(self.link_free),
        }
    }

    /// When the next round may begin at the earliest.
    fn earliest(&self) -> Option<Instant> {
        let nearly_free = self
            .link_free
            .and_then(|free| free.checked_sub(self.interval));
        self.begun
            .map(|begun| begun + self.interval)
            .max(nearly_free)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL: Duration = Duration::from_millis(50);

    /// Bytes sent in ten seconds and the longest that a map waited for its round, with more to send than the pace carries and a
    /// newer map every so often.
    fn sent_in_ten_seconds(map_every: Duration, bps: f64) -> (usize, Duration) {
        let mut rounds = Rounds::new(INTERVAL);
        let start = Instant::now();
        let (mut now, mut next_map) = (start, start);
        let (mut bytes, mut longest) = (0, Duration::ZERO);
        while now < start + Duration::from_secs(10) {
            if now >= next_map {
                longest = longest.max(now - next_map);
                next_map += map_every;
            }
            let mut room = rounds.begin(now, bps);
            while room > 0 {
                let message = room.min(1500);
                (room, bytes) = (room - message, bytes + message);
                rounds.sent(message, bps);
                let waiting = |until: Option<Instant>| until.unwrap_or(now).max(now);
                let (at_leisure, in_haste) = (
                    waiting(rounds.next_message(false)),
                    waiting(rounds.next_message(true)),
                );
                now = at_leisure.min(in_haste.max(next_map));
            }
            let (at_leisure, in_haste) = (
                rounds.next_round(false).unwrap(),
                rounds.next_round(true).unwrap(),
            );
            now = now.max(at_leisure.min(in_haste.max(next_map)));
        }
        (bytes, longest)
    }

    #[test]
    fn a_newer_map_goes_out_at_once_and_the_pace_is_kept() {
        for (map_ms, mbps) in [(69, 4.0), (50, 4.0), (51, 0.9), (120, 4.0), (400, 4.0)] {
            let (bytes, longest) = sent_in_ten_seconds(Duration::from_millis(map_ms), mbps * 1e6);
            let carried = mbps * 1e6 * 10.0 / 8.0;
            let share = bytes as f64 / carried;
            assert!((0.85..1.02).contains(&share), "{map_ms} ms: {share}");
            // But for one that came in the middle of a round that began when none had come.
            assert!(longest <= INTERVAL, "{map_ms} ms: {longest:?}");
        }
        let (_, longest) = sent_in_ten_seconds(Duration::from_millis(69), 4e6);
        assert!(longest < Duration::from_millis(5), "{longest:?}");
    }

    #[test]
    fn a_slow_pace_is_kept_although_a_round_has_its_least() {
        let (bytes, _) = sent_in_ten_seconds(Duration::from_millis(69), 1e5);
        assert!((115_000..140_000).contains(&bytes), "{bytes}");
    }
}
