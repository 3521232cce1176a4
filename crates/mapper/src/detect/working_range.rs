//! How far away what a dive looks at is, whatever range its unit was set to.
//!
//! Cost: one addition a ping, and a sum over [`SECTIONS`] each time it is asked for.

/// Steps of 3 %; grid.
/// Steps of range for each factor of e: 3 %.
const STEPS_PER_E: f32 = 32.0;
/// Metres, grid: within the blanking.
/// Nearest range that is told, and the steps from it on, up to 480 m.
const NEAREST_M: f32 = 0.2;
/// Steps, to 480 m; grid.
const SECTIONS: usize = 250;
/// Ratio, derived: once in 300 pings.
/// An echo is loud above so many times the threshold. Noise alone reaches that in one ping of three hundred.
const LOUD: f32 = 2.0;
/// Loud pings; found.
/// Loud pings before anything is told, some seconds: by then ground that is nearer than what is looked at is known.
const LEAST_PINGS: u32 = 256;
/// Loud pings, found: some minutes.
/// Loud pings after which it is known, some minutes: a map is not thrown away for less.
const ENOUGH_PINGS: u32 = 16_384;

/// The ranges of pings' strongest echoes.
#[derive(Debug, Clone)]
pub(crate) struct WorkingRange {
    /// Independent pings whose strongest echo is in each step, shape `[SECTIONS]`.
    weights: [f32; SECTIONS],
    pings: u32,
    is_asked: bool,
}

impl Default for WorkingRange {
    fn default() -> Self {
        Self {
            weights: [0.0; SECTIONS],
            pings: 0,
            is_asked: false,
        }
    }
}

impl WorkingRange {
    /// Takes in a ping by its strongest echo: its range, metres, and its power over the threshold. `weight` is what the ping
    /// says that the one before did not.
    pub(crate) fn hear(&mut self, range_m: f32, over_threshold: f32, weight: f32) {
        if !(over_threshold > LOUD) {
            return;
        }
        let step = (range_m / NEAREST_M).max(1.0).ln() * STEPS_PER_E;
        self.weights[(step as usize).min(SECTIONS - 1)] += weight;
        self.pings += 1;
        let may_ask = (LEAST_PINGS..=ENOUGH_PINGS).contains(&self.pings);
        self.is_asked |= may_ask && self.pings.is_power_of_two();
    }

    /// The range that half of the strongest echoes are nearer than, metres. Told after 256, 512, … and
    /// 16,384 pings with a loud echo, once each.
    pub(crate) fn settle(&mut self) -> Option<f32> {
        if !std::mem::take(&mut self.is_asked) {
            return None;
        }
        let half = 0.5 * self.weights.iter().sum::<f32>();
        let mut sum = 0.0;
        let middle = self.weights.iter().position(|weight| {
            sum += weight;
            sum >= half
        })?;
        Some(NEAREST_M * ((middle as f32 + 0.5) / STEPS_PER_E).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(ranges_m: impl Iterator<Item = (f32, f32)>) -> Option<f32> {
        let mut working = WorkingRange::default();
        let mut told = None;
        for (range_m, over_threshold) in ranges_m {
            working.hear(range_m, over_threshold, 1.0);
            told = working.settle().or(told);
        }
        told
    }

    #[test]
    fn what_most_pings_hear_is_told_whatever_else_some_hear() {
        // Two of five hear something far away.
        let ranges_m = (0..256).map(|i| (if i % 5 < 2 { 30.0 } else { 6.5 }, 10.0));
        let range_m = told(ranges_m).unwrap();
        assert!((range_m / 6.5 - 1.0).abs() < 0.02, "{range_m}");
    }

    #[test]
    fn few_pings_and_noise_tell_nothing() {
        assert_eq!(told((0..255).map(|_| (6.5, 10.0))), None);
        assert_eq!(
            told((0..1000_u16).map(|i| (0.02 * f32::from(i), 1.5))),
            None
        );
    }

    #[test]
    fn ranges_beyond_all_steps_count_as_the_last_and_break_nothing() {
        let wild = [0.0, -1.0, f32::MAX, f32::INFINITY, f32::NAN];
        let range_m = told((0..256).map(|i| (wild[i % wild.len()], 10.0)));
        assert!(range_m.is_some_and(f32::is_finite));
    }

    #[test]
    fn a_unit_at_rest_says_little() {
        let mut working = WorkingRange::default();
        (0..240).for_each(|_| working.hear(1.5, 10.0, 0.02));
        (0..16).for_each(|_| working.hear(6.5, 10.0, 1.0));
        let range_m = working.settle().unwrap();
        assert!(range_m > 6.0, "{range_m}");
    }
}
