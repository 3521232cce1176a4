//! A scene: solids with exact geometry and what they send back.

mod ellipsoid;
mod error;
mod file;
mod load;
mod meeting;
mod mesh;
mod sample;
mod shape;
mod tree;

use glam::DVec3;

pub use error::SceneError;
pub use file::SurveyPath;
pub(crate) use file::{SurveyHints, ViewpointHints};
pub use load::BUILT_IN_SCENES;
use meeting::Closest;
pub use sample::SurfacePoint;
use shape::Shape;
use tree::{Bounds, Tree, union};

/// Deeper than this in another solid a surface is no surface.
const BURIED_M: f64 = 1e-6;

/// Solids in the world: what there is to be mapped, and the truth it is compared with.
///
/// Read from TOML by [`Scene::parse`], [`Scene::load`] or [`Scene::named`].
pub struct Scene {
    name: String,
    parts: Vec<Part>,
    planes: Vec<Plane>,
    tree: Tree,
    survey: SurveyHints,
    viewpoints: ViewpointHints,
}

/// A bounded piece of surface and what it is made of.
struct Part {
    shape: Shape,
    material: Material,
}

/// Everything on the far side of `normal` from `point`, without end.
#[derive(Debug, Clone, Copy)]
struct Plane {
    point: DVec3,
    normal: DVec3,
    material: Material,
}

#[derive(Debug, Clone, Copy)]
struct Material {
    reflectivity: f64,
    specular: f64,
    is_seabed: bool,
}

/// Where a ray first meets a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// From the ray's origin.
    pub distance_m: f64,
    /// In the world.
    pub position: DVec3,
    /// Unit, outward; of a triangle, by its winding.
    pub normal: DVec3,
    /// Share of the power that comes back at normal incidence.
    pub reflectivity: f64,
    /// Exponent of the fall-off with the cosine of the angle from the normal; 0 is diffuse.
    pub specular: f64,
    /// Whether it belongs to the seabed.
    pub is_seabed: bool,
    /// How far around the place its tangent plane still stands for the surface.
    pub flat_reach_m: f64,
}

impl Scene {
    /// As the file says.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether nothing is there at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty() && self.planes.is_empty()
    }

    /// Whether any solid counts as seabed.
    #[must_use]
    pub fn has_seabed(&self) -> bool {
        let part = self.parts.iter().any(|part| part.material.is_seabed);
        part || self.planes.iter().any(|plane| plane.material.is_seabed)
    }

    /// Corners of the box around all structure: what is bounded and not seabed. `None` if there is
    /// no structure.
    #[must_use]
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let structure = self.parts.iter().filter(|part| !part.material.is_seabed);
        union(structure.map(|part| part.shape.bounds()))
    }

    /// The box around all that is bounded, seabed included.
    pub(crate) fn whole_bounds(&self) -> Option<Bounds> {
        union(self.parts.iter().map(|part| part.shape.bounds()))
    }

    /// Surface of all bounded structure, buried pieces included.
    pub(crate) fn structure_area_m2(&self) -> f64 {
        let structure = self.parts.iter().filter(|part| !part.material.is_seabed);
        structure.map(|part| part.shape.area()).sum()
    }

    pub(crate) fn survey_hints(&self) -> &SurveyHints {
        &self.survey
    }

    pub(crate) fn viewpoint_hints(&self) -> &ViewpointHints {
        &self.viewpoints
    }

    /// The first surface along a ray, exact. `direction` is a unit vector; metres, world axes.
    /// A ray that starts inside a solid meets the surface it leaves by.
    #[must_use]
    pub fn cast(&self, origin: DVec3, direction: DVec3, max_range_m: f64) -> Option<Hit> {
        let mut nearest = None;
        let mut max_m = max_range_m;
        for plane in &self.planes {
            let facing = direction.dot(plane.normal);
            let distance_m = (plane.point - origin).dot(plane.normal) / facing;
            if distance_m >= 0.0 && distance_m <= max_m {
                max_m = distance_m;
                nearest = Some((distance_m, plane.normal, plane.material, f64::INFINITY));
            }
        }
        self.tree
            .cast(origin, direction, max_m, |index, max_so_far_m| {
                let part = &self.parts[index];
                let crossing = part.shape.cast(origin, direction, max_so_far_m)?;
                let reach_m = part.shape.flat_reach();
                nearest = Some((crossing.distance, crossing.normal, part.material, reach_m));
                Some(crossing.distance)
            });
        let (distance_m, normal, material, flat_reach_m) = nearest?;
        Some(Hit {
            distance_m,
            position: origin + direction * distance_m,
            normal,
            reflectivity: material.reflectivity,
            specular: material.specular,
            is_seabed: material.is_seabed,
            flat_reach_m,
        })
    }

    /// Exact distance to the nearest surface, metres, never negative; infinite in an empty scene.
    #[must_use]
    pub fn distance(&self, point: DVec3) -> f64 {
        self.nearest(point).0
    }

    /// Distance to the nearest surface, its outward normal there, and whether it is seabed.
    ///
    /// Outside all solids this is exact. Inside, pieces of surface that are buried in another
    /// solid do not count, unless nothing else is left; where solids join, the way out is then
    /// found by walking from one to the next, and may be longer than the shortest by less than the
    /// joint is wide. Infinite, zero and `false` in an empty scene.
    #[must_use]
    pub fn nearest(&self, point: DVec3) -> (f64, DVec3, bool) {
        // The place nearest from outside of everything is never buried.
        if self.contains(point, 0.0) {
            let bare = self.nearest_where(point, |place| !self.is_buried(place));
            let out = self.walk_out(point).filter(|out| out.0 < bare.0);
            if let Some(out) = out {
                return out;
            }
            if bare.0.is_finite() {
                return bare;
            }
        }
        self.nearest_where(point, |_| true)
    }

    /// From inside: to the nearest wall of the solid around, or up to the seabed, and on from there
    /// while that is buried in another. What leaves a structure on its way is not seabed.
    fn walk_out(&self, point: DVec3) -> Option<(f64, DVec3, bool)> {
        const MOST_STEPS: usize = 64;
        /// To and fro between two solids the walk comes to the crease between them, ever slower.
        const ARRIVED_M: f64 = 1e-4;
        let (mut place, mut is_all_seabed) = (point, true);
        for _ in 0..MOST_STEPS {
            let exits = self.exits(place);
            let (exit, is_seabed) = exits
                .into_iter()
                .min_by(|(a, _), (b, _)| a.signed.abs().total_cmp(&b.signed.abs()))?;
            let step_m = place.distance(exit.place);
            place = exit.place;
            is_all_seabed &= is_seabed;
            if step_m < ARRIVED_M || !self.is_buried(place) {
                return Some((point.distance(place), exit.normal, is_all_seabed));
            }
        }
        None
    }

    /// The nearest way out of each solid and each ground that holds `place` strictly inside, and
    /// whether it is seabed.
    fn exits(&self, place: DVec3) -> Vec<(Closest, bool)> {
        let mut exits = Vec::new();
        for plane in &self.planes {
            let signed = (place - plane.point).dot(plane.normal);
            if signed < -BURIED_M {
                let exit = Closest {
                    signed,
                    place: place - plane.normal * signed,
                    normal: plane.normal,
                };
                exits.push((exit, plane.material.is_seabed));
            }
        }
        self.tree.any_around(place, |index| {
            let part = &self.parts[index];
            if part.shape.contains(place, BURIED_M) {
                exits.push((part.shape.closest(place), part.material.is_seabed));
            }
            false
        });
        exits
    }

    fn nearest_where(&self, point: DVec3, counts: impl Fn(DVec3) -> bool) -> (f64, DVec3, bool) {
        let mut best = (f64::INFINITY, DVec3::ZERO, false);
        for plane in &self.planes {
            let signed = (point - plane.point).dot(plane.normal);
            if signed.abs() < best.0 && counts(point - plane.normal * signed) {
                best = (signed.abs(), plane.normal, plane.material.is_seabed);
            }
        }
        self.tree.nearest(point, |index| {
            let part = &self.parts[index];
            let closest = part.shape.closest(point);
            let distance_m = closest.signed.abs();
            if !(distance_m < best.0) {
                return best.0.min(distance_m);
            }
            if !counts(closest.place) {
                return f64::INFINITY;
            }
            best = (distance_m, closest.normal, part.material.is_seabed);
            distance_m
        });
        best
    }

    /// Whether `place`, on a surface, lies strictly inside another solid.
    pub(crate) fn is_buried(&self, place: DVec3) -> bool {
        self.contains(place, BURIED_M)
    }

    /// Whether a vehicle can be at `point`: inside no solid, below no plane, under no seabed. A
    /// seabed of triangles holds no volume; whoever is under it sees its back straight above.
    pub(crate) fn is_open_water(&self, point: DVec3) -> bool {
        let overhead = self.cast(point, DVec3::Z, f64::MAX);
        let is_under = overhead.is_some_and(|hit| hit.is_seabed && hit.normal.z > 0.0);
        !is_under && !self.contains(point, 0.0)
    }

    /// Whether `point` lies inside a solid or below a plane, deeper than `margin_m`.
    pub(crate) fn contains(&self, point: DVec3, margin_m: f64) -> bool {
        let below = |plane: &Plane| (point - plane.point).dot(plane.normal) < -margin_m;
        self.planes.iter().any(below)
            || self.tree.any_around(point, |index| {
                self.parts[index].shape.contains(point, margin_m)
            })
    }
}

#[cfg(test)]
mod tests;
