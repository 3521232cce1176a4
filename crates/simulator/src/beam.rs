//! Where the simulated sonar is sensitive, and how a ping is cut into rays.

use echosplat_model::PingSettings;
use glam::DVec3;

use crate::random::Random;

/// Full width at half maximum over one sigma of a Gaussian.
const FWHM_PER_SIGMA: f64 = 2.354_820_045;
/// One sigma of the beam across, `ε_a` of (7): 0.8° wide at half maximum.
pub const AZIMUTH_SIGMA_RAD: f64 = 0.8 * DEGREE / FWHM_PER_SIGMA;
/// Where the beam across has fallen to one half.
pub const HALF_POWER_AZIMUTH_RAD: f64 = 0.4 * DEGREE;
/// Half the fan along: where its sensitivity has fallen to one half.
pub const ELEVATION_HALF_WIDTH_RAD: f64 = 25.0 * DEGREE;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Beyond this the fan's sensitivity is below 10⁻³.
const ELEVATION_LIMIT_RAD: f64 = 33.5 * DEGREE;
const ELEVATION_CELL_COUNT: usize = 256;
/// Rays of a row lie 1.2 sigmas apart: a Gaussian summed at such steps is constant to 10⁻⁶ wherever
/// the first step falls.
const AZIMUTH_STEP_SIGMAS: f64 = 1.2;
const AZIMUTH_LIMIT_SIGMAS: f64 = 3.6;

/// First side lobes across: one and a half widths off the axis, as narrow as the beam.
const SIDE_LOBE_OFFSET_SIGMAS: f64 = 1.5 * FWHM_PER_SIGMA;
/// Of harsh noise, two-way: 20 dB down.
const HARSH_LOBE_POWER: f64 = 0.01;
/// Of a real unit, two-way: 26 dB down, as the first side lobe of an evenly driven line of elements
/// is (13.3 dB each way).
const FIELD_LOBE_POWER: f64 = 0.0025;
/// Where a real unit's fan hears again beyond its edge, as loud as the side lobes across and as soft
/// at the edges: no unit's pattern was measured.
const ALONG_LOBE_OFFSET_RAD: f64 = 43.0 * DEGREE;
const ALONG_LOBE_SIGMA_RAD: f64 = 5.0 * DEGREE;
const ALONG_LOBE_LIMIT_RAD: f64 = 55.0 * DEGREE;
/// Cells as tall as those of the fan alone.
const ALONG_LOBE_CELL_COUNT: usize = 420;

/// (7): sensitivity across, 1 on the axis. Power, two-way.
#[must_use]
pub fn azimuth_weight(offset_rad: f64) -> f64 {
    let sigmas = offset_rad / AZIMUTH_SIGMA_RAD;
    (-0.5 * sigmas * sigmas).exp()
}

/// Sensitivity along, 1 in the middle: `g(φ) = 2^(−(φ/25°)⁸)`, flat inside the fan of 50° full
/// width at half maximum and soft at its edge. Power, two-way.
#[must_use]
pub fn elevation_weight(elevation_rad: f64) -> f64 {
    (-(elevation_rad / ELEVATION_HALF_WIDTH_RAD).powi(8)).exp2()
}

/// One sigma in range of a sharp echo: a Gaussian as wide at half maximum as the pulse is long.
#[must_use]
pub fn pulse_sigma_m(settings: &PingSettings) -> f64 {
    settings.pulse_length_m() / FWHM_PER_SIGMA
}

/// Unit vector at an azimuth and elevation of the sensor's frame (17).
pub(crate) fn direction(azimuth_rad: f64, elevation_rad: f64) -> DVec3 {
    let (sin_azimuth, cos_azimuth) = azimuth_rad.sin_cos();
    let (sin_elevation, cos_elevation) = elevation_rad.sin_cos();
    DVec3::new(
        cos_elevation * cos_azimuth,
        cos_elevation * sin_azimuth,
        sin_elevation,
    )
}

/// An interval of angle and what of the beam's power falls into it.
#[derive(Debug, Clone, Copy)]
struct Stratum {
    low_rad: f64,
    high_rad: f64,
    weight: f64,
}

impl Stratum {
    fn middle_rad(&self) -> f64 {
        0.5 * (self.low_rad + self.high_rad)
    }

    fn at(&self, fraction: f64) -> f64 {
        self.low_rad + (self.high_rad - self.low_rad) * fraction
    }
}

/// Which side lobes the beam has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SideLobes {
    /// None at all.
    Without,
    /// Across, 20 dB down.
    Harsh,
    /// Across and along, 26 dB down.
    Field,
}

impl SideLobes {
    fn power_across(self) -> f64 {
        match self {
            Self::Without => 0.0,
            Self::Harsh => HARSH_LOBE_POWER,
            Self::Field => FIELD_LOBE_POWER,
        }
    }

    fn rows(self) -> Vec<Stratum> {
        let main = |elevation_rad: f64| elevation_weight(elevation_rad) * elevation_rad.cos();
        let beyond = |elevation_rad: f64| lobe_along(elevation_rad) * elevation_rad.cos();
        match self {
            Self::Without | Self::Harsh => strata(ELEVATION_LIMIT_RAD, ELEVATION_CELL_COUNT, main),
            Self::Field => strata(ALONG_LOBE_LIMIT_RAD, ALONG_LOBE_CELL_COUNT, |e| {
                main(e) + beyond(e)
            }),
        }
    }
}

/// Sensitivity of the side lobes along.
fn lobe_along(elevation_rad: f64) -> f64 {
    let sigmas = (elevation_rad.abs() - ALONG_LOBE_OFFSET_RAD) / ALONG_LOBE_SIGMA_RAD;
    FIELD_LOBE_POWER * (-0.5 * sigmas * sigmas).exp()
}

/// The beam cut into rows of elevation, each crossed by equal steps of azimuth that begin at a
/// random place: (6) with one ray per cell that stands for the cell's weighted solid angle. So the
/// pattern across is exact for the smallest target, and a wide one has no noise of sampling.
pub(crate) struct Fan {
    elevations: Vec<Stratum>,
    /// Steps of azimuth in a row.
    step_count: usize,
    side_lobes: SideLobes,
    side_lobe_power: f64,
}

/// One cell of the fan and a ray inside it, in the sensor's frame.
pub(crate) struct Cell {
    /// Solid angle times sensitivity, steradian.
    pub(crate) weight: f64,
    pub(crate) ray: DVec3,
    /// Directions of the middles of the cell's lower, upper, right and left edges.
    pub(crate) edges: [DVec3; 4],
}

impl Fan {
    pub(crate) fn new(side_lobes: SideLobes) -> Self {
        let side_lobe_power = side_lobes.power_across();
        let lobe_sigmas = match side_lobes {
            SideLobes::Without => 0.0,
            SideLobes::Harsh | SideLobes::Field => SIDE_LOBE_OFFSET_SIGMAS,
        };
        let limit_sigmas = AZIMUTH_LIMIT_SIGMAS + lobe_sigmas;
        Self {
            elevations: side_lobes.rows(),
            step_count: (2.0 * limit_sigmas / AZIMUTH_STEP_SIGMAS).ceil() as usize,
            side_lobes,
            side_lobe_power,
        }
    }

    /// Sensitivity, two-way, towards a unit vector of the sensor's frame; 1 on the axis.
    pub(crate) fn sensitivity(&self, direction: DVec3) -> f64 {
        let elevation_rad = direction.z.clamp(-1.0, 1.0).asin();
        let beyond = match self.side_lobes {
            SideLobes::Without | SideLobes::Harsh => 0.0,
            SideLobes::Field => lobe_along(elevation_rad),
        };
        let along = elevation_weight(elevation_rad) + beyond;
        self.across(direction.y.atan2(direction.x)) * along
    }

    fn across(&self, azimuth_rad: f64) -> f64 {
        const LOBE_RAD: f64 = SIDE_LOBE_OFFSET_SIGMAS * AZIMUTH_SIGMA_RAD;
        let main = azimuth_weight(azimuth_rad);
        if self.side_lobe_power <= 0.0 {
            return main;
        }
        let lobes = azimuth_weight(azimuth_rad - LOBE_RAD) + azimuth_weight(azimuth_rad + LOBE_RAD);
        main + self.side_lobe_power * lobes
    }

    /// Calls `visit` for every cell, row by row from below.
    pub(crate) fn for_each(&self, random: &mut Random, mut visit: impl FnMut(&Cell)) {
        const STEP_RAD: f64 = AZIMUTH_STEP_SIGMAS * AZIMUTH_SIGMA_RAD;
        let first_rad = -0.5 * STEP_RAD * self.step_count as f64;
        for row in &self.elevations {
            let start_rad = first_rad + STEP_RAD * random.unit();
            let middle_rad = row.middle_rad();
            for step in 0..self.step_count {
                let azimuth_rad = start_rad + STEP_RAD * step as f64;
                visit(&Cell {
                    weight: self.across(azimuth_rad) * STEP_RAD * row.weight,
                    ray: direction(azimuth_rad, row.at(random.unit())),
                    edges: [
                        direction(azimuth_rad, row.low_rad),
                        direction(azimuth_rad, row.high_rad),
                        direction(azimuth_rad - 0.5 * STEP_RAD, middle_rad),
                        direction(azimuth_rad + 0.5 * STEP_RAD, middle_rad),
                    ],
                });
            }
        }
    }
}

fn strata(limit_rad: f64, count: usize, sensitivity: impl Fn(f64) -> f64) -> Vec<Stratum> {
    let width_rad = 2.0 * limit_rad / count as f64;
    let stratum = |index: usize| {
        let low_rad = -limit_rad + width_rad * index as f64;
        let high_rad = low_rad + width_rad;
        // Simpson's rule; a cell is far narrower than the pattern.
        let ends = sensitivity(low_rad) + sensitivity(high_rad);
        let weight = (ends + 4.0 * sensitivity(0.5 * (low_rad + high_rad))) * width_rad / 6.0;
        Stratum {
            low_rad,
            high_rad,
            weight,
        }
    };
    (0..count).map(stratum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;

    fn total_weight(fan: &Fan) -> f64 {
        let mut total = 0.0;
        fan.for_each(&mut Random::new(0, Purpose::Rays, 0), |cell| {
            total += cell.weight;
        });
        total
    }

    #[test]
    fn the_patterns_halve_at_their_half_widths() {
        assert!((azimuth_weight(0.4 * DEGREE) - 0.5).abs() < 1e-9);
        assert!((elevation_weight(25.0 * DEGREE) - 0.5).abs() < 1e-12);
        assert!(elevation_weight(ELEVATION_LIMIT_RAD) < 1.1e-3);
    }

    #[test]
    fn the_sensitivity_towards_a_cell_is_that_of_its_weight() {
        for side_lobes in [SideLobes::Without, SideLobes::Harsh, SideLobes::Field] {
            let fan = Fan::new(side_lobes);
            let (mut by_cells, mut towards) = (0.0, 0.0);
            let first = fan.elevations[0];
            let area = (first.high_rad - first.low_rad) * AZIMUTH_STEP_SIGMAS * AZIMUTH_SIGMA_RAD;
            fan.for_each(&mut Random::new(0, Purpose::Rays, 0), |cell| {
                by_cells += cell.weight;
                let cosine = cell.ray.truncate().length();
                towards += fan.sensitivity(cell.ray) * cosine * area;
            });
            assert!((towards / by_cells - 1.0).abs() < 1e-3, "{side_lobes:?}");
        }
    }

    #[test]
    fn the_cells_hold_the_whole_beam() {
        // ∫ exp(−θ²/2σ²) dθ = σ√2π; ∫ g cos φ dφ by a fine sum.
        let step = 1e-4 * DEGREE;
        let along: f64 = (-400_000..400_000)
            .map(|i| f64::from(i) * step)
            .map(|e| elevation_weight(e) * e.cos() * step)
            .sum();
        let expected = AZIMUTH_SIGMA_RAD * std::f64::consts::TAU.sqrt() * along;
        let share = total_weight(&Fan::new(SideLobes::Without)) / expected;
        assert!((share - 1.0).abs() < 1e-3, "{share}");
        let harsh = total_weight(&Fan::new(SideLobes::Harsh)) / expected;
        assert!((harsh - 1.02).abs() < 1e-3, "{harsh}");
        // Two lobes across of 1/400 each; two along of 1/400, σ√2π = 12.5° wide, at cos 43°, of 48°.
        let field = total_weight(&Fan::new(SideLobes::Field)) / expected;
        assert!((field - 1.005 - 0.0025 * 0.38).abs() < 1e-3, "{field}");
    }
}
