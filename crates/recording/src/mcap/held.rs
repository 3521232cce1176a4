//! A file that takes bytes into memory and hands them to the operating system when asked: so that a
//! record and what belongs to it reach the file together, or wait together while the disk refuses.

use std::io::{self, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Two hold it: the MCAP library, which writes into it, and the recording, which hands over. Dropping
/// it writes nothing.
pub(super) struct Held<W>(Arc<Mutex<Bytes<W>>>);

struct Bytes<W> {
    file: W,
    /// Where the next byte written goes.
    position: u64,
    /// Bytes of the file that the operating system has.
    file_byte_count: u64,
    /// What comes behind them.
    behind: Vec<u8>,
    /// Bytes before that become others, each with its place.
    patches: Vec<(u64, Vec<u8>)>,
}

impl<W> Clone for Held<W> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<W: Write + Seek> Held<W> {
    /// Of a file that is empty.
    pub(super) fn new(file: W) -> Self {
        Self(Arc::new(Mutex::new(Bytes {
            file,
            position: 0,
            file_byte_count: 0,
            behind: Vec::new(),
            patches: Vec::new(),
        })))
    }

    fn lock(&self) -> MutexGuard<'_, Bytes<W>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Bytes of the file, with those that were not handed over yet.
    pub(super) fn byte_count(&self) -> u64 {
        self.lock().end()
    }

    /// Gives the operating system what it does not have yet.
    ///
    /// # Errors
    /// If it refuses; what it did not take waits for the next call.
    pub(super) fn hand_over(&self) -> io::Result<()> {
        self.lock().hand_over()
    }

    /// The file, unless another still holds it.
    pub(super) fn into_inner(self) -> Option<W> {
        let bytes = Arc::into_inner(self.0)?;
        Some(
            bytes
                .into_inner()
                .unwrap_or_else(PoisonError::into_inner)
                .file,
        )
    }
}

impl<W: Write + Seek> Bytes<W> {
    fn end(&self) -> u64 {
        self.file_byte_count + self.behind.len() as u64
    }

    fn hand_over(&mut self) -> io::Result<()> {
        if self.behind.is_empty() && self.patches.is_empty() {
            return Ok(());
        }
        self.file.seek(SeekFrom::Start(self.file_byte_count))?;
        while !self.behind.is_empty() {
            match self.file.write(&self.behind) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(count) => {
                    self.file_byte_count += count as u64;
                    self.behind.drain(..count);
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        for (place, bytes) in &self.patches {
            self.file.seek(SeekFrom::Start(*place))?;
            self.file.write_all(bytes)?;
        }
        self.patches.clear();
        self.file.flush()
    }

    /// Puts bytes over others that were written before.
    fn patch(&mut self, bytes: &[u8]) {
        let position = self.position;
        match self.patches.last_mut() {
            Some((place, before)) if *place + before.len() as u64 == position => {
                before.extend_from_slice(bytes);
            }
            _ => self.patches.push((position, bytes.to_vec())),
        }
    }
}

impl<W: Write + Seek> Write for Held<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut held = self.lock();
        let taken = if held.position < held.file_byte_count {
            let room = held.file_byte_count - held.position;
            let taken = bytes.len().min(usize::try_from(room).unwrap_or(usize::MAX));
            held.patch(&bytes[..taken]);
            taken
        } else {
            let at = usize::try_from(held.position - held.file_byte_count);
            let at = at.map_err(|_| io::ErrorKind::FileTooLarge)?;
            let end = at + bytes.len();
            if held.behind.len() < end {
                held.behind.resize(end, 0);
            }
            held.behind[at..end].copy_from_slice(bytes);
            bytes.len()
        };
        held.position += taken as u64;
        Ok(taken)
    }

    /// Nothing: the recording says when.
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl<W: Write + Seek> Seek for Held<W> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let mut held = self.lock();
        let end = held.end();
        let position = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::End(offset) => end.checked_add_signed(offset),
            SeekFrom::Current(offset) => held.position.checked_add_signed(offset),
        };
        let within = position.filter(|position| *position <= end);
        held.position = within.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(held.position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    #[test]
    fn bytes_written_over_others_reach_the_file_wherever_those_are() {
        let mut held = Held::new(Cursor::new(Vec::new()));
        held.write_all(b"0123").unwrap();
        held.hand_over().unwrap();
        held.write_all(b"4567").unwrap();
        held.seek(SeekFrom::Start(2)).unwrap();
        held.write_all(b"abcd").unwrap();
        assert_eq!(held.seek(SeekFrom::End(0)).unwrap(), 8);
        held.write_all(b"8").unwrap();
        assert!(held.seek(SeekFrom::Current(1)).is_err());
        assert_eq!(held.byte_count(), 9);
        held.hand_over().unwrap();
        let file = held.into_inner().unwrap().into_inner();
        assert_eq!(file, b"01abcd678");
    }

    #[test]
    fn nothing_reaches_the_file_before_it_is_handed_over() {
        let mut file = Cursor::new(Vec::new());
        let mut held = Held::new(&mut file);
        held.write_all(b"0123").unwrap();
        held.flush().unwrap();
        drop(held);
        assert!(file.into_inner().is_empty());
    }
}
