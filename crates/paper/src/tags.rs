//! Which views each Gaussian is observed in, as bit sets.

/// One row of bits per Gaussian, one bit per view.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct ViewTags {
    words_per_row: usize,
    words: Vec<u64>,
}

impl ViewTags {
    /// No rows yet, for `view_count` views.
    #[must_use]
    pub(crate) fn new(view_count: usize) -> Self {
        Self {
            words_per_row: view_count.div_ceil(64).max(1),
            words: Vec::new(),
        }
    }

    /// Rows.
    #[must_use]
    pub(crate) fn len(&self) -> usize {
        self.words.len() / self.words_per_row.max(1)
    }

    /// Words of a row.
    #[must_use]
    pub(crate) fn words_per_row(&self) -> usize {
        self.words_per_row
    }

    /// Adds a row without any view; its index.
    pub(crate) fn push_empty(&mut self) -> usize {
        self.words.resize(self.words.len() + self.words_per_row, 0);
        self.len() - 1
    }

    /// Adds a row.
    pub(crate) fn push_row(&mut self, row: &[u64]) {
        debug_assert_eq!(row.len(), self.words_per_row);
        self.words.extend_from_slice(row);
    }

    /// Adds a view to a row; setting it twice is once.
    #[inline]
    pub(crate) fn set(&mut self, row: usize, view: usize) {
        self.words[row * self.words_per_row + view / 64] |= 1 << (view % 64);
    }

    /// Whether a row has a view.
    #[cfg(test)]
    #[must_use]
    pub(crate) fn contains(&self, row: usize, view: usize) -> bool {
        self.words[row * self.words_per_row + view / 64] >> (view % 64) & 1 == 1
    }

    /// The words of a row.
    #[inline]
    #[must_use]
    pub(crate) fn row(&self, row: usize) -> &[u64] {
        &self.words[row * self.words_per_row..(row + 1) * self.words_per_row]
    }

    /// Views of a row: `n_k` of (35).
    #[inline]
    #[must_use]
    pub(crate) fn count(&self, row: usize) -> u32 {
        self.row(row).iter().map(|word| word.count_ones()).sum()
    }

    /// Rows that have `view`, ascending, appended to `rows`.
    pub(crate) fn rows_of(&self, view: usize, rows: &mut Vec<u32>) {
        let (word, bit) = (view / 64, view % 64);
        let column = self.words.iter().skip(word).step_by(self.words_per_row);
        rows.extend(
            (0u32..)
                .zip(column)
                .filter_map(|(row, word)| (word >> bit & 1 == 1).then_some(row)),
        );
    }

    /// Keeps the rows whose place in `keep` is true.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        let width = self.words_per_row;
        let mut kept = 0;
        for (row, _) in keep.iter().enumerate().filter(|(_, keep)| **keep) {
            self.words
                .copy_within(row * width..(row + 1) * width, kept * width);
            kept += 1;
        }
        self.words.truncate(kept * width);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_set_counted_listed_and_kept() {
        let mut tags = ViewTags::new(130);
        for _ in 0..3 {
            tags.push_empty();
        }
        for (row, view) in [(0, 0), (0, 129), (1, 64), (2, 129), (2, 129)] {
            tags.set(row, view);
        }
        assert_eq!((tags.len(), tags.words_per_row()), (3, 3));
        assert_eq!([0, 1, 2].map(|row| tags.count(row)), [2, 1, 1]);
        let mut rows = Vec::new();
        tags.rows_of(129, &mut rows);
        assert_eq!(rows, [0, 2]);
        tags.retain(&[false, true, true]);
        assert!(tags.contains(0, 64) && tags.contains(1, 129) && !tags.contains(0, 0));
        assert_eq!(tags.len(), 2);
    }
}
