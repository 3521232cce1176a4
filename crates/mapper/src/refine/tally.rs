//! Sums per Gaussian over a few pings, which hear a small part of the map: blocks of Gaussians that lie together.

use std::cell::RefCell;

thread_local! {
    /// Room for [`Tally::starts`], all 0: one for each block of the map, and needed thousands of times.
    static ROOM: RefCell<Vec<u32>> = const { RefCell::new(Vec::new()) };
}

/// Sums of the Gaussians of each block that was asked for, in order of first asking.
#[derive(Debug)]
pub(crate) struct Tally<T> {
    /// Where a block's sums begin, plus one; 0 for none.
    starts: Vec<u32>,
    sums: Sums<T>,
}

/// What was summed, and of which blocks.
#[derive(Debug)]
pub(crate) struct Sums<T> {
    /// Block, and where its sums begin.
    blocks: Vec<(u32, u32)>,
    sums: Vec<T>,
}

impl<T: Default + Clone> Tally<T> {
    /// For blocks below `block_count`, with room for so many sums.
    pub(crate) fn new(block_count: usize, expected: usize) -> Self {
        let mut starts = ROOM.take();
        starts.resize(starts.len().max(block_count), 0);
        Self {
            starts,
            sums: Sums {
                blocks: Vec::new(),
                sums: Vec::with_capacity(expected),
            },
        }
    }

    /// The sums of a block of so many, from nothing if it has none yet.
    #[inline(always)]
    pub(crate) fn of(&mut self, block: u32, count: usize) -> &mut [T] {
        let start = &mut self.starts[block as usize];
        let Sums { blocks, sums } = &mut self.sums;
        if *start == 0 {
            blocks.push((block, sums.len() as u32));
            *start = sums.len() as u32 + 1;
            sums.resize(sums.len() + count, T::default());
        }
        let start = *start as usize - 1;
        &mut sums[start..start + count]
    }

    /// The sums alone, which are small.
    pub(crate) fn finish(self) -> Sums<T> {
        let Self { mut starts, sums } = self;
        for &(block, _) in &sums.blocks {
            starts[block as usize] = 0;
        }
        ROOM.set(starts);
        sums
    }
}

impl<T> Sums<T> {
    /// Blocks and their sums, which a block's last is followed by those of others.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, &[T])> {
        let blocks = self.blocks.iter();
        blocks.map(|&(block, start)| (block as usize, &self.sums[start as usize..]))
    }

    pub(crate) fn len(&self) -> usize {
        self.sums.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_never_asked_for_takes_no_part() {
        let mut tally: Tally<f32> = Tally::new(10, 2);
        tally.of(7, 2)[1] += 2.0;
        tally.of(3, 1)[0] += 1.0;
        tally.of(7, 2)[1] += 0.5;
        let listed = |sums: &Sums<f32>| -> Vec<(usize, f32)> {
            sums.iter().map(|(block, sums)| (block, sums[0])).collect()
        };
        let sums = tally.finish();
        assert_eq!(listed(&sums), [(7, 0.0), (3, 1.0)]);
        assert_eq!((sums.len(), sums.iter().next().unwrap().1[1]), (3, 2.5));
        // The next one begins with nothing, however many blocks there are then.
        for block in [7, 19] {
            let mut next: Tally<f32> = Tally::new(block as usize + 1, 0);
            next.of(block, 1)[0] += 1.0;
            assert_eq!(listed(&next.finish()), [(block as usize, 1.0)]);
        }
    }
}
