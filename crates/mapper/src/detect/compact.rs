//! What is remembered of a ping's bins, small: a dive has tens of thousands of pings.

use std::sync::LazyLock;

use crate::detect::bin_state::BinState;

/// Decibels a code, derived: errs 2 %, far below speckle.
/// Decibels from one code to the next: rounding to them errs by 2 %, far below speckle.
const STEP_DB: f32 = 0.3;
/// Code of the strongest power; layout.
const TOP: u8 = u8::MAX;

/// Powers as decibels below a top, a byte each; what is 76 dB below it or more is none.
#[derive(Debug, Clone, Default)]
pub(crate) struct Powers {
    top: f32,
    codes: Box<[u8]>,
}

/// Power of each code, for a top of 1.
static POWERS: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|code| match code {
        0 => 0.0,
        _ => 10f32.powf(0.1 * STEP_DB * (code as f32 - f32::from(TOP))),
    })
});

impl Powers {
    /// Of finite powers, not negative; those above `top` count as it.
    pub(crate) fn of(powers: &[f32], top: f32) -> Self {
        let steps_per_octave = 10.0 * std::f32::consts::LOG10_2 / STEP_DB;
        let code = |&power: &f32| {
            let below = (power / top).log2() * steps_per_octave;
            // Nothing at all, or no top, is code 0: casts saturate, and nothing that is no number
            // is more.
            (f32::from(TOP) + below).round() as u8
        };
        Self {
            top,
            codes: powers.iter().map(code).collect(),
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.codes.len()
    }

    #[cfg(test)]
    pub(crate) fn at(&self, bin: usize) -> f32 {
        self.top * POWERS[usize::from(self.codes[bin])]
    }

    pub(crate) fn iter(&self) -> impl ExactSizeIterator<Item = f32> + '_ {
        let powers = &*POWERS;
        self.codes
            .iter()
            .map(|&code| self.top * powers[usize::from(code)])
    }
}

/// What bins say, four to a byte.
#[derive(Debug, Clone, Default)]
pub(crate) struct States {
    packed: Box<[u8]>,
    count: usize,
}

impl States {
    pub(crate) fn of(states: &[BinState]) -> Self {
        let pack = |four: &[BinState]| {
            let bits = four.iter().enumerate();
            bits.fold(0, |byte, (i, &state)| byte | (state as u8) << (2 * i))
        };
        Self {
            packed: states.chunks(4).map(pack).collect(),
            count: states.len(),
        }
    }

    /// Bins beyond the last are [`BinState::Blank`].
    pub(crate) fn at(&self, bin: usize) -> BinState {
        // The bins that fill up the last byte are 0, blank, too.
        let byte = self.packed.get(bin / 4).copied().unwrap_or(0);
        BinState::of_bits(byte >> (2 * (bin % 4)))
    }

    /// Of sixteen bins from four times `byte` on, two bits each, the first one's lowest.
    pub(crate) fn sixteen(&self, byte: usize) -> u32 {
        let mut four = [0; 4];
        let rest = self.packed.get(byte..).unwrap_or_default();
        match rest.first_chunk() {
            Some(all) => four = *all,
            None => four[..rest.len()].copy_from_slice(rest),
        }
        u32::from_le_bytes(four)
    }

    /// Appends for each bin what its state stands for.
    pub(crate) fn expand(&self, meanings: [f32; 4], expanded: &mut Vec<f32>) {
        let end = expanded.len() + self.count;
        for &four in &self.packed {
            let of = |bin: u32| meanings[usize::from(four >> (2 * bin) & 3)];
            expanded.extend_from_slice(&[of(0), of(1), of(2), of(3)]);
        }
        expanded.truncate(end);
    }

    #[cfg(test)]
    pub(crate) fn iter(&self) -> impl Iterator<Item = BinState> + '_ {
        (0..self.count).map(|bin| self.at(bin))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_come_back_within_a_step_whatever_their_scale() {
        for scale in [1e-30f32, 1.0, 1e30] {
            let given = [1.0, 0.9, 0.3, 1e-3, 2e-7].map(|power| power * scale);
            let powers = Powers::of(&given, scale);
            for (bin, power) in given.iter().enumerate() {
                let error = powers.at(bin) / power - 1.0;
                assert!(error.abs() < 0.036, "{error} of {power}");
            }
            assert!(powers.iter().eq((0..5).map(|bin| powers.at(bin))));
        }
    }

    #[test]
    fn sixteen_states_are_those_of_their_bins_and_blank_beyond_the_last() {
        let all = [
            BinState::Lit,
            BinState::Dark,
            BinState::Shadowed,
            BinState::Blank,
            BinState::Dark,
        ];
        let given: Vec<BinState> = all.into_iter().cycle().take(45).collect();
        let states = States::of(&given);
        for byte in 0..20 {
            let sixteen = states.sixteen(byte);
            for place in 0..16 {
                let state = BinState::of_bits((sixteen >> (2 * place)) as u8);
                assert_eq!(state, states.at(4 * byte + place), "{byte} {place}");
            }
        }
    }

    #[test]
    fn the_top_holds_what_is_above_and_nothing_stays_nothing() {
        let powers = Powers::of(&[0.0, 1e-9, 7.0, f32::MAX], 1.0);
        let back: Vec<f32> = powers.iter().collect();
        assert_eq!(back, [0.0, 0.0, 1.0, 1.0]);
        let silent = Powers::of(&[0.0, 0.0], 0.0);
        assert!(silent.iter().all(|power| power == 0.0));
    }

    #[test]
    fn states_come_back_and_beyond_them_is_nothing() {
        use BinState::{Blank, Dark, Lit, Shadowed};
        let given = [Dark, Lit, Shadowed, Blank, Lit, Lit];
        let states = States::of(&given);
        assert!(states.iter().eq(given));
        assert_eq!((states.at(6), states.at(600)), (Blank, Blank));
    }
}
