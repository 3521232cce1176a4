//! What is said of many distances.

use serde::{Deserialize, Serialize};

use crate::nullable;

/// Distances from each point of one set to the nearest of the other. Infinite if there are none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Directed {
    /// Arithmetic mean, metres.
    #[serde(with = "nullable")]
    pub mean_m: f64,
    /// The smallest distance that 95 % do not exceed.
    #[serde(with = "nullable")]
    pub p95_m: f64,
    /// The smallest distance that 99 % do not exceed.
    #[serde(with = "nullable")]
    pub p99_m: f64,
    /// The largest.
    #[serde(with = "nullable")]
    pub max_m: f64,
}

impl Directed {
    pub(crate) fn of(mut distances_m: Vec<f64>) -> Self {
        distances_m.sort_unstable_by(f64::total_cmp);
        Self {
            mean_m: mean(&distances_m),
            p95_m: quantile(&distances_m, 0.95),
            p99_m: quantile(&distances_m, 0.99),
            max_m: quantile(&distances_m, 1.0),
        }
    }
}

/// Infinite if there are none.
pub(crate) fn mean(values: &[f64]) -> f64 {
    if values.is_empty() {
        return f64::INFINITY;
    }
    values.iter().sum::<f64>() / values.len() as f64
}

/// The smallest of `sorted` that at least `share` of them do not exceed (nearest rank); infinite if
/// there are none.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    let last = sorted.len().saturating_sub(1);
    let value = sorted.get(rank.saturating_sub(1).min(last));
    value.copied().unwrap_or(f64::INFINITY)
}

/// Share of the values for which `holds`; 0 if there are none.
pub(crate) fn share<T>(values: &[T], holds: impl Fn(&T) -> bool) -> f64 {
    let count = values.iter().filter(|value| holds(value)).count();
    count as f64 / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_by_nearest_rank() {
        let directed = Directed::of((1..=100).rev().map(f64::from).collect());
        let expected = Directed {
            mean_m: 50.5,
            p95_m: 95.0,
            p99_m: 99.0,
            max_m: 100.0,
        };
        assert_eq!(directed, expected);
        assert_eq!(Directed::of(vec![3.0]).p95_m.to_bits(), 3.0_f64.to_bits());
    }

    #[test]
    fn of_nothing_everything_is_infinite() {
        let directed = Directed::of(vec![]);
        assert!(directed.mean_m.is_infinite() && directed.max_m.is_infinite());
        assert!(directed.p95_m.is_infinite() && directed.p99_m.is_infinite());
        assert!(share(&[0.0; 0], |_| true).abs() < 1e-300);
    }
}
