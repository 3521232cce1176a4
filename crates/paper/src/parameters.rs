//! Gaussians in free coordinates, as arrays of each number, and gradients in the same shape.

use echosplat_model::glam::{Quat, Vec3};

use crate::real::Real;

/// Numbers a Gaussian; layout.
/// Numbers per Gaussian: mean 3, rotation 4 (x y z w), log scale 3, opacity logit, log reflectivity.
pub const PARAMETER_COUNT: usize = 12;

/// Opacity, bound: below it `T/(1 − α)` stays accurate.
pub const OPACITY_MAX: f32 = 0.999;
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
    fn the_opacitys_slope_is_its_derivative() {
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
