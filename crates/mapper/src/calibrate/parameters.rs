//! What is estimated, and how it is told.

use serde::Serialize;

use super::linear::{Square, cholesky, solve};

/// Time offset, mount about x, y and z, lever arm along y and z, and scale of ranges.
pub(crate) const PARAMETERS: usize = 7;
pub(super) const TIME: usize = 0;
pub(super) const TURN: usize = 1;
pub(super) const LEVER: usize = 4;
pub(crate) const RANGE: usize = 6;

pub(crate) type Values = [f64; PARAMETERS];

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// One sigma of what is thought possible before any ping: seconds, radians, metres, parts of the range.
pub(super) const PRIOR: Values = [
    0.1,
    3.0 * DEGREE,
    3.0 * DEGREE,
    3.0 * DEGREE,
    0.1,
    0.1,
    0.02,
];

/// A value with its sigma.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Estimate {
    /// What is likeliest.
    pub value: f64,
    /// One standard deviation of it.
    pub sigma: f64,
    /// Whether a map made with another value makes pings likelier: only then is it off.
    pub is_believed: bool,
}

/// What was found of clock, mount and speed of sound.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Calibration {
    /// How much later than they held poses are stamped, milliseconds.
    pub time_offset_ms: Estimate,
    /// Turn of the sonar against its configured mount about its own x axis, degrees; positive lifts the left side.
    pub mount_roll_deg: Estimate,
    /// About its y axis; positive lowers the nose.
    pub mount_pitch_deg: Estimate,
    /// About its z axis; positive looks to the left.
    pub mount_yaw_deg: Estimate,
    /// How far the sonar sits to the left of where it is configured, metres, on its own axes.
    pub lever_left_m: Estimate,
    /// How far it sits above.
    pub lever_up_m: Estimate,
    /// True over reported speed of sound, less 1, per cent.
    pub sound_speed_percent: Estimate,
    /// Landmarks that it rests on.
    pub landmarks: u64,
    /// Looks at them.
    pub looks: u64,
}

/// Values with the covariance of their errors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found {
    pub(super) values: Values,
    pub(super) covariance: Square<PARAMETERS>,
    pub(super) landmarks: u64,
    pub(super) looks: u64,
}

/// What is heard against what the map would have made heard.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Difference {
    heard: Found,
    predicted: Found,
}

/// A map is made with another value where the residual is so many sigmas.
const TRIED_SIGMAS: f64 = 4.0;
/// Another value is believed if it makes pings likelier by so many standard errors.
const LIKELIER_SIGMAS: f64 = 4.0;
/// What part of an error a map made with it leaves to see, as on the survey of a fence; of ranges that is not asked.
const SEEN: Values = [0.8, 0.65, 0.65, 0.65, 0.65, 0.65, 1.0];
/// Least part that one is taken for.
const SEEN_AT_LEAST: f64 = 0.4;
/// What part of the step has to vanish from the residual where it is right, and at most does.
const LEAST_SEEN: f64 = 0.2;
const MOST_SEEN: f64 = 1.3;

/// What trials brought.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Verdict {
    pub(crate) values: Values,
    seen: Values,
    tried: [bool; PARAMETERS],
    believed: [bool; PARAMETERS],
}

impl Default for Verdict {
    fn default() -> Self {
        Self {
            values: [0.0; PARAMETERS],
            seen: SEEN,
            tried: [false; PARAMETERS],
            believed: [false; PARAMETERS],
        }
    }
}

impl Verdict {
    /// Whether a trial of a parameter by `step` is believed: it takes away what it should, and makes pings likelier.
    pub(crate) fn judge(
        &mut self,
        which: usize,
        step: f64,
        before: &Difference,
        after: &Difference,
        gain_sigmas: f64,
    ) -> bool {
        let seen = (before.residual()[which] - after.residual()[which]) / step;
        let is_seen = (LEAST_SEEN..MOST_SEEN).contains(&seen);
        let is_believed = is_seen && gain_sigmas > LIKELIER_SIGMAS;
        self.tried[which] = true;
        self.believed[which] = is_believed;
        if is_believed {
            self.values[which] += step;
            self.seen[which] = seen.clamp(SEEN_AT_LEAST, 1.0);
        }
        is_believed
    }
}

impl Difference {
    pub(crate) fn of(heard: &Found, predicted: &Found) -> Self {
        Self {
            heard: *heard,
            predicted: *predicted,
        }
    }

    /// What is heard alone.
    pub(crate) fn raw(&self) -> Values {
        self.heard.values
    }

    fn residual(&self) -> Values {
        std::array::from_fn(|i| self.heard.values[i] - self.predicted.values[i])
    }

    fn covariance(&self) -> Square<PARAMETERS> {
        let (heard, predicted) = (&self.heard.covariance, &self.predicted.covariance);
        std::array::from_fn(|i| std::array::from_fn(|j| heard[i][j] + predicted[i][j]))
    }

    fn sigmas(&self) -> Values {
        let covariance = self.covariance();
        std::array::from_fn(|i| covariance[i][i].max(0.0).sqrt())
    }

    /// The parameter not yet tried that alone explains most of the residual, if any is more than chance makes it; the
    /// speed of sound is never one.
    pub(crate) fn most_off(&self, verdict: &Verdict) -> Option<usize> {
        let factor = cholesky(&self.covariance())?;
        let scaled = solve(&factor, &self.residual());
        let gain = |i: usize| {
            let unit: Values = std::array::from_fn(|j| f64::from(u8::from(i == j)));
            scaled[i] * scaled[i] / solve(&factor, &unit)[i]
        };
        let (residual, sigmas) = (self.residual(), self.sigmas());
        let is_off = |&i: &usize| residual[i].abs() > TRIED_SIGMAS * sigmas[i] && !verdict.tried[i];
        let off = (0..PARAMETERS).filter(|&i| i != RANGE).filter(is_off);
        off.max_by(|&a, &b| gain(a).total_cmp(&gain(b)))
    }

    /// What is left over, added to what was believed. What was tried and not believed is an error of the method, and
    /// counts as such. `sound` is what is told of the speed of sound, in parts of it.
    pub(crate) fn told(&self, verdict: &Verdict, sound: Estimate) -> Calibration {
        let (residual, sigmas) = (self.residual(), self.sigmas());
        let at = |i: usize, unit: f64| {
            let is_refuted = verdict.tried[i] && !verdict.believed[i];
            let sigma = sigmas[i].hypot(if is_refuted { residual[i] } else { 0.0 });
            Estimate {
                value: unit * (verdict.values[i] + residual[i] / verdict.seen[i]),
                sigma: unit * sigma / verdict.seen[i],
                is_believed: verdict.believed[i],
            }
        };
        let degrees = 1f64.to_degrees();
        Calibration {
            time_offset_ms: at(TIME, 1e3),
            mount_roll_deg: at(TURN, degrees),
            mount_pitch_deg: at(TURN + 1, degrees),
            mount_yaw_deg: at(TURN + 2, degrees),
            lever_left_m: at(LEVER, 1.0),
            lever_up_m: at(LEVER + 1, 1.0),
            sound_speed_percent: Estimate {
                value: 100.0 * sound.value,
                sigma: 100.0 * sound.sigma,
                ..sound
            },
            landmarks: self.heard.landmarks,
            looks: self.heard.looks,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(which: usize, value: f64) -> Found {
        let mut values = [0.0; PARAMETERS];
        values[which] = value;
        let variance = |i: usize| (0.01 * PRIOR[i]).powi(2);
        let covariance = std::array::from_fn(|i| {
            std::array::from_fn(|j| if i == j { variance(i) } else { 0.0 })
        });
        Found {
            values,
            covariance,
            landmarks: 20,
            looks: 400,
        }
    }

    fn difference(which: usize, value: f64) -> Difference {
        Difference::of(&found(which, value), &found(which, 0.0))
    }

    #[test]
    fn what_a_trial_bears_out_is_believed_and_what_is_left_over_is_added() {
        let mut verdict = Verdict::default();
        let before = difference(TIME, 0.024);
        assert_eq!(before.most_off(&verdict), Some(TIME));
        let after = difference(TIME, 0.0008);
        assert!(verdict.judge(TIME, 0.029, &before, &after, 6.0));
        assert_eq!(after.most_off(&verdict), None);
        let told = after.told(&verdict, Estimate::default()).time_offset_ms;
        assert!(
            told.is_believed && (told.value - 30.0).abs() < 0.1,
            "{told:?}"
        );
    }

    #[test]
    fn a_trial_that_makes_pings_no_likelier_counts_as_an_error_of_the_method() {
        for (after, gain) in [(0.0008, 1.0), (0.024, 6.0), (0.0008, f64::NAN)] {
            let mut verdict = Verdict::default();
            let before = difference(TIME, 0.024);
            let after = difference(TIME, after);
            assert!(!verdict.judge(TIME, 0.029, &before, &after, gain));
            assert_eq!(before.most_off(&verdict), None);
            let told = before.told(&verdict, Estimate::default()).time_offset_ms;
            assert!(
                !told.is_believed && told.value.abs() < 1.01 * told.sigma,
                "{told:?}"
            );
        }
    }

    #[test]
    fn the_speed_of_sound_is_told_as_it_was_found_and_not_tried_by_landmarks() {
        let off = difference(RANGE, 0.015);
        assert_eq!(off.most_off(&Verdict::default()), None);
        let sound = Estimate {
            value: 0.012,
            sigma: 0.003,
            is_believed: true,
        };
        let told = off.told(&Verdict::default(), sound).sound_speed_percent;
        assert!(
            told.is_believed && (told.value - 1.2).abs() < 1e-6,
            "{told:?}"
        );
    }
}
