//! Why nobody is reached at the endpoints that the session connects to, while nobody is.
//!
//! zenoh tries them again by itself, and tells neither that nor why it failed. So each is tried from
//! here too, by a plain connection.

use std::io::ErrorKind;
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use echosplat_liveness::Heartbeat;
use serde::Serialize;

use crate::BusError;
use crate::bus::{Link, company, spawn};

/// How often it is looked whether somebody is connected.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// What answers later is of no use.
const ANSWERS_WITHIN: Duration = Duration::from_secs(1);
/// zenoh waits up to 4 s between two tries, so that a router which has just come is not taken for a stranger.
const LOOKS_BEFORE_ZENOH_TRIES: u32 = 6;
const STRANGER: &str = "something accepts connections there and does not answer as zenoh does: it is another program, or \
                        wants another name and password";

/// An endpoint at which nobody is reached.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Unreached {
    /// As it was given.
    pub endpoint: String,
    /// What is in the way.
    pub reason: String,
}

/// Looks now and then, until dropped.
#[derive(Debug)]
pub(crate) struct Reach {
    unreached: Arc<Mutex<Vec<Unreached>>>,
    heartbeat: Heartbeat,
    _stop: Sender<()>,
}

impl Reach {
    /// Of a session that is to connect to `endpoints`, those of its own left out.
    pub(crate) fn start(link: &Arc<Link>, endpoints: Vec<String>) -> Result<Self, BusError> {
        let unreached = Arc::new(Mutex::new(Vec::new()));
        let heartbeat = Heartbeat::new("bus-reach");
        let (stop, stopped) = bounded(0);
        if !endpoints.is_empty() {
            let (link, beats) = (Arc::downgrade(link), heartbeat.clone());
            let found = Arc::clone(&unreached);
            let look = move || look_until(&stopped, &link, &endpoints, &found, &beats);
            let beats = heartbeat.clone();
            spawn("bus-reach", move || beats.run_again(look))?;
        }
        Ok(Self {
            unreached,
            heartbeat,
            _stop: stop,
        })
    }

    /// Empty while anybody is connected, and before it was looked.
    pub(crate) fn unreached(&self) -> Vec<Unreached> {
        let unreached = self.unreached.lock();
        unreached.unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }
}

fn look_until(
    stopped: &Receiver<()>,
    link: &Weak<Link>,
    endpoints: &[String],
    found: &Mutex<Vec<Unreached>>,
    beats: &Heartbeat,
) {
    let mut wait = Duration::ZERO;
    let mut at: Vec<Place> = endpoints.iter().map(|to| Place::new(to)).collect();
    loop {
        // A name server may take its time.
        beats.rest();
        if !matches!(stopped.recv_timeout(wait), Err(RecvTimeoutError::Timeout)) {
            return;
        }
        wait = LOOK_EVERY;
        let Some(is_alone) = link.upgrade().map(|link| company(&link.session) == 0) else {
            return;
        };
        let now = match is_alone {
            true => at.iter_mut().map(Place::look).collect(),
            false => Vec::new(),
        };
        *found.lock().unwrap_or_else(PoisonError::into_inner) = now;
    }
}

/// An endpoint, and what was last in the way there.
struct Place {
    endpoint: String,
    reason: Option<String>,
    /// Looks in which it accepted connections.
    accepting: u32,
}

impl Place {
    fn new(endpoint: &str) -> Self {
        Self {
            endpoint: endpoint.to_owned(),
            reason: None,
            accepting: 0,
        }
    }

    fn look(&mut self) -> Unreached {
        let found = why(&self.endpoint);
        self.accepting = match found {
            None => self.accepting + 1,
            Some(_) => 0,
        };
        let is_about_to_answer = found.is_none() && self.accepting <= LOOKS_BEFORE_ZENOH_TRIES;
        if !is_about_to_answer || self.reason.is_none() {
            self.reason = Some(found.unwrap_or_else(|| STRANGER.to_owned()));
        }
        Unreached {
            endpoint: self.endpoint.clone(),
            reason: self.reason.clone().unwrap_or_default(),
        }
    }
}

/// Why no zenoh answers at `proto/host:port#options`; `None` if connections are accepted there.
fn why(endpoint: &str) -> Option<String> {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, rest)| rest);
    let address = address.split(['#', '?']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let addresses = match address.to_socket_addrs() {
        Ok(addresses) => addresses,
        Err(reason) => return Some(format!("the name {host} is not found: {reason}")),
    };
    let mut reason = format!("the name {host} has no address");
    for address in addresses {
        match TcpStream::connect_timeout(&address, ANSWERS_WITHIN) {
            Ok(_) => return None,
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
                reason = "connection refused: nothing listens there".to_owned();
            }
            Err(error) if error.kind() == ErrorKind::TimedOut => {
                reason = format!("no answer within {} s", ANSWERS_WITHIN.as_secs());
            }
            Err(error) => reason = error.to_string(),
        }
    }
    Some(reason)
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    fn place(endpoint: &str) -> Place {
        Place::new(endpoint)
    }

    #[test]
    fn what_is_in_the_way_is_named() {
        let held = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = held.local_addr().unwrap().port();
        let mut there = place(&format!("tcp/127.0.0.1:{port}#iface=lo"));
        assert!(there.look().reason.contains("another program"));
        drop(held);
        assert!(there.look().reason.contains("refused"));
        // One that has just come is about to answer.
        let held = TcpListener::bind(("127.0.0.1", port)).unwrap();
        for _ in 0..LOOKS_BEFORE_ZENOH_TRIES {
            assert!(there.look().reason.contains("refused"));
        }
        assert!(there.look().reason.contains("another program"));
        drop(held);
        let nowhere = place("tcp/no-such-host.invalid:7447").look().reason;
        assert!(nowhere.contains("no-such-host.invalid"), "{nowhere}");
        assert!(!place("nonsense").look().reason.is_empty());
    }
}
