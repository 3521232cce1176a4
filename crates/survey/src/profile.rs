//! Cuts through a map along a line: what lies how far along, and how high.

use echosplat_model::glam::{DVec2, DVec3};

use crate::{Sample, SurveyError, Told};

/// One place of a section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cut {
    /// From the line's beginning, metres.
    pub along_m: f64,
    /// Left of the line, metres; right is negative.
    pub beside_m: f64,
    /// World z, metres, with its sigma.
    pub height_m: Told,
}

/// A piece of a profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// Its middle from the line's beginning, metres.
    pub along_m: f64,
    /// Of the highest Gaussian there, metres; `None` where nothing is.
    pub height_m: Option<Told>,
    /// Gaussians there.
    pub count: usize,
}

/// Most pieces of a profile.
const MOST_BINS: usize = 100_000;

/// All that lies within `half_m` beside the line from `from_m` to `to_m` seen from above, in order along it.
#[must_use]
pub fn section(samples: &[Sample], from_m: DVec3, to_m: DVec3, half_m: f64) -> Vec<Cut> {
    let begin = from_m.truncate();
    let line = to_m.truncate() - begin;
    let length_m = line.length();
    let direction = line.normalize_or(DVec2::X);
    let cut = |sample: &Sample| {
        let from = sample.at_m.truncate() - begin;
        Cut {
            along_m: from.dot(direction),
            beside_m: direction.perp_dot(from),
            height_m: Told {
                value: sample.at_m.z,
                sigma: sample.sigma_along_m(DVec3::Z),
            },
        }
    };
    let is_in = |cut: &Cut| cut.beside_m.abs() <= half_m && (0.0..=length_m).contains(&cut.along_m);
    let mut found: Vec<Cut> = samples.iter().map(cut).filter(is_in).collect();
    found.sort_by(|a, b| a.along_m.total_cmp(&b.along_m));
    found
}

/// The highest along a line, in pieces of `step_m`.
///
/// # Errors
/// If the line has no length, or has more pieces than are told.
pub fn profile(
    samples: &[Sample],
    from_m: DVec3,
    to_m: DVec3,
    half_m: f64,
    step_m: f64,
) -> Result<Vec<Bin>, SurveyError> {
    let length_m = (to_m - from_m).truncate().length();
    let pieces = (length_m / step_m).ceil();
    if !(pieces >= 1.0 && pieces <= MOST_BINS as f64) {
        return Err(SurveyError::Unlike {
            what: "line",
            why: format!("{length_m} m in pieces of {step_m} m; 1 to {MOST_BINS} pieces are told"),
        });
    }
    let empty = |index: usize| Bin {
        along_m: (index as f64 + 0.5) * step_m,
        height_m: None,
        count: 0,
    };
    let mut bins: Vec<Bin> = (0..pieces as usize).map(empty).collect();
    for cut in section(samples, from_m, to_m, half_m) {
        let index = ((cut.along_m / step_m) as usize).min(bins.len() - 1);
        let bin = &mut bins[index];
        bin.count += 1;
        if bin
            .height_m
            .is_none_or(|held| cut.height_m.value > held.value)
        {
            bin.height_m = Some(cut.height_m);
        }
    }
    Ok(bins)
}

#[cfg(test)]
mod tests {
    use echosplat_model::glam::DMat3;

    use super::*;

    fn sample(x: f64, y: f64, z: f64) -> Sample {
        Sample {
            at_m: DVec3::new(x, y, z),
            covariance_m2: DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.01)),
            probability: 1.0,
            is_confident: true,
            is_ground: false,
        }
    }

    #[test]
    fn a_profile_has_the_highest_and_its_gaps() {
        let samples = [
            sample(0.2, 0.1, 1.0),
            sample(0.3, -0.1, 2.0),
            sample(2.5, 0.0, 3.0),
            sample(1.5, 5.0, 9.0),
            sample(-1.0, 0.0, 9.0),
        ];
        let bins = profile(&samples, DVec3::ZERO, DVec3::X * 3.0, 0.5, 1.0).unwrap();
        let heights: Vec<Option<f64>> = bins
            .iter()
            .map(|bin| bin.height_m.map(|h| h.value))
            .collect();
        assert_eq!(heights, [Some(2.0), None, Some(3.0)]);
        assert!((bins[0].height_m.unwrap().sigma - 0.1).abs() < 1e-9);
        let cuts = section(&samples, DVec3::ZERO, DVec3::X * 3.0, 0.5);
        assert_eq!(cuts.len(), 3);
        assert!((cuts[0].beside_m - 0.1).abs() < 1e-9);
        assert!(profile(&samples, DVec3::ZERO, DVec3::ZERO, 0.5, 1.0).is_err());
    }
}
