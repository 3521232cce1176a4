//! Where a link's bytes are read to: each read is handed out as it lies there, and shared from then
//! on by whoever keeps it.

use bytes::{Bytes, BytesMut};

/// Bytes read at once at most: one full UDP datagram.
const READ_BYTES: usize = 65_536;
/// Room for the longest read so many times: pieces that somebody keeps hold on to all of it.
const READS: usize = 4;

/// A buffer that gives away what was read.
#[derive(Debug, Default)]
pub(crate) struct Intake(BytesMut);

impl Intake {
    /// Room for one read.
    pub(crate) fn room(&mut self) -> &mut [u8] {
        if self.0.len() < READ_BYTES {
            self.0 = BytesMut::zeroed(READS * READ_BYTES);
        }
        &mut self.0[..READ_BYTES]
    }

    /// The first `byte_count` bytes of the room, at most all of it.
    pub(crate) fn take(&mut self, byte_count: usize) -> Bytes {
        self.0.split_to(byte_count.min(self.0.len())).freeze()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_read_is_handed_out_where_it_lies() {
        let mut intake = Intake::default();
        let mut kept = Vec::new();
        for round in 0..20_u8 {
            let room = intake.room();
            assert_eq!(room.len(), READ_BYTES);
            room[..30_000].fill(round);
            let place = room.as_ptr();
            let piece = intake.take(30_000);
            assert_eq!(piece.as_ptr(), place, "a piece was copied");
            kept.push(piece);
        }
        for (round, piece) in kept.iter().enumerate() {
            assert!(piece.len() == 30_000 && piece.iter().all(|&b| usize::from(b) == round));
        }
    }
}
