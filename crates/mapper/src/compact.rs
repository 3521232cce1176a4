//! What is remembered of a ping's bins, small: a dive has tens of thousands of pings.

use crate::profile::BinState;

/// Powers as bfloat16, the upper halves of their f32, rounded to nearest even: within 0.4 %, far
/// below speckle.
#[derive(Debug, Clone, Default)]
pub(crate) struct Powers(Box<[u16]>);

impl Powers {
    pub(crate) fn of(powers: &[f32]) -> Self {
        Self(powers.iter().map(|&power| upper_half(power)).collect())
    }

    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    #[cfg(test)]
    pub(crate) fn at(&self, bin: usize) -> f32 {
        whole(self.0[bin])
    }

    pub(crate) fn iter(&self) -> impl ExactSizeIterator<Item = f32> + '_ {
        self.0.iter().map(|&half| whole(half))
    }
}

/// Rounded to nearest even, and never up to infinity. Powers are finite and not negative.
fn upper_half(power: f32) -> u16 {
    const GREATEST: u32 = 0x7f7f;
    let bits = power.to_bits();
    let rounded = (bits + 0x7fff + (bits >> 16 & 1)) >> 16;
    rounded.min(GREATEST) as u16
}

fn whole(half: u16) -> f32 {
    f32::from_bits(u32::from(half) << 16)
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

    pub(crate) fn iter(&self) -> impl Iterator<Item = BinState> + '_ {
        (0..self.count).map(|bin| self.at(bin))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_rounded_to_nearest_even_and_stay_finite() {
        let one_step = 1.0 / 128.0;
        let given = [1.0 + 0.5 * one_step, 1.0 + 1.5 * one_step, 0.3, 1e-20];
        let powers = Powers::of(&given);
        let errors = [0, 1, 2, 3].map(|bin| powers.at(bin) / given[bin] - 1.0);
        assert!(errors.iter().all(|error| error.abs() < 0.004), "{errors:?}");
        let back: Vec<u32> = powers.iter().map(f32::to_bits).collect();
        assert_eq!(back[..2], [1.0f32, 1.0 + 2.0 * one_step].map(f32::to_bits));
        let ends = Powers::of(&[0.0, f32::MAX]);
        assert!(ends.at(0).abs() < f32::MIN_POSITIVE && ends.at(1).is_finite());
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
