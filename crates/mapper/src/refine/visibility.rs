//! Which Gaussians a ping hears, where and how strongly, and what its bins say of each.
//!
//! Cost of a ping: one test for each Gaussian of the blocks in its fan, four for one heard; two sums and two look-ups for each
//! heard, and convolutions of its bins.

use echosplat_measurement::PingGeometry;
use echosplat_measurement::heard::{
    Bins, Detail, Hearing, Moments, PoseScore, Pulses, Rows, Run, View,
};
use echosplat_measurement::lanes::LANES;
use echosplat_measurement::pulse::GROUP;
use echosplat_measurement::simd_level;
use fearless_simd::dispatch;

use crate::accumulate::fan::Fan;
use crate::accumulate::history::{FAN_SIGMAS, Keyframe};
use crate::detect::bin_state::BinState;
use crate::features::Extent;
use crate::refine::field::Field;
use crate::refine::terms::PassTerms;

/// Everything one ping hears, and what it should measure. Reused from ping to ping.
#[derive(Debug, Default)]
pub(crate) struct Sight {
    /// Blocks that it may hear.
    near: Vec<u32>,
    hearing: Hearing,
    /// Slots of the rows, in full detail.
    slots: Vec<u32>,
    /// Predicted intensity per bin, noise included; it goes on beyond the last bin.
    pub(crate) predicted: Vec<f32>,
    measured: Vec<f32>,
    /// Predicted without echoes.
    alone: Vec<f32>,
    /// Power of the noise.
    background: f32,
    /// What each bin counts: 0 in the blanking, little in a shadow, 0 beyond the last.
    pub(crate) bin_weight: Vec<f32>,
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

impl Sight {
    /// Fills in what `keyframe` hears of the field.
    pub(crate) fn observe(
        &mut self,
        keyframe: &Keyframe,
        terms: PassTerms,
        field: &Field,
        detail: Detail,
    ) {
        let geometry = match terms.is_blurred {
            true => keyframe.blurred_geometry(),
            false => keyframe.geometry,
        };
        self.listen(keyframe, terms);
        let view = View::of(&geometry, terms.at_work.elevation);
        field.in_fan(&keyframe.fan, &mut self.near);
        let near = field.members_of(&self.near);
        dispatch!(simd_level::level(), simd => {
            self.hearing.find(simd, &view, field.numbers(), near, detail);
            self.hearing.spread(simd, &mut self.predicted);
        });
        if detail == Detail::Full {
            let rows = &self.hearing.rows;
            let places = rows.place[..rows.len()].iter();
            self.slots.clear();
            self.slots
                .extend(places.map(|&place| field.slots()[place as usize]));
        }
    }

    /// Readies what `keyframe` would measure from elsewhere.
    fn listen_from(
        &mut self,
        keyframe: &Keyframe,
        geometry: &PingGeometry,
        terms: PassTerms,
        field: &Field,
    ) -> View {
        self.listen(keyframe, terms);
        self.alone.clear();
        self.alone.extend(&self.predicted);
        field.in_fan(&Fan::of(geometry, FAN_SIGMAS), &mut self.near);
        View::of(geometry, terms.at_work.elevation)
    }

    /// Log likelihood of a ping above that without echoes, were it heard from elsewhere, nats, with heavy tails.
    pub(crate) fn gain_of_pose(
        &mut self,
        keyframe: &Keyframe,
        geometry: &PingGeometry,
        terms: PassTerms,
        field: &Field,
    ) -> f64 {
        let view = self.listen_from(keyframe, geometry, terms, field);
        let near = field.members_of(&self.near);
        dispatch!(simd_level::level(), simd => {
            self.hearing.find(simd, &view, field.numbers(), near, Detail::Strength);
            self.hearing.spread(simd, &mut self.predicted);
        });
        bins_of(&self.predicted, &self.measured, &self.bin_weight).gain_nats(&self.alone)
    }

    /// What the bins of `keyframe` say of its pose, were it heard from elsewhere and the map that much louder.
    pub(crate) fn score_pose(
        &mut self,
        keyframe: &Keyframe,
        geometry: &PingGeometry,
        louder_ln: f64,
        terms: PassTerms,
        field: &Field,
    ) -> PoseScore {
        let view = self.listen_from(keyframe, geometry, terms, field);
        let near = field.members_of(&self.near);
        let louder = louder_ln.exp() as f32;
        dispatch!(simd_level::level(), simd => {
            self.hearing.find(simd, &view, field.numbers(), near, Detail::Full);
            self.hearing.rows.echo.iter_mut().for_each(|echo| *echo *= louder);
            self.hearing.spread(simd, &mut self.predicted);
            let bins = bins_of(&self.predicted, &self.measured, &self.bin_weight);
            self.hearing.tell_pose(simd, &view, bins, &self.alone)
        })
    }

    /// What the ping measured, and the noise it has to be told from.
    fn listen(&mut self, keyframe: &Keyframe, terms: PassTerms) {
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
        let dark = match terms.at_work.empty {
            Extent::None => 0.0,
            _ => 1.0,
        };
        let weights = [0, 1, 2, 3].map(|bits| weight_of(BinState::of_bits(bits), dark));
        profile.state.expand(weights, &mut self.bin_weight);
        self.bin_weight.resize(padded, 0.0);
    }

    pub(crate) fn rows(&self) -> &Rows {
        &self.hearing.rows
    }

    /// Rows of each block.
    pub(crate) fn runs(&self) -> &[Run] {
        self.hearing.runs()
    }

    /// Of a row, in full detail.
    pub(crate) fn slot(&self, row: usize) -> usize {
        self.slots[row] as usize
    }

    /// Of a run those that the ping hears.
    pub(crate) fn heard_of(&self, run: &Run) -> impl Iterator<Item = usize> + '_ {
        self.hearing.heard(run.rows())
    }

    /// Those that the ping hears.
    pub(crate) fn heard(&self) -> impl Iterator<Item = usize> + '_ {
        self.hearing.heard(0..self.rows().len())
    }

    pub(crate) fn pulses(&self) -> &Pulses {
        &self.hearing.pulses
    }

    /// `w/Î` and `w·I/Î²` of the bins around each place of an echo, as counts `w` and `w·I/Î`: with the row's energy
    /// its denominator and its numerator.
    pub(crate) fn against_prediction(&mut self, is_speckled: bool) {
        let bins = bins_of(&self.predicted, &self.measured, &self.bin_weight);
        dispatch!(simd_level::level(), simd => self.hearing.tell_strengths(simd, bins, is_speckled));
    }

    /// What [`Self::against_prediction`] found, by place of an echo.
    pub(crate) fn against(&self) -> [&[f32]; 2] {
        self.hearing.strengths()
    }

    /// Readies the moments of all rows.
    pub(crate) fn find_moments(&mut self) {
        let bins = bins_of(&self.predicted, &self.measured, &self.bin_weight);
        dispatch!(simd_level::level(), simd => self.hearing.tell_moments(simd, bins));
    }

    /// Of a row, once they are found.
    pub(crate) fn moments(&self, row: usize) -> Moments {
        self.hearing.moments(row)
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

    /// Log likelihood of what was measured above that of noise and ground alone, nats, and the bins that count; each says at
    /// most what [`Self::log_likelihood`] lets it.
    pub(crate) fn gain_over_noise(&self, keyframe: &Keyframe) -> (f64, u64) {
        let ground = keyframe.profile.ground.iter();
        let ground = ground.chain(std::iter::repeat(0.0));
        let bins = self.predicted.iter().zip(&self.measured);
        let (mut gain_nats, mut count) = (0.0, 0);
        for ((&with, &measured), (&weight, ground)) in bins.zip(self.bin_weight.iter().zip(ground))
        {
            if weight > 0.0 {
                let alone = self.background + ground;
                let over = |expected: f32| (measured / expected).min(MOST_OVER);
                gain_nats += f64::from(weight * ((alone / with).ln() + over(alone) - over(with)));
                count += 1;
            }
        }
        (gain_nats, count)
    }

    /// Gaussian–bin pairs in this ping: the unit of work.
    pub(crate) fn pair_count(&self) -> u64 {
        self.hearing.pulses.pair_count()
    }

    /// Gaussians in this ping.
    pub(crate) fn row_count(&self) -> u64 {
        self.rows().len() as u64
    }
}

fn bins_of<'a>(predicted: &'a [f32], measured: &'a [f32], weight: &'a [f32]) -> Bins<'a> {
    Bins {
        predicted,
        measured,
        weight,
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
