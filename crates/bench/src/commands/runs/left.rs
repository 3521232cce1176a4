//! What is left of a queue, and about how long it will take.

use crate::runs::{Outcome, Spec};

/// Kept up as runs end.
#[derive(Debug, Default)]
pub(super) struct Left {
    runs: usize,
    expected_s: f64,
    /// Of the runs that are done: what was expected, and what they took.
    done_expected_s: f64,
    done_s: f64,
}

impl Left {
    pub(super) fn of<'a>(specs: impl Iterator<Item = &'a Spec>) -> Self {
        specs.fold(Self::default(), |left, spec| Self {
            runs: left.runs + 1,
            expected_s: left.expected_s + spec.expected_s(),
            ..left
        })
    }

    /// A run was made before.
    pub(super) fn was_done(&mut self, spec: &Spec, outcome: &Outcome) {
        self.done_expected_s += spec.expected_s();
        self.done_s += outcome.wall_s;
    }

    /// A run has ended, well if it has an outcome.
    pub(super) fn ended(&mut self, spec: &Spec, outcome: Option<&Outcome>) {
        self.runs = self.runs.saturating_sub(1);
        self.expected_s = (self.expected_s - spec.expected_s()).max(0.0);
        if let Some(outcome) = outcome {
            self.was_done(spec, outcome);
        }
    }

    /// By the runs so far; by what is expected before there are any.
    pub(super) fn minutes(&self, at_once: usize) -> f64 {
        let ratio = match self.done_expected_s > 0.0 {
            true => self.done_s / self.done_expected_s,
            false => 1.0,
        };
        self.expected_s * ratio / 60.0 / at_once.max(1) as f64
    }

    pub(super) fn words(&self, at_once: usize) -> String {
        format!(
            "{} runs left, about {:.0} min",
            self.runs,
            self.minutes(at_once).ceil()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runs::sample_outcome;
    use echosplat_simulator::{DiveKind, NoiseLevel};

    #[test]
    fn runs_so_far_tell_how_long_the_others_take() {
        let spec = |seed| Spec::new("fence", DiveKind::Survey, NoiseLevel::Nominal, seed);
        let specs = [1, 2, 3, 4].map(spec);
        let mut left = Left::of(specs.iter());
        let one_s = specs[0].expected_s();
        assert!((left.minutes(2) - 4.0 * one_s / 120.0).abs() < 1e-9);
        let slow = Outcome {
            wall_s: 3.0 * one_s,
            ..sample_outcome(0.1, 1)
        };
        left.ended(&specs[0], Some(&slow));
        assert!((left.minutes(1) - 9.0 * one_s / 60.0).abs() < 1e-9);
        // One that failed is done with, and tells nothing.
        left.ended(&specs[1], None);
        assert!((left.minutes(1) - 6.0 * one_s / 60.0).abs() < 1e-9);
        assert!(left.words(1).starts_with("2 runs left"));
    }
}
