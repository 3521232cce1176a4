//! Who answers a call to everybody: `Discovery`, broadcast over UDP to port 30303, as documented
//! for sister products.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

const CALL: &[u8] = b"Discovery";
const CALL_EVERY: Duration = Duration::from_millis(500);
const READ_WAIT: Duration = Duration::from_millis(50);
/// Answers are lines of text; so much of each is shown.
const SHOWN_CHARS: usize = 200;
const MOST_ANSWERS: usize = 32;

/// One that answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Discovered {
    /// Its address.
    pub address: IpAddr,
    /// What it said, in one line, cut, with control characters escaped.
    pub text: String,
}

/// What came of the call.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Discovery {
    /// Who answered, each once.
    pub answers: Vec<Discovered>,
    /// What was in the way, if something was: the call may have gone out all the same.
    pub trouble: Option<String>,
}

/// Calls `to` (the network's broadcast address and port 30303) and listens for so long.
#[must_use]
pub fn discover(to: SocketAddr, limit: Duration) -> Discovery {
    let (socket, trouble) = match bind(to.port()) {
        Ok(bound) => bound,
        Err(error) => {
            return Discovery {
                trouble: Some(format!("no UDP socket: {error}")),
                ..Discovery::default()
            };
        }
    };
    let mut discovery = Discovery {
        trouble,
        ..Discovery::default()
    };
    if let Err(error) = listen(&socket, to, limit, &mut discovery.answers) {
        discovery.trouble = Some(format!("the call to {to} failed: {error}"));
    }
    discovery
}

/// On the port that is called, where answers may go too; else on any, and words that say so.
fn bind(port: u16) -> io::Result<(UdpSocket, Option<String>)> {
    let any = Ipv4Addr::UNSPECIFIED;
    let (socket, trouble) = match UdpSocket::bind((any, port)) {
        Ok(socket) => (socket, None),
        Err(error) => {
            let words = format!(
                "port {port} is in use by another program ({error}); answers sent to that port \
                 are not heard here"
            );
            (UdpSocket::bind((any, 0))?, Some(words))
        }
    };
    socket.set_broadcast(true)?;
    socket.set_read_timeout(Some(READ_WAIT))?;
    Ok((socket, trouble))
}

fn listen(
    socket: &UdpSocket,
    to: SocketAddr,
    limit: Duration,
    answers: &mut Vec<Discovered>,
) -> io::Result<()> {
    let began = Instant::now();
    let mut calls = 0;
    let mut buffer = [0; 2048];
    while began.elapsed() < limit && answers.len() < MOST_ANSWERS {
        if began.elapsed() >= CALL_EVERY * calls {
            socket.send_to(CALL, to)?;
            calls += 1;
        }
        // Nothing yet, or word of an address where nobody is: others may still answer.
        let Ok((byte_count, from)) = socket.recv_from(&mut buffer) else {
            continue;
        };
        let said = &buffer[..byte_count];
        let is_new = answers.iter().all(|known| known.address != from.ip());
        if said != CALL && is_new {
            answers.push(Discovered {
                address: from.ip(),
                text: one_line(said),
            });
        }
    }
    Ok(())
}

fn one_line(said: &[u8]) -> String {
    let text = String::from_utf8_lossy(said);
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let shown = words.chars().take(SHOWN_CHARS);
    shown.flat_map(char::escape_debug).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_answers_is_found_and_a_port_in_use_is_said() {
        let unit = UdpSocket::bind("127.0.0.1:0").unwrap();
        let to = unit.local_addr().unwrap();
        let taken = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, to.port()));
        let answering = std::thread::spawn(move || {
            let mut call = [0; 100];
            let (byte_count, from) = unit.recv_from(&mut call).unwrap();
            assert_eq!(&call[..byte_count], CALL);
            unit.send_to(b"OmniScan 450\r\nMAC 00:11\x1b[2J", from)
                .unwrap();
        });
        let discovery = discover(to, Duration::from_millis(600));
        answering.join().unwrap();
        assert!(taken.is_err());
        let trouble = discovery.trouble.unwrap();
        assert!(trouble.contains("in use"), "{trouble}");
        assert_eq!(discovery.answers.len(), 1);
        let text = &discovery.answers[0].text;
        assert!(
            text.starts_with("OmniScan 450 MAC") && !text.contains('\u{1b}'),
            "{text}"
        );
    }
}
