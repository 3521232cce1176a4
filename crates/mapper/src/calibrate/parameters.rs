//! What is estimated, and how it is told.

use std::ops::Range;

use serde::Serialize;

use super::linear::{Square, cholesky, solve};

/// What is calibrated; layout.
/// Time offset, mount about x, y and z, lever arm along y and z, scale of ranges, and the deviation of the compass with sine and
/// cosine of the heading.
pub(crate) const PARAMETERS: usize = 9;
/// Place of the clock's offset; layout.
pub(super) const TIME: usize = 0;
/// Place of the mount's turn; layout.
pub(super) const TURN: usize = 1;
/// Place of the lever arm; layout.
pub(super) const LEVER: usize = 4;
/// Place of the scale of ranges; layout.
pub(crate) const RANGE: usize = 6;
/// Place of the compass's deviation; layout.
pub(super) const COMPASS: usize = 7;

pub(crate) type Values = [f64; PARAMETERS];

/// Radians; by definition.
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Seconds, radians, metres, fractions; assumed.
/// One sigma of what is thought possible before any ping: seconds, radians, metres, fractions of the range.
pub(super) const PRIOR: Values = [
    0.1,
    3.0 * DEGREE,
    3.0 * DEGREE,
    3.0 * DEGREE,
    0.1,
    0.1,
    0.02,
    3.0 * DEGREE,
    3.0 * DEGREE,
];
/// One sigma of what is known; by definition.
const KNOWN: f64 = 1e-6;

/// What is asked of the heading. Where a vehicle always looks one way its compass cannot be told from its mount, and either would
/// hide the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Compass {
    /// It is as told.
    True,
    /// It deviates.
    Deviates,
}

impl Compass {
    pub(super) fn prior(self) -> Values {
        let mut prior = PRIOR;
        if self == Self::True {
            prior[COMPASS..].fill(KNOWN);
        }
        prior
    }
}

/// A value with its sigma.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Estimate {
    /// The most likely value.
    pub value: f64,
    /// One standard deviation of it.
    pub sigma: f64,
    /// Whether a map made with another value makes pings more likely: only then is it off.
    pub is_believed: bool,
}

/// What was found of clock, mount, compass and speed of sound.
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
    /// How far the sonar is turned to the left of where poses have it, degrees, by the sine of its heading, which is counted from
    /// the world's x to y.
    pub compass_sine_deg: Estimate,
    /// The same, by the cosine.
    pub compass_cosine_deg: Estimate,
    /// Landmarks that it rests on.
    pub landmarks: u64,
    /// Observations of them.
    #[serde(rename = "looks")]
    pub observations: u64,
}

/// Values with the covariance of their errors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found {
    pub(super) values: Values,
    pub(super) covariance: Square<PARAMETERS>,
    pub(super) landmarks: u64,
    pub(super) observations: u64,
}

/// What is heard against what the map would have made heard.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Difference {
    heard: Found,
    predicted: Found,
    /// One sigma that no ping tells.
    common: Values,
}

/// Seconds, radians, metres, fractions: measured on six dives.
/// One sigma of what a dive's own map shows off although nothing is: on surveys of a fence, a wall, a pier, a frame and a tower
/// it showed up to 4 ms, 0.3°, 2 cm and 0.3 % of the ranges.
const OF_OWN_MAP: Values = [
    2e-3,
    0.26 * DEGREE,
    0.26 * DEGREE,
    0.26 * DEGREE,
    0.017,
    0.017,
    0.003,
    0.26 * DEGREE,
    0.26 * DEGREE,
];

/// Sigmas; found.
/// A map is made with another value where the residual is so many sigmas.
const TRIED_SIGMAS: f64 = 4.0;
/// Standard errors; found.
/// Another value is believed if its likelihood gain on held-out pings is so many standard errors.
const LEAST_GAIN_SIGMAS: f64 = 4.0;
/// Fractions, measured on the survey of a fence.
/// What fraction of an error a map made with it leaves to see, as on the survey of a fence; of ranges that is not asked.
const SEEN: Values = [0.8, 0.65, 0.65, 0.65, 0.65, 0.65, 1.0, 0.65, 0.65];
/// Fraction, at least; found.
/// Least fraction that one is taken for.
const SEEN_AT_LEAST: f64 = 0.4;
/// Fraction of a step; found.
/// What fraction of the step has to vanish from the residual where it is right, and at most does.
const LEAST_SEEN: f64 = 0.2;
/// Fraction of a step; found.
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
    /// Whether a trial is believed: it takes away what it should of that which explains most, and has a likelihood gain.
    pub(crate) fn judge(
        &mut self,
        trial: &Step,
        before: &Difference,
        after: &Difference,
        gain_sigmas: f64,
    ) -> bool {
        let which = trial.which;
        let seen = (before.residual()[which] - after.residual()[which]) / trial.by[which];
        let is_seen = (LEAST_SEEN..MOST_SEEN).contains(&seen);
        let is_believed = is_seen && gain_sigmas > LEAST_GAIN_SIGMAS;
        for i in group(which) {
            self.tried[i] = true;
            self.believed[i] = is_believed;
            if is_believed {
                self.values[i] += trial.by[i];
                self.seen[i] = seen.clamp(SEEN_AT_LEAST, 1.0);
            }
        }
        is_believed
    }

    /// The values with a step more.
    pub(crate) fn after(&self, step: &Step) -> Values {
        std::array::from_fn(|i| self.values[i] + step.by[i])
    }
}

/// What is tried together: both coefficients of the compass are one thing.
fn group(which: usize) -> Range<usize> {
    match which {
        COMPASS.. => COMPASS..PARAMETERS,
        _ => which..which + 1,
    }
}

/// Other values to be tried.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step {
    /// The parameter that explains most.
    which: usize,
    by: Values,
}

impl Difference {
    pub(crate) fn of(heard: &Found, predicted: &Found) -> Self {
        Self {
            heard: *heard,
            predicted: *predicted,
            common: [0.0; PARAMETERS],
        }
    }

    /// With what any dive's own map shows off although nothing is.
    pub(crate) fn of_own_map(self) -> Self {
        Self {
            common: OF_OWN_MAP,
            ..self
        }
    }

    /// What is shown of the scale of ranges, and one sigma of it.
    pub(crate) fn sound(&self) -> (f64, f64) {
        (self.residual()[RANGE], self.sigmas()[RANGE])
    }

    fn residual(&self) -> Values {
        std::array::from_fn(|i| self.heard.values[i] - self.predicted.values[i])
    }

    fn covariance(&self) -> Square<PARAMETERS> {
        let (heard, predicted) = (&self.heard.covariance, &self.predicted.covariance);
        let common = |i: usize, j: usize| if i == j { self.common[i].powi(2) } else { 0.0 };
        std::array::from_fn(|i| {
            std::array::from_fn(|j| heard[i][j] + predicted[i][j] + common(i, j))
        })
    }

    fn sigmas(&self) -> Values {
        let covariance = self.covariance();
        std::array::from_fn(|i| covariance[i][i].max(0.0).sqrt())
    }

    /// What to try next: the parameter not yet tried that alone explains most of the residual, if any is more than chance makes
    /// it; the speed of sound is never one, and the compass only where it was asked whether it deviates.
    pub(crate) fn most_off(&self, verdict: &Verdict, compass: Compass) -> Option<Step> {
        let factor = cholesky(&self.covariance())?;
        let scaled = solve(&factor, &self.residual());
        let gain = |i: usize| {
            let unit: Values = std::array::from_fn(|j| f64::from(u8::from(i == j)));
            scaled[i] * scaled[i] / solve(&factor, &unit)[i]
        };
        let is_off = |&i: &usize| self.is_off(i) && !verdict.tried[i];
        let end = match compass {
            Compass::True => COMPASS,
            Compass::Deviates => PARAMETERS,
        };
        let off = (0..end).filter(|&i| i != RANGE).filter(is_off);
        let which = off.max_by(|&a, &b| gain(a).total_cmp(&gain(b)))?;
        let mut by = [0.0; PARAMETERS];
        by[which] = self.heard.values[which];
        for other in group(which).filter(|&other| other != which) {
            by[other] = self.sure_fraction(other) * self.heard.values[other];
        }
        Some(Step { which, by })
    }

    fn is_off(&self, which: usize) -> bool {
        self.residual()[which].abs() > TRIED_SIGMAS * self.sigmas()[which]
    }

    /// Whether the heading of poses is more off than chance makes it, and that was not tried yet.
    pub(crate) fn is_compass_off(&self, verdict: &Verdict) -> bool {
        (COMPASS..PARAMETERS).any(|i| self.is_off(i) && !verdict.tried[i])
    }

    /// What fraction of a value is likely to be its own and not its error: Wiener's filter.
    fn sure_fraction(&self, which: usize) -> f64 {
        let (value, sigma) = (self.residual()[which], self.sigmas()[which]);
        value * value / (value * value + sigma * sigma).max(f64::MIN_POSITIVE)
    }

    /// What is left over, added to what was believed. What was tried and not believed is an error of the method, and counts as
    /// such. `sound` is what is told of the speed of sound, as a fraction of it, and `compass` of the heading.
    pub(crate) fn told(
        &self,
        verdict: &Verdict,
        sound: Estimate,
        compass: [Estimate; 2],
    ) -> Calibration {
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
            compass_sine_deg: compass[0],
            compass_cosine_deg: compass[1],
            landmarks: self.heard.landmarks,
            observations: self.heard.observations,
        }
    }

    /// What is told of the heading, degrees by sine and cosine of the heading in the world, where the map's x axis has the
    /// heading `axis_rad`.
    pub(crate) fn compass(&self, verdict: &Verdict, axis_rad: f64) -> [Estimate; 2] {
        let (residual, covariance) = (self.residual(), self.covariance());
        let (seen, is_believed) = (verdict.seen[COMPASS], verdict.believed[COMPASS]);
        let left = |i: usize| residual[i] / seen;
        let (sine, cosine) = axis_rad.sin_cos();
        let along = |on_sine: f64, on_cosine: f64| {
            let value = on_sine * (verdict.values[COMPASS] + left(COMPASS))
                + on_cosine * (verdict.values[COMPASS + 1] + left(COMPASS + 1));
            let variance = on_sine * on_sine * covariance[COMPASS][COMPASS]
                + 2.0 * on_sine * on_cosine * covariance[COMPASS][COMPASS + 1]
                + on_cosine * on_cosine * covariance[COMPASS + 1][COMPASS + 1];
            let is_refuted = verdict.tried[COMPASS] && !is_believed;
            let refuted = left(COMPASS).hypot(left(COMPASS + 1));
            let sigma = variance.max(0.0).sqrt() / seen;
            Estimate {
                value: value.to_degrees(),
                sigma: sigma
                    .hypot(if is_refuted { refuted } else { 0.0 })
                    .to_degrees(),
                is_believed,
            }
        };
        [along(cosine, sine), along(-sine, cosine)]
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
            observations: 400,
        }
    }

    fn difference(which: usize, value: f64) -> Difference {
        Difference::of(&found(which, value), &found(which, 0.0))
    }

    fn late(by_s: f64) -> Step {
        let mut by = [0.0; PARAMETERS];
        by[TIME] = by_s;
        Step { which: TIME, by }
    }

    fn told(left: &Difference, verdict: &Verdict, sound: Estimate) -> Calibration {
        left.told(verdict, sound, [Estimate::default(); 2])
    }

    #[test]
    fn both_coefficients_of_the_compass_are_tried_together_and_told_by_the_worlds_headings() {
        let degree = 1f64.to_radians();
        let mut heard = found(COMPASS, 3.0 * degree);
        heard.values[COMPASS + 1] = -2.0 * degree;
        let none = found(COMPASS, 0.0);
        let before = Difference::of(&heard, &none);
        let mut verdict = Verdict::default();
        assert!(before.is_compass_off(&verdict));
        assert!(before.most_off(&verdict, Compass::True).is_none());
        let step = before.most_off(&verdict, Compass::Deviates).unwrap();
        assert!((step.by[COMPASS] - 3.0 * degree).abs() < 1e-9);
        assert!((step.by[COMPASS + 1] + 2.0 * degree).abs() < 1e-4);
        let after = Difference::of(&none, &none);
        assert!(verdict.judge(&step, &before, &after, 6.0));
        assert!(!before.is_compass_off(&verdict));
        // The map looks along the world's y: its sine is the world's cosine less its sign.
        let axis_rad = std::f64::consts::FRAC_PI_2;
        let [sine, cosine] = after.compass(&verdict, axis_rad);
        assert!(sine.is_believed && cosine.is_believed);
        assert!((sine.value + 2.0).abs() < 1e-2, "{sine:?}");
        assert!((cosine.value + 3.0).abs() < 1e-2, "{cosine:?}");
    }

    #[test]
    fn what_a_trial_bears_out_is_believed_and_what_is_left_over_is_added() {
        let mut verdict = Verdict::default();
        let before = difference(TIME, 0.024);
        let step = before.most_off(&verdict, Compass::True).unwrap();
        assert_eq!(step.which, TIME);
        let after = difference(TIME, 0.0008);
        assert!(verdict.judge(&late(0.029), &before, &after, 6.0));
        assert!(after.most_off(&verdict, Compass::True).is_none());
        let told = told(&after, &verdict, Estimate::default()).time_offset_ms;
        assert!(
            told.is_believed && (told.value - 30.0).abs() < 0.1,
            "{told:?}"
        );
    }

    #[test]
    fn a_trial_without_likelihood_gain_counts_as_an_error_of_the_method() {
        for (after, gain) in [(0.0008, 1.0), (0.024, 6.0), (0.0008, f64::NAN)] {
            let mut verdict = Verdict::default();
            let before = difference(TIME, 0.024);
            let after = difference(TIME, after);
            assert!(!verdict.judge(&late(0.029), &before, &after, gain));
            assert!(before.most_off(&verdict, Compass::True).is_none());
            let told = told(&before, &verdict, Estimate::default()).time_offset_ms;
            assert!(
                !told.is_believed && told.value.abs() < 1.01 * told.sigma,
                "{told:?}"
            );
        }
    }

    #[test]
    fn what_any_own_map_shows_is_not_tried_and_told_with_its_sigma() {
        let shown = difference(TIME, 6e-3);
        assert!(shown.most_off(&Verdict::default(), Compass::True).is_some());
        let own = shown.of_own_map();
        assert!(own.most_off(&Verdict::default(), Compass::True).is_none());
        let told = told(&own, &Verdict::default(), Estimate::default()).time_offset_ms;
        assert!(told.sigma > 2.0 && told.value > told.sigma, "{told:?}");
        let late = difference(TIME, 0.024).of_own_map();
        assert!(late.most_off(&Verdict::default(), Compass::True).is_some());
    }

    #[test]
    fn the_speed_of_sound_is_told_as_it_was_found_and_not_tried_by_landmarks() {
        let off = difference(RANGE, 0.015);
        assert!(off.most_off(&Verdict::default(), Compass::True).is_none());
        let sound = Estimate {
            value: 0.012,
            sigma: 0.003,
            is_believed: true,
        };
        let told = told(&off, &Verdict::default(), sound).sound_speed_percent;
        assert!(
            told.is_believed && (told.value - 1.2).abs() < 1e-6,
            "{told:?}"
        );
    }
}
