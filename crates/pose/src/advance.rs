//! A position between its reports, by the velocity that came with it.

use echosplat_model::Timestamp;
use echosplat_model::glam::DVec3;

/// A position is moved by its velocity no longer than this, seconds: at 1 m/s and a velocity wrong
/// by a tenth it is then 5 cm off, which is what a map of this resolution bears.
pub(crate) const MAX_ADVANCE_S: f64 = 0.5;

/// Where the vehicle was, and how it moved then, in world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    pub(crate) time: Timestamp,
    pub(crate) position_m: DVec3,
    pub(crate) velocity_mps: DVec3,
}

impl Motion {
    /// The position at `time`, before or after; `None` beyond [`MAX_ADVANCE_S`].
    pub(crate) fn position_at(&self, time: Timestamp) -> Option<DVec3> {
        let elapsed_s = time.seconds_since(self.time);
        let is_near = elapsed_s.abs() <= MAX_ADVANCE_S;
        is_near.then(|| self.position_m + self.velocity_mps * elapsed_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_second_is_bridged_both_ways_and_no_more() {
        let motion = Motion {
            time: Timestamp::from_millis(10_000),
            position_m: DVec3::new(1.0, 2.0, 3.0),
            velocity_mps: DVec3::new(0.0, 2.0, -1.0),
        };
        let at = |millis| motion.position_at(Timestamp::from_millis(millis));
        assert_eq!(at(10_500), Some(DVec3::new(1.0, 3.0, 2.5)));
        assert_eq!(at(9_500), Some(DVec3::new(1.0, 1.0, 3.5)));
        assert_eq!((at(10_501), at(9_499)), (None, None));
    }
}
