//! The device over UDP: clients are known by their last request.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::ServeStatus;
use super::client::Requests;
use super::port::{Asked, Port};

const MAX_CLIENTS: usize = 8;
/// A client that has asked nothing for so long is forgotten if another has asked since. The last
/// one is kept: a client asks once and then only listens.
const FORGET: Duration = Duration::from_secs(60);
const DATAGRAM_BYTES: usize = 65_536;

pub(super) struct Udp {
    socket: UdpSocket,
    clients: Vec<Known>,
    buffer: Vec<u8>,
    is_full: bool,
}

struct Known {
    address: SocketAddr,
    requests: Requests,
    asked: Instant,
}

impl Udp {
    pub(super) fn bind(address: &str) -> io::Result<Self> {
        let socket = UdpSocket::bind(address)?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            clients: Vec::new(),
            buffer: vec![0; DATAGRAM_BYTES],
            is_full: false,
        })
    }

    /// Index of the client at `address`; the one that asked longest ago makes room for a new one.
    fn client_at(&mut self, address: SocketAddr, status: &mut ServeStatus) -> usize {
        let known = self.clients.iter().position(|c| c.address == address);
        if let Some(index) = known {
            return index;
        }
        if self.clients.len() >= MAX_CLIENTS {
            let oldest = (0..self.clients.len()).min_by_key(|&i| self.clients[i].asked);
            self.clients.swap_remove(oldest.unwrap_or(0));
        }
        status.clients_seen += 1;
        self.clients.push(Known {
            address,
            requests: Requests::new(),
            asked: Instant::now(),
        });
        self.clients.len() - 1
    }

    fn forget_silent(&mut self) {
        let newest = self.clients.iter().map(|client| client.asked).max();
        self.clients
            .retain(|client| Some(client.asked) == newest || client.asked.elapsed() < FORGET);
    }

    fn send(&mut self, frame: &[u8], address: SocketAddr, status: &mut ServeStatus) {
        match self.socket.send_to(frame, address) {
            Ok(_) => {
                status.frames_sent += 1;
                self.is_full = false;
            }
            Err(error) => {
                status.frames_dropped += 1;
                self.is_full = error.kind() == ErrorKind::WouldBlock;
            }
        }
    }
}

impl Port for Udp {
    fn url(&self) -> String {
        match self.socket.local_addr() {
            Ok(address) => format!("udp://{address}"),
            Err(_) => "udp://".to_owned(),
        }
    }

    fn serve(&mut self, asked: &mut Asked<'_>, status: &mut ServeStatus) -> bool {
        self.is_full = false;
        let mut was_busy = false;
        // Bounded, so that a flood of requests does not stop the profiles.
        for _ in 0..64 {
            let mut buffer = std::mem::take(&mut self.buffer);
            let received = self.socket.recv_from(&mut buffer);
            let mut answers = Vec::new();
            if let Ok((byte_count, address)) = received {
                let requests_before = status.requests;
                let index = self.client_at(address, status);
                let client = &mut self.clients[index];
                let bytes = &buffer[..byte_count];
                client.requests.take(bytes, asked, status, &mut answers);
                match status.requests > requests_before {
                    true => client.asked = Instant::now(),
                    // Who sends what is no request is no client.
                    false => drop(self.clients.swap_remove(index)),
                }
                if !answers.is_empty() {
                    self.send(&answers, address, status);
                }
            }
            self.buffer = buffer;
            match received {
                Ok(_) => was_busy = true,
                // Of a client that is gone; not of this socket.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
                Err(_) => break,
            }
        }
        self.forget_silent();
        status.clients = self.clients.len() as u64;
        was_busy
    }

    fn broadcast(&mut self, frame: &[u8], status: &mut ServeStatus) {
        for index in 0..self.clients.len() {
            let address = self.clients[index].address;
            self.send(frame, address, status);
        }
    }

    fn flush(&mut self) {}

    fn is_ready(&self) -> bool {
        !self.clients.is_empty() && !self.is_full
    }

    fn has_waiting(&self) -> bool {
        false
    }
}
