//! Places that are measured by, and how far two of them are apart.

use echosplat_model::glam::{DMat3, DVec3, Vec3};
use echosplat_model::{Gaussian, Reason, Standing};

use crate::SurveyError;
use crate::grid::Grid;

/// A Gaussian as a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// World coordinates, metres.
    pub at_m: DVec3,
    /// Of the place, square metres; infinite where nothing is known.
    pub covariance_m2: DMat3,
    /// That there is surface, 0 to 1.
    pub probability: f64,
    /// Whether the map asserts it.
    pub is_confident: bool,
    /// Whether it is of the ground that the map assumes: as far as a dive heard it, at one height over some width.
    pub is_ground: bool,
}

/// A number and its sigma, in one unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Told {
    /// The best guess.
    pub value: f64,
    /// One sigma; infinite if nothing is known.
    pub sigma: f64,
}

impl Sample {
    /// One sigma of the place along a direction of unit length, metres.
    #[must_use]
    pub fn sigma_along_m(&self, direction: DVec3) -> f64 {
        // Infinity times zero is no number: of such a place nothing is known in any direction.
        let variance = direction.dot(self.covariance_m2 * direction);
        if variance.is_nan() {
            f64::INFINITY
        } else {
            variance.max(0.0).sqrt()
        }
    }
}

/// The sound Gaussians of a map as places, in its order.
#[must_use]
pub fn samples_of(origin_m: DVec3, gaussians: &[Gaussian]) -> Vec<Sample> {
    let sample = |gaussian: &Gaussian| {
        let [xx, xy, xz, yy, yz, zz] = gaussian.position_covariance_m2.map(f64::from);
        let columns = [xx, xy, xz, xy, yy, yz, xz, yz, zz];
        Sample {
            at_m: origin_m + place(gaussian.mean_m),
            covariance_m2: DMat3::from_cols_array(&columns),
            probability: f64::from(gaussian.probability),
            is_confident: gaussian.standing == Standing::Confident,
            is_ground: gaussian.why.reason == Reason::Ground,
        }
    };
    let sound = gaussians.iter().filter(|gaussian| gaussian.is_sound());
    sound.map(sample).collect()
}

fn place(place_m: Vec3) -> DVec3 {
    place_m.as_dvec3()
}

/// From one place of the map to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// The Gaussians nearest to what was asked, metres.
    pub ends_m: [DVec3; 2],
    /// Straight, metres.
    pub length_m: Told,
    /// Along the ground, metres.
    pub horizontal_m: Told,
    /// How much higher the second is, metres.
    pub height_m: Told,
}

/// Between the Gaussians nearest to two places, each within `reach_m`.
///
/// # Errors
/// If the map has nothing there.
pub fn distance(
    samples: &[Sample],
    from_m: DVec3,
    to_m: DVec3,
    reach_m: f64,
) -> Result<Distance, SurveyError> {
    let grid = Grid::new(samples.iter().map(|sample| sample.at_m), reach_m);
    let nearest = |at_m: DVec3| {
        let [x, y, z] = at_m.to_array();
        let found = grid.nearest(at_m).map(|(index, _)| samples[index]);
        found.ok_or(SurveyError::Nothing { reach_m, x, y, z })
    };
    let (a, b) = (nearest(from_m)?, nearest(to_m)?);
    let step_m = b.at_m - a.at_m;
    let along = |vector: DVec3| {
        let direction = vector.normalize_or(DVec3::Z);
        Told {
            value: vector.length(),
            sigma: a.sigma_along_m(direction).hypot(b.sigma_along_m(direction)),
        }
    };
    let height_m = along(DVec3::Z * step_m.z);
    Ok(Distance {
        ends_m: [a.at_m, b.at_m],
        length_m: along(step_m),
        horizontal_m: along(step_m * DVec3::new(1.0, 1.0, 0.0)),
        height_m: Told {
            value: step_m.z,
            ..height_m
        },
    })
}
