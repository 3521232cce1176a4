//! Where the Gaussians around each corner of a sparse grid put the surface.

use std::collections::{HashMap, HashSet};

use echosplat_model::glam::{DMat3, DVec3, IVec3, Vec3};

use crate::normal::least_direction;
use crate::points::{Point, cell_of, cells_between};
use crate::{MOST_BLOCKS, SurfaceError};

/// Corners along the edge of a block.
const BLOCK: i32 = 4;
const CORNERS: usize = (BLOCK * BLOCK * BLOCK) as usize;

/// Sums are kept for so many blocks at a time: 13 MB.
const BLOCKS_AT_ONCE: usize = 4096;

/// The surface ends where no point is within so many of its widths, or of cells if that is more. The
/// middle of four points of an even square is 0.84 of a width from them.
const NEAR_WIDTHS: f32 = 0.9;
const NEAR_CELLS: f32 = 1.8;

/// Weights end here, in widths: 2 % of what they are in the middle.
const REACH_WIDTHS: f32 = 2.8;

/// Least sum of weights at a corner. On an even sheet it is 2 N w² = 5.8, with N neighbours within a
/// radius of which w is the width; half of that on a straight border.
const LEAST_WEIGHT: f32 = 1.5;

/// Furthest that the mean lies sideways, in widths: √(2/π) on a straight border of an even sheet.
const MOST_SIDEWAYS: f64 = 0.8;

/// Largest ratio of the smallest to the middle variance: beyond it no sheet stands out.
const MOST_ROUND: f64 = 0.8;

/// What is known at a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Corner {
    /// Unit, in either of two signs.
    pub(crate) normal: Vec3,
    /// Signed distance from the surface along `normal`, metres; NaN where there is none.
    pub(crate) height_m: f32,
    /// Of the Gaussians around.
    pub(crate) sigma_m: f32,
}

impl Corner {
    const NONE: Self = Self {
        normal: Vec3::ZERO,
        height_m: f32::NAN,
        sigma_m: f32::NAN,
    };

    fn is_there(&self) -> bool {
        !self.height_m.is_nan()
    }
}

/// The corners of all blocks near points.
pub(crate) struct Field {
    pub(crate) cell_m: f32,
    /// Sorted by key.
    blocks: Vec<(IVec3, [Corner; CORNERS])>,
    numbers: HashMap<IVec3, usize>,
}

impl Field {
    /// # Errors
    /// If it takes too many blocks.
    pub(crate) fn of(points: &[Point], cell_m: f32) -> Result<Self, SurfaceError> {
        let keys = blocks_near(points, cell_m)?;
        let mut blocks = Vec::new();
        for keys in keys.chunks(BLOCKS_AT_ONCE) {
            let filled = filled_blocks(keys, points, cell_m);
            blocks.extend(filled.filter(|(_, corners)| corners.iter().any(Corner::is_there)));
        }
        let keys = blocks.iter().map(|(key, _)| *key);
        Ok(Self {
            cell_m,
            numbers: keys.zip(0..).collect(),
            blocks,
        })
    }

    /// `None` where there is no surface near.
    pub(crate) fn at(&self, corner: IVec3) -> Option<&Corner> {
        let number = *self.numbers.get(&block_of(corner))?;
        let corner = &self.blocks[number].1[index_of(corner)];
        corner.is_there().then_some(corner)
    }

    /// Every corner near the surface, block by block.
    pub(crate) fn corners(&self) -> impl Iterator<Item = (IVec3, &Corner)> {
        self.blocks.iter().flat_map(|(key, corners)| {
            let all = corners_of(*key).zip(corners);
            all.filter(|(_, corner)| corner.is_there())
        })
    }
}

fn block_of(corner: IVec3) -> IVec3 {
    corner.div_euclid(IVec3::splat(BLOCK))
}

fn index_of(corner: IVec3) -> usize {
    let within = corner.rem_euclid(IVec3::splat(BLOCK));
    ((within.x * BLOCK + within.y) * BLOCK + within.z) as usize
}

fn corners_of(block: IVec3) -> impl Iterator<Item = IVec3> {
    let first = block * BLOCK;
    cells_between(first, first + (BLOCK - 1))
}

fn place_of(corner: IVec3, cell_m: f32) -> Vec3 {
    corner.as_vec3() * cell_m
}

/// Blocks that may hold a corner within `reach_m` of a place.
fn blocks_around(place_m: Vec3, reach_m: f32, cell_m: f32) -> impl Iterator<Item = IVec3> {
    let block = |place_m| block_of(cell_of(place_m, cell_m));
    let keys = cells_between(block(place_m - reach_m), block(place_m + reach_m));
    keys.filter(move |key| {
        let low = place_of(*key * BLOCK, cell_m);
        let high = place_of(*key * BLOCK + (BLOCK - 1), cell_m);
        place_m.clamp(low, high).distance(place_m) <= reach_m
    })
}

fn near_m(point: &Point, cell_m: f32) -> f32 {
    (NEAR_WIDTHS * point.width_m).max(NEAR_CELLS * cell_m)
}

fn blocks_near(points: &[Point], cell_m: f32) -> Result<Vec<IVec3>, SurfaceError> {
    let mut keys = HashSet::new();
    for point in points {
        keys.extend(blocks_around(
            point.position_m,
            near_m(point, cell_m),
            cell_m,
        ));
        if keys.len() > MOST_BLOCKS {
            return Err(SurfaceError::Large { cell_m });
        }
    }
    let mut keys: Vec<IVec3> = keys.into_iter().collect();
    keys.sort_unstable_by_key(IVec3::to_array);
    Ok(keys)
}

/// What the points say of the corners of these blocks, which are sorted by x.
fn filled_blocks<'k>(
    keys: &'k [IVec3],
    points: &[Point],
    cell_m: f32,
) -> impl Iterator<Item = (IVec3, [Corner; CORNERS])> + 'k {
    let numbers: HashMap<IVec3, usize> = keys.iter().copied().zip(0..).collect();
    let mut sums = vec![[Sums::default(); CORNERS]; keys.len()];
    let ends = [keys.first(), keys.last()].map(|key| key.map_or(0, |key| key.x));
    let [first_m, last_m] = [ends[0], ends[1] + 1].map(|x| (x * BLOCK) as f32 * cell_m);
    for point in points {
        let (x_m, reach_m) = (point.position_m.x, REACH_WIDTHS * point.width_m);
        if x_m + reach_m >= first_m && x_m - reach_m <= last_m {
            add_to_corners(point, cell_m, &numbers, &mut sums);
        }
    }
    let corners = sums
        .into_iter()
        .map(|block| block.map(|sums| sums.corner()));
    keys.iter().copied().zip(corners)
}

fn add_to_corners(
    point: &Point,
    cell_m: f32,
    numbers: &HashMap<IVec3, usize>,
    sums: &mut [[Sums; CORNERS]],
) {
    let (near_m, reach_m) = (near_m(point, cell_m), REACH_WIDTHS * point.width_m);
    for key in blocks_around(point.position_m, reach_m, cell_m) {
        let Some(&number) = numbers.get(&key) else {
            continue;
        };
        for (corner, sums) in corners_of(key).zip(&mut sums[number]) {
            let offset_m = point.position_m - place_of(corner, cell_m);
            let square_m2 = offset_m.length_squared();
            if square_m2 <= reach_m * reach_m {
                sums.add(offset_m, point);
                sums.is_near |= square_m2 <= near_m * near_m;
            }
        }
    }
}

/// Weighted sums over the points around a corner, from which their offsets count.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    weight: f32,
    offset_m: Vec3,
    /// xx, yy, zz.
    squares_m2: Vec3,
    /// yz, zx, xy.
    mixed_m2: Vec3,
    width_m: f32,
    sigma_m: f32,
    /// Whether one of the points is near.
    is_near: bool,
}

impl Sums {
    fn add(&mut self, offset_m: Vec3, point: &Point) {
        let width_m = point.width_m;
        let weight = (-0.5 * offset_m.length_squared() / (width_m * width_m)).exp();
        self.weight += weight;
        self.offset_m += weight * offset_m;
        self.squares_m2 += weight * offset_m * offset_m;
        let (yzx, zxy) = (
            Vec3::new(offset_m.y, offset_m.z, offset_m.x),
            Vec3::new(offset_m.z, offset_m.x, offset_m.y),
        );
        self.mixed_m2 += weight * yzx * zxy;
        self.width_m += weight * width_m;
        self.sigma_m += weight * point.sigma_m;
    }

    fn corner(&self) -> Corner {
        self.sheet().unwrap_or(Corner::NONE)
    }

    /// The sheet that the points around make, if they make one and the corner is within its border.
    fn sheet(&self) -> Option<Corner> {
        if !(self.is_near && self.weight >= LEAST_WEIGHT) {
            return None;
        }
        let share = 1.0 / f64::from(self.weight);
        let mean_m = self.offset_m.as_dvec3() * share;
        let (normal, [least, middle, _]) = least_direction(self.scatter_m2(mean_m, share))?;
        if !(least <= MOST_ROUND * middle) {
            return None;
        }
        let across_m = normal.dot(mean_m);
        let sideways_m = (mean_m - normal * across_m).length();
        let width_m = f64::from(self.width_m) * share;
        (sideways_m <= MOST_SIDEWAYS * width_m).then(|| Corner {
            normal: normal.as_vec3(),
            height_m: -across_m as f32,
            sigma_m: self.sigma_m * share as f32,
        })
    }

    fn scatter_m2(&self, mean_m: DVec3, share: f64) -> DMat3 {
        let (d, m) = (
            self.squares_m2.as_dvec3() * share,
            self.mixed_m2.as_dvec3() * share,
        );
        let second = DMat3::from_cols(
            DVec3::new(d.x, m.z, m.y),
            DVec3::new(m.z, d.y, m.x),
            DVec3::new(m.y, m.x, d.z),
        );
        let outer = DMat3::from_cols(mean_m * mean_m.x, mean_m * mean_m.y, mean_m * mean_m.z);
        second - outer
    }
}
