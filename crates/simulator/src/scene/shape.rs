//! Exact geometry of each solid: first hit of a ray, nearest surface, bounds.

use glam::{DQuat, DVec3};

use super::ellipsoid::Ellipsoid;
use super::meeting::{Closest, Crossing};
use super::tree::Bounds;

/// A bounded surface in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Shape {
    Sphere {
        center: DVec3,
        radius: f64,
    },
    Capsule(Rod),
    Cylinder(Rod),
    Block {
        center: DVec3,
        half: DVec3,
        world_from_block: DQuat,
    },
    Ellipsoid(Ellipsoid),
    /// Both sides reflect; nothing is inside. `normal` is that of its winding.
    Triangle {
        corner: DVec3,
        edge_1: DVec3,
        edge_2: DVec3,
        normal: DVec3,
    },
}

/// The line from `from` along the unit vector `axis`, and all within `radius` of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rod {
    pub(crate) from: DVec3,
    pub(crate) axis: DVec3,
    pub(crate) length: f64,
    pub(crate) radius: f64,
}

impl Rod {
    /// `None` if the ends coincide.
    pub(crate) fn between(from: DVec3, to: DVec3, radius: f64) -> Option<Self> {
        let length = from.distance(to);
        (length > 1e-9).then(|| Self {
            from,
            axis: (to - from) / length,
            length,
            radius,
        })
    }

    pub(crate) fn to(&self) -> DVec3 {
        self.from + self.axis * self.length
    }

    /// Distances at which the endless tube is met.
    fn tube_crossings(&self, origin: DVec3, direction: DVec3) -> Option<[f64; 2]> {
        let offset = origin - self.from;
        let across_direction = direction - self.axis * direction.dot(self.axis);
        let across_offset = offset - self.axis * offset.dot(self.axis);
        let a = across_direction.length_squared();
        if !(a > 1e-18) {
            return None;
        }
        // Measured from the foot of the perpendicular: no cancellation far from the rod.
        let foot = -across_offset.dot(across_direction) / a;
        let miss = across_offset + across_direction * foot;
        let rest = self.radius * self.radius - miss.length_squared();
        (rest >= 0.0).then(|| {
            let half = (rest / a).sqrt();
            [foot - half, foot + half]
        })
    }

    fn side_crossings(
        &self,
        origin: DVec3,
        direction: DVec3,
    ) -> impl Iterator<Item = Crossing> + use<> {
        let rod = *self;
        let distances = self.tube_crossings(origin, direction);
        distances.into_iter().flatten().filter_map(move |distance| {
            let from_end = origin + direction * distance - rod.from;
            let along = from_end.dot(rod.axis);
            (along >= 0.0 && along <= rod.length).then(|| Crossing {
                distance,
                normal: (from_end - rod.axis * along) / rod.radius,
            })
        })
    }
}

fn sphere_crossings(
    center: DVec3,
    radius: f64,
    origin: DVec3,
    direction: DVec3,
) -> impl Iterator<Item = Crossing> {
    let offset = center - origin;
    let foot = offset.dot(direction);
    let miss = offset - direction * foot;
    let rest = radius * radius - miss.length_squared();
    let half = if rest >= 0.0 { rest.sqrt() } else { f64::NAN };
    [foot - half, foot + half]
        .into_iter()
        .filter(|distance| distance.is_finite())
        .map(move |distance| Crossing {
            distance,
            normal: (direction * distance - offset) / radius,
        })
}

/// The nearest crossing ahead.
fn first(crossings: impl Iterator<Item = Crossing>, max: f64) -> Option<Crossing> {
    crossings
        .filter(|crossing| crossing.distance >= 0.0 && crossing.distance <= max)
        .min_by(|a, b| a.distance.total_cmp(&b.distance))
}

impl Shape {
    /// First place at or ahead of `origin` along the unit vector `direction`, at most `max` away.
    pub(crate) fn cast(&self, origin: DVec3, direction: DVec3, max: f64) -> Option<Crossing> {
        match *self {
            Self::Sphere { center, radius } => {
                first(sphere_crossings(center, radius, origin, direction), max)
            }
            Self::Capsule(rod) => {
                let end = |center: DVec3, outward: DVec3| {
                    sphere_crossings(center, rod.radius, origin, direction)
                        .filter(move |crossing| crossing.normal.dot(outward) >= 0.0)
                };
                let ends = end(rod.from, -rod.axis).chain(end(rod.to(), rod.axis));
                first(rod.side_crossings(origin, direction).chain(ends), max)
            }
            Self::Cylinder(rod) => {
                let lid = |center: DVec3, outward: DVec3| {
                    let distance = (center - origin).dot(outward) / direction.dot(outward);
                    let place = origin + direction * distance;
                    let inside = place.distance_squared(center) <= rod.radius * rod.radius;
                    inside.then_some(Crossing {
                        distance,
                        normal: outward,
                    })
                };
                let lids = [lid(rod.from, -rod.axis), lid(rod.to(), rod.axis)];
                let sides = rod.side_crossings(origin, direction);
                first(sides.chain(lids.into_iter().flatten()), max)
            }
            Self::Block {
                center,
                half,
                world_from_block,
            } => {
                let block_from_world = world_from_block.conjugate();
                let crossing = cast_block(
                    block_from_world * (origin - center),
                    block_from_world * direction,
                    half,
                )?;
                let within = crossing.distance >= 0.0 && crossing.distance <= max;
                within.then(|| Crossing {
                    normal: world_from_block * crossing.normal,
                    ..crossing
                })
            }
            Self::Ellipsoid(solid) => first(solid.crossings(origin, direction), max),
            Self::Triangle {
                corner,
                edge_1,
                edge_2,
                normal,
            } => {
                let distance = cast_triangle(corner, edge_1, edge_2, origin, direction)?;
                let within = distance >= 0.0 && distance <= max;
                within.then_some(Crossing { distance, normal })
            }
        }
    }

    /// The place of the surface nearest to `point`.
    pub(crate) fn closest(&self, point: DVec3) -> Closest {
        match *self {
            Self::Sphere { center, radius } => closest_on_ball(point, center, radius, DVec3::Z),
            Self::Capsule(rod) => {
                let along = (point - rod.from).dot(rod.axis).clamp(0.0, rod.length);
                let center = rod.from + rod.axis * along;
                closest_on_ball(point, center, rod.radius, rod.axis.any_orthonormal_vector())
            }
            Self::Cylinder(rod) => closest_on_cylinder(point, &rod),
            Self::Block {
                center,
                half,
                world_from_block,
            } => {
                let local = world_from_block.conjugate() * (point - center);
                let found = closest_on_block(local, half);
                Closest {
                    signed: found.signed,
                    place: center + world_from_block * found.place,
                    normal: world_from_block * found.normal,
                }
            }
            Self::Ellipsoid(solid) => solid.closest(point),
            Self::Triangle {
                corner,
                edge_1,
                edge_2,
                normal,
            } => {
                let place = closest_on_triangle(point, corner, edge_1, edge_2);
                Closest {
                    signed: point.distance(place),
                    place,
                    normal,
                }
            }
        }
    }

    /// Whether `point` lies in it deeper than `margin`.
    pub(crate) fn contains(&self, point: DVec3, margin: f64) -> bool {
        let is_solid = !matches!(self, Self::Triangle { .. });
        is_solid && self.closest(point).signed < -margin
    }

    pub(crate) fn bounds(&self) -> Bounds {
        match *self {
            Self::Sphere { center, radius } => (center - radius, center + radius),
            Self::Capsule(rod) => {
                let (low, high) = (rod.from.min(rod.to()), rod.from.max(rod.to()));
                (low - rod.radius, high + rod.radius)
            }
            Self::Cylinder(rod) => {
                let (low, high) = (rod.from.min(rod.to()), rod.from.max(rod.to()));
                let across = (DVec3::ONE - rod.axis * rod.axis).max(DVec3::ZERO);
                let reach = rod.radius * across.powf(0.5);
                (low - reach, high + reach)
            }
            Self::Block {
                center,
                half,
                world_from_block,
            } => {
                let axis = |unit: DVec3| (world_from_block * unit).abs();
                let reach =
                    axis(DVec3::X) * half.x + axis(DVec3::Y) * half.y + axis(DVec3::Z) * half.z;
                (center - reach, center + reach)
            }
            Self::Ellipsoid(solid) => solid.bounds(),
            Self::Triangle {
                corner,
                edge_1,
                edge_2,
                ..
            } => {
                let (b, c) = (corner + edge_1, corner + edge_2);
                (corner.min(b).min(c), corner.max(b).max(c))
            }
        }
    }

    /// How far from a place of the surface its tangent plane can still be it: a ray's footprint
    /// reaches no further.
    pub(crate) fn flat_reach(&self) -> f64 {
        match *self {
            Self::Sphere { radius, .. } => radius,
            Self::Capsule(rod) | Self::Cylinder(rod) => rod.radius,
            Self::Block { half, .. } => half.max_element(),
            Self::Ellipsoid(solid) => solid.semi_axes.min_element(),
            Self::Triangle { edge_1, edge_2, .. } => edge_1.length().max(edge_2.length()),
        }
    }

    pub(crate) fn area(&self) -> f64 {
        use std::f64::consts::{PI, TAU};
        match *self {
            Self::Sphere { radius, .. } => 4.0 * PI * radius * radius,
            Self::Capsule(rod) => TAU * rod.radius * (rod.length + 2.0 * rod.radius),
            Self::Cylinder(rod) => TAU * rod.radius * (rod.length + rod.radius),
            Self::Block { half, .. } => 8.0 * (half.x * half.y + half.y * half.z + half.z * half.x),
            Self::Ellipsoid(solid) => solid.area(),
            Self::Triangle { edge_1, edge_2, .. } => 0.5 * edge_1.cross(edge_2).length(),
        }
    }
}

fn closest_on_ball(point: DVec3, center: DVec3, radius: f64, fallback: DVec3) -> Closest {
    let normal = (point - center).try_normalize().unwrap_or(fallback);
    Closest {
        signed: point.distance(center) - radius,
        place: center + normal * radius,
        normal,
    }
}

fn closest_on_cylinder(point: DVec3, rod: &Rod) -> Closest {
    let offset = point - rod.from;
    let along = offset.dot(rod.axis);
    let across = offset - rod.axis * along;
    let outward = across
        .try_normalize()
        .unwrap_or_else(|| rod.axis.any_orthonormal_vector());
    let from_side = across.length() - rod.radius;
    let (from_lid, lid_normal) = if along > 0.5 * rod.length {
        (along - rod.length, rod.axis)
    } else {
        (-along, -rod.axis)
    };
    if from_side <= 0.0 && from_lid <= 0.0 {
        let (signed, normal) = if from_side > from_lid {
            (from_side, outward)
        } else {
            (from_lid, lid_normal)
        };
        return Closest {
            signed,
            place: point - normal * signed,
            normal,
        };
    }
    let place = rod.from
        + rod.axis * along.clamp(0.0, rod.length)
        + outward * across.length().min(rod.radius);
    closest_outside(point, place)
}

/// Outside of a convex solid the normal is the way from the nearest place.
fn closest_outside(point: DVec3, place: DVec3) -> Closest {
    let away = point - place;
    Closest {
        signed: away.length(),
        place,
        normal: away.normalize_or_zero(),
    }
}

fn closest_on_block(point: DVec3, half: DVec3) -> Closest {
    let beyond = point.abs() - half;
    if beyond.max_element() > 0.0 {
        return closest_outside(point, point.clamp(-half, half));
    }
    let axis = beyond.max_position();
    let mut normal = DVec3::ZERO;
    normal[axis] = if point[axis] < 0.0 { -1.0 } else { 1.0 };
    Closest {
        signed: beyond[axis],
        place: point - normal * beyond[axis],
        normal,
    }
}

fn cast_block(origin: DVec3, direction: DVec3, half: DVec3) -> Option<Crossing> {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    let (mut enter_axis, mut leave_axis) = (0, 0);
    for axis in 0..3 {
        if !(direction[axis].abs() > 1e-15) {
            if !(origin[axis].abs() <= half[axis]) {
                return None;
            }
            continue;
        }
        let a = (-half[axis] - origin[axis]) / direction[axis];
        let b = (half[axis] - origin[axis]) / direction[axis];
        if a.min(b) > enter {
            (enter, enter_axis) = (a.min(b), axis);
        }
        if a.max(b) < leave {
            (leave, leave_axis) = (a.max(b), axis);
        }
    }
    if !(enter <= leave) {
        return None;
    }
    let mut normal = DVec3::ZERO;
    let outside = enter >= 0.0;
    let axis = if outside { enter_axis } else { leave_axis };
    let heading = direction[axis].signum();
    normal[axis] = if outside { -heading } else { heading };
    Some(Crossing {
        distance: if outside { enter } else { leave },
        normal,
    })
}

/// Möller and Trumbore, both sides.
fn cast_triangle(
    corner: DVec3,
    edge_1: DVec3,
    edge_2: DVec3,
    origin: DVec3,
    direction: DVec3,
) -> Option<f64> {
    let p = direction.cross(edge_2);
    let determinant = edge_1.dot(p);
    let inverse = 1.0 / determinant;
    let offset = origin - corner;
    let u = offset.dot(p) * inverse;
    let q = offset.cross(edge_1);
    let v = direction.dot(q) * inverse;
    // A ray in the triangle's plane makes these NaN or infinite, which fails the test.
    let inside = u >= -1e-12 && v >= -1e-12 && u + v <= 1.0 + 1e-12;
    inside.then(|| edge_2.dot(q) * inverse)
}

/// By the regions of Ericson, Real-Time Collision Detection, 5.1.5.
fn closest_on_triangle(point: DVec3, corner: DVec3, edge_1: DVec3, edge_2: DVec3) -> DVec3 {
    let to_a = point - corner;
    let (d1, d2) = (edge_1.dot(to_a), edge_2.dot(to_a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return corner;
    }
    let to_b = to_a - edge_1;
    let (d3, d4) = (edge_1.dot(to_b), edge_2.dot(to_b));
    if d3 >= 0.0 && d4 <= d3 {
        return corner + edge_1;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return corner + edge_1 * (d1 / (d1 - d3));
    }
    let to_c = to_a - edge_2;
    let (d5, d6) = (edge_1.dot(to_c), edge_2.dot(to_c));
    if d6 >= 0.0 && d5 <= d6 {
        return corner + edge_2;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return corner + edge_2 * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return corner + edge_1 + (edge_2 - edge_1) * w;
    }
    let scale = 1.0 / (va + vb + vc);
    corner + edge_1 * (vb * scale) + edge_2 * (vc * scale)
}
