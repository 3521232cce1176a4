//! Points by the cubic cell they lie in (counting sort over a hash), for neighbours within a radius.

use glam::Vec3;

/// Points sorted by cell. Cells are hashed into a table of about two buckets per point, so memory
/// is bounded by the number of points whatever the space they span.
pub(crate) struct Grid {
    cell_m: f32,
    mask: u32,
    /// First place of each bucket in `places`; one more at the end.
    starts: Vec<u32>,
    /// Indices of the points, bucket by bucket, ascending within one.
    places: Vec<u32>,
}

impl Grid {
    /// Points that are not finite are never found. `cell_m` is best the radius asked for later.
    pub(crate) fn new(points: &[Vec3], cell_m: f32) -> Self {
        let buckets = (2 * points.len()).next_power_of_two().max(2);
        let mut grid = Self {
            cell_m: cell_m.max(1e-6),
            mask: (buckets - 1) as u32,
            starts: vec![0; buckets + 1],
            places: vec![0; points.len()],
        };
        let buckets: Vec<Option<u32>> = points.iter().map(|p| grid.bucket_of(*p)).collect();
        for bucket in buckets.iter().flatten() {
            grid.starts[*bucket as usize + 1] += 1;
        }
        for bucket in 1..grid.starts.len() {
            grid.starts[bucket] += grid.starts[bucket - 1];
        }
        let mut next = grid.starts.clone();
        for (index, bucket) in (0u32..).zip(&buckets) {
            if let Some(bucket) = bucket {
                let place = &mut next[*bucket as usize];
                grid.places[*place as usize] = index;
                *place += 1;
            }
        }
        grid
    }

    fn bucket_of(&self, point: Vec3) -> Option<u32> {
        point.is_finite().then(|| self.hash(self.cell_of(point)))
    }

    fn cell_of(&self, point: Vec3) -> [i32; 3] {
        (point / self.cell_m).floor().to_array().map(|c| c as i32)
    }

    fn hash(&self, cell: [i32; 3]) -> u32 {
        let [x, y, z] = cell.map(|c| c as u32);
        let mixed =
            x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791);
        (mixed ^ (mixed >> 15)) & self.mask
    }

    /// Calls `found` with the index of every point closer than `radius_m` to `center`, the center's
    /// own included, in a fixed order.
    pub(crate) fn for_each_within(
        &self,
        points: &[Vec3],
        center: Vec3,
        radius_m: f32,
        mut found: impl FnMut(u32),
    ) {
        if !center.is_finite() {
            return;
        }
        let low = self.cell_of(center - radius_m);
        let high = self.cell_of(center + radius_m);
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    self.in_cell(points, [x, y, z], center, radius_m, &mut found);
                }
            }
        }
    }

    fn in_cell(
        &self,
        points: &[Vec3],
        cell: [i32; 3],
        center: Vec3,
        radius_m: f32,
        found: &mut impl FnMut(u32),
    ) {
        let bucket = self.hash(cell) as usize;
        let places = self.starts[bucket] as usize..self.starts[bucket + 1] as usize;
        for &index in &self.places[places] {
            let point = points[index as usize];
            // Another cell may share the bucket: it is asked for by itself.
            let is_near = point.distance_squared(center) < radius_m * radius_m;
            if is_near && self.cell_of(point) == cell {
                found(index);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn it_finds_what_looking_at_all_finds() {
        let mut random = Random::new(3);
        let mut draw = || random.between(-2.0, 2.0);
        let mut points: Vec<Vec3> = (0..500)
            .map(|_| Vec3::new(draw(), draw(), draw()))
            .collect();
        points.push(Vec3::NAN);
        points.push(points[0]);
        for (cell_m, radius_m) in [(0.3, 0.3), (0.1, 0.45), (1.0, 0.2)] {
            let grid = Grid::new(&points, cell_m);
            for center in &points {
                let mut found = Vec::new();
                grid.for_each_within(&points, *center, radius_m, |index| found.push(index));
                found.sort_unstable();
                let near = |p: &Vec3| p.distance_squared(*center) < radius_m * radius_m;
                let all = (0u32..).zip(&points);
                let expected: Vec<u32> = all.filter(|(_, p)| near(p)).map(|(i, _)| i).collect();
                assert_eq!(found, expected);
            }
        }
    }
}
