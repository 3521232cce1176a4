//! A pile: a cylinder, seen in part, fitted by the distances of places from its surface.

mod solve;

use echosplat_model::glam::{DMat3, DVec2, DVec3};

use self::solve::{Fit, Problem, off_m};
use crate::{Sample, SurveyError, Told};

/// Least number of places; five numbers are fitted.
const FEWEST: usize = 20;
/// Middle x and y, slopes of the axis along x and y, radius.
const NUMBERS: usize = 5;
/// Metres, within which radii of piles and pipes lie.
const RADII_M: (f64, f64) = (0.02, 5.0);
/// Metres; a place is never known better.
const LEAST_SIGMA_M: f64 = 0.005;

/// Metres; all places of a pile lie too far in or out together: 0.011 to 0.025 m too far in on six of a simulated dive.
const COMMON_M: f64 = 0.015;

/// A cylinder whose axis is nearly upright.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cylinder {
    /// On its axis, at the middle height of what is seen of it, metres.
    pub middle_m: DVec3,
    /// One sigma of that along x and y, metres.
    pub middle_sigma_m: DVec2,
    /// Metres.
    pub radius_m: Told,
    /// Of the axis toward x and y, degrees from upright.
    pub lean_deg: [Told; 2],
    /// Lowest and highest that is seen of it, metres.
    pub from_to_m: (f64, f64),
    /// How far around it is seen, degrees.
    pub seen_deg: f64,
    /// Places that it was fitted to.
    pub count: usize,
    /// Root mean square of their distances from its surface, metres.
    pub residual_m: f64,
}

impl Cylinder {
    /// From upright, degrees.
    #[must_use]
    pub fn lean_from_upright_deg(&self) -> Told {
        let [x, y] = self.lean_deg.map(|lean| lean.value.to_radians().tan());
        let slope = x.hypot(y);
        let share = match slope > 0.0 {
            true => [x / slope, y / slope],
            false => [std::f64::consts::FRAC_1_SQRT_2; 2],
        };
        let [sx, sy] = self.lean_deg.map(|lean| lean.sigma);
        Told {
            value: slope.atan().to_degrees(),
            sigma: (share[0] * sx).hypot(share[1] * sy),
        }
    }

    /// Unit, upward.
    #[must_use]
    pub fn axis(&self) -> DVec3 {
        let [x, y] = self.lean_deg.map(|lean| lean.value.to_radians().tan());
        DVec3::new(x, y, 1.0).normalize()
    }

    /// How far from its surface a place is, metres; negative inside.
    #[must_use]
    pub fn off_m(&self, at_m: DVec3) -> f64 {
        let from_m = at_m - self.middle_m;
        from_m.reject_from_normalized(self.axis()).length() - self.radius_m.value
    }
}

/// The nearly upright cylinder of these places, which are those of one pile and little else.
///
/// # Errors
/// If they are too few, or are none.
pub fn fit_cylinder(samples: &[Sample]) -> Result<Cylinder, SurveyError> {
    let few = |found| SurveyError::Few {
        what: "a pile",
        found,
        needed: FEWEST,
    };
    let known = |sample: &&Sample| sample.sigma_along_m(DVec3::X).is_finite();
    let kept: Vec<Sample> = samples.iter().filter(known).copied().collect();
    if kept.len() < FEWEST {
        return Err(few(kept.len()));
    }
    let middle_m = kept.iter().map(|sample| sample.at_m).sum::<DVec3>() / kept.len() as f64;
    let places: Vec<DVec3> = kept.iter().map(|sample| sample.at_m - middle_m).collect();
    let sigmas: Vec<f64> = kept
        .iter()
        .map(|sample| across_sigma_m(sample).max(LEAST_SIGMA_M))
        .collect();
    let covariances: Vec<DMat3> = kept.iter().map(|sample| sample.covariance_m2).collect();
    let problem = Problem {
        places: &places,
        sigmas: &sigmas,
        covariances: &covariances,
    };
    let unlike = |why: &str| SurveyError::Unlike {
        what: "pile",
        why: why.to_owned(),
    };
    let best = problem.best().ok_or_else(|| unlike("no cylinder fits"))?;
    let best = problem.unbiased(best);
    told(&places, middle_m, &best)
        .ok_or_else(|| unlike("no nearly upright cylinder of 0.02 to 5 m fits"))
}

/// Horizontally, where it is known least.
fn across_sigma_m(sample: &Sample) -> f64 {
    let c = sample.covariance_m2;
    let (xx, xy, yy) = (c.x_axis.x, c.x_axis.y, c.y_axis.y);
    let half = f64::hypot(0.5 * (xx - yy), xy);
    (0.5 * (xx + yy) + half).max(0.0).sqrt()
}

fn told(places: &[DVec3], middle_m: DVec3, found: &Fit) -> Option<Cylinder> {
    let [x, y, along_x, along_y, radius] = found.numbers;
    if !(RADII_M.0..=RADII_M.1).contains(&radius.abs()) {
        return None;
    }
    let sigma = |i: usize| found.covariance[i][i].max(0.0).sqrt();
    let lean = |slope: f64, i: usize| Told {
        value: slope.atan().to_degrees(),
        sigma: (sigma(i) / (1.0 + slope * slope)).to_degrees(),
    };
    let heights = places.iter().map(|place| place.z);
    let least = heights.clone().fold(f64::INFINITY, f64::min);
    let most = heights.fold(f64::NEG_INFINITY, f64::max);
    let square = places
        .iter()
        .map(|place| off_m(*place, found.numbers).powi(2));
    Some(Cylinder {
        middle_m: middle_m + DVec3::new(x, y, 0.0),
        middle_sigma_m: DVec2::new(sigma(0), sigma(1)),
        radius_m: Told {
            value: radius.abs(),
            sigma: sigma(4).hypot(COMMON_M),
        },
        lean_deg: [lean(along_x, 2), lean(along_y, 3)],
        from_to_m: (middle_m.z + least, middle_m.z + most),
        seen_deg: seen_deg(places, found.numbers),
        count: places.len(),
        residual_m: (square.sum::<f64>() / places.len() as f64).sqrt(),
    })
}

/// All around but the widest gap.
fn seen_deg(places: &[DVec3], [x, y, along_x, along_y, _]: [f64; NUMBERS]) -> f64 {
    let around = places.iter().map(|place| {
        let flat = place.truncate() - DVec2::new(x + along_x * place.z, y + along_y * place.z);
        flat.to_angle().to_degrees()
    });
    let mut around: Vec<f64> = around.collect();
    around.sort_by(f64::total_cmp);
    let gaps = around.windows(2).map(|pair| pair[1] - pair[0]);
    let last = around.first().zip(around.last());
    let over = last.map_or(360.0, |(first, last)| first + 360.0 - last);
    360.0 - gaps.fold(over, f64::max)
}

#[cfg(test)]
mod tests;
