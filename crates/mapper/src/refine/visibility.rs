//! Which Gaussians a ping sees, and how much of each falls into which bin: its rows of the
//! system matrix A of the measurement.
//!
//! Cost of a ping: one test for each Gaussian of the blocks in its fan, four for one seen; all in all 60 ns a Gaussian seen
//! and 3 ns a pair, on one core of a shared server.

use std::ops::Range;

use echosplat_acoustics::PingGeometry;
use echosplat_acoustics::lanes::{self, LANES};
use echosplat_acoustics::packed::{self, MatrixRow, View};
use echosplat_acoustics::simd_level;
use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x8};

use crate::accumulate::history::Keyframe;
use crate::detect::bin_state::BinState;
use crate::features::Extent;
use crate::refine::field::Field;
use crate::refine::scene::Scene;

/// Everything one ping sees, and what it should measure. Reused from ping to ping.
#[derive(Debug, Default)]
pub(crate) struct Sight {
    near: Vec<Range<usize>>,
    places: Vec<u32>,
    rows: Vec<MatrixRow>,
    /// Per row and bin; each row's are filled up with zeros to eights.
    energies: Vec<f32>,
    pair_count: u64,
    /// Predicted intensity per bin, noise included; it goes on beyond the last bin.
    pub(crate) predicted: Vec<f32>,
    measured: Vec<f32>,
    /// Power of the noise.
    background: f32,
    /// What each bin counts: 0 in the blanking, little in a shadow, 0 beyond the last.
    pub(crate) bin_weight: Vec<f32>,
    /// `w/Î` and `w·I/Î²` per bin, as counts `w` and `w·I/Î`: what a row's energies are summed with.
    share: Vec<f32>,
    numerator: Vec<f32>,
}

/// Nats; found.
/// Most that one bin says for or against an echo, since the model of it may be wrong.
const MOST_ODDS_OF_BIN: f32 = 3.0;

/// Ratio of power; found.
/// Most that one bin may be louder than predicted, so that one wild bin does not decide.
const MOST_OVER: f32 = 30.0;

/// Fraction; found.
/// Darkness behind an echo may be its shadow and counts this little.
const SHADOWED_WEIGHT: f32 = 0.15;

/// `Σ A·w/Î` and `Σ A·w·I/Î²` over the bins of a row.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Against {
    pub(crate) share: f32,
    pub(crate) numerator: f32,
}

/// Sums over the bins of a row, with `e = Î_row/Î` the row's fraction of a bin, `z` the bin's middle in sigmas
/// from the row's mean, and `ε` what was measured over what was predicted, less 1.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Moments {
    /// `Σ w e²`, `Σ w e² z`, `Σ w e² z²`.
    pub(crate) square: [f32; 3],
    /// `Σ w e ε`, `Σ w e ε z`, ε held within −1 to 3: one wild bin must not carry a Gaussian away.
    pub(crate) residual: [f32; 2],
}

impl Sight {
    /// Fills in what `keyframe` sees of the scene.
    pub(crate) fn observe(&mut self, keyframe: &Keyframe, scene: Scene<'_>, field: &Field) {
        let geometry = match scene.is_blurred {
            true => keyframe.blurred_geometry(),
            false => keyframe.geometry,
        };
        self.listen(keyframe, scene);
        let view = View::of(&geometry, scene.at_work.elevation);
        field.in_fan(&keyframe.fan, &mut self.near);
        dispatch!(simd_level::level(), simd => {
            self.find(simd, &view, field);
            self.spread(simd, &geometry);
            self.compare(simd, scene.at_work.speckle);
        });
    }

    /// What the ping measured, and the noise it has to be told from.
    fn listen(&mut self, keyframe: &Keyframe, scene: Scene<'_>) {
        let profile = &keyframe.profile;
        let padded = (profile.intensity.len() + LANES).next_multiple_of(LANES);
        self.predicted.clear();
        self.background = profile.background;
        self.predicted.resize(padded, self.background);
        for (predicted, ground) in self.predicted.iter_mut().zip(profile.ground.iter()) {
            *predicted += ground;
        }
        self.measured.clear();
        self.measured.extend(profile.intensity.iter());
        self.measured.resize(padded, 0.0);
        self.bin_weight.clear();
        let dark = match scene.at_work.empty {
            Extent::None => 0.0,
            _ => 1.0,
        };
        let weights = profile.state.iter().map(|state| weight_of(state, dark));
        self.bin_weight.extend(weights);
        self.bin_weight.resize(padded, 0.0);
    }

    #[inline(always)]
    fn find<S: Simd>(&mut self, simd: S, view: &View, field: &Field) {
        let (numbers, slots) = (field.numbers(), field.slots());
        self.places.clear();
        self.rows.clear();
        for members in &self.near {
            packed::cull(simd, view, numbers, members.clone(), &mut self.places);
        }
        packed::project(simd, view, numbers, slots, &self.places, &mut self.rows);
    }

    /// Energies of all rows, and their sum.
    #[inline(always)]
    fn spread<S: Simd>(&mut self, simd: S, geometry: &PingGeometry) {
        let mut end = 0;
        self.pair_count = 0;
        for row in &mut self.rows {
            row.energies_from = end as u32;
            end += row.bins.len().next_multiple_of(LANES);
            self.pair_count += row.bins.len() as u64;
        }
        // What is left of the ping before is written over.
        self.energies.resize(end, 0.0);
        for row in &self.rows {
            let bins = row.bins.start as usize..row.bins.end as usize;
            let padded = bins.len().next_multiple_of(LANES);
            let from = row.energies_from as usize;
            let into = (
                &mut self.energies[from..from + padded],
                &mut self.predicted[bins.start..bins.start + padded],
            );
            geometry.spread_into(simd, &row.splat, bins, row.strength, into);
        }
    }

    #[inline(always)]
    fn compare<S: Simd>(&mut self, simd: S, is_speckled: bool) {
        let count = self.predicted.len();
        self.share.resize(count, 0.0);
        self.numerator.resize(count, 0.0);
        let outputs = self
            .share
            .chunks_exact_mut(LANES)
            .zip(self.numerator.chunks_exact_mut(LANES));
        let inputs = self
            .predicted
            .chunks_exact(LANES)
            .zip(self.bin_weight.chunks_exact(LANES));
        let inputs = inputs.zip(self.measured.chunks_exact(LANES));
        for ((share, numerator), ((predicted, weight), measured)) in outputs.zip(inputs) {
            let predicted = f32x8::from_slice(simd, predicted);
            let weight = f32x8::from_slice(simd, weight);
            let weighted = match is_speckled {
                true => weight / predicted,
                false => weight,
            };
            weighted.store_slice(share);
            let ratio = weighted * f32x8::from_slice(simd, measured) / predicted;
            ratio.store_slice(numerator);
        }
    }

    pub(crate) fn rows(&self) -> &[MatrixRow] {
        &self.rows
    }

    /// Energy of a row per bin of `row.bins`, for strength 1.
    pub(crate) fn energies(&self, row: &MatrixRow) -> &[f32] {
        let from = row.energies_from as usize;
        &self.energies[from..from + row.bins.len()]
    }

    /// Each row against what the ping measured, in the rows' order.
    pub(crate) fn against_prediction(&self, against: &mut Vec<Against>) {
        against.clear();
        dispatch!(simd_level::level(), simd => self.against(simd, against));
    }

    #[inline(always)]
    fn against<S: Simd>(&self, simd: S, against: &mut Vec<Against>) {
        for row in &self.rows {
            let zero = f32x8::splat(simd, 0.0);
            let (mut share, mut numerator) = (zero, zero);
            let (energies, bins) = self.eights(row);
            let shares = self.share[bins.clone()].chunks_exact(LANES);
            let numerators = self.numerator[bins].chunks_exact(LANES);
            for (energy, (shares, numerators)) in
                energies.chunks_exact(LANES).zip(shares.zip(numerators))
            {
                let energy = f32x8::from_slice(simd, energy);
                share = energy.mul_add(f32x8::from_slice(simd, shares), share);
                numerator = energy.mul_add(f32x8::from_slice(simd, numerators), numerator);
            }
            against.push(Against {
                share: share.reduce_sum(),
                numerator: numerator.reduce_sum(),
            });
        }
    }

    /// Energies of a row filled up to eights, and as many bins.
    #[inline(always)]
    fn eights(&self, row: &MatrixRow) -> (&[f32], Range<usize>) {
        let padded = row.bins.len().next_multiple_of(LANES);
        let (from, first) = (row.energies_from as usize, row.bins.start as usize);
        (&self.energies[from..from + padded], first..first + padded)
    }

    /// Each row's moments, in the rows' order; `geometry` is any of the ping.
    pub(crate) fn moments(&self, geometry: &PingGeometry, moments: &mut Vec<Moments>) {
        moments.clear();
        dispatch!(simd_level::level(), simd => {
            for row in &self.rows {
                moments.push(self.moments_of(simd, geometry, row));
            }
        });
    }

    #[inline(always)]
    fn moments_of<S: Simd>(&self, simd: S, geometry: &PingGeometry, row: &MatrixRow) -> Moments {
        let numbers = lanes::lane_numbers(simd);
        let zero = f32x8::splat(simd, 0.0);
        let [mut flat, mut tilt, mut bend, mut residual, mut slope] = [zero; 5];
        let (energies, bins) = self.eights(row);
        let by_sigma = 1.0 / row.splat.range_sigma_m;
        let middle_m = geometry.range_start_m + geometry.bin_length_m * (bins.start as f32 + 0.5);
        let mut first_z = (middle_m - row.splat.range_m) * by_sigma;
        let step = geometry.bin_length_m * by_sigma;
        let predicted = self.predicted[bins.clone()].chunks_exact(LANES);
        let weights = self.bin_weight[bins.clone()].chunks_exact(LANES);
        let measured = self.measured[bins].chunks_exact(LANES);
        let bins = predicted.zip(weights.zip(measured));
        for (energy, (predicted, (weight, measured))) in energies.chunks_exact(LANES).zip(bins) {
            let predicted = f32x8::from_slice(simd, predicted);
            let weight = f32x8::from_slice(simd, weight);
            let z = numbers.mul_add(step, f32x8::splat(simd, first_z));
            let part = f32x8::from_slice(simd, energy) * row.strength / predicted;
            let off = f32x8::from_slice(simd, measured) / predicted - 1.0;
            let off = off.max(-1.0).min(3.0) * part * weight;
            let square = part * part * weight;
            flat += square;
            tilt = square.mul_add(z, tilt);
            bend = (square * z).mul_add(z, bend);
            residual += off;
            slope = off.mul_add(z, slope);
            first_z += step * LANES as f32;
        }
        Moments {
            square: [flat.reduce_sum(), tilt.reduce_sum(), bend.reduce_sum()],
            residual: [residual.reduce_sum(), slope.reduce_sum()],
        }
    }

    /// Log likelihood ratio of a bin with all that is predicted, against without `energy` of it.
    pub(crate) fn odds(&self, bin: usize, energy: f32) -> f32 {
        let (with, measured) = (self.predicted[bin], self.measured[bin]);
        let without = (with - energy).clamp(self.background.min(with), with);
        let odds = (without / with).ln() + measured * (without.recip() - with.recip());
        self.bin_weight[bin] * odds.clamp(-MOST_ODDS_OF_BIN, MOST_ODDS_OF_BIN)
    }

    /// Log likelihood of what was measured, up to a constant; no bin says more than [`MOST_OVER`] times what was
    /// predicted.
    pub(crate) fn log_likelihood(&self) -> f64 {
        let bins = self
            .predicted
            .iter()
            .zip(&self.measured)
            .zip(&self.bin_weight);
        let of_bin = |((predicted, measured), weight): ((&f32, &f32), &f32)| {
            -f64::from(weight * (predicted.ln() + (measured / predicted).min(MOST_OVER)))
        };
        bins.map(of_bin).sum()
    }

    /// Gaussian–bin pairs in this ping: the unit of work.
    pub(crate) fn pair_count(&self) -> u64 {
        self.pair_count
    }
}

fn weight_of(state: BinState, dark: f32) -> f32 {
    match state {
        BinState::Blank => 0.0,
        BinState::Shadowed => SHADOWED_WEIGHT * dark,
        BinState::Dark => dark,
        BinState::Lit => 1.0,
    }
}
