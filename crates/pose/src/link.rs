//! Byte links that never block for long: TCP, UDP and serial lines, opened again after a loss.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::path::PathBuf;
use std::time::Duration;

use serialport::SerialPort;

use crate::stop::Stop;

/// How long a read waits, so that a thread sees its stop and its timers.
const READ_WAIT: Duration = Duration::from_millis(20);
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
    pub(crate) fn open(&self) -> io::Result<Link> {
        match self {
            Self::Tcp(address) => tcp(address).map(Link::Tcp),
            Self::UdpIn(address) => Link::udp(UdpSocket::bind(resolve(address)?.as_slice())?, None),
            Self::UdpOut(address) => {
                let peer = first(address)?;
                let any = if peer.is_ipv4() {
                    "0.0.0.0:0"
                } else {
                    "[::]:0"
                };
                Link::udp(UdpSocket::bind(any)?, Some(peer))
            }
            Self::Serial { path, baudrate } => {
                let name = path.to_string_lossy();
                let port = serialport::new(name.as_ref(), *baudrate).timeout(READ_WAIT);
                Ok(Link::Serial(port.open().map_err(io::Error::from)?))
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

fn resolve(address: &str) -> io::Result<Vec<SocketAddr>> {
    Ok(address.to_socket_addrs()?.collect())
}

fn first(address: &str) -> io::Result<SocketAddr> {
    let found = resolve(address)?.into_iter().next();
    found.ok_or_else(|| io::Error::new(ErrorKind::NotFound, "the name has no address"))
}

fn tcp(address: &str) -> io::Result<TcpStream> {
    let mut failure = io::Error::new(ErrorKind::NotFound, "the name has no address");
    for address in resolve(address)? {
        match TcpStream::connect_timeout(&address, CONNECT_LIMIT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(READ_WAIT))?;
                stream.set_write_timeout(Some(WRITE_LIMIT))?;
                return Ok(stream);
            }
            Err(error) => failure = error,
        }
    }
    Err(failure)
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
    Serial(Box<dyn SerialPort>),
}

impl Link {
    fn udp(socket: UdpSocket, peer: Option<SocketAddr>) -> io::Result<Self> {
        socket.set_read_timeout(Some(READ_WAIT))?;
        let learns = peer.is_none();
        Ok(Self::Udp {
            socket,
            peer,
            learns,
        })
    }

    /// What came within a short while; 0 if nothing did.
    ///
    /// # Errors
    /// If the link is lost.
    pub(crate) fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => ended(received(stream.read(buffer))),
            Self::Serial(port) => ended(received(port.read(buffer))),
            Self::Udp {
                socket,
                peer,
                learns,
            } => match socket.recv_from(buffer) {
                Ok((count, from)) => {
                    if *learns {
                        *peer = Some(from);
                    }
                    Ok(count)
                }
                // Nobody listens at the peer's port yet.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => Ok(0),
                Err(error) => Ok(received(Err(error))?.unwrap_or(0)),
            },
        }
    }

    /// Sends; over UDP only if it is known where to.
    ///
    /// # Errors
    /// If the link is lost.
    pub(crate) fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => stream.write_all(bytes),
            Self::Serial(port) => match port.write_all(bytes) {
                // A line that takes nothing for a while loses a request, which is sent again.
                Err(error) if error.kind() == ErrorKind::TimedOut => Ok(()),
                result => result,
            },
            Self::Udp { socket, peer, .. } => {
                if let Some(peer) = peer {
                    // Nobody there, or no way there: asked again in a second.
                    let _ = socket.send_to(bytes, *peer);
                }
                Ok(())
            }
        }
    }
}

/// `None` if nothing came in time.
fn received(result: io::Result<usize>) -> io::Result<Option<usize>> {
    match result {
        Ok(count) => Ok(Some(count)),
        Err(error) => match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => Ok(None),
            _ => Err(error),
        },
    }
}

/// A stream that gives nothing at once has ended.
fn ended(received: io::Result<Option<usize>>) -> io::Result<usize> {
    match received? {
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

    /// Waits; says whether the stop came.
    pub(crate) fn wait(&mut self, stop: &Stop) -> bool {
        let pause = self.0;
        self.0 = (pause * 2).min(LAST_PAUSE);
        stop.wait(pause)
    }
}
