//! What came out of a run.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Spec;
use echosplat_metrics::curve::Sample;
use echosplat_metrics::{Certainty, Metrics, nullable};
use echosplat_prediction::held_out::HeldOut;
use echosplat_report::table::{metres, percent};

/// What a mapper had done at some moment.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Work {
    /// Processor seconds of its threads.
    pub(crate) compute_s: f64,
    /// Gaussian–bin pairs.
    pub(crate) pairs: u64,
    /// Voxel observations; arc samples of methods that have no voxels.
    #[serde(rename = "voxel_looks")]
    pub(crate) voxel_observations: u64,
}

impl Work {
    /// Pairs and voxel observations, each at its count.
    #[must_use]
    pub(crate) fn counted(&self) -> u64 {
        self.pairs + self.voxel_observations
    }
}

/// An optional feature of the mapper that a map was made without.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct LeftOut {
    /// Its name, as in the configuration's `mapper.parts`.
    #[serde(rename = "part")]
    pub(crate) feature: String,
    /// In words.
    pub(crate) why: String,
}

/// How a run ended: what a caller would get as its return code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Ending {
    /// By itself: all its passes are made.
    Converged,
    /// A limit on its work came first.
    Budget,
    /// Something was seen, and the data left open where it is: nothing is asserted.
    Degenerate,
    /// No map: the run failed, or its input was refused.
    Rejected,
}

impl Ending {
    /// All of them, from best to worst.
    pub(crate) const ALL: [Self; 4] = [
        Self::Converged,
        Self::Budget,
        Self::Degenerate,
        Self::Rejected,
    ];

    /// Of what a run came to. An empty map of nothing has converged.
    #[must_use]
    pub(crate) fn of(result: &Result<Outcome, String>) -> Self {
        let Ok(outcome) = result else {
            return Self::Rejected;
        };
        let metrics = &outcome.metrics;
        let was_seen = metrics.truth_sample_count > 0;
        match () {
            () if outcome.pings == 0 => Self::Rejected,
            () if was_seen && metrics.confident_count == 0 => Self::Degenerate,
            () if outcome.met_budget => Self::Budget,
            () => Self::Converged,
        }
    }

    /// As in reports.
    #[must_use]
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Budget => "budget",
            Self::Degenerate => "degenerate",
            Self::Rejected => "rejected",
        }
    }
}

/// What came out of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Outcome {
    /// Of the finished map, turned and moved back to the scene.
    pub(crate) metrics: Metrics,
    /// Of the finished map, where the dive took place at the scene; `None` elsewhere, or where nothing is asserted.
    #[serde(default)]
    pub(crate) certainty: Option<Certainty>,
    /// Of the live map in the middle of the dive; infinite where there was none.
    #[serde(with = "nullable")]
    pub(crate) mid_dive_cd_m: f64,
    /// Pings in the map.
    pub(crate) pings: u64,
    /// From the first ping to the newest in the map, seconds.
    #[serde(default)]
    pub(crate) dive_s: f64,
    /// Before the finish; maps made to be looked at do not count.
    pub(crate) streamed: Work,
    /// With the finish.
    pub(crate) total: Work,
    /// Pings of the same dive that the map has not seen; `None` where it was not asked for, or
    /// nothing was heard.
    #[serde(rename = "held_back")]
    pub(crate) held_out: Option<HeldOut>,
    /// Of the whole process until the map was there, the simulator included.
    pub(crate) peak_memory_bytes: u64,
    /// By the clock, simulation and judging included.
    pub(crate) wall_s: f64,
    /// Names the bits of the finished map.
    pub(crate) fingerprint: String,
    /// The map at moments of the dive, in their order; without the finished map's.
    #[serde(default)]
    pub(crate) samples: Vec<Sample>,
    /// Whether a limit on its work ended it rather than its own end.
    #[serde(default)]
    pub(crate) met_budget: bool,
    /// Optional features that the mapper left out by itself.
    #[serde(default)]
    pub(crate) left_out: Vec<LeftOut>,
    /// From the same dive where it really was, for a dive that took place elsewhere: the mean of
    /// the two directed mean distances between confident points. Filled in once both are there.
    #[serde(skip)]
    pub(crate) from_unmoved_m: Option<f64>,
}

/// Outcomes by [`Spec::name`]: what a run came to, or why it failed. What is not there was not run.
#[derive(Debug, Clone, Default)]
pub(crate) struct Outcomes(pub(crate) BTreeMap<String, Result<Outcome, String>>);

impl Outcomes {
    /// Of one run.
    #[must_use]
    pub(crate) fn of(&self, spec: &Spec) -> Option<&Result<Outcome, String>> {
        self.0.get(&spec.name())
    }
}

/// What is worth saying when a run is done.
#[must_use]
pub(crate) fn run_line(outcome: &Outcome) -> String {
    let metrics = &outcome.metrics;
    format!(
        "CD {} m, HD {} m, {} false, {} + {} Gaussians, {:.0} s of computing, {:.0} s in all",
        metres(metrics.cd_m),
        metres(metrics.hd_m),
        percent(metrics.confident_false_share),
        metrics.confident_count,
        metrics.ambiguous_count,
        outcome.total.compute_s,
        outcome.wall_s,
    )
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use echosplat_metrics::{MapPoints, Truth, evaluate_raw};
    use glam::DVec3;

    /// A run whose map is one point, `cd_m` from the only truth.
    pub(crate) fn outcome(cd_m: f64, pairs: u64) -> Outcome {
        let truth = Truth::from_points(&[DVec3::ZERO]);
        let map = MapPoints::of_positions(cd_m.is_finite().then_some(DVec3::X * cd_m));
        let total = Work {
            compute_s: 1e-6 * pairs as f64,
            pairs,
            voxel_observations: 0,
        };
        Outcome {
            metrics: evaluate_raw(&map, &truth),
            certainty: None,
            mid_dive_cd_m: f64::INFINITY,
            pings: 10,
            dive_s: 30.0,
            streamed: Work::default(),
            total,
            held_out: None,
            peak_memory_bytes: 0,
            wall_s: 0.0,
            fingerprint: String::new(),
            samples: Vec::new(),
            met_budget: false,
            left_out: Vec::new(),
            from_unmoved_m: None,
        }
    }

    #[test]
    fn endings_are_told_apart() {
        let of = |outcome| Ending::of(&Ok(outcome));
        let bounded = Outcome {
            met_budget: true,
            ..outcome(0.1, 1)
        };
        let deaf = Outcome {
            pings: 0,
            ..outcome(0.1, 1)
        };
        assert_eq!(of(outcome(0.1, 1)), Ending::Converged);
        assert_eq!(of(bounded), Ending::Budget);
        assert_eq!(of(outcome(f64::INFINITY, 1)), Ending::Degenerate);
        assert_eq!(of(deaf), Ending::Rejected);
        assert_eq!(Ending::of(&Err("no".into())), Ending::Rejected);
        let mut open_water = outcome(f64::INFINITY, 1);
        let nothing = evaluate_raw(&MapPoints::default(), &Truth::from_points(&[]));
        open_water.metrics = nothing;
        assert_eq!(of(open_water), Ending::Converged);
    }
}
