//! How much a simulation is disturbed.

/// Named amounts of noise, in the device and in the poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NoiseLevel {
    /// Neither speckle nor background; 16-bit decibels still.
    #[default]
    None,
    /// Speckle of 4 looks, background 45 dB down, ring-down; poses off by 2 cm and 0.2° from
    /// reading to reading and drifting by 2 cm and 0.1°.
    Nominal,
    /// What a real unit hears and reports: echoes that fall with range, 5 to 30 dB above a noise that
    /// does not, speckle of one look, automatic gain; poses off by 1 cm and 0.1° from reading to
    /// reading, and by 2 cm and 0.1° more after 100 s, for good.
    Field,
    /// One look, and all that goes wrong at sea: dropouts, ghosts, side lobes, a walking gain, a
    /// range change, clock drift, bad poses and an outage of them.
    Harsh,
}

impl NoiseLevel {
    /// All of them, mildest first.
    pub const ALL: [Self; 4] = [Self::None, Self::Nominal, Self::Field, Self::Harsh];

    /// As in configurations and reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Nominal => "nominal",
            Self::Field => "field",
            Self::Harsh => "harsh",
        }
    }

    /// Independent looks per bin; none is no speckle.
    pub(crate) fn looks(self) -> Option<u32> {
        match self {
            Self::None => None,
            Self::Nominal => Some(4),
            Self::Field | Self::Harsh => Some(1),
        }
    }

    pub(crate) fn is_harsh(self) -> bool {
        self == Self::Harsh
    }

    pub(crate) fn is_field(self) -> bool {
        self == Self::Field
    }

    pub(crate) fn pose_noise(self) -> PoseNoise {
        let degrees = f64::to_radians;
        match self {
            Self::None => PoseNoise::default(),
            Self::Nominal => PoseNoise {
                white_m: 0.02,
                white_rad: degrees(0.2),
                drift_m: 0.02,
                drift_rad: degrees(0.1),
                ..PoseNoise::default()
            },
            // A velocity log and a compass: dead reckoning of position and heading walks away, depth
            // and tilt are measured against pressure and gravity and do not. Chosen within what such
            // instruments are sold as.
            Self::Field => PoseNoise {
                white_m: 0.01,
                white_rad: degrees(0.1),
                walk_m: 0.02,
                walk_rad: degrees(0.1),
                ..PoseNoise::default()
            },
            Self::Harsh => PoseNoise {
                white_m: 0.10,
                white_rad: degrees(1.0),
                drift_m: 0.08,
                drift_rad: degrees(0.5),
                outage_s: 3.0,
                ..PoseNoise::default()
            },
        }
    }

    /// How much faster than time the device's clock runs.
    pub(crate) fn clock_drift(self) -> f64 {
        if self.is_harsh() { 50e-6 } else { 0.0 }
    }
}

/// Errors of reported poses, one sigma per axis.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PoseNoise {
    pub(crate) white_m: f64,
    pub(crate) white_rad: f64,
    /// Of a Gauss–Markov process with a time constant of 60 s.
    pub(crate) drift_m: f64,
    pub(crate) drift_rad: f64,
    /// Of a random walk of the horizontal position and of the heading, after 100 s.
    pub(crate) walk_m: f64,
    pub(crate) walk_rad: f64,
    /// Time without any pose, in the middle of the dive.
    pub(crate) outage_s: f64,
}

impl std::fmt::Display for NoiseLevel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

impl std::str::FromStr for NoiseLevel {
    type Err = UnknownNoiseLevel;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let found = Self::ALL.into_iter().find(|level| level.as_str() == name);
        found.ok_or_else(|| UnknownNoiseLevel(name.to_owned()))
    }
}

/// Not the name of a noise level.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no noise level is called `{0}`; there are none, nominal, field and harsh")]
pub struct UnknownNoiseLevel(String);
