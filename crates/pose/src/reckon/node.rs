//! Where the vehicle is at a velocity, how sure that is, and the way from one to the next.

use echosplat_model::Timestamp;
use echosplat_model::glam::DVec3;

use super::slope::{Known, Slope};

/// Metres, assumed: what poses scatter by.
/// One sigma of a place at the beginning of an epoch, which counts from there.
const FIRST_SIGMA_M: f64 = 0.02;
/// Metres a second, from the data sheet of an A50.
/// One sigma of a velocity, of its own.
const VELOCITY_SIGMA_MPS: f64 = 0.01;
/// Square metres a metre, derived: 1 %, of legs of 2 m.
/// Growth of the variance along and across by the way: a scale that is 1 % off, as that of a Water Linked A50 at most, and a
/// heading as much, over the legs of a survey, which goes back and forth.
const BY_WAY_M2_PER_M: f64 = 2e-4;
/// Metres a second by the root of a second, measured: 0.03.
/// How a velocity changes that is not measured, along each axis: of simulated surveys, whose vehicle turns at 0.3 m/s.
const CHANGE_MPS_PER_ROOT_S: f64 = 0.03;
/// Fraction, measured: 0.4 to 0.6.
/// What is left of the error across a gap where it is known how velocities changed before and after it.
const LEFT_BY_SLOPES: f64 = 0.6;
/// Fraction, found: 0.5 is better than 0.7 and 1.
/// How much slopes beside a gap count against an even change across it: they are of velocities that wander, and noisy.
const SLOPES_COUNT: f64 = 0.5;
/// Metres; a pressure sensor's.
/// One sigma of a height by the depth sensor.
const DEPTH_SIGMA_M: f64 = 0.02;

/// A place and the velocity there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Node {
    pub(super) time: Timestamp,
    pub(super) place_m: DVec3,
    /// In world axes.
    pub(super) mps: DVec3,
    /// Of the integral, along each axis, square metres.
    variance_m2: f64,
    /// Whether the height is the depth sensor's.
    pub(super) has_depth: bool,
}

impl Node {
    /// Where the world begins.
    pub(super) fn first(known: Known) -> Self {
        Self {
            time: known.time,
            place_m: DVec3::ZERO,
            mps: known.mps,
            variance_m2: FIRST_SIGMA_M.powi(2),
            has_depth: false,
        }
    }

    /// Along the level axes, and up, square metres.
    pub(super) fn variances_m2(&self) -> [f64; 2] {
        let up_m2 = match self.has_depth {
            true => DEPTH_SIGMA_M.powi(2),
            false => self.variance_m2,
        };
        [self.variance_m2, up_m2]
    }
}

/// From one velocity to the next, or on and on with the last.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stretch {
    from: Node,
    /// How long it is; endless where the velocity is carried on.
    span_s: f64,
    /// At both ends.
    mps: [DVec3; 2],
    /// What velocities change by at both ends, times the span.
    changes_mps: [DVec3; 2],
    /// Fraction of the error of an even change that is left.
    left: f64,
}

impl Stretch {
    /// Velocity changes evenly from one to the next, which has to be later.
    pub(super) fn between(from: &Node, until: Known) -> Self {
        let change_mps = until.mps - from.mps;
        Self {
            from: *from,
            span_s: until.time.seconds_since(from.time),
            mps: [from.mps, until.mps],
            changes_mps: [change_mps; 2],
            left: 1.0,
        }
    }

    /// Across a gap: a cubic whose slopes at its ends are partly those of the velocities before and behind it, where these are
    /// known.
    pub(super) fn across(from: &Node, until: Known, [before, behind]: [Option<Slope>; 2]) -> Self {
        let even = Self::between(from, until);
        let smoothed = |slope: Option<Slope>, mps: DVec3| slope.map_or(mps, |slope| slope.mps);
        let mps = [smoothed(before, from.mps), smoothed(behind, until.mps)];
        let even_mps = mps[1] - mps[0];
        let bent = |slope: Option<Slope>| {
            let own_mps = slope.map_or(even_mps, |slope| slope.mps2 * even.span_s);
            even_mps + (own_mps - even_mps) * SLOPES_COUNT
        };
        Self {
            mps,
            changes_mps: [bent(before), bent(behind)],
            left: if before.is_some() && behind.is_some() {
                LEFT_BY_SLOPES
            } else {
                1.0
            },
            ..even
        }
    }

    pub(super) fn carried(from: &Node) -> Self {
        Self {
            from: *from,
            span_s: f64::INFINITY,
            mps: [from.mps; 2],
            changes_mps: [DVec3::ZERO; 2],
            left: 1.0,
        }
    }

    pub(super) fn at(&self, time: Timestamp) -> Node {
        let elapsed_s = time.seconds_since(self.from.time).clamp(0.0, self.span_s);
        let (mps, moved_m) = self.moved(elapsed_s);
        let of_noise_m2 = (VELOCITY_SIGMA_MPS * elapsed_s).powi(2);
        let of_velocity_m2 = self.left.powi(2) * (of_noise_m2 + self.of_change_m2(elapsed_s));
        let of_way_m2 = BY_WAY_M2_PER_M * moved_m.length();
        Node {
            time,
            place_m: self.from.place_m + moved_m,
            mps,
            variance_m2: self.from.variance_m2 + of_velocity_m2 + of_way_m2,
            has_depth: false,
        }
    }

    /// Velocity, and its integral since the beginning: of the cubic in Hermite's form.
    fn moved(&self, elapsed_s: f64) -> (DVec3, DVec3) {
        let u = elapsed_s / self.span_s;
        let [from, until] = self.mps;
        let [begins, ends] = self.changes_mps;
        let (u2, u3) = (u * u, u.powi(3));
        let mps = from * (2.0 * u3 - 3.0 * u2 + 1.0)
            + until * (3.0 * u2 - 2.0 * u3)
            + begins * (u3 - 2.0 * u2 + u)
            + ends * (u3 - u2);
        let mean_mps = from * (u3 / 2.0 - u2 + 1.0)
            + until * (u2 - u3 / 2.0)
            + begins * (u3 / 4.0 - 2.0 * u2 / 3.0 + u / 2.0)
            + ends * (u3 / 4.0 - u2 / 3.0);
        (mps, mean_mps * elapsed_s)
    }

    /// The integral of a velocity that wanders: free, or held at both ends.
    fn of_change_m2(&self, elapsed_s: f64) -> f64 {
        let free_s3 = elapsed_s.powi(3) * (1.0 / 3.0 - 0.25 * elapsed_s / self.span_s);
        CHANGE_MPS_PER_ROOT_S.powi(2) * free_s3
    }
}
