//! A stream of unknown length, thinned as it comes.

/// At most some of a stream of unknown length, evenly chosen: when full, every second one goes,
/// and from then on every second one more is passed over.
#[derive(Debug)]
pub(crate) struct Thinned<T> {
    kept: Vec<T>,
    most: usize,
    stride: u64,
    seen: u64,
}

impl<T> Thinned<T> {
    /// `most` is at least 2.
    pub(crate) fn new(most: usize) -> Self {
        Self {
            kept: Vec::new(),
            most,
            stride: 1,
            seen: 0,
        }
    }

    /// Takes the next one, or not; `make` is called only for what is kept.
    pub(crate) fn push(&mut self, make: impl FnOnce() -> T) {
        let index = self.seen;
        self.seen += 1;
        if !index.is_multiple_of(self.stride) {
            return;
        }
        if self.kept.len() == self.most {
            let mut place = 0;
            self.kept.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            self.stride *= 2;
            if !index.is_multiple_of(self.stride) {
                return;
            }
        }
        self.kept.push(make());
    }

    pub(crate) fn kept(&self) -> &[T] {
        &self.kept
    }

    pub(crate) fn into_kept(self) -> Vec<T> {
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_stream_is_thinned_evenly() {
        for (count, expected) in [
            (3, vec![0, 1, 2]),
            (9, vec![0, 4, 8]),
            (8, vec![0, 2, 4, 6]),
        ] {
            let mut thinned = Thinned::new(4);
            (0..count).for_each(|i| thinned.push(|| i));
            assert_eq!(thinned.into_kept(), expected);
        }
    }
}
