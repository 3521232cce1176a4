//! TCP, as a real `OmniScan` 450 FS offers it on port 51200.

use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use super::{READ_WAIT, Received, Transport, received};

pub(super) struct Tcp(TcpStream);

/// Tries every address the name has.
pub(super) fn open(address: &str, timeout: Duration) -> io::Result<Tcp> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, timeout) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(READ_WAIT))?;
                stream.set_write_timeout(Some(timeout))?;
                return Ok(Tcp(stream));
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}

impl Transport for Tcp {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<Received> {
        received(self.0.read(buffer))
    }

    fn write(&mut self, frame: &[u8]) -> io::Result<()> {
        self.0.write_all(frame)
    }

    fn connection(&self) -> Option<TcpStream> {
        self.0.try_clone().ok()
    }
}
