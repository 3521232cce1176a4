//! Disturbances by name, as the command line and a dive's description have them.

use super::Disturbances;

/// One number of [`Disturbances`].
#[derive(Debug)]
pub struct DisturbanceKey {
    /// As in `KEY=VALUE`.
    pub name: &'static str,
    /// What it is, with its unit.
    pub meaning: &'static str,
    /// Least and most allowed.
    pub range: (f64, f64),
    is_whole: bool,
    field: fn(&mut Disturbances) -> &mut f64,
}

const fn key(
    name: &'static str,
    meaning: &'static str,
    range: (f64, f64),
    field: fn(&mut Disturbances) -> &mut f64,
) -> DisturbanceKey {
    DisturbanceKey {
        name,
        meaning,
        range,
        is_whole: false,
        field,
    }
}

/// All of them; the first of a kind switches it on.
#[rustfmt::skip]
pub const DISTURBANCE_KEYS: [DisturbanceKey; 25] = [
    key("copy_offset_m", "a copy of every echo this much further away, metres", (0.0, 100.0), |d| &mut d.copies.offset_m),
    key("copy_db", "how much weaker the copy is, decibels", (0.0, 60.0), |d| &mut d.copies.weaker_db),
    key("multiple_ratio", "every echo once more at this multiple of its range", (1.0, 10.0), |d| &mut d.multiples.ratio),
    key("multiple_db", "how much weaker that is, decibels", (0.0, 60.0), |d| &mut d.multiples.weaker_db),
    key("spikes", "another sonar's pulses a ping, at random ranges; 0.05 is one in 20 pings", (0.0, 64.0), |d| &mut d.spikes.per_ping),
    key("spike_db", "their power over the mean noise, decibels", (0.0, 90.0), |d| &mut d.spikes.over_noise_db),
    key("spike_bins", "their length, bins", (0.1, 100.0), |d| &mut d.spikes.length_bins),
    key("walker_mps", "another sonar's pulse in every ping, which gains so much range a second, metres", (-1000.0, 1000.0), |d| &mut d.walker.walk_mps),
    key("walker_db", "its power over the mean noise, decibels", (0.0, 90.0), |d| &mut d.walker.over_noise_db),
    key("walker_bins", "its length, bins", (0.1, 100.0), |d| &mut d.walker.length_bins),
    DisturbanceKey { is_whole: true, ..key("fish", "fish that swim through the dive", (0.0, 1000.0), |d| &mut d.fish.count) },
    key("fish_db", "target strength of each, decibels re 1 m²", (-80.0, 0.0), |d| &mut d.fish.target_strength_db),
    key("surface_m", "a mirroring surface of the water at this height z, metres", (-1e4, 1e4), |d| &mut d.surface.height_m),
    key("surface_db", "loss at each reflection, decibels", (0.0, 60.0), |d| &mut d.surface.loss_db),
    key("surface_beyond_db", "how much less the beam hears of an image at most, one way, decibels", (0.0, 100.0), |d| &mut d.surface.beyond_beam_db),
    key("saturated_share", "share of echo bins clipped at the receiver's stop", (0.0, 1.0), |d| &mut d.saturation.share),
    key("saturated_db", "or the stop itself, decibels as reported", (-45.0, 120.0), |d| &mut d.saturation.stop_db),
    key("sound_error", "true over reported speed of sound, less 1, at the first ping", (-0.1, 0.1), |d| &mut d.sound.error),
    key("sound_drift", "what is added to it by the last ping", (-0.1, 0.1), |d| &mut d.sound.drift),
    key("pose_latency_s", "how much later than they held poses are stamped, seconds", (-1.0, 1.0), |d| &mut d.navigation.latency_s),
    key("mount_yaw_deg", "how the sonar is mounted unknown to the configuration, degrees", (-45.0, 45.0), |d| &mut d.navigation.mount_yaw_deg),
    key("mount_pitch_deg", "the same, positive lowers the nose", (-45.0, 45.0), |d| &mut d.navigation.mount_pitch_deg),
    key("mount_roll_deg", "the same, positive lifts the left side", (-45.0, 45.0), |d| &mut d.navigation.mount_roll_deg),
    key("compass_b_deg", "deviation of the compass: what the sine of the heading adds to it, degrees", (-30.0, 30.0), |d| &mut d.navigation.compass_b_deg),
    key("compass_c_deg", "the same, of the cosine", (-30.0, 30.0), |d| &mut d.navigation.compass_c_deg),
];

impl DisturbanceKey {
    /// What it is in `disturbances`.
    #[must_use]
    pub fn of(&self, disturbances: &Disturbances) -> f64 {
        let mut copy = *disturbances;
        *(self.field)(&mut copy)
    }

    fn check(&self, value: f64) -> Result<(), DisturbanceError> {
        let (low, high) = self.range;
        let name = self.name;
        if !(value >= low && value <= high) {
            return Err(DisturbanceError::Range {
                name,
                value,
                low,
                high,
            });
        }
        match self.is_whole && value.fract().abs() > 0.0 {
            true => Err(DisturbanceError::Part { name, value }),
            false => Ok(()),
        }
    }
}

/// Why a disturbance cannot be had.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DisturbanceError {
    /// No pair of key and value.
    #[error("`{0}` must read KEY=VALUE, as spikes=3")]
    NoPair(String),
    /// No such key.
    #[error("no disturbance is called `{name}`; there are {}", names())]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// Not a number.
    #[error("{name} is `{value}`; it must be a number")]
    NoNumber {
        /// Which.
        name: &'static str,
        /// What it was.
        value: String,
    },
    /// Out of range.
    #[error("{name} is {value}; allowed is {low} to {high}")]
    Range {
        /// Which.
        name: &'static str,
        /// What it was.
        value: f64,
        /// Least allowed.
        low: f64,
        /// Most allowed.
        high: f64,
    },
    /// Fraction of a whole.
    #[error("{name} is {value}; it must be a whole number")]
    Part {
        /// Which.
        name: &'static str,
        /// What it was.
        value: f64,
    },
}

fn names() -> String {
    let [first @ .., last] = DISTURBANCE_KEYS.each_ref().map(|key| key.name);
    format!("{} and {last}", first.join(", "))
}

impl Disturbances {
    /// Sets one of [`DISTURBANCE_KEYS`] from `KEY=VALUE`.
    ///
    /// # Errors
    /// Names what is wrong, and what there is instead.
    pub fn set(&mut self, pair: &str) -> Result<(), DisturbanceError> {
        let Some((name, value)) = pair.split_once('=') else {
            return Err(DisturbanceError::NoPair(pair.to_owned()));
        };
        let Some(key) = DISTURBANCE_KEYS.iter().find(|key| key.name == name.trim()) else {
            return Err(DisturbanceError::Unknown {
                name: name.trim().to_owned(),
            });
        };
        let Ok(number) = value.trim().parse::<f64>() else {
            return Err(DisturbanceError::NoNumber {
                name: key.name,
                value: value.trim().to_owned(),
            });
        };
        key.check(number)?;
        *(key.field)(self) = number;
        Ok(())
    }

    /// # Errors
    /// Says which number cannot be. What is infinite by default may stay so.
    pub(crate) fn check(&self) -> Result<(), DisturbanceError> {
        let off = Self::default();
        let changed = |key: &&DisturbanceKey| key.of(self).to_bits() != key.of(&off).to_bits();
        let mut keys = DISTURBANCE_KEYS.iter().filter(changed);
        keys.try_for_each(|key| key.check(key.of(self)))
    }

    /// Every number as a table of TOML, each with what it is.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let lines = DISTURBANCE_KEYS.iter().map(|key| {
            let value = key.of(self);
            let value = match key.is_whole {
                true => format!("{value:.0}"),
                false => format!("{value:?}"),
            };
            format!("{} = {value} # {}\n", key.name, key.meaning)
        });
        lines.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_sets_a_number_of_its_own_and_is_told_in_the_table() {
        let mut all = Disturbances::default();
        let inside = |key: &DisturbanceKey| key.range.1 - f64::from(u8::from(key.range.1 > 2.0));
        for key in &DISTURBANCE_KEYS {
            let before = all;
            all.set(&format!("{} = {}", key.name, inside(key))).unwrap();
            for other in &DISTURBANCE_KEYS {
                let is_same = other.of(&all).to_bits() == other.of(&before).to_bits();
                assert_eq!(
                    is_same,
                    other.name != key.name,
                    "{} {}",
                    key.name,
                    other.name
                );
            }
        }
        all.check().unwrap();
        let told: toml::Table = toml::from_str(&all.to_toml()).unwrap();
        assert_eq!(told.len(), DISTURBANCE_KEYS.len());
        for key in &DISTURBANCE_KEYS {
            let value = &told[key.name];
            let value = value
                .as_float()
                .or(value.as_integer().map(|whole| whole as f64));
            assert!(
                (value.unwrap() - key.of(&all)).abs() < 1e-12,
                "{}",
                key.name
            );
        }
        assert!(toml::from_str::<toml::Table>(&Disturbances::default().to_toml()).is_ok());
    }

    #[test]
    fn what_cannot_be_is_refused_with_what_could() {
        let refused = |pair: &str| {
            let mut disturbances = Disturbances::default();
            let error = disturbances.set(pair).unwrap_err().to_string();
            assert_eq!(disturbances, Disturbances::default());
            error
        };
        let wrong = refused("spike=3");
        assert!(
            wrong.contains("`spike`") && wrong.contains("spikes, spike_db"),
            "{wrong}"
        );
        assert!(
            wrong.ends_with("compass_b_deg and compass_c_deg"),
            "{wrong}"
        );
        assert!(refused("spikes").contains("KEY=VALUE"));
        assert!(refused("spikes=many").contains("spikes is `many`"));
        assert!(refused("spikes=-1").contains("0 to 64"));
        assert!(refused("surface_m=NaN").contains("surface_m"));
        assert!(refused("surface_m=inf").contains("10000"));
        assert!(refused("fish=2.5").contains("whole"));
        let mut wrong = Disturbances::default();
        wrong.fish.count = f64::NAN;
        assert!(wrong.check().is_err() && Disturbances::default().check().is_ok());
    }
}
