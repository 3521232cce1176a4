//! What the bins of a ping say of each Gaussian heard in it: sums of the multiplicative step, score and Fisher information.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use glam::Vec3;

use super::hearing::Hearing;
use super::rows::Rows;
use crate::SymmetricMat3;
use crate::lanes::LANES;
use crate::pulse::Weighted;

/// A ping's bins, shape `[bins]` each, with as much room beyond as [`Hearing::spread`] wants, where they count nothing.
#[derive(Debug, Clone, Copy)]
pub struct Bins<'a> {
    /// Power, noise included: above 0.
    pub predicted: &'a [f32],
    /// Power.
    pub measured: &'a [f32],
    /// What each counts, 0 to 1; 0 beyond the last.
    pub weight: &'a [f32],
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

/// What bins told, by place of an echo among the steps of its pulse.
#[derive(Debug, Default)]
pub(super) struct Gathered {
    of_bins: Vec<f32>,
    by_step: [Vec<f32>; 5],
}

/// Sums over the bins of a row, with `e = Î_row/Î` the row's fraction of a bin, `z` the bin's middle in sigmas
/// from the row's mean, and `ε` what was measured over what was predicted, less 1.
#[derive(Debug, Clone, Copy, Default)]
pub struct Moments {
    /// `Σ w e²`, `Σ w e² z`, `Σ w e² z²`.
    pub square: [f32; 3],
    /// `Σ w e ε`, `Σ w e ε z`, ε held within −1 to 3.
    pub residual: [f32; 2],
}

/// Score and Fisher information: gradient and expected curvature of the log likelihood by the mean of one Gaussian, and what
/// the gradient changes by were all echoes a metre nearer, 1/m².
#[derive(Debug, Clone, Copy, Default)]
pub struct Score {
    /// 1/m, world axes.
    pub gradient: Vec3,
    /// 1/m², world axes.
    pub information: SymmetricMat3,
    /// 1/m², world axes.
    pub nearer: Vec3,
}

impl Score {
    /// Adds a row of the system matrix, told in full detail: a mean moves its echo in range and across the beam.
    pub fn add(&mut self, rows: &Rows, row: usize, moments: &Moments, weight: f32) {
        let lever = rows.azimuth_variance_rad2[row] * rows.lever_m[row];
        let by_sigma = rows.range_sigma_m[row].recip();
        let across = rows.azimuth_axis_of(row) * (-rows.azimuth_rad[row] / lever);
        let along = rows.range_axis_of(row) * by_sigma;
        let [flat, tilt, bend] = moments.square.map(|sum| weight * sum);
        let [residual, slope] = moments.residual.map(|sum| weight * sum);
        self.gradient += along * slope + across * residual;
        let (by_along, by_across) = (along * bend + across * tilt, along * tilt + across * flat);
        self.nearer -= by_along * by_sigma;
        let information = &mut self.information;
        information.diagonal += by_along * along + by_across * across;
        information.mixed += Vec3::new(
            by_along.y * along.z + by_across.y * across.z,
            by_along.x * along.z + by_across.x * across.z,
            by_along.x * along.y + by_across.x * across.y,
        );
    }
}

impl Hearing {
    /// Readies `w/Î` and `w·I/Î²` around each place of an echo, as counts `w` and `w·I/Î`: with the row's energy its
    /// denominator and its numerator.
    #[inline(always)]
    pub fn tell_strengths<S: Simd>(&mut self, simd: S, bins: Bins<'_>, is_speckled: bool) {
        let [share, numerator] = match is_speckled {
            true => [Told::Share, Told::Numerator],
            false => [Told::CountsShare, Told::CountsNumerator],
        };
        self.tell(simd, bins, share, &[(Weighted::Energy, 0)]);
        self.tell(simd, bins, numerator, &[(Weighted::Energy, 1)]);
    }

    /// What [`Self::tell_strengths`] found, denominators and numerators, for [`Rows::found`].
    #[must_use]
    pub fn strengths(&self) -> [&[f32]; 2] {
        let [share, numerator, ..] = &self.gathered.by_step;
        [share, numerator]
    }

    /// Readies the moments of all rows.
    #[inline(always)]
    pub fn tell_moments<S: Simd>(&mut self, simd: S, bins: Bins<'_>) {
        let squares = [
            (Weighted::Square, 0),
            (Weighted::SquareTilt, 1),
            (Weighted::SquareBend, 2),
        ];
        let residuals = [(Weighted::Energy, 3), (Weighted::Slope, 4)];
        self.tell(simd, bins, Told::Square, &squares);
        self.tell(simd, bins, Told::Residual, &residuals);
    }

    /// Of a row, once they are told.
    #[must_use]
    pub fn moments(&self, row: usize) -> Moments {
        let echo = self.rows.echo[row];
        let found = |of: &Vec<f32>| self.rows.found(row, of);
        let [flat, tilt, bend, residual, slope] = &self.gathered.by_step;
        Moments {
            square: [flat, tilt, bend].map(|sum| found(sum) * echo * echo),
            residual: [residual, slope].map(|sum| found(sum) * echo),
        }
    }

    /// Sums up what is told of each bin around each place of an echo, weighted in one way or more.
    #[inline(always)]
    fn tell<S: Simd>(&mut self, simd: S, bins: Bins<'_>, told: Told, ways: &[(Weighted, usize)]) {
        let Gathered { of_bins, by_step } = &mut self.gathered;
        of_bins.resize(bins.predicted.len(), 0.0);
        let weights = bins.weight.chunks_exact(LANES);
        let inputs = bins.predicted.chunks_exact(LANES).zip(weights);
        let inputs = inputs.zip(bins.measured.chunks_exact(LANES));
        for (output, ((predicted, weight), measured)) in of_bins.chunks_exact_mut(LANES).zip(inputs)
        {
            let predicted = f32x8::from_slice(simd, predicted);
            let weight = f32x8::from_slice(simd, weight);
            let measured = f32x8::from_slice(simd, measured);
            told.of(predicted, weight, measured).store_slice(output);
        }
        for &(weighted, which) in ways {
            self.pulses
                .gather(simd, weighted, of_bins, &mut by_step[which]);
        }
    }
}
