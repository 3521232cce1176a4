//! What one ping hears of many Gaussians that are kept as packed numbers, each with a strength towards each of the six faces of
//! a cube.
//!
//! [`cull`] finds those in the beam, [`project_round`] and [`project_shaped`] say where in the ping each is heard and how
//! strongly, [`Pulses`] spread that over the bins and bring back what bins say of each.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};
use glam::Vec3;

use crate::PingGeometry;
use crate::lanes::{self, LANES};
use crate::online::constants::{BEAM_REACH_SIGMAS, LEAST_FAN, LEAST_VARIANCE_M2};
use crate::ping_view::{PingView, Place};
use crate::pulse::{GROUP, Pulse, Steps, Weighted};
use crate::triple::{Triple, cross, dot, gathered};

/// Numbers a Gaussian; layout.
/// Numbers per Gaussian, world axes: mean (m), strength towards +x, +y, +z and towards −x, −y, −z.
pub const NUMBERS: usize = 9;
/// Numbers of a shape; layout.
/// Those that a Gaussian with a shape has beside them: covariance xx, yy, zz, yz, xz, xy, m².
pub const SHAPE_NUMBERS: usize = 6;
/// Ratio of widths; grid.
/// Widths in range of Gaussians with a shape are rounded to powers of this.
const WIDTH_STEP: f32 = 1.1;
/// Pulses kept; bounds memory.
const MOST_PULSES: usize = 96;

/// How much is told of each Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// Where and how strongly it is heard, and from which direction.
    Strength,
    /// All of it.
    Full,
}

/// A ping's geometry as single numbers, worked out once per ping.
#[derive(Debug, Clone, Copy)]
pub struct View {
    ping: PingView,
    /// Whether sensitivity falls off over elevation.
    is_graded: bool,
    bins_per_m: f32,
}

impl View {
    /// Of `geometry`; unless `is_graded`, the fan is equally sensitive over all elevations that it sees.
    #[must_use]
    pub fn of(geometry: &PingGeometry, is_graded: bool) -> Self {
        Self {
            ping: PingView::new(geometry),
            is_graded,
            bins_per_m: 1.0 / geometry.bin_length_m,
        }
    }

    fn bin_count(&self) -> usize {
        self.ping.bin_count as usize
    }

    /// Width in bins of an echo with this variance in range beside the ping's.
    fn sigma_bins(&self, variance_m2: f32) -> f32 {
        let variance_m2 = variance_m2 + self.ping.range_variance_m2;
        variance_m2.max(LEAST_VARIANCE_M2).sqrt() * self.bins_per_m
    }
}

/// Numbers of Gaussians side by side, with [`LANES`] more places from the last on.
#[derive(Debug, Clone, Copy)]
pub struct Numbers<'a> {
    /// Shape `[NUMBERS][places]`.
    pub all: &'a [Vec<f32>; NUMBERS],
    /// Shape `[SHAPE_NUMBERS][places]`, for those that have one.
    pub shapes: &'a [Vec<f32>; SHAPE_NUMBERS],
}

/// Gaussians side by side that lie in a ball.
#[derive(Debug, Clone)]
pub struct Members {
    /// Their places.
    pub places: Range<usize>,
    /// Middle and radius of the ball that holds their means.
    pub center_m: Vec3,
    /// See `center_m`.
    pub radius_m: f32,
    /// The widest of their sigmas.
    pub sigma_m: f32,
}

/// Appends the places among `members` that the ping may see: a cheap test that rules most of them out.
#[inline(always)]
pub fn cull<S: Simd>(
    simd: S,
    view: &View,
    numbers: Numbers<'_>,
    members: &Members,
    places: &mut Vec<u32>,
) {
    let range = members.places.clone();
    let slab = view
        .ping
        .slab(members.center_m, members.radius_m, members.sigma_m);
    let mut found = places.len();
    // Room for all, and for eight from the last on.
    places.resize(found + range.len() + LANES, 0);
    let [x_m, y_m, z_m, ..] = numbers.all;
    let mut from = range.start;
    while from < range.end {
        let mean_m = [
            f32x8::from_slice(simd, &x_m[from..from + LANES]),
            f32x8::from_slice(simd, &y_m[from..from + LANES]),
            f32x8::from_slice(simd, &z_m[from..from + LANES]),
        ];
        let left = (range.end - from).min(LANES);
        let bits = slab.holds(mean_m).to_bitmask() & ((1 << left) - 1);
        if bits != 0 {
            // Each is written, and the next over those that are not seen: no branch that would be guessed wrong.
            let eight = &mut places[found..found + LANES];
            let mut count = 0;
            for lane in 0..LANES {
                eight[count & (LANES - 1)] = (from + lane) as u32;
                count += (bits >> lane & 1) as usize;
            }
            found += count;
        }
        from += LANES;
    }
    places.truncate(found);
}

/// What a ping hears of each Gaussian: one array per quantity, in the order in which they were projected. One that it does not
/// hear after all has the energy 0.
#[derive(Debug, Default)]
pub struct Rows {
    count: usize,
    /// Where its numbers are.
    pub place: Vec<u32>,
    /// The step of its pulse before its echo, and how far on towards the next it is.
    pub at: Vec<u32>,
    /// See `at`.
    pub fraction: Vec<f32>,
    /// Energy over all bins for strength 1: solid angle times sensitivity.
    pub energy: Vec<f32>,
    /// The same times its strength towards the sensor.
    pub echo: Vec<f32>,
    /// Unit vector of growing range, world axes.
    pub range_axis: [Vec<f32>; 3],
    /// From here on in full detail alone. Which of the widths in use it has.
    width: Vec<u32>,
    /// Mean range on the beam's axis, and one sigma.
    pub range_m: Vec<f32>,
    /// See `range_m`.
    pub range_sigma_m: Vec<f32>,
    /// Azimuth and elevation of the mean from the beam's axis.
    pub azimuth_rad: Vec<f32>,
    /// See `azimuth_rad`.
    pub elevation_rad: Vec<f32>,
    /// Variance of azimuth, beam, Gaussian and attitude together.
    pub azimuth_variance_rad2: Vec<f32>,
    /// Metres per radian of azimuth.
    pub lever_m: Vec<f32>,
    /// Unit vector of growing azimuth, world axes.
    pub azimuth_axis: [Vec<f32>; 3],
}

impl Rows {
    /// Makes room for so many, and eight more.
    fn begin(&mut self, count: usize, detail: Detail) {
        self.count = 0;
        let room = count + LANES;
        let [rx, ry, rz] = &mut self.range_axis;
        for numbers in [
            &mut self.energy,
            &mut self.echo,
            &mut self.fraction,
            rx,
            ry,
            rz,
        ] {
            numbers.resize(room.max(numbers.len()), 0.0);
        }
        for numbers in [&mut self.place, &mut self.at] {
            numbers.resize(room.max(numbers.len()), 0);
        }
        if detail == Detail::Full {
            let [ax, ay, az] = &mut self.azimuth_axis;
            for numbers in [
                &mut self.range_m,
                &mut self.range_sigma_m,
                &mut self.azimuth_rad,
                &mut self.elevation_rad,
                &mut self.azimuth_variance_rad2,
                &mut self.lever_m,
                ax,
                ay,
                az,
            ] {
                numbers.resize(room.max(numbers.len()), 0.0);
            }
            self.width.resize(room.max(self.width.len()), 0);
        }
    }

    /// Rows there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.count
    }

    /// What was gathered at a row's place, between the steps beside it.
    #[inline(always)]
    #[must_use]
    pub fn found(&self, row: usize, gathered: &[f32]) -> f32 {
        let at = self.at[row] as usize;
        match gathered[at..at + 2] {
            [before, next] => before + self.fraction[row] * (next - before),
            _ => 0.0,
        }
    }

    /// Unit vector of growing range of a row, world axes.
    #[inline(always)]
    #[must_use]
    pub fn range_axis_of(&self, row: usize) -> Vec3 {
        let [x, y, z] = &self.range_axis;
        Vec3::new(x[row], y[row], z[row])
    }

    /// Unit vector of growing azimuth of a row, world axes.
    #[inline(always)]
    #[must_use]
    pub fn azimuth_axis_of(&self, row: usize) -> Vec3 {
        let [x, y, z] = &self.azimuth_axis;
        Vec3::new(x[row], y[row], z[row])
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}

#[inline(always)]
fn put<S: Simd>(vector: f32x8<S>, numbers: &mut [f32], from: usize) {
    vector.store_slice(&mut numbers[from..from + LANES]);
}

/// The beam's frame at the means of eight Gaussians, and how sensitive it is there.
struct Beamed<S: Simd> {
    place: Place<S>,
    range_axis: Triple<S>,
    azimuth: f32x8<S>,
    elevation: f32x8<S>,
    fan: f32x8<S>,
}

impl<S: Simd> Beamed<S> {
    #[inline(always)]
    fn of(view: &View, mean_m: Triple<S>) -> Self {
        let place = view.ping.place(mean_m);
        let elevation = place.elevation();
        Self {
            range_axis: view.ping.range_axis(&place),
            azimuth: place.azimuth(),
            elevation,
            fan: view.ping.fan(elevation),
            place,
        }
    }
}

/// Strength seen from the sensor, `Σ u_k² s_k` over the three faces turned against `range_axis`.
#[inline(always)]
fn facing<S: Simd>(range_axis: Triple<S>, ahead: Triple<S>, behind: Triple<S>) -> f32x8<S> {
    let [x, y, z] = range_axis;
    let sx = x.simd_le(0.0).select(ahead[0], behind[0]);
    let sy = y.simd_le(0.0).select(ahead[1], behind[1]);
    let sz = z.simd_le(0.0).select(ahead[2], behind[2]);
    (x * x).mul_add(sx, (y * y).mul_add(sy, z * z * sz))
}

/// Covariances times vectors.
#[inline(always)]
fn stretched<S: Simd>(diagonal: Triple<S>, mixed: Triple<S>, v: Triple<S>) -> Triple<S> {
    let [yz, xz, xy] = mixed;
    [
        diagonal[0].mul_add(v[0], xy.mul_add(v[1], xz * v[2])),
        xy.mul_add(v[0], diagonal[1].mul_add(v[1], yz * v[2])),
        xz.mul_add(v[0], yz.mul_add(v[1], diagonal[2] * v[2])),
    ]
}

/// What a shape, or none, makes of an echo.
struct Extent<S: Simd> {
    /// Solid angle, steradians.
    solid_angle: f32x8<S>,
    /// Variance of azimuth, all together.
    total: f32x8<S>,
    /// Share of the beam's pattern.
    pattern: f32x8<S>,
    /// Squared sigmas off the beam.
    off: f32x8<S>,
    mean_range_m: f32x8<S>,
}

/// Energies of a ping's echoes by steps of a bin, and the pulses that spread them. Reused from ping to ping.
#[derive(Debug, Default)]
pub struct Pulses {
    pulses: Vec<Pulse>,
    bin_count: usize,
    /// Those in use in this ping, and the groups of bins around which each has echoes, a bit each.
    steps: Vec<Steps>,
    touched: Vec<u64>,
    /// Of each width's step, which of `steps` it is.
    by_width: Vec<(i32, usize)>,
    energies: Vec<f32>,
    pair_count: u64,
    /// Numbers per bin, each once for each step of it, with room around.
    padded: Vec<f32>,
}

impl Pulses {
    /// Lets go of the ping before.
    fn begin(&mut self, bin_count: usize) {
        if self.bin_count != bin_count || self.pulses.len() > MOST_PULSES {
            self.pulses.clear();
            self.bin_count = bin_count;
        }
        self.steps.clear();
        self.touched.clear();
        self.by_width.clear();
        self.energies.clear();
        self.pair_count = 0;
    }

    fn pulse(&mut self, sigma_bins: f32) -> usize {
        let known = self.pulses.iter();
        let mut known = known.map(|pulse| pulse.sigma_bins().to_bits());
        known
            .position(|bits| bits == sigma_bins.to_bits())
            .unwrap_or_else(|| {
                self.pulses.push(Pulse::of(sigma_bins, self.bin_count));
                self.pulses.len() - 1
            })
    }

    /// Begins energies of echoes of one width, bins. Returns its number.
    fn width(&mut self, sigma_bins: f32) -> usize {
        let number = self.pulse(sigma_bins);
        let steps = Steps::of(
            &self.pulses[number],
            number,
            self.bin_count,
            self.energies.len(),
        );
        self.energies.resize(steps.end(), 0.0);
        self.steps.push(steps);
        self.touched.push(0);
        self.steps.len() - 1
    }

    /// The same of a width among others, rounded to a power of [`WIDTH_STEP`].
    fn rounded_width(&mut self, sigma_bins: f32) -> usize {
        let step = (sigma_bins.ln() / WIDTH_STEP.ln()).round() as i32;
        if let Some(&(_, known)) = self.by_width.iter().find(|(known, _)| *known == step) {
            return known;
        }
        let width = self.width(WIDTH_STEP.powi(step));
        self.by_width.push((step, width));
        width
    }

    fn most_reach(&self) -> usize {
        let reaches = self
            .steps
            .iter()
            .map(|steps| self.pulses[steps.pulse as usize].reach());
        reaches.max().unwrap_or(0)
    }

    /// Gaussian–bin pairs of the ping: the unit of work.
    #[must_use]
    pub fn pair_count(&self) -> u64 {
        self.pair_count
    }

    fn count(&mut self, width: usize, echoes: usize) {
        let pulse = &self.pulses[self.steps[width].pulse as usize];
        self.pair_count += (echoes * pulse.width()) as u64;
    }

    /// Adds all rows' echoes to `predicted`, power per bin, with room for whole groups beyond the last bin.
    #[inline(always)]
    pub fn spread<S: Simd>(&mut self, simd: S, rows: &Rows, predicted: &mut [f32]) {
        let echoes = rows.echo.iter().zip(&rows.fraction);
        for (&at, (&echo, &fraction)) in rows.at[..rows.count].iter().zip(echoes) {
            let beyond = echo * fraction;
            if let [before, next] = &mut self.energies[at as usize..at as usize + 2] {
                *before += echo - beyond;
                *next += beyond;
            }
        }
        // The last group reads beyond the last step.
        self.energies.resize(self.energies.len() + GROUP, 0.0);
        for (steps, &touched) in self.steps.iter().zip(&self.touched) {
            let pulse = &self.pulses[steps.pulse as usize];
            steps.spread(simd, pulse, touched, &self.energies, predicted);
        }
    }

    /// `Σ_b K(b) x_b` of `x`, shape `[bins]`, for each step of each width: [`Rows::at`] is where a row finds its own.
    #[inline(always)]
    pub fn gather<S: Simd>(
        &mut self,
        simd: S,
        weighted: Weighted,
        x: &[f32],
        gathered: &mut Vec<f32>,
    ) {
        let end = self.steps.last().map_or(0, Steps::end);
        gathered.resize(end.max(gathered.len()), 0.0);
        let (front, mut padded_for) = (2 * self.most_reach(), 0);
        for (steps, &touched) in self.steps.iter().zip(&self.touched) {
            let (pulse, phases) = (&self.pulses[steps.pulse as usize], steps.phases());
            if padded_for != phases {
                repeat(&x[..self.bin_count], phases, front, &mut self.padded);
                padded_for = phases;
            }
            let x = &self.padded[(front - 2 * pulse.reach()) * phases..];
            steps.gather(simd, pulse, (weighted, touched), x, gathered);
        }
    }

    /// Bins of a row, in full detail, and the share of its energy in each, to the nearest step.
    #[must_use]
    pub fn echo_of(&self, rows: &Rows, row: usize) -> (Range<usize>, &[f32]) {
        let steps = &self.steps[rows.width[row] as usize];
        let nearest = rows.at[row] + u32::from(rows.fraction[row] > 0.5);
        let (first, shares) = steps.echo(&self.pulses[steps.pulse as usize], nearest);
        let end = first + shares.len() as isize;
        let bins = first.max(0) as usize..(end.max(0) as usize).min(self.bin_count);
        let skipped = bins.start.saturating_add_signed(-first).min(shares.len());
        (bins.clone(), &shares[skipped..skipped + bins.len()])
    }
}

/// Each of `x` so many times over, with room for so many bins and a group before and after.
#[inline(always)]
fn repeat(x: &[f32], times: usize, room: usize, repeated: &mut Vec<f32>) {
    repeated.clear();
    repeated.resize((x.len() + 2 * room + 1) * times + GROUP, 0.0);
    let into = repeated[room * times..].chunks_exact_mut(times);
    for (into, &x) in into.zip(x) {
        into.fill(x);
    }
}

/// Begins a ping that sees so many Gaussians.
pub fn begin(view: &View, count: usize, detail: Detail, rows: &mut Rows, pulses: &mut Pulses) {
    rows.begin(count, detail);
    pulses.begin(view.bin_count());
}

/// Appends a row for each of `places`, ascending, which are round and have this sigma.
#[inline(always)]
pub fn project_round<S: Simd>(
    simd: S,
    view: &View,
    numbers: Numbers<'_>,
    sigma_m: f32,
    places: &[u32],
    detail: Detail,
    (rows, pulses): (&mut Rows, &mut Pulses),
) {
    if places.is_empty() {
        return;
    }
    let variance_m2 = sigma_m * sigma_m;
    let width = pulses.width(view.sigma_bins(variance_m2));
    pulses.count(width, places.len());
    let steps = pulses.steps[width];
    let ping = &view.ping;
    let one = f32x8::splat(simd, 1.0);
    let range_sigma_m = f32x8::splat(simd, steps_sigma(view, variance_m2));
    for chunk in places.chunks(LANES) {
        let mut eight = [chunk[chunk.len() - 1]; LANES];
        eight[..chunk.len()].copy_from_slice(chunk);
        let mean_m = triple(simd, numbers.all, 0, eight);
        let beamed = Beamed::of(view, mean_m);
        let (by_lever, by_range) = (beamed.place.by_lever, beamed.place.by_range);
        let total =
            (by_lever * by_lever).mul_add(variance_m2, f32x8::splat(simd, ping.beam_variance));
        let by_total = one / total;
        let off = beamed.azimuth * beamed.azimuth * by_total;
        let extent = Extent {
            solid_angle: by_range * by_range * (std::f32::consts::TAU * variance_m2),
            total,
            pattern: by_total.sqrt() * ping.sigma_b * lanes::exp(off * -0.5),
            off,
            mean_range_m: beamed.place.range_m,
        };
        let bins = (extent.mean_range_m - ping.range_start_m) * view.bins_per_m;
        let placed = steps.place(bins, ping.bin_count);
        pulses.touched[width] |= placed.touched;
        let heard = Heard {
            at: placed.at,
            fraction: placed.fraction,
            inside: placed.inside,
            width: [width as u32; LANES],
            range_sigma_m,
        };
        write(
            view,
            numbers,
            (eight, chunk.len()),
            &beamed,
            &extent,
            &heard,
            detail,
            rows,
        );
    }
}

/// Appends a row for each of `places`, ascending, which have shapes.
#[inline(always)]
pub fn project_shaped<S: Simd>(
    simd: S,
    view: &View,
    numbers: Numbers<'_>,
    places: &[u32],
    detail: Detail,
    (rows, pulses): (&mut Rows, &mut Pulses),
) {
    let ping = &view.ping;
    let one = f32x8::splat(simd, 1.0);
    for chunk in places.chunks(LANES) {
        let mut eight = [chunk[chunk.len() - 1]; LANES];
        eight[..chunk.len()].copy_from_slice(chunk);
        let mean_m = triple(simd, numbers.all, 0, eight);
        let (diagonal, mixed) = (
            triple(simd, numbers.shapes, 0, eight),
            triple(simd, numbers.shapes, 3, eight),
        );
        let beamed = Beamed::of(view, mean_m);
        let place = &beamed.place;
        let azimuth_axis = ping.azimuth_axis(place);
        let elevation_axis = cross(beamed.range_axis, azimuth_axis);
        let along = stretched(diagonal, mixed, beamed.range_axis);
        let across = stretched(diagonal, mixed, azimuth_axis);
        let up = stretched(diagonal, mixed, elevation_axis);
        let range_variance = dot(along, beamed.range_axis);
        let width2 = dot(across, azimuth_axis).max(0.0);
        let range_azimuth = dot(along, azimuth_axis) * place.by_lever;
        // √det of the cross-section by Cholesky; its azimuth in metres keeps it well scaled.
        let width_m = width2.sqrt();
        let skew = dot(across, elevation_axis) / width_m.max(1e-9);
        let height_m = (dot(up, elevation_axis) - skew * skew).max(0.0).sqrt();
        let total = (width2 * place.by_lever)
            .mul_add(place.by_lever, f32x8::splat(simd, ping.beam_variance));
        let by_total = one / total;
        let off = beamed.azimuth * beamed.azimuth * by_total;
        let extent = Extent {
            solid_angle: width_m
                * height_m
                * place.by_range
                * place.by_range
                * std::f32::consts::TAU,
            total,
            pattern: by_total.sqrt() * ping.sigma_b * lanes::exp(off * -0.5),
            off,
            mean_range_m: place.range_m - beamed.azimuth * range_azimuth * by_total,
        };
        let own_m2 = range_variance - range_azimuth * range_azimuth * by_total;
        let range_sigma_m = (own_m2 + ping.range_variance_m2)
            .max(LEAST_VARIANCE_M2)
            .sqrt();
        let bins = (extent.mean_range_m - ping.range_start_m) * view.bins_per_m;
        let mut heard = Heard {
            at: [0; LANES],
            fraction: one,
            inside: bins.simd_lt(f32::NEG_INFINITY),
            width: [0; LANES],
            range_sigma_m,
        };
        let (mut inside, mut fraction) = ([0.0; LANES], [0.0; LANES]);
        let widths = (range_sigma_m * view.bins_per_m).to_array();
        for lane in 0..chunk.len() {
            if !widths[lane].is_finite() {
                continue;
            }
            let width = pulses.rounded_width(widths[lane]);
            let placed = pulses.steps[width].place(bins, ping.bin_count);
            pulses.touched[width] |= placed.touched;
            heard.at[lane] = placed.at[lane];
            fraction[lane] = placed.fraction.to_array()[lane];
            inside[lane] = lanes::only(placed.inside, one).to_array()[lane];
            heard.width[lane] = width as u32;
            pulses.count(width, 1);
        }
        heard.inside = f32x8::simd_from(simd, inside).simd_gt(0.0);
        heard.fraction = f32x8::simd_from(simd, fraction);
        write(
            view,
            numbers,
            (eight, chunk.len()),
            &beamed,
            &extent,
            &heard,
            detail,
            rows,
        );
    }
}

fn steps_sigma(view: &View, variance_m2: f32) -> f32 {
    view.sigma_bins(variance_m2) / view.bins_per_m
}

#[inline(always)]
fn triple<S: Simd, const N: usize>(
    simd: S,
    numbers: &[Vec<f32>; N],
    from: usize,
    places: [u32; LANES],
) -> Triple<S> {
    [
        gathered(simd, &numbers[from], places),
        gathered(simd, &numbers[from + 1], places),
        gathered(simd, &numbers[from + 2], places),
    ]
}

/// Where eight are heard.
struct Heard<S: Simd> {
    at: [u32; LANES],
    fraction: f32x8<S>,
    inside: mask32x8<S>,
    width: [u32; LANES],
    range_sigma_m: f32x8<S>,
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn write<S: Simd>(
    view: &View,
    numbers: Numbers<'_>,
    (places, count): ([u32; LANES], usize),
    beamed: &Beamed<S>,
    extent: &Extent<S>,
    heard: &Heard<S>,
    detail: Detail,
    rows: &mut Rows,
) {
    let simd = extent.total.simd;
    let place = &beamed.place;
    let energy = extent.solid_angle * extent.pattern;
    let energy = match view.is_graded {
        true => energy * beamed.fan,
        false => energy,
    };
    let is_seen = beamed.fan.simd_gt(LEAST_FAN)
        & place.in_front()
        & energy.simd_ge(0.0)
        & extent.off.simd_le(BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS)
        & heard.inside;
    let energy = lanes::only(is_seen, energy);
    let strength = facing(
        beamed.range_axis,
        triple(simd, numbers.all, 3, places),
        triple(simd, numbers.all, 6, places),
    );
    let from = rows.count;
    rows.place[from..from + LANES].copy_from_slice(&places);
    rows.at[from..from + LANES].copy_from_slice(&heard.at);
    put(energy, &mut rows.energy, from);
    put(heard.fraction, &mut rows.fraction, from);
    put(
        lanes::only(is_seen, energy * strength),
        &mut rows.echo,
        from,
    );
    for (numbers, axis) in rows.range_axis.iter_mut().zip(beamed.range_axis) {
        put(axis, numbers, from);
    }
    if detail == Detail::Full {
        rows.width[from..from + LANES].copy_from_slice(&heard.width);
        put(extent.mean_range_m, &mut rows.range_m, from);
        put(heard.range_sigma_m, &mut rows.range_sigma_m, from);
        put(beamed.azimuth, &mut rows.azimuth_rad, from);
        put(beamed.elevation, &mut rows.elevation_rad, from);
        put(extent.total, &mut rows.azimuth_variance_rad2, from);
        put(place.lever_m, &mut rows.lever_m, from);
        let azimuth_axis = view.ping.azimuth_axis(place);
        for (numbers, axis) in rows.azimuth_axis.iter_mut().zip(azimuth_axis) {
            put(axis, numbers, from);
        }
    }
    rows.count += count;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Beam, PingPose, Splat, SymmetricMat3};
    use fearless_simd::{Level, dispatch};
    use glam::{EulerRot, Mat3, Quat};

    fn geometry() -> PingGeometry {
        let turn = Quat::from_euler(EulerRot::ZYX, 0.4, -0.2, 0.3);
        PingGeometry {
            pose: PingPose {
                position_m: Vec3::new(1.0, -2.0, 0.5),
                axes: Mat3::from_quat(turn),
                drift_per_m: Vec3::new(1e-4, 2e-4, -1e-4),
                reference_range_m: 5.0,
            },
            range_start_m: 0.3,
            bin_length_m: 0.02,
            bin_count: 500,
            range_variance_m2: 1e-4,
            azimuth_variance_rad2: 1e-5,
            beam: Beam::default(),
        }
    }

    #[derive(Clone, Copy)]
    struct Gaussian {
        mean_m: Vec3,
        covariance_m2: SymmetricMat3,
        ahead: Vec3,
        behind: Vec3,
    }

    impl Gaussian {
        fn strength_seen(&self, towards: Vec3) -> f32 {
            let faces = Vec3::select(towards.cmpge(Vec3::ZERO), self.ahead, self.behind);
            faces.dot(towards * towards)
        }
    }

    const ROUND_M: f32 = 0.03;

    /// Gaussians in and beside the fan and behind the sensor, of all shapes or round.
    fn gaussians(geometry: &PingGeometry, is_round: bool) -> Vec<Gaussian> {
        let gaussian = |i| {
            let t = i as f32;
            let in_beam = Vec3::new(
                5.0 + 6.0 * (t * 0.7).sin(),
                0.3 * (t * 1.3).sin(),
                4.0 * (t * 0.9).cos(),
            );
            let rotation = Quat::from_euler(EulerRot::ZYX, t * 0.37, t * 0.11, t * 0.23);
            let axes = Mat3::from_quat(rotation) * Mat3::from_diagonal(Vec3::new(0.05, 0.03, 0.01));
            Gaussian {
                mean_m: geometry.pose.position_m + geometry.pose.axes * in_beam,
                covariance_m2: match is_round {
                    true => SymmetricMat3::isotropic(ROUND_M),
                    false => SymmetricMat3::of(axes * axes.transpose()),
                },
                ahead: Vec3::new(1.0, 2.0, 3.0) + t,
                behind: Vec3::new(5.0, 7.0, 9.0) + t,
            }
        };
        (0..2003).map(gaussian).collect()
    }

    fn filled<const N: usize>(rows: impl Iterator<Item = [f32; N]>) -> [Vec<f32>; N] {
        let mut numbers = [const { Vec::new() }; N];
        for row in rows.chain([[0.0; N]; LANES]) {
            for (numbers, number) in numbers.iter_mut().zip(row) {
                numbers.push(number);
            }
        }
        numbers
    }

    struct Heard {
        geometry: PingGeometry,
        gaussians: Vec<Gaussian>,
        rows: Rows,
        pulses: Pulses,
    }

    fn hear(
        geometry: PingGeometry,
        gaussians: Vec<Gaussian>,
        sigma_m: Option<f32>,
        level: Level,
    ) -> Heard {
        let triples = |g: &Gaussian| [g.mean_m, g.ahead, g.behind].map(|v| v.to_array());
        let all = filled(gaussians.iter().map(|g| {
            let [[x, y, z], [a, b, c], [d, e, f]] = triples(g);
            [x, y, z, a, b, c, d, e, f]
        }));
        let shapes = filled(gaussians.iter().map(|g| {
            let ([x, y, z], [yz, xz, xy]) = (
                g.covariance_m2.diagonal.to_array(),
                g.covariance_m2.mixed.to_array(),
            );
            [x, y, z, yz, xz, xy]
        }));
        let numbers = Numbers {
            all: &all,
            shapes: &shapes,
        };
        let view = View::of(&geometry, true);
        let members = Members {
            places: 0..gaussians.len(),
            center_m: geometry.pose.position_m,
            radius_m: 12.0,
            sigma_m: 0.05,
        };
        let (mut places, mut rows, mut pulses) = (Vec::new(), Rows::default(), Pulses::default());
        dispatch!(level, simd => {
            cull(simd, &view, numbers, &members, &mut places);
            begin(&view, places.len(), Detail::Full, &mut rows, &mut pulses);
            let into = (&mut rows, &mut pulses);
            match sigma_m {
                Some(sigma_m) => {
                    project_round(simd, &view, numbers, sigma_m, &places, Detail::Full, into);
                }
                None => project_shaped(simd, &view, numbers, &places, Detail::Full, into),
            }
        });
        Heard {
            geometry,
            gaussians,
            rows,
            pulses,
        }
    }

    impl Heard {
        fn of(is_round: bool, level: Level) -> Self {
            let geometry = geometry();
            let gaussians = gaussians(&geometry, is_round);
            hear(geometry, gaussians, is_round.then_some(ROUND_M), level)
        }

        fn splat(&self, place: usize) -> Option<Splat> {
            let gaussian = &self.gaussians[place];
            let splat = self
                .geometry
                .project(gaussian.mean_m, &gaussian.covariance_m2);
            splat.filter(|splat| !self.geometry.bins_of(splat).is_empty())
        }

        fn predicted(&mut self) -> Vec<f32> {
            let mut predicted = vec![0.0; 512];
            dispatch!(Level::new(), simd => {
                self.pulses.spread(simd, &self.rows, &mut predicted);
            });
            predicted.truncate(500);
            predicted
        }
    }

    #[test]
    fn eight_at_a_time_are_heard_as_one_at_a_time() {
        for is_round in [true, false] {
            let heard = Heard::of(is_round, Level::new());
            let rows = &heard.rows;
            let mut row_of = vec![None; heard.gaussians.len()];
            for row in (0..rows.len()).filter(|&row| rows.energy[row] > 0.0) {
                row_of[rows.place[row] as usize] = Some(row);
            }
            let mut count = 0;
            for (place, gaussian) in heard.gaussians.iter().enumerate() {
                // One at the very edge of a cut may fall to either side.
                let (splat, row) = match (heard.splat(place), row_of[place]) {
                    (Some(splat), Some(row)) => (splat, row),
                    (Some(splat), None) => {
                        assert!(splat.energy < 1e-4, "{place} {splat:?}");
                        continue;
                    }
                    (None, row) => {
                        assert!(row.is_none_or(|row| rows.energy[row] < 1e-4), "{place}");
                        continue;
                    }
                };
                count += 1;
                let near = |a: f32, b: f32, size: f32| (a - b).abs() <= 2e-3 * size;
                assert!(near(rows.range_m[row], splat.range_m, 1e-2), "{place}");
                assert!(near(rows.range_sigma_m[row], splat.range_sigma_m, 0.02));
                assert!(near(rows.energy[row], splat.energy, splat.energy));
                assert!(near(rows.elevation_rad[row], splat.elevation_rad, 1.0));
                assert!(near(rows.azimuth_rad[row], splat.azimuth_rad, 1e-2));
                assert!(near(rows.lever_m[row], splat.lever_m, 1e-2));
                assert!((rows.range_axis_of(row) - splat.range_axis).length() < 1e-5);
                assert!((rows.azimuth_axis_of(row) - splat.azimuth_axis).length() < 1e-5);
                let echo = splat.energy * gaussian.strength_seen(-splat.range_axis);
                assert!(near(rows.echo[row], echo, echo), "{place}");
            }
            assert!(count > 100, "{count}");
        }
    }

    #[test]
    fn echoes_spread_as_the_sum_of_each_by_itself() {
        for is_round in [true, false] {
            let mut heard = Heard::of(is_round, Level::new());
            let mut expected = vec![0.0; 500];
            for (place, gaussian) in heard.gaussians.iter().enumerate() {
                let Some(splat) = heard.splat(place) else {
                    continue;
                };
                let (bins, mut energies) = (heard.geometry.bins_of(&splat), Vec::new());
                heard.geometry.spread(&splat, bins.clone(), &mut energies);
                let strength = gaussian.strength_seen(-splat.range_axis);
                for (bin, energy) in bins.zip(energies) {
                    expected[bin] += strength * energy;
                }
            }
            let predicted = heard.predicted();
            let most = expected.iter().copied().fold(0.0, f32::max);
            let off = predicted.iter().zip(&expected).map(|(a, b)| (a - b).abs());
            let off = off.fold(0.0, f32::max);
            // Of shapes' widths a twentieth.
            let allowed = if is_round { 0.003 } else { 0.03 };
            assert!(off < allowed * most, "{off} of {most}");
            let sum = |power: &[f32]| power.iter().map(|&p| f64::from(p)).sum::<f64>();
            let (sum, expected) = (sum(&predicted), sum(&expected));
            assert!((sum / expected - 1.0).abs() < 2e-3, "{sum} {expected}");
        }
    }

    #[test]
    fn what_bins_say_comes_back_the_way_that_echoes_went() {
        // Of any numbers per bin: Σ_b x_b Î_b = Σ_i e_i (Σ_b K_i(b) x_b).
        for is_round in [true, false] {
            let mut heard = Heard::of(is_round, Level::new());
            let predicted = heard.predicted();
            let x: Vec<f32> = (0..500)
                .map(|bin| 1.5 + (bin as f32 * 0.37).sin())
                .collect();
            let mut gathered = Vec::new();
            dispatch!(Level::new(), simd => {
                heard.pulses.gather(simd, Weighted::Energy, &x, &mut gathered);
            });
            let there = predicted.iter().zip(&x);
            let there: f64 = there.map(|(&a, &b)| f64::from(a) * f64::from(b)).sum();
            let rows = 0..heard.rows.len();
            let back = rows.map(|row| {
                let found = heard.rows.found(row, &gathered);
                f64::from(heard.rows.echo[row]) * f64::from(found)
            });
            let back: f64 = back.sum();
            assert!((there / back - 1.0).abs() < 1e-5, "{there} {back}");
        }
    }

    #[test]
    fn a_rows_own_bins_are_those_it_was_spread_over() {
        let geometry = geometry();
        // In the middle, and over either end of the ping.
        for range_m in [5.0, 0.305, 10.29] {
            let mut alone = gaussians(&geometry, true)[0];
            alone.mean_m = geometry.pose.position_m + geometry.pose.axes * Vec3::X * range_m;
            let mut heard = hear(geometry, vec![alone], Some(ROUND_M), Level::new());
            assert!(heard.rows.len() == 1 && heard.rows.energy[0] > 0.0);
            let predicted = heard.predicted();
            let (bins, shares) = heard.pulses.echo_of(&heard.rows, 0);
            let echo = heard.rows.echo[0];
            for (bin, &power) in predicted.iter().enumerate() {
                let own = bins.contains(&bin).then(|| shares[bin - bins.start]);
                let off = (own.unwrap_or(0.0) * echo - power).abs();
                assert!(off < 0.02 * echo, "{bin}: {own:?} {power}");
            }
        }
    }

    #[test]
    fn levels_of_one_kind_hear_the_same_bits() {
        let of = |level: Level| {
            let mut heard = Heard::of(false, level);
            let mut bits: Vec<u32> = heard.predicted().iter().map(|p| p.to_bits()).collect();
            let rows = 0..heard.rows.len();
            bits.extend(rows.map(|row| heard.rows.echo[row].to_bits()));
            bits
        };
        assert!(lanes::avx2().is_none_or(|avx2| of(avx2) == of(Level::new())));
    }
}
