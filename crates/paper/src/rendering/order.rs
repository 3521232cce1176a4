//! Sorting by range: three passes over eleven bits, which beat comparing at some thousand splats.

const DIGIT_BITS: u32 = 11;
const BUCKETS: usize = 1 << DIGIT_BITS;
const PASSES: usize = 3;

/// Buffers of the sort.
#[derive(Debug, Default)]
pub(super) struct Order {
    /// Bits of the range above, place below.
    keys: Vec<u64>,
    other: Vec<u64>,
    counts: Vec<[u32; BUCKETS]>,
}

impl Order {
    /// Places in increasing order of range, equal ones in the order of their places. Ranges are
    /// positive, so that their bits sort as they do.
    pub(super) fn sort(
        &mut self,
        ranges_m: impl Iterator<Item = f32>,
    ) -> impl Iterator<Item = usize> {
        let key =
            |(place, range_m): (usize, f32)| u64::from(range_m.to_bits()) << 32 | place as u64;
        self.keys.clear();
        self.keys.extend(ranges_m.enumerate().map(key));
        self.other.clear();
        self.other.resize(self.keys.len(), 0);
        self.count();
        for pass in 0..PASSES {
            self.pass(pass);
        }
        self.keys.iter().map(|&key| key as u32 as usize)
    }

    fn count(&mut self) {
        self.counts.clear();
        self.counts.resize(PASSES, [0; BUCKETS]);
        for &key in &self.keys {
            for (pass, counts) in self.counts.iter_mut().enumerate() {
                counts[digit(key, pass)] += 1;
            }
        }
    }

    fn pass(&mut self, pass: usize) {
        let counts = &mut self.counts[pass];
        let mut next = 0;
        for count in counts.iter_mut() {
            (*count, next) = (next, next + *count);
        }
        for &key in &self.keys {
            let place = &mut counts[digit(key, pass)];
            self.other[*place as usize] = key;
            *place += 1;
        }
        std::mem::swap(&mut self.keys, &mut self.other);
    }
}

fn digit(key: u64, pass: usize) -> usize {
    (key >> (32 + DIGIT_BITS * pass as u32)) as usize & (BUCKETS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn it_sorts_as_a_stable_sort_does() {
        let mut noise = Random::new(3);
        let mut ranges: Vec<f32> = (0..3000).map(|_| noise.between(0.05, 90.0)).collect();
        for i in (0..3000).step_by(7) {
            ranges[i] = ranges[i / 2];
        }
        ranges.extend([1e30, f32::MIN_POSITIVE, 0.06]);
        let mut expected: Vec<usize> = (0..ranges.len()).collect();
        expected.sort_by(|&a, &b| ranges[a].total_cmp(&ranges[b]));
        let mut order = Order::default();
        let found: Vec<usize> = order.sort(ranges.iter().copied()).collect();
        assert_eq!(found, expected);
        assert_eq!(order.sort(std::iter::empty()).count(), 0);
    }
}
