//! UDP: a socket connected to its device, so that the system lets nobody else in.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::time::Duration;

use super::{READ_WAIT, Received, Transport, received};

pub(super) struct Udp(UdpSocket);

pub(super) fn open(address: &str, timeout: Duration) -> io::Result<Udp> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
    for address in address.to_socket_addrs()? {
        let any = match address {
            SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0)),
            SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
        };
        let connected = UdpSocket::bind(any).and_then(|socket| {
            socket.connect(address)?;
            socket.set_read_timeout(Some(READ_WAIT))?;
            socket.set_write_timeout(Some(timeout))?;
            Ok(Udp(socket))
        });
        match connected {
            Ok(udp) => return Ok(udp),
            Err(error) => last = error,
        }
    }
    Err(last)
}

impl Transport for Udp {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<Received> {
        match self.0.recv(buffer) {
            // An empty datagram is no end.
            Ok(0) => Ok(Received::Nothing),
            result => received(result),
        }
    }

    fn write(&mut self, frame: &[u8]) -> io::Result<()> {
        self.0.send(frame).map(|_| ())
    }

    fn opens_connected(&self) -> bool {
        false
    }
}
