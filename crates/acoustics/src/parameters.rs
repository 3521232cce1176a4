//! Gaussians in free coordinates, as arrays of each number, and gradients in the same shape.

use echosplat_model::Gaussian;
use echosplat_model::glam::{Mat3, Quat, Vec3};

use crate::{Real, SymmetricMat3};

/// Numbers a Gaussian; layout.
/// Numbers per Gaussian: mean 3, rotation 4 (x y z w), log scale 3, opacity logit, log reflectivity.
pub const PARAMETER_COUNT: usize = 12;

/// Opacity, bound: below it `T/(1 − α)` stays accurate.
pub const OPACITY_MAX: f32 = 0.999;
/// Logit, bound: the slope has not vanished.
/// Logits are kept within plus and minus this, where their slope has not vanished: at 12 it is
/// 6·10⁻⁶, in f32 it is 0 from 16.6 on.
pub const OPACITY_LOGIT_LIMIT: f32 = 12.0;
/// Log metres, bound: 10 µm to 100 m.
/// Log scales: 10 µm to 100 m. Their fourth powers are normal f32 numbers, and what is as wide as a
/// sonar hears still has a slope to shrink by; from 1 km on it is lost in rounding.
pub const LOG_SCALE_LIMITS: [f32; 2] = [-11.512_925, 4.61];
/// Log ratio, bound: covariance condition 10¹².
/// Largest difference of log scales in one Gaussian: covariance condition 10¹².
pub const LOG_SCALE_SPREAD: f32 = 13.815_511;
/// Log power, bound: either way.
/// Log reflectivities are kept within plus and minus this.
pub const REFLECTIVITY_LOG_LIMIT: f32 = 60.0;

/// α of a logit: the logistic function, capped at [`OPACITY_MAX`].
#[must_use]
pub fn opacity_of<R: Real>(logit: R) -> R {
    logistic(logit).min(R::of_f32(OPACITY_MAX))
}

/// dα/d logit. The cap lets it through: what has grown beyond it must find back.
#[must_use]
pub fn opacity_slope<R: Real>(logit: R) -> R {
    let falls = (-logit.abs()).exp();
    let one_and = R::ONE + falls;
    falls / (one_and * one_and)
}

fn logistic<R: Real>(x: R) -> R {
    R::ONE / (R::ONE + (-x).exp())
}

/// One Gaussian in free coordinates: any finite number means something.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Centre relative to the map's origin, world axes.
    pub mean_m: Vec3,
    /// World from the Gaussian's own axes; of any length but zero.
    pub rotation: Quat,
    /// Natural logarithm of one sigma in metres along each of its own axes.
    pub log_scale: Vec3,
    /// Logit of the opacity.
    pub opacity_logit: f32,
    /// Natural logarithm of the reflectivity.
    pub reflectivity_log: f32,
}

impl Parameters {
    /// The free coordinates of a published Gaussian; opacity and reflectivity are first brought
    /// into the open intervals that have a logit and a logarithm.
    #[must_use]
    pub fn from_gaussian(gaussian: &Gaussian) -> Self {
        let opacity = gaussian.opacity.clamp(1e-5, OPACITY_MAX);
        Self {
            mean_m: gaussian.mean_m,
            rotation: gaussian.rotation,
            log_scale: gaussian.scale_m.map(f32::ln),
            opacity_logit: (opacity / (1.0 - opacity)).ln(),
            reflectivity_log: gaussian.reflectivity.max(1e-26).ln(),
        }
    }

    /// Fraction of the sound stopped at the centre, 0 to [`OPACITY_MAX`].
    #[must_use]
    pub fn opacity(&self) -> f32 {
        opacity_of(self.opacity_logit)
    }

    /// What of the stopped sound comes back, linear power.
    #[must_use]
    pub fn reflectivity(&self) -> f32 {
        self.reflectivity_log.exp()
    }

    /// (10): `Σ = R S² Rᵀ`, square metres, world axes.
    #[must_use]
    pub fn covariance_m2(&self) -> SymmetricMat3 {
        let unit = self.rotation * self.rotation.length_recip();
        let scaled = Mat3::from_quat(unit) * Mat3::from_diagonal(self.log_scale.map(f32::exp));
        SymmetricMat3::of(scaled * scaled.transpose())
    }

    /// In the order of the arrays.
    #[must_use]
    pub fn to_array(&self) -> [f32; PARAMETER_COUNT] {
        let (m, q, s) = (self.mean_m, self.rotation, self.log_scale);
        [
            m.x,
            m.y,
            m.z,
            q.x,
            q.y,
            q.z,
            q.w,
            s.x,
            s.y,
            s.z,
            self.opacity_logit,
            self.reflectivity_log,
        ]
    }

    /// From the order of the arrays.
    #[must_use]
    pub fn from_array(values: [f32; PARAMETER_COUNT]) -> Self {
        let [mx, my, mz, qx, qy, qz, qw, sx, sy, sz, logit, log] = values;
        Self {
            mean_m: Vec3::new(mx, my, mz),
            rotation: Quat::from_xyzw(qx, qy, qz, qw),
            log_scale: Vec3::new(sx, sy, sz),
            opacity_logit: logit,
            reflectivity_log: log,
        }
    }
}

/// Many Gaussians in free coordinates, one array for each number, shape `[n]` each; a Gaussian is
/// its position in them.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct GaussianArrays {
    /// Centres relative to the map's origin, world axes: x, y, z.
    pub mean_m: [Vec<f32>; 3],
    /// World from own axes: x, y, z, w.
    pub rotation: [Vec<f32>; 4],
    /// Logarithms of the sigmas along the own axes.
    pub log_scale: [Vec<f32>; 3],
    /// Logits of the opacities.
    pub opacity_logit: Vec<f32>,
    /// Logarithms of the reflectivities.
    pub reflectivity_log: Vec<f32>,
}

/// What [`GaussianArrays::clamp`] had to change, as counts, and what it cannot mend.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Clamped {
    /// Opacity logits beyond [`OPACITY_LOGIT_LIMIT`].
    pub opacity_logits: usize,
    /// Log scales outside [`LOG_SCALE_LIMITS`].
    pub log_scales: usize,
    /// Gaussians thicker now, since their condition was above 10¹².
    pub conditions: usize,
    /// Log reflectivities beyond [`REFLECTIVITY_LOG_LIMIT`].
    pub reflectivities: usize,
    /// Quaternions of no length, now the identity.
    pub rotations_reset: usize,
    /// Quaternions of another length than 1, now of length 1.
    pub rotations_renormalised: usize,
    /// Gaussians with a number that is not finite, ascending: to be removed.
    pub non_finite: Vec<u32>,
}

impl GaussianArrays {
    /// None.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// None, with room for `count`.
    #[must_use]
    pub fn with_capacity(count: usize) -> Self {
        let mut arrays = Self::default();
        for field in arrays.fields_mut() {
            field.reserve_exact(count);
        }
        arrays
    }

    /// The arrays of published Gaussians, in their order.
    #[must_use]
    pub fn from_gaussians(gaussians: &[Gaussian]) -> Self {
        let mut arrays = Self::with_capacity(gaussians.len());
        for gaussian in gaussians {
            arrays.push(Parameters::from_gaussian(gaussian));
        }
        arrays
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacity_logit.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The twelve arrays, in the order of [`Parameters::to_array`].
    #[must_use]
    pub fn fields(&self) -> [&[f32]; PARAMETER_COUNT] {
        let ([mx, my, mz], [qx, qy, qz, qw]) = (&self.mean_m, &self.rotation);
        let [sx, sy, sz] = &self.log_scale;
        let (logit, log) = (&self.opacity_logit, &self.reflectivity_log);
        [mx, my, mz, qx, qy, qz, qw, sx, sy, sz, logit, log]
    }

    /// The twelve arrays to change; all must stay of one length.
    pub fn fields_mut(&mut self) -> [&mut Vec<f32>; PARAMETER_COUNT] {
        let ([mx, my, mz], [qx, qy, qz, qw]) = (&mut self.mean_m, &mut self.rotation);
        let [sx, sy, sz] = &mut self.log_scale;
        let (logit, log) = (&mut self.opacity_logit, &mut self.reflectivity_log);
        [mx, my, mz, qx, qy, qz, qw, sx, sy, sz, logit, log]
    }

    /// Adds one at the end.
    pub fn push(&mut self, parameters: Parameters) {
        for (field, value) in self.fields_mut().into_iter().zip(parameters.to_array()) {
            field.push(value);
        }
    }

    /// Gaussian `index`, which must exist.
    #[must_use]
    pub fn get(&self, index: usize) -> Parameters {
        Parameters::from_array(self.fields().map(|field| field[index]))
    }

    /// Replaces Gaussian `index`, which must exist.
    pub fn set(&mut self, index: usize, parameters: Parameters) {
        for (field, value) in self.fields_mut().into_iter().zip(parameters.to_array()) {
            field[index] = value;
        }
    }

    /// Keeps those for which `mask` is true, in their order; beyond the mask's end none.
    pub fn retain(&mut self, mask: &[bool]) {
        for field in self.fields_mut() {
            let mut keep = mask.iter();
            field.retain(|_| keep.next().copied().unwrap_or(false));
        }
    }

    /// Whether all numbers of Gaussian `index` are finite; false where there is none.
    #[must_use]
    pub fn is_finite(&self, index: usize) -> bool {
        let finite = |field: &[f32]| field.get(index).is_some_and(|value| value.is_finite());
        self.fields().into_iter().all(finite)
    }

    /// Brings every finite Gaussian into the limits within which forward and backward are exact,
    /// and lists those with numbers that are not finite, which it leaves alone.
    pub fn clamp(&mut self) -> Clamped {
        let mut clamped = Clamped::default();
        for index in 0..self.len() {
            if self.is_finite(index) {
                self.clamp_one(index, &mut clamped);
            } else {
                clamped.non_finite.push(index as u32);
            }
        }
        clamped
    }

    fn clamp_one(&mut self, index: usize, clamped: &mut Clamped) {
        let logit = &mut self.opacity_logit[index];
        clamped.opacity_logits +=
            usize::from(limit(logit, -OPACITY_LOGIT_LIMIT, OPACITY_LOGIT_LIMIT));
        let log = &mut self.reflectivity_log[index];
        clamped.reflectivities +=
            usize::from(limit(log, -REFLECTIVITY_LOG_LIMIT, REFLECTIVITY_LOG_LIMIT));
        let [low, high] = LOG_SCALE_LIMITS;
        let mut widest = low;
        for field in &mut self.log_scale {
            clamped.log_scales += usize::from(limit(&mut field[index], low, high));
            widest = widest.max(field[index]);
        }
        let mut thickened = false;
        for field in &mut self.log_scale {
            thickened |= limit(&mut field[index], widest - LOG_SCALE_SPREAD, high);
        }
        clamped.conditions += usize::from(thickened);
        self.clamp_rotation(index, clamped);
    }

    fn clamp_rotation(&mut self, index: usize, clamped: &mut Clamped) {
        let [x, y, z, w] = [0, 1, 2, 3].map(|part| f64::from(self.rotation[part][index]));
        let length = (x * x + y * y + z * z + w * w).sqrt();
        let unit = if length > 1e-12 {
            if (length - 1.0).abs() < 1e-6 {
                return;
            }
            clamped.rotations_renormalised += 1;
            [x, y, z, w].map(|part| (part / length) as f32)
        } else {
            clamped.rotations_reset += 1;
            [0.0, 0.0, 0.0, 1.0]
        };
        for (field, part) in self.rotation.iter_mut().zip(unit) {
            field[index] = part;
        }
    }
}

/// Clamps, and says whether there was need.
fn limit(value: &mut f32, low: f32, high: f32) -> bool {
    let outside = *value < low || *value > high;
    *value = value.clamp(low, high);
    outside
}

/// Derivatives of one number by every parameter, in the arrays of [`GaussianArrays`]; the
/// rotation's are by the raw quaternion, through its normalisation.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct GradientArrays {
    /// By the centres.
    pub mean_m: [Vec<f32>; 3],
    /// By the raw quaternions: x, y, z, w.
    pub rotation: [Vec<f32>; 4],
    /// By the log scales.
    pub log_scale: [Vec<f32>; 3],
    /// By the opacity logits.
    pub opacity_logit: Vec<f32>,
    /// By the log reflectivities.
    pub reflectivity_log: Vec<f32>,
}

impl GradientArrays {
    /// `count` Gaussians' gradients, all 0.
    #[must_use]
    pub fn zeros(count: usize) -> Self {
        let zeros = || vec![0.0; count];
        Self {
            mean_m: [zeros(), zeros(), zeros()],
            rotation: [zeros(), zeros(), zeros(), zeros()],
            log_scale: [zeros(), zeros(), zeros()],
            opacity_logit: zeros(),
            reflectivity_log: zeros(),
        }
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacity_logit.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Back to 0.
    pub fn clear(&mut self) {
        for field in self.fields_mut() {
            field.fill(0.0);
        }
    }

    /// The twelve arrays, in the order of [`Parameters::to_array`].
    #[must_use]
    pub fn fields(&self) -> [&[f32]; PARAMETER_COUNT] {
        let ([mx, my, mz], [qx, qy, qz, qw]) = (&self.mean_m, &self.rotation);
        let [sx, sy, sz] = &self.log_scale;
        let (logit, log) = (&self.opacity_logit, &self.reflectivity_log);
        [mx, my, mz, qx, qy, qz, qw, sx, sy, sz, logit, log]
    }

    /// The twelve arrays to change.
    pub fn fields_mut(&mut self) -> [&mut [f32]; PARAMETER_COUNT] {
        let ([mx, my, mz], [qx, qy, qz, qw]) = (&mut self.mean_m, &mut self.rotation);
        let [sx, sy, sz] = &mut self.log_scale;
        let (logit, log) = (&mut self.opacity_logit, &mut self.reflectivity_log);
        [mx, my, mz, qx, qy, qz, qw, sx, sy, sz, logit, log]
    }

    /// Gradient of Gaussian `index`, which must exist.
    #[must_use]
    pub fn get(&self, index: usize) -> [f32; PARAMETER_COUNT] {
        self.fields().map(|field| field[index])
    }

    /// Adds to the gradient of Gaussian `index`, which must exist.
    pub fn add(&mut self, index: usize, gradient: [f32; PARAMETER_COUNT]) {
        for (field, value) in self.fields_mut().into_iter().zip(gradient) {
            field[index] += value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::Standing;

    fn plain() -> Parameters {
        Parameters {
            mean_m: Vec3::new(1.0, 2.0, 3.0),
            rotation: Quat::from_rotation_z(0.4),
            log_scale: Vec3::new(-3.0, -4.0, -5.0),
            opacity_logit: 0.5,
            reflectivity_log: -1.0,
        }
    }

    #[test]
    fn a_published_gaussian_is_the_same_in_free_coordinates() {
        let gaussian = Gaussian {
            id: 7,
            mean_m: Vec3::new(1.0, -2.0, 3.0),
            rotation: Quat::from_euler(glam::EulerRot::ZYX, 0.3, 0.2, 0.1),
            scale_m: Vec3::new(0.2, 0.1, 0.05),
            opacity: 0.8,
            reflectivity: 0.3,
            sigma_m: 0.1,
            position_covariance_m2: Gaussian::known_alike_m2(0.1),
            probability: 1.0,
            standing: Standing::Confident,
        };
        let parameters = Parameters::from_gaussian(&gaussian);
        assert!((parameters.opacity() - 0.8).abs() < 1e-6);
        assert!((parameters.reflectivity() - 0.3).abs() < 1e-6);
        let covariance = parameters.covariance_m2().to_mat3();
        assert!(covariance.abs_diff_eq(gaussian.covariance_m2(), 1e-7));
        let opaque = Gaussian {
            opacity: 1.0,
            reflectivity: 0.0,
            ..gaussian
        };
        let ends = GaussianArrays::from_gaussians(&[opaque]);
        assert!(ends.is_finite(0));
        assert!((ends.get(0).opacity() - OPACITY_MAX).abs() < 1e-6);
    }

    #[test]
    fn the_length_of_the_quaternion_does_not_matter() {
        let long = Parameters {
            rotation: plain().rotation * 7.0,
            ..plain()
        };
        let (a, b) = (
            long.covariance_m2().to_mat3(),
            plain().covariance_m2().to_mat3(),
        );
        assert!(a.abs_diff_eq(b, 1e-9));
    }

    #[test]
    fn what_is_set_is_got_and_what_is_dropped_is_gone() {
        let mut arrays = GaussianArrays::new();
        for i in 0..5 {
            arrays.push(Parameters {
                opacity_logit: i as f32,
                ..plain()
            });
        }
        arrays.set(4, plain());
        arrays.retain(&[true, false, true, false, true]);
        assert_eq!(arrays.opacity_logit, [0.0, 2.0, 0.5]);
        assert_eq!(arrays.get(2), plain());
        arrays.retain(&[true]);
        assert!(arrays.fields().iter().all(|field| field.len() == 1));
    }

    #[test]
    fn each_excess_is_brought_back_and_counted() {
        let mut arrays = GaussianArrays::new();
        arrays.push(plain());
        arrays.push(Parameters {
            opacity_logit: 40.0,
            ..plain()
        });
        arrays.push(Parameters {
            opacity_logit: -40.0,
            ..plain()
        });
        arrays.push(Parameters {
            log_scale: Vec3::splat(100.0),
            ..plain()
        });
        arrays.push(Parameters {
            log_scale: Vec3::new(2.0, -3.0, -11.9),
            ..plain()
        });
        arrays.push(Parameters {
            log_scale: Vec3::new(4.5, -3.0, -11.0),
            ..plain()
        });
        arrays.push(Parameters {
            rotation: Quat::from_xyzw(0.0, 0.0, 0.0, 0.0),
            ..plain()
        });
        arrays.push(Parameters {
            rotation: plain().rotation * 1e-6,
            ..plain()
        });
        arrays.push(Parameters {
            reflectivity_log: 1e9,
            ..plain()
        });
        for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            arrays.push(Parameters {
                mean_m: Vec3::splat(poison),
                ..plain()
            });
        }
        let clamped = arrays.clamp();
        let expected = Clamped {
            opacity_logits: 2,
            log_scales: 4,
            conditions: 1,
            reflectivities: 1,
            rotations_reset: 1,
            rotations_renormalised: 1,
            non_finite: vec![9, 10, 11],
        };
        assert_eq!(clamped, expected);
        assert_eq!(arrays.get(0), plain());
        assert!(arrays.get(7).rotation.abs_diff_eq(plain().rotation, 1e-6));
        let again = arrays.clamp();
        assert_eq!(
            again,
            Clamped {
                non_finite: vec![9, 10, 11],
                ..Clamped::default()
            }
        );
    }

    #[test]
    fn a_clamped_logit_has_a_slope_to_come_back_on() {
        for logit in [-OPACITY_LOGIT_LIMIT, OPACITY_LOGIT_LIMIT] {
            assert!(opacity_slope(logit) > 5e-6);
        }
        for i in -60..60 {
            let (x, h) = (f64::from(i) * 0.1, 1e-6);
            let slope = (opacity_of(x + h) - opacity_of(x - h)) / (2.0 * h);
            assert!((slope - opacity_slope(x)).abs() < 1e-9, "{x}");
        }
        assert!(opacity_of(f32::MAX) <= OPACITY_MAX && opacity_of(f32::MIN) >= 0.0);
    }

    #[test]
    fn gradients_add_up_and_clear() {
        let mut gradients = GradientArrays::zeros(3);
        gradients.add(1, [1.0; PARAMETER_COUNT]);
        gradients.add(1, [2.0; PARAMETER_COUNT]);
        assert_eq!(gradients.get(1).to_vec(), vec![3.0; PARAMETER_COUNT]);
        assert_eq!(gradients.get(0).to_vec(), vec![0.0; PARAMETER_COUNT]);
        gradients.clear();
        assert_eq!(gradients, GradientArrays::zeros(3));
    }
}
