//! Every message id with every payload length, checksum right.

use echosplat_firmware_protocol::{Decoder, Event, Message, id};

use crate::reference::length_is_allowed;

const MAX_PAYLOAD_BYTES: usize = 2500;

const TABLE_IDS: [u16; 18] = [
    id::NOP,
    id::ACK,
    id::NACK,
    id::ASCII_TEXT,
    id::DEVICE_INFORMATION,
    id::PROTOCOL_VERSION,
    id::GENERAL_REQUEST,
    id::JSON,
    id::VIEW_CONFIGURATION,
    id::SET_DEVICE_ID,
    id::NMEA,
    id::SET_SPEED_OF_SOUND,
    id::MAVLINK,
    id::SYNC_CHANNEL_NUMBER,
    id::SET_SYNC_CHANNEL_NUMBER,
    id::STATUS,
    id::OS_PING_PARAMS,
    id::OS_MONO_PROFILE,
];

/// Which payload lengths and values make a message, written out a second time.
fn is_message(message_id: u16, payload: &[u8]) -> bool {
    length_is_allowed(message_id, payload.len())
        && match message_id {
            id::SET_DEVICE_ID => payload[0] != 0 && payload[0] != 255,
            id::OS_PING_PARAMS => payload[32] <= 1,
            id::OS_MONO_PROFILE => result_count_fits(payload),
            _ => true,
        }
}

fn result_count_fits(payload: &[u8]) -> bool {
    52 + 2 * usize::from(u16::from_le_bytes([payload[22], payload[23]])) == payload.len()
}

/// A frame with a right checksum, whatever its id and length.
struct Candidate {
    bytes: Vec<u8>,
}

impl Candidate {
    fn new(message_id: u16, payload: &[u8]) -> Self {
        let mut bytes = b"BR".to_vec();
        bytes.extend((payload.len() as u16).to_le_bytes());
        bytes.extend(message_id.to_le_bytes());
        bytes.extend([1, 0]);
        bytes.extend(payload);
        let sum: u32 = bytes.iter().map(|&byte| u32::from(byte)).sum();
        bytes.extend((sum as u16).to_le_bytes());
        Self { bytes }
    }

    /// Makes it a frame of another id.
    fn set_message_id(&mut self, message_id: u16) {
        let at = self.bytes.len() - 2;
        let sum_of = |bytes: &[u8]| u16::from(bytes[4]) + u16::from(bytes[5]);
        let mut sum = u16::from_le_bytes([self.bytes[at], self.bytes[at + 1]]);
        sum = sum.wrapping_sub(sum_of(&self.bytes));
        self.bytes[4..6].copy_from_slice(&message_id.to_le_bytes());
        sum = sum.wrapping_add(sum_of(&self.bytes));
        self.bytes[at..].copy_from_slice(&sum.to_le_bytes());
    }

    /// Feeds it to `decoder` and holds what comes out against the tables.
    fn check(&self, decoder: &mut Decoder) {
        let payload = &self.bytes[8..self.bytes.len() - 2];
        let message_id = u16::from_le_bytes([self.bytes[4], self.bytes[5]]);
        let (mut parsed, mut frames, mut skipped_bytes) = (false, 0, 0);
        let mut sink = |event: Event<'_>| match event {
            Event::Frame(frame) => {
                frames += 1;
                assert_eq!(frame.bytes(), self.bytes);
                parsed = Message::parse(&frame).is_ok_and(|message| round_trips(&message));
            }
            Event::Skipped(skipped) => skipped_bytes += skipped.byte_count,
        };
        decoder.feed(&self.bytes, &mut sink);
        decoder.finish(&mut sink);
        let context = || format!("message {message_id} with {} payload bytes", payload.len());
        assert_eq!(parsed, is_message(message_id, payload), "{}", context());
        let is_frame = length_is_allowed(message_id, payload.len())
            && (message_id != id::OS_MONO_PROFILE || result_count_fits(payload));
        assert_eq!(frames, usize::from(is_frame), "{}", context());
        let lost = if is_frame { 0 } else { self.bytes.len() };
        assert_eq!(skipped_bytes, lost, "{}", context());
    }
}

/// Written, read and written again, the bytes stay the same. (Reserved bytes may differ from
/// those received, and NaN is not itself.)
fn round_trips(message: &Message<'_>) -> bool {
    let (mut first, mut second) = ([0; MAX_PAYLOAD_BYTES + 10], [0; MAX_PAYLOAD_BYTES + 10]);
    let byte_count = message.encode(1, 2, &mut first).unwrap();
    let payload = &first[8..byte_count - 2];
    let again = Message::parse_payload(message.id(), payload).unwrap();
    assert_eq!(again.encode(1, 2, &mut second), Ok(byte_count));
    assert_eq!(first[..byte_count], second[..byte_count]);
    byte_count == message.encoded_byte_count()
}

/// A payload of zeros, one of ones (NaN in every float, 65535 in every count), and one that says
/// what its length says.
fn payloads(message_id: u16, byte_count: usize) -> [Vec<u8>; 3] {
    let mut fitting = vec![1; byte_count];
    if message_id == id::OS_MONO_PROFILE && byte_count >= 52 {
        let result_count = ((byte_count - 52) / 2) as u16;
        fitting[22..24].copy_from_slice(&result_count.to_le_bytes());
    }
    [vec![0; byte_count], vec![0xff; byte_count], fitting]
}

#[test]
fn every_id_of_the_tables_with_every_length_is_taken_or_rejected_rightly() {
    let mut decoder = Box::new(Decoder::new());
    for message_id in TABLE_IDS
        .into_iter()
        .chain([7, 1002, 2000, 2196, 2199, 3012, 65535])
    {
        for byte_count in 0..=MAX_PAYLOAD_BYTES {
            for payload in payloads(message_id, byte_count) {
                Candidate::new(message_id, &payload).check(&mut decoder);
            }
        }
    }
}

fn check_every_id(byte_counts: impl IntoIterator<Item = usize>) {
    let mut decoder = Box::new(Decoder::new());
    for byte_count in byte_counts {
        let mut candidate = Candidate::new(0, &vec![1; byte_count]);
        for message_id in 0..=u16::MAX {
            candidate.set_message_id(message_id);
            candidate.check(&mut decoder);
        }
    }
}

/// Ten lengths, or every one (164 million frames, minutes) with `ECHOSPLAT_LONG=1`.
#[test]
fn every_id_is_taken_or_rejected_rightly() {
    if std::env::var_os("ECHOSPLAT_LONG").is_some() {
        check_every_id(0..=MAX_PAYLOAD_BYTES);
    } else {
        check_every_id([0, 1, 2, 6, 34, 52, 254, 2048, 2049, MAX_PAYLOAD_BYTES]);
    }
}
