//! Where the sonar is sensitive.

use serde::{Deserialize, Serialize};

/// Ratio, by definition: full width at half maximum over one sigma.
/// Full width at half maximum over one sigma of a Gaussian.
const FWHM_PER_SIGMA: f32 = 2.354_82;

/// Directional sensitivity: (7) in azimuth, a soft-edged fan in elevation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Beam {
    /// Full width at half maximum across, degrees; 0.8 for the `OmniScan` 450 FS.
    pub azimuth_width_deg: f32,
    /// Full width at half maximum along, degrees; 50 for the `OmniScan` 450 FS.
    pub elevation_width_deg: f32,
}

impl Default for Beam {
    fn default() -> Self {
        Self {
            azimuth_width_deg: 0.8,
            elevation_width_deg: 50.0,
        }
    }
}

/// A beam no sonar has.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("beam {name} is {value}°; allowed is {low}° to {high}°")]
pub struct BeamError {
    /// Name of the width.
    pub name: &'static str,
    /// What it held, degrees.
    pub value: f32,
    /// Least allowed.
    pub low: f32,
    /// Most allowed.
    pub high: f32,
}

impl Beam {
    /// # Errors
    /// Names the width that is out of range.
    pub fn check(&self) -> Result<(), BeamError> {
        let width = |name, value: f32, low: f32, high: f32| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(BeamError {
                    name,
                    value,
                    low,
                    high,
                })
            }
        };
        width("azimuth_width_deg", self.azimuth_width_deg, 0.05, 30.0)?;
        width("elevation_width_deg", self.elevation_width_deg, 1.0, 120.0)
    }

    /// One sigma of the pattern across, radians: `ε_a` of (7).
    #[must_use]
    pub fn azimuth_sigma_rad(&self) -> f32 {
        self.azimuth_width_deg.to_radians() / FWHM_PER_SIGMA
    }

    /// Half the fan: where the sensitivity along has fallen to one half, radians.
    #[must_use]
    pub fn elevation_half_width_rad(&self) -> f32 {
        0.5 * self.elevation_width_deg.to_radians()
    }

    /// Sensitivity along, 0 to 1: `g(φ) = 2^(−(φ/φ_half)⁸)`, flat inside the fan and soft at its
    /// edge. The simulator states the same pattern by itself.
    #[must_use]
    pub fn elevation_weight(&self, elevation_rad: f32) -> f32 {
        let x = elevation_rad / self.elevation_half_width_rad();
        let x2 = x * x;
        let x4 = x2 * x2;
        (-x4 * x4).exp2()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_patterns_halve_at_their_half_widths() {
        let beam = Beam::default();
        assert!((beam.elevation_weight(25f32.to_radians()) - 0.5).abs() < 1e-5);
        assert!((beam.elevation_weight(0.0) - 1.0).abs() < 1e-7);
        let half = 0.4f32.to_radians() / beam.azimuth_sigma_rad();
        assert!(((-0.5 * half * half).exp() - 0.5).abs() < 1e-4);
    }

    #[test]
    fn a_beam_of_no_width_is_refused() {
        let beam = Beam {
            azimuth_width_deg: f32::NAN,
            ..Beam::default()
        };
        assert!(beam.check().is_err());
    }
}
