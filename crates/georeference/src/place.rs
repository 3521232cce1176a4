//! A point near the Earth's surface, and the same from the Earth's middle.

use echosplat_model::glam::{DMat3, DVec3};

/// Metres; half the longest axis of WGS 84.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
/// Of WGS 84, without a unit.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
const ECCENTRICITY_2: f64 = FLATTENING * (2.0 - FLATTENING);

/// Metres; no dive is as far from the surface, and no number in other units as near.
const MAX_HEIGHT_M: f64 = 20_000.0;

/// Steps of the way back from the Earth's middle; three are exact to a nanometre.
const STEPS: usize = 5;

/// A point in WGS 84.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Degrees, north of the equator, −90 to 90.
    pub latitude_deg: f64,
    /// Degrees, east of Greenwich, −180 to 180.
    pub longitude_deg: f64,
    /// Metres, upward, over what its owner's datum says.
    pub height_m: f64,
}

/// Why there is no such place.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PlaceError {
    /// Degrees of latitude.
    #[error("a latitude of {0} degrees: it must be within -90 to 90")]
    Latitude(f64),
    /// Degrees of longitude.
    #[error("a longitude of {0} degrees: it must be within -180 to 180")]
    Longitude(f64),
    /// Metres.
    #[error("a height of {0} m: it must be within -{MAX_HEIGHT_M} to {MAX_HEIGHT_M}")]
    Height(f64),
}

impl Place {
    /// Degrees north, degrees east, metres up.
    ///
    /// # Errors
    /// The first number that cannot be.
    pub fn new(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Result<Self, PlaceError> {
        // NaN is within nothing.
        if !(-90.0..=90.0).contains(&latitude_deg) {
            return Err(PlaceError::Latitude(latitude_deg));
        }
        if !(-180.0..=180.0).contains(&longitude_deg) {
            return Err(PlaceError::Longitude(longitude_deg));
        }
        if !(-MAX_HEIGHT_M..=MAX_HEIGHT_M).contains(&height_m) {
            return Err(PlaceError::Height(height_m));
        }
        Ok(Self {
            latitude_deg,
            longitude_deg,
            height_m,
        })
    }

    /// From the Earth's middle, metres: x to the equator at Greenwich, z to the north pole. The height is taken for
    /// one over the ellipsoid.
    #[must_use]
    pub fn from_middle_m(&self) -> DVec3 {
        let (sin_lat, cos_lat) = self.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude_deg.to_radians().sin_cos();
        let normal_m = SEMI_MAJOR_M / (1.0 - ECCENTRICITY_2 * sin_lat * sin_lat).sqrt();
        let around_m = (normal_m + self.height_m) * cos_lat;
        let up_m = (normal_m * (1.0 - ECCENTRICITY_2) + self.height_m) * sin_lat;
        DVec3::new(around_m * cos_lon, around_m * sin_lon, up_m)
    }

    /// The place at a point that is not near the Earth's middle: there the numbers have no meaning.
    #[must_use]
    pub fn at(from_middle_m: DVec3) -> Self {
        let around_m = from_middle_m.x.hypot(from_middle_m.y);
        let z_m = from_middle_m.z;
        // Latitude from the point at this height below the surface's normal, again and again.
        let mut latitude = z_m.atan2(around_m * (1.0 - ECCENTRICITY_2));
        for _ in 0..STEPS {
            let sin = latitude.sin();
            let normal_m = SEMI_MAJOR_M / (1.0 - ECCENTRICITY_2 * sin * sin).sqrt();
            latitude = (z_m + ECCENTRICITY_2 * normal_m * sin).atan2(around_m);
        }
        let (sin, cos) = latitude.sin_cos();
        let foot_m = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_2 * sin * sin).sqrt();
        Self {
            latitude_deg: latitude.to_degrees(),
            longitude_deg: from_middle_m.y.atan2(from_middle_m.x).to_degrees(),
            height_m: around_m * cos + z_m * sin - foot_m,
        }
    }

    /// Columns are east, north and up at this place, seen from the Earth's middle.
    pub(crate) fn middle_from_enu(&self) -> DMat3 {
        let (sin_lat, cos_lat) = self.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude_deg.to_radians().sin_cos();
        DMat3::from_cols(
            DVec3::new(-sin_lon, cos_lon, 0.0),
            DVec3::new(-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat),
            DVec3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat),
        )
    }

    /// The other place as metres east, north and up of this one, in the plane that touches the Earth here.
    #[must_use]
    pub fn enu_of(&self, other: &Self) -> DVec3 {
        let apart_m = other.from_middle_m() - self.from_middle_m();
        self.middle_from_enu().transpose() * apart_m
    }

    /// The place at metres east, north and up of this one.
    #[must_use]
    pub fn moved(&self, enu_m: DVec3) -> Self {
        Self::at(self.from_middle_m() + self.middle_from_enu() * enu_m)
    }
}
