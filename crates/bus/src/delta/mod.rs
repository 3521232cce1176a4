//! What changed in the map, as a stream of deltas per tile, and the map again from that stream.
//!
//! Pure: no zenoh, no clock, no threads. [`SnapshotDiffer`] keeps the published state, tile by
//! tile, and says what to send next within a budget of bytes; [`MapAssembler`] keeps the same
//! state at the other end and says when it has lost the thread. Both compare and keep numbers bit
//! by bit, so at the end both hold the same map to the last bit.

mod answer;
mod assembler;
mod change;
mod differ;
mod published;
mod tile;

pub use answer::{SnapshotAnswer, SnapshotRequest, SnapshotRequestError, TileState};
pub use assembler::{AssemblerCounters, MapAssembler, Progress};
pub use differ::SnapshotDiffer;
pub use published::PublishedMap;
pub use tile::{TileName, tile_of};

#[cfg(test)]
pub(crate) use change::bits;

#[cfg(test)]
mod tests;
