//! Surface nets (Gibson 1998) over a field whose sign is known only from corner to corner.

use std::collections::HashMap;

use echosplat_model::glam::{IVec3, Vec3};

use crate::field::{Corner, Field};

/// Least cosine between the normals at the two ends of an edge: beyond 60° there is no common sign.
const LEAST_ALIKE: f32 = 0.5;

/// An edge that stands less than this cosine across the surface does not tell the two senses apart in
/// which it may be crossed.
const LEAST_ACROSS: f32 = 0.3;

/// One vertex in the middle of the crossings of its cell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct NetVertex {
    pub(crate) position_m: Vec3,
    pub(crate) sigma_m: f32,
}

/// Vertices and the quads between them.
#[derive(Debug, Default)]
pub(crate) struct Quads {
    pub(crate) vertices: Vec<NetVertex>,
    /// Counter-clockwise as seen from where the normal of their own edge points; which of its two
    /// signs that is, is left open.
    pub(crate) quads: Vec<[u32; 4]>,
}

/// Where the surface crosses an edge of the grid.
struct Crossing {
    /// From its first end, as share of its length.
    at: f32,
    /// Whether the normal points back to the first end.
    is_reverse: bool,
    sigma_m: f32,
}

impl Quads {
    /// Of all crossings of the field's edges.
    pub(crate) fn of(field: &Field) -> Self {
        let mut net = Net::default();
        for (corner, here) in field.corners() {
            for axis in 0..3 {
                let along = IVec3::AXES[axis];
                let Some(there) = field.at(corner + along) else {
                    continue;
                };
                if let Some(crossing) = crossing_of(here, there, along.as_vec3()) {
                    net.add(corner, axis, &crossing, field.cell_m);
                }
            }
        }
        net.finish()
    }
}

fn crossing_of(here: &Corner, there: &Corner, along: Vec3) -> Option<Crossing> {
    let alike = here.normal.dot(there.normal);
    if !(alike.abs() >= LEAST_ALIKE) {
        return None;
    }
    let sign = alike.signum();
    let (first_m, last_m) = (here.height_m, sign * there.height_m);
    // One of both zeros counts as above, so that a surface through a corner is crossed once.
    if (first_m < 0.0) == (last_m < 0.0) {
        return None;
    }
    let across = (here.normal + sign * there.normal)
        .normalize_or_zero()
        .dot(along);
    let is_rising = last_m > first_m;
    // Between two sheets the mean changes sides the other way.
    let is_between = across.abs() > LEAST_ACROSS && is_rising != (across > 0.0);
    if is_between {
        return None;
    }
    let at = (first_m / (first_m - last_m)).clamp(0.0, 1.0);
    Some(Crossing {
        at,
        is_reverse: !is_rising,
        sigma_m: here.sigma_m + at * (there.sigma_m - here.sigma_m),
    })
}

#[derive(Default)]
struct Net {
    numbers: HashMap<IVec3, u32>,
    sums: Vec<(NetVertex, f32)>,
    quads: Vec<[u32; 4]>,
}

impl Net {
    fn add(&mut self, corner: IVec3, axis: usize, crossing: &Crossing, cell_m: f32) {
        let along = IVec3::AXES[axis].as_vec3();
        let vertex = NetVertex {
            position_m: (corner.as_vec3() + crossing.at * along) * cell_m,
            sigma_m: crossing.sigma_m,
        };
        let (right, up) = (IVec3::AXES[(axis + 1) % 3], IVec3::AXES[(axis + 2) % 3]);
        // Counter-clockwise as seen from the edge's far end.
        let cells = [corner - right - up, corner - up, corner, corner - right];
        let mut quad = cells.map(|cell| self.add_to_cell(cell, vertex));
        if crossing.is_reverse {
            quad.reverse();
        }
        self.quads.push(quad);
    }

    fn add_to_cell(&mut self, cell: IVec3, vertex: NetVertex) -> u32 {
        let next = self.sums.len() as u32;
        let number = *self.numbers.entry(cell).or_insert(next);
        if number == next {
            self.sums.push((NetVertex::default(), 0.0));
        }
        let (sum, count) = &mut self.sums[number as usize];
        sum.position_m += vertex.position_m;
        sum.sigma_m += vertex.sigma_m;
        *count += 1.0;
        number
    }

    fn finish(self) -> Quads {
        let mean = |(sum, count): (NetVertex, f32)| NetVertex {
            position_m: sum.position_m / count,
            sigma_m: sum.sigma_m / count,
        };
        Quads {
            vertices: self.sums.into_iter().map(mean).collect(),
            quads: self.quads,
        }
    }
}
