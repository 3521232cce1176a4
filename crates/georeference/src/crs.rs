//! Coordinates of a projection.

use std::fmt;

use echosplat_model::glam::DVec2;
use proj4rs::Proj;
use proj4rs::transform::transform;

use crate::Place;
use crate::known_codes::definition;

/// Degrees; beyond, UTM ends and the polar projections begin.
const UTM_SOUTH_DEG: f64 = -80.0;
/// Degrees; beyond, UTM ends and the polar projections begin.
const UTM_NORTH_DEG: f64 = 84.0;

/// Degrees northward, about a metre: over it the grid's north is measured.
const STEP_DEG: f64 = 1e-5;

/// What coordinates are counted in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LengthUnit {
    /// Degrees: x east, y north.
    Degrees,
    /// So many metres.
    Metres(f64),
}

/// A coordinate reference system by its code in the EPSG register.
pub struct Crs {
    code: u16,
    wkt: String,
    proj: Proj,
    geographic: Proj,
}

/// Why there is no such system, or no coordinates in it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CrsError {
    /// No code.
    #[error("`{0}` is no coordinate reference system: it reads EPSG:CODE, as in EPSG:32635")]
    Form(String),
    /// Not in the register, or not in this build.
    #[error(
        "EPSG:{code} is not known{}",
        match cfg!(feature = "epsg") {
            true => "",
            false => " to this build, which has UTM, UPS and EPSG:4326; the cargo feature `epsg` has them all",
        }
    )]
    Unknown {
        /// Of the register.
        code: u32,
    },
    /// Its projection cannot be computed here.
    #[error("EPSG:{code} cannot be computed: {why}")]
    Unusable {
        /// Of the register.
        code: u16,
        /// What is missing.
        why: String,
    },
    /// Outside what the projection can show.
    #[error(
        "EPSG:{code} has no coordinates at latitude {latitude_deg:.6}, longitude {longitude_deg:.6}"
    )]
    Outside {
        /// Of the register.
        code: u16,
        /// Degrees.
        latitude_deg: f64,
        /// Degrees.
        longitude_deg: f64,
    },
}

/// How a grid lies at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Heading of the grid's north from true north, degrees clockwise.
    pub convergence_deg: f64,
    /// Length in the grid of a metre on the ellipsoid, northward.
    pub scale: f64,
}

impl fmt::Debug for Crs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Crs({self})")
    }
}

impl fmt::Display for Crs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "EPSG:{} ({})", self.code, self.name())
    }
}

impl Crs {
    /// By code.
    ///
    /// # Errors
    /// If it is not known, or no map can be told in it.
    pub fn of_code(code: u16) -> Result<Self, CrsError> {
        let found = definition(code).ok_or(CrsError::Unknown { code: code.into() })?;
        let unusable = |why: String| CrsError::Unusable { code, why };
        let proj = Proj::from_proj_string(&found.proj);
        let proj = proj.map_err(|error| unusable(error.to_string()))?;
        if proj.is_geocent() || !proj.has_forward() || !proj.has_inverse() {
            return Err(unusable("it is no map projection".to_owned()));
        }
        let geographic = "+proj=longlat +datum=WGS84 +no_defs";
        let geographic = Proj::from_proj_string(geographic);
        Ok(Self {
            code,
            wkt: found.wkt,
            proj,
            geographic: geographic.map_err(|error| unusable(error.to_string()))?,
        })
    }

    /// Reads `EPSG:CODE`, or the code alone.
    ///
    /// # Errors
    /// As [`Crs::of_code`], and if it is no code.
    pub fn parse(text: &str) -> Result<Self, CrsError> {
        let head = text
            .get(..5)
            .filter(|head| head.eq_ignore_ascii_case("epsg:"));
        let digits = head.map_or(text, |head| &text[head.len()..]);
        let code: u32 = digits
            .parse()
            .map_err(|_| CrsError::Form(text.to_owned()))?;
        let short = u16::try_from(code).map_err(|_| CrsError::Unknown { code })?;
        Self::of_code(short)
    }

    /// The UTM zone of a place, as Norway and Svalbard have it too; near the poles UPS.
    ///
    /// # Errors
    /// None that a place can cause.
    pub fn utm_of(place: &Place) -> Result<Self, CrsError> {
        let (latitude, longitude) = (place.latitude_deg, place.longitude_deg);
        if latitude > UTM_NORTH_DEG {
            return Self::of_code(5041);
        }
        if latitude < UTM_SOUTH_DEG {
            return Self::of_code(5042);
        }
        let regular = ((longitude + 180.0) / 6.0).floor() as u16 % 60 + 1;
        let zone = match (latitude, longitude) {
            (56.0..64.0, 3.0..12.0) => 32,
            (72.0..=84.0, 0.0..9.0) => 31,
            (72.0..=84.0, 9.0..21.0) => 33,
            (72.0..=84.0, 21.0..33.0) => 35,
            (72.0..=84.0, 33.0..42.0) => 37,
            _ => regular,
        };
        let base = if latitude < 0.0 { 32700 } else { 32600 };
        Self::of_code(base + zone)
    }

    /// Of the register.
    #[must_use]
    pub fn code(&self) -> u16 {
        self.code
    }

    /// Well-known text, first version.
    #[must_use]
    pub fn wkt(&self) -> &str {
        &self.wkt
    }

    /// As the register calls it.
    #[must_use]
    pub fn name(&self) -> &str {
        self.wkt.split('"').nth(1).unwrap_or("")
    }

    /// What its coordinates are counted in.
    #[must_use]
    pub fn unit(&self) -> LengthUnit {
        match self.proj.is_latlong() {
            true => LengthUnit::Degrees,
            false => LengthUnit::Metres(self.proj.to_meter()),
        }
    }

    /// East and north coordinates of a place; its height stays what it is.
    ///
    /// # Errors
    /// If the projection shows no such place.
    pub fn project(&self, place: &Place) -> Result<DVec2, CrsError> {
        let mut point = (
            place.longitude_deg.to_radians(),
            place.latitude_deg.to_radians(),
            0.0,
        );
        let outside = CrsError::Outside {
            code: self.code,
            latitude_deg: place.latitude_deg,
            longitude_deg: place.longitude_deg,
        };
        if transform(&self.geographic, &self.proj, &mut point).is_err() {
            return Err(outside);
        }
        let found = DVec2::new(point.0, point.1);
        let found = match self.unit() {
            LengthUnit::Degrees => DVec2::new(found.x.to_degrees(), found.y.to_degrees()),
            LengthUnit::Metres(_) => found,
        };
        found.is_finite().then_some(found).ok_or(outside)
    }

    /// The place at coordinates, with this height.
    ///
    /// # Errors
    /// If the projection has none there.
    pub fn unproject(&self, at: DVec2, height_m: f64) -> Result<Place, CrsError> {
        let at = match self.unit() {
            LengthUnit::Degrees => DVec2::new(at.x.to_radians(), at.y.to_radians()),
            LengthUnit::Metres(_) => at,
        };
        let mut point = (at.x, at.y, 0.0);
        let done = transform(&self.proj, &self.geographic, &mut point);
        let (longitude_deg, latitude_deg) = (point.0.to_degrees(), point.1.to_degrees());
        let place = Place::new(latitude_deg, longitude_deg, height_m).ok();
        let outside = CrsError::Outside {
            code: self.code,
            latitude_deg,
            longitude_deg,
        };
        done.ok().and(place).ok_or(outside)
    }

    /// How the grid lies there.
    ///
    /// # Errors
    /// If the projection shows no such place.
    pub fn grid(&self, place: &Place) -> Result<Grid, CrsError> {
        let half = |sign: f64| Place {
            latitude_deg: (place.latitude_deg + sign * 0.5 * STEP_DEG).clamp(-90.0, 90.0),
            longitude_deg: place.longitude_deg,
            height_m: 0.0,
        };
        let (south, north) = (half(-1.0), half(1.0));
        let step = self.project(&north)? - self.project(&south)?;
        let unit_m = match self.unit() {
            LengthUnit::Degrees => {
                return Ok(Grid {
                    convergence_deg: 0.0,
                    scale: 1.0,
                });
            }
            LengthUnit::Metres(unit_m) => unit_m,
        };
        let earth_m = south.from_middle_m().distance(north.from_middle_m());
        Ok(Grid {
            convergence_deg: -step.x.atan2(step.y).to_degrees(),
            scale: step.length() * unit_m / earth_m,
        })
    }
}
