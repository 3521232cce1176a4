//! What is kept of each Gaussian that a ping hears.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use glam::Vec3;

use super::footprint::Eight;
use super::view::View;
use crate::lanes::LANES;

/// How much is told of each Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// Where and how strongly it is heard, and from which direction.
    Strength,
    /// All of it.
    Full,
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
    pub(super) width: Vec<u32>,
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
    /// Numbers told in any detail.
    fn brief(&mut self) -> [&mut Vec<f32>; 6] {
        let [x, y, z] = &mut self.range_axis;
        [
            &mut self.energy,
            &mut self.echo,
            &mut self.fraction,
            x,
            y,
            z,
        ]
    }

    /// Those told in full detail beside them.
    fn full(&mut self) -> [&mut Vec<f32>; 9] {
        let [x, y, z] = &mut self.azimuth_axis;
        [
            &mut self.range_m,
            &mut self.range_sigma_m,
            &mut self.azimuth_rad,
            &mut self.elevation_rad,
            &mut self.azimuth_variance_rad2,
            &mut self.lever_m,
            x,
            y,
            z,
        ]
    }

    /// Makes room for so many, and eight more.
    pub(super) fn begin(&mut self, count: usize, detail: Detail) {
        self.count = 0;
        let room = count + LANES;
        for numbers in self.brief() {
            numbers.resize(room.max(numbers.len()), 0.0);
        }
        for numbers in [&mut self.place, &mut self.at] {
            numbers.resize(room.max(numbers.len()), 0);
        }
        if detail == Detail::Full {
            for numbers in self.full() {
                numbers.resize(room.max(numbers.len()), 0.0);
            }
            self.width.resize(room.max(self.width.len()), 0);
        }
    }

    /// Appends eight, of which the first `eight.count` are meant.
    #[inline(always)]
    pub(super) fn append<S: Simd>(&mut self, view: &View, eight: &Eight<S>, detail: Detail) {
        let from = self.count;
        let [rx, ry, rz] = eight.beamed.range_axis;
        let heard = &eight.heard;
        self.place[from..from + LANES].copy_from_slice(&eight.places);
        self.at[from..from + LANES].copy_from_slice(&heard.at);
        let brief = [eight.energy, eight.echo, heard.fraction, rx, ry, rz];
        for (numbers, vector) in self.brief().into_iter().zip(brief) {
            put(vector, numbers, from);
        }
        if detail == Detail::Full {
            self.width[from..from + LANES].copy_from_slice(&heard.width);
            let (beamed, extent) = (&eight.beamed, &eight.extent);
            let [ax, ay, az] = view.ping.azimuth_axis(&beamed.place);
            let full = [
                extent.mean_range_m,
                heard.range_sigma_m,
                beamed.azimuth,
                beamed.elevation,
                extent.total,
                beamed.place.lever_m,
                ax,
                ay,
                az,
            ];
            for (numbers, vector) in self.full().into_iter().zip(full) {
                put(vector, numbers, from);
            }
        }
        self.count += eight.count;
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
