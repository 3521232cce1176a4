//! How often the same kind of thing is said.

use crate::Timestamp;

/// So many of a kind are said at once.
const BURST: u32 = 3;
/// First wait until one more is said; it doubles up to [`MAX_WAIT_S`].
const MIN_WAIT_S: f64 = 10.0;
const MAX_WAIT_S: f64 = 600.0;

/// Keeps whatever comes from outside from filling a log: lets the first three of a kind through,
/// then one after 10 s, 20 s, 40 s … up to 10 minutes, each with the number left out before it.
/// After a quiet as long as the longest wait it begins anew.
///
/// Knows no clock: whoever asks says what time it is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RateLimit {
    said: u32,
    left_out: u64,
    wait_s: f64,
    /// When the last one came, said or not.
    newest: Timestamp,
    due: Timestamp,
}

impl RateLimit {
    /// Nothing said yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// One more came at `now`: `None` if it is to be left out, else how many were left out since
    /// the one said before. A clock that goes back makes no wait longer.
    pub fn admit(&mut self, now: Timestamp) -> Option<u64> {
        let since_s = now.seconds_since(self.newest);
        self.newest = now;
        if since_s < 0.0 {
            self.due = self.due.offset_by(since_s);
        } else if since_s >= MAX_WAIT_S {
            self.said = 0;
        }
        if self.said >= BURST && now < self.due {
            self.left_out += 1;
            return None;
        }
        self.wait_s = match self.said < BURST {
            true => MIN_WAIT_S,
            false => (2.0 * self.wait_s).min(MAX_WAIT_S),
        };
        self.said = self.said.saturating_add(1);
        self.due = now.offset_by(self.wait_s);
        Some(std::mem::take(&mut self.left_out))
    }

    /// How many were left out since the last one said.
    #[must_use]
    pub fn left_out(&self) -> u64 {
        self.left_out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(1e9 + seconds)
    }

    #[test]
    fn a_flood_is_told_in_a_few_lines_that_count_it() {
        let mut limit = RateLimit::new();
        let (mut said, mut told) = (0_u64, 0_u64);
        for i in 0..100_000 {
            if let Some(left_out) = limit.admit(at(0.01 * f64::from(i))) {
                said += 1;
                told += 1 + left_out;
            }
        }
        // 1,000 s: three at once, then after 10, 30, 70, 150, 310 and 630 s.
        assert_eq!(said, 9);
        assert_eq!(told + limit.left_out(), 100_000);
    }

    #[test]
    fn quiet_begins_anew_and_a_clock_set_back_silences_nobody() {
        let mut limit = RateLimit::new();
        let said = |limit: &mut RateLimit, second| limit.admit(at(second)).is_some();
        assert!((0..3).all(|_| said(&mut limit, 0.0)) && !said(&mut limit, 1.0));
        assert!((0..3).all(|_| said(&mut limit, 700.0)));
        assert!(!said(&mut limit, 700.0) && !said(&mut limit, -3_000.0));
        assert!(said(&mut limit, -2_989.0));
    }
}
