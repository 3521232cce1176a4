//! HTTP and WebSocket (RFC 6455) as far as the tests need them, over plain sockets, so that requests can
//! be wrong too.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

/// Longest wait for an answer.
const ANSWER: Duration = Duration::from_secs(20);

/// An answer.
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n")?;
        let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let status = head.split(' ').nth(1)?.parse().ok()?;
        let body = &bytes[end + 4..];
        let is_chunked = head
            .to_ascii_lowercase()
            .contains("transfer-encoding: chunked");
        let body = if is_chunked {
            dechunked(body)
        } else {
            body.to_vec()
        };
        Some(Self { status, head, body })
    }
}

fn dechunked(mut rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    while let Some(end) = rest.windows(2).position(|two| two == b"\r\n") {
        let length = std::str::from_utf8(&rest[..end]).ok();
        let length = length.and_then(|text| usize::from_str_radix(text, 16).ok());
        let Some(length @ 1..) = length else { break };
        body.extend_from_slice(&rest[end + 2..end + 2 + length]);
        rest = &rest[end + 4 + length..];
    }
    body
}

/// Asks and reads until the other end closes.
pub(crate) fn ask(port: u16, method: &str, path: &str, headers: &[(&str, &str)]) -> Answer {
    let mut request = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\n");
    if !headers.iter().any(|(name, _)| *name == "Host") {
        request += &format!("Host: 127.0.0.1:{port}\r\n");
    }
    for (name, value) in headers {
        request += &format!("{name}: {value}\r\n");
    }
    let bytes = raw(port, (request + "\r\n").as_bytes());
    Answer::parse(&bytes).unwrap_or_else(|| {
        let said = String::from_utf8_lossy(&bytes);
        panic!("{method} {path}: no answer but {said:?}")
    })
}

/// Sends these bytes and reads whatever comes until the other end closes, or a second has passed
/// without a byte.
pub(crate) fn raw(port: u16, bytes: &[u8]) -> Vec<u8> {
    let mut stream = connect(port, ANSWER);
    // It may have been closed for what came first.
    let _ = stream.write_all(bytes);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    answer
}

/// The same, saying that nothing more will come.
pub(crate) fn raw_and_end(port: u16, bytes: &[u8]) -> Vec<u8> {
    let mut stream = connect(port, Duration::from_secs(1));
    let _ = stream.write_all(bytes);
    let _ = stream.shutdown(Shutdown::Write);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    answer
}

fn connect(port: u16, patience: Duration) -> TcpStream {
    let stream = TcpStream::connect(("127.0.0.1", port)).expect("the page is served");
    stream
        .set_read_timeout(Some(patience))
        .expect("a positive limit");
    stream
}

/// A message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Message {
    Text(String),
    Binary(Vec<u8>),
    Closed,
}

/// One end of a WebSocket.
pub(crate) struct WebSocket {
    stream: TcpStream,
    read: Vec<u8>,
}

impl WebSocket {
    /// Opens it; `Err` is the status of a refusal.
    pub(crate) fn open(port: u16, path: &str, headers: &[(&str, &str)]) -> Result<Self, u16> {
        let mut stream = connect(port, ANSWER);
        let mut request = format!(
            "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n\
             Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
             Sec-WebSocket-Version: 13\r\n"
        );
        for (name, value) in headers {
            request += &format!("{name}: {value}\r\n");
        }
        stream
            .write_all((request + "\r\n").as_bytes())
            .expect("it listens");
        let mut read = Vec::new();
        let mut byte = [0];
        while !read.ends_with(b"\r\n\r\n") && stream.read(&mut byte).is_ok_and(|count| count == 1) {
            read.push(byte[0]);
        }
        let answer = Answer::parse(&read).ok_or(0_u16)?;
        if answer.status != 101 {
            return Err(answer.status);
        }
        let read = Vec::new();
        Ok(Self { stream, read })
    }

    /// The next message, or `None` if none comes in time. Pings are answered.
    pub(crate) fn next(&mut self, within: Duration) -> Option<Message> {
        let deadline = Instant::now() + within;
        let mut whole = Vec::new();
        let mut first_kind = 0;
        loop {
            let (is_last, kind, payload) = self.frame(deadline)?;
            match kind {
                8 => return Some(Message::Closed),
                9 => self.send(10, &payload),
                10 => {}
                _ => {
                    first_kind = if kind == 0 { first_kind } else { kind };
                    whole.extend(payload);
                    if is_last {
                        break;
                    }
                }
            }
        }
        Some(match first_kind {
            1 => Message::Text(String::from_utf8(whole).expect("text is UTF-8")),
            _ => Message::Binary(whole),
        })
    }

    fn frame(&mut self, deadline: Instant) -> Option<(bool, u8, Vec<u8>)> {
        let head = self.peek(2, deadline)?;
        let (is_last, kind) = (head[0] & 0x80 != 0, head[0] & 0x0f);
        let (extra, length) = match head[1] & 0x7f {
            126 => (
                2,
                u64::from(u16::from_be_bytes(
                    self.peek(4, deadline)?[2..4].try_into().ok()?,
                )),
            ),
            127 => (
                8,
                u64::from_be_bytes(self.peek(10, deadline)?[2..10].try_into().ok()?),
            ),
            short => (0, u64::from(short)),
        };
        let (start, length) = (2 + extra, usize::try_from(length).ok()?);
        let payload = self.peek(start + length, deadline)?[start..].to_vec();
        self.read.drain(..start + length);
        Some((is_last, kind, payload))
    }

    /// The first bytes that were not taken yet.
    fn peek(&mut self, count: usize, deadline: Instant) -> Option<&[u8]> {
        let mut block = vec![0; 1 << 16];
        while self.read.len() < count {
            let left = deadline.checked_duration_since(Instant::now())?;
            let limit = left.max(Duration::from_millis(1));
            self.stream
                .set_read_timeout(Some(limit))
                .expect("a positive limit");
            match self.stream.read(&mut block) {
                Ok(0) => return None,
                Ok(read) => self.read.extend_from_slice(&block[..read]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return None,
            }
        }
        Some(&self.read[..count])
    }

    pub(crate) fn send_text(&mut self, text: &str) {
        self.send(1, text.as_bytes());
    }

    /// A frame with a mask of zeros.
    fn send(&mut self, kind: u8, payload: &[u8]) {
        let mut frame = vec![0x80 | kind];
        match payload.len() {
            length @ 0..=125 => frame.push(0x80 | length as u8),
            length @ 126..=65_535 => {
                frame.push(0x80 | 126);
                frame.extend((length as u16).to_be_bytes());
            }
            length => {
                frame.push(0x80 | 127);
                frame.extend((length as u64).to_be_bytes());
            }
        }
        frame.extend([0; 4]);
        frame.extend(payload);
        // Who has gone is seen when reading.
        let _ = self.stream.write_all(&frame);
    }

    /// Bytes that are no frame.
    pub(crate) fn send_raw(&mut self, bytes: &[u8]) {
        let _ = self.stream.write_all(bytes);
    }
}
