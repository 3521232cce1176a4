//! Single precision as one would write it down first: (10), (18), (19) term by term, determinants
//! by their formula, opacities as a running product. Correct on paper, and in f32 on easy input.

use echosplat_acoustics::{GaussianArrays, Parameters, PingGeometry};
use echosplat_paper::rendering::PaperView;
use glam::{Mat3, Vec3};

use super::normal::normal_cdf;

/// Intensity per bin of one Gaussian, shape `[bin_count]`. Azimuth is taken as it comes.
pub(super) fn profile(geometry: &PingGeometry, gaussian: &Parameters) -> Vec<f32> {
    let to_mean = gaussian.mean_m - geometry.pose.position_m;
    let q = geometry.pose.axes.transpose() * to_mean;
    profile_at(geometry, gaussian, q, q.y.atan2(q.x))
}

/// The same with azimuth as the difference of two bearings in the world.
pub(super) fn profile_by_bearings(geometry: &PingGeometry, gaussian: &Parameters) -> Vec<f32> {
    let to_mean = gaussian.mean_m - geometry.pose.position_m;
    let q = geometry.pose.axes.transpose() * to_mean;
    let ahead = geometry.pose.axes.x_axis;
    let azimuth = to_mean.y.atan2(to_mean.x) - ahead.y.atan2(ahead.x);
    profile_at(geometry, gaussian, q, azimuth)
}

fn profile_at(geometry: &PingGeometry, gaussian: &Parameters, q: Vec3, azimuth: f32) -> Vec<f32> {
    let s = polar_covariance(geometry.pose.axes, gaussian, q);
    let (rr, rt, tt) = (s.x_axis.x, s.x_axis.y, s.y_axis.y);
    let (tp, pp) = (s.y_axis.z, s.z_axis.z);
    let (range_m, elevation) = (q.length(), q.z.atan2((q.x * q.x + q.y * q.y).sqrt()));
    let solid_angle = std::f32::consts::TAU * elevation.cos() * (tt * pp - tp * tp).sqrt();
    let sigma_b = geometry.beam.azimuth_sigma_rad();
    let total = sigma_b * sigma_b + tt + geometry.azimuth_variance_rad2;
    let pattern = sigma_b / total.sqrt() * (-0.5 * azimuth * azimuth / total).exp();
    let determinant = (rr + geometry.range_variance_m2) * total - rt * rt;
    let deviation = (determinant / total).sqrt();
    let on_axis = range_m - azimuth * rt / total;
    let strength = gaussian.reflectivity() / (1.0 + (-gaussian.opacity_logit).exp());
    let energy = strength * solid_angle * pattern * geometry.beam.elevation_weight(elevation);
    let edge = |bin: u32| {
        let range_m = geometry.range_start_m + geometry.bin_length_m * bin as f32;
        normal_cdf((range_m - on_axis) / deviation)
    };
    (0..geometry.bin_count)
        .map(|bin| energy * (edge(bin + 1) - edge(bin)))
        .collect()
}

/// `J A Σ Aᵀ Jᵀ` of range, azimuth and elevation.
fn polar_covariance(axes: Mat3, gaussian: &Parameters, q: Vec3) -> Mat3 {
    let unit = gaussian.rotation * (1.0 / gaussian.rotation.length());
    let scaled = Mat3::from_quat(unit) * Mat3::from_diagonal(gaussian.log_scale.map(f32::exp));
    let world = scaled * scaled.transpose();
    let sensor = axes.transpose() * world * axes;
    let rho2 = q.x * q.x + q.y * q.y;
    let (rho, range_m) = (rho2.sqrt(), q.length());
    let range2 = range_m * range_m;
    let jacobian = Mat3::from_cols(
        Vec3::new(q.x / range_m, -q.y / rho2, -q.x * q.z / (range2 * rho)),
        Vec3::new(q.y / range_m, q.x / rho2, -q.y * q.z / (range2 * rho)),
        Vec3::new(q.z / range_m, 0.0, rho / range2),
    );
    jacobian * sensor * jacobian.transpose()
}

/// What gets through to each of a row of Gaussians that cover a cell whole, by a running product.
pub(super) fn running_product(opacities: &[f32]) -> Vec<f32> {
    let mut through = 1.0_f32;
    let mut each = Vec::with_capacity(opacities.len());
    for opacity in opacities {
        each.push(through);
        through *= 1.0 - opacity;
    }
    each
}

/// σ(x) and its slope as σ(1 − σ).
pub(super) fn logistic_and_slope(logit: f32) -> (f32, f32) {
    let opacity = 1.0 / (1.0 + (-logit).exp());
    (opacity, opacity * (1.0 - opacity))
}

/// d/d(first opacity) of what is left of the sound behind all, by dividing the running product.
pub(super) fn slope_of_rest(opacities: &[f32]) -> f32 {
    let rest: f32 = opacities.iter().map(|opacity| 1.0 - opacity).product();
    -rest / (1.0 - opacities[0])
}

/// A log scale after plain descent on half the squared error of the energy `2π s²/r²` at 5 m, by
/// the chain rule through `s = exp(log s)`; −3 is right.
pub(super) fn descended_log_scale(start: f32, step: f32, steps: usize) -> f32 {
    let energy = |log_scale: f32| {
        let scale_m = log_scale.exp();
        std::f32::consts::TAU * scale_m * scale_m / 25.0
    };
    let goal = energy(-3.0);
    (0..steps).fold(start, |log_scale, _| {
        let here = energy(log_scale);
        log_scale - step * (here - goal) * 2.0 * here
    })
}

/// An image of the paper's renderer, shape `[beams][range bins]`: (17), (24) with a determinant, its
/// inverse by it, (25) at every pixel, (26) as a running product. In the order of the arrays.
pub(super) fn image(view: &PaperView, gaussians: &GaussianArrays, shadowed: bool) -> Vec<f32> {
    let mut sum = vec![0.0; view.pixel_count()];
    let mut through = vec![1.0_f32; sum.len()];
    for index in 0..gaussians.len() {
        let gaussian = gaussians.get(index);
        let (opacity, _) = logistic_and_slope(gaussian.opacity_logit);
        let strength = opacity * gaussian.reflectivity();
        for (pixel, covered) in kernel(view, &gaussian) {
            let left = if shadowed { through[pixel] } else { 1.0 };
            sum[pixel] += left * strength * covered;
            through[pixel] *= 1.0 - opacity * covered;
        }
    }
    sum
}

/// (25) at the pixels within 3.5 sigmas, or where that is no number.
fn kernel(view: &PaperView, gaussian: &Parameters) -> Vec<(usize, f32)> {
    let q = view.axes.transpose() * (gaussian.mean_m - view.position_m);
    let s = polar_covariance(view.axes, gaussian, q);
    let [bin_m, beam_rad] = [view.range_step_m, view.azimuth_step_rad()];
    let least = view.least_pixel_variance;
    let rr = s.x_axis.x / (bin_m * bin_m) + least;
    let rt = s.x_axis.y / (bin_m * beam_rad);
    let tt = s.y_axis.y / (beam_rad * beam_rad) + least;
    let determinant = rr * tt - rt * rt;
    let u_r = (q.length() - view.range_min_m) / bin_m;
    let u_t = q.y.atan2(q.x) / beam_rad + 0.5 * (view.beams - 1) as f32;
    let pixels = |centre: f32, sigma: f32, count: u32| {
        let low = (centre - 3.5 * sigma).clamp(0.0, count as f32) as usize;
        low..((centre + 3.5 * sigma + 1.0).clamp(0.0, count as f32) as usize)
    };
    let mut covered = Vec::new();
    for beam in pixels(u_t, tt.sqrt(), view.beams) {
        for bin in pixels(u_r, rr.sqrt(), view.range_bins) {
            let (dr, dt) = (bin as f32 - u_r, beam as f32 - u_t);
            let form = (tt * dr * dr - 2.0 * rt * dr * dt + rr * dt * dt) / determinant;
            if form > 3.5 * 3.5 {
                continue;
            }
            let f = (-0.5 * form).exp();
            covered.push((beam * view.range_bins as usize + bin, f));
        }
    }
    covered
}
