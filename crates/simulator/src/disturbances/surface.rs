//! The water's surface as a mirror: each place's echo also comes by way of it.
//!
//! Of a place P a sensor S hears its echo at |SP|; once by way of the surface, where P′ is P's mirror image,
//! at (|SP| + |SP′|) / 2; and there and back by way of it at |SP′|, from where P′ would be. The echo of the
//! surface itself is left out: what is smooth sends back only straight from above.

use glam::DVec3;

use super::power;
use crate::scene::Hit;
use crate::sonar::{Echo, Listener};

/// What two casts to the same place may differ by.
const TOLERANCE_M: f64 = 0.005;
/// Of a place that is met edge-on, so that its area stays finite.
const LEAST_FACING: f64 = 0.05;

/// A mirroring surface of the water, level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WaterSurface {
    /// Height in the world, metres, z up, −10⁴ to 10⁴, above all of the track; infinite is no surface.
    /// What of the structure stands above it has no image.
    pub height_m: f64,
    /// Loss at each reflection, decibels, 0 to 60; 3 by default, chosen: water sends back all, waves turn
    /// it elsewhere and bubbles under them swallow some (Dahl 2001, High-frequency forward scattering
    /// from the sea surface).
    pub loss_db: f64,
    /// The least that the beam hears of an image, one way, decibels below its axis, 0 to 100. An image
    /// mostly lies beyond the fan's edge and, where the sensor is rolled, beside its beam; waves scatter it
    /// into the beam from beside. No unit was measured there: 13 dB is the first side lobe of an evenly driven
    /// line. At 100 the surface is a flat mirror and the beam ends as it does for echoes.
    pub beyond_beam_db: f64,
}

impl Default for WaterSurface {
    fn default() -> Self {
        Self {
            height_m: f64::INFINITY,
            loss_db: 3.0,
            beyond_beam_db: 13.0,
        }
    }
}

/// One way of a place's echo: middle and half width of its ranges, metres, and its power.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Arrival {
    pub(crate) middle_m: f64,
    pub(crate) half_m: f64,
    pub(crate) power: f64,
}

impl WaterSurface {
    pub(crate) fn is_there(&self) -> bool {
        self.height_m.is_finite()
    }

    /// What comes of `echo` by way of the surface once, and there and back. `None` where the surface does
    /// not show its place to the sensor.
    pub(crate) fn images(&self, listener: &Listener<'_>, echo: &Echo<'_>) -> Option<[Arrival; 2]> {
        let (place, origin) = (echo.hit.position, echo.origin);
        let above_m = self.height_m - origin.z;
        if !(above_m > 0.0 && place.z < self.height_m) {
            return None;
        }
        let image = DVec3::new(place.x, place.y, 2.0 * self.height_m - place.z);
        let image_m = image.distance(origin);
        let up = (image - origin) / image_m;
        let down = DVec3::new(up.x, up.y, -up.z);
        let facing = self.facing(echo, down)?;
        if !self.is_open(listener, origin, up, place) {
            return None;
        }

        // Power of the same piece of surface from where its image is: by its solid angle there, what it
        // sends back at that angle and over that range, and what the beam hears from there.
        let hit = Hit {
            distance_m: image_m,
            ..echo.hit
        };
        let near = echo.hit.distance_m / image_m;
        let solid_angle = near * near * facing / echo.facing().max(LEAST_FACING);
        let heard = listener.fan.sensitivity(echo.rotation.transpose() * up);
        let heard = heard.max(power(-2.0 * self.beyond_beam_db));
        let own = listener.fan.sensitivity(echo.cell.ray);
        let direct = echo.power(listener.radiometry);
        let sent_back = listener.radiometry.sent_back(&hit, facing);
        let alone = echo.cell.weight * solid_angle * sent_back * heard / own;
        // The way round and its reverse arrive at once and in phase, by reciprocity: twice the amplitude.
        let once = 4.0 * power(-self.loss_db) * (direct * alone).sqrt();
        let twice = power(-2.0 * self.loss_db) * alone;

        let (met_m, by_image_m) = (echo.edges_m(), self.edges_m(echo));
        let mixed_m = [0, 1, 2, 3].map(|edge| 0.5 * (met_m[edge] + by_image_m[edge]));
        let arrival = |edges_m: [f64; 4], power: f64| {
            let (middle_m, half_m) = Echo::spread(edges_m);
            Arrival {
                middle_m,
                half_m,
                power,
            }
        };
        Some([arrival(mixed_m, once), arrival(by_image_m, twice)])
    }

    /// Cosine to the normal of a place of a ray that comes down from the surface; `None` if it meets
    /// the other side of it.
    fn facing(&self, echo: &Echo<'_>, down: DVec3) -> Option<f64> {
        let (direct, mirrored) = (echo.normal.dot(echo.cell.ray), echo.hit.normal.dot(down));
        (direct * mirrored > 0.0).then_some(mirrored.abs())
    }

    /// Whether nothing stands in the way from the sensor up to the surface and down to the place.
    fn is_open(&self, listener: &Listener<'_>, origin: DVec3, up: DVec3, place: DVec3) -> bool {
        let climb_m = (self.height_m - origin.z) / up.z;
        let mirror = origin + up * climb_m;
        let fall_m = mirror.distance(place);
        let down = (place - mirror) / fall_m;
        let is_free = |from: DVec3, along: DVec3, length_m: f64| {
            listener.scene.cast(from, along, length_m).is_none()
        };
        is_free(origin, up, climb_m) && is_free(mirror, down, fall_m - TOLERANCE_M)
    }

    /// How far the edges of a cell's piece of surface are from the sensor by way of the mirror, which is
    /// how far they are from the sensor's image.
    fn edges_m(&self, echo: &Echo<'_>) -> [f64; 4] {
        let to_image = DVec3::Z * (2.0 * (self.height_m - echo.origin.z));
        let image = echo.rotation.transpose() * to_image;
        let met_m = echo.edges_m();
        [0, 1, 2, 3].map(|edge| (echo.cell.edges[edge] * met_m[edge]).distance(image))
    }
}

#[cfg(test)]
mod tests;
