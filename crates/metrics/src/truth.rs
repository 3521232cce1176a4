//! What a map is compared with.

use std::path::Path;
use std::sync::Arc;

use echosplat_simulator::{Scene, SceneError, SurfacePoint};
use glam::DVec3;

use crate::neighbors::KdTree;
use crate::point_file::{self, PointFileError};

/// Samples of a surface lie about this share of its extent apart.
const SPACING_SHARE: f64 = 1e-3;
const SPACING_LIMITS_M: (f64, f64) = (0.02, 0.1);
/// The same places in every run.
const SAMPLE_SEED: u64 = 1;
/// Largest point file taken.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// The true surface: exact for map → truth, and the samples of it that were seen for truth → map.
pub struct Truth {
    surface: Surface,
    seen: Vec<SurfacePoint>,
    seen_tree: KdTree,
}

enum Surface {
    Scene(Arc<Scene>),
    /// No more is known than the samples.
    Points,
}

/// Why there is no truth.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The scene or mesh.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The points.
    #[error("{path}: {source}")]
    Points {
        /// The file.
        path: String,
        /// What is wrong with it.
        source: PointFileError,
    },
}

impl Truth {
    /// Of a scene. `seen` are places that the dive's pings hit first; without a dive, a fixed
    /// sample of the whole surface.
    #[must_use]
    pub fn from_scene(scene: &Arc<Scene>, seen: Option<Vec<SurfacePoint>>) -> Self {
        let seen = seen.unwrap_or_else(|| sample(scene));
        Self::new(Surface::Scene(scene.clone()), seen)
    }

    /// Of the triangles of a mesh (STL, OBJ or PLY), in metres.
    fn of_mesh(bytes: &[u8], path: &Path) -> Result<Self, TruthError> {
        let scene = Arc::new(Scene::of_mesh(bytes, path)?);
        Ok(Self::from_scene(&scene, None))
    }

    /// Of bare points, metres: distances are to the nearest of them, and nothing is seabed.
    #[must_use]
    pub fn from_points(positions: &[DVec3]) -> Self {
        let point = |&position| SurfacePoint {
            position,
            normal: DVec3::ZERO,
            is_seabed: false,
        };
        let finite = positions.iter().filter(|position| position.is_finite());
        Self::new(Surface::Points, finite.map(point).collect())
    }

    /// By what the file is: a scene (`.toml`), a mesh (`.stl`, `.obj`, `.ply` with faces), or
    /// points (`.ply` without, or lines of `x y z`).
    ///
    /// # Errors
    /// Says what is wrong with the file.
    pub fn load(path: &Path) -> Result<Self, TruthError> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
        let extension = extension.to_ascii_lowercase();
        if extension == "toml" {
            return Ok(Self::from_scene(&Arc::new(Scene::load(path)?), None));
        }
        let bytes = echosplat_input::read(path, MAX_FILE_BYTES);
        let bytes = bytes.map_err(|error| in_file(path, error.into()))?;
        if ["stl", "obj"].contains(&extension.as_str()) || point_file::has_faces(&bytes) {
            return Self::of_mesh(&bytes, path);
        }
        let positions = point_file::parse(&bytes).map_err(|error| in_file(path, error))?;
        Ok(Self::from_points(&positions))
    }

    fn new(surface: Surface, seen: Vec<SurfacePoint>) -> Self {
        Self {
            seen_tree: KdTree::new(seen.iter().map(|point| point.position)),
            surface,
            seen,
        }
    }

    /// Samples of what was seen.
    #[must_use]
    pub fn seen(&self) -> &[SurfacePoint] {
        &self.seen
    }

    /// Whether part of it is seabed, which is then counted apart.
    #[must_use]
    pub fn has_seabed(&self) -> bool {
        match &self.surface {
            Surface::Scene(scene) => scene.has_seabed(),
            Surface::Points => false,
        }
    }

    /// Distance from `point` to the nearest surface, its unit normal there (zero if unknown) and
    /// whether that is seabed. Infinite where there is no surface or `point` is not finite.
    #[must_use]
    pub fn nearest(&self, point: DVec3) -> (f64, DVec3, bool) {
        if !point.is_finite() {
            return (f64::INFINITY, DVec3::ZERO, false);
        }
        match &self.surface {
            Surface::Scene(scene) => scene.nearest(point),
            Surface::Points => (self.seen_tree.distance(point), DVec3::ZERO, false),
        }
    }

    /// Low and high corner of the box around the samples seen, without seabed if there is anything
    /// else; `None` if there are none.
    #[must_use]
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let structure = self.seen.iter().filter(|point| !point.is_seabed);
        bounds_of(structure).or_else(|| bounds_of(self.seen.iter()))
    }

    pub(crate) fn seen_tree(&self) -> &KdTree {
        &self.seen_tree
    }
}

fn bounds_of<'a>(points: impl Iterator<Item = &'a SurfacePoint>) -> Option<(DVec3, DVec3)> {
    points
        .map(|p| (p.position, p.position))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

fn sample(scene: &Scene) -> Vec<SurfacePoint> {
    let extent_m = scene.bounds().map_or(0.0, |(low, high)| low.distance(high));
    let (least_m, most_m) = SPACING_LIMITS_M;
    let spacing_m = (extent_m * SPACING_SHARE).clamp(least_m, most_m);
    scene.sample_surface(spacing_m, SAMPLE_SEED)
}

fn in_file(path: &Path, source: PointFileError) -> TruthError {
    TruthError::Points {
        path: path.display().to_string(),
        source,
    }
}
