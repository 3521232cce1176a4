//! One run: which dive it is of, and what came out.

use std::collections::BTreeMap;

use echosplat_model::Pose;
use echosplat_simulator::{DiveKind, NoiseLevel};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::held_back::HeldBack;
use crate::{Metrics, nullable};

/// A simulated dive, and how it goes through the mapper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spec {
    /// A built-in scene.
    pub scene: String,
    /// How the sonar moves.
    #[serde(with = "as_text")]
    pub dive: DiveKind,
    /// What is wrong with pings and poses.
    #[serde(with = "as_text")]
    pub noise: NoiseLevel,
    /// Of everything random.
    pub seed: u64,
    /// Length of the dive; the default's without.
    pub duration_s: Option<f64>,
    /// The first part of its pings that is mapped, above 0 to 1.
    pub share: f64,
    /// Added to the pings' times before poses are looked up.
    pub time_offset_s: f64,
    /// Threads of the mapper.
    pub threads: usize,
    /// Where all of it takes place.
    pub placement: Placement,
}

/// A turn about the world's vertical, then a shift.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Placement {
    /// Counter-clockwise.
    pub yaw_deg: f64,
    /// World axes.
    pub shift_m: DVec3,
}

impl Placement {
    /// From where it was to where it is.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose::from_yaw_pitch_roll(self.yaw_deg.to_radians(), 0.0, 0.0, self.shift_m)
    }
}

impl Spec {
    /// A whole dive as it comes, with one thread.
    #[must_use]
    pub fn new(scene: &str, dive: DiveKind, noise: NoiseLevel, seed: u64) -> Self {
        Self {
            scene: scene.to_owned(),
            dive,
            noise,
            seed,
            duration_s: None,
            share: 1.0,
            time_offset_s: 0.0,
            threads: 1,
            placement: Placement::default(),
        }
    }

    /// Says all of it: no two different runs have the same name.
    #[must_use]
    pub fn name(&self) -> String {
        let mut name = format!("{} {} {}", self.scene, self.dive, self.noise);
        let mut add = |said: String| name = format!("{name}, {said}");
        if let Some(duration_s) = self.duration_s {
            add(format!("{duration_s} s"));
        }
        if self.share < 1.0 {
            add(format!("first {} %", 100.0 * self.share));
        }
        if self.time_offset_s.abs() > 0.0 {
            add(format!("poses {} s off", self.time_offset_s));
        }
        if self.threads != 1 {
            add(format!("{} threads", self.threads));
        }
        let Placement { yaw_deg, shift_m } = self.placement;
        if yaw_deg.abs() > 0.0 {
            add(format!("turned {yaw_deg}°"));
        }
        if shift_m.length() > 0.0 {
            add(format!("moved by {shift_m} m"));
        }
        add(format!("seed {}", self.seed));
        name
    }

    /// Whether it is a dive as users have it, and not one bent for a comparison.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        let plain = Self::new(&self.scene, self.dive, self.noise, self.seed);
        *self == plain
    }
}

/// What a mapper had done at some moment.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Work {
    /// Processor seconds of its threads.
    pub compute_s: f64,
    /// Gaussian–bin pairs.
    pub pairs: u64,
    /// Voxel looks.
    pub voxel_looks: u64,
}

/// What came out of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Of the finished map, turned and moved back to the scene.
    pub metrics: Metrics,
    /// Of the live map in the middle of the dive; infinite where there was none.
    #[serde(with = "nullable")]
    pub mid_dive_cd_m: f64,
    /// Pings in the map.
    pub pings: u64,
    /// Before the finish; maps made to be looked at do not count.
    pub streamed: Work,
    /// With the finish.
    pub total: Work,
    /// Pings of the same dive that the map has not seen; `None` where it was not asked for, or
    /// nothing was heard.
    pub held_back: Option<HeldBack>,
    /// Of the whole process until the map was there, the simulator included.
    pub peak_memory_bytes: u64,
    /// By the clock, simulation and judging included.
    pub wall_s: f64,
    /// Names the bits of the finished map.
    pub fingerprint: String,
    /// From the same dive where it really was, for a dive that took place elsewhere: the mean of
    /// the two directed mean distances between confident points. Filled in once both are there.
    #[serde(skip)]
    pub from_unmoved_m: Option<f64>,
}

/// Outcomes by [`Spec::name`]: what a run came to, or why it failed. What is not there was not run.
#[derive(Debug, Clone, Default)]
pub struct Results(pub BTreeMap<String, Result<Outcome, String>>);

impl Results {
    /// Of one run.
    #[must_use]
    pub fn of(&self, spec: &Spec) -> Option<&Result<Outcome, String>> {
        self.0.get(&spec.name())
    }
}

/// Names that read and print as text.
mod as_text {
    use std::fmt::Display;
    use std::str::FromStr;

    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<T: Display, S: Serializer>(
        value: &T,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        to.collect_str(value)
    }

    pub(super) fn deserialize<'de, T, D>(from: D) -> Result<T, D::Error>
    where
        T: FromStr<Err: Display>,
        D: Deserializer<'de>,
    {
        String::deserialize(from)?.parse().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_difference_between_runs_is_in_their_names() {
        let plain = Spec::new("fence", DiveKind::Survey, NoiseLevel::Nominal, 1);
        let bent = [
            Spec {
                seed: 2,
                ..plain.clone()
            },
            Spec {
                duration_s: Some(60.0),
                ..plain.clone()
            },
            Spec {
                share: 0.25,
                ..plain.clone()
            },
            Spec {
                time_offset_s: 1.0,
                ..plain.clone()
            },
            Spec {
                threads: 2,
                ..plain.clone()
            },
            Spec {
                placement: Placement {
                    yaw_deg: 10.0,
                    shift_m: DVec3::ZERO,
                },
                ..plain.clone()
            },
            Spec {
                placement: Placement {
                    yaw_deg: 0.0,
                    shift_m: DVec3::X,
                },
                ..plain.clone()
            },
        ];
        let mut names: Vec<String> = bent.iter().map(Spec::name).collect();
        names.push(plain.name());
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count, "{names:?}");
        assert_eq!(plain.name(), "fence survey nominal, seed 1");
        assert!(plain.is_plain() && bent[1..].iter().all(|spec| !spec.is_plain()));
    }

    #[test]
    fn a_spec_survives_json() {
        let spec = Spec {
            placement: Placement {
                yaw_deg: 33.0,
                shift_m: DVec3::splat(1e7),
            },
            ..Spec::new("pier", DiveKind::Viewpoints, NoiseLevel::Harsh, 3)
        };
        let json = serde_json::to_string(&spec).unwrap();
        assert_eq!(serde_json::from_str::<Spec>(&json).unwrap(), spec);
        assert!(serde_json::from_str::<Spec>(&json.replace("harsh", "rough")).is_err());
    }
}
