//! How a velocity changed beside a gap, by a straight line through those of some seconds.

use std::collections::VecDeque;

use echosplat_model::Timestamp;
use echosplat_model::glam::DVec3;

/// Seconds, found: of 1, 2 and 3 the best.
/// A line is laid through velocities of so long: beside gaps of 5 s of simulated surveys.
pub(super) const SLOPE_S: f64 = 3.0;
/// Fraction of `SLOPE_S`, assumed.
/// Velocities of less tell no slope.
const LEAST_SPAN: f64 = 0.6;
/// Velocities; assumed.
/// So few tell no slope.
const LEAST_COUNT: usize = 5;

/// A velocity in world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Known {
    pub(super) time: Timestamp,
    /// Metres a second.
    pub(super) mps: DVec3,
}

/// The line at one end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slope {
    /// There, metres a second.
    pub(super) mps: DVec3,
    /// Metres a second, each second.
    pub(super) mps2: DVec3,
}

impl Slope {
    /// Through velocities within [`SLOPE_S`] of `at`; `None` where they are too few.
    pub(super) fn through<'a>(
        known: impl Iterator<Item = &'a Known>,
        at: Timestamp,
    ) -> Option<Self> {
        let near: Vec<(f64, DVec3)> = known
            .map(|known| (known.time.seconds_since(at), known.mps))
            .filter(|(elapsed_s, _)| elapsed_s.abs() <= SLOPE_S)
            .collect();
        let count = near.len() as f64;
        let (first, last) = (near.first()?.0, near.last()?.0);
        if near.len() < LEAST_COUNT || last - first < LEAST_SPAN * SLOPE_S {
            return None;
        }
        let middle_s = near.iter().map(|(s, _)| s).sum::<f64>() / count;
        let mean_mps = near.iter().map(|(_, mps)| *mps).sum::<DVec3>() / count;
        let spread_s2: f64 = near.iter().map(|(s, _)| (s - middle_s).powi(2)).sum();
        let sum: DVec3 = near.iter().map(|(s, mps)| *mps * (s - middle_s)).sum();
        let mps2 = sum / spread_s2;
        Some(Self {
            mps: mean_mps - mps2 * middle_s,
            mps2,
        })
    }
}

/// Velocities of the last seconds without a gap.
#[derive(Debug, Default)]
pub(super) struct Recent(VecDeque<Known>);

impl Recent {
    pub(super) fn push(&mut self, known: Known) {
        let is_old = |before: &Known| known.time.seconds_since(before.time) > SLOPE_S;
        while self.0.front().is_some_and(is_old) {
            self.0.pop_front();
        }
        self.0.push_back(known);
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    pub(super) fn slope(&self) -> Option<Slope> {
        Slope::through(self.0.iter(), self.0.back()?.time)
    }
}
