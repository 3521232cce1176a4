//! Places and datums in words.

use std::fmt;
use std::str::FromStr;

use crate::Place;

/// What heights are counted from. None is made of another here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Datum {
    /// The water's surface where and when it was dived: minus a height is a depth.
    #[default]
    Surface,
    /// Mean sea level, as autopilots and NMEA tell.
    MeanSea,
    /// The ellipsoid of WGS 84, as ROS tells.
    Ellipsoid,
}

impl Datum {
    /// All there are.
    pub const ALL: [Self; 3] = [Self::Surface, Self::MeanSea, Self::Ellipsoid];

    /// As it is written and read.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Surface => "surface",
            Self::MeanSea => "msl",
            Self::Ellipsoid => "ellipsoid",
        }
    }

    /// For people.
    #[must_use]
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Surface => "the water's surface",
            Self::MeanSea => "mean sea level",
            Self::Ellipsoid => "the WGS 84 ellipsoid",
        }
    }
}

impl fmt::Display for Datum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Datum {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|datum| datum.name() == text);
        found.ok_or_else(|| format!("`{text}` is no datum; there are surface, msl and ellipsoid"))
    }
}

/// `LAT,LON,ALT` as degrees north, degrees east and metres up.
///
/// # Errors
/// Says what is wrong with it.
pub fn parse_origin(text: &str) -> Result<Place, String> {
    let numbers = three_numbers(text).ok_or_else(|| {
        format!(
            "`{text}`: it must be three numbers, latitude and longitude in degrees and metres up, as in 60.17,24.94,0"
        )
    })?;
    let [latitude_deg, longitude_deg, height_m] = numbers;
    Place::new(latitude_deg, longitude_deg, height_m).map_err(|error| error.to_string())
}

pub(crate) fn three_numbers(text: &str) -> Option<[f64; 3]> {
    let mut numbers = [f64::NAN; 3];
    let mut words = text.split(',');
    for number in &mut numbers {
        *number = words.next()?.trim().parse().ok()?;
    }
    let are_finite = numbers.iter().all(|number| number.is_finite());
    (are_finite && words.next().is_none()).then_some(numbers)
}
