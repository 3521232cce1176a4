//! A plane through places, and how it lies.

use std::collections::BTreeMap;

use echosplat_model::glam::{DMat3, DVec3};

use crate::grid::{Cell, SHARED_M, cell, independent_share};
use crate::{Sample, SurveyError, Told};

/// Least number of places; three numbers are fitted.
const FEWEST: usize = 10;
/// Rounds of weighing anew.
const ROUNDS: usize = 10;
/// Sigmas of what places scatter, beyond which one counts less (Huber).
const HUBER: f64 = 2.0;
/// Metres; a place that is known less well lies on the plane by chance, and its sigma tells nothing of it.
const MOST_SIGMA_M: f64 = 0.3;
/// Metres; places never scatter less.
const LEAST_SCATTER_M: f64 = 1e-4;
/// Sweeps of turning a matrix of three rows to its own axes; five are exact.
const SWEEPS: usize = 12;

/// Flat, however it lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Middle of what is seen of it, metres.
    pub middle_m: DVec3,
    /// Unit, upward.
    pub normal: DVec3,
    /// From level, degrees.
    pub tilt_deg: Told,
    /// Where its normal leans to, degrees clockwise from the world's y axis: downhill.
    pub towards_deg: f64,
    /// Places that it was fitted to.
    pub count: usize,
    /// Root mean square of their distances from it, metres.
    pub residual_m: f64,
}

/// The plane that these places lie nearest to.
///
/// # Errors
/// If they are too few, or lie on a line.
pub fn fit_plane(samples: &[Sample]) -> Result<Plane, SurveyError> {
    if samples.len() < FEWEST {
        return Err(SurveyError::Few {
            what: "a plane",
            found: samples.len(),
            needed: FEWEST,
        });
    }
    let places: Vec<DVec3> = samples.iter().map(|sample| sample.at_m).collect();
    let mut weights = vec![1.0; places.len()];
    let (mut middle_m, mut axes) = axes_of(&places, &weights);
    for _ in 0..ROUNDS {
        let off = |place: &DVec3| (*place - middle_m).dot(axes[0].1);
        let mut sorted: Vec<f64> = places.iter().map(|place| off(place).abs()).collect();
        let half = sorted.len() / 2;
        let (_, median, _) = sorted.select_nth_unstable_by(half, f64::total_cmp);
        let scatter_m = (1.4826 * *median).max(LEAST_SCATTER_M);
        let huber =
            |place: &DVec3| (HUBER * scatter_m / off(place).abs().max(LEAST_SCATTER_M)).min(1.0);
        weights = places.iter().map(huber).collect();
        (middle_m, axes) = axes_of(&places, &weights);
    }
    let [(thick, normal), (wide, _), (long, _)] = axes;
    if !(wide > 1e-4 * long) || !(wide > 2.0 * thick) {
        return Err(SurveyError::Unlike {
            what: "plane",
            why: "its Gaussians lie along a line, or all around".to_owned(),
        });
    }
    let normal = if normal.z < 0.0 { -normal } else { normal };
    let off = |place: &DVec3| (*place - middle_m).dot(normal);
    let count = places.len();
    let square: f64 = places.iter().map(|place| off(place).powi(2)).sum();
    let weighted: f64 = places
        .iter()
        .zip(&weights)
        .map(|(place, w)| w * off(place).powi(2))
        .sum();
    let scatter_2 = weighted / (count - 3) as f64;
    // The tilt turns about the level line of the plane: what counts is how far places lie from that.
    let level = normal.cross(DVec3::Z).normalize_or(DVec3::X);
    let uphill = normal.cross(level);
    let lever: f64 = places
        .iter()
        .zip(&weights)
        .map(|(place, w)| w * (*place - middle_m).dot(uphill).powi(2))
        .sum();
    // What the map says of its places' errors is alike for all of a block.
    let mut blocks: BTreeMap<Cell, f64> = BTreeMap::new();
    for ((place, weight), sample) in places.iter().zip(&weights).zip(samples) {
        let told_m = sample.sigma_along_m(normal).min(MOST_SIGMA_M);
        *blocks.entry(cell(*place, SHARED_M)).or_default() +=
            weight * told_m * (*place - middle_m).dot(uphill);
    }
    let shared_2 = blocks.values().map(|sum| sum * sum).sum::<f64>() / (lever * lever);
    let own_2 = scatter_2 / lever / independent_share(&places);
    Ok(Plane {
        middle_m,
        normal,
        tilt_deg: Told {
            value: normal.z.clamp(-1.0, 1.0).acos().to_degrees(),
            sigma: (own_2 + shared_2).sqrt().to_degrees(),
        },
        towards_deg: normal.x.atan2(normal.y).to_degrees().rem_euclid(360.0),
        count,
        residual_m: (square / count as f64).sqrt(),
    })
}

type Axes = [(f64, DVec3); 3];

/// Weighted middle; then variance and direction of the axes, the shortest first.
pub(crate) fn axes_of(places: &[DVec3], weights: &[f64]) -> (DVec3, Axes) {
    let total: f64 = weights.iter().sum();
    let pairs = || places.iter().zip(weights);
    let middle_m = pairs()
        .map(|(place, weight)| *place * *weight)
        .sum::<DVec3>()
        / total;
    let scatter = pairs().fold(DMat3::ZERO, |sum, (place, weight)| {
        let p = *place - middle_m;
        sum + DMat3::from_cols(p * p.x, p * p.y, p * p.z) * (*weight / total)
    });
    (middle_m, eigen(scatter))
}

/// Of a symmetric matrix, by turning its largest other element away again and again (Jacobi).
fn eigen(mut matrix: DMat3) -> Axes {
    let mut turned = DMat3::IDENTITY;
    for _ in 0..SWEEPS {
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let between = matrix.col(i)[j];
            if between.abs() < f64::MIN_POSITIVE {
                continue;
            }
            let angle = 0.5 * (2.0 * between).atan2(matrix.col(j)[j] - matrix.col(i)[i]);
            let (sin, cos) = angle.sin_cos();
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(i)[i] = cos;
            turn.col_mut(j)[j] = cos;
            turn.col_mut(j)[i] = sin;
            turn.col_mut(i)[j] = -sin;
            matrix = turn.transpose() * matrix * turn;
            turned *= turn;
        }
    }
    let mut axes: Axes = std::array::from_fn(|i| (matrix.col(i)[i].max(0.0), turned.col(i)));
    axes.sort_by(|a, b| a.0.total_cmp(&b.0));
    axes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tilted(slope: f64, noise_m: f64) -> Vec<Sample> {
        let at = |i: i32| {
            let (x, y) = (f64::from(i % 20) * 0.1, f64::from(i / 20) * 0.1);
            let noise_m = noise_m * f64::from(i * 7919 % 13 - 6) / 6.0;
            DVec3::new(x, y, 3.0 - slope * x + noise_m)
        };
        let sample = |i| Sample {
            at_m: at(i),
            covariance_m2: DMat3::ZERO,
            probability: 1.0,
            is_confident: true,
            is_ground: false,
        };
        (0..400).map(sample).collect()
    }

    #[test]
    fn a_plane_is_tilted_as_it_is() {
        let found = fit_plane(&tilted(0.1, 0.02)).unwrap();
        let truth = 0.1_f64.atan().to_degrees();
        assert!(
            (found.tilt_deg.value - truth).abs() < 3.0 * found.tilt_deg.sigma,
            "{found:?}"
        );
        assert!(found.tilt_deg.sigma < 0.2 && found.residual_m < 0.02);
        assert!((found.towards_deg - 90.0).abs() < 3.0, "{found:?}");
        let mut with_strays = tilted(0.1, 0.0);
        for sample in with_strays.iter_mut().step_by(20) {
            sample.at_m.z += 0.5;
        }
        let found = fit_plane(&with_strays).unwrap();
        assert!((found.tilt_deg.value - truth).abs() < 0.5, "{found:?}");
    }

    #[test]
    fn a_line_is_no_plane() {
        let line: Vec<Sample> = tilted(0.0, 0.0)
            .into_iter()
            .filter(|s| s.at_m.y < 0.05)
            .collect();
        assert!(matches!(fit_plane(&line), Err(SurveyError::Unlike { .. })));
        assert!(matches!(
            fit_plane(&line[..3]),
            Err(SurveyError::Few { .. })
        ));
    }
}
