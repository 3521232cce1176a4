//! How far two maps are apart.

use glam::DVec3;

use crate::neighbors::KdTree;
use crate::statistics::mean;

/// The mean of the two directed mean distances, metres; infinite if either holds no point.
#[must_use]
pub fn distance_between(a: &[DVec3], b: &[DVec3]) -> f64 {
    let directed = |from: &[DVec3], to: &[DVec3]| {
        let tree = KdTree::new(to.iter().copied());
        let distances: Vec<f64> = from.iter().map(|point| tree.distance(*point)).collect();
        mean(&distances)
    };
    0.5 * (directed(a, b) + directed(b, a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_is_the_same_both_ways() {
        let a = [DVec3::ZERO, DVec3::X];
        let b = [DVec3::ZERO];
        assert!((distance_between(&a, &b) - 0.25).abs() < 1e-12);
        assert!((distance_between(&b, &a) - 0.25).abs() < 1e-12);
        assert!(distance_between(&a, &[]).is_infinite());
        assert!(distance_between(&[], &[]).is_infinite());
    }
}
