//! Nearest neighbours among points that do not change: a balanced k-d tree in one array.

use glam::DVec3;

/// Ranges up to this length are searched point by point.
const LEAF_POINTS: usize = 8;

/// A static k-d tree. The point in the middle of a range splits it; the halves lie on both sides.
pub(crate) struct KdTree {
    points: Vec<DVec3>,
    /// Place in the caller's order of each point.
    indices: Vec<u32>,
    /// Axis by which the range is split whose middle is here.
    axes: Vec<u8>,
}

/// What is nearest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Neighbor {
    /// Place in the order the points were given.
    pub(crate) index: usize,
    pub(crate) distance_m: f64,
    pub(crate) point: DVec3,
}

impl KdTree {
    /// Points that are not finite are never found. Duplicates are fine. At most 2³² points.
    pub(crate) fn new(points: impl IntoIterator<Item = DVec3>) -> Self {
        let numbered = (0..).zip(points).filter(|(_, point)| point.is_finite());
        let mut numbered: Vec<(u32, DVec3)> = numbered.collect();
        let mut axes = vec![0; numbered.len()];
        split(&mut numbered, &mut axes);
        Self {
            points: numbered.iter().map(|(_, point)| *point).collect(),
            indices: numbered.iter().map(|(index, _)| *index).collect(),
            axes,
        }
    }

    /// The nearest point, of equally near ones the first given; `None` in an empty tree or for a
    /// query that is not finite.
    pub(crate) fn nearest(&self, query: DVec3) -> Option<Neighbor> {
        if !query.is_finite() {
            return None;
        }
        let mut best = Best {
            squared: f64::INFINITY,
            index: u32::MAX,
            at: None,
        };
        self.search(query, 0, self.points.len(), &mut best);
        let at = best.at?;
        Some(Neighbor {
            index: best.index as usize,
            distance_m: self.points[at].distance(query),
            point: self.points[at],
        })
    }

    /// Infinite where nothing is near.
    pub(crate) fn distance(&self, query: DVec3) -> f64 {
        self.nearest(query).map_or(f64::INFINITY, |n| n.distance_m)
    }

    fn search(&self, query: DVec3, start: usize, end: usize, best: &mut Best) {
        if end - start <= LEAF_POINTS {
            for at in start..end {
                self.offer(query, at, best);
            }
            return;
        }
        let middle = usize::midpoint(start, end);
        self.offer(query, middle, best);
        let axis = usize::from(self.axes[middle]);
        let beyond = query[axis] - self.points[middle][axis];
        let (near, far) = if beyond < 0.0 {
            ((start, middle), (middle + 1, end))
        } else {
            ((middle + 1, end), (start, middle))
        };
        self.search(query, near.0, near.1, best);
        if beyond * beyond <= best.squared {
            self.search(query, far.0, far.1, best);
        }
    }

    fn offer(&self, query: DVec3, at: usize, best: &mut Best) {
        let squared = self.points[at].distance_squared(query);
        let index = self.indices[at];
        if squared < best.squared || (squared <= best.squared && index < best.index) {
            *best = Best {
                squared,
                index,
                at: Some(at),
            };
        }
    }
}

struct Best {
    squared: f64,
    index: u32,
    at: Option<usize>,
}

/// Orders a range around its middle by its widest axis, then its halves. Depth is log₂ of the
/// length whatever the points, since ranges are halved by number.
fn split(points: &mut [(u32, DVec3)], axes: &mut [u8]) {
    if points.len() <= LEAF_POINTS {
        return;
    }
    let (low, high) = points.iter().fold(
        (DVec3::INFINITY, DVec3::NEG_INFINITY),
        |(low, high), (_, point)| (low.min(*point), high.max(*point)),
    );
    let axis = (high - low).max_position();
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| {
        a.1[axis].total_cmp(&b.1[axis]).then(a.0.cmp(&b.0))
    });
    axes[middle] = axis as u8;
    let (left, right) = points.split_at_mut(middle);
    let (left_axes, right_axes) = axes.split_at_mut(middle);
    split(left, left_axes);
    split(&mut right[1..], &mut right_axes[1..]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The slow twin.
    fn nearest_by_looking_at_all(points: &[DVec3], query: DVec3) -> Option<(usize, f64)> {
        let finite = points.iter().enumerate().filter(|(_, p)| p.is_finite());
        finite
            .map(|(index, p)| (index, p.distance_squared(query)))
            .min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)))
            .map(|(index, squared)| (index, squared.sqrt()))
    }

    fn coordinate() -> impl Strategy<Value = f64> {
        // Few values, so that duplicates and axis-aligned points abound.
        prop_oneof![
            4 => (-5..5i32).prop_map(f64::from),
            2 => -5.0..5.0f64,
            1 => Just(f64::NAN),
            1 => Just(f64::INFINITY),
        ]
    }

    proptest! {
        #[test]
        fn it_finds_what_looking_at_all_finds(
            points in proptest::collection::vec((coordinate(), coordinate(), coordinate()), 0..200),
            query in (-6.0..6.0f64, -6..6i32, -6.0..6.0f64),
        ) {
            let points: Vec<DVec3> = points.into_iter().map(DVec3::from).collect();
            let query = DVec3::new(query.0, f64::from(query.1), query.2);
            let found = KdTree::new(points.iter().copied()).nearest(query);
            let expected = nearest_by_looking_at_all(&points, query);
            prop_assert_eq!(found.map(|n| n.index), expected.map(|(index, _)| index));
            if let (Some(found), Some((_, distance_m))) = (found, expected) {
                prop_assert!((found.distance_m - distance_m).abs() < 1e-12);
                prop_assert_eq!(found.point, points[found.index]);
            }
        }
    }

    #[test]
    fn ten_thousand_in_one_place_are_no_trouble() {
        let tree = KdTree::new(vec![DVec3::ONE; 10_000]);
        assert_eq!(tree.nearest(DVec3::ZERO).unwrap().index, 0);
        assert!(tree.nearest(DVec3::NAN).is_none());
        assert!(KdTree::new([]).distance(DVec3::ZERO).is_infinite());
    }
}
