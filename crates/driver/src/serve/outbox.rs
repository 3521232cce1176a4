//! Frames on their way to one client: whole or not at all.

use std::io::{self, ErrorKind, Write};

/// A client this far behind loses frames: about a second of a real unit.
const MAX_BYTES: usize = 128 * 1024;
/// A client with less than this waiting is ready for more.
const READY_BYTES: usize = 16 * 1024;

/// Bytes that the client has not yet taken. Bounded; what does not fit is refused whole.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    bytes: Vec<u8>,
    taken: usize,
}

impl Outbox {
    /// Whether there was room for `frame`.
    pub(super) fn push(&mut self, frame: &[u8]) -> bool {
        if self.waiting() + frame.len() > MAX_BYTES {
            return false;
        }
        if self.taken > READY_BYTES {
            self.bytes.drain(..self.taken);
            self.taken = 0;
        }
        self.bytes.extend_from_slice(frame);
        true
    }

    pub(super) fn is_ready(&self) -> bool {
        self.waiting() < READY_BYTES
    }

    /// Writes as much as `client` takes without waiting, at most `chunk_bytes` a call.
    pub(super) fn flush(&mut self, client: &mut dyn Write, chunk_bytes: usize) -> io::Result<()> {
        while self.waiting() > 0 {
            let end = self.bytes.len().min(self.taken + chunk_bytes);
            match client.write(&self.bytes[self.taken..end]) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(byte_count) => self.taken += byte_count,
                Err(error) => match error.kind() {
                    ErrorKind::WouldBlock | ErrorKind::TimedOut => return Ok(()),
                    ErrorKind::Interrupted => {}
                    _ => return Err(error),
                },
            }
        }
        self.bytes.clear();
        self.taken = 0;
        Ok(())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.waiting() == 0
    }

    fn waiting(&self) -> usize {
        self.bytes.len() - self.taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes so many bytes, then none for now.
    struct Slow {
        taken: Vec<u8>,
        room: usize,
    }

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let count = bytes.len().min(self.room);
            if count == 0 {
                return Err(ErrorKind::WouldBlock.into());
            }
            self.room -= count;
            self.taken.extend_from_slice(&bytes[..count]);
            Ok(count)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_slow_client_gets_whole_frames_or_none() {
        let mut outbox = Outbox::default();
        let mut slow = Slow {
            taken: Vec::new(),
            room: 0,
        };
        let (mut pushed, mut refused) = (Vec::new(), 0);
        for i in 0..6000_u32 {
            let frame = vec![(i % 251) as u8; 100];
            match outbox.push(&frame) {
                true => pushed.extend_from_slice(&frame),
                false => refused += 1,
            }
            slow.room = 73;
            outbox.flush(&mut slow, 50).unwrap();
        }
        assert!(refused > 0 && !outbox.is_ready());
        slow.room = usize::MAX;
        outbox.flush(&mut slow, 4096).unwrap();
        assert!(outbox.is_ready());
        assert!(slow.taken == pushed);
    }
}
