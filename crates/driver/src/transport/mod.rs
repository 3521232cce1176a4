//! Links that bytes travel on, each with reads and writes of bounded time.

mod serial;
mod tcp;
mod udp;

use std::io;
use std::net::TcpStream;
use std::time::Duration;

pub(crate) use serial::{in_words, what_else_than_a_line};

use crate::config::DriverConfig;
use crate::url::SonarUrl;

/// A read returns after so long even if nothing came, so that a stop is prompt.
pub(crate) const READ_WAIT: Duration = Duration::from_millis(20);
/// Bytes read at once at most: one full UDP datagram.
pub(crate) const READ_BYTES: usize = 65_536;

/// What a read brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Received {
    /// So many bytes, at least 1.
    Bytes(usize),
    /// Nothing yet.
    Nothing,
}

/// One link. An error of any kind, the end of the stream included, is its loss.
pub(crate) trait Transport: Send {
    /// Reads what is there; waits at most [`READ_WAIT`] for something.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<Received>;

    /// Writes one whole frame, in bounded time.
    fn write(&mut self, frame: &[u8]) -> io::Result<()>;

    /// The same connection once more, for whoever ends it while this thread hangs; `None` where
    /// there is none.
    fn connection(&self) -> Option<TcpStream> {
        None
    }

    /// Whether being open means that there is somebody at the other end.
    fn opens_connected(&self) -> bool {
        true
    }
}

/// Opens the link of `config`, in bounded time. `was_silent` says that the last one was open and
/// nothing came.
pub(crate) fn open(config: &DriverConfig, was_silent: bool) -> io::Result<Box<dyn Transport>> {
    let timeout = Duration::from_secs_f64(config.io_timeout_s.clamp(0.05, 60.0));
    match &config.url {
        SonarUrl::Tcp(address) => Ok(Box::new(tcp::open(address, timeout)?)),
        SonarUrl::Udp(address) => Ok(Box::new(udp::open(address, timeout)?)),
        SonarUrl::Serial { path, baudrate } => Ok(Box::new(serial::open(
            path, *baudrate, timeout, was_silent,
        )?)),
        SonarUrl::Sim(_) | SonarUrl::File(_) => Err(io::Error::new(
            io::ErrorKind::Unsupported,
            format!("{} is not a link", config.url),
        )),
    }
}

/// What the two kinds of time-out and an interrupted call mean to a reader: nothing yet.
fn received(result: io::Result<usize>) -> io::Result<Received> {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    match result {
        Ok(0) => Err(io::Error::new(
            io::ErrorKind::UnexpectedEof,
            "the other end closed the link",
        )),
        Ok(byte_count) => Ok(Received::Bytes(byte_count)),
        Err(error) if matches!(error.kind(), WouldBlock | TimedOut | Interrupted) => {
            Ok(Received::Nothing)
        }
        Err(error) => Err(error),
    }
}
