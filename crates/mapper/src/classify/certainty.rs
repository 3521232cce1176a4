//! How sure a Gaussian's place is: its own pings, the surface around it, and what its poses have in common.
//!
//! And how likely there is surface beside it at all.
//!
//! Pings whose poses are off alike agree, and what they agree on is off as well: however many come together, the place is no
//! surer than their poses. Those that come later are off otherwise.

use echosplat_measurement::SymmetricMat3;
use echosplat_measurement::heard::Rows;
use echosplat_model::glam::{DMat3, DVec3, Mat3};
use echosplat_model::{Reason, Standing, Why};
use rayon::prelude::*;

use crate::accumulate::finding::{Finding, ViewStatistics};
use crate::accumulate::history::PoseBlur;
use crate::refine::shape::{eigen, scatter_of};
use crate::spawn::gaussians::{BY_CHANCE, Gaussians, Verdict};
use crate::spawn::neighbours::Neighbours;

/// Metres, derived: a usual range.
/// A place that nothing is known of is within a ping's range, of which this is a usual one, metres.
const REACH_M: f64 = 10.0;
/// Voxels, derived: the next, diagonals included.
/// A surface goes on within so many voxels.
const SURFACE_VOXELS: f32 = 1.5;

/// Metres, assumed: half of an 8 cm pipe.
/// Half the thickness of what may be taken for one place while observations from two sides hear a face of it each: that of a pipe
/// of 8 cm.
pub(crate) const HALF_THICKNESS_M: f64 = 0.04;

/// Metres, by definition of probability.
/// Surface is looked for this near.
pub(crate) const NEAR_M: f32 = 0.10;
/// Nats, measured by logistic regression.
/// Log odds of a place that explains as much as the best other place on the arc, whose sigma across the surface and the error
/// that its poses share are `NEAR_M`, and that is heard from one side or from all around. They grow by so many times its log odds
/// against the other places, from its explained-energy ratio (at most `MOST_TOLD`, at least `LEAST_TOLD`), and fall by so many
/// times the logarithms of that sigma, of what its poses share, and of how many half thicknesses it lies from the body's middle.
/// Found by logistic regression; `docs/decisions/2026-11-28-what-is-asserted.md` has the dives and what they leave over.
const EVEN_ODDS: f32 = 0.2;
/// Nats a nat; measured likewise.
const PER_EXPLAINED_RATIO: f32 = 1.2;
/// Nats, at least; measured likewise.
const LEAST_TOLD: f32 = -3.0;
/// Nats, at most; measured likewise.
const MOST_TOLD: f32 = 1.5;
/// Nats a nat; measured likewise.
const PER_SIGMA: f32 = 0.9;
/// Nats a nat; measured likewise.
const PER_SHARED: f32 = 1.2;
/// Nats a nat; measured likewise.
const PER_BEYOND: f32 = 1.4;
/// Metres, measured: the best poses there were.
/// Poses that share less tell no more: no dive that the numbers above were found on has better ones.
const LEAST_SHARED_M: f32 = 0.02;
/// Probability, assumed: false costs 2.3 times ambiguous.
/// Asserted is what would have at least this probability if its poses shared an error of `NEAR_M` and bodies were thin: a
/// place asserted in vain costs as much as two or three that are shown as ambiguous.
pub(super) const LEAST_PROBABILITY: f32 = 0.70;
/// Square metres, assumed: a micrometre.
/// A variance is not taken for less, square metres: rounding may leave nothing of it, and a micrometre is surer than any place.
const LEAST_M2: f32 = 1e-12;

/// What an error of the sensor's pose makes of a place, square metres: of its position alike in all directions, of its
/// attitude across the line of sight.
pub(super) fn of_pose(rows: &Rows, row: usize, error: PoseBlur) -> SymmetricMat3 {
    let (away, range_m) = (rows.range_axis_of(row), rows.range_m[row]);
    let turned_m2 = error.azimuth_variance_rad2 * range_m * range_m;
    let across = Mat3::IDENTITY - Mat3::from_cols(away * away.x, away * away.y, away * away.z);
    SymmetricMat3::of(Mat3::IDENTITY * error.range_variance_m2 + across * turned_m2)
}

/// Sets covariance, sigma and probability of every Gaussian that there is a finding for.
pub(crate) fn tell(
    gaussians: &mut Gaussians,
    finding_of: impl Fn(usize) -> Option<Finding> + Sync,
    voxel_m: f32,
) {
    let is_confident =
        |slot: usize| gaussians.verdict[slot] == Verdict::Published(Standing::Confident);
    let neighbours = Neighbours::new(gaussians, SURFACE_VOXELS * voxel_m, is_confident);
    let surfaces = neighbours.map(|_| true, |around| scatter_of(around, |_| 1.0));
    let mut surface_of = vec![None; gaussians.slot_count()];
    for (slot, scatter) in surfaces {
        surface_of[slot] = Some(scatter);
    }
    let of_slot = |(slot, surface): (usize, Option<Mat3>)| {
        let finding = finding_of(slot).filter(|_| gaussians.alive[slot])?;
        let place = Place::of(&finding, gaussians.child_share[slot], surface, voxel_m);
        Some(Certainty::of(&place, &finding.statistics, voxel_m))
    };
    let certainties: Vec<Option<Certainty>> = surface_of
        .into_par_iter()
        .enumerate()
        .map(of_slot)
        .collect();
    for (slot, certainty) in certainties.into_iter().enumerate() {
        let Some(certainty) = certainty else { continue };
        gaussians.position_covariance_m2[slot] = certainty.position_covariance_m2;
        gaussians.sigma_m[slot] = certainty.sigma_m;
        gaussians.probability[slot] = certainty.probability;
        gaussians.is_likely[slot] = certainty.is_likely;
        let is_confident = gaussians.verdict[slot] == Verdict::Published(Standing::Confident);
        if is_confident && !certainty.is_likely {
            let why = &mut gaussians.why[slot];
            *why = Why {
                clear: why.clear,
                ..Why::of(Reason::Improbable, 0.0, certainty.own_probability)
            };
        }
    }
}

/// What is told of one Gaussian.
struct Certainty {
    position_covariance_m2: SymmetricMat3,
    sigma_m: f32,
    probability: f32,
    is_likely: bool,
    /// By its own odds alone, which that goes by.
    own_probability: f32,
}

impl Certainty {
    fn of(place: &Place, statistics: &ViewStatistics, voxel_m: f32) -> Self {
        // Beyond single precision nothing is known; no number would take the Gaussian from the map.
        if !place.covariance_m2.is_finite() {
            return Self {
                position_covariance_m2: SymmetricMat3::isotropic(f32::INFINITY),
                sigma_m: f32::INFINITY,
                probability: BY_CHANCE,
                is_likely: false,
                own_probability: BY_CHANCE,
            };
        }
        let (_, variances_m2) = eigen(place.covariance_m2);
        let own_odds = own_odds(statistics, variances_m2.x);
        Self {
            position_covariance_m2: SymmetricMat3::of(place.covariance_m2),
            sigma_m: variances_m2.z.max(0.0).sqrt(),
            probability: place.probability(own_odds),
            is_likely: own_odds >= least_odds(voxel_m),
            own_probability: of_odds(own_odds),
        }
    }
}

/// How well a Gaussian's place is known.
struct Place {
    covariance_m2: Mat3,
    /// One sigma along an axis of the error that its poses share, metres.
    shared_m: f32,
    /// How many half thicknesses its observations put it from the middle of what they hear.
    off: f32,
}

impl Place {
    /// Covariance `(H + P⁻¹)⁻¹ + T + C`: information `H` of its own pings, the place `P` that the surface around leaves it (the
    /// scatter of its neighbours, and as much as a voxel is wide) or any within reach, what a thick body adds as `T`, and the
    /// error `C` of the poses. What the children of a split Gaussian know adds up.
    fn of(finding: &Finding, child_share: f32, surface: Option<Mat3>, voxel_m: f32) -> Self {
        let information =
            finding.information.to_mat3().as_dmat3() * f64::from(child_share).powi(-2);
        let anywhere = DMat3::from_diagonal(DVec3::splat(REACH_M.powi(-2)));
        let prior = match surface {
            Some(scatter) => {
                let within_voxel_m2 = f64::from(voxel_m).powi(2) / 12.0;
                let place = untruncated(scatter, SURFACE_VOXELS * voxel_m).as_dmat3();
                (place + DMat3::from_diagonal(DVec3::splat(within_voxel_m2))).inverse()
            }
            None => anywhere,
        };
        let own_m2 = (information + prior).inverse();
        let nearer = finding.nearer.as_dvec3() * f64::from(child_share).powi(-2);
        let off = (information + anywhere).inverse() * nearer;
        let of_poses_m2 = finding.of_poses.variance_m2();
        Self {
            covariance_m2: (own_m2 + of_thickness(off)).as_mat3() + of_poses_m2.to_mat3(),
            shared_m: (of_poses_m2.diagonal.element_sum() / 3.0).sqrt(),
            off: off.length() as f32,
        }
    }

    /// That there is surface within [`NEAR_M`] of it, by the odds that its observations give.
    fn probability(&self, own_odds: f32) -> f32 {
        let shared = self.shared_m.max(LEAST_SHARED_M) / NEAR_M;
        of_odds(own_odds - PER_SHARED * shared.ln() - PER_BEYOND * self.off.max(1.0).ln())
    }
}

/// Variance of a place from a body's thickness, square metres. Each observation hears the face towards it, half a thickness
/// nearer than the middle, and `off` is where the place goes, in half thicknesses from the middle. Observations from one side put
/// it on the face that they hear, one away. Observations from two sides, all from above, agree on a place further above than the
/// body reaches.
fn of_thickness(off: DVec3) -> DMat3 {
    let beyond = (off.length() - 1.0).max(0.0) * HALF_THICKNESS_M;
    let beyond_m = off.normalize_or_zero() * beyond;
    DMat3::from_cols(
        beyond_m * beyond_m.x,
        beyond_m * beyond_m.y,
        beyond_m * beyond_m.z,
    )
}

/// The scatter that a surface has across itself, of the scatter of what is seen of it within a ball of this radius. A
/// ball filled evenly scatters by r²/5 along any axis, which says nothing of the surface: of two Gaussian factors the
/// inverse variances add up.
fn untruncated(scatter: Mat3, radius_m: f32) -> Mat3 {
    let (axes, mut variances_m2) = eigen(scatter);
    let filled = 5.0 * variances_m2.x / radius_m.powi(2);
    let most_m2 = (REACH_M as f32).powi(2);
    variances_m2.x = match filled < 1.0 {
        true => (variances_m2.x / (1.0 - filled)).min(most_m2),
        false => most_m2,
    };
    axes * Mat3::from_diagonal(variances_m2) * axes.transpose()
}

/// Least own odds of what is asserted. Where voxels are wider than [`NEAR_M`] no place is known as near as that: as much is
/// asked there of surface within a voxel.
fn least_odds(voxel_m: f32) -> f32 {
    let least = (LEAST_PROBABILITY - BY_CHANCE) / (1.0 - LEAST_PROBABILITY);
    least.ln() - PER_SIGMA * (voxel_m / NEAR_M).max(1.0).ln()
}

/// Log odds over chance that there is surface within [`NEAR_M`], as far as a place's own observations say, with this variance
/// across the surface, square metres.
fn own_odds(statistics: &ViewStatistics, across_m2: f32) -> f32 {
    let explains = statistics.explained_ratio / statistics.observations;
    if explains.is_nan() {
        return f32::NEG_INFINITY;
    }
    // Rounding puts what explains all of its observations beside 1.
    let explains = explains.min(1.0);
    let told = (explains / (1.0 - explains)).ln();
    let across_m = across_m2.max(LEAST_M2).sqrt();
    EVEN_ODDS + PER_EXPLAINED_RATIO * told.clamp(LEAST_TOLD, MOST_TOLD)
        - PER_SIGMA * (across_m / NEAR_M).ln()
}

/// The probability of these log odds over chance.
fn of_odds(odds: f32) -> f32 {
    BY_CHANCE + (1.0 - BY_CHANCE) / (1.0 + (-odds).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accumulate::common_error::Faded;
    use crate::refine::expectation::Score;
    use echosplat_model::glam::Vec3;

    const VOXEL_M: f32 = 0.05;

    fn finding(information: Vec3, pose_m2: f32) -> Finding {
        let score = Score {
            information: SymmetricMat3::of(Mat3::from_diagonal(information)),
            ..Score::default()
        };
        let mut finding = Finding::default();
        let pose_m2 = SymmetricMat3::isotropic(pose_m2.sqrt());
        finding.add_observation(&score, pose_m2, 0.0, &mut Faded::default());
        finding
    }

    /// Of ranges along these directions, each as sure as one sigma says.
    fn finding_along(directions: &[Vec3], sigma_m: f32) -> Finding {
        let mut finding = Finding::default();
        for away in directions.iter().map(|away| away.normalize()) {
            let weight = sigma_m.powi(-2);
            let square = Mat3::from_cols(away * away.x, away * away.y, away * away.z) * weight;
            let score = Score {
                information: SymmetricMat3::of(square),
                nearer: -away * weight,
                ..Score::default()
            };
            let pose_m2 = SymmetricMat3::default();
            finding.add_observation(&score, pose_m2, 0.0, &mut Faded::default());
        }
        finding
    }

    #[test]
    fn what_is_heard_from_two_sides_and_from_above_alone_may_lie_above_the_body_that_it_is_of() {
        let upwards_m = |finding: &Finding| {
            let place = Place::of(finding, 1.0, None, VOXEL_M);
            place.covariance_m2.z_axis.z.sqrt()
        };
        let (left, right) = (Vec3::new(0.0, 1.0, -0.25), Vec3::new(0.0, -1.0, -0.25));
        let along = Vec3::X;
        let both = finding_along(&[left, right, along, -along], 1e-3);
        // From each side the face towards it is heard; they meet 4.1 half thicknesses above the middle.
        let above = 1.0_f32.hypot(0.25) / 0.25 - 1.0;
        let expected_m = above * HALF_THICKNESS_M as f32;
        assert!(
            (upwards_m(&both) / expected_m - 1.0).abs() < 0.02,
            "{}",
            upwards_m(&both)
        );
        // What is seen from above and below as well is not off, and a face seen from its own side is where it is.
        let (below_left, below_right) = (Vec3::new(0.0, 1.0, 0.25), Vec3::new(0.0, -1.0, 0.25));
        let around = finding_along(&[left, right, below_left, below_right, along, -along], 1e-3);
        assert!(upwards_m(&around) < 4e-3, "{}", upwards_m(&around));
        let high = Vec3::new(0.0, 1.0, -1.0);
        let face = finding_along(&[left, high, Vec3::new(0.3, 1.0, -0.6)], 1e-3);
        assert!(upwards_m(&face) < 0.2 * expected_m, "{}", upwards_m(&face));
    }

    #[test]
    fn however_many_observations_come_together_a_place_is_no_surer_than_their_poses() {
        let observations = |count: f32| {
            let finding = finding(Vec3::splat(1e4), 4e-4).times(count);
            Place::of(&finding, 1.0, None, VOXEL_M)
                .covariance_m2
                .x_axis
                .x
        };
        assert!(
            (observations(1.0) - 5e-4).abs() < 1e-6,
            "{}",
            observations(1.0)
        );
        assert!(
            (observations(1e6) - 4e-4).abs() < 1e-6,
            "{}",
            observations(1e6)
        );
    }

    #[test]
    fn the_surface_around_says_what_observations_leave_open() {
        let told = finding(Vec3::new(1e4, 1e4, 0.0), 0.0);
        let alone = Place::of(&told, 1.0, None, VOXEL_M).covariance_m2;
        assert!((alone.z_axis.z.sqrt() - REACH_M as f32).abs() < 0.1);
        let plane = Mat3::from_diagonal(Vec3::new(1e-3, 1e-3, 0.0));
        let on_a_plane = Place::of(&told, 1.0, Some(plane), VOXEL_M).covariance_m2;
        assert!((on_a_plane.z_axis.z.sqrt() - VOXEL_M / 12f32.sqrt()).abs() < 1e-4);
    }

    #[test]
    fn a_cloud_as_thick_as_the_ball_it_is_looked_at_in_says_nothing_across() {
        let radius_m = SURFACE_VOXELS * VOXEL_M;
        let cloud = |thickness_m2: f32| {
            let scatter = Mat3::from_diagonal(Vec3::new(1e-3, thickness_m2, 2e-3));
            untruncated(scatter, radius_m).y_axis.y.sqrt()
        };
        // Thin ones are as thin as they look, thicker ones thicker than they look.
        assert!((cloud(1e-6) - 1e-3).abs() < 1e-5);
        let half_filled = radius_m.powi(2) / 10.0;
        assert!((cloud(half_filled) - (2.0 * half_filled).sqrt()).abs() < 1e-4);
        let filled = Mat3::IDENTITY * (radius_m.powi(2) / 5.0);
        let across_m = untruncated(filled, radius_m).determinant() / filled.x_axis.x.powi(2);
        assert!(across_m > 90.0, "{across_m}");
    }

    #[test]
    fn nothing_told_is_nothing_known_and_finite() {
        let nothing = Place::of(&Finding::default(), 0.125, None, VOXEL_M);
        assert!((nothing.covariance_m2.x_axis.x.sqrt() - REACH_M as f32).abs() < 0.1);
        let certainty = Certainty::of(&nothing, &ViewStatistics::default(), VOXEL_M);
        assert!((certainty.probability - BY_CHANCE).abs() < 1e-6 && !certainty.is_likely);
    }

    #[test]
    fn what_single_precision_cannot_hold_is_nothing_known() {
        let mut gaussians = Gaussians::default();
        let slot = gaussians.spawn(Vec3::ZERO, (0, 0), 0.1, 1.0) as usize;
        let too_sharp = finding(Vec3::splat(f32::MAX), 1.0);
        tell(&mut gaussians, |_| Some(too_sharp), VOXEL_M);
        assert!(gaussians.sigma_m[slot].is_infinite() && !gaussians.is_likely[slot]);
        let covariance = gaussians.position_covariance_m2[slot];
        assert!(!covariance.diagonal.is_nan() && covariance.mixed == Vec3::ZERO);
    }

    /// Of what explains this share of ten observations.
    fn statistics(explains: f32) -> ViewStatistics {
        ViewStatistics {
            observations: 10.0,
            explained_ratio: 10.0 * explains,
            ..ViewStatistics::default()
        }
    }

    fn probability(explains: f32, across_m: f32, shared_m: f32, off: f32) -> f32 {
        let place = Place {
            covariance_m2: Mat3::IDENTITY,
            shared_m,
            off,
        };
        place.probability(own_odds(&statistics(explains), across_m * across_m))
    }

    #[test]
    fn the_more_a_place_explains_and_the_surer_it_and_its_poses_are_the_more_likely_is_surface() {
        let usual = probability(0.5, 0.05, 0.05, 1.0);
        assert!(usual > probability(0.4, 0.05, 0.05, 1.0));
        assert!(usual > probability(0.5, 0.06, 0.05, 1.0));
        assert!(usual > probability(0.5, 0.05, 0.06, 1.0));
        assert!(usual > probability(0.5, 0.05, 0.05, 1.1));
        // Heard from all around it is where it seems to be, as on a face heard from its own side.
        assert_eq!(usual.to_bits(), probability(0.5, 0.05, 0.05, 0.0).to_bits());
        assert!(probability(1.0, 0.03, 0.03, 1.0) > 0.95);
        assert!(probability(1.0, 0.0, 0.0, 0.0) <= 1.0);
        let (beyond, whole) = (1.000_001, 1.0);
        let [beyond, whole] =
            [beyond, whole].map(|explains| probability(explains, 0.03, 0.03, 1.0));
        assert_eq!(beyond.to_bits(), whole.to_bits());
        let hardly = probability(0.0, 1.0, 1.0, 1.0);
        assert!((BY_CHANCE..0.2).contains(&hardly), "{hardly}");
    }

    #[test]
    fn poses_without_any_error_tell_of_no_certainty_that_no_dive_had() {
        let [exact, best] = [0.0, LEAST_SHARED_M].map(|shared| probability(0.5, 0.1, shared, 1.0));
        assert_eq!(exact.to_bits(), best.to_bits());
        assert!(exact < 0.95, "{exact}");
    }

    #[test]
    fn where_voxels_are_wider_than_surface_is_looked_for_as_much_is_asked_of_places_as_much_wider()
    {
        let is_likely = |sigma_m: f32, voxel_m: f32| {
            own_odds(&statistics(0.7), sigma_m * sigma_m) >= least_odds(voxel_m)
        };
        assert_eq!(
            least_odds(0.5 * NEAR_M).to_bits(),
            least_odds(NEAR_M).to_bits()
        );
        let (surer_m, less_sure_m) = (0.12, 0.17);
        for wider in [1.0, 3.0, 10.0] {
            assert!(is_likely(wider * surer_m, wider * NEAR_M), "{wider}");
            assert!(!is_likely(wider * less_sure_m, wider * NEAR_M), "{wider}");
        }
    }
}
