//! The file's contents. Distances in metres, shares 0 to 1, times in seconds; `null` is infinite.

use echosplat_metrics::nullable;
use serde::{Deserialize, Serialize};

/// All that one version reached.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// Of the program.
    pub version: String,
    /// Of the program's source.
    pub commit: String,
    /// The processor's own name.
    pub processor: String,
    /// Threads it runs at once.
    pub cores: usize,
    /// Runs at a time, each with one thread of the mapper.
    pub jobs: u64,
    /// What made the file.
    pub command: String,
    /// Names of runs that were not made, or not yet.
    pub left_out: Vec<String>,
    /// Name and reason of each run that failed.
    pub failed: Vec<(String, String)>,
    /// What was made smaller so that all of it fits its time, in sentences.
    pub thinned: Vec<String>,
    /// All runs one after another, simulation and judging included.
    pub run_s: f64,
    /// Finished maps of whole dives.
    pub accuracy: Vec<Case>,
    /// Live maps beside the dive ended there.
    pub live: Vec<Live>,
    /// How often truth lies within what maps say of themselves.
    pub sigma: Vec<Sigma>,
    /// Echoes that sink into the noise.
    pub noise: Vec<Noise>,
    /// Error against processor time, by method.
    pub error_time: Vec<Watched>,
    /// The same structure for longer and longer.
    pub length: Vec<Case>,
    /// What is asked, and what was reached.
    pub targets: Vec<Judged>,
}

/// Maps of one dive over seeds.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// A built-in scene.
    pub scene: String,
    /// How the sonar moves.
    pub dive: String,
    /// What is wrong with pings and poses.
    pub noise: String,
    /// One a seed that was run to its end.
    pub runs: Vec<Run>,
}

/// One finished map.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Of everything random.
    pub seed: u64,
    /// Chamfer distance.
    #[serde(with = "nullable")]
    pub cd_m: f64,
    /// The larger of the two directed 99th percentiles.
    #[serde(with = "nullable")]
    pub p99_m: f64,
    /// Hausdorff distance.
    #[serde(with = "nullable")]
    pub hd_m: f64,
    /// Of what is asserted, what lies beyond 0.25 m of truth.
    pub false_share: f64,
    /// Of what was seen, what lies within 0.10 m of the map.
    pub recall_share: f64,
    /// Gaussians that are asserted.
    pub confident: usize,
    /// Gaussians that are not.
    pub ambiguous: usize,
    /// Length of the dive.
    pub dive_s: f64,
    /// In the map.
    pub pings: u64,
    /// Processor time of the mapper while the dive goes on.
    pub live_s: f64,
    /// With the finish.
    pub total_s: f64,
    /// Of the whole process, simulator included.
    pub peak_bytes: u64,
}

/// A live map beside that of the same dive ended there.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Live {
    /// A built-in scene, surveyed at nominal noise.
    pub scene: String,
    /// Of everything random.
    pub seed: u64,
    /// So much of the dive.
    pub share: f64,
    /// Chamfer distance, 99th percentile and false share of the live map.
    pub live: Point,
    /// Of the dive that ends there; of the whole where it was not run.
    pub ended: Option<Point>,
}

/// What a map is worth at some moment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Into the dive.
    pub dive_s: f64,
    /// Processor time so far.
    pub compute_s: f64,
    /// Chamfer distance.
    #[serde(with = "nullable")]
    pub cd_m: f64,
    /// The larger of the two directed 99th percentiles.
    #[serde(with = "nullable")]
    pub p99_m: f64,
    /// Of what is asserted, what is false.
    pub false_share: f64,
}

/// What maps say of their own certainty, all surveys of one noise level together.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Sigma {
    /// Of pings and poses.
    pub noise: String,
    /// How many maps.
    pub maps: usize,
    /// Share within two sigma along truth's normal.
    pub within_share: f64,
    /// Sigma and error, rms, of tenths by sigma from the surest.
    pub tenths_m: Vec<(f64, f64)>,
    /// Probability told, share with truth within 0.10 m, and how many Gaussians.
    pub probability: Vec<(f64, f64, usize)>,
}

/// One survey heard so far above the noise.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Whose pings: `field` or `nominal`.
    pub pings: String,
    /// Strongest echo of a ping over the mean noise, median over the pings.
    pub over_noise_db: f64,
    /// What came of it.
    pub run: Run,
}

/// A dive by several methods.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Watched {
    /// Scene, dive and noise.
    pub dive: String,
    /// One a method.
    pub curves: Vec<Curve>,
}

/// One method on one dive, one seed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Its name.
    pub method: String,
    /// In order of time.
    pub points: Vec<Point>,
}

/// A target and what was reached.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Which dive.
    pub case: String,
    /// What is asked for.
    pub quantity: String,
    /// The limit of the median, as it is written.
    pub asked: String,
    /// Median over the seeds.
    pub median: String,
    /// The worst seed.
    pub worst: String,
    /// How many seeds.
    pub seeds: usize,
    /// `passed`, `failed` or `incomplete`.
    pub verdict: String,
    /// How many times the limit the median is, or the limit it; `None` where that says nothing.
    pub times: Option<f64>,
}
