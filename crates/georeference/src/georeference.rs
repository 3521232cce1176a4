//! The tie between a world of poses and the Earth.

use echosplat_model::glam::{DMat3, DVec3};
use echosplat_model::is_origin;

use crate::{Datum, Place, PlaceError};

/// Degrees; x of a world that is called ENU points east.
const EAST_DEG: f64 = 90.0;

/// Characters; what is told of where it came from fits a comment line.
const LONGEST_SOURCE: usize = 100;

/// Where a world lies: z is up, and at `anchor_m` the world touches the Earth.
#[derive(Debug, Clone, PartialEq)]
pub struct Georeference {
    /// A point of the world, metres.
    pub anchor_m: DVec3,
    /// Where that is; its height is over `datum`.
    pub place: Place,
    /// What heights are counted from.
    pub datum: Datum,
    /// Heading of the world's x axis at the anchor, degrees clockwise from true north; 90 if x is east.
    pub x_heading_deg: f64,
    /// Where this was taken from, in a few words.
    pub source: String,
}

/// Why a line says no georeference.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GeoreferenceError {
    /// Its place.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// All else.
    #[error(
        "a georeference reads `wgs84 LAT LON HEIGHT DATUM x_heading DEGREES anchor X Y Z from WORDS`"
    )]
    Form,
}

impl Georeference {
    /// Of a world whose origin lies there and whose x points east.
    #[must_use]
    pub fn at_origin(place: Place, datum: Datum, source: &str) -> Self {
        Self {
            anchor_m: DVec3::ZERO,
            place,
            datum,
            x_heading_deg: EAST_DEG,
            source: source.to_owned(),
        }
    }

    /// East, north and up of a direction of the world.
    #[must_use]
    pub fn enu_from_world(&self) -> DMat3 {
        let (sin, cos) = self.x_heading_deg.to_radians().sin_cos();
        DMat3::from_cols(
            DVec3::new(sin, cos, 0.0),
            DVec3::new(-cos, sin, 0.0),
            DVec3::Z,
        )
    }

    /// Where a point of the world is, metres. Distances are those of WGS 84: the Earth bends away below a flat world.
    #[must_use]
    pub fn place_of(&self, world_m: DVec3) -> Place {
        self.place
            .moved(self.enu_from_world() * (world_m - self.anchor_m))
    }

    /// The point of the world at a place, metres.
    #[must_use]
    pub fn world_of(&self, place: &Place) -> DVec3 {
        self.enu_from_world().transpose() * self.place.enu_of(place) + self.anchor_m
    }

    /// With heights over the ellipsoid, if the ellipsoid lies so far below what they are over now.
    #[must_use]
    pub fn over_ellipsoid(mut self, separation_m: f64) -> Self {
        self.place.height_m += separation_m;
        self.datum = Datum::Ellipsoid;
        self
    }

    /// One line, without losing a bit; [`Georeference::parse`] reads it.
    #[must_use]
    pub fn line(&self) -> String {
        let Place {
            latitude_deg,
            longitude_deg,
            height_m,
        } = self.place;
        let [x, y, z] = self.anchor_m.to_array();
        let words: Vec<&str> = self.source.split_whitespace().collect();
        let source: String = words.join(" ");
        let source: String = source
            .chars()
            .filter(|c| !c.is_control())
            .take(LONGEST_SOURCE)
            .collect();
        format!(
            "wgs84 {latitude_deg:?} {longitude_deg:?} {height_m:?} {} x_heading {:?} anchor {x:?} {y:?} {z:?} from {source}",
            self.datum, self.x_heading_deg
        )
    }

    /// What [`Georeference::line`] wrote.
    ///
    /// # Errors
    /// If it is none, or names a place that there is not.
    pub fn parse(line: &str) -> Result<Self, GeoreferenceError> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [
            "wgs84",
            latitude,
            longitude,
            height,
            datum,
            "x_heading",
            heading,
            "anchor",
            x,
            y,
            z,
            "from",
            source @ ..,
        ] = &words[..]
        else {
            return Err(GeoreferenceError::Form);
        };
        let number = |text: &str| text.parse::<f64>().unwrap_or(f64::NAN);
        let anchor_m = DVec3::new(number(x), number(y), number(z));
        let x_heading_deg = number(heading);
        let datum = datum.parse().map_err(|_| GeoreferenceError::Form)?;
        if !is_origin(anchor_m) || !(x_heading_deg.abs() <= 360.0) {
            return Err(GeoreferenceError::Form);
        }
        Ok(Self {
            anchor_m,
            place: Place::new(number(latitude), number(longitude), number(height))?,
            datum,
            x_heading_deg,
            source: source.join(" "),
        })
    }
}
