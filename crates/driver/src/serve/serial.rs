//! The device on a serial line or a pseudo-terminal: one client, which comes and goes unseen.

use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;
use std::time::Duration;

use super::ServeStatus;
use super::client::Client;
use super::port::{Asked, Port};

/// A line's write waits until its bytes are taken, so few are written at once.
const LINE_CHUNK_BYTES: usize = 64;
#[cfg(unix)]
const PTY_CHUNK_BYTES: usize = 4096;
/// Least wait of a line's reads and writes.
const LINE_WAIT: Duration = Duration::from_millis(1);

pub(super) struct Serial<S> {
    client: Client<S>,
    url: String,
    #[cfg(unix)]
    _pty: Option<super::pty::Pty>,
}

/// A serial line that exists.
pub(super) fn open_line(path: &Path, baudrate: u32) -> io::Result<Box<dyn Port>> {
    let line = serialport::new(path.to_string_lossy(), baudrate)
        .timeout(LINE_WAIT)
        .open()
        .map_err(|error| crate::transport::in_words(path, error))?;
    Ok(Box::new(Serial {
        client: Client::new(line, LINE_CHUNK_BYTES),
        url: format!("serial://{}?baudrate={baudrate}", path.display()),
        #[cfg(unix)]
        _pty: None,
    }))
}

/// A new pseudo-terminal, linked to at `link`.
#[cfg(unix)]
pub(super) fn open_pty(link: Option<&Path>) -> io::Result<Box<dyn Port>> {
    let (stream, pty) = super::pty::open(link)?;
    let path = link.unwrap_or(&pty.path);
    let url = format!("serial://{}", path.display());
    Ok(Box::new(Serial {
        client: Client::new(stream, PTY_CHUNK_BYTES),
        url,
        _pty: Some(pty),
    }))
}

/// This system has no pseudo-terminals.
#[cfg(not(unix))]
pub(super) fn open_pty(_link: Option<&Path>) -> io::Result<Box<dyn Port>> {
    Err(ErrorKind::Unsupported.into())
}

impl<S: Read + Write + Send> Port for Serial<S> {
    fn url(&self) -> String {
        self.url.clone()
    }

    fn serve(&mut self, asked: &mut Asked<'_>, status: &mut ServeStatus) -> bool {
        (status.clients, status.clients_seen) = (1, 1);
        // A line has no end: what is wrong now may be right with the next client.
        self.client.serve(asked, status).unwrap_or(false)
    }

    fn broadcast(&mut self, frame: &[u8], status: &mut ServeStatus) {
        self.client.push(frame, status);
    }

    fn flush(&mut self) {
        if let Err(error) = self.client.flush() {
            tracing::debug!("serial line takes no bytes: {error}");
        }
    }

    fn is_ready(&self) -> bool {
        self.client.is_ready()
    }

    fn has_waiting(&self) -> bool {
        self.client.has_waiting()
    }
}

/// Whether `path` leads to a serial line; a link to a pseudo-terminal, or to nothing, is one that
/// an earlier server left behind.
pub(super) fn is_line(path: &Path) -> bool {
    let target = std::fs::canonicalize(path);
    target.is_ok_and(|target| !target.starts_with("/dev/pts") && !target.is_file())
        || path.starts_with("/dev/pts")
}

/// What the system says when a line or port is taken.
pub(super) fn is_taken(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::AddrInUse | ErrorKind::ResourceBusy)
}
