//! Writing to whoever reads slowly, or not at all.

use std::io::{self, ErrorKind, Write};
use std::time::Duration;

/// Most bytes written at once: what a pipe takes whole or not at all.
pub(super) const PIECE_BYTES: usize = 4096;
/// How long to wait where whoever started the program lets no write wait.
const PAUSE: Duration = Duration::from_millis(10);

/// Writes all of it, however long that takes; `moved` is told each time that some of it is taken, and how
/// much.
///
/// # Errors
/// Of the system; a pipe that is full is none.
pub(super) fn write_all(
    to: &mut dyn Write,
    mut bytes: &[u8],
    mut moved: impl FnMut(usize),
) -> io::Result<()> {
    while !bytes.is_empty() {
        match to.write(&bytes[..bytes.len().min(PIECE_BYTES)]) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(count) => {
                bytes = &bytes[count..];
                moved(count);
            }
            Err(error) => match error.kind() {
                ErrorKind::Interrupted => {}
                ErrorKind::WouldBlock => std::thread::sleep(PAUSE),
                _ => return Err(error),
            },
        }
    }
    to.flush()
}
