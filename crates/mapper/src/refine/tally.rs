//! Sums per Gaussian over a few pings, which see a small part of the map.

/// A sum for each slot that was asked for, in order of first asking.
#[derive(Debug)]
pub(crate) struct Tally<T> {
    /// Where a slot's sum is, plus one; 0 for none.
    place: Vec<u32>,
    slots: Vec<u32>,
    sums: Vec<T>,
}

impl<T: Default> Tally<T> {
    /// For slots below `slot_count`.
    pub(crate) fn new(slot_count: usize) -> Self {
        Self {
            place: vec![0; slot_count],
            slots: Vec::new(),
            sums: Vec::new(),
        }
    }

    /// The sum of a slot, from nothing if it has none yet.
    pub(crate) fn of(&mut self, slot: u32) -> &mut T {
        let place = &mut self.place[slot as usize];
        if *place == 0 {
            self.slots.push(slot);
            self.sums.push(T::default());
            *place = self.slots.len() as u32;
        }
        &mut self.sums[*place as usize - 1]
    }

    /// What was summed, with the slots it belongs to.
    pub(crate) fn sums(&self) -> impl Iterator<Item = (usize, &T)> {
        self.slots.iter().map(|&slot| slot as usize).zip(&self.sums)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_never_asked_for_takes_no_part() {
        let mut tally: Tally<f32> = Tally::new(10);
        *tally.of(7) += 2.0;
        *tally.of(3) += 1.0;
        *tally.of(7) += 0.5;
        let sums: Vec<(usize, f32)> = tally.sums().map(|(slot, &sum)| (slot, sum)).collect();
        assert_eq!(sums, [(7, 2.5), (3, 1.0)]);
    }
}
