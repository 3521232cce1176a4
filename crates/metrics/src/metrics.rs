//! The metrics of a map.

use echosplat_simulator::SurfacePoint;
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::alignment::{align, best_level, best_rigid};
use crate::neighbors::KdTree;
use crate::nullable;
use crate::statistics::{Directed, quantile, share};
use crate::{MapPoint, MapPoints, Truth};

/// A confident point further than this from all truth is false.
pub const FALSE_BEYOND_M: f64 = 0.25;
/// An ambiguous Gaussian within this distance covers a place.
const COVER_WITHIN_M: f64 = 0.25;
/// The crop's box is the truth's, wider on each side by this share of its diagonal: many a true
/// surface lies in the box's faces.
const CROP_MARGIN_SHARE: f64 = 0.01;
const NORMAL_WITHIN_DEG: f64 = 20.0;

/// Figures of one part of the surface, raw: nothing aligned, nothing cropped. If either the map or
/// the seen truth has no point of it, all distances are infinite.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Mean distance map → truth.
    #[serde(with = "nullable")]
    pub accuracy_m: f64,
    /// Mean distance seen truth → map.
    #[serde(with = "nullable")]
    pub completeness_m: f64,
    /// Chamfer distance: half of accuracy plus completeness.
    #[serde(with = "nullable")]
    pub cd_m: f64,
    /// The same as the sum, as `SonarSplat`'s script has it.
    #[serde(with = "nullable")]
    pub cd_sum_m: f64,
    /// Hausdorff distance: the larger of the two directed maxima.
    #[serde(with = "nullable")]
    pub hd_m: f64,
    /// The larger of the two directed 95th percentiles.
    #[serde(with = "nullable")]
    pub p95_m: f64,
    /// The larger of the two directed 99th percentiles.
    #[serde(with = "nullable")]
    pub p99_m: f64,
    /// All of map → truth.
    pub map_to_truth: Directed,
    /// All of seen truth → map.
    pub truth_to_map: Directed,
    /// Share of map points within 5 cm of truth.
    pub precision_5cm: f64,
    /// Share of seen truth within 5 cm of the map.
    pub recall_5cm: f64,
    /// Harmonic mean of the two.
    pub f_5cm: f64,
    /// Share of map points within 10 cm of truth.
    pub precision_10cm: f64,
    /// Share of seen truth within 10 cm of the map.
    pub recall_10cm: f64,
    /// Harmonic mean of the two.
    pub f_10cm: f64,
    /// Map points it is about.
    pub point_count: usize,
    /// Samples of seen truth it is about.
    pub truth_sample_count: usize,
}

/// Whether Gaussians are more than dots: the angle between each flat one's shortest axis and the
/// normal of the nearest truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Normals {
    /// Half of the angles are not larger.
    pub median_deg: f64,
    /// Share of angles up to 20°.
    pub within_20deg_share: f64,
    /// Gaussians whose shortest scale is below half of the middle one.
    pub flat_count: usize,
}

/// By the paper's protocol: map aligned with the truth by ICP, then cropped to the box of the truth
/// (of its structure, where there is a seabed). Never the headline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PaperFigures {
    /// Chamfer distance, half-sum.
    #[serde(with = "nullable")]
    pub cd_m: f64,
    /// Chamfer distance, sum.
    #[serde(with = "nullable")]
    pub cd_sum_m: f64,
    /// Hausdorff distance.
    #[serde(with = "nullable")]
    pub hd_m: f64,
    /// How far ICP moved the middle of the map.
    pub shift_m: f64,
    /// How far ICP turned it.
    pub turn_deg: f64,
    /// Steps of ICP.
    pub icp_iterations: usize,
    /// Points left out by the crop.
    pub cropped_count: usize,
}

/// Of a map that was shifted and turned about the vertical onto the truth. Never the headline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AlignedFigures {
    /// Chamfer distance, half-sum.
    #[serde(with = "nullable")]
    pub cd_m: f64,
    /// Hausdorff distance.
    #[serde(with = "nullable")]
    pub hd_m: f64,
    /// Mean distance map → truth.
    #[serde(with = "nullable")]
    pub accuracy_m: f64,
    /// Mean distance seen truth → map.
    #[serde(with = "nullable")]
    pub completeness_m: f64,
    /// Share of all confident points further than 0.25 m from all truth.
    pub confident_false_share: f64,
    /// How far that moved the middle of the map, along the world's axes.
    pub shift_m: [f64; 3],
    /// How far it turned it, from x to y.
    pub turn_deg: f64,
}

/// Everything said of a map. The headline's figures are fields of it in JSON, and reachable as
/// such in code; in a scene with a seabed they are those of the structure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Of the structure; of everything where there is no seabed.
    #[serde(flatten)]
    pub headline: Figures,
    /// Of the seabed, in scenes that have one. Map points are split by their nearest truth.
    pub seabed: Option<Figures>,
    /// Of structure and seabed together, in scenes that have a seabed.
    pub whole: Option<Figures>,
    /// Share of all confident points further than 0.25 m from all truth; 0 in an empty map.
    pub confident_false_share: f64,
    /// How many those are.
    pub confident_false_count: usize,
    /// Share of seen truth within 0.25 m of an ambiguous Gaussian.
    pub ambiguous_cover_share: f64,
    /// Confident Gaussians.
    pub confident_count: usize,
    /// Ambiguous Gaussians.
    pub ambiguous_count: usize,
    /// Gaussians that were not finite.
    pub left_out_count: usize,
    /// `None` without flat Gaussians or without known normals.
    pub normals: Option<Normals>,
    /// Of Gaussians nearest to structure, in scenes that have a seabed.
    pub structure_normals: Option<Normals>,
    /// Of Gaussians nearest to seabed, in scenes that have one.
    pub seabed_normals: Option<Normals>,
    /// By the paper's protocol; `None` if it was not asked for or either set is empty.
    pub paper: Option<PaperFigures>,
}

impl std::ops::Deref for Metrics {
    type Target = Figures;

    fn deref(&self) -> &Figures {
        &self.headline
    }
}

/// Everything, the paper's protocol beside.
#[must_use]
pub fn evaluate(points: &MapPoints, truth: &Truth) -> Metrics {
    Metrics {
        paper: by_the_paper(points, truth),
        ..evaluate_raw(points, truth)
    }
}

/// Without the paper's protocol, whose alignment takes most of the time.
#[must_use]
pub fn evaluate_raw(points: &MapPoints, truth: &Truth) -> Metrics {
    let to_truth = all_to_truth(&points.confident, truth);
    let to_map = distances_to_map(&points.confident, truth.seen());
    let part = |wanted: fn(bool) -> bool| {
        let map = to_truth.iter().filter(|d| wanted(d.is_seabed));
        let seen = truth.seen().iter().zip(&to_map);
        let seen = seen.filter(|(point, _)| wanted(point.is_seabed));
        Figures::of(
            map.map(|d| d.distance_m).collect(),
            seen.map(|(_, d)| *d).collect(),
        )
    };
    let has_seabed = truth.has_seabed();
    let normals_of = |seabed: bool| {
        let is_part = |is_seabed| has_seabed && is_seabed == seabed;
        normals(&points.confident, &to_truth, is_part)
    };
    let false_count = to_truth.iter().filter(|d| d.is_false()).count();
    Metrics {
        headline: part(if has_seabed {
            |seabed| !seabed
        } else {
            |_| true
        }),
        seabed: has_seabed.then(|| part(|seabed| seabed)),
        whole: has_seabed.then(|| part(|_| true)),
        confident_false_share: share(&to_truth, ToTruth::is_false),
        confident_false_count: false_count,
        ambiguous_cover_share: ambiguous_cover(&points.ambiguous, truth),
        confident_count: points.confident.len(),
        ambiguous_count: points.ambiguous.len(),
        left_out_count: points.left_out_count,
        normals: normals(&points.confident, &to_truth, |_| true),
        structure_normals: normals_of(false),
        seabed_normals: normals_of(true),
        paper: None,
    }
}

/// From one map point to the truth.
struct ToTruth {
    distance_m: f64,
    normal: DVec3,
    is_seabed: bool,
}

impl ToTruth {
    fn is_false(&self) -> bool {
        self.distance_m > FALSE_BEYOND_M
    }
}

/// Distance of each point to the truth, metres, in the map's order.
#[must_use]
pub fn distances_to_truth(map: &[MapPoint], truth: &Truth) -> Vec<f64> {
    let all = all_to_truth(map, truth);
    all.iter().map(|point| point.distance_m).collect()
}

/// In the map's order; each is independent of the others, so threads change no bit.
fn all_to_truth(map: &[MapPoint], truth: &Truth) -> Vec<ToTruth> {
    let to_truth = |point: &MapPoint| {
        let (distance_m, normal, is_seabed) = truth.nearest(point.position);
        ToTruth {
            distance_m,
            normal,
            is_seabed,
        }
    };
    map.par_iter().map(to_truth).collect()
}

fn distances_to_map(map: &[MapPoint], seen: &[SurfacePoint]) -> Vec<f64> {
    let tree = KdTree::new(map.iter().map(|point| point.position));
    let distance = |place: &SurfacePoint| tree.distance(place.position);
    seen.par_iter().map(distance).collect()
}

impl Figures {
    fn of(to_truth: Vec<f64>, to_map: Vec<f64>) -> Self {
        let (point_count, truth_sample_count) = (to_truth.len(), to_map.len());
        let within = |distances: &[f64], limit_m: f64| share(distances, |d| *d <= limit_m);
        let [precision_5cm, precision_10cm] = [0.05, 0.1].map(|limit| within(&to_truth, limit));
        let [recall_5cm, recall_10cm] = [0.05, 0.1].map(|limit| within(&to_map, limit));
        let (map_to_truth, truth_to_map) = (Directed::of(to_truth), Directed::of(to_map));
        let (accuracy_m, completeness_m) = (map_to_truth.mean_m, truth_to_map.mean_m);
        Self {
            accuracy_m,
            completeness_m,
            cd_m: 0.5 * (accuracy_m + completeness_m),
            cd_sum_m: accuracy_m + completeness_m,
            hd_m: map_to_truth.max_m.max(truth_to_map.max_m),
            p95_m: map_to_truth.p95_m.max(truth_to_map.p95_m),
            p99_m: map_to_truth.p99_m.max(truth_to_map.p99_m),
            map_to_truth,
            truth_to_map,
            precision_5cm,
            recall_5cm,
            f_5cm: harmonic_mean(precision_5cm, recall_5cm),
            precision_10cm,
            recall_10cm,
            f_10cm: harmonic_mean(precision_10cm, recall_10cm),
            point_count,
            truth_sample_count,
        }
    }
}

fn harmonic_mean(a: f64, b: f64) -> f64 {
    if a + b > 0.0 {
        2.0 * a * b / (a + b)
    } else {
        0.0
    }
}

fn ambiguous_cover(ambiguous: &[DVec3], truth: &Truth) -> f64 {
    let tree = KdTree::new(ambiguous.iter().copied());
    let seen = truth.seen().par_iter();
    let distances: Vec<f64> = seen.map(|point| tree.distance(point.position)).collect();
    share(&distances, |distance_m| *distance_m <= COVER_WITHIN_M)
}

/// Of the points whose nearest truth is seabed or not, as `counts` says.
fn normals(
    map: &[MapPoint],
    to_truth: &[ToTruth],
    counts: impl Fn(bool) -> bool,
) -> Option<Normals> {
    let both = map.iter().zip(to_truth);
    let known = both.filter(|(_, truth)| counts(truth.is_seabed));
    let known = known.filter_map(|(point, truth)| {
        let axis = point.shortest_axis?;
        let cosine = axis.dot(truth.normal.try_normalize()?).abs().min(1.0);
        Some(cosine.acos().to_degrees())
    });
    let mut angles_deg: Vec<f64> = known.collect();
    angles_deg.sort_unstable_by(f64::total_cmp);
    (!angles_deg.is_empty()).then(|| Normals {
        median_deg: quantile(&angles_deg, 0.5),
        within_20deg_share: share(&angles_deg, |angle| *angle <= NORMAL_WITHIN_DEG),
        flat_count: angles_deg.len(),
    })
}

/// Of a map that was shifted and turned about the vertical so that it lies as near to the truth as it can: what is wrong with
/// it beside where it lies as a whole. Never the headline. `None` if either set is empty.
#[must_use]
pub fn evaluate_aligned(points: &MapPoints, truth: &Truth) -> Option<AlignedFigures> {
    let map: Vec<DVec3> = points
        .confident
        .iter()
        .map(|point| point.position)
        .collect();
    if map.is_empty() || truth.seen().is_empty() {
        return None;
    }
    let pose = align(&map, truth.seen_tree(), best_level).truth_from_map;
    let middle = map.iter().sum::<DVec3>() / map.len() as f64;
    let moved = MapPoints::of_positions(map.into_iter().map(|point| pose * point));
    let metrics = evaluate_raw(&moved, truth);
    let ahead = pose.rotation * DVec3::X;
    Some(AlignedFigures {
        cd_m: metrics.cd_m,
        hd_m: metrics.hd_m,
        accuracy_m: metrics.accuracy_m,
        completeness_m: metrics.completeness_m,
        confident_false_share: metrics.confident_false_share,
        shift_m: (pose * middle - middle).to_array(),
        turn_deg: ahead.y.atan2(ahead.x).to_degrees(),
    })
}

fn by_the_paper(points: &MapPoints, truth: &Truth) -> Option<PaperFigures> {
    let map: Vec<DVec3> = points
        .confident
        .iter()
        .map(|point| point.position)
        .collect();
    let (low, high) = truth.bounds()?;
    let margin_m = CROP_MARGIN_SHARE * low.distance(high);
    let (low, high) = (low - margin_m, high + margin_m);
    if map.is_empty() {
        return None;
    }
    let alignment = align(&map, truth.seen_tree(), best_rigid);
    let pose = alignment.truth_from_map;
    let middle = map.iter().sum::<DVec3>() / map.len() as f64;
    let moved = map.iter().map(|point| pose * *point);
    let inside = |point: &DVec3| point.cmpge(low).all() && point.cmple(high).all();
    let kept = MapPoints::of_positions(moved.filter(inside));
    let to_truth = distances_to_truth(&kept.confident, truth);
    let seen = truth.seen().iter().copied();
    let seen: Vec<SurfacePoint> = seen.filter(|place| inside(&place.position)).collect();
    let figures = Figures::of(to_truth, distances_to_map(&kept.confident, &seen));
    Some(PaperFigures {
        cd_m: figures.cd_m,
        cd_sum_m: figures.cd_sum_m,
        hd_m: figures.hd_m,
        shift_m: (pose * middle).distance(middle),
        turn_deg: 2.0 * pose.rotation.w.abs().min(1.0).acos().to_degrees(),
        icp_iterations: alignment.iterations,
        cropped_count: map.len() - kept.confident.len(),
    })
}

#[cfg(test)]
mod tests;
