//! Spread and gather: energies of echoes into the bins around them, and what bins say back to echoes.

use std::ops::Range;

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::rows::Rows;
use crate::lanes;
use crate::pulse::{GROUP, Pulse, Steps, Weighted};

/// Ratio of widths; grid.
/// Widths in range of Gaussians with a shape are rounded to powers of this.
const WIDTH_STEP: f32 = 1.1;
/// Pulses kept; bounds memory.
const MOST_PULSES: usize = 96;

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
    pub(super) fn begin(&mut self, bin_count: usize) {
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
    pub(super) fn width(&mut self, sigma_bins: f32) -> usize {
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

    /// The same of the width that is this power of [`WIDTH_STEP`], a whole number: see [`width_steps`].
    #[inline(always)]
    pub(super) fn rounded_width(&mut self, step: f32) -> usize {
        let step = step as i32;
        if let Some(&(_, known)) = self.by_width.iter().find(|(known, _)| *known == step) {
            return known;
        }
        let width = self.width(WIDTH_STEP.powi(step));
        self.by_width.push((step, width));
        width
    }

    /// Steps of one of the widths in use.
    #[inline(always)]
    pub(super) fn steps(&self, width: usize) -> Steps {
        self.steps[width]
    }

    /// Notes that echoes of this width lie in these groups of bins.
    #[inline(always)]
    pub(super) fn touch(&mut self, width: usize, touched: u64) {
        self.touched[width] |= touched;
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

    pub(super) fn count(&mut self, width: usize, echoes: usize) {
        let pulse = &self.pulses[self.steps[width].pulse as usize];
        self.pair_count += (echoes * pulse.width()) as u64;
    }

    /// Adds `echoes`, one for each row, to `predicted`, power per bin, with room for whole groups beyond the last bin.
    #[inline(always)]
    pub fn spread<S: Simd>(&mut self, simd: S, rows: &Rows, echoes: &[f32], predicted: &mut [f32]) {
        let end = self.steps.last().map_or(0, Steps::end);
        self.energies.clear();
        // The last group reads beyond the last step.
        self.energies.resize(end + GROUP, 0.0);
        let echoes = echoes.iter().zip(&rows.fraction);
        for (&at, (&echo, &fraction)) in rows.at[..rows.len()].iter().zip(echoes) {
            let beyond = echo * fraction;
            if let [before, next] = &mut self.energies[at as usize..at as usize + 2] {
                *before += echo - beyond;
                *next += beyond;
            }
        }
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

/// The powers of [`WIDTH_STEP`] that are next to some widths, bins.
#[inline(always)]
pub(super) fn width_steps<S: Simd>(sigma_bins: f32x8<S>) -> f32x8<S> {
    (lanes::ln(sigma_bins) * WIDTH_STEP.ln().recip() + 0.5).floor()
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
