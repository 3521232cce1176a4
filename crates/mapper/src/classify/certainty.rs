//! How sure a Gaussian's place is: its own pings, the surface around it, and what its poses have in common.
//!
//! And how likely there is surface beside it at all.
//!
//! Pings whose poses are off alike agree, and what they agree on is off as well: however many come together, the place is no
//! surer than their poses. Those that come later are off otherwise.

use echosplat_acoustics::SymmetricMat3;
use echosplat_acoustics::packed::Row;
use echosplat_model::Standing;
use echosplat_model::glam::{DMat3, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use crate::accumulate::finding::{Account, Finding};
use crate::accumulate::history::PoseBlur;
use crate::refine::shape::{eigen, scatter_of};
use crate::spawn::gaussians::{BY_CHANCE, Gaussians, Verdict};
use crate::spawn::neighbours::Neighbours;

/// A place that nothing is known of is within a ping's range, of which this is a usual one, metres.
const REACH_M: f64 = 10.0;
/// A surface goes on within so many voxels.
const SURFACE_VOXELS: f32 = 1.5;

/// Half the thickness of what may be taken for one place while looks from two sides hear a face of it each: that of a pipe
/// of 8 cm.
pub(crate) const HALF_THICKNESS_M: f64 = 0.04;

/// Surface is looked for this near.
pub(crate) const NEAR_M: f32 = 0.10;
/// Log odds of a place that explains as much as its best rival on the arc, and whose sigma is `NEAR_M` along all axes; what
/// they grow by with the log odds against its rivals (at most `MOST_TOLD`, at least `LEAST_TOLD`), fall by with the logarithm
/// of sigma across the surface, and grow by with the logarithm of the widest sigma over that one. Found by logistic
/// regression; `docs/algorithm.md` has the dives and what they leave over.
const EVEN_ODDS: f32 = 0.6;
const PER_RIVALRY: f32 = 1.4;
const PER_SIGMA: f32 = 0.9;
const PER_FLATNESS: f32 = 0.5;
const LEAST_TOLD: f32 = -3.0;
const MOST_TOLD: f32 = 1.5;
/// Asserted is what has at least this probability: a place asserted in vain costs as much as four that are shown as ambiguous.
const LEAST_PROBABILITY: f32 = 0.80;
/// A variance is not taken for less, square metres: rounding may leave nothing of it, and a micrometre is surer than any place.
const LEAST_M2: f32 = 1e-12;

/// What an error of the sensor's pose makes of a place, square metres: of its position alike in all directions, of its
/// attitude across the line of sight.
pub(super) fn of_pose(row: &Row, error: PoseBlur) -> SymmetricMat3 {
    let (away, range_m) = (row.splat.range_axis, row.splat.range_m);
    let turned_m2 = error.azimuth_variance_rad2 * range_m * range_m;
    let across = Mat3::IDENTITY - Mat3::from_cols(away * away.x, away * away.y, away * away.z);
    SymmetricMat3::of(Mat3::IDENTITY * error.range_variance_m2 + across * turned_m2)
}

/// Sets covariance, sigma and probability of every Gaussian that there is a finding for.
pub(super) fn tell(
    gaussians: &mut Gaussians,
    finding_of: impl Fn(usize) -> Option<Finding> + Sync,
    voxel_m: f32,
) {
    let is_confident =
        |slot: usize| gaussians.verdict[slot] == Verdict::Published(Standing::Confident);
    let neighbours = Neighbours::new(gaussians, SURFACE_VOXELS * voxel_m, is_confident);
    let surfaces = neighbours.map(|_| true, |around| scatter_of(gaussians, around, |_| 1.0));
    let mut surface_of = vec![None; gaussians.slot_count()];
    for (slot, scatter) in surfaces {
        surface_of[slot] = Some(scatter);
    }
    let of_slot = |(slot, surface): (usize, Option<Mat3>)| {
        let finding = finding_of(slot).filter(|_| gaussians.alive[slot])?;
        let covariance_m2 = covariance_m2(&finding, gaussians.part[slot], surface, voxel_m);
        Some(Certainty::of(covariance_m2, &finding.account))
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
    }
}

/// What is told of one Gaussian.
struct Certainty {
    position_covariance_m2: SymmetricMat3,
    sigma_m: f32,
    probability: f32,
}

impl Certainty {
    fn of(covariance_m2: Mat3, account: &Account) -> Self {
        // Beyond single precision nothing is known; no number would take the Gaussian from the map.
        if !covariance_m2.is_finite() {
            return Self {
                position_covariance_m2: SymmetricMat3::isotropic(f32::INFINITY),
                sigma_m: f32::INFINITY,
                probability: BY_CHANCE,
            };
        }
        let (_, variances_m2) = eigen(covariance_m2);
        Self {
            position_covariance_m2: SymmetricMat3::of(covariance_m2),
            sigma_m: variances_m2.z.max(0.0).sqrt(),
            probability: probability(account, variances_m2),
        }
    }
}

/// `(H + P⁻¹)⁻¹ + T + C`: information `H` of its own pings, the place `P` that the surface around leaves it (the scatter of its
/// neighbours, and as much as a voxel is wide) or any within reach, what a thick body adds as `T`, and the error `C` of the
/// poses. What the parts of a split Gaussian know adds up.
fn covariance_m2(finding: &Finding, part: f32, surface: Option<Mat3>, voxel_m: f32) -> Mat3 {
    let information = finding.information.to_mat3().as_dmat3() * f64::from(part).powi(-2);
    let prior = match surface {
        Some(scatter) => {
            let within_voxel_m2 = f64::from(voxel_m).powi(2) / 12.0;
            let place = untruncated(scatter, SURFACE_VOXELS * voxel_m).as_dmat3();
            (place + DMat3::from_diagonal(DVec3::splat(within_voxel_m2))).inverse()
        }
        None => DMat3::from_diagonal(DVec3::splat(REACH_M.powi(-2))),
    };
    let own_m2 = (information + prior).inverse();
    let anywhere = DMat3::from_diagonal(DVec3::splat(REACH_M.powi(-2)));
    let nearer = finding.nearer.as_dvec3() * f64::from(part).powi(-2);
    let of_thickness_m2 = of_thickness((information + anywhere).inverse() * nearer);
    (own_m2 + of_thickness_m2).as_mat3() + finding.of_poses.variance_m2().to_mat3()
}

/// What a body's thickness makes of a place, square metres. Each look hears the face towards it, half a thickness nearer than the
/// middle, and `off` is where the place goes, in half thicknesses from the middle. Looks from one side put it on the face that they
/// hear, one away. Looks from two sides, all from above, agree on a place further above than the body reaches.
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

/// Least probability of what is asserted. Where voxels are wider than [`NEAR_M`] no place is known as near as that: as much is
/// asked there of surface within a voxel, for which a lower probability of surface within [`NEAR_M`] does.
pub(crate) fn least_probability(voxel_m: f32) -> f32 {
    let least = (LEAST_PROBABILITY - BY_CHANCE) / (1.0 - LEAST_PROBABILITY);
    let odds = least.ln() - PER_SIGMA * (voxel_m / NEAR_M).max(1.0).ln();
    of_odds(odds)
}

/// That there is surface within [`NEAR_M`] of a place with these variances along its axes, the least first, square metres.
fn probability(account: &Account, variances_m2: Vec3) -> f32 {
    let explains = account.rivalry / account.looks;
    if explains.is_nan() {
        return BY_CHANCE;
    }
    // Rounding puts what explains all of its looks beside 1.
    let explains = explains.min(1.0);
    let told = (explains / (1.0 - explains)).ln();
    let [across_m, _, open_m] = variances_m2.to_array().map(|m2| m2.max(LEAST_M2).sqrt());
    let odds = EVEN_ODDS + PER_RIVALRY * told.clamp(LEAST_TOLD, MOST_TOLD)
        - PER_SIGMA * (across_m / NEAR_M).ln()
        + PER_FLATNESS * (open_m / across_m).ln();
    of_odds(odds)
}

/// The probability of these log odds over chance.
fn of_odds(odds: f32) -> f32 {
    BY_CHANCE + (1.0 - BY_CHANCE) / (1.0 + (-odds).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refine::expectation::Pull;

    const VOXEL_M: f32 = 0.05;

    fn finding(information: Vec3, pose_m2: f32) -> Finding {
        let pull = Pull {
            information: SymmetricMat3::of(Mat3::from_diagonal(information)),
            ..Pull::default()
        };
        Finding::of_look(&pull, SymmetricMat3::isotropic(pose_m2.sqrt()), 0.0)
    }

    /// Of ranges along these directions, each as sure as one sigma says.
    fn finding_along(directions: &[Vec3], sigma_m: f32) -> Finding {
        let mut finding = Finding::default();
        for away in directions.iter().map(|away| away.normalize()) {
            let weight = sigma_m.powi(-2);
            let square = Mat3::from_cols(away * away.x, away * away.y, away * away.z) * weight;
            let pull = Pull {
                information: SymmetricMat3::of(square),
                nearer: -away * weight,
                ..Pull::default()
            };
            finding.add(&Finding::of_look(&pull, SymmetricMat3::default(), 0.0));
        }
        finding
    }

    #[test]
    fn what_is_heard_from_two_sides_and_from_above_alone_may_lie_above_the_body_that_it_is_of() {
        let upwards_m = |finding: &Finding| {
            let covariance = covariance_m2(finding, 1.0, None, VOXEL_M);
            covariance.z_axis.z.sqrt()
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
    fn however_many_looks_come_together_a_place_is_no_surer_than_their_poses() {
        let looks = |count: f32| {
            let finding = finding(Vec3::splat(1e4), 4e-4).times(count);
            covariance_m2(&finding, 1.0, None, VOXEL_M).x_axis.x
        };
        assert!((looks(1.0) - 5e-4).abs() < 1e-6, "{}", looks(1.0));
        assert!((looks(1e6) - 4e-4).abs() < 1e-6, "{}", looks(1e6));
    }

    #[test]
    fn the_surface_around_says_what_looks_leave_open() {
        let told = finding(Vec3::new(1e4, 1e4, 0.0), 0.0);
        let alone = covariance_m2(&told, 1.0, None, VOXEL_M);
        assert!((alone.z_axis.z.sqrt() - REACH_M as f32).abs() < 0.1);
        let plane = Mat3::from_diagonal(Vec3::new(1e-3, 1e-3, 0.0));
        let on_a_plane = covariance_m2(&told, 1.0, Some(plane), VOXEL_M);
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
        let nothing = covariance_m2(&Finding::default(), 0.125, None, VOXEL_M);
        assert!((nothing.x_axis.x.sqrt() - REACH_M as f32).abs() < 0.1);
        let probability = probability(&Account::default(), Vec3::splat(100.0));
        assert!((probability - BY_CHANCE).abs() < 1e-6);
    }

    #[test]
    fn what_single_precision_cannot_hold_is_nothing_known() {
        let mut gaussians = Gaussians::default();
        let slot = gaussians.spawn(Vec3::ZERO, (0, 0), 0.1, 1.0) as usize;
        let too_sharp = finding(Vec3::splat(f32::MAX), 1.0);
        tell(&mut gaussians, |_| Some(too_sharp), VOXEL_M);
        assert!(gaussians.sigma_m[slot].is_infinite());
        let covariance = gaussians.position_covariance_m2[slot];
        assert!(!covariance.diagonal.is_nan() && covariance.mixed == Vec3::ZERO);
    }

    #[test]
    fn the_more_a_place_explains_the_surer_and_the_flatter_it_is_the_likelier_is_surface() {
        let of = |rivalry: f32, across_m: f32, open_m: f32| {
            let account = Account {
                looks: 10.0,
                rivalry,
                ..Account::default()
            };
            let axes_m = Vec3::new(across_m, across_m, open_m);
            probability(&account, axes_m * axes_m)
        };
        let round = |rivalry, sigma_m| of(rivalry, sigma_m, sigma_m);
        assert!(round(9.0, 0.03) > round(5.0, 0.03) && round(5.0, 0.03) > round(5.0, 0.3));
        assert!(of(5.0, 0.03, 0.3) > round(5.0, 0.03) && of(5.0, 0.03, 0.3) > round(5.0, 0.3));
        assert!(round(10.0, 0.03) > 0.95 && round(10.0, 0.0) <= 1.0);
        let (beyond, whole) = (round(10.000_001, 0.03), round(10.0, 0.03));
        assert_eq!(beyond.to_bits(), whole.to_bits());
        assert!(round(0.0, 1.0) < 0.2 && round(0.0, 1.0) >= BY_CHANCE);
    }

    #[test]
    fn where_voxels_are_wider_than_surface_is_looked_for_as_much_is_asked_of_places_as_much_wider()
    {
        let round = |sigma_m: f32| {
            let account = Account {
                looks: 10.0,
                rivalry: 7.0,
                ..Account::default()
            };
            probability(&account, Vec3::splat(sigma_m * sigma_m))
        };
        let least_of_fine = least_probability(0.5 * NEAR_M);
        assert!((least_of_fine - LEAST_PROBABILITY).abs() < 1e-6);
        assert_eq!(least_of_fine.to_bits(), least_probability(NEAR_M).to_bits());
        let (surer_m, less_sure_m) = (0.15, 0.20);
        for wider in [1.0, 3.0, 10.0] {
            let least = least_probability(wider * NEAR_M);
            assert!(round(wider * surer_m) > least, "{wider}");
            assert!(round(wider * less_sure_m) < least, "{wider}");
        }
    }
}
