//! Links that bytes travel on. Reads wait for what comes and can be given up at any time; writes and
//! opening end in bounded time.

mod serial;
mod tcp;
mod udp;

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use bytes::Bytes;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

pub(crate) use serial::{in_words, what_else_than_a_line};

use crate::config::DriverConfig;
use crate::url::SonarUrl;

/// A name server that does not answer is waited for so long.
const RESOLVING: Duration = Duration::from_secs(30);

/// One link. An error of any kind, the end of the stream included, is its loss.
#[derive(Debug)]
pub(crate) enum Transport {
    Tcp(tcp::Tcp),
    Udp(udp::Udp),
    Serial(serial::Serial),
}

/// Opens the link of `config`, in bounded time. `was_silent` says that the last one was open and
/// nothing came. Once `abandoned` is cancelled the link ends, whatever its holder is doing.
pub(crate) async fn open(
    config: &DriverConfig,
    was_silent: bool,
    abandoned: &CancellationToken,
) -> io::Result<Transport> {
    let limit = Duration::from_secs_f64(config.io_timeout_s.clamp(0.05, 60.0));
    match &config.url {
        SonarUrl::Tcp(address) => {
            let opened = tcp::open(address, limit, abandoned.clone());
            opened.await.map(Transport::Tcp)
        }
        SonarUrl::Udp(address) => udp::open(address).await.map(Transport::Udp),
        SonarUrl::Serial { path, baudrate } => {
            let opened = serial::open(path, *baudrate, limit, was_silent, abandoned.clone());
            opened.await.map(Transport::Serial)
        }
        SonarUrl::Sim(_) | SonarUrl::File(_) => Err(io::Error::new(
            io::ErrorKind::Unsupported,
            format!("{} is not a link", config.url),
        )),
    }
}

impl Transport {
    /// What came, at least one byte, where it was read. Given up while it waits, it loses nothing.
    pub(crate) async fn read(&mut self) -> io::Result<Bytes> {
        match self {
            Self::Tcp(link) => link.read().await,
            Self::Udp(link) => link.read().await,
            Self::Serial(link) => link.read().await,
        }
    }

    /// Writes one whole frame, in bounded time.
    pub(crate) async fn write(&mut self, frame: Vec<u8>) -> io::Result<()> {
        match self {
            Self::Tcp(link) => link.write(&frame).await,
            Self::Udp(link) => link.write(&frame).await,
            Self::Serial(link) => link.write(frame).await,
        }
    }

    /// Whether being open means that there is somebody at the other end.
    pub(crate) fn opens_connected(&self) -> bool {
        !matches!(self, Self::Udp(_))
    }

    /// Ends the link; then it can be opened again.
    pub(crate) async fn close(self) {
        if let Self::Serial(link) = self {
            link.close().await;
        }
    }
}

/// Every address that a name has.
async fn resolve(address: &str) -> io::Result<impl Iterator<Item = SocketAddr>> {
    let found = within(RESOLVING, tokio::net::lookup_host(address)).await;
    found.map(Iterator::collect::<Vec<_>>).map(Vec::into_iter)
}

fn no_address() -> io::Error {
    io::Error::new(io::ErrorKind::NotFound, "the host has no address")
}

fn closed() -> io::Error {
    let words = "the other end closed the link";
    io::Error::new(io::ErrorKind::UnexpectedEof, words)
}

/// What takes longer has failed.
async fn within<T>(limit: Duration, work: impl Future<Output = io::Result<T>>) -> io::Result<T> {
    let words = "it took too long";
    let late = |_| Err(io::Error::new(io::ErrorKind::TimedOut, words));
    timeout(limit, work).await.unwrap_or_else(late)
}
