//! Which pings were taken, and when the device made them: what tells one that comes late from one
//! that comes again.

use std::collections::BTreeMap;

/// Numbers kept together.
const PIECE_PINGS: i64 = 256;
const PIECE_WORDS: usize = 4;
/// A live link disorders a few datagrams: the last 768 numbers at least.
const MOST_PIECES_LIVE: usize = 4;
/// A log disorders whole blocks: a million numbers, five hours at 58 pings/s, in 4.3 MB.
const MOST_PIECES_LOG: usize = 4096;

/// Numbers and device times of the pings taken. Bounded: the lowest numbers are forgotten first.
#[derive(Debug, Clone, Default)]
pub(crate) struct Seen {
    /// By number divided by [`PIECE_PINGS`].
    pieces: BTreeMap<i64, Box<Piece>>,
    /// Nothing is known of numbers below.
    floor: i64,
}

#[derive(Debug, Clone)]
struct Piece {
    /// One bit a number.
    is_there: [u64; PIECE_WORDS],
    millis: [u32; PIECE_PINGS as usize],
}

impl Seen {
    /// Nothing seen; numbers are expected from `floor` on.
    pub(crate) fn from(floor: i64) -> Self {
        Self {
            pieces: BTreeMap::new(),
            floor,
        }
    }

    pub(crate) fn insert(&mut self, number: i64, millis: u32, is_log: bool) {
        let (key, index) = place(number);
        let piece = self.pieces.entry(key).or_default();
        piece.is_there[index / 64] |= 1 << (index % 64);
        piece.millis[index] = millis;
        let most = match is_log {
            true => MOST_PIECES_LOG,
            false => MOST_PIECES_LIVE,
        };
        if self.pieces.len() > most
            && let Some((lowest, _)) = self.pieces.pop_first()
        {
            self.floor = self.floor.max((lowest + 1).saturating_mul(PIECE_PINGS));
        }
    }

    /// Whether it is still known which numbers from `number` on were taken.
    pub(crate) fn remembers(&self, number: i64) -> bool {
        number >= self.floor
    }

    /// When the ping of this number was made, if it was taken.
    pub(crate) fn millis_of(&self, number: i64) -> Option<u32> {
        let (key, index) = place(number);
        self.pieces.get(&key)?.at(index)
    }

    /// When the last one taken below this number was made.
    pub(crate) fn millis_before(&self, number: i64) -> Option<u32> {
        let (key, index) = place(number);
        let here = self.pieces.get(&key);
        let near = here.and_then(|piece| (0..index).rev().find_map(|i| piece.at(i)));
        near.or_else(|| {
            let (_, piece) = self.pieces.range(..key).next_back()?;
            (0..PIECE_PINGS as usize).rev().find_map(|i| piece.at(i))
        })
    }

    /// When the first one taken above this number was made.
    pub(crate) fn millis_after(&self, number: i64) -> Option<u32> {
        let (key, index) = place(number);
        let here = self.pieces.get(&key);
        let all = PIECE_PINGS as usize;
        let near = here.and_then(|piece| (index + 1..all).find_map(|i| piece.at(i)));
        near.or_else(|| {
            let (_, piece) = self.pieces.range(key + 1..).next()?;
            (0..all).find_map(|i| piece.at(i))
        })
    }
}

/// Key of a number's piece, and its index there.
fn place(number: i64) -> (i64, usize) {
    let index = number.rem_euclid(PIECE_PINGS);
    (number.div_euclid(PIECE_PINGS), index as usize)
}

impl Piece {
    fn at(&self, index: usize) -> Option<u32> {
        let is_there = self.is_there[index / 64] >> (index % 64) & 1 == 1;
        is_there.then(|| self.millis[index])
    }
}

impl Default for Piece {
    fn default() -> Self {
        Self {
            is_there: [0; PIECE_WORDS],
            millis: [0; PIECE_PINGS as usize],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_found_across_pieces() {
        let mut seen = Seen::default();
        for number in [5, 250, 256, 2_000] {
            seen.insert(number, number as u32 * 25, true);
        }
        assert_eq!(seen.millis_of(250), Some(6_250));
        assert_eq!(seen.millis_of(251), None);
        assert_eq!(seen.millis_before(251), Some(6_250));
        assert_eq!(seen.millis_after(251), Some(6_400));
        assert_eq!(seen.millis_before(1_999), Some(6_400));
        assert_eq!(seen.millis_after(257), Some(50_000));
        assert_eq!(seen.millis_before(5), None);
        assert_eq!(seen.millis_after(2_000), None);
    }

    #[test]
    fn memory_is_bounded_and_what_is_forgotten_is_known_to_be() {
        for (is_log, most) in [(false, MOST_PIECES_LIVE), (true, MOST_PIECES_LOG)] {
            let mut seen = Seen::default();
            for number in 0..5_000 {
                seen.insert(number * 1_000, 0, is_log);
            }
            assert_eq!(seen.pieces.len(), most);
            let kept = most as i64 * 1_000;
            assert!(!seen.remembers(5_000_000 - kept - 2_000));
            assert!(seen.remembers(5_000_000 - kept));
        }
    }
}
