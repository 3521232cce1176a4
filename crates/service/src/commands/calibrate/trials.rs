//! The dive mapped with one parameter shifted, and how likely that makes the pings kept from the map.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use echosplat_join::ArrivedPose;
use echosplat_mapper::{Calibration, Features, Mapper, MapperConfig, Questions};
use echosplat_model::{Ping, PosedPing, Switch};
use echosplat_pose::PoseSource;
use echosplat_prediction::alignment::Alignment;
use echosplat_prediction::held_out::{Pair, score};
use echosplat_prediction::{MapRenderer, pair_of};

use crate::alignment::Sections;
use crate::config::Config;
use crate::exit::Usage;
use crate::logs;
use crate::pipeline::Poses;
use crate::thinned::Thinned;

/// Most pings of a dive that are looked at.
const MOST_PINGS: usize = 6144;
/// Two of so many are kept from the map, one to search by and one to verify by; one of the map's own is fitted on.
const HOLD_BACK: usize = 10;
/// Fewest held-out pings that say anything.
const LEAST_HELD: usize = 30;
/// Work of a finish, pairs: enough to rank maps.
const WORKOUT_PAIRS: u64 = 300_000_000;
/// A log in memory, thinned.
pub(super) struct Dive {
    pings: Vec<Arc<Ping>>,
    poses: Vec<ArrivedPose>,
    /// What becomes of a ping, by its number.
    roles: HashMap<u64, Role>,
    alignment: Option<Alignment>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Mapped,
    /// Mapped, and the renderer's gain and floor are fitted on it.
    Fitted,
    HeldOut,
    /// Held out of the search too.
    Verifying,
}

fn role(index: usize) -> Role {
    match index % HOLD_BACK {
        1 => Role::Verifying,
        4 => Role::Fitted,
        9 => Role::HeldOut,
        _ => Role::Mapped,
    }
}

/// What a configuration makes of a dive.
#[derive(Debug, Clone)]
pub(super) struct Trial {
    pub(super) config: Config,
    /// What it is searched by.
    pub(super) held_out: Likelihoods,
    /// What the search does not see.
    pub(super) verifying: Likelihoods,
}

/// Log likelihood per bin of each ping, by its number.
pub(super) type Likelihoods = Vec<(u64, f64)>;

impl Dive {
    pub(super) fn read(log: &Path, poses: Option<&Path>, config: &Config) -> anyhow::Result<Self> {
        let (mut kept, mut sections) = (Thinned::new(MOST_PINGS), Sections::new());
        logs::pings(log, config, |ping| {
            sections.take(&ping);
            kept.push(|| ping);
        })?;
        let pings: Vec<Arc<Ping>> = kept.into_kept();
        let poses = logs::poses(log, poses)?;
        let roles = pings.iter().enumerate();
        let roles = roles.map(|(index, ping)| (ping.sequence(), role(index)));
        Ok(Self {
            roles: roles.collect(),
            alignment: sections.with(&poses, config),
            poses,
            pings,
        })
    }

    fn posed(&self, config: &Config) -> anyhow::Result<Vec<PosedPing>> {
        let source = PoseSource::recorded(self.poses.clone());
        let mut poses = Poses::waited_for(config, source)?;
        let mut posed = Vec::new();
        for ping in &self.pings {
            poses.push(Arc::clone(ping), Instant::now());
            while let Some(joined) = poses.pop() {
                posed.push(joined.posed);
            }
        }
        poses.finish();
        while let Some(joined) = poses.pop() {
            posed.push(joined.posed);
        }
        Ok(posed)
    }

    pub(super) fn trial(&self, config: &Config) -> anyhow::Result<Trial> {
        let posed = self.posed(config)?;
        let role = |ping: &PosedPing| self.roles.get(&ping.ping.sequence()).copied();
        let of_role = |wanted: Role| posed.iter().filter(move |p| role(p) == Some(wanted));
        let mut mapper = Mapper::new(MapperConfig {
            threads: 1,
            workout_pairs: WORKOUT_PAIRS,
            // As a published map knows it: one strength for all directions.
            parts: Features {
                specular: Switch::Off,
                ..config.mapper.parts.for_comparison()
            },
            ..config.mapper.clone()
        })?;
        let is_mapped = |p: &&PosedPing| matches!(role(p), Some(Role::Mapped | Role::Fitted));
        for ping in posed.iter().filter(is_mapped) {
            mapper.insert(ping);
        }
        let map = mapper.finish();
        let mut renderer = MapRenderer::new(map.origin_m, map.intensity_unit, &map.gaussians);
        let mut pair = |ping: &PosedPing| pair_of(&mut renderer, ping, &config.mapper);
        let fit: Vec<Pair> = of_role(Role::Fitted).map(&mut pair).collect();
        let held: Vec<Pair> = of_role(Role::HeldOut).map(&mut pair).collect();
        let verifying: Vec<Pair> = of_role(Role::Verifying).map(&mut pair).collect();
        let found = score(&fit, &held).filter(|found| found.ping_count >= LEAST_HELD as u64);
        let Some(found) = found else {
            return Err(Usage::error(format!(
                "of {} pings {} have a pose and can be held out; at least {LEAST_HELD} must, \
                 and something be heard",
                self.pings.len(),
                held.len()
            )));
        };
        let likelihoods = |role: Role, pairs: &[Pair]| {
            let numbers = of_role(role).map(|ping| ping.ping.sequence());
            let likelihoods = pairs.iter().map(|pair| found.log_likelihood_per_bin(pair));
            numbers.zip(likelihoods).collect()
        };
        Ok(Trial {
            config: config.clone(),
            held_out: likelihoods(Role::HeldOut, &held),
            verifying: likelihoods(Role::Verifying, &verifying),
        })
    }

    /// Pings and poses far from each other, if anything is heard.
    pub(super) fn alignment(&self) -> Option<&Alignment> {
        self.alignment.as_ref()
    }

    /// What the dive's own map and others beside it say of the rest, the speed of sound first.
    pub(super) fn landmarks(&self, config: &Config) -> anyhow::Result<Option<Calibration>> {
        let mut mapper = Mapper::new(config.mapper.clone())?;
        for ping in &self.posed(config)? {
            mapper.insert(ping);
        }
        let calibration = mapper.calibrator();
        let calibration = calibration
            .map(|calibrator| calibrator.run(Questions::InFull))
            .transpose()?;
        Ok(calibration.flatten())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_out_and_fitted_pings_are_as_many() {
        let count = |wanted| (0..100).filter(|&index| role(index) == wanted).count();
        let counts = [Role::Fitted, Role::HeldOut, Role::Verifying].map(count);
        assert_eq!(counts, [10; 3]);
    }
}
