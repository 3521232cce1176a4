//! The device for any number of TCP clients, up to a bound.

use std::io;
use std::net::{TcpListener, TcpStream};

use super::ServeStatus;
use super::client::Client;
use super::port::{Asked, Port};

const MAX_CLIENTS: usize = 16;
const CHUNK_BYTES: usize = 64 * 1024;

pub(super) struct Tcp {
    listener: TcpListener,
    clients: Vec<Client<TcpStream>>,
}

impl Tcp {
    pub(super) fn bind(address: &str) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            listener,
            clients: Vec::new(),
        })
    }

    fn accept(&mut self, status: &mut ServeStatus) {
        // An error here concerns one connection attempt; the next is as good as the last.
        while let Ok((stream, _)) = self.listener.accept() {
            let prepared = stream
                .set_nonblocking(true)
                .and_then(|()| stream.set_nodelay(true));
            if prepared.is_ok() && self.clients.len() < MAX_CLIENTS {
                status.clients_seen += 1;
                self.clients.push(Client::new(stream, CHUNK_BYTES));
            }
        }
    }
}

impl Port for Tcp {
    fn url(&self) -> String {
        match self.listener.local_addr() {
            Ok(address) => format!("tcp://{address}"),
            Err(_) => "tcp://".to_owned(),
        }
    }

    fn serve(&mut self, asked: &mut Asked<'_>, status: &mut ServeStatus) -> bool {
        self.accept(status);
        let mut was_busy = false;
        self.clients
            .retain_mut(|client| match client.serve(asked, status) {
                Ok(busy) => {
                    was_busy |= busy;
                    true
                }
                Err(_) => false,
            });
        status.clients = self.clients.len() as u64;
        was_busy
    }

    fn broadcast(&mut self, frame: &[u8], status: &mut ServeStatus) {
        for client in &mut self.clients {
            client.push(frame, status);
        }
    }

    fn flush(&mut self) {
        self.clients.retain_mut(|client| client.flush().is_ok());
    }

    fn is_ready(&self) -> bool {
        !self.clients.is_empty() && self.clients.iter().all(Client::is_ready)
    }

    fn has_waiting(&self) -> bool {
        self.clients.iter().any(Client::has_waiting)
    }
}
