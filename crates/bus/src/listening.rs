//! Which of the endpoints a session was told to listen on are really open.
//!
//! zenoh tells neither (in its stable interface) nor fails when an endpoint cannot be opened and
//! that is allowed. So each address is tried before the session is opened, and again after it:
//! what was free and is taken now, the session listens on.

use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, TcpListener, ToSocketAddrs, UdpSocket};
use std::sync::atomic::{AtomicU16, Ordering};

use crate::endpoints::NotListening;

/// An endpoint as it was before the session opened.
#[derive(Debug)]
pub(crate) struct Tried {
    endpoint: String,
    state: State,
}

#[derive(Debug)]
enum State {
    /// So many addresses of that name can be listened on; mostly one.
    Free(usize),
    Taken,
    Refused(String),
    /// Nothing can be tried: it takes whatever port is free.
    AnyPort,
}

/// Below the ports that systems give to connections of themselves, unless told otherwise: from 32,768 on (Linux), 49,152
/// (others).
const FIRST_PORT: u16 = 20_000;
const PORTS: u16 = 12_000;

/// A port of the loopback interface that nothing uses, TCP or UDP, and that stays so until it is listened on: the system
/// gives none of these to a connection, and this function gives each only once before it has given all.
///
/// # Errors
/// If none is free.
pub fn free_port() -> io::Result<u16> {
    static CHOSEN: AtomicU16 = AtomicU16::new(0);
    // Programs that run side by side begin at different ones.
    let first = (std::process::id() * 97 % u32::from(PORTS)) as u16;
    let is_free = |port: &u16| {
        TcpListener::bind((Ipv4Addr::LOCALHOST, *port)).is_ok()
            && UdpSocket::bind((Ipv4Addr::LOCALHOST, *port)).is_ok()
    };
    (0..PORTS)
        .map(|_| FIRST_PORT + first.wrapping_add(CHOSEN.fetch_add(1, Ordering::Relaxed)) % PORTS)
        .find(is_free)
        .ok_or_else(|| {
            io::Error::new(
                ErrorKind::AddrInUse,
                "no port of the loopback interface is free",
            )
        })
}

/// Tries every endpoint.
pub(crate) fn try_all(listen: &[String]) -> Vec<Tried> {
    let tried = |endpoint: &String| Tried {
        endpoint: endpoint.clone(),
        state: state_of(endpoint),
    };
    listen.iter().map(tried).collect()
}

/// Endpoints that another socket listened on already.
pub(crate) fn taken(tried: &[Tried]) -> Vec<String> {
    let is_taken = |tried: &&Tried| matches!(tried.state, State::Taken);
    let taken = tried.iter().filter(is_taken);
    taken.map(|tried| tried.endpoint.clone()).collect()
}

/// What the session listens on, and what not and why, now that it is open. `is_alone`: no other
/// zenoh is connected.
pub(crate) fn outcome(tried: Vec<Tried>, is_alone: bool) -> (Vec<String>, Vec<NotListening>) {
    let (mut open, mut not_open) = (Vec::new(), Vec::new());
    for Tried { endpoint, state } in tried {
        let reason = match state {
            State::AnyPort => None,
            State::Free(count) => why_still_closed(&endpoint, count),
            State::Taken if is_alone => Some("in use by a program that is no zenoh".to_owned()),
            State::Taken => Some("in use by another program".to_owned()),
            State::Refused(reason) => Some(reason),
        };
        match reason {
            None => open.push(endpoint),
            Some(reason) => not_open.push(NotListening { endpoint, reason }),
        }
    }
    (open, not_open)
}

fn why_still_closed(endpoint: &str, free_before: usize) -> Option<String> {
    match state_of(endpoint) {
        State::Free(count) if count >= free_before => Some("zenoh did not open it".to_owned()),
        State::Refused(reason) => Some(reason),
        State::Free(_) | State::Taken | State::AnyPort => None,
    }
}

fn state_of(endpoint: &str) -> State {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, rest)| rest);
    let address = address.split(['#', '?']).next().unwrap_or_default();
    if address.ends_with(":0") {
        return State::AnyPort;
    }
    let tried: Vec<io::Result<TcpListener>> = match address.to_socket_addrs() {
        Ok(addresses) => addresses.map(TcpListener::bind).collect(),
        Err(error) => vec![Err(error)],
    };
    let free = tried.iter().filter(|tried| tried.is_ok()).count();
    match tried.into_iter().find_map(Result::err) {
        _ if free > 0 => State::Free(free),
        Some(error) if error.kind() == ErrorKind::AddrInUse => State::Taken,
        Some(error) => State::Refused(words_for(&error)),
        None => State::Refused("its name stands for no address".to_owned()),
    }
}

fn words_for(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::AddrNotAvailable => "no interface of this machine has that address".to_owned(),
        ErrorKind::PermissionDenied => "no permission; ports above 1023 need none".to_owned(),
        _ => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn only(endpoint: &str, is_alone: bool) -> (Vec<String>, Vec<NotListening>) {
        outcome(try_all(&[endpoint.to_owned()]), is_alone)
    }

    #[test]
    fn a_free_port_is_given_once() {
        let ports: Vec<u16> = (0..20).map(|_| free_port().unwrap()).collect();
        for (i, port) in ports.iter().enumerate() {
            assert!((FIRST_PORT..FIRST_PORT + PORTS).contains(port), "{port}");
            assert!(!ports[..i].contains(port), "{port}");
        }
    }

    #[test]
    fn what_was_free_and_is_taken_now_is_open() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let endpoint = format!("tcp/{address}");
        drop(listener);
        let tried = try_all(std::slice::from_ref(&endpoint));
        let session = TcpListener::bind(address).unwrap();
        assert_eq!(outcome(tried, true), (vec![endpoint.clone()], vec![]));

        let (open, not_open) = only(&endpoint, false);
        assert_eq!(open, Vec::<String>::new());
        assert_eq!(not_open[0].reason, "in use by another program");
        drop(session);
        let (_, not_open) = only(&endpoint, true);
        assert_eq!(not_open[0].reason, "zenoh did not open it");
    }

    #[test]
    fn an_address_of_no_interface_is_told_as_such() {
        // TEST-NET-3 of RFC 5737: nobody has it.
        let (open, not_open) = only("tcp/203.0.113.9:7447#iface=lo", true);
        assert_eq!(open, Vec::<String>::new());
        assert!(not_open[0].reason.contains("no interface"), "{not_open:?}");
    }

    #[test]
    fn a_name_of_several_addresses_is_open_once_one_of_them_is() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        drop(listener);
        let endpoint = format!("tcp/localhost:{port}");
        let tried = try_all(std::slice::from_ref(&endpoint));
        let _session = TcpListener::bind(("127.0.0.1", port)).unwrap();
        assert_eq!(outcome(tried, true), (vec![endpoint], vec![]));
    }

    #[test]
    fn any_free_port_is_taken_as_open() {
        let (open, not_open) = only("tcp/[::]:0", true);
        assert_eq!((open.len(), not_open.len()), (1, 0));
    }
}
