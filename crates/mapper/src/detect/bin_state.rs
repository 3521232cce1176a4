//! What one bin says.

/// What one bin says of the places at its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum BinState {
    /// Inside the blanking, or outside the ping: nothing.
    Blank = 0,
    /// Looked at and nothing there.
    Dark = 1,
    /// An echo here or within the localisation error.
    Lit = 2,
    /// Dark, but behind an echo that may have hidden it.
    Shadowed = 3,
}

impl BinState {
    /// Of the lower two bits.
    pub(crate) fn of_bits(bits: u8) -> Self {
        match bits & 3 {
            0 => Self::Blank,
            1 => Self::Dark,
            2 => Self::Lit,
            _ => Self::Shadowed,
        }
    }
}
