//! Which Gaussians a ping hears, where and how strongly, and what its bins say of each.
//!
//! Cost of a ping: one test for each Gaussian of the blocks in its fan, four for one heard; two sums and two look-ups for each
//! heard, and convolutions of its bins.

use std::ops::Range;

use echosplat_acoustics::heard::{self, Detail, Pulses, Rows, View};
use echosplat_acoustics::lanes::LANES;
use echosplat_acoustics::pulse::{GROUP, Weighted};
use echosplat_acoustics::simd_level;
use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x8};

use crate::accumulate::history::Keyframe;
use crate::detect::bin_state::BinState;
use crate::features::Extent;
use crate::refine::field::Field;
use crate::refine::scene::Scene;

/// Everything one ping hears, and what it should measure. Reused from ping to ping.
#[derive(Debug, Default)]
pub(crate) struct Sight {
    /// Blocks that it may hear.
    near: Vec<u32>,
    /// Places by size, those with shapes last.
    places: Vec<Vec<u32>>,
    /// Rows of each block, in order of size.
    runs: Vec<Run>,
    rows: Rows,
    pulses: Pulses,
    /// Slots of the rows, in full detail.
    slots: Vec<u32>,
    /// Predicted intensity per bin, noise included; it goes on beyond the last bin.
    pub(crate) predicted: Vec<f32>,
    measured: Vec<f32>,
    /// Power of the noise.
    background: f32,
    /// What each bin counts: 0 in the blanking, little in a shadow, 0 beyond the last.
    pub(crate) bin_weight: Vec<f32>,
    /// Numbers per bin, and what echoes find of them at their places.
    of_bins: Vec<f32>,
    gathered: [Vec<f32>; 5],
}

/// Rows of one block.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Run {
    size: usize,
    /// The block, where its Gaussians' places begin, and how many they are.
    pub(crate) block: u32,
    first_place: u32,
    pub(crate) count: usize,
    first_row: usize,
    end_row: usize,
}

impl Run {
    pub(crate) fn rows(&self) -> Range<usize> {
        self.first_row..self.end_row
    }

    /// Which of the block's Gaussians the one at this place is.
    #[inline(always)]
    pub(crate) fn within(&self, place: u32) -> usize {
        (place - self.first_place) as usize
    }
}

/// What is summed up of bins.
#[derive(Debug, Clone, Copy)]
enum Told {
    /// `w/Î`.
    Share,
    /// `w·I/Î²`.
    Numerator,
    /// `w`: as counts.
    CountsShare,
    /// `w·I/Î`.
    CountsNumerator,
    /// `w/Î²`.
    Square,
    /// `w·ε/Î`, ε held within −1 to 3: one wild bin must not carry a Gaussian away.
    Residual,
}

impl Told {
    #[inline(always)]
    fn of<S: Simd>(self, predicted: f32x8<S>, weight: f32x8<S>, measured: f32x8<S>) -> f32x8<S> {
        match self {
            Self::Share => weight / predicted,
            Self::Numerator => weight / predicted * measured / predicted,
            Self::CountsShare => weight,
            Self::CountsNumerator => weight * measured / predicted,
            Self::Square => weight / (predicted * predicted),
            Self::Residual => (measured / predicted - 1.0).max(-1.0).min(3.0) * weight / predicted,
        }
    }
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
    /// Fills in what `keyframe` hears of the scene.
    pub(crate) fn observe(
        &mut self,
        keyframe: &Keyframe,
        scene: Scene<'_>,
        field: &Field,
        detail: Detail,
    ) {
        let geometry = match scene.is_blurred {
            true => keyframe.blurred_geometry(),
            false => keyframe.geometry,
        };
        self.listen(keyframe, scene);
        let view = View::of(&geometry, scene.at_work.elevation);
        field.in_fan(&keyframe.fan, &mut self.near);
        dispatch!(simd_level::level(), simd => {
            self.find(simd, &view, field, detail);
            self.pulses.spread(simd, &self.rows, &mut self.predicted);
        });
    }

    /// What the ping measured, and the noise it has to be told from.
    fn listen(&mut self, keyframe: &Keyframe, scene: Scene<'_>) {
        let profile = &keyframe.profile;
        let padded = (profile.intensity.len() + LANES).next_multiple_of(GROUP);
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
        let weights = [0, 1, 2, 3].map(|bits| weight_of(BinState::of_bits(bits), dark));
        profile.state.expand(weights, &mut self.bin_weight);
        self.bin_weight.resize(padded, 0.0);
    }

    #[inline(always)]
    fn find<S: Simd>(&mut self, simd: S, view: &View, field: &Field, detail: Detail) {
        let (numbers, sizes_m) = (field.numbers(), field.sizes_m());
        self.places.resize_with(sizes_m.len() + 1, Vec::new);
        self.places.iter_mut().for_each(Vec::clear);
        self.runs.clear();
        for &block in &self.near {
            let (members, size) = field.block(block);
            let places = &mut self.places[size];
            let first_row = places.len();
            heard::cull(simd, view, numbers, members, places);
            if places.len() > first_row {
                self.runs.push(Run {
                    size,
                    block,
                    first_place: members.places.start as u32,
                    count: members.places.len(),
                    first_row,
                    end_row: places.len(),
                });
            }
        }
        let mut first_row = 0;
        for (size, places) in self.places.iter().enumerate() {
            for run in self.runs.iter_mut().filter(|run| run.size == size) {
                run.first_row += first_row;
                run.end_row += first_row;
            }
            first_row += places.len();
        }
        let count = self.places.iter().map(Vec::len).sum();
        heard::begin(view, count, detail, &mut self.rows, &mut self.pulses);
        for (size, places) in self.places.iter().enumerate() {
            let into = (&mut self.rows, &mut self.pulses);
            match sizes_m.get(size) {
                Some(&sigma_m) => {
                    heard::project_round(simd, view, numbers, sigma_m, places, detail, into);
                }
                None => heard::project_shaped(simd, view, numbers, places, detail, into),
            }
        }
        if detail == Detail::Full {
            let places = self.rows.place[..self.rows.len()].iter();
            self.slots.clear();
            self.slots
                .extend(places.map(|&place| field.slots()[place as usize]));
        }
    }

    pub(crate) fn rows(&self) -> &Rows {
        &self.rows
    }

    /// Rows of each block.
    pub(crate) fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// Of a row, in full detail.
    pub(crate) fn slot(&self, row: usize) -> usize {
        self.slots[row] as usize
    }

    /// Of a run those that the ping hears.
    pub(crate) fn heard_of(&self, run: &Run) -> impl Iterator<Item = usize> + '_ {
        run.rows().filter(|&row| self.rows.energy[row] > 0.0)
    }

    /// Those that the ping hears.
    pub(crate) fn heard(&self) -> impl Iterator<Item = usize> + '_ {
        let rows = 0..self.rows.len();
        rows.filter(|&row| self.rows.energy[row] > 0.0)
    }

    pub(crate) fn pulses(&self) -> &Pulses {
        &self.pulses
    }

    /// `w/Î` and `w·I/Î²` of the bins around each place of an echo, as counts `w` and `w·I/Î`: with the row's energy
    /// its denominator and its numerator.
    pub(crate) fn against_prediction(&mut self, is_speckled: bool) {
        dispatch!(simd_level::level(), simd => match is_speckled {
            true => {
                self.compare(simd, Told::Share, &[(Weighted::Energy, 0)]);
                self.compare(simd, Told::Numerator, &[(Weighted::Energy, 1)]);
            }
            false => {
                self.compare(simd, Told::CountsShare, &[(Weighted::Energy, 0)]);
                self.compare(simd, Told::CountsNumerator, &[(Weighted::Energy, 1)]);
            }
        });
    }

    /// What [`Self::against_prediction`] found, by place of an echo.
    pub(crate) fn against(&self) -> [&[f32]; 2] {
        let [share, numerator, ..] = &self.gathered;
        [share, numerator]
    }

    /// Sums up what is told of each bin around each place of an echo, weighted in one way or more.
    #[inline(always)]
    fn compare<S: Simd>(&mut self, simd: S, told: Told, ways: &[(Weighted, usize)]) {
        self.of_bins.resize(self.predicted.len(), 0.0);
        let inputs = self
            .predicted
            .chunks_exact(LANES)
            .zip(self.bin_weight.chunks_exact(LANES));
        let inputs = inputs.zip(self.measured.chunks_exact(LANES));
        let outputs = self.of_bins.chunks_exact_mut(LANES);
        for (output, ((predicted, weight), measured)) in outputs.zip(inputs) {
            let predicted = f32x8::from_slice(simd, predicted);
            let weight = f32x8::from_slice(simd, weight);
            let measured = f32x8::from_slice(simd, measured);
            told.of(predicted, weight, measured).store_slice(output);
        }
        for &(weighted, which) in ways {
            let gathered = &mut self.gathered[which];
            self.pulses.gather(simd, weighted, &self.of_bins, gathered);
        }
    }

    /// Readies the moments of all rows.
    pub(crate) fn find_moments(&mut self) {
        let squares = [
            (Weighted::Square, 0),
            (Weighted::SquareTilt, 1),
            (Weighted::SquareBend, 2),
        ];
        let residuals = [(Weighted::Energy, 3), (Weighted::Slope, 4)];
        dispatch!(simd_level::level(), simd => {
            self.compare(simd, Told::Square, &squares);
            self.compare(simd, Told::Residual, &residuals);
        });
    }

    /// Of a row, once they are found.
    pub(crate) fn moments(&self, row: usize) -> Moments {
        let echo = self.rows.echo[row];
        let found = |of: &Vec<f32>| self.rows.found(row, of);
        let [flat, tilt, bend, residual, slope] = &self.gathered;
        Moments {
            square: [flat, tilt, bend].map(|sum| found(sum) * echo * echo),
            residual: [residual, slope].map(|sum| found(sum) * echo),
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
        self.pulses.pair_count()
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
