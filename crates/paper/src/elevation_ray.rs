//! (33) to (41): the regulariser that wants the mass on each (azimuth, elevation) ray compact.
//!
//! Opacity does not occur in it: the score (35) holds a count of views and a measured intensity. So
//! the entropy (37) has a gradient only through `f_k`, read between the pixels of the measured
//! image, and the variance (39) through that and the range itself. With counts in the tens the
//! softmax (36) saturates and the entropy's gradient is close to zero; both are as printed.

use echosplat_acoustics::{GaussianArrays, GradientArrays};
use glam::Vec3;
use rayon::prelude::*;

use crate::Choices;
use crate::images::Image;

/// One Gaussian on its ray.
#[derive(Debug, Clone, Copy)]
struct OnRay {
    /// `b_θ`, `b_φ` of (33), (34).
    ray: (i32, i32),
    index: u32,
    range_m: f64,
    /// `n_k` of (35).
    views: f64,
    /// `f_k` of (35).
    value: f64,
    /// `∂f/∂r`, `∂f/∂θ`.
    slope: [f64; 2],
    /// `∂r/∂μ`, `∂θ/∂μ`.
    range_axis: Vec3,
    azimuth_axis: Vec3,
}

/// One view's geometry and measured image, and how often Gaussians are seen: what places Gaussians on its rays.
#[derive(Clone, Copy)]
pub(crate) struct RayView<'a> {
    pub(crate) image: &'a Image,
    /// Views that each Gaussian is observed in.
    pub(crate) view_counts: &'a [u32],
    pub(crate) choices: &'a Choices,
}

/// Reused between views.
#[derive(Debug, Default)]
pub(crate) struct ElevationRays {
    on_rays: Vec<OnRay>,
    mass: Vec<f64>,
}

impl ElevationRays {
    /// `L_elev` (41) of the Gaussians in `subset` as seen from one view; adds `λ_elev` times its
    /// gradient with respect to their means.
    pub(crate) fn add(
        &mut self,
        view: RayView<'_>,
        gaussians: &GaussianArrays,
        subset: &[u32],
        gradients: &mut GradientArrays,
    ) -> f64 {
        let on_ray = |&index: &u32| {
            let mean_m = Vec3::from_array([0, 1, 2].map(|k| gaussians.mean_m[k][index as usize]));
            view.place(index, mean_m)
        };
        self.on_rays.clear();
        self.on_rays
            .par_extend(subset.par_iter().with_min_len(1024).filter_map(on_ray));
        // No two are equal: any sort gives the same order.
        self.on_rays.par_sort_unstable_by(|a, b| {
            let by_range = a.range_m.total_cmp(&b.range_m);
            a.ray.cmp(&b.ray).then(by_range).then(a.index.cmp(&b.index))
        });
        let of_one_ray = |ray: &&[OnRay]| ray.len() >= 2;
        let rays = || {
            self.on_rays
                .chunk_by(|a, b| a.ray == b.ray)
                .filter(of_one_ray)
        };
        let count = rays().count();
        if count == 0 {
            return 0.0;
        }
        let share = f64::from(view.choices.elevation_weight) / count as f64;
        let mut loss = 0.0;
        for ray in rays() {
            loss += one_ray(ray, &mut self.mass, view.choices, share, gradients);
        }
        loss / count as f64
    }
}

impl RayView<'_> {
    /// (17), (33), (34) and `f_k`; `None` behind the sensor or on its z axis.
    fn place(&self, index: u32, mean_m: Vec3) -> Option<OnRay> {
        let g = &self.image.geometry;
        let q = g.axes.transpose() * (mean_m - g.position_m);
        let level2 = q.x * q.x + q.y * q.y;
        let (level, range_m) = (level2.sqrt(), q.length());
        if !(q.x > 0.0 && level > 1e-3 * range_m) {
            return None;
        }
        let azimuth = q.y.atan2(q.x);
        let elevation = q.z.atan2(level);
        let step_rad = g.azimuth_step_rad();
        let column = (azimuth + 0.5 * g.fov_rad) / step_rad;
        let row = (range_m - g.range_min_m) / g.range_step_m;
        let (value, along, across) = between_pixels(self.image, row, column);
        let from_lowest = elevation + self.choices.elevation_half_width_rad;
        Some(OnRay {
            ray: (
                column.floor() as i32,
                (from_lowest / self.choices.elevation_bin_rad).floor() as i32,
            ),
            index,
            range_m: f64::from(range_m),
            views: f64::from(self.view_counts[index as usize]),
            value: f64::from(value),
            slope: [
                f64::from(along / g.range_step_m),
                f64::from(across / step_rad),
            ],
            range_axis: g.axes * (q / range_m),
            azimuth_axis: g.axes * (Vec3::new(-q.y, q.x, 0.0) / level2),
        })
    }
}

/// Measured intensity at a place between pixels, bilinear, and its slope along range and azimuth
/// per pixel; 0 outside the image.
fn between_pixels(image: &Image, row: f32, column: f32) -> (f32, f32, f32) {
    let (bins, beams) = (
        image.geometry.range_bins as i64,
        i64::from(image.geometry.beams),
    );
    let (bin, beam) = (row.floor() as i64, column.floor() as i64);
    let (s, t) = (row - row.floor(), column - column.floor());
    let at = |beam: i64, bin: i64| {
        let inside = (0..beams).contains(&beam) && (0..bins).contains(&bin);
        if inside {
            image.at(beam as usize, bin as usize)
        } else {
            0.0
        }
    };
    let [a, b] = [at(beam, bin), at(beam, bin + 1)];
    let [c, d] = [at(beam + 1, bin), at(beam + 1, bin + 1)];
    let (near, far) = (a + s * (b - a), c + s * (d - c));
    let along = (1.0 - t) * (b - a) + t * (d - c);
    (near + t * (far - near), along, far - near)
}

/// (35) to (40) of one ray; adds `share` times its gradient.
fn one_ray(
    ray: &[OnRay],
    mass: &mut Vec<f64>,
    choices: &Choices,
    share: f64,
    gradients: &mut GradientArrays,
) -> f64 {
    let (epsilon, depth) = (
        f64::from(choices.entropy_epsilon),
        f64::from(choices.depth_weight),
    );
    let score = |k: &OnRay| k.views * k.value;
    let highest = ray.iter().map(score).fold(f64::NEG_INFINITY, f64::max);
    mass.clear();
    mass.extend(ray.iter().map(|k| (score(k) - highest).exp()));
    let total: f64 = mass.iter().sum();
    mass.iter_mut().for_each(|p| *p /= total);

    let mean_m: f64 = ray.iter().zip(&*mass).map(|(k, p)| p * k.range_m).sum();
    let from_mean2 = |k: &OnRay| (k.range_m - mean_m).powi(2);
    let entropy: f64 = -mass.iter().map(|p| p * (p + epsilon).ln()).sum::<f64>();
    let variance: f64 = ray.iter().zip(&*mass).map(|(k, p)| p * from_mean2(k)).sum();

    // ∂L/∂p; what the variance loses through the mean range cancels.
    let by_mass =
        |k: &OnRay, p: f64| depth * from_mean2(k) - (p + epsilon).ln() - p / (p + epsilon);
    let middle: f64 = ray
        .iter()
        .zip(&*mass)
        .map(|(k, p)| p * by_mass(k, *p))
        .sum();
    for (k, &p) in ray.iter().zip(&*mass) {
        let by_value = k.views * p * (by_mass(k, p) - middle);
        let by_range = depth * 2.0 * p * (k.range_m - mean_m) + by_value * k.slope[0];
        let by_azimuth = by_value * k.slope[1];
        let by_mean =
            k.range_axis * (share * by_range) as f32 + k.azimuth_axis * (share * by_azimuth) as f32;
        for axis in 0..3 {
            gradients.mean_m[axis][k.index as usize] += by_mean[axis];
        }
    }
    entropy + depth * variance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    type Setting = (Image, GaussianArrays, Vec<u32>, Choices);

    fn setting() -> Setting {
        let image = sample::image(0, |_, _| false);
        let mut smooth = image.clone();
        let bins = image.geometry.range_bins as usize;
        for (at, value) in smooth.value.iter_mut().enumerate() {
            let (beam, bin) = ((at / bins) as f32, (at % bins) as f32);
            *value = 0.5 + 0.3 * (0.11 * bin).sin() + 0.15 * (0.4 * beam).cos();
        }
        // Three on one ray, two on another, one alone.
        let (mut gaussians, mut view_counts) = (GaussianArrays::new(), Vec::new());
        let g = image.geometry;
        for (azimuth, elevation, range_m, views) in [
            (0.02f32, 0.05f32, 4.013f32, 2),
            (0.0205, 0.052, 4.331, 3),
            (0.0215, 0.051, 4.727, 1),
            (-0.11, -0.2, 4.107, 3),
            (-0.111, -0.201, 4.257, 3),
            (0.2, 0.3, 4.5, 4),
        ] {
            let level = elevation.cos();
            let ray = Vec3::new(
                level * azimuth.cos(),
                level * azimuth.sin(),
                elevation.sin(),
            );
            let mut one = sample::gaussians(1).get(0);
            one.mean_m = g.position_m + g.axes * (ray * range_m);
            gaussians.push(one);
            view_counts.push(views);
        }
        let choices = Choices {
            elevation_weight: 1.0,
            depth_weight: 1.7,
            ..Choices::default()
        };
        (smooth, gaussians, view_counts, choices)
    }

    fn loss(setting: &Setting, gradients: &mut GradientArrays) -> f64 {
        let (image, gaussians, view_counts, choices) = setting;
        let view = RayView {
            image,
            view_counts,
            choices,
        };
        ElevationRays::default().add(view, gaussians, &[5, 4, 3, 2, 1, 0], gradients)
    }

    #[test]
    fn the_gradient_agrees_with_central_differences() {
        let setting = setting();
        let mut gradients = GradientArrays::zeros(6);
        loss(&setting, &mut gradients);
        for index in 0..6 {
            for axis in 0..3 {
                let at = |step: f32| {
                    let mut moved = setting.clone();
                    moved.1.mean_m[axis][index] += step;
                    loss(&moved, &mut GradientArrays::zeros(6))
                };
                let expected = (at(1e-3) - at(-1e-3)) / 2e-3;
                let found = f64::from(gradients.mean_m[axis][index]);
                assert!(
                    (found - expected).abs() < 0.02 * (0.02 + expected.abs()),
                    "{index} {axis}: {found} {expected}"
                );
            }
        }
        assert_eq!(gradients.get(5), [0.0; 12], "alone on its ray");
    }

    #[test]
    fn one_place_on_a_ray_costs_less_than_two_apart() {
        let mut apart = setting();
        let far = loss(&apart, &mut GradientArrays::zeros(6));
        for axis in 0..3 {
            let first = apart.1.mean_m[axis][0];
            apart.1.mean_m[axis][1] = first;
            apart.1.mean_m[axis][2] = first;
        }
        assert!(loss(&apart, &mut GradientArrays::zeros(6)) < far);
    }
}
