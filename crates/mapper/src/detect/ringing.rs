//! How long the transducer rings beyond what each ping tells by itself: ringing is what no group of pings at a gain was
//! without, from the nearest range on and ever weaker. At a low gain a unit may be heard to ring for metres.

use std::collections::BTreeMap;

use crate::detect::noise_over_range::{NoiseOverRange, section_edge_m};

/// Ratio over noise, found: half of an echo's.
/// The transducer is heard to ring where even the quietest pings are above so many times the noise.
const RINGS: f32 = 3.0;
/// Log power, derived: twice a section's error.
/// Ringing dies away: from one section to the next it grows by no more than this, as its log.
const MOST_RISE: f32 = 0.2;
/// Pings, derived: a section is then told to 0.2.
/// Pings that tell ringing.
const LEAST_RINGING_PINGS: u32 = 16;
/// Metres, found: less is no news.
/// Ringing that ends elsewhere by less is no news, metres.
const LEAST_RINGING_CHANGE_M: f64 = 0.1;

/// Where the transducer is no longer heard to ring.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ringing {
    /// Of gains that pings had, by index, metres; 0 where every ping tells it by itself.
    of_gain: BTreeMap<i16, f64>,
    /// The same of all pings, for gains that none had and those that too few had.
    of_all_m: f64,
}

impl Ringing {
    /// What pings of all gains say, and those of each. `exponent` is the power of range that noise grows by; each ping tells
    /// what is nearer than `told_m` by itself.
    pub(crate) fn of(
        all: &NoiseOverRange,
        by_gain: &BTreeMap<i16, NoiseOverRange>,
        exponent: f32,
        told_m: f64,
    ) -> Self {
        let until_m = |noise: &NoiseOverRange| {
            let is_enough = noise.pings() >= LEAST_RINGING_PINGS;
            is_enough.then(|| until_m(&noise.levels(exponent), told_m))
        };
        let of_all_m = until_m(all).unwrap_or(0.0);
        let gains = by_gain.iter();
        let of_gain = gains.map(|(&index, noise)| (index, until_m(noise).unwrap_or(of_all_m)));
        Self {
            of_gain: of_gain.collect(),
            of_all_m,
        }
    }

    /// Whether this differs from what was told before by more than is no news.
    pub(crate) fn is_news(&self, before: &Self) -> bool {
        let indices = self.of_gain.keys().chain(before.of_gain.keys());
        let differs = |index: &i16| {
            (self.until_m(*index) - before.until_m(*index)).abs() >= LEAST_RINGING_CHANGE_M
        };
        indices.into_iter().any(differs)
    }

    /// Of the gain that rings longest, metres.
    pub(crate) fn longest_m(&self) -> f64 {
        let gains = self.of_gain.values().copied();
        gains.reduce(f64::max).unwrap_or(self.of_all_m)
    }

    /// Of a gain, metres; 0 where each ping tells it by itself.
    pub(crate) fn until_m(&self, gain_index: i16) -> f64 {
        let of_gain = self.of_gain.get(&gain_index);
        of_gain.copied().unwrap_or(self.of_all_m)
    }
}

/// Where ringing ends that goes on beyond `told_m`, metres; 0 if none does. A structure is not in all pings, or has quiet
/// before it. `levels` are logs of noise by sections of range, as [`NoiseOverRange::levels`] has them.
fn until_m(levels: &[(usize, f32)], told_m: f64) -> f64 {
    let noise = levels.iter().map(|&(_, level)| level);
    let noise = noise.fold(f32::MAX, f32::min);
    let mut before: Option<(usize, f32)> = None;
    for &(index, level) in levels {
        let goes_on = match before {
            Some((last, last_level)) => index == last + 1 && level <= last_level + MOST_RISE,
            None => section_edge_m(index) <= told_m,
        };
        if !(goes_on && level > noise + RINGS.ln()) {
            break;
        }
        before = Some((index, level));
    }
    let end_m = before.map_or(0.0, |(last, _)| section_edge_m(last + 1));
    if end_m > told_m { end_m } else { 0.0 }
}
