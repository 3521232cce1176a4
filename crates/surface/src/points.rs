//! Gaussians as points, each with the width of its weight.

use std::collections::HashMap;
use std::ops::Range;

use echosplat_model::Gaussian;
use echosplat_model::glam::{IVec3, Vec3};

use crate::SurfaceError;

/// Gaussians nearer to each other than this share of a cell's edge are taken for one, so that no
/// place can hold more of them than the grid tells apart.
const MERGED_WITHIN: f32 = 0.25;

/// So many neighbours within a radius say how densely a place is covered.
const NEIGHBOURS: usize = 8;

/// Radii in which neighbours are looked for, in cells; who has too few within the last is alone.
const RADII: [f32; 7] = [1.0, 1.5, 2.5, 4.0, 6.5, 10.0, 17.0];

/// Width of a weight, in radii that hold the neighbours, and its limits in cells.
const WIDTH: f32 = 0.6;
const WIDTH_LIMITS: (f32, f32) = (1.0, 9.0);

/// Most of a width, in scales of the Gaussian: √12, the edge of the even square that scatters so far. On an even
/// sheet of such squares the width is 1.0 edges. Where neighbours are further off than that, they are none:
/// single Gaussians far from all others would else span what lies between.
const MOST_SCALES: f32 = 3.464;

/// Least probability that there is surface within 0.10 m of a Gaussian: a face says that it is there.
const LEAST_PROBABILITY: f32 = 0.5;

/// Stands for an infinite sigma in sums.
pub(crate) const UNKNOWN_SIGMA_M: f32 = 1e6;

/// One or several Gaussians in one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    pub(crate) position_m: Vec3,
    pub(crate) sigma_m: f32,
    /// One sigma of the weight it has at places around.
    pub(crate) width_m: f32,
}

/// The points of these Gaussians that have neighbours, in an order that depends on their places only.
///
/// # Errors
/// If one is not sound.
pub(crate) fn points_of<'a>(
    gaussians: impl Iterator<Item = &'a Gaussian>,
    cell_m: f32,
) -> Result<Vec<Point>, SurfaceError> {
    let mut places = Vec::new();
    for gaussian in gaussians {
        let place = checked(gaussian)?;
        if gaussian.probability >= LEAST_PROBABILITY {
            places.push(place);
        }
    }
    let merged = merged(places, MERGED_WITHIN * cell_m);
    let grid = Grid::of(&merged, 3.0 * cell_m);
    let mut points = Vec::with_capacity(merged.len());
    for place in &grid.places {
        if let Some(radius_m) = grid.radius_of_neighbours(place.position_m, cell_m) {
            let (least, most) = WIDTH_LIMITS;
            let width_m = (WIDTH * radius_m).min(MOST_SCALES * place.scale_m);
            points.push(Point {
                position_m: place.position_m,
                sigma_m: place.sigma_m,
                width_m: width_m.clamp(least * cell_m, most * cell_m),
            });
        }
    }
    Ok(points)
}

/// What counts of a Gaussian.
#[derive(Debug, Clone, Copy)]
struct Place {
    position_m: Vec3,
    sigma_m: f32,
    /// The largest of its three.
    scale_m: f32,
}

fn checked(gaussian: &Gaussian) -> Result<Place, SurfaceError> {
    let id = gaussian.id;
    gaussian
        .check()
        .map_err(|why| SurfaceError::Unsound { id, why })?;
    Ok(Place {
        position_m: gaussian.mean_m,
        sigma_m: gaussian.sigma_m.min(UNKNOWN_SIGMA_M),
        scale_m: gaussian.scale_m.max_element(),
    })
}

/// The cell of a grid that holds a place.
pub(crate) fn cell_of(place_m: Vec3, edge_m: f32) -> IVec3 {
    (place_m / edge_m).floor().as_ivec3()
}

/// Those in one cell of `edge_m` as their mean.
fn merged(mut places: Vec<Place>, edge_m: f32) -> Vec<Place> {
    let key = |place: &Place| cell_of(place.position_m, edge_m).to_array();
    let bits = |place: &Place| {
        let numbers = [place.sigma_m, place.scale_m].map(f32::to_bits);
        (place.position_m.to_array().map(f32::to_bits), numbers)
    };
    places.sort_by_cached_key(|place| (key(place), bits(place)));
    let groups = places.chunk_by(|a, b| key(a) == key(b));
    groups.map(mean_of).collect()
}

/// Offsets from the first are summed: places far from the origin keep their digits.
fn mean_of(group: &[Place]) -> Place {
    let first = group[0].position_m;
    let share = 1.0 / group.len() as f32;
    let offset_m: Vec3 = group.iter().map(|place| place.position_m - first).sum();
    let sigma_m: f32 = group.iter().map(|place| place.sigma_m).sum();
    let scale_m: f32 = group.iter().map(|place| place.scale_m).sum();
    Place {
        position_m: first + offset_m * share,
        sigma_m: sigma_m * share,
        scale_m: scale_m * share,
    }
}

/// Places sorted by the cells of a grid.
struct Grid {
    edge_m: f32,
    places: Vec<Place>,
    cells: HashMap<IVec3, Range<usize>>,
}

impl Grid {
    fn of(places: &[Place], edge_m: f32) -> Self {
        let mut places = places.to_vec();
        let key = |place: &Place| cell_of(place.position_m, edge_m);
        places.sort_by_cached_key(|place| key(place).to_array());
        let mut cells = HashMap::new();
        let mut start = 0;
        for group in places.chunk_by(|a, b| key(a) == key(b)) {
            cells.insert(key(&group[0]), start..start + group.len());
            start += group.len();
        }
        Self {
            edge_m,
            places,
            cells,
        }
    }

    /// Distance of the last of [`NEIGHBOURS`]; `None` if there are fewer within reach.
    fn radius_of_neighbours(&self, place_m: Vec3, cell_m: f32) -> Option<f32> {
        let mut squares = Vec::new();
        for radius_m in RADII.map(|radius| radius * cell_m) {
            squares.clear();
            let limit = radius_m * radius_m;
            self.around(place_m, radius_m, |other_m| {
                let square = place_m.distance_squared(other_m);
                if square <= limit {
                    squares.push(square);
                }
            });
            // The place itself is the first.
            if squares.len() > NEIGHBOURS {
                let (_, square, _) = squares.select_nth_unstable_by(NEIGHBOURS, f32::total_cmp);
                return Some(square.sqrt());
            }
        }
        None
    }

    fn around(&self, place_m: Vec3, radius_m: f32, mut visit: impl FnMut(Vec3)) {
        let low = cell_of(place_m - radius_m, self.edge_m);
        let high = cell_of(place_m + radius_m, self.edge_m);
        for cell in cells_between(low, high) {
            let Some(range) = self.cells.get(&cell) else {
                continue;
            };
            for other in &self.places[range.clone()] {
                visit(other.position_m);
            }
        }
    }
}

/// All cells of a box, both ends included.
pub(crate) fn cells_between(low: IVec3, high: IVec3) -> impl Iterator<Item = IVec3> {
    let rows = (low.x..=high.x).flat_map(move |x| (low.y..=high.y).map(move |y| (x, y)));
    rows.flat_map(move |(x, y)| (low.z..=high.z).map(move |z| IVec3::new(x, y, z)))
}
