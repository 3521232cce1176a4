//! Attitudes, and the one at any time between them.

use std::collections::VecDeque;

use echosplat_model::Timestamp;
use echosplat_model::glam::DQuat;

/// Seconds, as `pose.max_pose_gap_s`.
/// Attitudes further apart are not interpolated between.
const LONGEST_S: f64 = 0.5;
/// Seconds; bounds memory.
/// Velocities come no later than this behind their attitude.
const KEPT_S: f64 = 5.0;
/// Attitudes; bounds memory.
/// Those of 5 s, 400 a second.
const KEPT_COUNT: usize = 2_048;

/// The attitude at some time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Turn {
    Is(DQuat),
    /// The one behind it has yet to come.
    NotYet,
    /// None is near enough.
    Never,
}

/// Attitudes in order of time.
#[derive(Debug, Default)]
pub(super) struct Turns {
    kept: VecDeque<(Timestamp, DQuat)>,
}

impl Turns {
    /// Whether it is newer than those before; else it is left out.
    pub(super) fn push(&mut self, time: Timestamp, rotation: DQuat) -> bool {
        if self.newest().is_some_and(|newest| time <= newest) {
            return false;
        }
        let is_old = |at: Timestamp| time.seconds_since(at) > KEPT_S;
        while self.kept.len() >= KEPT_COUNT || self.kept.front().is_some_and(|(at, _)| is_old(*at))
        {
            self.kept.pop_front();
        }
        self.kept.push_back((time, rotation));
        true
    }

    pub(super) fn newest(&self) -> Option<Timestamp> {
        self.kept.back().map(|(at, _)| *at)
    }

    pub(super) fn at(&self, time: Timestamp) -> Turn {
        let behind = self.kept.partition_point(|(at, _)| *at < time);
        let Some(&(after_at, after)) = self.kept.get(behind) else {
            return Turn::NotYet;
        };
        if after_at == time {
            return Turn::Is(after);
        }
        let Some(&(before_at, before)) = behind.checked_sub(1).and_then(|i| self.kept.get(i))
        else {
            return Turn::Never;
        };
        let span_s = after_at.seconds_since(before_at);
        if span_s > LONGEST_S {
            return Turn::Never;
        }
        let fraction = time.seconds_since(before_at) / span_s;
        Turn::Is(before.slerp(after, fraction).normalize())
    }
}
