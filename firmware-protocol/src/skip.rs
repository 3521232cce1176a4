//! The account of bytes that are in no frame.

use crate::decoder::Event;

/// Why bytes were skipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SkipReason {
    /// Bytes that belong to nothing that looks like a frame.
    Noise,
    /// A whole candidate frame whose sum is wrong: damaged, cut short, or no frame at all.
    Checksum,
    /// A header whose length cannot be right: for its message id, for a profile's count of
    /// results, or since a long frame's sum is wrong or an intact profile lies within it.
    Length,
    /// A candidate whose remaining bytes did not come in time.
    TimedOut,
}

impl SkipReason {
    /// Every reason, in the order of declaration.
    pub const ALL: [Self; 4] = [Self::Noise, Self::Checksum, Self::Length, Self::TimedOut];

    /// A short name for counters and logs.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Noise => "noise",
            Self::Checksum => "checksum",
            Self::Length => "length",
            Self::TimedOut => "timed_out",
        }
    }
}

/// A stretch of adjacent bytes in no frame, skipped for one reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Skipped {
    /// Length of the stretch, at least 1.
    pub byte_count: usize,
    /// Why.
    pub reason: SkipReason,
}

/// Gathers skipped bytes into stretches and puts what follows a given-up candidate down to it.
///
/// A candidate is given up one byte at a time, since a frame may begin at its second byte. The
/// bytes it covered that turn out to be in no frame are blamed on it all the same, so that one
/// damaged frame is one event.
#[derive(Debug, Clone)]
pub(crate) struct SkipLedger {
    run: Skipped,
    blamed: Skipped,
}

impl SkipLedger {
    pub(crate) const fn new() -> Self {
        let none = Skipped {
            byte_count: 0,
            reason: SkipReason::Noise,
        };
        Self {
            run: none,
            blamed: none,
        }
    }

    /// Bytes gathered and not yet reported.
    pub(crate) fn unreported_byte_count(&self) -> usize {
        self.run.byte_count
    }

    /// Blames the next `byte_count` bytes on `reason`, unless a longer stretch is already blamed.
    pub(crate) fn blame(&mut self, byte_count: usize, reason: SkipReason) {
        if byte_count > self.blamed.byte_count {
            self.blamed = Skipped { byte_count, reason };
        }
    }

    /// Skips the next `byte_count` bytes.
    pub(crate) fn skip(&mut self, byte_count: usize, sink: &mut dyn FnMut(Event<'_>)) {
        let blamed = byte_count.min(self.blamed.byte_count);
        self.gather(blamed, self.blamed.reason, sink);
        self.blamed.byte_count -= blamed;
        self.gather(byte_count - blamed, SkipReason::Noise, sink);
    }

    /// Reports the stretch gathered so far.
    pub(crate) fn report(&mut self, sink: &mut dyn FnMut(Event<'_>)) {
        if self.run.byte_count > 0 {
            sink(Event::Skipped(self.run));
            self.run.byte_count = 0;
        }
    }

    /// A frame begins here: what was gathered is reported, and nothing is blamed any more.
    pub(crate) fn end_stretch(&mut self, sink: &mut dyn FnMut(Event<'_>)) {
        self.report(sink);
        self.blamed.byte_count = 0;
    }

    fn gather(&mut self, byte_count: usize, reason: SkipReason, sink: &mut dyn FnMut(Event<'_>)) {
        if byte_count == 0 {
            return;
        }
        if reason != self.run.reason {
            self.report(sink);
            self.run.reason = reason;
        }
        self.run.byte_count = self.run.byte_count.saturating_add(byte_count);
    }
}
