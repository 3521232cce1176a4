//! The receiver's stop: no bin is louder than it.

/// Where the receiver's range ends. With both given the lower one counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Saturation {
    /// Share of the dive's echo bins that are clipped, 0 to 1. An echo bin is one beyond 0.5 m in which the
    /// echo, before speckle, is above the mean noise; the stop is fixed for the whole dive.
    pub share: f64,
    /// Or the stop itself, decibels as the unit reports them, −45 to 120; infinite is none. Real units'
    /// decibels end at 75.
    pub stop_db: f64,
}

impl Default for Saturation {
    fn default() -> Self {
        Self {
            share: 0.0,
            stop_db: f64::INFINITY,
        }
    }
}

impl Saturation {
    /// The stop, linear power as reported; infinite if there is none. `echo_bins` gives the power that the
    /// dive's echo bins would have without a stop, and is asked only for a share of them.
    pub(crate) fn stop(&self, echo_bins: impl FnOnce() -> Vec<f64>) -> f64 {
        let given = super::power(self.stop_db);
        if !(self.share > 0.0) {
            return given;
        }
        let mut powers = echo_bins();
        powers.sort_by(f64::total_cmp);
        let below = ((1.0 - self.share) * powers.len() as f64) as usize;
        let Some(quantile) = powers.get(below.min(powers.len().saturating_sub(1))) else {
            return given;
        };
        given.min(*quantile)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stop_leaves_the_asked_share_above_it() {
        let powers = || (0..1000).rev().map(f64::from).collect::<Vec<f64>>();
        let fifth = Saturation {
            share: 0.2,
            ..Saturation::default()
        };
        let stop = fifth.stop(powers);
        let above = powers().into_iter().filter(|power| *power >= stop).count();
        assert_eq!(above, 200);
        assert!(fifth.stop(Vec::new).is_infinite());
        let lower = Saturation {
            stop_db: 20.0,
            ..fifth
        };
        assert!((lower.stop(powers) - 100.0).abs() < 1e-9);
        let all = Saturation {
            share: 1.0,
            ..fifth
        };
        assert!(all.stop(powers).abs() < 1e-12);
    }

    #[test]
    fn by_default_there_is_none_and_no_bin_is_asked_for() {
        let stop = Saturation::default().stop(|| unreachable!());
        assert!(stop.is_infinite());
    }
}
