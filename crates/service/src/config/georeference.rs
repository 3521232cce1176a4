//! Where on Earth the world of the poses lies.

use echosplat_georeference::{BesideRule, Datum, Georeference, parse_origin};
use echosplat_model::glam::DVec3;
use echosplat_pose::GnssUrl;
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
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) x_heading_deg: Option<f64>,
    /// The receiver on the vehicle whose fixes tell the origin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) gnss: Option<GnssUrl>,
    /// Its antenna in the vehicle, metres forward, left and up.
    pub(crate) antenna_m: [f64; 3],
}

/// Metres; no antenna is farther from where its vehicle's poses are.
const FARTHEST_ANTENNA_M: f64 = 50.0;

impl Default for GeoreferenceConfig {
    fn default() -> Self {
        Self {
            origin: None,
            datum: Datum::Surface.name().to_owned(),
            x_heading_deg: None,
            gnss: None,
            antenna_m: [0.0; 3],
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
        let x_heading_deg = self.x_heading_deg.unwrap_or(EAST_DEG);
        super::within("georeference.x_heading_deg", x_heading_deg, -360.0, 360.0)?;
        for metres in self.antenna_m {
            let most = FARTHEST_ANTENNA_M;
            super::within("georeference.antenna_m", metres, -most, most)?;
        }
        let Some(origin) = &self.origin else {
            return Ok(None);
        };
        let place = parse_origin(origin).map_err(|error| bad("origin", error))?;
        Ok(Some(Georeference {
            x_heading_deg,
            ..Georeference::at_origin(place, datum, "configuration")
        }))
    }

    /// What is known beside fixes; `is_enu` as the source of poses has it.
    pub(crate) fn beside(&self, is_enu: bool, max_pose_gap_s: f64) -> BesideRule {
        BesideRule {
            x_heading_deg: self.x_heading_deg,
            is_enu,
            antenna_m: DVec3::from_array(self.antenna_m),
            max_pose_gap_s,
        }
    }

    /// What it says; nothing is in it that was not checked.
    pub(crate) fn georeference(&self) -> Option<Georeference> {
        self.read().ok().flatten()
    }
}
