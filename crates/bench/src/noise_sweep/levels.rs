//! Which dives, and how loud their echoes are.

use echosplat_simulator::{DiveKind, NoiseLevel};
use serde::Serialize;

use crate::runs::Spec;

/// Strongest echo of a ping over the mean noise, median over the pings.
const OVER_NOISE_DB: [f64; 9] = [40.0, 30.0, 24.0, 20.0, 17.0, 14.0, 11.0, 8.0, 6.0];
const QUICK_OVER_NOISE_DB: [f64; 3] = [30.0, 14.0, 6.0];
const QUICK_DIVE_S: f64 = 30.0;
const SCENE: &str = "fence";
/// Whose poses both dives have, so that they differ in their pings alone.
const POSES: NoiseLevel = NoiseLevel::Nominal;

/// One survey, heard so far above the noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Level {
    /// Whose pings: as a real unit hears them, or with four looks and no loss over range.
    #[serde(serialize_with = "as_name")]
    pub(crate) pings: NoiseLevel,
    /// Strongest echo of a ping over the mean noise, median over the pings, dB.
    pub(crate) over_noise_db: f64,
    /// Length of the dive; the default's without.
    pub(crate) duration_s: Option<f64>,
}

/// All levels, loud echoes first, those of a real unit's pings before the others.
#[must_use]
pub(crate) fn levels(quick: bool) -> Vec<Level> {
    let over_noise_db: &[f64] = match quick {
        true => &QUICK_OVER_NOISE_DB,
        false => &OVER_NOISE_DB,
    };
    let of_pings = |pings| {
        let level = move |over_noise_db: &f64| Level {
            pings,
            over_noise_db: *over_noise_db,
            duration_s: quick.then_some(QUICK_DIVE_S),
        };
        over_noise_db.iter().map(level)
    };
    let pings = [NoiseLevel::Field, NoiseLevel::Nominal];
    pings.into_iter().flat_map(of_pings).collect()
}

impl Level {
    /// Its run with a seed.
    #[must_use]
    pub(crate) fn spec(&self, seed: u64) -> Spec {
        Spec {
            duration_s: self.duration_s,
            pose_noise: (self.pings != POSES).then_some(POSES),
            echoes_over_noise_db: Some(self.over_noise_db),
            ..Spec::new(SCENE, DiveKind::Survey, self.pings, seed)
        }
    }
}

fn as_name<S: serde::Serializer>(level: &NoiseLevel, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(level.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_is_a_run_of_its_own_with_the_same_poses() {
        for quick in [false, true] {
            let specs: Vec<Spec> = levels(quick).iter().map(|level| level.spec(2)).collect();
            let mut names: Vec<String> = specs.iter().map(Spec::name).collect();
            names.sort();
            names.dedup();
            assert_eq!(names.len(), levels(quick).len());
            let poses = specs
                .iter()
                .map(|spec| spec.pose_noise.unwrap_or(spec.noise));
            assert!(poses.into_iter().all(|noise| noise == POSES));
        }
        assert_eq!(levels(false).len(), 18);
    }
}
