//! What a satellite receiver tells, whatever it was told in.

use echosplat_model::Timestamp;

use crate::{Datum, Place};

/// Metres, one sigma along one axis; a receiver without corrections under an open sky, whose fix tells no accuracy.
pub const USUAL_SIGMA_M: f64 = 3.0;
/// Metres; what claims to be better, or worse, is taken for this.
const SIGMAS_M: std::ops::RangeInclusive<f64> = 0.01..=100.0;

/// One fix of the antenna.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// When it was there, on the clock of poses or pings.
    pub time: Timestamp,
    /// Where; its height is over `datum`, and 0 where that is `None`.
    pub place: Place,
    /// What the height is counted from; `None` if none was told.
    pub datum: Option<Datum>,
    /// Height of the geoid over the ellipsoid as the receiver has it, metres.
    pub separation_m: Option<f64>,
    /// One sigma along north or east, metres.
    pub sigma_m: f64,
}

/// One thing that a receiver told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Heard {
    /// A fix.
    Fix(Fix),
    /// Where the vehicle's bow points, degrees clockwise from true north.
    Heading {
        /// When it did.
        time: Timestamp,
        /// 0 to 360.
        heading_deg: f64,
    },
}

impl Heard {
    /// When it was so.
    #[must_use]
    pub fn time(&self) -> Timestamp {
        match self {
            Self::Fix(fix) => fix.time,
            Self::Heading { time, .. } => *time,
        }
    }

    /// The same, on a clock that is ahead by so much.
    #[must_use]
    pub fn offset_by(mut self, seconds: f64) -> Self {
        match &mut self {
            Self::Fix(Fix { time, .. }) | Self::Heading { time, .. } => {
                *time = time.offset_by(seconds);
            }
        }
        self
    }

    /// One line, without losing a bit; [`Heard::parse`] reads it. Times are nanoseconds.
    #[must_use]
    pub fn line(&self) -> String {
        match self {
            Self::Heading { time, heading_deg } => {
                format!("heading {} {heading_deg:?}", time.nanos())
            }
            Self::Fix(fix) => {
                let Place {
                    latitude_deg,
                    longitude_deg,
                    height_m,
                } = fix.place;
                let datum = fix.datum.map_or("none", Datum::name);
                let separation = fix.separation_m.map(|metres| format!(" {metres:?}"));
                format!(
                    "fix {} {latitude_deg:?} {longitude_deg:?} {height_m:?} {datum} {:?}{}",
                    fix.time.nanos(),
                    fix.sigma_m,
                    separation.unwrap_or_default()
                )
            }
        }
    }

    /// What [`Heard::line`] wrote; `None` if it is not that.
    #[must_use]
    pub fn parse(line: &str) -> Option<Self> {
        let number = |text: &str| text.parse::<f64>().ok().filter(|number| number.is_finite());
        let time = |text: &str| text.parse().ok().map(Timestamp::from_nanos);
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["heading", at, heading] => Some(Self::Heading {
                time: time(at)?,
                heading_deg: number(heading).filter(|deg| (0.0..=360.0).contains(deg))?,
            }),
            [
                "fix",
                at,
                latitude,
                longitude,
                height,
                datum,
                sigma,
                ref separation @ ..,
            ] if separation.len() < 2 => Some(Self::Fix(Fix {
                time: time(at)?,
                place: Place::new(number(latitude)?, number(longitude)?, number(height)?).ok()?,
                datum: match datum {
                    "none" => None,
                    name => Some(name.parse().ok()?),
                },
                separation_m: match separation {
                    [metres] => Some(number(metres)?),
                    _ => None,
                },
                sigma_m: sigma_of(number(sigma)),
            })),
            _ => None,
        }
    }
}

/// One sigma that can be used: what is told, within bounds, or the usual.
#[must_use]
pub fn sigma_of(told_m: Option<f64>) -> f64 {
    let told_m = told_m.filter(|sigma_m| sigma_m.is_finite() && *sigma_m > 0.0);
    told_m.map_or(USUAL_SIGMA_M, |sigma_m| {
        sigma_m.clamp(*SIGMAS_M.start(), *SIGMAS_M.end())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_gives_back_every_bit() {
        let place = Place::new(60.170_000_123_456_7, -24.940_000_000_000_1, 0.1 + 0.2).unwrap();
        let fix = |datum, separation_m| {
            Heard::Fix(Fix {
                time: Timestamp::from_nanos(1_714_564_800_123_456_789),
                place,
                datum,
                separation_m,
                sigma_m: 1.0 / 3.0,
            })
        };
        let heading = Heard::Heading {
            time: Timestamp::from_nanos(-7),
            heading_deg: 359.9,
        };
        let all = [
            fix(None, None),
            fix(Some(Datum::MeanSea), Some(17.1)),
            fix(Some(Datum::Ellipsoid), None),
            heading,
        ];
        for heard in all {
            assert_eq!(Heard::parse(&heard.line()), Some(heard));
        }
        for wrong in [
            "",
            "fix",
            "fix 1 95 0 0 msl 1",
            "fix 1 NaN 0 0 msl 1",
            "fix 1 0 0 0 sea 1",
            "fix 1 0 0 0 msl 1 2 3",
            "heading 1 400",
            "heading x 4",
        ] {
            assert_eq!(Heard::parse(wrong), None, "{wrong}");
        }
    }
}
