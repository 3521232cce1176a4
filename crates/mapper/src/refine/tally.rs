//! Sums per Gaussian over a few pings, which see a small part of the map.

use std::cell::RefCell;

thread_local! {
    /// Room for [`Tally::place`], all 0: as long as the map, and needed thousands of times.
    static ROOM: RefCell<Vec<u32>> = const { RefCell::new(Vec::new()) };
}

/// A sum for each slot that was asked for, in order of first asking.
#[derive(Debug)]
pub(crate) struct Tally<T> {
    /// Where a slot's sum is, plus one; 0 for none.
    place: Vec<u32>,
    sums: Sums<T>,
}

/// What was summed, with the slots it belongs to.
#[derive(Debug)]
pub(crate) struct Sums<T> {
    slots: Vec<u32>,
    sums: Vec<T>,
}

impl<T: Default> Tally<T> {
    /// For slots below `slot_count`, with room for sums of `expected` of them.
    pub(crate) fn new(slot_count: usize, expected: usize) -> Self {
        let mut place = ROOM.take();
        place.resize(place.len().max(slot_count), 0);
        Self {
            place,
            sums: Sums {
                slots: Vec::with_capacity(expected),
                sums: Vec::with_capacity(expected),
            },
        }
    }

    /// The sum of a slot, from nothing if it has none yet.
    pub(crate) fn of(&mut self, slot: u32) -> &mut T {
        let place = &mut self.place[slot as usize];
        let Sums { slots, sums } = &mut self.sums;
        if *place == 0 {
            slots.push(slot);
            sums.push(T::default());
            *place = slots.len() as u32;
        }
        &mut sums[*place as usize - 1]
    }

    /// The sums alone, which are small.
    pub(crate) fn finish(self) -> Sums<T> {
        let Self { mut place, sums } = self;
        for &slot in &sums.slots {
            place[slot as usize] = 0;
        }
        ROOM.set(place);
        sums
    }
}

impl<T> Sums<T> {
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, &T)> {
        self.slots.iter().map(|&slot| slot as usize).zip(&self.sums)
    }

    pub(crate) fn len(&self) -> usize {
        self.slots.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_never_asked_for_takes_no_part() {
        let mut tally: Tally<f32> = Tally::new(10, 2);
        *tally.of(7) += 2.0;
        *tally.of(3) += 1.0;
        *tally.of(7) += 0.5;
        let listed = |sums: &Sums<f32>| -> Vec<(usize, f32)> {
            sums.iter().map(|(slot, &sum)| (slot, sum)).collect()
        };
        assert_eq!(listed(&tally.finish()), [(7, 2.5), (3, 1.0)]);
        // The next one begins with nothing, however many slots there are then.
        for slot in [7, 19] {
            let mut next: Tally<f32> = Tally::new(slot as usize + 1, 0);
            *next.of(slot) += 1.0;
            assert_eq!(listed(&next.finish()), [(slot as usize, 1.0)]);
        }
    }
}
