//! (33) to (41): the regulariser that wants the mass on each (azimuth, elevation) ray compact.
//!
//! Opacity does not occur in it: the score (35) holds a count of views and a measured intensity. So
//! the entropy (37) has a gradient only through `f_k`, read between the pixels of the measured
//! image, and the variance (39) through that and the range itself. With counts in the tens the
//! softmax (36) saturates and the entropy's gradient is close to zero; both are as printed.

use crate::parameters::{GaussianArrays, GradientArrays};
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
    range_m: f32,
    /// `n_k` of (35).
    views: f32,
    /// `f_k` of (35).
    value: f32,
    /// `∂f/∂r`, `∂f/∂θ`.
    slope: [f32; 2],
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
    /// In the order of the subset.
    places: Vec<Option<OnRay>>,
    /// Ray, bits of the range (positive, so in its order) and place of each.
    keys: Vec<(u64, u32, u32)>,
    /// Ray by ray, by increasing range.
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
        let places = subset.par_iter().with_min_len(1024).map(on_ray);
        places.collect_into_vec(&mut self.places);
        self.sort_along_rays();
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

    /// Sorts keys, which are a sixth of what they stand for.
    fn sort_along_rays(&mut self) {
        self.keys.clear();
        let placed = (0u32..).zip(&self.places);
        self.keys.extend(placed.filter_map(|(at, place)| {
            let place = place.as_ref()?;
            let (azimuth, elevation) = place.ray;
            let ray = (u64::from(azimuth as u32) << 32) | u64::from(elevation as u32);
            Some((ray, place.range_m.to_bits(), at))
        }));
        // No two are equal: any sort gives the same order.
        self.keys.par_sort_unstable();
        self.on_rays.clear();
        let sorted = self.keys.iter();
        self.on_rays
            .extend(sorted.filter_map(|(_, _, at)| self.places[*at as usize]));
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
            range_m,
            views: self.view_counts[index as usize] as f32,
            value,
            slope: [along / g.range_step_m, across / step_rad],
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

/// (35), (36): the mass of each Gaussian on its ray.
fn distribute(ray: &[OnRay], mass: &mut Vec<f64>) {
    let score = |k: &OnRay| f64::from(k.views) * f64::from(k.value);
    let highest = ray.iter().map(score).fold(f64::NEG_INFINITY, f64::max);
    mass.clear();
    mass.extend(ray.iter().map(|k| (score(k) - highest).exp()));
    let total: f64 = mass.iter().sum();
    mass.iter_mut().for_each(|p| *p /= total);
}

/// (35) to (40) of one ray; adds `share` times its gradient.
fn one_ray(
    ray: &[OnRay],
    mass: &mut Vec<f64>,
    choices: &Choices,
    share: f64,
    gradients: &mut GradientArrays,
) -> f64 {
    let epsilon = f64::from(choices.entropy_epsilon);
    let depth = f64::from(choices.depth_weight);
    distribute(ray, mass);
    let weighted = |of: &dyn Fn(&OnRay, f64) -> f64| -> f64 {
        let masses = ray.iter().zip(&*mass);
        masses.map(|(k, p)| p * of(k, *p)).sum()
    };
    let mean_m = weighted(&|k, _| f64::from(k.range_m));
    let from_mean_m = |k: &OnRay| f64::from(k.range_m) - mean_m;
    let entropy = weighted(&|_, p| -(p + epsilon).ln());
    let variance = weighted(&|k, _| from_mean_m(k).powi(2));

    // ∂L/∂p; what the variance loses through the mean range cancels.
    let by_mass =
        |k: &OnRay, p: f64| depth * from_mean_m(k).powi(2) - (p + epsilon).ln() - p / (p + epsilon);
    let middle = weighted(&by_mass);
    for (k, &p) in ray.iter().zip(&*mass) {
        let by_value = f64::from(k.views) * p * (by_mass(k, p) - middle);
        let [along, across] = k.slope.map(|slope| by_value * f64::from(slope));
        let by_range = along + depth * 2.0 * p * from_mean_m(k);
        let by_mean_m =
            k.range_axis * (share * by_range) as f32 + k.azimuth_axis * (share * across) as f32;
        for axis in 0..3 {
            gradients.mean_m[axis][k.index as usize] += by_mean_m[axis];
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
        let alone = gradients.get(5);
        assert!(alone.iter().all(|g| g.abs() < 1e-12), "{alone:?}");
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
