//! UDP: a socket connected to its device, so that the system lets nobody else in.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};

use bytes::Bytes;
use tokio::net::UdpSocket;

use super::{no_address, resolve};
use crate::intake::Intake;

#[derive(Debug)]
pub(crate) struct Udp {
    socket: UdpSocket,
    intake: Intake,
}

pub(super) async fn open(address: &str) -> io::Result<Udp> {
    let mut last = no_address();
    for address in resolve(address).await? {
        match connected(address).await {
            Ok(socket) => {
                return Ok(Udp {
                    socket,
                    intake: Intake::default(),
                });
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}

async fn connected(address: SocketAddr) -> io::Result<UdpSocket> {
    let any = match address {
        SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0)),
        SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
    };
    let socket = UdpSocket::bind(any).await?;
    socket.connect(address).await?;
    Ok(socket)
}

impl Udp {
    pub(super) async fn read(&mut self) -> io::Result<Bytes> {
        loop {
            let byte_count = self.socket.recv(self.intake.room()).await?;
            // An empty datagram is no end.
            if byte_count > 0 {
                return Ok(self.intake.take(byte_count));
            }
        }
    }

    pub(super) async fn write(&mut self, frame: &[u8]) -> io::Result<()> {
        // A datagram is taken at once, or dropped.
        self.socket.send(frame).await.map(|_| ())
    }
}
