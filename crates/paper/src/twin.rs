//! The plain twin of the paper's renderer: (14) to (30) and the exact gradient of (30), in loops.

use echosplat_model::glam::Vec3;

use crate::parameters::{GaussianArrays, PARAMETER_COUNT, opacity_of, opacity_slope};
use crate::real::Real;
use crate::rendering::{
    COVARIANCE_MAX, LEAST_AXIS_RATIO, LEAST_RANGE_M, LEAST_TRANSMITTANCE, PaperView,
    QUATERNION_LENGTHS, REACH_SIGMAS, REFLECTIVITY_MAX, Transmittance,
};

/// One Gaussian, or the gradient of one, in the order of [`crate::Parameters::to_array`].
pub type Row<R> = [R; PARAMETER_COUNT];

/// All Gaussians of `arrays` as rows of the twin.
#[must_use]
pub fn rows_of<R: Real>(arrays: &GaussianArrays) -> Vec<Row<R>> {
    let one = |index| arrays.get(index).to_array().map(R::of_f32);
    (0..arrays.len()).map(one).collect()
}

/// A matrix as its rows.
type Matrix<R> = [[R; 3]; 3];

/// What is rendered, and where it is cut.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'a> {
    /// The image's geometry.
    pub view: &'a PaperView,
    /// How Gaussians are shadowed.
    pub transmittance: Transmittance,
    /// Kernels are cut beyond this many sigmas.
    pub reach_sigmas: f64,
    /// Pixels are done below this transmittance.
    pub least_transmittance: f64,
}

impl<'a> Setting<'a> {
    /// With the cuts of the fast path.
    #[must_use]
    pub fn new(view: &'a PaperView, transmittance: Transmittance) -> Self {
        Self {
            view,
            transmittance,
            reach_sigmas: f64::from(REACH_SIGMAS),
            least_transmittance: f64::from(LEAST_TRANSMITTANCE),
        }
    }
}

/// A Gaussian on its way from world to pixels; matrices as rows, of (16) to (24).
#[derive(Debug, Clone, Copy)]
struct Projected<R> {
    index: usize,
    /// Mean in the sensor's frame: (15).
    q: [R; 3],
    range_m: R,
    /// `R S` of (10).
    scaled: Matrix<R>,
    scale_m: [R; 3],
    /// Rows r and θ of `D J` (19), (23) in world axes: pixels per metre.
    pixels_per_m: [[R; 3]; 2],
    /// `D J R S`: its product with its transpose is (24).
    half: [[R; 3]; 2],
    /// (21): range, azimuth.
    centre: [R; 2],
    /// (24): rr, rθ, θθ.
    covariance: [R; 3],
    /// Of (24), without cancellation: `|h_r × h_θ|² + λ (|h_r|² + |h_θ|²) + λ²`.
    determinant: R,
    opacity: R,
    reflectivity: R,
}

fn dot<R: Real>(a: [R; 3], b: [R; 3]) -> R {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// `row · matrix`.
fn times<R: Real>(row: [R; 3], matrix: &Matrix<R>) -> [R; 3] {
    [0, 1, 2].map(|k| row[0] * matrix[0][k] + row[1] * matrix[1][k] + row[2] * matrix[2][k])
}

fn transposed<R: Real>(m: &Matrix<R>) -> Matrix<R> {
    [0, 1, 2].map(|i| [m[0][i], m[1][i], m[2][i]])
}

/// Rows of the matrix whose columns are the sensor's axes in the world.
fn world_from_sensor<R: Real>(view: &PaperView) -> Matrix<R> {
    let row = |i: usize| {
        let row: Vec3 = view.axes.row(i);
        row.to_array().map(R::of_f32)
    };
    [row(0), row(1), row(2)]
}

fn length<R: Real>(quaternion: [R; 4]) -> R {
    let [x, y, z, w] = quaternion;
    (x * x + y * y + z * z + w * w).sqrt()
}

fn rotation_of<R: Real>([x, y, z, w]: [R; 4]) -> Matrix<R> {
    let (one, two) = (R::ONE, R::of(2.0));
    [
        [
            one - two * (y * y + z * z),
            two * (x * y - w * z),
            two * (x * z + w * y),
        ],
        [
            two * (x * y + w * z),
            one - two * (x * x + z * z),
            two * (y * z - w * x),
        ],
        [
            two * (x * z - w * y),
            two * (y * z + w * x),
            one - two * (x * x + y * y),
        ],
    ]
}

/// What a unit quaternion's rotation matrix passes on to it, before its length is held.
fn rotation_gradient<R: Real>([x, y, z, w]: [R; 4], g: &Matrix<R>) -> [R; 4] {
    let two = R::of(2.0);
    let (xy, xz, yz) = (g[0][1] + g[1][0], g[0][2] + g[2][0], g[1][2] + g[2][1]);
    let (wx, wy, wz) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    [
        two * (y * xy + z * xz + w * wx - two * x * (g[1][1] + g[2][2])),
        two * (x * xy + z * yz + w * wy - two * y * (g[0][0] + g[2][2])),
        two * (x * xz + y * yz + w * wz - two * z * (g[0][0] + g[1][1])),
        two * (x * wx + y * wy + z * wz),
    ]
}

/// (14) to (24) of one Gaussian; `None` where it is left out.
fn project<R: Real>(view: &PaperView, index: usize, row: &Row<R>) -> Option<Projected<R>> {
    let axes = world_from_sensor(view);
    let position = view.position_m.to_array().map(R::of_f32);
    let q = times([0, 1, 2].map(|i| row[i] - position[i]), &axes);
    let (axis_m2, range_m) = (q[0] * q[0] + q[1] * q[1], dot(q, q).sqrt());
    let far = range_m > R::of_f32(LEAST_RANGE_M);
    if !(far && axis_m2.sqrt() > R::of_f32(LEAST_AXIS_RATIO) * range_m) {
        return None;
    }
    let quaternion = [row[3], row[4], row[5], row[6]];
    let size = length(quaternion);
    let rotation = rotation_of(quaternion.map(|part| part / size));
    let scale_m = [row[7].exp(), row[8].exp(), row[9].exp()];
    let scaled = rotation.map(|r| [r[0] * scale_m[0], r[1] * scale_m[1], r[2] * scale_m[2]]);

    let steps = [
        R::of_f32(view.range_step_m),
        R::of_f32(view.azimuth_step_rad()),
    ];
    let jacobian = [
        q.map(|part| part / range_m / steps[0]),
        [
            -q[1] / axis_m2 / steps[1],
            q[0] / axis_m2 / steps[1],
            R::ZERO,
        ],
    ];
    let pixels_per_m = jacobian.map(|row| times(row, &transposed(&axes)));
    let half = pixels_per_m.map(|row| times(row, &scaled));
    let least = R::of_f32(view.least_pixel_variance);
    let covariance = [
        dot(half[0], half[0]) + least,
        dot(half[0], half[1]),
        dot(half[1], half[1]) + least,
    ];
    let across = cross(half[0], half[1]);
    let determinant =
        dot(across, across) + least * (dot(half[0], half[0]) + dot(half[1], half[1]) + least);
    let middle = R::of(0.5 * f64::from(view.beams - 1));
    let centre = [
        (range_m - R::of_f32(view.range_min_m)) / steps[0],
        q[1].atan2(q[0]) / steps[1] + middle,
    ];
    let (opacity, reflectivity) = (opacity_of(row[10]), row[11].exp());
    let [short, long] = QUATERNION_LENGTHS.map(R::of_f32);
    let sound = size > short
        && size < long
        && covariance[0] <= R::of_f32(COVARIANCE_MAX)
        && covariance[2] <= R::of_f32(COVARIANCE_MAX)
        && determinant > R::ZERO
        && determinant.is_finite()
        && row[10].is_finite()
        && reflectivity <= R::of_f32(REFLECTIVITY_MAX);
    sound.then_some(Projected {
        index,
        q,
        range_m,
        scaled,
        scale_m,
        pixels_per_m,
        half,
        centre,
        covariance,
        determinant,
        opacity,
        reflectivity,
    })
}

/// One pixel that a Gaussian covers.
#[derive(Debug, Clone, Copy)]
struct Covered<R> {
    pixel: usize,
    /// (25).
    f: R,
    /// `Σ⁻¹ (p − u)`: the slope of `ln f` to the centre.
    slope: [R; 2],
    /// (27), 0 where the pixel is done.
    transmittance: R,
}

/// One Gaussian with the pixels it covers.
struct Footprint<R> {
    gaussian: Projected<R>,
    pixels: Vec<Covered<R>>,
    /// (29).
    mean_transmittance: R,
}

/// Integers from `centre − reach` to `centre + reach` inside `0..count`.
fn span<R: Real>(centre: R, reach: R, count: u32) -> std::ops::Range<usize> {
    let end = R::of(f64::from(count));
    let low = (centre - reach).floor().max(R::ZERO).min(end);
    let high = ((centre + reach).floor() + R::ONE).max(R::ZERO).min(end);
    low.to_f64() as usize..high.to_f64() as usize
}

impl<R: Real> Footprint<R> {
    /// (25) by Cholesky, azimuth first: `|L⁻¹ d|² = d_θ²/Σ_θθ + (d_r − m d_θ)²/v`.
    fn new(setting: &Setting<'_>, gaussian: Projected<R>) -> Self {
        let view = setting.view;
        let [rr, rt, tt] = gaussian.covariance;
        let slope = rt / tt;
        let rest = gaussian.determinant / tt;
        let reach = R::of(setting.reach_sigmas);
        let mut pixels = Vec::new();
        for beam in span(gaussian.centre[1], reach * tt.sqrt(), view.beams) {
            for bin in span(gaussian.centre[0], reach * rr.sqrt(), view.range_bins) {
                let dt = R::of(beam as f64) - gaussian.centre[1];
                let x = R::of(bin as f64) - gaussian.centre[0] - slope * dt;
                let distance2 = dt * dt / tt + x * x / rest;
                if distance2 <= reach * reach {
                    let by_range = x / rest;
                    pixels.push(Covered {
                        pixel: beam * view.range_bins as usize + bin,
                        f: (R::of(-0.5) * distance2).exp(),
                        slope: [by_range, dt / tt - slope * by_range],
                        transmittance: R::ONE,
                    });
                }
            }
        }
        Self {
            gaussian,
            pixels,
            mean_transmittance: R::ONE,
        }
    }

    /// (26), (27): what earlier ones leave, and what is left behind this one, in logarithms.
    fn shadow(&mut self, logs: &mut [R], least: R) {
        let mut sum = R::ZERO;
        for covered in &mut self.pixels {
            let log = &mut logs[covered.pixel];
            let left = log.exp();
            covered.transmittance = if left < least { R::ZERO } else { left };
            *log += (-self.gaussian.opacity * covered.f).ln_1p();
            sum += covered.transmittance;
        }
        self.mean_transmittance = sum / R::of(self.pixels.len().max(1) as f64);
    }
}

/// The footprints in increasing order of range, ties in the order given.
fn footprints<R: Real>(setting: &Setting<'_>, gaussians: &[Row<R>]) -> Vec<Footprint<R>> {
    let project = |(index, row)| project(setting.view, index, row);
    let mut seen: Vec<_> = gaussians.iter().enumerate().filter_map(project).collect();
    seen.sort_by(|a, b| a.range_m.to_f64().total_cmp(&b.range_m.to_f64()));
    let mut logs = vec![R::ZERO; setting.view.pixel_count()];
    let mut footprints = Vec::with_capacity(seen.len());
    for gaussian in seen {
        let mut footprint = Footprint::new(setting, gaussian);
        if setting.transmittance != Transmittance::None {
            footprint.shadow(&mut logs, R::of(setting.least_transmittance));
        }
        footprints.push(footprint);
    }
    footprints
}

/// The image, shape `[beams][range_bins]`: (28) or (30). Empty if the view is not sound.
#[must_use]
pub fn forward<R: Real>(setting: &Setting<'_>, gaussians: &[Row<R>]) -> Vec<R> {
    if !setting.view.is_sound() {
        return Vec::new();
    }
    let mut image = vec![R::ZERO; setting.view.pixel_count()];
    for footprint in footprints(setting, gaussians) {
        let gaussian = footprint.gaussian;
        for covered in &footprint.pixels {
            let left = match setting.transmittance {
                Transmittance::None => R::ONE,
                Transmittance::Exact => covered.transmittance,
                Transmittance::Averaged => footprint.mean_transmittance,
            };
            image[covered.pixel] += left * gaussian.opacity * gaussian.reflectivity * covered.f;
        }
    }
    image
}

/// dL/d(parameters) of every Gaussian, given dL/d(image): exact within the cuts.
#[must_use]
pub fn backward<R: Real>(
    setting: &Setting<'_>,
    gaussians: &[Row<R>],
    d_image: &[R],
) -> Vec<Row<R>> {
    let mut gradients = vec![[R::ZERO; PARAMETER_COUNT]; gaussians.len()];
    if !setting.view.is_sound() {
        return gradients;
    }
    // What the image loses per unit of ln T of a pixel, of all Gaussians behind.
    let mut behind = vec![R::ZERO; setting.view.pixel_count()];
    for footprint in footprints(setting, gaussians).iter().rev() {
        let index = footprint.gaussian.index;
        let pixels = pixel_gradients(setting.transmittance, footprint, d_image, &mut behind);
        let chain = Chain::of(&footprint.gaussian, &gaussians[index], &pixels);
        gradients[index] = chain.row(setting.view);
    }
    gradients
}

/// What the pixels say of one Gaussian.
struct PixelGradient<R> {
    opacity: R,
    reflectivity_log: R,
    centre: [R; 2],
    /// To (24) as a full symmetric matrix: rr, rθ (each of the two), θθ.
    covariance: [R; 3],
}

fn pixel_gradients<R: Real>(
    kind: Transmittance,
    footprint: &Footprint<R>,
    d_image: &[R],
    behind: &mut [R],
) -> PixelGradient<R> {
    let Projected {
        opacity,
        reflectivity,
        ..
    } = footprint.gaussian;
    let mut sum = PixelGradient {
        opacity: R::ZERO,
        reflectivity_log: R::ZERO,
        centre: [R::ZERO; 2],
        covariance: [R::ZERO; 3],
    };
    let mut energy = R::ZERO;
    for covered in &footprint.pixels {
        energy += d_image[covered.pixel] * covered.f;
    }
    // dL/dT of each covered pixel, by (29).
    let mean_weight = opacity * reflectivity * energy / R::of(footprint.pixels.len().max(1) as f64);
    for covered in &footprint.pixels {
        let d = d_image[covered.pixel];
        let shadow = behind[covered.pixel] / (R::ONE - opacity * covered.f);
        // dL/d(α f) of (26), and this one's share of `behind`.
        let (slope, weight) = match kind {
            Transmittance::None => (d * reflectivity, R::ZERO),
            Transmittance::Exact => (
                d * covered.transmittance * reflectivity - shadow,
                d * opacity * covered.f * reflectivity,
            ),
            Transmittance::Averaged => (
                d * footprint.mean_transmittance * reflectivity - shadow,
                mean_weight,
            ),
        };
        let left = match kind {
            Transmittance::None => R::ONE,
            Transmittance::Exact => covered.transmittance,
            Transmittance::Averaged => footprint.mean_transmittance,
        };
        sum.reflectivity_log += d * left * opacity * reflectivity * covered.f;
        sum.opacity += slope * covered.f;
        let e = slope * opacity * covered.f;
        let [by_range, by_azimuth] = covered.slope;
        sum.centre[0] += e * by_range;
        sum.centre[1] += e * by_azimuth;
        // ∂ ln f/∂Σ = ½ (Σ⁻¹ d)(Σ⁻¹ d)ᵀ
        let half = R::of(0.5) * e;
        sum.covariance[0] += half * by_range * by_range;
        sum.covariance[1] += half * by_range * by_azimuth;
        sum.covariance[2] += half * by_azimuth * by_azimuth;
        behind[covered.pixel] += weight * covered.transmittance;
    }
    sum
}

/// (24) back to (10): the chain rule from pixels to parameters.
struct Chain<'a, R> {
    gaussian: &'a Projected<R>,
    row: &'a Row<R>,
    pixels: &'a PixelGradient<R>,
}

impl<'a, R: Real> Chain<'a, R> {
    fn of(gaussian: &'a Projected<R>, row: &'a Row<R>, pixels: &'a PixelGradient<R>) -> Self {
        Self {
            gaussian,
            row,
            pixels,
        }
    }

    fn row(&self, view: &PaperView) -> Row<R> {
        let g = self.gaussian;
        let two = R::of(2.0);
        let [rr, rt, tt] = self.pixels.covariance;
        // Σ = H Hᵀ: dL/dH = 2 (dL/dΣ) H.
        let d_half = [0, 1].map(|i| {
            let (a, b) = if i == 0 { (rr, rt) } else { (rt, tt) };
            [0, 1, 2].map(|k| two * (a * g.half[0][k] + b * g.half[1][k]))
        });
        // H = P (R S)
        let d_scaled = [0, 1, 2].map(|i| {
            [0, 1, 2]
                .map(|k| g.pixels_per_m[0][i] * d_half[0][k] + g.pixels_per_m[1][i] * d_half[1][k])
        });
        let d_log_scale = [0, 1, 2].map(|k| {
            let column = |m: &Matrix<R>| [m[0][k], m[1][k], m[2][k]];
            dot(column(&d_scaled), column(&g.scaled))
        });
        let d_pixels_per_m = d_half.map(|row| times(row, &transposed(&g.scaled)));
        let mean = self.mean(view, d_pixels_per_m);
        let rotation = self.rotation(&d_scaled);
        [
            mean[0],
            mean[1],
            mean[2],
            rotation[0],
            rotation[1],
            rotation[2],
            rotation[3],
            d_log_scale[0],
            d_log_scale[1],
            d_log_scale[2],
            self.pixels.opacity * opacity_slope(self.row[10]),
            self.pixels.reflectivity_log,
        ]
    }

    /// Through the centre (20) and through the Jacobian (19), which is taken where the mean is.
    fn mean(&self, view: &PaperView, d_pixels_per_m: [[R; 3]; 2]) -> [R; 3] {
        let axes = world_from_sensor(view);
        let [x, y, z] = self.gaussian.q;
        let range = self.gaussian.range_m;
        let axis_m2 = x * x + y * y;
        let step_r = R::of_f32(view.range_step_m);
        let step_t = R::of_f32(view.azimuth_step_rad());
        let [d_r, d_t] = d_pixels_per_m.map(|row| times(row, &axes));
        let [u_r, u_t] = self.pixels.centre;
        let along = [x / range, y / range, z / range];
        let slope = dot(along, d_r);
        let mut d =
            [0, 1, 2].map(|i| (u_r * along[i] + (d_r[i] - slope * along[i]) / range) / step_r);
        let axis_m4 = axis_m2 * axis_m2;
        let (skew, spread) = (R::of(2.0) * x * y, y * y - x * x);
        d[0] += (-u_t * y / axis_m2 + (d_t[0] * skew + d_t[1] * spread) / axis_m4) / step_t;
        d[1] += (u_t * x / axis_m2 + (d_t[0] * spread - d_t[1] * skew) / axis_m4) / step_t;
        times(d, &transposed(&axes))
    }

    fn rotation(&self, d_scaled: &Matrix<R>) -> [R; 4] {
        let scale = self.gaussian.scale_m;
        let d_rotation = d_scaled.map(|row| [0, 1, 2].map(|k| row[k] * scale[k]));
        let raw = [self.row[3], self.row[4], self.row[5], self.row[6]];
        let size = length(raw);
        let unit = raw.map(|part| part / size);
        let d = rotation_gradient(unit, &d_rotation);
        let along = unit[0] * d[0] + unit[1] * d[1] + unit[2] * d[2] + unit[3] * d[3];
        [0, 1, 2, 3].map(|i| (d[i] - along * unit[i]) / size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use echosplat_model::glam::{Mat3, Quat, Vec3};

    /// Five overlapping Gaussians before a sensor with few, large pixels.
    fn small_scene(noise: &mut Random) -> (PaperView, Vec<Row<f64>>) {
        let turn = Quat::from_euler(
            glam::EulerRot::XYZ,
            noise.between(-3.0, 3.0),
            noise.between(-1.0, 1.0),
            noise.between(-3.0, 3.0),
        );
        let view = PaperView {
            position_m: Vec3::new(noise.between(-9.0, 9.0), noise.between(-9.0, 9.0), 1.0),
            axes: Mat3::from_quat(turn),
            range_min_m: 1.5,
            range_step_m: 0.1,
            range_bins: 12,
            fov_rad: 0.4,
            beams: 6,
            least_pixel_variance: 0.3,
        };
        let rows = (0..5).map(|_| row(&view, noise)).collect();
        (view, rows)
    }

    fn row(view: &PaperView, noise: &mut Random) -> Row<f64> {
        let (range, azimuth, elevation) = (
            noise.between(1.5, 2.7),
            noise.between(-0.25, 0.25),
            noise.between(-0.9, 0.9),
        );
        let level = range * elevation.cos();
        let q = Vec3::new(
            level * azimuth.cos(),
            level * azimuth.sin(),
            range * elevation.sin(),
        );
        let mean = view.position_m + view.axes * q;
        let mut draw = |low: f32, high: f32| f64::from(noise.between(low, high));
        [
            f64::from(mean.x),
            f64::from(mean.y),
            f64::from(mean.z),
            draw(-1.0, 1.0),
            draw(-1.0, 1.0),
            draw(-1.0, 1.0),
            draw(0.2, 1.0),
            draw(-4.0, -1.3),
            draw(-4.0, -1.3),
            draw(-4.0, -1.3),
            draw(-3.0, 5.0),
            draw(-1.0, 1.0),
        ]
    }

    /// Whether no pixel lies at a cut, no pixel is nearly done, and the order is clear.
    fn away_from_cuts(setting: &Setting<'_>, rows: &[Row<f64>]) -> bool {
        let wider = |reach_sigmas| Setting {
            reach_sigmas,
            ..*setting
        };
        let count = |setting: &Setting<'_>| -> Vec<usize> {
            footprints(setting, rows)
                .iter()
                .map(|one| one.pixels.len())
                .collect()
        };
        let all = footprints(setting, rows);
        let clear = |pixel: &Covered<f64>| {
            let t = pixel.transmittance;
            t == 0.0 || !(0.5..2.0).contains(&(t / setting.least_transmittance))
        };
        let apart =
            |pair: &[Footprint<f64>]| pair[1].gaussian.range_m - pair[0].gaussian.range_m > 1e-3;
        count(&wider(setting.reach_sigmas * 0.999)) == count(&wider(setting.reach_sigmas * 1.001))
            && all.iter().all(|one| one.pixels.iter().all(clear))
            && all.windows(2).all(apart)
    }

    /// Largest error of any parameter, over that Gaussian's larger gradients.
    fn worst_error(setting: &Setting<'_>, rows: &[Row<f64>], d_image: &[f64]) -> f64 {
        let gradients = backward(setting, rows, d_image);
        let loss = |rows: &[Row<f64>]| -> f64 {
            let image = forward(setting, rows);
            image.iter().zip(d_image).map(|(i, d)| i * d).sum()
        };
        let mut worst = 0f64;
        for (i, gradient) in gradients.iter().enumerate() {
            let largest = gradient.iter().fold(0f64, |a, b| a.max(b.abs()));
            for k in 0..PARAMETER_COUNT {
                let at = |step: f64| {
                    let mut moved = rows.to_vec();
                    moved[i][k] += step;
                    loss(&moved)
                };
                // Fourth order, so that the step may be large against rounding.
                let h = 2e-5;
                let slope = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
                let scale = gradient[k].abs().max(1e-3 * largest).max(1e-9);
                worst = worst.max((slope - gradient[k]).abs() / scale);
            }
        }
        worst
    }

    #[test]
    fn gradients_agree_with_central_differences() {
        let mut noise = Random::new(7);
        for kind in [
            Transmittance::None,
            Transmittance::Exact,
            Transmittance::Averaged,
        ] {
            let (mut tried, mut worst) = (0, 0f64);
            while tried < 1000 {
                let (view, rows) = small_scene(&mut noise);
                let setting = Setting::new(&view, kind);
                if !away_from_cuts(&setting, &rows) {
                    continue;
                }
                let d_image: Vec<f64> = (0..72)
                    .map(|_| f64::from(noise.between(-1.0, 1.0)))
                    .collect();
                worst = worst.max(worst_error(&setting, &rows, &d_image));
                tried += 1;
            }
            println!("{kind:?}: {worst:e}");
            assert!(worst <= 1e-5, "{kind:?}: {worst:e}");
        }
    }

    #[test]
    fn a_gaussian_in_front_shadows_the_same_pixel_only() {
        let view = PaperView {
            position_m: Vec3::ZERO,
            axes: Mat3::IDENTITY,
            range_min_m: 1.0,
            range_step_m: 0.1,
            range_bins: 40,
            fov_rad: 0.5,
            beams: 5,
            least_pixel_variance: 0.0,
        };
        let at = |range: f64| {
            let logit = 0.25f64.ln() - 0.75f64.ln();
            [
                range, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, -2.3, -2.3, -2.3, logit, 0.0,
            ]
        };
        let rows = [at(3.0), at(3.0 + 1e-6), at(4.5)];
        for kind in [Transmittance::Exact, Transmittance::Averaged] {
            let image = forward(&Setting::new(&view, kind), &rows);
            let middle = 2 * 40;
            // Two at one place: ¼ + ¾·¼ by (28); alone: ¼.
            if kind == Transmittance::Exact {
                assert!(
                    (image[middle + 20] - 0.4375).abs() < 1e-5,
                    "{}",
                    image[middle + 20]
                );
            } else {
                assert!(image[middle + 20] > 0.4375 && image[middle + 20] < 0.5);
            }
            assert!((image[middle + 35] - 0.25).abs() < 1e-5);
        }
    }
}
