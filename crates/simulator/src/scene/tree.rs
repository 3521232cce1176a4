//! The library's bounding volume hierarchy over exact shapes.
//!
//! Its boxes are f32 relative to the scene's middle and padded outward, so they only ever decide
//! what is worth an exact f64 test.

use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use obvhs::ray::{Ray, RayHit};

/// Corners of an axis-aligned box.
pub(crate) type Bounds = (DVec3, DVec3);

/// Covers the rounding of boxes, origins and directions to f32 at ranges up to a kilometre.
const PADDING_M: f64 = 1e-3;

pub(crate) struct Tree {
    middle_m: DVec3,
    bvh: Bvh2,
}

impl Tree {
    pub(crate) fn build(boxes: &[Bounds]) -> Self {
        let whole = union(boxes.iter().copied()).unwrap_or_default();
        let middle_m = 0.5 * (whole.0 + whole.1);
        let padded: Vec<Aabb> = boxes
            .iter()
            .map(|&(low, high)| {
                let low = (low - middle_m - PADDING_M).as_vec3a();
                let high = (high - middle_m + PADDING_M).as_vec3a();
                Aabb::new(low, high)
            })
            .collect();
        let indices = (0..padded.len() as u32).collect();
        let mut bvh = PlocBuilder::new().build(
            PlocSearchDistance::Medium,
            &padded,
            indices,
            SortPrecision::U64,
            3,
        );
        ReinsertionOptimizer::default().run(&mut bvh, 0.05, None);
        Self { middle_m, bvh }
    }

    /// Calls `test(item, nearest so far)` for items whose box the ray meets within `max_range_m`;
    /// `test` answers the exact distance if the item is hit nearer than that.
    pub(crate) fn cast(
        &self,
        origin: DVec3,
        direction: DVec3,
        max_range_m: f64,
        mut test: impl FnMut(usize, f64) -> Option<f64>,
    ) {
        if self.bvh.primitive_indices.is_empty() {
            return;
        }
        let mut nearest_m = max_range_m;
        let ray = Ray::new(
            (origin - self.middle_m).as_vec3a(),
            direction.as_vec3a(),
            0.0,
            round_up(max_range_m),
        );
        self.bvh
            .ray_traverse(ray, &mut RayHit::none(), |_, position| {
                let item = self.bvh.primitive_indices[position] as usize;
                let Some(distance_m) = test(item, nearest_m) else {
                    return f32::INFINITY;
                };
                nearest_m = distance_m;
                round_up(distance_m)
            });
    }

    /// Calls `visit(item)` for items that may lie nearer to `point` than the best distance so far;
    /// `visit` answers the exact distance.
    pub(crate) fn nearest(&self, point: DVec3, mut visit: impl FnMut(usize) -> f64) {
        if self.bvh.primitive_indices.is_empty() {
            return;
        }
        let local = (point - self.middle_m).as_vec3a();
        let bound = |index: u32| distance_to_box(local, &self.bvh.nodes[index as usize].aabb);
        let mut best_m = f64::INFINITY;
        let mut open = vec![(bound(0), 0u32)];
        while let Some((bound_m, index)) = open.pop() {
            if bound_m > best_m {
                continue;
            }
            let node = &self.bvh.nodes[index as usize];
            if node.is_leaf() {
                for position in node.first_index..node.first_index + node.prim_count {
                    let item = self.bvh.primitive_indices[position as usize] as usize;
                    best_m = best_m.min(visit(item));
                }
                continue;
            }
            let (left, right) = (node.first_index, node.first_index + 1);
            let (left_m, right_m) = (bound(left), bound(right));
            // The nearer child is looked into first, so it goes on top.
            if left_m < right_m {
                open.extend([(right_m, right), (left_m, left)]);
            } else {
                open.extend([(left_m, left), (right_m, right)]);
            }
        }
    }

    /// Whether `test` holds for any item whose box holds `point`.
    pub(crate) fn any_around(&self, point: DVec3, mut test: impl FnMut(usize) -> bool) -> bool {
        let mut found = false;
        let local = (point - self.middle_m).as_vec3a();
        if self.bvh.primitive_indices.is_empty() {
            return false;
        }
        self.bvh.point_traverse(local, |bvh, index| {
            let node = &bvh.nodes[index as usize];
            found = (node.first_index..node.first_index + node.prim_count)
                .any(|position| test(bvh.primitive_indices[position as usize] as usize));
            !found
        });
        found
    }
}

/// The box around all boxes.
pub(crate) fn union(boxes: impl Iterator<Item = Bounds>) -> Option<Bounds> {
    boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

fn round_up(distance_m: f64) -> f32 {
    (distance_m + PADDING_M) as f32
}

fn distance_to_box(point: Vec3A, aabb: &Aabb) -> f64 {
    let outside = (aabb.min - point).max(point - aabb.max).max(Vec3A::ZERO);
    f64::from(outside.length()) * (1.0 - 1e-6)
}
