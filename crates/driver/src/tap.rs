//! What a session is given, shown to whoever records it, and given again from a recording.

use bytes::Bytes;
use echosplat_model::Timestamp;

/// What a session is about to be given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tapped<'a> {
    /// The link is there.
    LinkUp,
    /// Bytes as they came, before they are decoded; whoever keeps them shares them.
    Bytes(&'a Bytes),
    /// The rest of a half frame did not come; it is given up.
    HalfFrameExpired,
    /// The link is gone, and with it what was half received.
    LinkDown,
    /// Pings with these sequences, both included, found no room in the channel. No tape gives them
    /// again: who replays one leaves them out.
    PingsShed(u64, u64),
}

/// Called by the driver with the time that the session is given: before bytes are decoded,
/// and before the next thing is given to it. A tape of all of these replays to the same pings, bit
/// for bit: see [`crate::spawn_tape`].
pub type RawTap = Box<dyn FnMut(Timestamp, Tapped<'_>) + Send>;

/// One [`Tapped`] as a recording holds it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TapeItem {
    /// The link was there.
    LinkUp,
    /// Bytes as they came.
    Bytes(Bytes),
    /// A half frame was given up.
    HalfFrameExpired,
    /// The link was gone.
    LinkDown,
    /// Nothing came for a while, on a tape that is still being written: the reader looks whether it
    /// is to stop.
    Nothing,
    /// Something else was recorded here: it is told as [`crate::DriverEvent::Mark`], so that whoever
    /// reads the rest of the recording keeps step.
    Mark(u64),
    /// What follows comes for the first time; what went before was read from a recording of the same
    /// dive. Told as [`crate::DriverEvent::GoesOn`].
    GoesOn,
}

impl TapeItem {
    /// As a tap is shown it.
    #[must_use]
    pub fn tapped(&self) -> Option<Tapped<'_>> {
        Some(match self {
            Self::LinkUp => Tapped::LinkUp,
            Self::Bytes(bytes) => Tapped::Bytes(bytes),
            Self::HalfFrameExpired => Tapped::HalfFrameExpired,
            Self::LinkDown => Tapped::LinkDown,
            Self::Nothing | Self::Mark(_) | Self::GoesOn => return None,
        })
    }
}

impl TapeItem {
    /// What a tape keeps of what a tap was shown.
    #[must_use]
    pub fn of(tapped: Tapped<'_>) -> Option<Self> {
        Some(match tapped {
            Tapped::LinkUp => Self::LinkUp,
            Tapped::Bytes(bytes) => Self::Bytes(bytes.clone()),
            Tapped::HalfFrameExpired => Self::HalfFrameExpired,
            Tapped::LinkDown => Self::LinkDown,
            Tapped::PingsShed(..) => return None,
        })
    }
}

/// What a recording holds, in order, each with the host's time then; or words that say why it
/// cannot be read further, which end it.
pub type Tape = Box<dyn Iterator<Item = Result<(Timestamp, TapeItem), String>> + Send>;
