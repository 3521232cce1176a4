//! What cannot have less error without more cost, and where that stops to pay.

/// Indices of the points (cost, error) that no other beats in one without losing in the other, in
/// order of cost. What is not positive and finite is on no front.
#[must_use]
pub(crate) fn front(points: &[(f64, f64)]) -> Vec<usize> {
    let is_drawable = |value: f64| value > 0.0 && value.is_finite();
    let mut order: Vec<usize> = (0..points.len())
        .filter(|&index| is_drawable(points[index].0) && is_drawable(points[index].1))
        .collect();
    order.sort_by(|&a, &b| {
        let by_cost = points[a].0.total_cmp(&points[b].0);
        by_cost.then(points[a].1.total_cmp(&points[b].1))
    });
    let mut least = f64::INFINITY;
    order.retain(|&index| {
        let is_better = points[index].1 < least;
        least = least.min(points[index].1);
        is_better
    });
    order
}

/// The point of the front that bulges most towards no cost and no error: the one most distant from
/// the chord between the front's ends, both axes logarithmic. Without such a bulge, the end that
/// is nearer to the corner of least cost and least error; `None` without a front.
#[must_use]
pub(crate) fn knee(points: &[(f64, f64)]) -> Option<usize> {
    let front = front(points);
    let log = |index: usize| (points[index].0.ln(), points[index].1.ln());
    let (&first, &last) = (front.first()?, front.last()?);
    let ((x0, y0), (x1, y1)) = (log(first), log(last));
    let length = (x1 - x0).hypot(y1 - y0);
    // Positive below the chord.
    let bulge = |index: usize| {
        let (x, y) = log(index);
        ((x1 - x0) * (y0 - y) - (x - x0) * (y0 - y1)) / length
    };
    let inner = front.iter().copied().filter(|&index| bulge(index) > 1e-9);
    let most = inner.max_by(|&a, &b| bulge(a).total_cmp(&bulge(b)));
    let nearer_end = if x1 - x0 < y0 - y1 { last } else { first };
    Some(most.unwrap_or(nearer_end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_front_leaves_out_what_is_beaten_and_what_has_no_logarithm() {
        let points = [
            (4.0, 1.0),
            (1.0, 4.0),
            (2.0, 2.5),
            (3.0, 3.0),
            (2.0, 2.0),
            (0.0, 0.5),
            (5.0, f64::INFINITY),
            (6.0, 1.0),
        ];
        assert_eq!(front(&points), [1, 4, 0]);
        assert!(front(&[]).is_empty() && knee(&[]).is_none());
    }

    #[test]
    fn the_knee_bulges_most_on_logarithmic_axes() {
        let points = [
            (1.0, 100.0),
            (3.0, 80.0),
            (10.0, 10.0),
            (100.0, 8.0),
            (1000.0, 7.0),
        ];
        assert_eq!(knee(&points), Some(2));
        assert_eq!(knee(&[(1.0, 8.0), (2.0, 4.0), (100.0, 1.0)]), Some(1));
        // A straight front, and one that bulges away from the corner.
        assert_eq!(knee(&[(1.0, 8.0), (4.0, 1.0)]), Some(1));
        assert_eq!(knee(&[(1.0, 100.0), (80.0, 90.0), (100.0, 50.0)]), Some(0));
    }
}
