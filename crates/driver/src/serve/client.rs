//! One client on a stream of bytes: its requests in, its frames out.

use std::io::{self, ErrorKind, Read, Write};
use std::time::{Duration, Instant};

use echosplat_firmware_protocol::{Decoder, Event};

use super::ServeStatus;
use super::outbox::Outbox;
use super::port::Asked;

/// Requests have at most some dozen bytes.
const READ_BYTES: usize = 4096;
/// A half request that has not grown for so long will not be completed.
const HALF_FRAME: Duration = Duration::from_millis(250);

/// Finds requests in one client's bytes.
pub(super) struct Requests {
    decoder: Box<Decoder>,
    heard: Instant,
}

impl Requests {
    pub(super) fn new() -> Self {
        Self {
            decoder: Box::default(),
            heard: Instant::now(),
        }
    }

    /// Hands each whole frame in `bytes` to the device; appends its answers to `answers`.
    pub(super) fn take(
        &mut self,
        bytes: &[u8],
        asked: &mut Asked<'_>,
        status: &mut ServeStatus,
        answers: &mut Vec<u8>,
    ) {
        let mut handle = |event: Event<'_>| {
            if let Event::Frame(frame) = event {
                status.requests += 1;
                asked.device.receive(frame.bytes(), asked.now, answers);
            }
        };
        if bytes.is_empty() {
            let is_stuck = self.decoder.pending_byte_count() > 0;
            if is_stuck && self.heard.elapsed() > HALF_FRAME {
                self.decoder.expire(&mut handle);
            }
            return;
        }
        self.heard = Instant::now();
        self.decoder.feed(bytes, &mut handle);
    }
}

/// One client on a stream that neither reads nor writes wait.
pub(super) struct Client<S> {
    stream: S,
    requests: Requests,
    outbox: Outbox,
    /// Most bytes written at once.
    chunk_bytes: usize,
}

impl<S: Read + Write> Client<S> {
    pub(super) fn new(stream: S, chunk_bytes: usize) -> Self {
        Self {
            stream,
            requests: Requests::new(),
            outbox: Outbox::default(),
            chunk_bytes,
        }
    }

    /// Reads what is there and answers it; says whether anything was. An error is its end.
    pub(super) fn serve(
        &mut self,
        asked: &mut Asked<'_>,
        status: &mut ServeStatus,
    ) -> io::Result<bool> {
        let mut buffer = [0; READ_BYTES];
        let byte_count = match self.stream.read(&mut buffer) {
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(byte_count) => byte_count,
            Err(error) => match error.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => 0,
                _ => return Err(error),
            },
        };
        let mut answers = Vec::new();
        let bytes = &buffer[..byte_count];
        self.requests.take(bytes, asked, status, &mut answers);
        if !answers.is_empty() {
            self.push(&answers, status);
        }
        Ok(byte_count > 0)
    }

    pub(super) fn push(&mut self, frame: &[u8], status: &mut ServeStatus) {
        match self.outbox.push(frame) {
            true => status.frames_sent += 1,
            false => status.frames_dropped += 1,
        }
    }

    /// Writes what the client takes without waiting. An error is its end.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.outbox.flush(&mut self.stream, self.chunk_bytes)
    }

    pub(super) fn is_ready(&self) -> bool {
        self.outbox.is_ready()
    }

    pub(super) fn has_waiting(&self) -> bool {
        !self.outbox.is_empty()
    }
}
