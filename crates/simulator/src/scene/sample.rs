//! Points spread evenly over a scene's surface.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec3};

use super::shape::{Rod, Shape};
use super::tree::Bounds;
use super::{Plane, Scene};
use crate::random::{Purpose, Random};

/// Planes have no end: they are sampled this far around everything bounded.
const PLANE_MARGIN_M: f64 = 5.0;
/// Bounds memory by the question, not by the answer.
const MAX_SAMPLE_COUNT: f64 = 2e7;

/// A place on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// In the world, metres.
    pub position: DVec3,
    /// Unit, outward.
    pub normal: DVec3,
    /// Whether the surface is seabed.
    pub is_seabed: bool,
}

impl Scene {
    /// A point per `spacing_m`² of bare surface, jittered within its cell; the same for the same
    /// seed. Endless planes are sampled to 5 m around the bounded solids; what is buried in
    /// another solid is left out. A spacing that would give over twenty million points is widened.
    #[must_use]
    pub fn sample_surface(&self, spacing_m: f64, seed: u64) -> Vec<SurfacePoint> {
        let around = self.whole_bounds().unwrap_or((DVec3::ZERO, DVec3::ZERO));
        let area = (around.0 - PLANE_MARGIN_M, around.1 + PLANE_MARGIN_M);
        let mut points = self.sample_structure(spacing_m, seed);
        points.extend(self.sample_seabed(spacing_m, seed, area));
        points
    }

    /// What [`Self::sample_surface`] gives for all that is not seabed.
    pub(crate) fn sample_structure(&self, spacing_m: f64, seed: u64) -> Vec<SurfacePoint> {
        self.sample_parts(spacing_m, seed, false)
    }

    /// The same for the seabed inside a box.
    pub(crate) fn sample_seabed(
        &self,
        spacing_m: f64,
        seed: u64,
        (low, high): Bounds,
    ) -> Vec<SurfacePoint> {
        let mut points = self.sample_parts(spacing_m, seed, true);
        points.retain(|point| point.position.cmpge(low).all() && point.position.cmple(high).all());
        for (index, plane) in self.planes.iter().enumerate() {
            let mut random = Random::new(seed, Purpose::Surface, u64::MAX - index as u64);
            points.extend(sample_plane(plane, spacing_m, (low, high), &mut random));
        }
        points.retain(|point| !self.is_buried(point.position));
        points
    }

    fn sample_parts(&self, spacing_m: f64, seed: u64, is_seabed: bool) -> Vec<SurfacePoint> {
        let total_m2: f64 = self.parts.iter().map(|part| part.shape.area()).sum();
        let spacing_m = spacing_m
            .max((total_m2 / MAX_SAMPLE_COUNT).sqrt())
            .max(1e-4);
        let mut points = Vec::new();
        for (index, part) in self.parts.iter().enumerate() {
            if part.material.is_seabed != is_seabed {
                continue;
            }
            let mut random = Random::new(seed, Purpose::Surface, index as u64);
            sample_shape(&part.shape, spacing_m, &mut random, |position, normal| {
                if !self.is_buried(position) {
                    points.push(SurfacePoint {
                        position,
                        normal,
                        is_seabed,
                    });
                }
            });
        }
        points
    }
}

/// One jittered pair in [0, 1)² per cell of a grid whose cells are about `spacing` wide.
fn grid(size: [f64; 2], spacing: f64, random: &mut Random, mut place: impl FnMut(f64, f64)) {
    let [columns, rows] = size.map(|length| (length / spacing).round().max(1.0) as usize);
    for row in 0..rows {
        for column in 0..columns {
            let u = (column as f64 + random.unit()) / columns as f64;
            let v = (row as f64 + random.unit()) / rows as f64;
            place(u, v);
        }
    }
}

fn sample_shape(
    shape: &Shape,
    spacing: f64,
    random: &mut Random,
    mut emit: impl FnMut(DVec3, DVec3),
) {
    match *shape {
        Shape::Sphere { center, radius } => {
            sample_ball(radius, spacing, random, |normal| {
                emit(center + normal * radius, normal);
            });
        }
        Shape::Capsule(rod) => {
            sample_tube(&rod, spacing, random, &mut emit);
            sample_ball(rod.radius, spacing, random, |normal| {
                let is_far = normal.dot(rod.axis) >= 0.0;
                let center = if is_far { rod.to() } else { rod.from };
                emit(center + normal * rod.radius, normal);
            });
        }
        Shape::Cylinder(rod) => {
            sample_tube(&rod, spacing, random, &mut emit);
            for (center, normal) in [(rod.from, -rod.axis), (rod.to(), rod.axis)] {
                sample_disc(center, normal, rod.radius, spacing, random, &mut emit);
            }
        }
        Shape::Block {
            center,
            half,
            world_from_block,
        } => sample_block(half, spacing, random, |place, normal| {
            emit(center + world_from_block * place, world_from_block * normal);
        }),
        Shape::Ellipsoid(solid) => {
            // Uniform on the unit sphere, thinned by how much of the surface each place stands for.
            let mut on_sphere = Vec::new();
            sample_ball(solid.sampling_radius(), spacing, random, |unit| {
                on_sphere.push(unit);
            });
            for unit in on_sphere {
                if random.unit() < solid.sampling_share(unit) {
                    let (place, normal) = solid.at(unit);
                    emit(place, normal);
                }
            }
        }
        Shape::Triangle {
            corner,
            edge_1,
            edge_2,
            normal,
        } => {
            // Small triangles get a point with the chance that keeps the density.
            let expected = shape.area() / (spacing * spacing);
            for _ in 0..(expected + random.unit()) as usize {
                let (mut u, mut v) = (random.unit(), random.unit());
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                emit(corner + edge_1 * u + edge_2 * v, normal);
            }
        }
    }
}

fn sample_tube(rod: &Rod, spacing: f64, random: &mut Random, emit: &mut impl FnMut(DVec3, DVec3)) {
    let (side, other) = rod.axis.any_orthonormal_pair();
    let size = [TAU * rod.radius, rod.length];
    grid(size, spacing, random, |u, v| {
        let (sin, cos) = (TAU * u).sin_cos();
        let normal = side * cos + other * sin;
        emit(
            rod.from + rod.axis * (v * rod.length) + normal * rod.radius,
            normal,
        );
    });
}

/// Bands of equal width from pole to pole, each with points by its area; uniform in height within
/// a band is uniform in area (Archimedes).
fn sample_ball(radius: f64, spacing: f64, random: &mut Random, mut emit: impl FnMut(DVec3)) {
    let height = |share: f64| (PI * share).cos();
    bands(PI * radius, spacing, |from, to| {
        let (top, bottom) = (height(from), height(to));
        let area = TAU * radius * radius * (top - bottom);
        ring(area, spacing, random, |turn, share| {
            let z = top + (bottom - top) * share;
            let across = (1.0 - z * z).max(0.0).sqrt();
            let (sin, cos) = (TAU * turn).sin_cos();
            emit(DVec3::new(across * cos, across * sin, z));
        });
    });
}

/// Rings of equal width, uniform in area within each.
fn sample_disc(
    center: DVec3,
    normal: DVec3,
    radius: f64,
    spacing: f64,
    random: &mut Random,
    emit: &mut impl FnMut(DVec3, DVec3),
) {
    let (side, other) = normal.any_orthonormal_pair();
    bands(radius, spacing, |from, to| {
        let (inner, outer) = (from * from, to * to);
        let area = PI * radius * radius * (outer - inner);
        ring(area, spacing, random, |turn, share| {
            let from_center = radius * (inner + (outer - inner) * share).sqrt();
            let (sin, cos) = (TAU * turn).sin_cos();
            emit(center + (side * cos + other * sin) * from_center, normal);
        });
    });
}

/// Cuts 0 to 1, `length` long, into bands about `spacing` wide.
fn bands(length: f64, spacing: f64, mut band: impl FnMut(f64, f64)) {
    let count = (length / spacing).round().max(1.0) as u32;
    for index in 0..count {
        let edge = |index: u32| f64::from(index) / f64::from(count);
        band(edge(index), edge(index + 1));
    }
}

/// A point per `spacing`² of a ring's area: its share of a turn, jittered, and its place across.
fn ring(area: f64, spacing: f64, random: &mut Random, mut place: impl FnMut(f64, f64)) {
    let count = (area / (spacing * spacing)).round().max(1.0) as u32;
    for index in 0..count {
        let turn = (f64::from(index) + random.unit()) / f64::from(count);
        place(turn, random.unit());
    }
}

fn sample_block(
    half: DVec3,
    spacing: f64,
    random: &mut Random,
    mut emit: impl FnMut(DVec3, DVec3),
) {
    for axis in 0..3 {
        let (first, second) = ((axis + 1) % 3, (axis + 2) % 3);
        for sign in [-1.0, 1.0] {
            let mut normal = DVec3::ZERO;
            normal[axis] = sign;
            let size = [2.0 * half[first], 2.0 * half[second]];
            grid(size, spacing, random, |u, v| {
                let mut place = normal * half[axis];
                place[first] = (2.0 * u - 1.0) * half[first];
                place[second] = (2.0 * v - 1.0) * half[second];
                emit(place, normal);
            });
        }
    }
}

/// The plane's places inside the box, looked for in the square around the box's middle.
fn sample_plane(
    plane: &Plane,
    spacing_m: f64,
    (low, high): Bounds,
    random: &mut Random,
) -> Vec<SurfacePoint> {
    let mut points = Vec::new();
    let middle = 0.5 * (low + high);
    let reach = 0.5 * low.distance(high);
    let spacing_m = spacing_m
        .max(2.0 * reach / MAX_SAMPLE_COUNT.sqrt())
        .max(1e-4);
    let foot = middle - plane.normal * (middle - plane.point).dot(plane.normal);
    let turn = DQuat::from_rotation_arc(DVec3::Z, plane.normal);
    let is_flat = plane.normal.z.abs() > 0.999;
    grid([2.0 * reach; 2], spacing_m, random, |u, v| {
        let local = DVec3::new(2.0 * u - 1.0, 2.0 * v - 1.0, 0.0) * reach;
        let position = foot + turn * local;
        let beyond = position.cmplt(low) | position.cmpgt(high);
        // A floor counts below the box as well: only its outline matters there.
        let is_outside = beyond.x || beyond.y || (beyond.z && !is_flat);
        if !is_outside {
            points.push(SurfacePoint {
                position,
                normal: plane.normal,
                is_seabed: plane.material.is_seabed,
            });
        }
    });
    points
}
