//! How good a mesh made of a map is: the map's own metrics, of places spread evenly over its area.

use std::path::Path;

use echosplat_simulator::{Scene, SceneError};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::metrics::{FALSE_BEYOND_M, Figures, evaluate_raw};
use crate::neighbors::KdTree;
use crate::nullable;
use crate::statistics::share;
use crate::{MapPoints, Truth};

/// One place per square of this edge; the same places each time.
const SPACING_M: f64 = 0.02;
const SEED: u64 = 1;

/// Figures of one part of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MeshFigures {
    /// Mean distance of the mesh's area to truth.
    #[serde(with = "nullable")]
    pub accuracy_m: f64,
    /// The same over that of the map's Gaussians; infinite if either has none.
    #[serde(with = "nullable")]
    pub accuracy_ratio: f64,
    /// 95 % of the area is not further from truth.
    #[serde(with = "nullable")]
    pub p95_m: f64,
    /// The largest distance to truth.
    #[serde(with = "nullable")]
    pub max_m: f64,
    /// Mean distance of seen truth to the mesh.
    #[serde(with = "nullable")]
    pub completeness_m: f64,
    /// Area whose nearest truth is this part.
    pub area_m2: f64,
}

/// Everything said of a mesh. In scenes with a seabed the headline is the structure's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MeshMetrics {
    /// Of the structure; of everything where there is no seabed.
    #[serde(flatten)]
    pub headline: MeshFigures,
    /// Of the seabed, in scenes that have one.
    pub seabed: Option<MeshFigures>,
    /// Share of all area further than 0.25 m from all truth.
    pub false_area_share: f64,
    /// Share of all area further than 0.25 m from all truth that was seen.
    pub unseen_area_share: f64,
    /// Share of all area further than 0.25 m from everything that the map asserts.
    pub bare_area_share: f64,
}

/// Places spread evenly over the triangles of a file (PLY, OBJ or STL), in its coordinates, metres:
/// one per 4 cm², the same each time.
///
/// # Errors
/// If it cannot be read as a mesh.
pub fn mesh_places(path: &Path) -> Result<Vec<DVec3>, SceneError> {
    let samples = Scene::from_mesh(path)?.sample_surface(SPACING_M, SEED);
    Ok(samples.iter().map(|sample| sample.position).collect())
}

/// Judges a mesh by the [`mesh_places`] of it, beside the map that it was made of.
#[must_use]
pub fn evaluate_mesh(places: &[DVec3], map: &MapPoints, truth: &Truth) -> MeshMetrics {
    let mesh = evaluate_raw(&MapPoints::of_positions(places.iter().copied()), truth);
    let beside = evaluate_raw(map, truth);
    let seen = truth.seen().iter().map(|point| point.position);
    let parts = mesh.seabed.zip(beside.seabed);
    MeshMetrics {
        headline: MeshFigures::of(&mesh.headline, &beside.headline),
        seabed: parts.map(|(mesh, beside)| MeshFigures::of(&mesh, &beside)),
        false_area_share: mesh.confident_false_share,
        unseen_area_share: share_away(places, seen),
        bare_area_share: share_away(places, map.positions()),
    }
}

impl MeshFigures {
    fn of(mesh: &Figures, map: &Figures) -> Self {
        let ratio = mesh.accuracy_m / map.accuracy_m;
        Self {
            accuracy_m: mesh.accuracy_m,
            accuracy_ratio: if ratio.is_nan() { f64::INFINITY } else { ratio },
            p95_m: mesh.map_to_truth.p95_m,
            max_m: mesh.map_to_truth.max_m,
            completeness_m: mesh.completeness_m,
            area_m2: mesh.point_count as f64 * SPACING_M * SPACING_M,
        }
    }
}

fn share_away(places: &[DVec3], from: impl IntoIterator<Item = DVec3>) -> f64 {
    let tree = KdTree::new(from);
    let distances_m: Vec<f64> = places
        .par_iter()
        .map(|place| tree.distance(*place))
        .collect();
    share(&distances_m, |distance_m| *distance_m > FALSE_BEYOND_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two square metres at 0.1 m above a floor that was seen, one of them above what the map asserts.
    #[test]
    fn area_counts_and_not_triangles() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.obj");
        let text = "v 0 0 0.1\nv 2 0 0.1\nv 2 1 0.1\nv 0 1 0.1\nv 1 0 0.1\nf 1 5 3 4\nf 5 2 3\n";
        std::fs::write(&path, text).unwrap();
        let places = mesh_places(&path).unwrap();
        let grid = (0..=20).flat_map(|x| (0..=10).map(move |y| (x, y)));
        let floor = grid.map(|(x, y)| DVec3::new(f64::from(x), f64::from(y), 0.0) * 0.1);
        let floor: Vec<DVec3> = floor.collect();
        let truth = Truth::from_points(&floor);
        let left = floor.iter().copied().filter(|place| place.x <= 1.0);
        let found = evaluate_mesh(&places, &MapPoints::of_positions(left), &truth);
        assert!((found.headline.area_m2 - 2.0).abs() < 0.05);
        assert!((0.1..0.11).contains(&found.headline.accuracy_m));
        assert!(found.headline.accuracy_ratio.is_infinite());
        assert_eq!(found.seabed, None);
        assert!(found.false_area_share + found.unseen_area_share < 1e-12);
        // Within 0.23 m beside what is asserted, 0.1 m above it.
        assert!((found.bare_area_share - 0.385).abs() < 0.01);
    }

    #[test]
    fn no_mesh_is_infinitely_far() {
        let truth = Truth::from_points(&[DVec3::ZERO]);
        let map = MapPoints::of_positions([DVec3::X]);
        let found = evaluate_mesh(&[], &map, &truth);
        assert!(found.headline.accuracy_m.is_infinite());
        assert!(found.headline.completeness_m.is_infinite());
    }
}
