//! A pipe, read by a thread of its own: opening and reading it wait for whoever writes, and that thread
//! alone is held up by it.

use std::collections::BTreeSet;
use std::fs::{File, Metadata};
use std::io::{self, Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Bytes taken at once: what a pipe of Linux holds.
const PIECE_BYTES: usize = 64 << 10;
/// How often is asked whether to wait no longer.
const LOOK: Duration = Duration::from_millis(50);
/// Looks after which is said what is waited for: a second.
const LOOKS_UNTIL_TOLD: u32 = 20;

/// Set for good: it is the program's end.
static IS_ENDING: AtomicBool = AtomicBool::new(false);
static WAS_ENDED: AtomicBool = AtomicBool::new(false);

/// The program is to end: from now on no pipe is waited for.
pub fn end_waiting() {
    IS_ENDING.store(true, Ordering::Relaxed);
}

/// Whether a read failed for that reason.
#[must_use]
pub fn was_ended() -> bool {
    WAS_ENDED.load(Ordering::Relaxed)
}

/// A pipe's bytes.
#[derive(Debug)]
pub struct Pipe {
    path: PathBuf,
    pieces: Receiver<io::Result<Vec<u8>>>,
    at_hand: Cursor<Vec<u8>>,
    looks: u32,
}

impl Pipe {
    /// # Errors
    /// If it was opened before, as what came from it is gone, or there is no thread for it.
    pub(crate) fn open(path: &Path, metadata: &Metadata) -> io::Result<Self> {
        if !is_first(metadata) {
            return Err(io::Error::other(
                "it is a pipe that was read already, and can be read once; give a regular file",
            ));
        }
        // One piece waits while the next is read.
        let (sender, pieces) = sync_channel(1);
        let of_thread = path.to_owned();
        std::thread::Builder::new()
            .name("pipe".to_owned())
            .spawn(move || pass_on(&of_thread, &sender))?;
        Ok(Self {
            path: path.to_owned(),
            pieces,
            at_hand: Cursor::default(),
            looks: 0,
        })
    }

    /// The next piece, `None` at the end.
    fn wait(&mut self) -> io::Result<Option<Vec<u8>>> {
        loop {
            match self.pieces.recv_timeout(LOOK) {
                Ok(piece) => return piece.map(Some),
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if IS_ENDING.load(Ordering::Relaxed) {
                WAS_ENDED.store(true, Ordering::Relaxed);
                return Err(io::Error::other("asked to end while waiting for this pipe"));
            }
            self.looks = self.looks.saturating_add(1);
            if self.looks == LOOKS_UNTIL_TOLD {
                let path = self.path.display();
                tracing::info!("waiting for the pipe {path}: nothing more has come from it yet");
            }
        }
    }
}

impl Read for Pipe {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let count = self.at_hand.read(buffer)?;
            if count > 0 || buffer.is_empty() {
                return Ok(count);
            }
            match self.wait()? {
                Some(piece) => self.at_hand = Cursor::new(piece),
                None => return Ok(0),
            }
        }
    }
}

/// Until the pipe's end, or nobody takes what comes.
fn pass_on(path: &Path, pieces: &SyncSender<io::Result<Vec<u8>>>) {
    let mut file = match File::open(path) {
        Ok(file) => file,
        Err(error) => {
            // Whoever waited may be gone.
            let _ = pieces.send(Err(error));
            return;
        }
    };
    loop {
        let mut piece = vec![0; PIECE_BYTES];
        let read = match file.read(&mut piece) {
            Ok(0) => return,
            Ok(count) => {
                piece.truncate(count);
                Ok(piece)
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => Err(error),
        };
        let is_over = read.is_err();
        if pieces.send(read).is_err() || is_over {
            return;
        }
    }
}

/// Whether this pipe was not opened here before.
#[cfg(unix)]
fn is_first(metadata: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    static OPENED: Mutex<BTreeSet<(u64, u64)>> = Mutex::new(BTreeSet::new());
    let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
    opened.insert((metadata.dev(), metadata.ino()))
}

#[cfg(not(unix))]
fn is_first(_: &Metadata) -> bool {
    true
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::io::Write;

    fn pipe_in(folder: &Path) -> PathBuf {
        let path = folder.join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.is_ok_and(|status| status.success()), "mkfifo");
        path
    }

    fn text_of(mut input: impl Read) -> String {
        let mut text = String::new();
        input.read_to_string(&mut text).expect("it is text");
        text
    }

    #[test]
    fn a_pipe_is_read_whole_and_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = pipe_in(folder.path());
        let input = crate::open(&path).unwrap();
        let text = "eleven bytes".repeat(50_000);
        let (to, expected) = (path.clone(), text.clone());
        let writer = std::thread::spawn(move || {
            let mut pipe = std::fs::OpenOptions::new().write(true).open(to).unwrap();
            pipe.write_all(text.as_bytes()).unwrap();
        });
        assert!(text_of(input) == expected);
        writer.join().unwrap();
        let again = crate::open(&path).unwrap_err().to_string();
        assert!(again.contains("read already"), "{again}");
        let refused = crate::open_file(&path).unwrap_err().to_string();
        assert!(refused.contains("a named pipe"), "{refused}");
    }

    #[test]
    fn what_is_no_file_is_named_and_nothing_is_read_without_bound() {
        let folder = tempfile::tempdir().unwrap();
        for open in [
            |path: &Path| crate::open(path).map(drop),
            |path: &Path| crate::open_file(path).map(drop),
        ] {
            let refused = |path: &Path| open(path).unwrap_err().to_string();
            assert!(refused(folder.path()).contains("a directory"));
            assert!(refused(Path::new("/dev/zero")).contains("a device"));
        }
        assert_eq!(text_of(crate::open(Path::new("/dev/null")).unwrap()), "");
        let file = folder.path().join("file");
        std::fs::write(&file, "12345").unwrap();
        assert_eq!(crate::read(&file, 5).unwrap(), b"12345");
        assert!(
            crate::read(&file, 4)
                .unwrap_err()
                .to_string()
                .contains("4 bytes")
        );
    }
}
