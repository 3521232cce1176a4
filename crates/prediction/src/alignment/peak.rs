//! The top of an agreement, and how sure it is.

use crate::agreement::error_of_sum;

/// Standard errors; assumed.
/// Above this many standard errors poses say something of what is heard.
const TELLING_ERRORS: f64 = 4.0;
/// Standard errors, derived: once in 10,000 dives.
/// By this many the best is better than any other maximum: the true one is expected to be, so that another is that much
/// better than it once in ten thousand dives.
const UNRIVALLED_ERRORS: f64 = 3.0;

/// One value that was tried.
#[derive(Debug, Clone)]
pub(super) struct Tried {
    pub(super) shift: f64,
    /// By block of time.
    pub(super) gain: Vec<f64>,
}

impl Tried {
    pub(super) fn sum(&self) -> f64 {
        self.gain.iter().sum()
    }

    /// How much better it is than `other`, standard errors; 0 if they are the same.
    pub(super) fn errors_over(&self, other: &Self) -> f64 {
        let more = self.gain.iter().zip(&other.gain);
        let more: Vec<f64> = more.map(|(mine, other)| mine - other).collect();
        let error = error_of_sum(&more);
        if error > 0.0 {
            more.iter().sum::<f64>() / error
        } else {
            0.0
        }
    }
}

/// Where the agreement is best.
#[derive(Debug, Clone, PartialEq)]
pub struct Peak {
    /// What has to be added to the value that was searched from.
    pub shift: f64,
    /// One standard deviation of it.
    pub sigma: f64,
    /// How much better it is than no poses, standard errors over blocks of time.
    pub gain_errors: f64,
    /// How much better than the value that was searched from.
    pub over_given_errors: f64,
    /// How much better than the next best maximum; infinite if there is no other.
    pub over_rivals_errors: f64,
    /// Other maxima, the best first, as [`Peak::shift`] is.
    pub rivals: Vec<f64>,
}

impl Peak {
    /// Whether nothing else can be true.
    #[must_use]
    pub fn is_telling(&self) -> bool {
        self.gain_errors > TELLING_ERRORS
            && self.over_rivals_errors > UNRIVALLED_ERRORS
            && self.sigma.is_finite()
    }

    /// Whether the value that was searched from is wrong.
    #[must_use]
    pub fn is_off(&self) -> bool {
        self.is_telling()
            && self.over_given_errors > UNRIVALLED_ERRORS
            && self.shift.abs() > UNRIVALLED_ERRORS * self.sigma
    }
}

/// Local maxima, the highest first.
pub(super) fn maxima(tried: Vec<Tried>, most: usize) -> Vec<Tried> {
    let sums: Vec<f64> = tried.iter().map(Tried::sum).collect();
    let is_top = |i: usize| {
        let at = |i: Option<usize>| i.and_then(|i| sums.get(i)).copied();
        let is_over = |other: Option<f64>| other.is_none_or(|other| sums[i] >= other);
        is_over(at(i.checked_sub(1))) && is_over(at(Some(i + 1))) && sums[i] > 0.0
    };
    let tops = tried.into_iter().enumerate().filter(|(i, _)| is_top(*i));
    highest(tops.map(|(_, tried)| tried).collect(), most)
}

/// Those that did not climb the same hill, the highest first.
pub(super) fn distinct(tried: Vec<Tried>, step: f64, most: usize) -> Vec<Tried> {
    let mut kept: Vec<Tried> = Vec::new();
    for tried in highest(tried, usize::MAX) {
        let is_near = |other: &Tried| (other.shift - tried.shift).abs() < 1.5 * step;
        if !kept.iter().any(is_near) {
            kept.push(tried);
        }
    }
    kept.truncate(most);
    kept
}

fn highest(mut tried: Vec<Tried>, most: usize) -> Vec<Tried> {
    tried.sort_by(|a, b| b.sum().total_cmp(&a.sum()));
    tried.truncate(most);
    tried
}

/// Where the parabola of least squares through evenly spaced values has its top, and its standard error by leaving out
/// each block of time in turn, at most `step`.
pub(super) fn vertex(around: &[Tried], step: f64) -> (f64, f64) {
    let middle = around[around.len() / 2].shift;
    let block_count = around[0].gain.len();
    let without = |left_out: usize| {
        let y = |tried: &Tried| match tried.gain.get(left_out) {
            Some(gain) => tried.sum() - gain,
            None => tried.sum(),
        };
        let points: Vec<(f64, f64)> = around.iter().map(|t| (t.shift - middle, y(t))).collect();
        top_of_parabola(&points)
    };
    let Some(all) = without(block_count) else {
        return (middle, step);
    };
    let left: Vec<f64> = (0..block_count)
        .map(|i| without(i).unwrap_or(all + step))
        .collect();
    let count = block_count as f64;
    let mean = left.iter().sum::<f64>() / count;
    let square: f64 = left.iter().map(|top| (top - mean).powi(2)).sum();
    let sigma = (square * (count - 1.0) / count).sqrt();
    (middle + all, sigma.min(step))
}

/// `None` if it has no top within the points, which are symmetric about 0.
fn top_of_parabola(points: &[(f64, f64)]) -> Option<f64> {
    let count = points.len() as f64;
    let sum = |of: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>();
    let (x2, x4) = (sum(&|p| p.0 * p.0), sum(&|p| p.0.powi(4)));
    let (y, xy, x2y) = (
        sum(&|p| p.1),
        sum(&|p| p.0 * p.1),
        sum(&|p| p.0 * p.0 * p.1),
    );
    let slope = xy / x2;
    let bend = (count * x2y - x2 * y) / (count * x4 - x2 * x2);
    let top = -0.5 * slope / bend;
    let reach = points.iter().map(|p| p.0).fold(0.0, f64::max);
    (bend < 0.0 && top.abs() <= reach).then_some(top)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hill(top: f64, block_tops: &[f64]) -> Vec<Tried> {
        let at = |i: i32| {
            let shift = 1.0 + 0.1 * f64::from(i);
            let gain = block_tops
                .iter()
                .map(|own| 5.0 - (shift - top - own).powi(2));
            Tried {
                shift,
                gain: gain.collect(),
            }
        };
        (-4..=4).map(at).collect()
    }

    #[test]
    fn a_top_is_found_with_how_far_blocks_of_time_disagree_on_it() {
        let blocks = [0.1, -0.1, 0.2, -0.2, 0.0, 0.05, -0.05, 0.0];
        let (top, sigma) = vertex(&hill(1.07, &blocks), 0.2);
        assert!((top - 1.07).abs() < 1e-9, "{top}");
        let square: f64 = blocks.iter().map(|b: &f64| b * b).sum();
        let expected = (square / 7.0 / 8.0).sqrt();
        assert!(
            (sigma - expected).abs() < 0.2 * expected,
            "{sigma} {expected}"
        );
        // Level, and beyond what was tried.
        assert_eq!(vertex(&hill(9.0, &[0.0; 4]), 0.2), (1.0, 0.2));
    }

    #[test]
    fn maxima_are_ordered_and_one_hill_counts_once() {
        let tried = |shift: f64, gain: f64| Tried {
            shift,
            gain: vec![gain, gain],
        };
        let values = [1.0, 3.0, 2.0, -1.0, 4.0, 0.0, -2.0];
        let all = values
            .iter()
            .enumerate()
            .map(|(i, gain)| tried(i as f64, *gain));
        let shifts = |tried: Vec<Tried>| tried.iter().map(|t| t.shift).collect::<Vec<_>>();
        assert_eq!(shifts(maxima(all.collect(), 5)), [4.0, 1.0]);
        let near = vec![tried(1.0, 2.0), tried(1.1, 3.0), tried(5.0, 1.0)];
        assert_eq!(shifts(distinct(near, 0.2, 5)), [1.1, 5.0]);
    }
}
