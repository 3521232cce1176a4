//! Confident Gaussians split in eight.

use echosplat_model::Standing;
use echosplat_model::glam::{Quat, Vec3};

use crate::spawn::gaussians::{Gaussians, Verdict};

/// Fraction, physics: a quarter solid angle.
/// Of a Gaussian's strength for each of its eight children: half as wide, each fills a quarter of
/// the solid angle, so eight of them at half the strength send back as much.
const CHILD_STRENGTH_FRACTION: f32 = 0.5;
/// Fraction, derived: 1/8.
/// A child's share of the Gaussian it was split from, and of what that knows of where the surface
/// is.
pub(crate) const CHILD_SHARE: f32 = 0.125;

/// Splits every whole confident Gaussian into the eight corners of its voxel.
pub(crate) fn split_confident(gaussians: &mut Gaussians, voxel_m: f32) {
    let is_whole =
        |slot: &usize| gaussians.is_worked_on(*slot) && gaussians.child_share[*slot] >= 1.0;
    let is_sure =
        |slot: &usize| gaussians.verdict[*slot] == Verdict::Published(Standing::Confident);
    let confident: Vec<usize> = gaussians.slots().filter(is_whole).filter(is_sure).collect();
    for slot in confident {
        split(gaussians, slot, 0.25 * voxel_m);
    }
}

fn split(gaussians: &mut Gaussians, slot: usize, quarter_m: f32) {
    let (home, mean_m) = (gaussians.home[slot], gaussians.mean_m[slot]);
    let mut strength = gaussians.strength[slot];
    let (known, kept) = (gaussians.known[slot], gaussians.kept[slot].clone());
    strength.scale(CHILD_STRENGTH_FRACTION);
    for corner in 0..8_u32 {
        let at_m = mean_m + corner_of(corner) * quarter_m;
        let child = match corner {
            0 => slot,
            _ => gaussians.spawn(at_m, home, quarter_m, 0.0) as usize,
        };
        gaussians.mean_m[child] = at_m;
        gaussians.home_m[child] = at_m;
        gaussians.set_shape(child, Quat::IDENTITY, Vec3::splat(quarter_m));
        gaussians.strength[child] = strength;
        gaussians.known[child] = known;
        gaussians.child_share[child] = CHILD_SHARE;
        gaussians.kept[child] = kept.clone();
        gaussians.verdict[child] = Verdict::Published(Standing::Confident);
    }
}

/// Corner 0 to 7 of the cube from −1 to 1.
fn corner_of(corner: u32) -> Vec3 {
    let side = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
    Vec3::new(side(0), side(1), side(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_measurement::{Beam, PingGeometry, PingPose, SymmetricMat3};
    use echosplat_model::glam::Mat3;

    #[test]
    fn eight_children_send_back_what_the_whole_did() {
        let geometry = PingGeometry {
            pose: PingPose {
                position_m: Vec3::ZERO,
                axes: Mat3::IDENTITY,
                drift_per_m: Vec3::ZERO,
                reference_range_m: 5.0,
            },
            range_start_m: 0.0,
            bin_length_m: 0.02,
            bin_count: 500,
            range_variance_m2: 1e-4,
            azimuth_variance_rad2: 0.0,
            beam: Beam::default(),
        };
        let energy = |mean_m: Vec3, sigma_m: f32| {
            let splat = geometry.project(mean_m, &SymmetricMat3::isotropic(sigma_m));
            splat.unwrap().energy
        };
        let middle_m = Vec3::new(6.0, 0.01, 0.5);
        let children: f32 = (0..8)
            .map(|corner| {
                CHILD_STRENGTH_FRACTION * energy(middle_m + corner_of(corner) * 0.0125, 0.0125)
            })
            .sum();
        let whole = energy(middle_m, 0.025);
        // Together they are a little narrower than the whole, so the beam takes in more of them.
        assert!(
            (children / whole - 1.0).abs() < 0.1,
            "{children} of {whole}"
        );
    }
}
