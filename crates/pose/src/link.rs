//! Byte links whose waits are short: TCP, UDP and serial lines, opened again after a loss.

use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serialport::SerialPort;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket};
use tokio::task::spawn_blocking;
use tokio::time::{sleep, timeout};

/// How long a read waits, so that requests go out in time, which are a second apart.
const READ_WAIT: Duration = Duration::from_millis(100);
/// Longest read of a serial line at once.
const LINE_PIECE_BYTES: usize = 4096;
/// A name server that does not answer is waited for so long.
const RESOLVE_LIMIT: Duration = Duration::from_secs(30);
const CONNECT_LIMIT: Duration = Duration::from_secs(2);
const WRITE_LIMIT: Duration = Duration::from_secs(1);
/// Pauses between attempts: doubled from the first to the last, back to the first once something
/// intact was heard.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
const LAST_PAUSE: Duration = Duration::from_secs(5);

/// Where bytes come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Address {
    Tcp(String),
    /// Waits for whoever sends, and answers the one heard last.
    UdpIn(String),
    /// Sends first.
    UdpOut(String),
    Serial {
        path: PathBuf,
        baudrate: u32,
    },
}

impl Address {
    pub(crate) async fn open(&self) -> io::Result<Link> {
        match self {
            Self::Tcp(address) => tcp(address).await.map(Link::Tcp),
            Self::UdpIn(address) => {
                let socket = UdpSocket::bind(resolve(address).await?.as_slice()).await?;
                Ok(Link::udp(socket, None))
            }
            Self::UdpOut(address) => {
                let found = resolve(address).await?.into_iter().next();
                let peer = found.ok_or_else(no_address)?;
                let any = if peer.is_ipv4() {
                    "0.0.0.0:0"
                } else {
                    "[::]:0"
                };
                Ok(Link::udp(UdpSocket::bind(any).await?, Some(peer)))
            }
            Self::Serial { path, baudrate } => {
                let name = path.to_string_lossy();
                let port = serialport::new(name.as_ref(), *baudrate).timeout(READ_WAIT);
                let opened = off_the_workers(move || Ok(port.open()?)).await;
                opened.map(|port| Link::Serial(Arc::new(Mutex::new(port))))
            }
        }
    }

    /// In words, for the status.
    pub(crate) fn name(&self) -> String {
        match self {
            Self::Tcp(address) => format!("TCP {address}"),
            Self::UdpIn(address) => format!("UDP {address}"),
            Self::UdpOut(address) => format!("UDP to {address}"),
            Self::Serial { path, baudrate } => format!("{} at {baudrate} baud", path.display()),
        }
    }
}

async fn resolve(address: &str) -> io::Result<Vec<SocketAddr>> {
    let found = within(RESOLVE_LIMIT, tokio::net::lookup_host(address)).await;
    found.map(Iterator::collect)
}

fn no_address() -> io::Error {
    io::Error::new(ErrorKind::NotFound, "the name has no address")
}

async fn tcp(address: &str) -> io::Result<TcpStream> {
    let mut failure = no_address();
    for address in resolve(address).await? {
        match within(CONNECT_LIMIT, TcpStream::connect(address)).await {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                return Ok(stream);
            }
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// What takes longer has failed.
async fn within<T>(limit: Duration, work: impl Future<Output = io::Result<T>>) -> io::Result<T> {
    let late = |_| Err(io::Error::new(ErrorKind::TimedOut, "it took too long"));
    timeout(limit, work).await.unwrap_or_else(late)
}

/// What blocks is done on a thread of the runtime's that is there for that.
async fn off_the_workers<T: Send + 'static>(
    work: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> io::Result<T> {
    let done = spawn_blocking(work).await;
    done.unwrap_or_else(|failed| Err(io::Error::other(failed)))
}

type Line = Arc<Mutex<Box<dyn SerialPort>>>;

async fn on_line<T: Send + 'static>(
    line: &Line,
    work: impl FnOnce(&mut dyn SerialPort) -> io::Result<T> + Send + 'static,
) -> io::Result<T> {
    let line = Arc::clone(line);
    off_the_workers(move || work(&mut **line.lock().unwrap_or_else(PoisonError::into_inner))).await
}

/// An open link.
pub(crate) enum Link {
    Tcp(TcpStream),
    Udp {
        socket: UdpSocket,
        /// Whom to answer.
        peer: Option<SocketAddr>,
        /// Whether the peer is the one who sent last.
        learns: bool,
    },
    Serial(Line),
}

impl Link {
    fn udp(socket: UdpSocket, peer: Option<SocketAddr>) -> Self {
        let learns = peer.is_none();
        Self::Udp {
            socket,
            peer,
            learns,
        }
    }

    /// What came within a short while; 0 if nothing did.
    ///
    /// # Errors
    /// If the link is lost.
    pub(crate) async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => ended(timeout(READ_WAIT, stream.read(buffer)).await.ok()),
            Self::Serial(line) => {
                let most = buffer.len().min(LINE_PIECE_BYTES);
                let piece = on_line(line, move |port| {
                    let mut piece = vec![0; most];
                    let count = ended(came(port.read(&mut piece)))?;
                    piece.truncate(count);
                    Ok(piece)
                });
                let piece = piece.await?;
                buffer[..piece.len()].copy_from_slice(&piece);
                Ok(piece.len())
            }
            Self::Udp {
                socket,
                peer,
                learns,
            } => match timeout(READ_WAIT, socket.recv_from(buffer)).await {
                Ok(Ok((count, from))) => {
                    if *learns {
                        *peer = Some(from);
                    }
                    Ok(count)
                }
                // Nobody listens at the peer's port yet.
                Ok(Err(error)) if error.kind() == ErrorKind::ConnectionRefused => Ok(0),
                Ok(Err(error)) => Err(error),
                Err(_) => Ok(0),
            },
        }
    }

    /// Sends; over UDP only if it is known where to.
    ///
    /// # Errors
    /// If the link is lost.
    pub(crate) async fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => within(WRITE_LIMIT, stream.write_all(bytes)).await,
            Self::Serial(line) => {
                let bytes = bytes.to_vec();
                match on_line(line, move |port| port.write_all(&bytes)).await {
                    // A line that takes nothing for a while loses a request, which is sent again.
                    Err(error) if error.kind() == ErrorKind::TimedOut => Ok(()),
                    result => result,
                }
            }
            Self::Udp { socket, peer, .. } => {
                if let Some(peer) = peer {
                    // Nobody there, or no way there: asked again in a second.
                    let _ = socket.send_to(bytes, *peer).await;
                }
                Ok(())
            }
        }
    }
}

/// `None` if nothing came in time.
fn came(result: io::Result<usize>) -> Option<io::Result<usize>> {
    use ErrorKind::{Interrupted, TimedOut, WouldBlock};
    let is_nothing =
        |error: &io::Error| matches!(error.kind(), WouldBlock | TimedOut | Interrupted);
    match result {
        Err(error) if is_nothing(&error) => None,
        result => Some(result),
    }
}

/// A stream that gives nothing at once has ended.
fn ended(received: Option<io::Result<usize>>) -> io::Result<usize> {
    match received.transpose()? {
        Some(0) => Err(io::Error::new(
            ErrorKind::ConnectionAborted,
            "closed by the other end",
        )),
        Some(count) => Ok(count),
        None => Ok(0),
    }
}

/// Pauses that grow while nothing intact is heard.
#[derive(Debug)]
pub(crate) struct BackOff(Duration);

impl Default for BackOff {
    fn default() -> Self {
        Self(FIRST_PAUSE)
    }
}

impl BackOff {
    /// Something intact was heard.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    pub(crate) async fn wait(&mut self) {
        let pause = self.0;
        self.0 = (pause * 2).min(LAST_PAUSE);
        sleep(pause).await;
    }
}
