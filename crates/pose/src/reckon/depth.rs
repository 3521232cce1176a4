//! Heights by a depth sensor, and the one at any time beside them.

use std::collections::VecDeque;

use echosplat_model::Timestamp;

/// Seconds; assumed.
/// Without a height for longer than this up is by the integral.
const LOST_S: f64 = 2.0;
/// Heights; bounds memory.
/// Those of 10 s, 50 a second.
const KEPT_COUNT: usize = 512;

/// Heights in order of time.
#[derive(Debug, Default)]
pub(super) struct Depths {
    kept: VecDeque<(Timestamp, f64)>,
    /// What is added, so that a sensor that is heard later than the world began goes on from there; `None` until one was used.
    added_m: Option<f64>,
}

impl Depths {
    /// One no newer than those before is left out.
    pub(super) fn push(&mut self, time: Timestamp, z_m: f64) {
        if self.kept.back().is_some_and(|(newest, _)| time <= *newest) {
            return;
        }
        if self.kept.len() == KEPT_COUNT {
            self.kept.pop_front();
        }
        self.kept.push_back((time, z_m));
    }

    /// The world begins: a sensor that is heard by now counts from the surface.
    pub(super) fn begin(&mut self) {
        let is_heard = !self.kept.is_empty();
        self.added_m = is_heard.then_some(0.0);
    }

    /// In the world: between two heights, or moved on from the nearest at `up_mps`. `None` where none is near. `integral_m` is
    /// where the vehicle is without them.
    pub(super) fn at(&mut self, time: Timestamp, up_mps: f64, integral_m: f64) -> Option<f64> {
        let behind = self.kept.partition_point(|(at, _)| *at < time);
        let before = behind.checked_sub(1).and_then(|index| self.kept.get(index));
        let moved = |(at, z_m): (Timestamp, f64)| {
            let elapsed_s = time.seconds_since(at);
            (elapsed_s.abs() <= LOST_S).then_some(z_m + up_mps * elapsed_s)
        };
        let z_m = match (before.copied(), self.kept.get(behind).copied()) {
            (Some((from, from_m)), Some((until, until_m)))
                if until.seconds_since(from) <= LOST_S =>
            {
                let fraction = time.seconds_since(from) / until.seconds_since(from);
                from_m + fraction * (until_m - from_m)
            }
            (before, after) => before.and_then(moved).or(after.and_then(moved))?,
        };
        let added_m = *self.added_m.get_or_insert(integral_m - z_m);
        Some(z_m + added_m)
    }
}
