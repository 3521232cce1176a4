//! Frames of `MAVLink` 1 and 2 in a stream of bytes, and messages as frames.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::sync::{Arc, Mutex, PoisonError};

use mavlink::dialects::ardupilotmega::MavMessage;
use mavlink::error::MessageReadError;
use mavlink::{MavHeader, MavlinkReader};

use super::message::{Message, Sender};

/// Bytes in, messages out; damaged frames are skipped by the crate's decoder.
pub(crate) struct Frames {
    reader: MavlinkReader<Queue>,
    queue: Queue,
    frame_count: u64,
}

/// Bytes that wait to be decoded, shared with the reader, which keeps its source to itself. Empty,
/// it says that more may come.
#[derive(Default, Clone)]
struct Queue(Arc<Mutex<VecDeque<u8>>>);

impl Read for Queue {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut bytes = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match bytes.is_empty() {
            true => Err(io::ErrorKind::WouldBlock.into()),
            false => bytes.read(buffer),
        }
    }
}

impl Frames {
    pub(crate) fn new() -> Self {
        let queue = Queue::default();
        Self {
            reader: MavlinkReader::new(queue.clone()),
            queue,
            frame_count: 0,
        }
    }

    /// Intact frames so far, of whatever message.
    pub(crate) fn frame_count(&self) -> u64 {
        self.frame_count
    }

    /// Takes what came and calls `take` for each message that poses need.
    pub(crate) fn feed(&mut self, bytes: &[u8], mut take: impl FnMut(Sender, Message)) {
        let queue = self.queue.0.lock();
        queue.unwrap_or_else(PoisonError::into_inner).extend(bytes);
        loop {
            match self.reader.read_any_message::<MavMessage>() {
                Ok((header, message)) => {
                    self.frame_count += 1;
                    let sender = Sender {
                        system: header.system_id,
                        component: header.component_id,
                    };
                    if let Some(message) = Message::of_mavlink(&message) {
                        take(sender, message);
                    }
                }
                // An enum's value that the dialect does not know; the frame is gone already.
                Err(MessageReadError::Parse(_)) => {}
                Err(MessageReadError::Io(_)) => return,
            }
        }
    }
}

/// A message as a frame of `MAVLink` 2.
pub(crate) fn frame(header: MavHeader, message: &MavMessage) -> Vec<u8> {
    let mut bytes = Vec::new();
    // Into memory, from a message of this dialect: this cannot fail.
    let _ = mavlink::write_v2_msg(&mut bytes, header, message);
    bytes
}
