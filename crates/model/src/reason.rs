//! Why the map says of a Gaussian what it says.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Which test gave a Gaussian its verdict. Numbers are those of files and messages; none is used twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Reason {
    /// Nothing is said.
    #[default]
    Unknown = 0,
    /// Ambiguous: spawned since its tile was last worked out.
    NotWorkedOut = 1,
    /// Confident: enough observations are clear.
    ClearlySeen = 2,
    /// Confident: few are, but all together are likely enough.
    Likely = 3,
    /// Confident: nearly so by itself, and beside a surface.
    Linked = 4,
    /// Confident: ground.
    Ground = 5,
    /// Ambiguous: few observations are clear.
    FewClear = 6,
    /// Ambiguous: a small fraction of them is.
    SmallClearShare = 7,
    /// Ambiguous: its observations leave its place open.
    WidePlace = 8,
    /// Ambiguous: a stronger surface is beside it.
    BesideSurface = 9,
    /// Ambiguous: surfaces in front hide it.
    Hidden = 10,
    /// Ambiguous: its mirror image above or below the beam fits as well.
    MirrorFits = 11,
    /// Ambiguous: alone where another sonar is heard.
    IsolatedNear = 12,
    /// Ambiguous: alone.
    Isolated = 13,
    /// Ambiguous: surface there is not likely enough.
    Improbable = 14,
    /// Explained away: a side lobe of a stronger one beside it.
    Outshone = 15,
    /// Explained away: other places on its arcs explain its echoes.
    ExplainsLittle = 16,
    /// Explained away: no observation was lit.
    Unlit = 17,
    /// Explained away: below the ground.
    BelowGround = 18,
}

/// What a test measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Nothing.
    None,
    /// Fraction, in hundredths.
    Percent,
    /// Centimetres.
    Centimetres,
    /// Whole nats.
    Nats,
    /// Whole Gaussians.
    Gaussians,
}

impl Reason {
    /// All, in the order of their numbers.
    pub const ALL: [Self; 19] = [
        Self::Unknown,
        Self::NotWorkedOut,
        Self::ClearlySeen,
        Self::Likely,
        Self::Linked,
        Self::Ground,
        Self::FewClear,
        Self::SmallClearShare,
        Self::WidePlace,
        Self::BesideSurface,
        Self::Hidden,
        Self::MirrorFits,
        Self::IsolatedNear,
        Self::Isolated,
        Self::Improbable,
        Self::Outshone,
        Self::ExplainsLittle,
        Self::Unlit,
        Self::BelowGround,
    ];

    /// Of a file or a message; one that is not known here says nothing.
    #[must_use]
    pub fn of(number: u8) -> Self {
        let found = Self::ALL.get(usize::from(number));
        found.copied().unwrap_or_default()
    }

    /// One word, as in a status and in files that programs read.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::NotWorkedOut => "not_worked_out",
            Self::ClearlySeen => "clearly_seen",
            Self::Likely => "likely",
            Self::Linked => "linked",
            Self::Ground => "ground",
            Self::FewClear => "few_clear",
            Self::SmallClearShare => "small_clear_share",
            Self::WidePlace => "wide_place",
            Self::BesideSurface => "beside_surface",
            Self::Hidden => "hidden",
            Self::MirrorFits => "mirror_fits",
            Self::IsolatedNear => "isolated_near",
            Self::Isolated => "isolated",
            Self::Improbable => "improbable",
            Self::Outshone => "outshone",
            Self::ExplainsLittle => "explains_little",
            Self::Unlit => "unlit",
            Self::BelowGround => "below_ground",
        }
    }

    /// What the test measures.
    #[must_use]
    pub fn unit(self) -> Unit {
        match self {
            Self::Unknown
            | Self::NotWorkedOut
            | Self::Ground
            | Self::Outshone
            | Self::Unlit
            | Self::BelowGround => Unit::None,
            Self::ClearlySeen
            | Self::SmallClearShare
            | Self::BesideSurface
            | Self::Hidden
            | Self::Improbable
            | Self::ExplainsLittle => Unit::Percent,
            Self::WidePlace | Self::Linked | Self::MirrorFits => Unit::Centimetres,
            Self::Likely | Self::FewClear => Unit::Nats,
            Self::IsolatedNear | Self::Isolated => Unit::Gaussians,
        }
    }

    /// The test in plain words; `{}` stands for what it measured, `{clear}` for the clear observations.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Unknown => "the map does not say why",
            Self::NotWorkedOut => "not worked out: spawned since its tile was last worked out",
            Self::ClearlySeen => {
                "enough observations are clear: {clear}, {} of all (8 and 15 % are asked for, 10 where poses jitter)"
            }
            Self::Likely => {
                "only {clear} clear observations, but all together are {} more likely with it than without (15 are asked for)"
            }
            Self::Linked => {
                "{clear} clear observations and a sigma of {} do beside a surface: eight confident Gaussians within six voxels, none five times as strong"
            }
            Self::Ground => "ground, which is mapped as a height",
            Self::FewClear => {
                "only {clear} observations are clear (8 are asked for, 10 where poses jitter), and all together are only {} more likely with it than without (15 are asked for)"
            }
            Self::SmallClearShare => {
                "{clear} observations are clear, but only {} of all (15 % are asked for): something else is mostly beside it"
            }
            Self::WidePlace => {
                "{clear} observations are clear, but leave a sigma of {} (mapper.confident_sigma_m is asked for, 25 cm unless set)"
            }
            Self::BesideSurface => {
                "only {} of what its surroundings send back comes from their middle (50 % are asked for): a stronger surface is beside it"
            }
            Self::Hidden => {
                "surfaces in front hide it in {} of its observations (70 % at most are asked for)"
            }
            Self::MirrorFits => {
                "its mirror image above or below the beam fits as well: it scatters by only {} (30 cm are asked for)"
            }
            Self::IsolatedNear => {
                "alone: only {} within six voxels, and another sonar is heard (2 are asked for)"
            }
            Self::Isolated => "alone: only {} within 16 voxels (12 are asked for)",
            Self::Improbable => {
                "its observations fix it, but make surface there likely to {} only (70 % are asked for, less where voxels are wider than 10 cm)"
            }
            Self::Outshone => {
                "a side lobe: one beside it is more than eight times as strong (12 % of it are asked for)"
            }
            Self::ExplainsLittle => {
                "other places on its arcs explain its echoes: it explains {} of what the best does (15 % are asked for)"
            }
            Self::Unlit => "no ping heard an echo there",
            Self::BelowGround => "below the ground",
        }
    }
}

/// Why a Gaussian has its verdict: three bytes, the same in the mapper, in messages and in files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct Why {
    /// The test that decided.
    pub reason: Reason,
    /// Its clear observations, whole ones; 255 for as many or more.
    pub clear: u8,
    /// What the test measured, in whole steps of its [`Unit`]; 255 for as much or more.
    pub measured: u8,
}

impl Why {
    /// Of a test that measured so much: a fraction, metres, nats or a count. What is below 0 or no number is 0.
    #[must_use]
    pub fn of(reason: Reason, clear: f32, measured: f32) -> Self {
        let steps = match reason.unit() {
            Unit::None => 0.0,
            Unit::Percent | Unit::Centimetres => 100.0,
            Unit::Nats | Unit::Gaussians => 1.0,
        };
        Self {
            reason,
            // Conversions saturate.
            clear: clear as u8,
            measured: (steps * measured) as u8,
        }
    }

    /// As in messages and files.
    #[must_use]
    pub fn bytes(self) -> [u8; 3] {
        [self.reason as u8, self.clear, self.measured]
    }

    /// The inverse; a reason that is not known here says nothing.
    #[must_use]
    pub fn of_bytes([reason, clear, measured]: [u8; 3]) -> Self {
        match Reason::of(reason) {
            Reason::Unknown => Self::default(),
            reason => Self {
                reason,
                clear,
                measured,
            },
        }
    }
}

/// As in `only 3 observations are clear …`.
impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let or_more = |number: u8| match number {
            u8::MAX => "255 or more".to_owned(),
            number => number.to_string(),
        };
        let measured = or_more(self.measured);
        let measured = match self.reason.unit() {
            Unit::None => String::new(),
            Unit::Percent => format!("{measured} %"),
            Unit::Centimetres => format!("{measured} cm"),
            Unit::Nats => format!("{measured} nats"),
            Unit::Gaussians => format!("{measured} confident Gaussians"),
        };
        let words = self.reason.words().replace("{}", &measured);
        f.write_str(&words.replace("{clear}", &or_more(self.clear)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_has_the_number_of_its_place_and_comes_back() {
        for (number, reason) in Reason::ALL.into_iter().enumerate() {
            assert_eq!(reason as usize, number);
            let why = Why::of(reason, 3.9, 0.25);
            assert_eq!(Why::of_bytes(why.bytes()).reason, reason);
            let is_measured = reason.unit() != Unit::None;
            assert_eq!(reason.words().contains("{}"), is_measured, "{reason:?}");
            assert!(!why.to_string().contains('{'), "{why}");
        }
        assert_eq!(Why::of_bytes([200, 1, 2]), Why::default());
    }

    #[test]
    fn figures_saturate_and_stand_in_the_sentence() {
        let why = Why::of(Reason::SmallClearShare, 300.7, 0.128);
        assert_eq!(why.bytes(), [7, 255, 12]);
        assert!(
            why.to_string().starts_with("255 or more observations"),
            "{why}"
        );
        assert!(why.to_string().contains("only 12 % of all"), "{why}");
        let wide = Why::of(Reason::WidePlace, f32::NAN, f32::INFINITY);
        assert_eq!(wide.bytes(), [8, 0, 255]);
        assert_eq!(Why::of(Reason::FewClear, 2.0, -4.0).measured, 0);
    }
}
