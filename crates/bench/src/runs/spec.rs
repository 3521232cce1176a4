//! One run: which dive it is of, and what makes a map of it.

use std::collections::BTreeMap;

use echosplat_model::Pose;
use echosplat_simulator::{DiveKind, NoiseLevel};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// What makes a map of a dive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Method {
    /// The service's mapper: live while the dive goes on, then finished.
    #[default]
    Online,
    /// Places on the arcs that enough views agree on: the paper's first Gaussians.
    Support,
    /// Voxels on the arcs that most observations of them find lit.
    Carving,
    /// The paper's method whole; needs a dive that comes in images.
    Paper,
}

impl Method {
    /// As on the command line and in reports.
    #[must_use]
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Online => "online",
            Self::Support => "support",
            Self::Carving => "carving",
            Self::Paper => "paper",
        }
    }
}

/// How the moments of a dive are spaced at which its map is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Spacing {
    /// Every second one doubles the time: curves on logarithmic axes.
    #[default]
    Doubling,
    /// So that each is as far from the next, the first as far from the beginning.
    Even,
}

/// A simulated dive, and how it becomes a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Spec {
    /// A built-in scene.
    pub(crate) scene: String,
    /// How the sonar moves.
    #[serde(with = "as_text")]
    pub(crate) dive: DiveKind,
    /// What is wrong with pings and poses.
    #[serde(with = "as_text")]
    pub(crate) noise: NoiseLevel,
    /// That of the poses, where it is another than that of the pings.
    #[serde(default, with = "as_optional_text")]
    pub(crate) pose_noise: Option<NoiseLevel>,
    /// Strongest echo of a ping over the mean noise, median over the pings, dB; the noise's own
    /// without.
    #[serde(default)]
    pub(crate) echoes_over_noise_db: Option<f64>,
    /// What the water adds, each as `KEY=VALUE` of `simulate --disturb`.
    #[serde(default)]
    pub(crate) disturbances: Vec<String>,
    /// Of everything random.
    pub(crate) seed: u64,
    /// Length of the dive; the default's without.
    pub(crate) duration_s: Option<f64>,
    /// The first fraction of its pings that is mapped, above 0 to 1.
    pub(crate) share: f64,
    /// Added to the pings' times before poses are looked up.
    pub(crate) time_offset_s: f64,
    /// Threads of the mapper.
    pub(crate) threads: usize,
    /// Where all of it takes place.
    pub(crate) placement: Placement,
    /// What makes the map.
    #[serde(default)]
    pub(crate) method: Method,
    /// Keys of the configuration and their TOML values, as in `mapper.workout_passes` and `48`; the
    /// defaults without.
    #[serde(default)]
    pub(crate) settings: BTreeMap<String, String>,
    /// Moments of the dive at which its map is judged; 0 for none.
    #[serde(default)]
    pub(crate) moments: usize,
    /// How they are spaced.
    #[serde(default)]
    pub(crate) spacing: Spacing,
    /// Whether the map is scored on pings that it has not seen; plain dives always are.
    #[serde(default, rename = "held_back")]
    pub(crate) held_out: bool,
}

/// Moments of a dive are this far apart: two double its length.
const MOMENT_RATIO: f64 = std::f64::consts::SQRT_2;

/// A turn about the world's vertical, then a shift.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Placement {
    /// Counter-clockwise.
    pub(crate) yaw_deg: f64,
    /// World axes.
    pub(crate) shift_m: DVec3,
}

impl Placement {
    /// From where it was to where it is.
    #[must_use]
    pub(crate) fn pose(&self) -> Pose {
        Pose::from_yaw_pitch_roll(self.yaw_deg.to_radians(), 0.0, 0.0, self.shift_m)
    }
}

/// As reports name a dive; its length only where it is not the default's.
pub(crate) fn dive_name(
    scene: &str,
    dive: DiveKind,
    noise: NoiseLevel,
    duration_s: Option<f64>,
) -> String {
    let length = duration_s.map_or(String::new(), |s| format!(", {s} s"));
    format!("{scene}, {dive}, {noise}{length}")
}

impl Spec {
    /// A whole dive as it comes, with one thread.
    #[must_use]
    pub(crate) fn new(scene: &str, dive: DiveKind, noise: NoiseLevel, seed: u64) -> Self {
        Self {
            scene: scene.to_owned(),
            dive,
            noise,
            pose_noise: None,
            echoes_over_noise_db: None,
            disturbances: Vec::new(),
            seed,
            duration_s: None,
            share: 1.0,
            time_offset_s: 0.0,
            threads: 1,
            placement: Placement::default(),
            method: Method::default(),
            settings: BTreeMap::new(),
            moments: 0,
            spacing: Spacing::default(),
            held_out: false,
        }
    }

    /// The same with one more setting; `value` is TOML.
    #[must_use]
    pub(crate) fn with(mut self, key: &str, value: &str) -> Self {
        self.settings.insert(key.to_owned(), value.to_owned());
        self
    }

    /// When the map is judged, as shares of what is mapped of the dive, in order, the last 1.
    #[must_use]
    pub(crate) fn moment_shares(&self) -> Vec<f64> {
        let before_end = (0..self.moments as i32).rev();
        match self.spacing {
            Spacing::Doubling => before_end.map(|steps| MOMENT_RATIO.powi(-steps)).collect(),
            Spacing::Even => {
                let share = |moment| moment as f64 / self.moments as f64;
                (1..=self.moments).map(share).collect()
            }
        }
    }

    /// Says all of it: no two different runs have the same name.
    #[must_use]
    pub(crate) fn name(&self) -> String {
        let mut name = format!("{} {} {}", self.scene, self.dive, self.noise);
        let mut add = |said: String| name = format!("{name}, {said}");
        if let Some(noise) = self.pose_noise {
            add(format!("{noise} poses"));
        }
        if let Some(over_noise_db) = self.echoes_over_noise_db {
            add(format!("echoes {over_noise_db} dB over the noise"));
        }
        if !self.disturbances.is_empty() {
            add(self.disturbances.join(", "));
        }
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
        if self.method != Method::Online {
            add(self.method.as_str().to_owned());
        }
        for (key, value) in &self.settings {
            add(format!("{key} = {value}"));
        }
        if self.moments > 0 {
            let even = match self.spacing {
                Spacing::Doubling => "",
                Spacing::Even => "even ",
            };
            add(format!("{} {even}moments", self.moments));
        }
        if self.held_out {
            add("held-out pings scored".to_owned());
        }
        add(format!("seed {}", self.seed));
        name
    }

    /// Whether it is a dive as users have it, and not one bent for a comparison.
    #[must_use]
    pub(crate) fn is_plain(&self) -> bool {
        let plain = Self::new(&self.scene, self.dive, self.noise, self.seed);
        *self == plain
    }

    /// Whether the map is scored on pings that it has not seen.
    #[must_use]
    pub(crate) fn scores_held_out(&self) -> bool {
        self.held_out || self.is_plain()
    }
}

/// As [`as_text`], or nothing.
mod as_optional_text {
    use std::fmt::Display;
    use std::str::FromStr;

    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<T: Display, S: Serializer>(
        value: &Option<T>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        value.as_ref().map(ToString::to_string).serialize(to)
    }

    pub(super) fn deserialize<'de, T, D>(from: D) -> Result<Option<T>, D::Error>
    where
        T: FromStr<Err: Display>,
        D: Deserializer<'de>,
    {
        let text = Option::<String>::deserialize(from)?;
        let value = text.map(|text| text.parse().map_err(D::Error::custom));
        value.transpose()
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
            Spec {
                method: Method::Carving,
                ..plain.clone()
            },
            Spec {
                moments: 12,
                ..plain.clone()
            },
            Spec {
                moments: 12,
                spacing: Spacing::Even,
                ..plain.clone()
            },
            Spec {
                held_out: true,
                ..plain.clone()
            },
            Spec {
                pose_noise: Some(NoiseLevel::Harsh),
                ..plain.clone()
            },
            Spec {
                echoes_over_noise_db: Some(14.0),
                ..plain.clone()
            },
            Spec {
                disturbances: vec!["surface_m=2".to_owned()],
                ..plain.clone()
            },
            plain.clone().with("mapper.workout_passes", "48"),
            plain.clone().with("mapper.workout_passes", "8"),
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
            pose_noise: Some(NoiseLevel::Field),
            echoes_over_noise_db: Some(17.0),
            disturbances: vec!["copy_offset_m=1".to_owned()],
            ..Spec::new("pier", DiveKind::Viewpoints, NoiseLevel::Harsh, 3)
        };
        let json = serde_json::to_string(&spec).unwrap();
        assert_eq!(serde_json::from_str::<Spec>(&json).unwrap(), spec);
        assert!(serde_json::from_str::<Spec>(&json.replace("harsh", "rough")).is_err());
        // Of a program that knew one spacing only.
        let before = json.replace(",\"spacing\":\"doubling\"", "");
        assert_ne!(before, json);
        assert_eq!(serde_json::from_str::<Spec>(&before).unwrap(), spec);
        let wrong = json.replace("field", "meadow");
        let error = serde_json::from_str::<Spec>(&wrong).unwrap_err();
        assert!(error.to_string().contains("nominal, field"), "{error}");
    }

    #[test]
    fn moments_double_every_second_step_up_to_the_end() {
        let spec = Spec {
            moments: 5,
            ..Spec::new("fence", DiveKind::Survey, NoiseLevel::Nominal, 1)
        };
        let shares = spec.moment_shares();
        let root = std::f64::consts::FRAC_1_SQRT_2;
        let expected = [0.25, 0.5 * root, 0.5, root, 1.0];
        assert_eq!(shares.len(), 5);
        for (share, expected) in shares.iter().zip(expected) {
            assert!((share - expected).abs() < 1e-5, "{shares:?}");
        }
        assert_eq!(Spec { moments: 0, ..spec }.moment_shares().len(), 0);
    }

    #[test]
    fn even_moments_are_those_at_which_dives_are_cut() {
        let spec = Spec {
            moments: 10,
            spacing: Spacing::Even,
            ..Spec::new("fence", DiveKind::Survey, NoiseLevel::Nominal, 1)
        };
        let shares = spec.moment_shares().into_iter().map(f64::to_bits);
        let tenths = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0].map(f64::to_bits);
        assert!(shares.eq(tenths));
    }
}
