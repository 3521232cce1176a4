//! How much of a ray's power comes back from the surface that it meets.

use crate::scene::Hit;

/// Of sea water at 450 kHz, one way: about 0.1 dB/m (0.12 at 10 °C by the formula of Ainslie et al. 1998).
const ABSORPTION_DB_PER_M: f64 = 0.1;
/// Nearer than this a surface is not in the far field: its echo grows no further.
const NEAREST_M: f64 = 0.2;
/// Of the reflectivity of a surface that its scene says no exponent for: what facets send back that
/// face the sonar, the rest scattered by Lambert's law. Chosen; no surface was measured.
const FACET_SHARE: f64 = 0.5;
/// Root-mean-square slope of these facets, 11°. Chosen too: between a painted pipe and rough rock.
const FACET_SLOPE: f64 = 0.2;

/// The law by which echoes weaken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Radiometry {
    /// The reflectivity, at any range and, unless the scene gives an exponent, any angle: the paper's.
    Even,
    /// That of the sea: per solid angle 1/r² of spreading on the way back, absorption both ways, and
    /// less the more a surface turns away.
    Sea,
}

impl Radiometry {
    /// Per solid angle of the ray; `facing` is the cosine of the angle between ray and normal.
    pub(crate) fn sent_back(self, hit: &Hit, facing: f64) -> f64 {
        let by_exponent = || hit.reflectivity * facing.powf(hit.specular);
        match self {
            Self::Even if hit.specular > 0.0 => by_exponent(),
            Self::Even => hit.reflectivity,
            Self::Sea if hit.specular > 0.0 => by_exponent() * passed_on(hit.distance_m),
            Self::Sea => hit.reflectivity * rough(facing) * passed_on(hit.distance_m),
        }
    }

    /// What a range takes beside the solid angle.
    pub(crate) fn over_range(self, range_m: f64) -> f64 {
        match self {
            Self::Even => 1.0,
            Self::Sea => passed_on(range_m),
        }
    }
}

/// Lambert's law, whose surface of a given solid angle shines with cos θ, and facets with slopes of
/// a normal distribution, of which those of slope tan θ send back: `½ cos θ + ½ exp(−tan²θ / 2s²)`.
fn rough(facing: f64) -> f64 {
    let square = facing * facing;
    let slopes = (1.0 - square) / (square * FACET_SLOPE * FACET_SLOPE).max(f64::MIN_POSITIVE);
    (1.0 - FACET_SHARE) * facing + FACET_SHARE * (-0.5 * slopes).exp()
}

fn passed_on(range_m: f64) -> f64 {
    let spreading = range_m.max(NEAREST_M).powi(-2);
    spreading * 10f64.powf(-0.2 * ABSORPTION_DB_PER_M * range_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn hit(distance_m: f64, specular: f64) -> Hit {
        Hit {
            distance_m,
            position: DVec3::ZERO,
            normal: DVec3::X,
            reflectivity: 0.5,
            specular,
            is_seabed: false,
            flat_reach_m: 1.0,
        }
    }

    #[test]
    fn in_the_sea_echoes_fall_by_spreading_and_absorption() {
        let level_db = |r: f64| 10.0 * Radiometry::Sea.sent_back(&hit(r, 0.0), 1.0).log10();
        // 20 dB a decade, and 0.2 dB a metre there and back.
        assert!((level_db(1.0) - level_db(10.0) - 20.0 - 1.8).abs() < 1e-9);
        assert!((level_db(1.0) - 10.0 * 0.5_f64.log10() + 0.2).abs() < 1e-9);
        assert!((level_db(0.0) - level_db(0.1)).abs() < 0.05);
        let even = |r: f64| Radiometry::Even.sent_back(&hit(r, 0.0), 0.3);
        assert!((even(1.0) - 0.5).abs() < 1e-12 && (even(9.0) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_surface_that_turns_away_scatters_by_lamberts_law_alone() {
        let at = |degrees: f64, specular: f64| {
            Radiometry::Sea.sent_back(&hit(1.0, specular), degrees.to_radians().cos())
        };
        let lambert = |degrees: f64| 0.5 * degrees.to_radians().cos() * at(0.0, 0.0);
        assert!((at(50.0, 0.0) / lambert(50.0) - 1.0).abs() < 1e-6);
        // At the slope of the facets they send e^(−1/2).
        let slope_deg = FACET_SLOPE.atan().to_degrees();
        let facets = (at(slope_deg, 0.0) - lambert(slope_deg)) / at(0.0, 0.0);
        assert!((facets - 0.5 * (-0.5_f64).exp()).abs() < 1e-9);
        assert!(at(90.0, 0.0).is_finite());
        // What the scene says of a smooth surface holds.
        let expected = 40f64.to_radians().cos().powi(12) * at(0.0, 12.0);
        assert!((at(40.0, 12.0) / expected - 1.0).abs() < 1e-9);
    }
}
