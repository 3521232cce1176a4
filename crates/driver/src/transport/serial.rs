//! Serial lines and pseudo-terminals, 8 data bits, no parity, one stop bit, no flow control. What
//! blocks is on a thread of its own: a line is not a socket, and adapters can hang in their driver.

use std::io::{self, Read, Write};
use std::path::Path;
use std::thread;
use std::time::Duration;

use bytes::Bytes;
use serialport::SerialPort;
use tokio::sync::{mpsc, oneshot};
use tokio_util::sync::CancellationToken;

use super::{closed, within};
use crate::intake::Intake;

/// A read returns after so long even if nothing came, so that what is to be written is.
const READ_WAIT: Duration = Duration::from_millis(20);
/// Pieces read ahead of who takes them; the rest waits in the system's buffer.
const PIECES: usize = 8;
/// Opening takes a few milliseconds, in a driver that hangs for ever.
const OPENING: Duration = Duration::from_secs(10);
/// A line that is closed is free again by then.
const CLOSING: Duration = Duration::from_millis(500);

/// Frames to be written, and where to say what came of it.
type ToWrite = mpsc::Sender<(Vec<u8>, oneshot::Sender<io::Result<()>>)>;

/// The task's end of a line. Dropped, it ends the line's thread.
#[derive(Debug)]
pub(crate) struct Serial {
    pieces: mpsc::Receiver<io::Result<Bytes>>,
    to_write: ToWrite,
    write_limit: Duration,
}

/// `find_baudrate` wakes a unit that detects the rate: break, 1 ms, the letter U, as the vendor's
/// client does it. Only when nothing was heard: it is noise to a unit that listens already.
pub(super) async fn open(
    path: &Path,
    baudrate: u32,
    limit: Duration,
    find_baudrate: bool,
    abandoned: CancellationToken,
) -> io::Result<Serial> {
    let path = path.to_owned();
    let (opened, is_open) = oneshot::channel();
    let (give, pieces) = mpsc::channel(PIECES);
    let (to_write, frames) = mpsc::channel(PIECES);
    let work = move || {
        let (outcome, port) = match open_port(&path, baudrate, limit, find_baudrate) {
            Ok(port) => (Ok(()), Some(port)),
            Err(error) => (Err(error), None),
        };
        // Nobody waits any more: then nobody writes either, and the line is closed again.
        let _ = opened.send(outcome);
        if let Some(port) = port {
            Line { port, abandoned }.serve(&give, frames);
        }
    };
    thread::Builder::new()
        .name("sonar-line".to_owned())
        .spawn(work)?;
    within(OPENING, async {
        is_open.await.unwrap_or_else(|_| Err(closed()))
    })
    .await?;
    Ok(Serial {
        pieces,
        to_write,
        write_limit: limit.max(2 * READ_WAIT),
    })
}

impl Serial {
    pub(super) async fn read(&mut self) -> io::Result<Bytes> {
        self.pieces.recv().await.unwrap_or_else(|| Err(closed()))
    }

    pub(super) async fn write(&mut self, frame: Vec<u8>) -> io::Result<()> {
        let (done, is_done) = oneshot::channel();
        let written = async {
            self.to_write
                .send((frame, done))
                .await
                .map_err(|_| closed())?;
            is_done.await.unwrap_or_else(|_| Err(closed()))
        };
        within(self.write_limit, written).await
    }

    /// Waits until the thread has let go of the line: two cannot hold it.
    pub(super) async fn close(self) {
        let Self {
            mut pieces,
            to_write,
            ..
        } = self;
        drop(to_write);
        let ended = async {
            while pieces.recv().await.is_some() {}
            Ok(())
        };
        // One that hangs keeps it.
        let _ = within(CLOSING, ended).await;
    }
}

/// The thread's end of a line.
struct Line {
    port: Box<dyn SerialPort>,
    abandoned: CancellationToken,
}

impl Line {
    /// Until the line is lost, or nobody writes any more.
    fn serve(
        mut self,
        pieces: &mpsc::Sender<io::Result<Bytes>>,
        mut to_write: mpsc::Receiver<(Vec<u8>, oneshot::Sender<io::Result<()>>)>,
    ) {
        use mpsc::error::TryRecvError::Disconnected;
        let mut intake = Intake::default();
        while !self.abandoned.is_cancelled() {
            match to_write.try_recv() {
                Ok((frame, done)) => {
                    // Who asked may have given up waiting.
                    let _ = done.send(self.port.write_all(&frame));
                    continue;
                }
                Err(Disconnected) => return,
                Err(_) => {}
            }
            // Where nobody takes them, bytes wait in the system's buffer.
            let Ok(room) = pieces.try_reserve() else {
                thread::sleep(READ_WAIT);
                continue;
            };
            match self.port.read(intake.room()) {
                Ok(0) => return room.send(Err(closed())),
                Ok(byte_count) => room.send(Ok(intake.take(byte_count))),
                Err(error) if is_nothing_yet(&error) => {}
                Err(error) => return room.send(Err(error)),
            }
        }
    }
}

/// What the two kinds of time-out and an interrupted call mean to a reader.
fn is_nothing_yet(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), WouldBlock | TimedOut | Interrupted)
}

fn open_port(
    path: &Path,
    baudrate: u32,
    limit: Duration,
    find_baudrate: bool,
) -> io::Result<Box<dyn SerialPort>> {
    let name = path.to_string_lossy();
    if let Some(what) = what_else_than_a_line(path) {
        return Err(io::Error::other(format!(
            "{name} is {what}, not a serial line"
        )));
    }
    let mut port = serialport::new(name.as_ref(), baudrate)
        .timeout(limit)
        .open()
        .map_err(|error| in_words(path, error))?;
    if find_baudrate {
        // Pseudo-terminals and some adapters know no break: then there is no rate to find.
        let _ = port.set_break();
        thread::sleep(Duration::from_millis(1));
        let _ = port.clear_break();
        let _ = port.write(b"U");
    }
    port.set_timeout(READ_WAIT)?;
    Ok(port)
}

/// What is at `path`, if it will never be a serial line; `None` for a device, and for nothing,
/// which may yet be plugged in.
pub(crate) fn what_else_than_a_line(path: &Path) -> Option<&'static str> {
    let kind = std::fs::metadata(path).ok()?.file_type();
    if kind.is_file() {
        return Some("a file");
    }
    if kind.is_dir() {
        return Some("a directory");
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return Some("a fifo");
        }
        if kind.is_socket() {
            return Some("a socket");
        }
        if kind.is_block_device() {
            return Some("a disk");
        }
    }
    None
}

/// What the system says of a line that does not open, and what to do about it.
pub(crate) fn in_words(path: &Path, error: serialport::Error) -> io::Error {
    use serialport::ErrorKind::{Io, NoDevice};
    let (name, text) = (path.display(), error.to_string());
    let words = match error.kind() {
        Io(io::ErrorKind::PermissionDenied) => format!(
            "no permission to open {name}: add yourself to the group that owns it, as in \
             `sudo usermod -aG dialout $USER`, and log in again"
        ),
        Io(io::ErrorKind::NotFound) => {
            format!("there is no {name}: is the adapter plugged in?")
        }
        // What the library says of a line that another program holds.
        NoDevice => format!(
            "{name} is in use by another program, or was just unplugged: close the other one \
             (ModemManager opens adapters by itself)"
        ),
        _ => format!("{name} cannot be opened as a serial line: {text}"),
    };
    let kind = match error.kind() {
        NoDevice => io::ErrorKind::ResourceBusy,
        _ => io::Error::from(error).kind(),
    };
    io::Error::new(kind, words)
}
