//! Energy goes as solid angle, does not depend on where bins begin, and is hidden by what covers it.

use super::*;
use crate::{Beam, Parameters};
use echosplat_model::glam::{EulerRot, Mat3, Quat, Vec3};

/// No doubt about the pose and no drift: only what the Gaussian does.
fn still_geometry() -> PingGeometry {
    let mut geometry = sample::geometry();
    geometry.pose.drift_per_m = Vec3::ZERO;
    geometry.azimuth_variance_rad2 = 0.0;
    geometry.bin_count = 1_200;
    geometry
}

/// Nearly opaque and perfectly reflecting.
fn body(mean_m: Vec3, rotation: Quat, scale_m: Vec3) -> Parameters {
    Parameters {
        mean_m,
        rotation,
        log_scale: scale_m.map(f32::ln),
        opacity_logit: 6.0,
        reflectivity_log: 0.0,
    }
}

fn arrays(bodies: &[Parameters]) -> GaussianArrays {
    let mut gaussians = GaussianArrays::new();
    for &body in bodies {
        gaussians.push(body);
    }
    gaussians
}

fn total(geometry: &PingGeometry, bodies: &[Parameters]) -> f64 {
    let (intensity, _) = render(BARE, geometry, &arrays(bodies), &[]);
    intensity.iter().map(|&i| f64::from(i)).sum()
}

/// A sphere of 1 mm is small against the beam from 2 m on (sigma 12 mm), so the beam's fold is
/// below 1 %: `σ_b/√(σ_b² + (s/r)²)` is 0.997 at 2 m.
#[test]
fn a_spheres_energy_times_range_squared_is_constant() {
    let mut geometry = still_geometry();
    geometry.range_variance_m2 = 4e-4;
    let at = |range_m: f32| {
        let sphere = body(Vec3::X * range_m, Quat::IDENTITY, Vec3::splat(1e-3));
        total(&geometry, &[sphere]) * f64::from(range_m * range_m)
    };
    for tenths in 20..=200 {
        let ratio = at(0.1 * tenths as f32) / at(10.0);
        assert!((ratio - 1.0).abs() < 0.01, "{tenths} dm: {ratio}");
    }
}

/// A 4 cm sphere is wider than the beam near by: with the fold accounted for, the same.
#[test]
fn a_wide_spheres_energy_follows_the_folded_beam() {
    let geometry = still_geometry();
    let sigma_b = f64::from(geometry.beam.azimuth_sigma_rad());
    let at = |range_m: f32| {
        let sphere = body(Vec3::X * range_m, Quat::IDENTITY, Vec3::splat(0.04));
        let angle = 0.04 / f64::from(range_m);
        let fold = sigma_b / (sigma_b * sigma_b + angle * angle).sqrt();
        total(&geometry, &[sphere]) * f64::from(range_m * range_m) / fold
    };
    for tenths in 20..=200 {
        let ratio = at(0.1 * tenths as f32) / at(10.0);
        assert!((ratio - 1.0).abs() < 0.01, "{tenths} dm: {ratio}");
    }
}

/// A disc tilted by t about the beam's left axis shows `cos t` of its face and `sin t` of its edge.
#[test]
fn a_discs_energy_follows_its_solid_angle() {
    let mut geometry = still_geometry();
    // Wide enough that the disc's width does not fold.
    geometry.beam = Beam {
        azimuth_width_deg: 10.0,
        elevation_width_deg: 100.0,
    };
    let (wide, thin) = (0.05f32, 0.002f32);
    let at = |tilt: f32| {
        let disc = body(
            Vec3::X * 6.0,
            Quat::from_rotation_y(tilt),
            Vec3::new(thin, wide, wide),
        );
        total(&geometry, &[disc])
    };
    for degrees in (0..=90).step_by(5) {
        let tilt = (degrees as f32).to_radians();
        let height = (tilt.cos() * wide).hypot(tilt.sin() * thin);
        let expected = f64::from(height / wide);
        let ratio = at(tilt) / at(0.0);
        assert!(
            (ratio / expected - 1.0).abs() < 0.01,
            "{degrees}°: {ratio} for {expected}"
        );
    }
}

#[test]
fn a_shift_by_a_fraction_of_a_bin_keeps_the_energy() {
    for sigma_m in [0.003, 0.01, 0.05] {
        let ball = body(
            Vec3::new(5.0, 0.01, 0.3),
            Quat::IDENTITY,
            Vec3::splat(sigma_m),
        );
        let at = |fraction: f32| {
            let mut geometry = still_geometry();
            geometry.range_variance_m2 = 1e-6;
            geometry.range_start_m = geometry.bin_length_m * fraction;
            total(&geometry, &[ball])
        };
        for part in 1..20 {
            let ratio = at(0.05 * part as f32) / at(0.0);
            assert!((ratio - 1.0).abs() < 0.01, "{sigma_m} m, {part}: {ratio}");
        }
    }
}

/// Transmittance of `hidden` behind the others, in the kernels.
fn through(geometry: &PingGeometry, hidden: Parameters, before: &[Parameters]) -> f32 {
    let mut bodies = vec![hidden];
    bodies.extend_from_slice(before);
    let gaussians = arrays(&bodies);
    let mut renderer = OnlineRenderer::new(SHADOWING);
    renderer.forward(geometry, &gaussians, &all(&gaussians));
    assert_eq!(renderer.rows()[0].index, 0);
    renderer.rows()[0].transmittance
}

/// Columns of opacity along `y` and `z`, close enough to overlap: a wall or a rod of Gaussians.
fn grid(range_m: f32, half: [f32; 2], sigma_m: [f32; 2]) -> Vec<Parameters> {
    let steps = [0, 1].map(|k| (half[k] / sigma_m[k]).ceil() as i32);
    let mut bodies = Vec::new();
    for y in -steps[0]..=steps[0] {
        for z in -steps[1]..=steps[1] {
            let mean_m = Vec3::new(range_m, y as f32 * sigma_m[0], z as f32 * sigma_m[1]);
            let scale_m = Vec3::new(0.01, sigma_m[0], sigma_m[1]);
            bodies.push(body(mean_m, Quat::IDENTITY, scale_m));
        }
    }
    bodies
}

#[test]
fn a_plate_hides_what_is_behind_it() {
    let geometry = still_geometry();
    let plate = grid(4.0, [0.6, 2.2], [0.1, 0.1]);
    for (y, z, size) in [(0.0, 0.0, 0.05), (0.02, 1.0, 0.1), (0.0, -1.5, 0.3)] {
        let behind = body(Vec3::new(6.0, y, z), Quat::IDENTITY, Vec3::splat(size));
        let share = through(&geometry, behind, &plate);
        assert!(share < 1e-2, "{share} gets through to {z} m");
        let before = body(Vec3::new(3.0, y, z), Quat::IDENTITY, Vec3::splat(size));
        assert!(through(&geometry, before, &plate) > 0.999);
    }
}

/// A horizontal rod of 5 cm at 4 m subtends 0.72° of the fan. What is behind and spans ±s of it in
/// elevation keeps all but the rod's share of its own Gaussian profile, widened by half a cell.
#[test]
fn a_rod_hides_only_its_share() {
    let geometry = still_geometry();
    // A rod's profile over its diameter d has the sigma d/√12; its peak covers as much as it.
    let rod_sigma = 0.05 / 12f32.sqrt();
    let rod = [body(
        Vec3::new(4.0, 0.0, 0.0),
        Quat::IDENTITY,
        Vec3::new(rod_sigma, 2.0, rod_sigma),
    )];
    let cell = 0.25f32.to_radians();
    for size in [0.3f32, 0.6, 1.2] {
        let behind = body(
            Vec3::new(8.0, 0.0, 0.0),
            Quat::IDENTITY,
            Vec3::new(0.01, 2.0, size),
        );
        let share = through(&geometry, behind, &rod);
        // 1 − α ∫ f_rod f / ∫ f, both Gaussians in elevation with the cell's extent added.
        let rod_angle = (rod_sigma / 4.0).hypot(cell);
        let angle = (size / 8.0).hypot(cell);
        let peak = (rod_sigma / 4.0) / rod_angle;
        let hidden = peak * rod_angle / rod_angle.hypot(angle);
        let expected = 1.0 - hidden * rod[0].opacity();
        assert!(
            (share - expected).abs() < 0.01,
            "{size} m: {share} for {expected}"
        );
        assert!(share > 0.8, "{share}");
    }
}

#[test]
fn energy_is_the_same_from_every_side() {
    let geometry = still_geometry();
    let (target, scale) = (Vec3::new(6.0, 0.02, 0.5), Vec3::new(0.05, 0.03, 0.01));
    let one = body(
        target,
        Quat::from_euler(EulerRot::ZYX, 0.3, 0.2, 0.1),
        scale,
    );
    let expected = total(&geometry, &[one]);
    let mut dice = Dice::new(9);
    for _ in 0..20 {
        // World and sensor turned and moved together.
        let (turn, shift) = (dice.rotation(), Vec3::new(40.0, -30.0, 8.0));
        let mut moved = geometry;
        moved.pose.position_m = shift;
        moved.pose.axes = Mat3::from_quat(turn);
        let mut other = one;
        other.mean_m = turn * target + shift;
        other.rotation = turn * one.rotation;
        let ratio = total(&moved, &[other]) / expected;
        assert!((ratio - 1.0).abs() < 1e-3, "{ratio}");
    }
}
