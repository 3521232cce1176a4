//! How fast deltas go out: as fast as the slowest link between here and a follower takes them.
//!
//! Nobody tells what a link carries, and zenoh drops in silence what it does not. But a follower that
//! missed a delta asks for what changed since the last one that it has. Then deltas go back to the
//! least, and become faster again: quickly up to half of what was too fast, slowly beyond. While an
//! answer waits for a link they go at the least too, so that it gets through: answers have a lower
//! priority than deltas, which else would starve them. One stream of deltas goes to all followers,
//! so that the slowest sets the pace for all.

use std::time::{Duration, Instant};

/// Pace that every link is trusted with, bits per second: a tenth of the slowest tether that a map
/// is followed over.
const LEAST_BPS: f64 = 100_000.0;

/// Factor per second up to what was carried before: from the least to 1 Mbit/s in ten seconds, in
/// which a link of that pace hands over what is queued of an answer.
const QUICK_GROWTH: f64 = 1.25;

/// Factor per second beyond: twice as fast after 70 s, since each loss costs an answer.
const SLOW_GROWTH: f64 = 1.01;

/// Of what was too fast, what is taken to be carried.
const CARRIED: f64 = 0.5;

/// Those who missed the same deltas ask within so long.
const SAME_LOSS: Duration = Duration::from_secs(2);

/// An answer that takes longer waits for a link.
const PATIENCE: Duration = Duration::from_millis(200);

/// The pace of one publisher.
#[derive(Debug)]
pub(super) struct Pace {
    most_bps: f64,
    bps: f64,
    /// Up to here it becomes faster quickly.
    carried_bps: f64,
    /// Epoch and sequence of the newest delta that zenoh has.
    handed_over: Option<(u64, u64)>,
    slowed: Option<Instant>,
    slowed_count: u64,
    answering: Option<Instant>,
    answered: Option<Instant>,
}

impl Pace {
    /// At most `most_bps`, bits per second, which is what it begins with.
    pub(super) fn new(most_bps: u64) -> Self {
        let most_bps = most_bps as f64;
        Self {
            most_bps,
            bps: most_bps,
            carried_bps: most_bps,
            handed_over: None,
            slowed: None,
            slowed_count: 0,
            answering: None,
            answered: None,
        }
    }

    /// Bits per second that deltas may take now.
    pub(super) fn bps(&self, now: Instant) -> f64 {
        match self.is_answer_waiting(now) {
            true => self.least_bps(),
            false => self.bps,
        }
    }

    fn least_bps(&self) -> f64 {
        self.most_bps.min(LEAST_BPS)
    }

    fn is_answer_waiting(&self, now: Instant) -> bool {
        self.answering
            .is_some_and(|begin| now.saturating_duration_since(begin) > PATIENCE)
    }

    /// Deltas took all that they may for so long, and nobody missed one.
    pub(super) fn filled(&mut self, took: Duration, now: Instant) {
        if self.is_answer_waiting(now) {
            return;
        }
        let growth = match self.bps < self.carried_bps {
            true => QUICK_GROWTH,
            false => SLOW_GROWTH,
        };
        let faster = self.bps * growth.powf(took.as_secs_f64());
        self.bps = faster.min(self.most_bps);
    }

    /// zenoh has this delta.
    pub(super) fn handed_over(&mut self, epoch: u64, sequence: u64) {
        self.handed_over = Some((epoch, sequence));
    }

    /// A follower asks for what comes after this; if deltas after it were handed over, it missed them.
    /// Some also ask after a while of silence, and have them all.
    pub(super) fn asked(&mut self, after: (u64, u64), now: Instant) {
        let newest = self.handed_over.filter(|newest| newest.0 == after.0);
        if newest.is_some_and(|newest| newest.1 > after.1) {
            self.missed(now);
        }
    }

    fn missed(&mut self, now: Instant) {
        let since = |slowed| now.saturating_duration_since(slowed);
        if self.slowed.is_some_and(|slowed| since(slowed) < SAME_LOSS) {
            return;
        }
        self.slowed = Some(now);
        self.slowed_count += 1;
        self.carried_bps = (self.bps * CARRIED).max(self.least_bps());
        self.bps = self.least_bps();
    }

    /// An answer is being handed to zenoh.
    pub(super) fn answer_begins(&mut self, now: Instant) {
        self.answering = Some(now);
    }

    /// zenoh has all of it.
    pub(super) fn answer_ends(&mut self, now: Instant) {
        self.answering = None;
        self.answered = Some(now);
    }

    /// When the newest answer ended; `now` while one is under way, `None` if there was none.
    pub(super) fn answered(&self, now: Instant) -> Option<Instant> {
        self.answering.map(|_| now).or(self.answered)
    }

    /// Whether deltas go slower than they may.
    pub(super) fn is_slowed(&self) -> bool {
        self.bps < self.most_bps
    }

    /// How often it was slowed.
    pub(super) fn slowed_count(&self) -> u64 {
        self.slowed_count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: u64 = 4_000_000;

    /// Rounds of 50 ms over a link of `link_bps`, on which whoever missed something asks 0.1 s
    /// later; the pace in each round, and how often something was missed.
    fn over_a_link(pace: &mut Pace, link_bps: f64, seconds: f64) -> (Vec<f64>, u32) {
        let begin = Instant::now();
        let mut paces = Vec::new();
        let mut losses = 0;
        for round in 0..(seconds * 20.0) as u32 {
            let now = begin + Duration::from_millis(50) * round;
            pace.filled(Duration::from_millis(50), now);
            paces.push(pace.bps(now));
            if pace.bps(now) > link_bps {
                losses += 1;
                pace.missed(now + Duration::from_millis(100));
            }
        }
        (paces, losses)
    }

    fn close(a: f64, b: f64) -> bool {
        (a / b - 1.0).abs() < 1e-9
    }

    #[test]
    fn nobody_misses_anything_and_it_stays_as_configured() {
        let mut pace = Pace::new(MOST);
        let (paces, losses) = over_a_link(&mut pace, 10e6, 60.0);
        assert!(paces.iter().all(|&bps| close(bps, MOST as f64)));
        assert_eq!(losses, 0);
        assert!(!pace.is_slowed());
    }

    #[test]
    fn it_settles_below_what_a_link_carries_and_seldom_tries_more() {
        let mut pace = Pace::new(MOST);
        let (_, found) = over_a_link(&mut pace, 1e6, 60.0);
        assert!(found <= 8, "{found} losses until it is found out");
        let (paces, losses) = over_a_link(&mut pace, 1e6, 300.0);
        assert!(losses <= 6, "{losses} losses in five minutes");
        let mean = paces.iter().sum::<f64>() / paces.len() as f64;
        assert!((0.5e6..1e6).contains(&mean), "{mean} bit/s");
    }

    #[test]
    fn it_becomes_as_fast_as_configured_again() {
        let mut pace = Pace::new(MOST);
        pace.missed(Instant::now());
        assert!(pace.is_slowed());
        let (paces, _) = over_a_link(&mut pace, 10e6, 200.0);
        assert!(close(paces[paces.len() - 1], MOST as f64), "{paces:?}");
    }

    #[test]
    fn many_who_missed_the_same_slow_it_once() {
        let mut pace = Pace::new(MOST);
        let now = Instant::now();
        for follower in 0..20 {
            pace.missed(now + Duration::from_millis(50) * follower);
        }
        assert_eq!(pace.slowed_count(), 1);
    }

    #[test]
    fn who_asks_and_missed_nothing_does_not_slow_it() {
        let mut pace = Pace::new(MOST);
        let now = Instant::now();
        pace.asked((7, 3), now);
        pace.handed_over(7, 3);
        pace.asked((7, 3), now);
        pace.asked((6, 1), now);
        assert_eq!(pace.slowed_count(), 0);
        pace.asked((7, 2), now);
        assert_eq!(pace.slowed_count(), 1);
    }

    #[test]
    fn an_answer_that_waits_for_a_link_goes_before() {
        let mut pace = Pace::new(MOST);
        let now = Instant::now();
        pace.answer_begins(now);
        assert!(close(pace.bps(now), MOST as f64));
        let later = now + 2 * PATIENCE;
        assert!(close(pace.bps(later), LEAST_BPS));
        assert_eq!(pace.answered(later), Some(later));
        pace.answer_ends(later);
        assert!(close(pace.bps(later), MOST as f64));
    }

    #[test]
    fn what_is_configured_below_the_least_stays() {
        let mut pace = Pace::new(20_000);
        let now = Instant::now();
        pace.missed(now);
        assert!(close(pace.bps(now), 20_000.0));
        assert!(!pace.is_slowed());
    }
}
