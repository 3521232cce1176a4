//! Where on Earth the world of the poses lies.

use echosplat_georeference::{Datum, Georeference, parse_origin};
use serde::{Deserialize, Serialize};

use super::errors::BadSetting;
use crate::placing::EAST_DEG;

/// Where on Earth the world's origin lies, where its owner says it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct GeoreferenceConfig {
    /// Degrees north, degrees east, metres up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) origin: Option<String>,
    /// What its metres up are counted from.
    pub(crate) datum: String,
    /// Of the world's x axis, degrees from true north.
    pub(crate) x_heading_deg: f64,
}

impl Default for GeoreferenceConfig {
    fn default() -> Self {
        Self {
            origin: None,
            datum: Datum::Surface.name().to_owned(),
            x_heading_deg: EAST_DEG,
        }
    }
}

impl GeoreferenceConfig {
    pub(super) fn check(&self) -> Result<(), BadSetting> {
        self.read().map(drop)
    }

    fn read(&self) -> Result<Option<Georeference>, BadSetting> {
        let bad =
            |key: &str, message: String| BadSetting::new(format!("georeference.{key}"), message);
        let datum: Datum = self.datum.parse().map_err(|error| bad("datum", error))?;
        super::within(
            "georeference.x_heading_deg",
            self.x_heading_deg,
            -360.0,
            360.0,
        )?;
        let Some(origin) = &self.origin else {
            return Ok(None);
        };
        let place = parse_origin(origin).map_err(|error| bad("origin", error))?;
        Ok(Some(Georeference {
            x_heading_deg: self.x_heading_deg,
            ..Georeference::at_origin(place, datum, "configuration")
        }))
    }

    /// Takes a place that a dive learned, unless its owner gave one. Learned ones lie at the world's origin.
    pub(crate) fn learn(&mut self, place: &Georeference) {
        if self.origin.is_some() {
            return;
        }
        let at = place.place;
        let numbers = [at.latitude_deg, at.longitude_deg, at.height_m];
        self.origin = Some(numbers.map(|number| format!("{number:?}")).join(","));
        self.datum = place.datum.name().to_owned();
        self.x_heading_deg = place.x_heading_deg;
    }

    /// What it says; nothing is in it that was not checked.
    pub(crate) fn georeference(&self) -> Option<Georeference> {
        self.read().ok().flatten()
    }
}
