//! Error against run time: what the map was worth at each moment of a dive, and what it had cost.

use serde::{Deserialize, Serialize};

use crate::Metrics;

/// The map at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Seconds into the dive.
    pub dive_s: f64,
    /// CPU seconds of the mapper so far.
    pub compute_s: f64,
    /// Work so far, counted: Gaussian–bin pairs, which no machine's noise touches.
    pub pair_count: u64,
    /// Voxel observations so far; arc samples of methods that have no voxels.
    #[serde(default, rename = "voxel_looks")]
    pub voxel_observations: u64,
    /// Pings mapped so far.
    pub ping_count: u64,
    /// What the map was worth.
    pub metrics: Metrics,
}

impl Sample {
    /// Counted work: pairs and voxel observations, each at its count.
    #[must_use]
    pub fn work(&self) -> u64 {
        self.pair_count + self.voxel_observations
    }
}

/// One run of one method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Name of the method.
    pub method: String,
    /// Seed of the dive and its noise.
    pub seed: u64,
    /// In order of dive time, then of compute time.
    pub samples: Vec<Sample>,
    /// Why the run failed, if it did. Shown, never left out.
    pub failure: Option<String>,
}

impl Curve {
    /// Empty.
    #[must_use]
    pub fn new(method: impl Into<String>, seed: u64) -> Self {
        Self {
            method: method.into(),
            seed,
            samples: Vec::new(),
            failure: None,
        }
    }

    /// The map at the end.
    #[must_use]
    pub fn last(&self) -> Option<&Sample> {
        self.samples.last()
    }
}

/// Median, least and most over the seeds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Smallest.
    #[serde(with = "crate::nullable")]
    pub min: f64,
    /// The lower median.
    #[serde(with = "crate::nullable")]
    pub median: f64,
    /// Largest.
    #[serde(with = "crate::nullable")]
    pub max: f64,
}

impl Spread {
    /// Raised to `least` where it is below.
    #[must_use]
    pub fn at_least(self, least: f64) -> Self {
        Self {
            min: self.min.max(least),
            median: self.median.max(least),
            max: self.max.max(least),
        }
    }

    /// Infinite if there are no values.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_unstable_by(f64::total_cmp);
        let at = |index: usize| values.get(index).copied().unwrap_or(f64::INFINITY);
        let last = values.len().saturating_sub(1);
        Self {
            min: at(0),
            median: at(last / 2),
            max: at(last),
        }
    }
}

/// What one method did over all seeds at the same moment of the dive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BandPoint {
    /// Seconds into the dive, median.
    pub dive_s: f64,
    /// CPU seconds, median.
    pub compute_s: f64,
    /// Gaussian–bin pairs and voxel observations, median.
    pub work: f64,
    /// Chamfer distance, metres.
    pub cd_m: Spread,
    /// Hausdorff distance, metres.
    pub hd_m: Spread,
    /// Share of what is asserted that is further than 0.25 m from all truth, 0 to 1; infinite for
    /// empty maps, which assert nothing.
    pub false_share: Spread,
}

/// One method over all seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// Name of the method.
    pub method: String,
    /// Seeds of all its runs.
    pub seeds: Vec<u64>,
    /// One per sample of the shortest run that did not fail.
    pub points: Vec<BandPoint>,
    /// Seed and reason of each run that failed.
    pub failures: Vec<(u64, String)>,
}

/// The runs of each method as one band, in the order in which methods first appear. Runs are
/// sampled at the same moments, so the n-th samples belong together.
#[must_use]
pub fn bands(curves: &[Curve]) -> Vec<Band> {
    let mut methods: Vec<&str> = Vec::new();
    for curve in curves {
        if !methods.contains(&curve.method.as_str()) {
            methods.push(&curve.method);
        }
    }
    methods
        .into_iter()
        .map(|method| band(method, curves))
        .collect()
}

fn band(method: &str, curves: &[Curve]) -> Band {
    let runs: Vec<&Curve> = curves.iter().filter(|c| c.method == method).collect();
    let good: Vec<&Curve> = runs
        .iter()
        .copied()
        .filter(|c| c.failure.is_none())
        .collect();
    let count = good
        .iter()
        .map(|curve| curve.samples.len())
        .min()
        .unwrap_or(0);
    Band {
        method: method.to_owned(),
        seeds: runs.iter().map(|curve| curve.seed).collect(),
        points: (0..count).map(|index| band_point(&good, index)).collect(),
        failures: runs
            .iter()
            .filter_map(|curve| Some((curve.seed, curve.failure.clone()?)))
            .collect(),
    }
}

fn band_point(curves: &[&Curve], index: usize) -> BandPoint {
    let spread = |of: fn(&Sample) -> f64| Spread::of(curves.iter().map(|c| of(&c.samples[index])));
    BandPoint {
        dive_s: spread(|sample| sample.dive_s).median,
        compute_s: spread(|sample| sample.compute_s).median,
        work: spread(|sample| sample.work() as f64).median,
        cd_m: spread(|sample| sample.metrics.cd_m),
        hd_m: spread(|sample| sample.metrics.hd_m),
        false_share: spread(|sample| match sample.metrics.confident_count {
            0 => f64::INFINITY,
            _ => sample.metrics.confident_false_share,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::run;

    #[test]
    fn a_band_is_median_least_and_most_over_the_seeds() {
        let mut failed = run("online", 4, 1.0, 2);
        failed.failure = Some("out of memory".into());
        let curves = [
            run("online", 1, 3.0, 4),
            run("other", 1, 1.0, 4),
            run("online", 2, 1.0, 3),
            run("online", 3, 2.0, 4),
            failed,
        ];
        let bands = bands(&curves);
        assert_eq!(bands.len(), 2);
        assert_eq!(bands[0].seeds, [1, 2, 3, 4]);
        assert_eq!(bands[0].failures, [(4, "out of memory".to_owned())]);
        assert_eq!(bands[0].points.len(), 3);
        assert!(bands[0].points[0].cd_m.min.is_infinite());
        let Spread { min, median, max } = bands[0].points[2].cd_m;
        assert!((min - 0.05).abs() < 1e-12 && (median - 0.1).abs() < 1e-12);
        assert!((max - 0.15).abs() < 1e-12);
    }

    #[test]
    fn a_curve_survives_json() {
        let curve = run("online", 1, 3.0, 4);
        let json = serde_json::to_string(&curve).unwrap();
        assert_eq!(serde_json::from_str::<Curve>(&json).unwrap(), curve);
    }
}
