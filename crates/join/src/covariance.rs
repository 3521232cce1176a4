//! What covariances of poses mean for a ping.
//!
//! A source tells how far its pose may be from the truth, all that came of the past included. A map is made of how
//! poses stand to each other: an error that is the same from ping to ping puts the whole map elsewhere and smears
//! nothing. Of a variance P that a source tells, in the direction in which it moves echoes,
//!
//! * what is there all along, or grows all along as that of dead reckoning does, is shared with the poses around. It
//!   smears echoes by no more than poses are taken to scatter anyway: the configured sigma, or what is left of their
//!   jitter;
//! * what it rose by beyond that within the time that errors take to fade, as while a Doppler log loses the bottom,
//!   sets the pose apart from those before it: how far P(t) lies above an earlier P moved on by the mean growth of that time.
//!
//! Cost: 65 look-ups among the poses held for each ping whose poses have a covariance.

use echosplat_model::{LEFT_OF_JITTER, PoseCovariance, PoseUncertainty, Timestamp, Trajectory};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Metres, derived: a quarter of 100 m, the longest range.
/// No pose is of use whose place is less sure, one sigma, metres: a quarter of the longest range of a sonar of this
/// kind, 100 m, beyond which a ping says nothing of any place. Drivers write 1e6, 9999 or 1000 m² where nobody measures.
const LARGEST_SIGMA_M: f64 = 25.0;
/// Square radians, derived: nothing is known of the angle.
/// Variance of an angle of which nothing is known: even over the whole turn, π²/3.
const LARGEST_VARIANCE_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;
/// Covariances before a ping, bounds work.
/// Covariances before a ping are looked at so often within the time that errors take to fade.
const LOOKS: u32 = 64;
/// Fraction of variance, assumed: less is rounding.
/// A rise of less, as a share of the variance that poses are taken to have anyway, is rounding.
const LEAST_RISE: f64 = 1e-6;

/// What is made of the covariances that poses come with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariances {
    /// They weigh pings, axis by axis.
    #[default]
    Use,
    /// Nothing: all poses have the configured sigma.
    Ignore,
}

/// What covariances are judged by.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CovarianceRule {
    /// Whether they are used.
    pub covariances: Covariances,
    /// One sigma of an axis of which the source says nothing that can be used.
    pub prior: PoseUncertainty,
    /// Time in which errors that neighbouring poses share fade, seconds.
    pub error_time_s: f64,
    /// Half the angle over which the sonar hears across its slice, radians.
    pub fan_half_width_rad: f64,
}

impl Default for CovarianceRule {
    fn default() -> Self {
        Self {
            covariances: Covariances::Use,
            prior: PoseUncertainty {
                position_m: 0.02,
                attitude_rad: 0.2_f64.to_radians(),
            },
            error_time_s: 60.0,
            fan_half_width_rad: 25_f64.to_radians(),
        }
    }
}

/// What became of covariances.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct CovarianceCounters {
    /// Poses that came with one.
    pub given: u64,
    /// Of these, those left out since `pose.covariances` says so.
    pub ignored: u64,
    /// Poses whose variance along x cannot be used: not finite, not positive, or larger than that of any pose of
    /// use. The configured sigma stands for it.
    pub unusable_x: u64,
    /// Along y.
    pub unusable_y: u64,
    /// Along z.
    pub unusable_z: u64,
    /// About x.
    pub unusable_roll: u64,
    /// About y.
    pub unusable_pitch: u64,
    /// About z.
    pub unusable_yaw: u64,
    /// Pings that a rise of their pose's covariance smears by more than the poses' own scatter.
    pub pings_smeared: u64,
    /// By how much the newest of these is, one sigma in the middle of its range, metres.
    pub newest_smear_m: f64,
}

/// Metres, derived: within this probability speaks of surface.
/// A smear in the middle of the range that is told of, metres: that within which a map says how likely surface is.
const TOLD_M: f64 = 0.1;

/// Judges and projects.
#[derive(Debug, Default)]
pub(crate) struct CovarianceJudge {
    rule: CovarianceRule,
    counters: CovarianceCounters,
}

/// The ping whose echoes errors move.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    pub(crate) time: Timestamp,
    /// Of the sensor turned along the beam.
    pub(crate) world_from_beam: DQuat,
    /// The middle of its range, metres.
    pub(crate) range_m: f64,
    pub(crate) jitter: Option<PoseUncertainty>,
}

/// How errors of a pose move echoes, variances.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Moved {
    range_m2: f64,
    azimuth_rad2: f64,
}

impl CovarianceJudge {
    pub(crate) fn new(rule: CovarianceRule) -> Self {
        Self {
            rule,
            ..Self::default()
        }
    }

    pub(crate) fn counters(&self) -> CovarianceCounters {
        self.counters
    }

    /// What can be used of a covariance, the configured sigma along and about the axes of which it says nothing;
    /// `None` if it says nothing at all.
    pub(crate) fn usable(&mut self, told: Option<PoseCovariance>) -> Option<PoseCovariance> {
        let told = told?;
        self.counters.given += 1;
        if self.rule.covariances == Covariances::Ignore {
            self.counters.ignored += 1;
            return None;
        }
        let prior = self.rule.prior;
        let places = told.position_variances_m2();
        let are_known = places.map(|m2| m2 > 0.0 && m2 <= LARGEST_SIGMA_M * LARGEST_SIGMA_M);
        let are_angles_known = told
            .attitude_rad2
            .map(|rad2| rad2 > 0.0 && rad2 <= LARGEST_VARIANCE_RAD2);
        self.count(are_known, are_angles_known);
        if !are_known.contains(&true) && !are_angles_known.contains(&true) {
            return None;
        }
        let place = |axis: usize| match are_known[axis] {
            true => places[axis],
            false => prior.position_m.powi(2),
        };
        let mixed = |a: usize, b: usize, m2: f64| {
            let is_of_both = are_known[a] && are_known[b] && m2.powi(2) <= places[a] * places[b];
            if is_of_both { m2 } else { 0.0 }
        };
        let [_, xy, xz, _, yz, _] = told.position_m2;
        let angle = |axis: usize| match are_angles_known[axis] {
            true => told.attitude_rad2[axis],
            false => prior.attitude_rad.powi(2),
        };
        Some(PoseCovariance {
            position_m2: [
                place(0),
                mixed(0, 1, xy),
                mixed(0, 2, xz),
                place(1),
                mixed(1, 2, yz),
                place(2),
            ],
            attitude_rad2: [angle(0), angle(1), angle(2)],
        })
    }

    fn count(&mut self, are_known: [bool; 3], are_angles_known: [bool; 3]) {
        let counters = &mut self.counters;
        let unusable = [
            &mut counters.unusable_x,
            &mut counters.unusable_y,
            &mut counters.unusable_z,
            &mut counters.unusable_roll,
            &mut counters.unusable_pitch,
            &mut counters.unusable_yaw,
        ];
        let known = are_known.into_iter().chain(are_angles_known);
        for (counter, is_known) in unusable.into_iter().zip(known) {
            *counter += u64::from(!is_known);
        }
    }

    /// What the pose of a ping is off by against those around it; `None` if its source says nothing of it.
    pub(crate) fn of_ping(&mut self, poses: &Trajectory, view: &View) -> Option<PoseUncertainty> {
        let window = self.window(poses, view)?;
        let (_, told) = *window.first()?;
        let prior = &self.rule.prior;
        let jitter = view.jitter.unwrap_or(PoseUncertainty {
            position_m: 0.0,
            attitude_rad: 0.0,
        });
        let rise = |of: fn(&Moved) -> f64| sudden_rise(window.iter().map(|(s, m)| (*s, of(m))));
        let scatter_m = prior.position_m.max(LEFT_OF_JITTER * jitter.position_m);
        let scatter_rad = prior.attitude_rad.max(LEFT_OF_JITTER * jitter.attitude_rad);
        let turned_rad = with_rise(told.azimuth_rad2, scatter_rad, rise(|m| m.azimuth_rad2));
        let found = PoseUncertainty {
            position_m: with_rise(told.range_m2, scatter_m, rise(|m| m.range_m2)),
            attitude_rad: turned_rad.min(LARGEST_VARIANCE_RAD2.sqrt()),
        };
        let at_range_m = |sigma_m: f64, sigma_rad: f64| sigma_m.hypot(sigma_rad * view.range_m);
        let smear_m = at_range_m(found.position_m, found.attitude_rad);
        let usual_m = std::f64::consts::SQRT_2 * at_range_m(scatter_m, scatter_rad);
        if smear_m > usual_m.max(TOLD_M) {
            self.counters.pings_smeared += 1;
            self.counters.newest_smear_m = smear_m;
        }
        Some(found)
    }

    /// How errors move the ping's echoes by the covariance of its pose, first, and of those before it, so many seconds.
    fn window(&self, poses: &Trajectory, view: &View) -> Option<Vec<(f64, Moved)>> {
        let newest = poses.at_or_before(view.time)?;
        let mut window = vec![(0.0, self.moved(&newest.uncertainty?, view))];
        for look in 1..=LOOKS {
            let before_s = self.rule.error_time_s * f64::from(look) / f64::from(LOOKS);
            let Some(pose) = poses.at_or_before(newest.time.offset_by(-before_s)) else {
                break;
            };
            let (Some(covariance), true) = (&pose.uncertainty, pose.epoch == newest.epoch) else {
                break;
            };
            let before_s = newest.time.seconds_since(pose.time);
            window.push((before_s, self.moved(covariance, view)));
        }
        Some(window)
    }

    /// Along the range and across it, in the mean over the fan. A shift across the fan moves an echo as a turn does, and counts
    /// as one where it is more than that along the range; what goes along the arcs of the fan is not measured.
    fn moved(&self, covariance: &PoseCovariance, view: &View) -> Moved {
        let [xx, xy, xz, yy, yz, zz] = covariance.position_m2;
        let along = |u: DVec3| {
            let squares = xx * u.x * u.x + yy * u.y * u.y + zz * u.z * u.z;
            let mixed = xy * u.x * u.y + xz * u.x * u.z + yz * u.y * u.z;
            (squares + 2.0 * mixed).max(0.0)
        };
        // Which of the level axes is meant goes with the source: about both alike.
        let [about_x, about_y, about_z] = covariance.attitude_rad2;
        let tilt = 0.5 * (about_x + about_y);
        let about = |u: DVec3| tilt * (u.x * u.x + u.y * u.y) + about_z * u.z * u.z;
        let axis = |axis: DVec3| view.world_from_beam * axis;
        let (ahead, aside, normal) = (axis(DVec3::X), axis(DVec3::Y), axis(DVec3::Z));
        let upwards = mean_square_of_sine(self.rule.fan_half_width_rad);
        let range_m2 = (1.0 - upwards) * along(ahead) + upwards * along(normal);
        let beyond_m2 = (along(aside) - range_m2).max(0.0);
        Moved {
            range_m2,
            azimuth_rad2: (1.0 - upwards) * about(normal)
                + upwards * about(ahead)
                + beyond_m2 / view.range_m.powi(2).max(1.0),
        }
    }
}

/// Of an elevation that is even over the fan.
fn mean_square_of_sine(half_width_rad: f64) -> f64 {
    0.5 - (2.0 * half_width_rad).sin() / (4.0 * half_width_rad)
}

/// What a variance rose by of late beyond a steady growth; of its value now first, and then of so many seconds before.
fn sudden_rise(values: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
    let ends = values.clone().next().zip(values.clone().last());
    let Some(((_, now), (before_s, first))) = ends else {
        return 0.0;
    };
    let growth = match before_s > 0.0 {
        true => ((now - first) / before_s).max(0.0),
        false => 0.0,
    };
    values
        .map(|(before_s, value)| now - value - growth * before_s)
        .fold(0.0, f64::max)
}

/// One sigma of what is told, but no more of it than poses scatter, and of a rise.
fn with_rise(told: f64, scatter: f64, rise: f64) -> f64 {
    let own = told.sqrt().min(scatter);
    match rise > LEAST_RISE * scatter.powi(2) {
        true => own.hypot(rise.sqrt()),
        false => own,
    }
}

#[cfg(test)]
mod tests;
