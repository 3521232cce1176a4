//! The slow, plain twins of the fast path, written from the formulas and from nothing else.

pub mod online;
mod vector;

use echosplat_model::glam::{DMat3, DVec3};

use crate::PingGeometry;

/// Φ(x) from the series of erf near zero and its continued fraction in the tails.
#[must_use]
pub fn normal_cdf(x: f64) -> f64 {
    let z = x / std::f64::consts::SQRT_2;
    0.5 * if z < 0.0 { erfc(-z) } else { 2.0 - erfc(z) }
}

/// Complementary error function of `z ≥ 0`.
fn erfc(z: f64) -> f64 {
    let scale = (-z * z).exp() / std::f64::consts::PI.sqrt();
    if z < 2.5 {
        // erf z = 2/√π e^{−z²} Σ 2ⁿ z^{2n+1} / (2n+1)!!
        let (mut term, mut sum) = (z, z);
        for n in 1..120 {
            term *= 2.0 * z * z / f64::from(2 * n + 1);
            sum += term;
        }
        return 1.0 - 2.0 * scale * sum;
    }
    // erfc z = e^{−z²}/√π · 1/(z + ½/(z + 1/(z + 3⁄2/(z + …))))
    let fraction = (1..80)
        .rev()
        .fold(z, |deeper, k| z + 0.5 * f64::from(k) / deeper);
    scale / fraction
}

/// Intensity per bin of one Gaussian with αρT = 1, shape `[bin_count]`: (16) to (19) in full,
/// the beam folded in, the bins integrated. Motion during the ping is left out.
#[must_use]
pub fn render(geometry: &PingGeometry, mean_m: DVec3, covariance_m2: DMat3) -> Vec<f64> {
    let axes = geometry.pose.axes.as_dmat3();
    let q = axes.transpose() * (mean_m - geometry.pose.position_m.as_dvec3());
    let sensor = axes.transpose() * covariance_m2 * axes;
    let rho2 = q.x * q.x + q.y * q.y;
    let (rho, range) = (rho2.sqrt(), q.length());
    let (azimuth, elevation) = (q.y.atan2(q.x), q.z.atan2(rho));
    // Rows of (19).
    let jacobian = DMat3::from_cols(
        DVec3::new(q.x / range, -q.y / rho2, -q.x * q.z / (range * range * rho)),
        DVec3::new(q.y / range, q.x / rho2, -q.y * q.z / (range * range * rho)),
        DVec3::new(q.z / range, 0.0, rho / (range * range)),
    );
    let s = jacobian * sensor * jacobian.transpose();
    let (rr, rt) = (s.x_axis.x, s.y_axis.x);
    let (tt, tp, pp) = (s.y_axis.y, s.z_axis.y, s.z_axis.z);

    let sigma_b = f64::from(geometry.beam.azimuth_sigma_rad());
    let total = sigma_b * sigma_b + tt + f64::from(geometry.azimuth_variance_rad2);
    let solid_angle = std::f64::consts::TAU * elevation.cos() * (tt * pp - tp * tp).max(0.0).sqrt();
    let half = f64::from(geometry.beam.elevation_half_width_rad());
    let fan = (-(elevation / half).powi(8)).exp2();
    let pattern = sigma_b / total.sqrt() * (-0.5 * azimuth * azimuth / total).exp();
    let on_axis = range - azimuth * rt / total;
    let deviation = (rr + f64::from(geometry.range_variance_m2) - rt * rt / total).sqrt();
    let edge = |bin: u32| {
        let range =
            f64::from(geometry.range_start_m) + f64::from(geometry.bin_length_m) * f64::from(bin);
        normal_cdf((range - on_axis) / deviation)
    };
    (0..geometry.bin_count)
        .map(|bin| solid_angle * fan * pattern * (edge(bin + 1) - edge(bin)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distribution_function_has_its_known_values() {
        for (x, expected) in [
            (0.0, 0.5),
            (1.0, 0.841_344_746_068_542_9),
            (-1.959_963_984_540_054, 0.025),
            (3.0, 0.998_650_101_968_369_9),
            (-6.0, 9.865_876_450_376_98e-10),
        ] {
            assert!((normal_cdf(x) - expected).abs() < 1e-14, "{x}");
        }
    }
}
