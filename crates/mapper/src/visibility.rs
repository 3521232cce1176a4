//! Which Gaussians a ping sees, and how much of each falls into which bin: its rows of the
//! system matrix A of the measurement.

use std::ops::Range;

use echosplat_acoustics::{Look, Splat};

use crate::expectation::Scene;
use crate::gaussians::Gaussians;
use crate::history::Past;
use crate::profile::BinState;

/// One Gaussian in one ping.
#[derive(Debug, Clone)]
pub(crate) struct Row {
    pub(crate) slot: u32,
    pub(crate) splat: Splat,
    /// Strength towards this ping's sensor.
    pub(crate) strength: f32,
    /// Bins it reaches, never empty.
    pub(crate) bins: Range<u32>,
    energies_from: u32,
}

/// Everything one ping sees, and what it should measure. Reused from ping to ping.
#[derive(Debug, Default)]
pub(crate) struct Sight {
    rows: Vec<Row>,
    energies: Vec<f32>,
    /// Predicted intensity per bin, noise included.
    pub(crate) predicted: Vec<f32>,
    /// What each bin counts: 0 in the blanking, little in a shadow.
    pub(crate) bin_weight: Vec<f32>,
    /// `w/Î` and `w·I/Î²` per bin: what a row's energies are summed with.
    per_predicted: Vec<(f32, f32)>,
}

/// Darkness behind an echo may be its shadow and counts this little.
const SHADOWED_WEIGHT: f32 = 0.15;

impl Sight {
    /// Fills in what `past` sees of the scene.
    pub(crate) fn look(&mut self, past: &Past, scene: Scene<'_>) {
        self.rows.clear();
        self.energies.clear();
        let look = match scene.is_blurred {
            true => past.blurred_look(),
            false => past.look,
        };
        scene.evidence.blocks_in(past, |block| {
            for &(_, slot) in &block.gaussians {
                self.add(&look, slot, scene.gaussians);
            }
        });
        self.predict(past, scene.floor);
    }

    fn add(&mut self, look: &Look, slot: u32, gaussians: &Gaussians) {
        let s = slot as usize;
        let Some(splat) = look.project(gaussians.mean_m[s], &gaussians.covariance_m2[s]) else {
            return;
        };
        let bins = look.bins_of(&splat);
        if bins.is_empty() {
            return;
        }
        let energies_from = self.energies.len() as u32;
        look.spread(&splat, bins.clone(), &mut self.energies);
        self.rows.push(Row {
            slot,
            strength: gaussians.strength[s].seen(-splat.range_axis),
            splat,
            bins: bins.start as u32..bins.end as u32,
            energies_from,
        });
    }

    fn predict(&mut self, past: &Past, floor: f32) {
        let profile = &past.profile;
        self.predicted.clear();
        self.predicted
            .resize(profile.intensity.len(), profile.noise.max(floor));
        for row in &self.rows {
            let energies = energies_of(&self.energies, row);
            let bins = row.bins.start as usize..row.bins.end as usize;
            for (predicted, energy) in self.predicted[bins].iter_mut().zip(energies) {
                *predicted += row.strength * energy;
            }
        }
        self.bin_weight.clear();
        self.bin_weight
            .extend(profile.state.iter().map(|state| match state {
                BinState::Blank => 0.0,
                BinState::Shadowed => SHADOWED_WEIGHT,
                BinState::Dark | BinState::Lit => 1.0,
            }));
        let bins = self
            .predicted
            .iter()
            .zip(&self.bin_weight)
            .zip(profile.intensity.iter());
        self.per_predicted.clear();
        self.per_predicted
            .extend(bins.map(|((predicted, weight), intensity)| {
                let share = weight / predicted;
                (share, share * intensity / predicted)
            }));
    }

    pub(crate) fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Energy of a row per bin of `row.bins`, for strength 1.
    pub(crate) fn energies(&self, row: &Row) -> &[f32] {
        energies_of(&self.energies, row)
    }

    /// `Σ A·w/Î` and `Σ A·w·I/Î²` over the bins of a row.
    pub(crate) fn against_prediction(&self, row: &Row) -> (f32, f32) {
        let bins = row.bins.start as usize..row.bins.end as usize;
        let (mut share, mut pull) = (0.0, 0.0);
        for (energy, per) in self.energies(row).iter().zip(&self.per_predicted[bins]) {
            share += energy * per.0;
            pull += energy * per.1;
        }
        (share, pull)
    }

    /// Gaussian–bin pairs in this ping: the unit of work.
    pub(crate) fn pair_count(&self) -> u64 {
        self.energies.len() as u64
    }
}

fn energies_of<'a>(energies: &'a [f32], row: &Row) -> &'a [f32] {
    let from = row.energies_from as usize;
    &energies[from..from + row.bins.len()]
}
