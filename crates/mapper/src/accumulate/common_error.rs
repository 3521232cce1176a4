//! The error that the poses of some observations give a place: they are off alike, the less so the further apart in
//! time.
//!
//! Errors of poses are a first-order Gauss–Markov process: two observations Δt apart share e^(−Δt/τ) of the error.

use echosplat_measurement::SymmetricMat3;

use super::finding::{add, times};

/// The error that a place has from the poses of its observations. Each observation counts as much as it informs.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct CommonError {
    /// How much the observations inform, 1/m².
    weight: f32,
    /// Variance of the place from a single observation's pose, square metres, times `weight`.
    weighted_m2: SymmetricMat3,
    /// Times of the first and the last observation, in time constants of the error.
    first: f64,
    last: f64,
    /// Fraction of a single observation's variance that their mean has: Σ w w′ e^(−|t − t′|) / (Σ w)².
    shared: f32,
    /// Correlation of their mean with the error at the first observation and at the last: Σ w e^(−|t − first|) / Σ w.
    shared_with_first: f32,
    shared_with_last: f32,
}

impl CommonError {
    /// Of one observation that informs by `weight`, made at this time in time constants of the error, whose pose makes
    /// `variance_m2` of the place.
    pub(crate) fn of_observation(weight: f32, variance_m2: SymmetricMat3, at: f64) -> Self {
        Self {
            weight,
            weighted_m2: times(variance_m2, weight),
            first: at,
            last: at,
            shared: 1.0,
            shared_with_first: 1.0,
            shared_with_last: 1.0,
        }
    }

    /// Adds other observations: [`Self::add_faded`].
    pub(crate) fn add(&mut self, other: &Self) {
        self.add_faded(other, &mut Faded::default());
    }

    /// Adds other observations. They were made before these or after; where the times overlap, they count as made at
    /// the same moments.
    pub(crate) fn add_faded(&mut self, other: &Self, faded: &mut Faded) {
        if other.weight == 0.0 {
            return;
        }
        if self.weight == 0.0 {
            *self = *other;
            return;
        }
        let weight = self.weight + other.weight;
        let (early, late) = match other.first < self.first {
            true => (other, &*self),
            false => (&*self, other),
        };
        let (early_fraction, late_fraction) = (early.weight / weight, late.weight / weight);
        let last = early.last.max(late.last);
        let (of_early, of_late) = (faded.to(early.last, last), faded.to(late.last, last));
        let between = if late.first < early.last {
            (early.shared * late.shared).sqrt()
        } else {
            // Of a single observation that comes after the others it is the same.
            let gap = match late.first < last {
                true => faded.to(early.last, late.first),
                false => of_early,
            };
            early.shared_with_last * late.shared_with_first * gap
        };
        let of_first = faded.since_first(early.first, late.first);
        let mut weighted_m2 = self.weighted_m2;
        add(&mut weighted_m2, &other.weighted_m2);
        *self = Self {
            weight,
            weighted_m2,
            first: early.first,
            last,
            shared: early_fraction.powi(2) * early.shared
                + late_fraction.powi(2) * late.shared
                + 2.0 * early_fraction * late_fraction * between,
            shared_with_first: early_fraction * early.shared_with_first
                + late_fraction * late.shared_with_first * of_first,
            shared_with_last: early_fraction * early.shared_with_last * of_early
                + late_fraction * late.shared_with_last * of_late,
        };
    }

    /// As if each observation informed so many times as much.
    pub(crate) fn times(self, factor: f32) -> Self {
        Self {
            weight: self.weight * factor,
            weighted_m2: times(self.weighted_m2, factor),
            ..self
        }
    }

    /// Variance of the place by all observations together, square metres; 0 without observations.
    pub(crate) fn variance_m2(&self) -> SymmetricMat3 {
        match self.weight == 0.0 {
            true => SymmetricMat3::default(),
            false => times(self.weighted_m2, self.shared / self.weight),
        }
    }
}

/// What is left of errors between some times, as it was asked for last: observations of one ping mostly ask alike.
#[derive(Debug, Default)]
pub(crate) struct Faded {
    /// Bits of both times, and what is left.
    last: Option<([u64; 2], f32)>,
    first: Option<([u64; 2], f32)>,
}

impl Faded {
    fn to(&mut self, from: f64, to: f64) -> f32 {
        remembered(&mut self.last, from, to)
    }

    fn since_first(&mut self, from: f64, to: f64) -> f32 {
        remembered(&mut self.first, from, to)
    }
}

fn remembered(known: &mut Option<([u64; 2], f32)>, from: f64, to: f64) -> f32 {
    if !(from < to) {
        return 1.0;
    }
    let times = [from.to_bits(), to.to_bits()];
    match known {
        Some((of, left)) if *of == times => *left,
        _ => {
            let left = left_after(from, to);
            *known = Some((times, left));
            left
        }
    }
}

/// What is left of an error at a time `from`, at `to`, both in time constants of it.
fn left_after(from: f64, to: f64) -> f32 {
    match from < to {
        true => ((from - to) as f32).exp(),
        false => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observation(weight: f32, at: f64) -> CommonError {
        CommonError::of_observation(weight, SymmetricMat3::isotropic(1.0), at)
    }

    fn all(observations: &[(f32, f64)]) -> CommonError {
        let mut sum = CommonError::default();
        for &(weight, at) in observations {
            sum.add(&observation(weight, at));
        }
        sum
    }

    fn variance_m2(of: CommonError) -> f32 {
        of.variance_m2().diagonal.x
    }

    /// The sum over all pairs of observations.
    fn expected(observations: &[(f32, f64)]) -> f32 {
        let weight: f64 = observations.iter().map(|&(w, _)| f64::from(w)).sum();
        let of_pair = |&(w, t): &(f32, f64), &(w2, t2): &(f32, f64)| {
            f64::from(w) * f64::from(w2) * (-(t - t2).abs()).exp()
        };
        let pairs = observations
            .iter()
            .flat_map(|a| observations.iter().map(move |b| of_pair(a, b)));
        (pairs.sum::<f64>() / (weight * weight)) as f32
    }

    const OBSERVATIONS: [(f32, f64); 5] =
        [(1.0, 2.0), (3.0, 2.1), (0.5, 2.9), (2.0, 6.0), (2.0, 6.0)];

    #[test]
    fn observations_at_one_time_are_off_alike_and_those_far_apart_are_not() {
        let [at_once, far] =
            [0.0, 100.0].map(|apart| variance_m2(all(&[(1.0, 7.0), (1.0, 7.0 + apart)])));
        assert!(
            (at_once - 1.0).abs() < 1e-6 && (far - 0.5).abs() < 1e-6,
            "{at_once} {far}"
        );
    }

    #[test]
    fn however_they_are_added_up_it_is_the_sum_over_all_pairs() {
        let whole = variance_m2(all(&OBSERVATIONS));
        assert!((whole - expected(&OBSERVATIONS)).abs() < 1e-6, "{whole}");
        for cut in 1..4 {
            let (early, late) = (all(&OBSERVATIONS[..cut]), all(&OBSERVATIONS[cut..]));
            for (mut first, then) in [(early, late), (late, early)] {
                first.add(&then);
                assert!((variance_m2(first) - whole).abs() < 1e-6);
                first.add(&observation(1.0, 7.0));
                let longer = [&OBSERVATIONS[..], &[(1.0, 7.0)]].concat();
                assert!((variance_m2(first) - expected(&longer)).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn the_same_observations_twice_say_no_more() {
        let mut twice = all(&OBSERVATIONS);
        twice.add(&all(&OBSERVATIONS));
        assert!((variance_m2(twice) - expected(&OBSERVATIONS)).abs() < 1e-6);
        assert!(
            (variance_m2(all(&OBSERVATIONS).times(8.0)) - expected(&OBSERVATIONS)).abs() < 1e-6
        );
    }

    #[test]
    fn no_observation_says_nothing() {
        let mut some = all(&OBSERVATIONS);
        some.add(&CommonError::default());
        assert!((variance_m2(some) - expected(&OBSERVATIONS)).abs() < 1e-6);
        assert!(variance_m2(CommonError::default()) == 0.0);
    }
}
