//! The automatic gain of a real unit.

/// Gain below that of index 7, dB, by index. From 4 on as the noise of ten pings of a real unit steps:
/// 4.2, 6.1 and 5.2 dB. Of the others only 0 is used, for a first ping; they lie below 4 as far as the
/// `analog_gain` that units report of them.
const GAIN_DB: [f64; 8] = [-38.6, -32.8, -27.0, -21.3, -15.5, -11.3, -5.2, 0.0];
/// How a unit begins: 0, 4, 5, 6, 7 in its first five pings.
pub(super) const GAIN_START: [i16; 5] = [0, 4, 5, 6, 7];
/// The gain that automatic control ends up between.
const LEAST_INDEX: i16 = 4;
const MOST_INDEX: i16 = 7;
/// The loudest echo is kept between these, dB as reported. Chosen, since a unit's own rule is not
/// known: wider than the largest step, so that a steady echo leaves the gain alone.
const LOUDEST_DB: std::ops::RangeInclusive<f64> = 12.0..=24.0;
/// How often control may make a step. Chosen: real units were seen to step once a ping at their start.
const STEP_S: f64 = 0.25;
/// In dives longer than an hour and more, less often.
const MOST_STEPS: usize = 16_384;

/// Gain of an index, dB; that of 7 is 0.
pub(super) fn gain_db(index: i16) -> f64 {
    GAIN_DB[usize::from(index.clamp(0, MOST_INDEX).unsigned_abs())]
}

/// Gain index over a dive, so that any ping's is known without the pings before.
pub(super) struct GainTrack {
    step_s: f64,
    indices: Vec<i16>,
}

impl GainTrack {
    /// Times at which the gain may step, seconds into a dive of `duration_s`.
    pub(super) fn times(duration_s: f64) -> Vec<f64> {
        let step_s = step_s(duration_s);
        let count = (duration_s / step_s).ceil().max(1.0) as usize;
        (0..count).map(|step| step as f64 * step_s).collect()
    }

    /// `loudest_db` is the loudest echo of the ping at each of [`Self::times`], dB at gain index 7.
    pub(super) fn following(loudest_db: &[f64], duration_s: f64) -> Self {
        let mut index = MOST_INDEX;
        let mut next = |loudest_db: &f64| {
            let reported_db = loudest_db + gain_db(index);
            if reported_db > *LOUDEST_DB.end() {
                index = (index - 1).max(LEAST_INDEX);
            } else if reported_db < *LOUDEST_DB.start() {
                index = (index + 1).min(MOST_INDEX);
            }
            index
        };
        Self {
            step_s: step_s(duration_s),
            indices: loudest_db.iter().map(&mut next).collect(),
        }
    }

    /// Of ping `sequence` of a unit that was switched on with ping 0, `time_s` into the dive.
    pub(super) fn index(&self, sequence: u64, time_s: f64) -> i16 {
        let start = usize::try_from(sequence).ok();
        if let Some(&index) = start.and_then(|sequence| GAIN_START.get(sequence)) {
            return index;
        }
        // A ping belongs to the step before it: it could not be heard before it was made.
        let step = (time_s / self.step_s - 1e-6).max(0.0) as usize;
        let last = self.indices.len().saturating_sub(1);
        self.indices
            .get(step.min(last))
            .copied()
            .unwrap_or(MOST_INDEX)
    }
}

fn step_s(duration_s: f64) -> f64 {
    STEP_S.max(duration_s / MOST_STEPS as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_steps_down_from_a_loud_echo_and_up_again_one_at_a_time() {
        let duration_s = 3.0;
        assert_eq!(GainTrack::times(duration_s).len(), 12);
        let loudest_db = [[45.0; 6], [5.0; 6]].concat();
        let track = GainTrack::following(&loudest_db, duration_s);
        assert_eq!(track.indices, [6, 5, 4, 4, 4, 4, 5, 6, 7, 7, 7, 7]);
        assert_eq!(track.index(100, 0.3), 5);
        assert_eq!(track.index(100, 99.0), 7);
        assert_eq!([0, 1, 4].map(|first| track.index(first, 0.3)), [0, 4, 7]);
    }

    #[test]
    fn a_steady_echo_leaves_the_gain_alone() {
        for loudest_db in 0..60 {
            let track = GainTrack::following(&[f64::from(loudest_db); 20], 5.0);
            assert!(track.indices[4..].windows(2).all(|pair| pair[0] == pair[1]));
        }
    }

    #[test]
    fn a_dive_of_hours_has_a_bounded_track() {
        assert!(GainTrack::times(1e5).len() <= MOST_STEPS + 1);
        assert_eq!(GainTrack::times(0.1).len(), 1);
    }
}
