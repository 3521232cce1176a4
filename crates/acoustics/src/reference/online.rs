//! The measurement of one ping and its exact gradient, in plain loops: what the kernels of
//! [`crate::online`] are held to.
//!
//! Everything is written over [`Real`]: in f64 it is the truth, in f32 what plain code makes of it.
//! Parameters are `[R; 12]` per Gaussian, in the order of [`crate::Parameters::to_array`].

use std::ops::Range;

use super::vector::{self, cross, dot, scaled, sum};
use crate::online::constants::{
    BEAM_REACH_SIGMAS, LEAST_AREA2_M4, LEAST_FAN, LEAST_OVERLAP, LEAST_VARIANCE_M2, NEAREST_M,
    RANGE_REACH_SIGMAS, RASTER_REACH_SIGMAS, SIDEWAYS,
};
use crate::online::raster::{self, Raster};
use crate::parameters::{GaussianArrays, OPACITY_MAX, PARAMETER_COUNT, opacity_of, opacity_slope};
use crate::{PingGeometry, Real};

/// Gradient or value of one Gaussian's parameters.
pub type Numbers<R> = [R; PARAMETER_COUNT];

/// Where small contributions are cut. Differences across a cut are no derivatives, so tests of
/// gradients set them out of the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cutoffs {
    /// Bins this many sigmas in range from the mean are left out.
    pub range_sigmas: f64,
    /// Raster cells this many sigmas from the mean are left out.
    pub raster_sigmas: f64,
    /// Transmittance below this counts as 0.
    pub least_transmittance: f64,
}

impl Default for Cutoffs {
    /// Those of the kernels.
    fn default() -> Self {
        Self {
            range_sigmas: f64::from(RANGE_REACH_SIGMAS),
            raster_sigmas: f64::from(RASTER_REACH_SIGMAS),
            least_transmittance: f64::from(crate::online::constants::LEAST_TRANSMITTANCE),
        }
    }
}

/// All Gaussians of `arrays` as numbers of the twin.
#[must_use]
pub fn numbers_of<R: Real>(arrays: &GaussianArrays) -> Vec<Numbers<R>> {
    let one = |index| arrays.get(index).to_array().map(R::of_f32);
    (0..arrays.len()).map(one).collect()
}

/// What one ping measures, and everything its gradient needs.
#[derive(Debug, Clone)]
pub struct Rendering<R> {
    /// Intensity per bin without noise, shape `[bin_count]`.
    pub intensity: Vec<R>,
    /// Gaussians that the ping sees, in ascending order of index.
    pub rows: Vec<MatrixRow<R>>,
    /// Rows from near to far; empty without occlusion.
    order: Vec<usize>,
    cutoffs: Cutoffs,
}

impl<R> Rendering<R> {
    /// Gaussian–bin pairs.
    #[must_use]
    pub fn pair_count(&self) -> u64 {
        self.rows.iter().map(|row| row.bins.len() as u64).sum()
    }
}

/// One Gaussian in one ping.
#[derive(Debug, Clone)]
pub struct MatrixRow<R> {
    /// Which Gaussian.
    pub index: u32,
    /// Bins it reaches.
    pub bins: Range<usize>,
    /// Share of the sound that gets through to it.
    pub transmittance: R,
    /// Energy over all bins for αρT = 1.
    pub energy: R,
    /// Mean range on the beam's axis, r′.
    pub range_on_axis_m: R,
    /// Variance in range, s².
    pub range_variance_m2: R,
    sight: Sight<R>,
    /// Covered cells with what gets through to each; empty without occlusion.
    cells: Vec<Cell<R>>,
    overlap: R,
}

#[derive(Debug, Clone, Copy)]
struct Cell<R> {
    number: usize,
    /// Share of the cell that the Gaussian covers, f.
    covered: R,
    /// Whitened distance of the cell from the Gaussian.
    y: [R; 2],
    /// Share of the sound that gets through to the Gaussian in this cell.
    transmittance: R,
}

/// A Gaussian in the beam's frame: (16) to (19) and the closed forms of the measurement.
#[derive(Debug, Clone, Copy)]
struct Sight<R> {
    /// Mean before what the sensor drifts, and after.
    still: [R; 3],
    mean: [R; 3],
    lever_m: R,
    range_m: R,
    azimuth: R,
    elevation: R,
    /// Unit quaternion and length of the raw one.
    unit: [R; 4],
    length: R,
    /// Unit vectors of growing range, azimuth and elevation along the Gaussian's own axes.
    along: [R; 3],
    across: [R; 3],
    up: [R; 3],
    /// Variances along the own axes, and products of two of them (the third left out).
    scale2: [R; 3],
    area2: [R; 3],
    /// Range, azimuth (in metres) and elevation (in metres) against one another.
    rr: R,
    rt: R,
    tt: R,
    tp: R,
    pp: R,
    /// Square of the cross-section seen from the sensor, over (2π)²; and from above.
    section2: R,
    side2: R,
    /// Variance across, in metres: of beam and attitude, and with the Gaussian's own.
    beam2: R,
    total2: R,
}

/// A ping's geometry in the twin's numbers. Its axes are made orthogonal to the twin's precision:
/// that is the rotation which the geometry's f32 axes mean.
struct View<'a, R> {
    geometry: &'a PingGeometry,
    axes: [[R; 3]; 3],
    position_m: [R; 3],
    drift_per_m: [R; 3],
    reference_range_m: R,
    sigma_b: R,
    /// Variance in azimuth of beam and attitude.
    beam_variance: R,
    range_start_m: R,
    bin_length_m: R,
    /// What a raster cell's extent adds to a covariance, C.
    cell_variance_rad2: [R; 2],
}

impl<'a, R: Real> View<'a, R> {
    fn new(geometry: &'a PingGeometry) -> Self {
        let column = |k| geometry.pose.axes.col(k).to_array().map(R::of_f32);
        let along = vector::unit(column(0));
        let up = vector::unit(cross(along, column(1)));
        let sigma_b = R::of_f32(geometry.beam.azimuth_sigma_rad());
        Self {
            geometry,
            axes: [along, cross(up, along), up],
            position_m: geometry.pose.position_m.to_array().map(R::of_f32),
            drift_per_m: geometry.pose.drift_per_m.to_array().map(R::of_f32),
            reference_range_m: R::of_f32(geometry.pose.reference_range_m),
            sigma_b,
            beam_variance: sigma_b * sigma_b + R::of_f32(geometry.azimuth_variance_rad2),
            range_start_m: R::of_f32(geometry.range_start_m),
            bin_length_m: R::of_f32(geometry.bin_length_m),
            cell_variance_rad2: raster::cell_rad(geometry).map(|size| R::of(0.25 * size * size)),
        }
    }

    /// `ln g(φ)` of the fan and its slope.
    fn fan(&self, elevation: R) -> (R, R) {
        let half = R::of_f32(self.geometry.beam.elevation_half_width_rad());
        let x = elevation / half;
        let x2 = x * x;
        let x7 = x2 * x2 * x2 * x;
        let ln2 = R::of(std::f64::consts::LN_2);
        (-ln2 * x7 * x, -ln2 * R::of(8.0) * x7 / half)
    }

    /// `Rᵀ(μ − t)`.
    fn in_beam_frame(&self, mean_m: [R; 3]) -> [R; 3] {
        let from_sensor = [0, 1, 2].map(|k| mean_m[k] - self.position_m[k]);
        self.axes.map(|axis| dot(axis, from_sensor))
    }

    /// `R v`.
    fn in_world_frame(&self, v: [R; 3]) -> [R; 3] {
        let [x, y, z] = self.axes;
        [0, 1, 2].map(|k| x[k] * v[0] + y[k] * v[1] + z[k] * v[2])
    }

    /// Moved by what the sensor drifts until the echo: as [`PingGeometry::in_beam`].
    fn drifted(&self, still: [R; 3]) -> [R; 3] {
        let late = vector::length(still) - self.reference_range_m;
        let [left, up, along] = self.drift_per_m;
        let [x, y, z] = still;
        [x, y - late * (left + up * x - along * z), z]
    }

    /// `Dᵀg` with D the derivative of the drifted mean by the still one.
    fn drift_back(&self, still: [R; 3], by_moved: [R; 3]) -> [R; 3] {
        let [left, up, along] = self.drift_per_m;
        let distance = vector::length(still);
        let late = distance - self.reference_range_m;
        let rate = (left + up * still[0] - along * still[2]) / distance;
        let turn = [up, R::ZERO, -along];
        [0, 1, 2].map(|k| by_moved[k] - by_moved[1] * (rate * still[k] + late * turn[k]))
    }
}

impl<R: Real> Sight<R> {
    fn new(view: &View<R>, gaussian: &Numbers<R>) -> Option<Self> {
        let [mx, my, mz, qx, qy, qz, qw, sx, sy, sz, ..] = *gaussian;
        let still = view.in_beam_frame([mx, my, mz]);
        let mean = view.drifted(still);
        let lever_m = (mean[0] * mean[0] + mean[1] * mean[1]).sqrt();
        let range_m = vector::length(mean);
        let ahead = range_m > R::of_f32(NEAREST_M) && mean[0] > R::of_f32(SIDEWAYS) * range_m;
        let length = (qx * qx + qy * qy + qz * qz + qw * qw).sqrt();
        if !(ahead && length > R::ZERO) {
            return None;
        }
        let unit = [qx, qy, qz, qw].map(|part| part / length);
        let own = |direction| vector::rotated_back(unit, view.in_world_frame(direction));
        let (x, y, z) = (mean[0], mean[1], mean[2]);
        let along = own(mean.map(|part| part / range_m));
        let across = own([-y / lever_m, x / lever_m, R::ZERO]);
        let up = [-x * z, -y * z, lever_m * lever_m].map(|part| part / (range_m * lever_m));
        let up = own(up);
        let scale2 = [sx, sy, sz].map(|log| (log + log).exp());
        let [s0, s1, s2] = scale2;
        let area2 = [s1 * s2, s2 * s0, s0 * s1];
        let moment = |a: [R; 3], b: [R; 3]| dot(scaled(scale2, a), b);
        let beam2 = lever_m * lever_m * view.beam_variance;
        let tt = moment(across, across);
        let sight = Self {
            still,
            mean,
            lever_m,
            range_m,
            azimuth: y.atan2(x),
            elevation: z.atan2(lever_m),
            unit,
            length,
            along,
            across,
            up,
            scale2,
            area2,
            rr: moment(along, along),
            rt: moment(along, across),
            tt,
            tp: moment(across, up),
            pp: moment(up, up),
            // |Sᵀθ × Sᵀφ|² as a sum of squares: det Σ_(θφ) without cancellation.
            section2: dot(scaled(area2, along), along),
            side2: dot(scaled(area2, up), up),
            beam2,
            total2: beam2 + tt,
        };
        sight.is_seen(view).then_some(sight)
    }

    fn is_seen(&self, view: &View<R>) -> bool {
        let reach2 = R::of_f32(BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS);
        let widest2 = self.beam2 + sum(self.scale2);
        self.mean[1] * self.mean[1] <= reach2 * widest2
            && widest2.is_finite()
            && view.fan(self.elevation).0.exp() > R::of_f32(LEAST_FAN)
            && self.section2 > R::of_f32(LEAST_AREA2_M4)
            && self.section2.is_finite()
    }

    /// Energy over all bins for αρT = 1: `Ω g(φ̄) σ_b/√(σ_b²+Σ_θθ) exp(−ΔΘ²/2(σ_b²+Σ_θθ))`.
    fn energy(&self, view: &View<R>) -> R {
        let solid_angle =
            R::of(std::f64::consts::TAU) * self.section2.sqrt() / (self.range_m * self.range_m);
        let arc = self.azimuth * self.lever_m;
        let sigma = view.sigma_b * self.lever_m;
        let pattern = (R::of(-0.5) * arc * arc / self.total2).exp() * sigma / self.total2.sqrt();
        solid_angle * view.fan(self.elevation).0.exp() * pattern
    }

    /// r′.
    fn range_on_axis(&self) -> R {
        self.range_m - self.azimuth * self.lever_m * self.rt / self.total2
    }

    /// s² and whether it stands above its floor: `Σ_rr + σ² − Σ_rθ²/(Σ_θθ+σ_b²)` without the
    /// difference.
    fn range_variance(&self, view: &View<R>) -> (R, bool) {
        let own = (self.rr * self.beam2 + self.side2) / self.total2;
        let variance = own + R::of_f32(view.geometry.range_variance_m2);
        let least = R::of_f32(LEAST_VARIANCE_M2);
        (variance.max(least), variance > least)
    }

    fn shadow(&self, view: &View<R>) -> Shadow<R> {
        let (lever_m, range_m) = (self.lever_m, self.range_m);
        let [tt, tp, pp] = [
            self.tt / (lever_m * lever_m),
            self.tp / (lever_m * range_m),
            self.pp / (range_m * range_m),
        ];
        let [ct, cp] = view.cell_variance_rad2;
        let determinant = self.section2 / (lever_m * lever_m * range_m * range_m);
        let widened = determinant + ct * pp + cp * tt + ct * cp;
        Shadow {
            tt,
            tp,
            pp,
            inverse_width: R::ONE / (tt + ct).sqrt(),
            slope: tp / (tt + ct),
            inverse_height: ((tt + ct) / widened).sqrt(),
            height: (pp + cp).sqrt(),
            peak: (determinant / widened).sqrt(),
        }
    }
}

/// A Gaussian on the raster: covariance in radians, Cholesky factor of it widened by the cells'.
#[derive(Debug, Clone, Copy)]
struct Shadow<R> {
    tt: R,
    tp: R,
    pp: R,
    inverse_width: R,
    slope: R,
    inverse_height: R,
    height: R,
    peak: R,
}

/// Renders `visible` Gaussians into one ping.
#[must_use]
pub fn forward<R: Real>(
    geometry: &PingGeometry,
    gaussians: &[Numbers<R>],
    visible: &[u32],
    occlusion: bool,
    cutoffs: &Cutoffs,
) -> Rendering<R> {
    let view = View::new(geometry);
    let mut indices = visible.to_vec();
    indices.sort_unstable();
    let row = |index: u32| MatrixRow::new(&view, gaussians.get(index as usize)?, index, cutoffs);
    let mut rendering = Rendering {
        intensity: vec![R::ZERO; geometry.bin_count as usize],
        rows: indices.into_iter().filter_map(row).collect(),
        order: Vec::new(),
        cutoffs: *cutoffs,
    };
    if occlusion {
        rendering.occlude(&view, gaussians);
    }
    for row in &rendering.rows {
        let gaussian = &gaussians[row.index as usize];
        let strength =
            row.transmittance * row.energy * opacity_of(gaussian[10]) * gaussian[11].exp();
        for bin in row.bins.clone() {
            let share = row.edge(&view, bin + 1).normal_cdf() - row.edge(&view, bin).normal_cdf();
            rendering.intensity[bin] += strength * share;
        }
    }
    rendering
}

impl<R: Real> MatrixRow<R> {
    fn new(view: &View<R>, gaussian: &Numbers<R>, index: u32, cutoffs: &Cutoffs) -> Option<Self> {
        if !gaussian.iter().all(|number| number.is_finite()) {
            return None;
        }
        let sight = Sight::new(view, gaussian)?;
        let (range_on_axis_m, range_variance_m2) =
            (sight.range_on_axis(), sight.range_variance(view).0);
        let reach = R::of(cutoffs.range_sigmas) * range_variance_m2.sqrt();
        let bin = |range_m: R| {
            let position = (range_m - view.range_start_m) / view.bin_length_m;
            position
                .to_f64()
                .clamp(0.0, f64::from(view.geometry.bin_count))
        };
        let first = bin(range_on_axis_m - reach).floor() as usize;
        let last = bin(range_on_axis_m + reach).ceil() as usize;
        Some(Self {
            index,
            bins: first..last,
            transmittance: R::ONE,
            energy: sight.energy(view),
            range_on_axis_m,
            range_variance_m2,
            sight,
            cells: Vec::new(),
            overlap: R::ZERO,
        })
    }

    /// Edge `edge` of the bins in sigmas from the mean.
    fn edge(&self, view: &View<R>, edge: usize) -> R {
        let range_m = view.range_start_m + view.bin_length_m * R::of(edge as f64);
        (range_m - self.range_on_axis_m) / self.range_variance_m2.sqrt()
    }

    /// The cells it covers, with nothing yet before it.
    fn cover(&mut self, view: &View<R>, raster: &Raster, raster_sigmas: f64) {
        let shadow = self.sight.shadow(view);
        let reach = R::of(raster_sigmas);
        for number in 0..raster.cell_count() {
            let [azimuth, elevation] = raster.centre_rad(number).map(R::of_f32);
            let (dt, dp) = (
                azimuth - self.sight.azimuth,
                elevation - self.sight.elevation,
            );
            let y = [
                dt * shadow.inverse_width,
                (dp - shadow.slope * dt) * shadow.inverse_height,
            ];
            let distance2 = y[0] * y[0] + y[1] * y[1];
            if dp.abs() <= reach * shadow.height && distance2 <= reach * reach {
                self.cells.push(Cell {
                    number,
                    covered: shadow.peak * (R::of(-0.5) * distance2).exp(),
                    y,
                    transmittance: R::ONE,
                });
            }
        }
    }
}

impl<R: Real> Rendering<R> {
    /// Transmittance by what of each raster cell the Gaussians before cover.
    fn occlude(&mut self, view: &View<R>, gaussians: &[Numbers<R>]) {
        let raster = Raster::new(view.geometry);
        self.order = (0..self.rows.len()).collect();
        let rows = &self.rows;
        self.order.sort_by(|&a, &b| {
            let [near, far] = [rows[a].sight.range_m, rows[b].sight.range_m];
            near.to_f64().total_cmp(&far.to_f64()).then(a.cmp(&b))
        });
        let mut log_transmittance = vec![R::ZERO; raster.cell_count()];
        for &row in &self.order {
            let row = &mut self.rows[row];
            row.cover(view, &raster, self.cutoffs.raster_sigmas);
            let opacity = opacity_of(gaussians[row.index as usize][10]);
            let (mut lit, mut overlap) = (R::ZERO, R::ZERO);
            for cell in &mut row.cells {
                let through = log_transmittance[cell.number].exp();
                let dark = through < R::of(self.cutoffs.least_transmittance);
                cell.transmittance = if dark { R::ZERO } else { through };
                let weight = R::of_f32(raster.weight(cell.number)) * cell.covered;
                lit += weight * cell.transmittance;
                overlap += weight;
                let stopped = (opacity * cell.covered).min(R::of_f32(OPACITY_MAX));
                log_transmittance[cell.number] += (-stopped).ln_1p();
            }
            row.overlap = overlap;
            if overlap > R::of_f32(LEAST_OVERLAP) {
                row.transmittance = lit / overlap;
            }
        }
    }
}

/// What the loss's derivatives by a Gaussian's place in the ping are.
#[derive(Debug, Clone, Copy, Default)]
struct RowGradient<R> {
    /// By the logarithm of its energy; by r′; by s².
    log_energy: R,
    range: R,
    variance: R,
    /// By α, through what it hides; whether anything can be hidden at all.
    opacity: R,
    occluding: bool,
    /// Sums over covered cells of `f·dL/df`, plain and times the whitened distance's powers.
    h: R,
    h1: R,
    h2: R,
    h11: R,
    h12: R,
    h22: R,
}

/// dL/d(parameters) of every Gaussian given dL/dI, shape `[bin_count]`, of a rendering of them.
#[must_use]
pub fn backward<R: Real>(
    geometry: &PingGeometry,
    gaussians: &[Numbers<R>],
    rendering: &Rendering<R>,
    d_intensity: &[R],
) -> Vec<Numbers<R>> {
    let view = View::new(geometry);
    let mut gradients = vec![[R::ZERO; PARAMETER_COUNT]; gaussians.len()];
    let mut row_gradients: Vec<RowGradient<R>> = (rendering.rows.iter())
        .map(|row| row.spread_back(&view, &gaussians[row.index as usize], d_intensity))
        .collect();
    rendering.occlude_back(&view, gaussians, &mut row_gradients);
    for (row, row_gradient) in rendering.rows.iter().zip(&row_gradients) {
        let gaussian = &gaussians[row.index as usize];
        gradients[row.index as usize] = row.sight.back(&view, gaussian, row_gradient);
    }
    gradients
}

impl<R: Real> MatrixRow<R> {
    /// `Σ g ΔΦ`, `Σ g Δϕ`, `Σ g Δ(zϕ)` over the row, and the gradient that they make.
    fn spread_back(
        &self,
        view: &View<R>,
        gaussian: &Numbers<R>,
        d_intensity: &[R],
    ) -> RowGradient<R> {
        let (mut energy, mut shift, mut width) = (R::ZERO, R::ZERO, R::ZERO);
        for bin in self.bins.clone() {
            let g = d_intensity.get(bin).copied().unwrap_or_default();
            let (a, b) = (self.edge(view, bin), self.edge(view, bin + 1));
            energy += g * (b.normal_cdf() - a.normal_cdf());
            shift += g * (b.normal_density() - a.normal_density());
            width += g * (b * b.normal_density() - a * a.normal_density());
        }
        let strength =
            self.transmittance * self.energy * opacity_of(gaussian[10]) * gaussian[11].exp();
        let above_floor = self.sight.range_variance(view).1;
        let half = if above_floor { R::of(0.5) } else { R::ZERO };
        RowGradient {
            log_energy: strength * energy,
            range: -strength * shift / self.range_variance_m2.sqrt(),
            variance: -half * strength * width / self.range_variance_m2,
            ..RowGradient::default()
        }
    }
}

impl<R: Real> Rendering<R> {
    /// From far to near: what each hides from those behind it.
    fn occlude_back(
        &self,
        view: &View<R>,
        gaussians: &[Numbers<R>],
        row_gradients: &mut [RowGradient<R>],
    ) {
        let raster = Raster::new(view.geometry);
        // Σ over Gaussians behind of dL/d ln T, per cell.
        let mut behind = vec![R::ZERO; raster.cell_count()];
        for &row_number in self.order.iter().rev() {
            let (row, row_gradient) = (&self.rows[row_number], &mut row_gradients[row_number]);
            row_gradient.occluding = true;
            let opacity = opacity_of(gaussians[row.index as usize][10]);
            let seen = row.overlap > R::of_f32(LEAST_OVERLAP) && row.transmittance > R::ZERO;
            let by_mean = if seen {
                row_gradient.log_energy / (row.transmittance * row.overlap)
            } else {
                R::ZERO
            };
            for cell in &row.cells {
                let weight = R::of_f32(raster.weight(cell.number));
                let stopped = (opacity * cell.covered).min(R::of_f32(OPACITY_MAX));
                let by_stopped = -behind[cell.number] / (R::ONE - stopped);
                let by_covered = by_mean * weight * (cell.transmittance - row.transmittance)
                    + by_stopped * opacity;
                row_gradient.opacity += by_stopped * cell.covered;
                behind[cell.number] += by_mean * weight * cell.covered * cell.transmittance;
                let (h, [y1, y2]) = (by_covered * cell.covered, cell.y);
                row_gradient.h += h;
                row_gradient.h1 += h * y1;
                row_gradient.h2 += h * y2;
                row_gradient.h11 += h * y1 * y1;
                row_gradient.h12 += h * y1 * y2;
                row_gradient.h22 += h * y2 * y2;
            }
        }
    }
}

/// Derivatives by the quantities of a [`Sight`].
#[derive(Debug, Clone, Copy, Default)]
struct SightGradient<R> {
    range_m: R,
    lever_m: R,
    azimuth: R,
    elevation: R,
    rr: R,
    rt: R,
    tt: R,
    tp: R,
    pp: R,
    section2: R,
    side2: R,
}

impl<R: Real> Sight<R> {
    fn back(
        &self,
        view: &View<R>,
        gaussian: &Numbers<R>,
        row_gradient: &RowGradient<R>,
    ) -> Numbers<R> {
        let mut by = self.measurement_back(view, row_gradient);
        if row_gradient.occluding {
            self.shadow_back(view, row_gradient, &mut by);
        }
        let [by_along, by_across, by_up] = self.axes_back(&by);
        let [sx, sy, sz] = self.scale_back(&by);
        let [mx, my, mz] = self.mean_back(view, &by, by_along, by_across, by_up);
        let [qx, qy, qz, qw] = self.rotation_back(by_along, by_across, by_up);
        let slope = opacity_slope(gaussian[10]);
        let by_opacity = row_gradient.log_energy / opacity_of(gaussian[10]) + row_gradient.opacity;
        let logit = by_opacity * slope;
        [
            mx,
            my,
            mz,
            qx,
            qy,
            qz,
            qw,
            sx,
            sy,
            sz,
            logit,
            row_gradient.log_energy,
        ]
    }

    /// Through energy, r′ and s².
    fn measurement_back(&self, view: &View<R>, row_gradient: &RowGradient<R>) -> SightGradient<R> {
        let two = R::of(2.0);
        let (e, lever, total2) = (row_gradient.log_energy, self.lever_m, self.total2);
        let arc = self.azimuth * lever;
        let own = (self.rr * self.beam2 + self.side2) / total2;
        let by_total2 = (e * (arc * arc / total2 - R::ONE) / two
            + row_gradient.range * arc * self.rt / total2
            - row_gradient.variance * own)
            / total2;
        let by_beam2 = by_total2 + row_gradient.variance * self.rr / total2;
        let by_arc = -(e * arc + row_gradient.range * self.rt) / total2;
        SightGradient {
            range_m: row_gradient.range - two * e / self.range_m,
            lever_m: e / lever
                + by_arc * self.azimuth
                + two * lever * view.beam_variance * by_beam2,
            azimuth: by_arc * lever,
            elevation: e * view.fan(self.elevation).1,
            rr: row_gradient.variance * self.beam2 / total2,
            rt: -row_gradient.range * arc / total2,
            tt: by_total2,
            section2: e / (two * self.section2),
            side2: row_gradient.variance / total2,
            ..SightGradient::default()
        }
    }

    /// Through what is covered on the raster.
    fn shadow_back(
        &self,
        view: &View<R>,
        row_gradient: &RowGradient<R>,
        by: &mut SightGradient<R>,
    ) {
        let two = R::of(2.0);
        let half = R::of(0.5);
        let shadow = self.shadow(view);
        let (a, b, slope) = (shadow.inverse_width, shadow.inverse_height, shadow.slope);
        let by_elevation = row_gradient.h2 * b;
        by.elevation += by_elevation;
        by.azimuth += row_gradient.h1 * a - slope * by_elevation;
        // ½ S⁻¹(d dᵀ − S)S⁻¹ in the whitened frame.
        let (k11, k12, k22) = (
            row_gradient.h11 - row_gradient.h,
            row_gradient.h12,
            row_gradient.h22 - row_gradient.h,
        );
        let pp = half * b * b * k22;
        let tp = b * (a * k12 - slope * b * k22);
        let tt = half * (a * a * k11 - two * a * slope * b * k12 + slope * slope * b * b * k22);
        let (lever, range) = (self.lever_m, self.range_m);
        by.tt += tt / (lever * lever);
        by.tp += tp / (lever * range);
        by.pp += pp / (range * range);
        by.section2 += half * row_gradient.h / self.section2;
        by.lever_m -= (row_gradient.h + two * tt * shadow.tt + tp * shadow.tp) / lever;
        by.range_m -= (row_gradient.h + two * pp * shadow.pp + tp * shadow.tp) / range;
    }

    /// By the directions of range, azimuth and elevation along the Gaussian's own axes.
    fn axes_back(&self, by: &SightGradient<R>) -> [[R; 3]; 3] {
        let two = R::of(2.0);
        let (u, v, w) = (self.along, self.across, self.up);
        let part = |k: usize| {
            let (s, area) = (self.scale2[k], self.area2[k]);
            [
                s * (two * by.rr * u[k] + by.rt * v[k]) + two * by.section2 * area * u[k],
                s * (two * by.tt * v[k] + by.rt * u[k] + by.tp * w[k]),
                s * (two * by.pp * w[k] + by.tp * v[k]) + two * by.side2 * area * w[k],
            ]
        };
        let parts = [0, 1, 2].map(part);
        [0, 1, 2].map(|axis| [0, 1, 2].map(|k| parts[k][axis]))
    }

    fn scale_back(&self, by: &SightGradient<R>) -> [R; 3] {
        let two = R::of(2.0);
        let (u, v, w) = (self.along, self.across, self.up);
        let area =
            [0, 1, 2].map(|k| self.area2[k] * (by.section2 * u[k] * u[k] + by.side2 * w[k] * w[k]));
        [0, 1, 2].map(|k| {
            let spread = by.rr * u[k] * u[k]
                + by.rt * u[k] * v[k]
                + by.tt * v[k] * v[k]
                + by.tp * v[k] * w[k]
                + by.pp * w[k] * w[k];
            // Area l is the product of the two scales other than l.
            two * (self.scale2[k] * spread + area[(k + 1) % 3] + area[(k + 2) % 3])
        })
    }

    /// By the mean: along range, azimuth and elevation, back through the drift, into the world.
    fn mean_back(
        &self,
        view: &View<R>,
        by: &SightGradient<R>,
        gu: [R; 3],
        gv: [R; 3],
        gw: [R; 3],
    ) -> [R; 3] {
        let (u, v, w) = (self.along, self.across, self.up);
        let (cos, sin) = (self.lever_m / self.range_m, self.mean[2] / self.range_m);
        let azimuth =
            by.azimuth + cos * (dot(gu, v) - dot(gv, u)) + sin * (dot(gv, w) - dot(gw, v));
        let elevation = by.elevation + dot(gu, w) - dot(gw, u) - self.range_m * sin * by.lever_m;
        let range = by.range_m + cos * by.lever_m;
        let [x, y, z] = self.mean;
        let (lever, r) = (self.lever_m, self.range_m);
        let (a, p) = (azimuth / lever, elevation / r);
        let moved = [
            range * x / r - a * y / lever - p * x * z / (lever * r),
            range * y / r + a * x / lever - p * y * z / (lever * r),
            range * z / r + p * lever / r,
        ];
        view.in_world_frame(view.drift_back(self.still, moved))
    }

    /// By the raw quaternion: the torque about the own axes, doubled, through the normalisation.
    fn rotation_back(&self, gu: [R; 3], gv: [R; 3], gw: [R; 3]) -> [R; 4] {
        let (a, b, c) = (
            cross(gu, self.along),
            cross(gv, self.across),
            cross(gw, self.up),
        );
        let torque = [0, 1, 2].map(|k| a[k] + b[k] + c[k]);
        let [x, y, z, w] = self.unit;
        let turned = cross([x, y, z], torque);
        let factor = R::of(2.0) / self.length;
        let part = |k: usize| factor * (w * torque[k] + turned[k]);
        [part(0), part(1), part(2), -factor * dot([x, y, z], torque)]
    }
}

#[cfg(test)]
mod tests;
