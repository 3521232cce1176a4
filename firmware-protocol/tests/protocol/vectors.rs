//! The files under `vectors/`, which other implementations can use as well.

use echosplat_firmware_protocol::{
    DeviceInformation, Frame, FrameError, Message, OsMonoProfile, OsPingParams, ParseError,
    PowerResults, ProtocolVersion, SkipReason, Skipped, Status, SyncChannel, Text,
};
use serde::Deserialize;

use crate::reference::{Found, decode, expected};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MessageVectors {
    frame: Vec<MessageVector>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MessageVector {
    name: String,
    hex: String,
    src_device_id: u8,
    dst_device_id: u8,
    message: Description,
}

/// A message as the vectors write it down.
#[derive(Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
enum Description {
    Nop,
    Ack {
        acked_id: u16,
    },
    Nack {
        nacked_id: u16,
        text: String,
    },
    AsciiText {
        text: String,
    },
    DeviceInformation {
        device_type: u8,
        device_revision: u8,
        firmware: [u8; 3],
    },
    ProtocolVersion {
        version: [u8; 3],
    },
    GeneralRequest {
        requested_id: u16,
    },
    Json {
        text: Option<String>,
        hex: Option<String>,
    },
    ViewConfiguration {
        hex: String,
    },
    SetDeviceId {
        device_id: u8,
    },
    Nmea {
        text: String,
    },
    SetSpeedOfSound {
        speed_of_sound_mmps: u32,
    },
    Mavlink {
        text: String,
    },
    SyncChannelNumber {
        channel_number: u8,
        channel_count: u8,
    },
    SetSyncChannelNumber {
        channel_number: u8,
        channel_count: u8,
    },
    Status {
        values: [f32; 2],
        timestamp_ms: u32,
        channel_number: u8,
    },
    OsPingParams(PingParamsDescription),
    OsMonoProfile(ProfileDescription),
    Unknown {
        message_id: u16,
        hex: String,
    },
}

#[derive(Deserialize)]
struct PingParamsDescription {
    start_mm: u32,
    length_mm: u32,
    msec_per_ping: u32,
    pulse_len_percent: f32,
    filter_duration_percent: f32,
    gain_index: i16,
    num_results: u16,
    enable: bool,
    #[serde(default)]
    short_payload: bool,
}

#[derive(Deserialize)]
struct ProfileDescription {
    ping_number: u32,
    start_mm: u32,
    length_mm: u32,
    timestamp_ms: u32,
    ping_hz: u32,
    gain_index: u16,
    sos_dmps: u16,
    channel_number: u8,
    pulse_duration_sec: f32,
    analog_gain: f32,
    max_pwr_db: f32,
    min_pwr_db: f32,
    transducer_heading_deg: f32,
    vehicle_heading_deg: f32,
    pwr_results: Vec<u16>,
}

impl Description {
    /// The bytes that the described message borrows.
    fn borrowed(&self) -> Vec<u8> {
        match self {
            Self::Nack { text, .. }
            | Self::AsciiText { text }
            | Self::Json {
                text: Some(text), ..
            }
            | Self::Nmea { text }
            | Self::Mavlink { text } => text.clone().into_bytes(),
            Self::Json { hex: Some(hex), .. }
            | Self::ViewConfiguration { hex }
            | Self::Unknown { hex, .. } => bytes_of(hex),
            Self::OsMonoProfile(profile) => profile
                .pwr_results
                .iter()
                .flat_map(|raw| raw.to_le_bytes())
                .collect(),
            _ => Vec::new(),
        }
    }

    fn message<'a>(&self, borrowed: &'a [u8]) -> Message<'a> {
        let text = Text::from_bytes(borrowed);
        match *self {
            Self::Nop => Message::Nop,
            Self::Ack { acked_id } => Message::Ack { acked_id },
            Self::Nack { nacked_id, .. } => Message::Nack { nacked_id, text },
            Self::AsciiText { .. } => Message::AsciiText(text),
            Self::DeviceInformation {
                device_type,
                device_revision,
                firmware,
            } => {
                let information = DeviceInformation {
                    device_type,
                    device_revision,
                    firmware,
                };
                Message::DeviceInformation(information)
            }
            Self::ProtocolVersion { version } => {
                Message::ProtocolVersion(ProtocolVersion { version })
            }
            Self::GeneralRequest { requested_id } => Message::GeneralRequest { requested_id },
            Self::Json { .. } => Message::Json(text),
            Self::ViewConfiguration { .. } => Message::ViewConfiguration(borrowed),
            Self::SetDeviceId { device_id } => Message::SetDeviceId { device_id },
            Self::Nmea { .. } => Message::Nmea(text),
            Self::SetSpeedOfSound {
                speed_of_sound_mmps,
            } => Message::SetSpeedOfSound {
                speed_of_sound_mmps,
            },
            Self::Mavlink { .. } => Message::Mavlink(text),
            Self::SyncChannelNumber {
                channel_number,
                channel_count,
            } => Message::SyncChannelNumber(SyncChannel {
                channel_number,
                channel_count,
            }),
            Self::SetSyncChannelNumber {
                channel_number,
                channel_count,
            } => Message::SetSyncChannelNumber(SyncChannel {
                channel_number,
                channel_count,
            }),
            Self::Status {
                values,
                timestamp_ms,
                channel_number,
            } => Message::Status(Status {
                values,
                timestamp_ms,
                channel_number,
            }),
            Self::OsPingParams(ref params) => Message::OsPingParams(params.params()),
            Self::OsMonoProfile(ref profile) => Message::OsMonoProfile(profile.profile(borrowed)),
            Self::Unknown { message_id, .. } => Message::Unknown {
                message_id,
                payload: borrowed,
            },
        }
    }
}

impl PingParamsDescription {
    fn params(&self) -> OsPingParams {
        OsPingParams {
            start_mm: self.start_mm,
            length_mm: self.length_mm,
            msec_per_ping: self.msec_per_ping,
            pulse_len_percent: self.pulse_len_percent,
            filter_duration_percent: self.filter_duration_percent,
            gain_index: self.gain_index,
            num_results: self.num_results,
            enable: self.enable,
        }
    }
}

impl ProfileDescription {
    fn profile<'a>(&self, pwr_results: &'a [u8]) -> OsMonoProfile<'a> {
        OsMonoProfile {
            ping_number: self.ping_number,
            start_mm: self.start_mm,
            length_mm: self.length_mm,
            timestamp_ms: self.timestamp_ms,
            ping_hz: self.ping_hz,
            gain_index: self.gain_index,
            sos_dmps: self.sos_dmps,
            channel_number: self.channel_number,
            pulse_duration_sec: self.pulse_duration_sec,
            analog_gain: self.analog_gain,
            max_pwr_db: self.max_pwr_db,
            min_pwr_db: self.min_pwr_db,
            transducer_heading_deg: self.transducer_heading_deg,
            vehicle_heading_deg: self.vehicle_heading_deg,
            pwr_results: PowerResults::from_bytes(pwr_results).unwrap(),
        }
    }
}

fn bytes_of(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex
        .bytes()
        .filter(|byte| !byte.is_ascii_whitespace())
        .collect();
    let pairs = digits
        .chunks(2)
        .map(|pair| std::str::from_utf8(pair).unwrap());
    pairs
        .map(|pair| u8::from_str_radix(pair, 16).unwrap())
        .collect()
}

fn message_vectors() -> Vec<MessageVector> {
    let vectors: MessageVectors =
        toml::from_str(include_str!("../../vectors/messages.toml")).unwrap();
    vectors.frame
}

#[test]
fn frames_read_as_their_messages() {
    for vector in message_vectors() {
        let bytes = bytes_of(&vector.hex);
        let frame = Frame::from_bytes(&bytes).unwrap();
        assert_eq!(
            frame.src_device_id(),
            vector.src_device_id,
            "{}",
            vector.name
        );
        assert_eq!(
            frame.dst_device_id(),
            vector.dst_device_id,
            "{}",
            vector.name
        );
        let borrowed = vector.message.borrowed();
        let message = vector.message.message(&borrowed);
        assert_eq!(Message::parse(&frame), Ok(message), "{}", vector.name);
        assert_eq!(message.id(), frame.message_id(), "{}", vector.name);
        assert_eq!(
            decode([bytes.as_slice()]),
            [Found::Frame(bytes.clone())],
            "{}",
            vector.name
        );
    }
}

#[test]
fn messages_write_as_their_frames() {
    for vector in message_vectors() {
        let bytes = bytes_of(&vector.hex);
        let borrowed = vector.message.borrowed();
        let message = vector.message.message(&borrowed);
        let (src, dst) = (vector.src_device_id, vector.dst_device_id);
        let mut out = vec![0xaa; bytes.len() + 3];
        let short = match &vector.message {
            Description::OsPingParams(params) if params.short_payload => Some(params.params()),
            _ => None,
        };
        let encode = |out: &mut [u8]| match short {
            Some(params) => params.encode_short(src, dst, out),
            None => message.encode(src, dst, out),
        };
        assert_eq!(encode(&mut out), Ok(bytes.len()), "{}", vector.name);
        assert_eq!(out[..bytes.len()], bytes, "{}", vector.name);
        assert_eq!(out[bytes.len()..], [0xaa; 3], "{}", vector.name);
        assert!(
            encode(&mut out[..bytes.len() - 1]).is_err(),
            "{}",
            vector.name
        );
        if short.is_none() {
            assert_eq!(message.encoded_byte_count(), bytes.len(), "{}", vector.name);
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RejectedVectors {
    bytes: Vec<RejectedVector>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RejectedVector {
    name: String,
    hex: String,
    reason: String,
}

fn kind_of_rejection(bytes: &[u8]) -> &'static str {
    match Frame::from_bytes(bytes) {
        Err(FrameError::Start) => "start",
        Err(FrameError::Length { .. }) => "length",
        Err(FrameError::ByteCount { .. }) => "byte_count",
        Err(FrameError::Checksum) => "checksum",
        Ok(frame) => match Message::parse(&frame) {
            Err(ParseError::Value { .. }) => "value",
            Err(ParseError::Length { .. } | ParseError::ResultCount { .. }) => "late length",
            Ok(_) => "none",
        },
    }
}

#[test]
fn what_is_no_frame_is_rejected_for_its_reason() {
    let vectors: RejectedVectors =
        toml::from_str(include_str!("../../vectors/rejected.toml")).unwrap();
    for vector in vectors.bytes {
        assert_eq!(
            kind_of_rejection(&bytes_of(&vector.hex)),
            vector.reason,
            "{}",
            vector.name
        );
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StreamVectors {
    stream: Vec<StreamVector>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StreamVector {
    name: String,
    hex: String,
    events: Vec<EventVector>,
}

#[derive(Deserialize)]
#[serde(untagged, deny_unknown_fields)]
enum EventVector {
    Frame { frame_hex: String },
    Skipped { skipped: usize, reason: String },
}

impl EventVector {
    fn found(&self) -> Found {
        match self {
            Self::Frame { frame_hex } => Found::Frame(bytes_of(frame_hex)),
            Self::Skipped { skipped, reason } => {
                let known = SkipReason::ALL
                    .into_iter()
                    .find(|known| known.as_str() == reason);
                Found::Skipped(Skipped {
                    byte_count: *skipped,
                    reason: known.unwrap(),
                })
            }
        }
    }
}

#[test]
fn streams_give_their_events_in_pieces_of_any_size() {
    let vectors: StreamVectors =
        toml::from_str(include_str!("../../vectors/streams.toml")).unwrap();
    for vector in vectors.stream {
        let bytes = bytes_of(&vector.hex);
        let events: Vec<Found> = vector.events.iter().map(EventVector::found).collect();
        assert_eq!(expected(&bytes), events, "{}", vector.name);
        for size in 1..=bytes.len() {
            assert_eq!(
                decode(bytes.chunks(size)),
                events,
                "{}, pieces of {size}",
                vector.name
            );
        }
    }
}
