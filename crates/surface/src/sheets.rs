//! Quads to sheets of triangles that turn the same way.

use std::collections::{BinaryHeap, HashMap};

use echosplat_model::glam::Vec3;

use crate::nets::{NetVertex, Quads};
use crate::points::UNKNOWN_SIGMA_M;
use crate::{Surface, Vertex};

/// Smaller sheets are left out, in faces of a cell: a few hundredths of a square metre with the usual
/// cells. Those of the pier's survey lie 0.15 m off in the mean, all others 0.02 m.
const LEAST_SHEET: f32 = 25.0;

/// A sheet whose normals point away from its middle by more than this share, of what those of a ball
/// would, bulges.
const BULGES: f32 = 0.05;

/// From this much of [`UNKNOWN_SIGMA_M`] on nothing is known.
const UNKNOWN_SHARE: f32 = 1e-3;

type Quad = [u32; 4];

/// What is left of the sheets that are large enough.
pub(crate) fn surface_of(quads: Quads, cell_m: f32) -> Surface {
    let Quads {
        vertices,
        mut quads,
    } = quads;
    let mut sheet_of = turn_alike(&mut quads, &vertices);
    let sheet_count = sheet_of.iter().max().map_or(0, |last| last + 1);
    let mut sheets = vec![Sheet::default(); sheet_count];
    for (quad, &sheet) in quads.iter().zip(&sheet_of) {
        sheets[sheet].add(quad, &vertices);
    }
    for (quad, &sheet) in quads.iter().zip(&sheet_of) {
        sheets[sheet].add_outward(quad, &vertices);
    }
    for (quad, sheet) in quads.iter_mut().zip(&mut sheet_of) {
        if sheets[*sheet].is_inside_out() {
            quad.reverse();
        }
    }
    let least_m2 = LEAST_SHEET * cell_m * cell_m;
    let kept = quads.iter().zip(&sheet_of);
    let kept = kept.filter(|(_, sheet)| sheets[**sheet].area_m2 >= least_m2);
    triangulated(kept.map(|(quad, _)| *quad), &vertices)
}

/// Turns quads so that neighbours turn the same way, and numbers the sheets they make. Edges with more
/// than two quads join none. From each quad it goes on to the neighbour that lies flattest to what it
/// has: where a twisted fin joins both sides of a sheet, the two meet in the fin and not across the
/// sheet (Hoppe et al. 1992).
fn turn_alike(quads: &mut [Quad], vertices: &[NetVertex]) -> Vec<usize> {
    let neighbours = Neighbours::of(quads);
    let normals: Vec<Vec3> = quads
        .iter()
        .map(|quad| face(quad, vertices).1.normalize_or_zero())
        .collect();
    let mut sheet_of = vec![usize::MAX; quads.len()];
    let mut sheet_count = 0;
    let mut waiting = BinaryHeap::new();
    for first in 0..quads.len() {
        let mut next = Some((first, None));
        while let Some((at, edge)) = next {
            if sheet_of[at] == usize::MAX {
                sheet_of[at] = sheet_count;
                // Two that turn alike run along their edge in opposite directions.
                if edge.is_some_and(|edge| edges(quads[at]).contains(&edge)) {
                    quads[at].reverse();
                }
                for edge in edges(quads[at]) {
                    if let Some(other) = neighbours.across(edge, at) {
                        let flatness = normals[at].dot(normals[other]).abs();
                        waiting.push((to_order(flatness), other, edge));
                    }
                }
            }
            next = waiting.pop().map(|(_, other, edge)| (other, Some(edge)));
        }
        if sheet_of[first] == sheet_count {
            sheet_count += 1;
        }
    }
    sheet_of
}

/// A share as a number that can be put in order.
fn to_order(share: f32) -> u32 {
    (share * 1e6) as u32
}

fn edges(quad: Quad) -> [(u32, u32); 4] {
    let [a, b, c, d] = quad;
    [(a, b), (b, c), (c, d), (d, a)]
}

/// The one or two quads of each edge; edges with more are left out.
struct Neighbours(HashMap<(u32, u32), [usize; 2]>);

impl Neighbours {
    const NONE: usize = usize::MAX;

    fn of(quads: &[Quad]) -> Self {
        let mut counted: HashMap<(u32, u32), ([usize; 2], u8)> = HashMap::new();
        for (number, quad) in quads.iter().enumerate() {
            for edge in edges(*quad) {
                let (both, count) = counted
                    .entry(unordered(edge))
                    .or_insert(([Self::NONE; 2], 0));
                if let Some(slot) = both.get_mut(usize::from(*count)) {
                    *slot = number;
                }
                *count = count.saturating_add(1);
            }
        }
        let simple = counted.into_iter().filter(|(_, (_, count))| *count <= 2);
        Self(simple.map(|(edge, (both, _))| (edge, both)).collect())
    }

    fn across(&self, edge: (u32, u32), from: usize) -> Option<usize> {
        let [one, other] = *self.0.get(&unordered(edge))?;
        let across = if one == from { other } else { one };
        (across != Self::NONE).then_some(across)
    }
}

fn unordered((a, b): (u32, u32)) -> (u32, u32) {
    (a.min(b), a.max(b))
}

/// What decides which side of a sheet is its front.
#[derive(Debug, Clone, Copy, Default)]
struct Sheet {
    area_m2: f32,
    /// Sum of centres by area, m³.
    centers_m3: Vec3,
    /// Sum of areas along their normals, m².
    facing_m2: Vec3,
    /// Three times the volume between the sheet and its middle, m³.
    outward_m3: f32,
}

impl Sheet {
    fn add(&mut self, quad: &Quad, vertices: &[NetVertex]) {
        let (center_m, facing_m2) = face(quad, vertices);
        self.area_m2 += facing_m2.length();
        self.centers_m3 += center_m * facing_m2.length();
        self.facing_m2 += facing_m2;
    }

    fn add_outward(&mut self, quad: &Quad, vertices: &[NetVertex]) {
        let (center_m, facing_m2) = face(quad, vertices);
        let middle_m = self.centers_m3 / self.area_m2.max(f32::MIN_POSITIVE);
        self.outward_m3 += facing_m2.dot(center_m - middle_m);
    }

    fn is_inside_out(&self) -> bool {
        // A ball of this area has area · radius, with 4 π radius² = area.
        let ball_m3 = self.area_m2 * (self.area_m2 / (4.0 * std::f32::consts::PI)).sqrt();
        if self.outward_m3.abs() > BULGES * ball_m3 {
            return self.outward_m3 < 0.0;
        }
        // Up, then east, then north: a rule for every sheet, the same one each time.
        let [east, north, up] = self.facing_m2.to_array();
        let steep = 1e-3 * self.area_m2;
        let decisive = [up, north, east]
            .into_iter()
            .find(|along| along.abs() > steep);
        decisive.is_some_and(|along| along < 0.0)
    }
}

/// Centre, and area along the normal: half the cross product of the diagonals.
fn face(quad: &Quad, vertices: &[NetVertex]) -> (Vec3, Vec3) {
    let [a, b, c, d] = quad.map(|number| vertices[number as usize].position_m);
    let center_m = 0.25 * (a + b + c + d);
    (center_m, 0.5 * (c - a).cross(d - b))
}

/// Two triangles a quad, cut along its shorter diagonal; vertices numbered anew as they are used.
fn triangulated(quads: impl Iterator<Item = Quad>, vertices: &[NetVertex]) -> Surface {
    let mut surface = Surface::default();
    let mut numbers = vec![u32::MAX; vertices.len()];
    for quad in quads {
        let facing_m2 = face(&quad, vertices).1;
        let [a, b, c, d] = quad.map(|old| {
            let number = &mut numbers[old as usize];
            if *number == u32::MAX {
                *number = surface.vertices.len() as u32;
                surface.vertices.push(vertex_of(&vertices[old as usize]));
            }
            surface.vertices[*number as usize].normal += facing_m2;
            *number
        });
        let place = |number: u32| surface.vertices[number as usize].position_m;
        let is_ac_shorter = place(a).distance(place(c)) <= place(b).distance(place(d));
        surface.triangles.extend(if is_ac_shorter {
            [[a, b, c], [a, c, d]]
        } else {
            [[a, b, d], [b, c, d]]
        });
    }
    for vertex in &mut surface.vertices {
        vertex.normal = vertex.normal.try_normalize().unwrap_or(Vec3::Z);
    }
    surface
}

fn vertex_of(vertex: &NetVertex) -> Vertex {
    let is_unknown = vertex.sigma_m > UNKNOWN_SHARE * UNKNOWN_SIGMA_M;
    Vertex {
        position_m: vertex.position_m,
        normal: Vec3::ZERO,
        sigma_m: if is_unknown {
            f32::INFINITY
        } else {
            vertex.sigma_m
        },
    }
}
