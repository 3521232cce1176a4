//! (43) to (46): opacity follows the gradient of the reconstruction loss, multiplicatively.

use crate::Choices;
use crate::retain::retain;

/// The moving average of harm (45), one per Gaussian.
#[derive(Debug, Clone, Default)]
pub(crate) struct Alignment {
    harm: Vec<f32>,
}

impl Alignment {
    pub(crate) fn new(count: usize) -> Self {
        Self {
            harm: vec![0.0; count],
        }
    }

    /// (44) to (46) of one Gaussian after its step; `gradient` is `g_i` of (43).
    pub(crate) fn aligned(
        &mut self,
        index: usize,
        opacity: f32,
        gradient: f32,
        choices: &Choices,
    ) -> f32 {
        if !gradient.is_finite() {
            return opacity;
        }
        let beta = choices.alignment_memory;
        let harm = &mut self.harm[index];
        *harm = beta * *harm + (1.0 - beta) * gradient.max(0.0);
        let exponent = choices.alignment_rate * gradient + choices.alignment_decay * *harm;
        opacity * (-exponent).exp()
    }

    pub(crate) fn retain(&mut self, keep: &[bool]) {
        retain(&mut self.harm, keep);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opacity_falls_with_harm_rises_with_use_and_remembers_harm() {
        let choices = Choices {
            alignment_rate: 0.1,
            alignment_memory: 0.5,
            alignment_decay: 1.0,
            ..Choices::default()
        };
        let mut alignment = Alignment::new(2);
        // (44): exp(0.1 · 2); (45), (46) have nothing to remember.
        let risen = alignment.aligned(0, 0.5, -2.0, &choices);
        assert!((risen - 0.5 * 0.2f32.exp()).abs() < 1e-6);
        // h = 1: exp(−0.1 · 2 − 1).
        let fallen = alignment.aligned(1, 0.5, 2.0, &choices);
        assert!((fallen - 0.5 * (-1.2f32).exp()).abs() < 1e-6);
        // h = 0.5 is left.
        let later = alignment.aligned(1, 0.5, 0.0, &choices);
        assert!((later - 0.5 * (-0.5f32).exp()).abs() < 1e-6);
        assert_eq!(
            alignment.aligned(1, 0.5, f32::NAN, &choices).to_bits(),
            0.5f32.to_bits()
        );
        alignment.retain(&[false, true]);
        assert!((alignment.harm[0] - 0.5).abs() < 1e-6);
    }
}
