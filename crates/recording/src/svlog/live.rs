//! A log written while bytes come: only intact frames, after a session packet with their time.

use std::io::{self, ErrorKind, Write};

use echosplat_firmware_protocol::{Decoder, Event, Frame, Message, id};
use echosplat_model::Timestamp;

use super::session_clock::SessionClock;
use super::{SessionHeader, SvlogError, SvlogWriter};

/// What readers of logs expect of a sonar. Others trip over acknowledgements; session packets are
/// this writer's alone.
const KEPT: [u16; 2] = [id::OS_MONO_PROFILE, id::STATUS];

/// The clock that poses are stamped with, which the log's times shall meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LogClock {
    /// The host's: a session's `timestamp` is when its first profile came.
    #[default]
    Host,
    /// The device's own: a session's `timestamp` is the device time of its first profile.
    Device,
    /// That of a log whose bytes are given: its session packets are kept as they are.
    Kept,
}

/// Writes the frames found in a stream of bytes. What the writer refuses is kept and completed by
/// [`LiveSvlog::catch_up`]; nothing more must be given before that succeeds.
pub struct LiveSvlog<W: Write> {
    writer: W,
    url: String,
    decoder: Box<Decoder>,
    framing: Framing,
}

/// Frames with their sessions, as bytes to write.
#[derive(Debug, Default)]
struct Framing {
    log_clock: LogClock,
    clock: Option<SessionClock>,
    session_count: u64,
    /// Since the last session: what came before the first profile waits for it.
    waiting: Vec<u8>,
    pending: Vec<u8>,
    byte_count: u64,
    frame_count: u64,
}

/// Most bytes that wait for the first profile; a session without any is of no use.
const MAX_WAITING_BYTES: usize = 64 << 10;

impl<W: Write> LiveSvlog<W> {
    /// A log of the sonar at `url`; its first packet is written with the first profile.
    pub fn new(writer: W, url: &str, log_clock: LogClock) -> Self {
        Self {
            writer,
            url: url.to_owned(),
            decoder: Box::default(),
            framing: Framing {
                log_clock,
                ..Framing::default()
            },
        }
    }

    /// Takes the next bytes, which came at `host_time`.
    ///
    /// # Errors
    /// Of the writer; what was refused is kept.
    pub fn take(&mut self, host_time: Timestamp, bytes: &[u8]) -> io::Result<()> {
        let (framing, url) = (&mut self.framing, &self.url);
        self.decoder.feed(bytes, &mut |event| {
            framing.take(&event, host_time, url);
        });
        self.catch_up()
    }

    /// The rest of a frame did not come in time.
    ///
    /// # Errors
    /// As [`LiveSvlog::take`].
    pub fn half_frame_expired(&mut self, host_time: Timestamp) -> io::Result<()> {
        let (framing, url) = (&mut self.framing, &self.url);
        self.decoder.expire(&mut |event| {
            framing.take(&event, host_time, url);
        });
        self.catch_up()
    }

    /// The link is gone: no frame that has begun goes on.
    ///
    /// # Errors
    /// As [`LiveSvlog::take`].
    pub fn link_down(&mut self, host_time: Timestamp) -> io::Result<()> {
        let (framing, url) = (&mut self.framing, &self.url);
        self.decoder.finish(&mut |event| {
            framing.take(&event, host_time, url);
        });
        self.catch_up()
    }

    /// Hands over what was refused before, if anything was.
    ///
    /// # Errors
    /// If it is refused again.
    pub fn catch_up(&mut self) -> io::Result<()> {
        while !self.framing.pending.is_empty() {
            match self.writer.write(&self.framing.pending) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => drop(self.framing.pending.drain(..count)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        self.writer.flush()
    }

    /// Bytes written or about to be.
    #[must_use]
    pub fn byte_count(&self) -> u64 {
        self.framing.byte_count
    }

    /// Frames among them, session packets aside.
    #[must_use]
    pub fn frame_count(&self) -> u64 {
        self.framing.frame_count
    }

    /// The writer, without another byte.
    pub fn into_inner(self) -> W {
        self.writer
    }
}

impl Framing {
    fn take(&mut self, event: &Event<'_>, arrival: Timestamp, url: &str) {
        let Event::Frame(frame) = event else { return };
        let is_session = frame.message_id() == id::JSON;
        let keeps_sessions = self.log_clock == LogClock::Kept;
        if keeps_sessions && is_session {
            self.session_count += 1;
            return self.write(frame);
        }
        if !KEPT.contains(&frame.message_id()) {
            return;
        }
        self.frame_count += 1;
        if keeps_sessions {
            return self.write(frame);
        }
        if let Ok(Message::OsMonoProfile(profile)) = Message::parse(frame) {
            self.begin_session_if_due(profile.timestamp_ms, arrival, frame.src_device_id(), url);
        }
        self.put(frame);
    }

    fn begin_session_if_due(&mut self, device_ms: u32, arrival: Timestamp, device: u8, url: &str) {
        let arrival = match self.log_clock {
            LogClock::Host | LogClock::Kept => arrival,
            LogClock::Device => Timestamp::from_millis(device_ms.into()),
        };
        let began = match &mut self.clock {
            Some(clock) => clock.insert(device_ms, arrival),
            None => Some(arrival),
        };
        let Some(timestamp) = began else { return };
        self.clock = Some(SessionClock::new(timestamp, device_ms));
        self.session_count += 1;
        let header = SessionHeader {
            session_id: self.session_count,
            device_uptime_s: Some(f64::from(device_ms) * 1e-3),
            ..SessionHeader::new(timestamp, device, url)
        };
        let packet = session_packet(&header).unwrap_or_default();
        let before = std::mem::take(&mut self.waiting);
        self.byte_count += (packet.len() + before.len()) as u64;
        self.pending.extend(packet);
        self.pending.extend(before);
    }

    fn put(&mut self, frame: &Frame<'_>) {
        let bytes = frame.bytes();
        if self.clock.is_some() {
            self.write(frame);
        } else if self.waiting.len() + bytes.len() <= MAX_WAITING_BYTES {
            self.waiting.extend_from_slice(bytes);
        }
    }

    fn write(&mut self, frame: &Frame<'_>) {
        self.byte_count += frame.bytes().len() as u64;
        self.pending.extend_from_slice(frame.bytes());
    }
}

fn session_packet(header: &SessionHeader) -> Result<Vec<u8>, SvlogError> {
    SvlogWriter::new(Vec::new(), header)?.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_firmware_protocol::{OsMonoProfile, PowerResults};

    fn time(millis: i64) -> Timestamp {
        Timestamp::from_millis(1_700_000_000_000 + millis)
    }

    fn profile(number: u32, device_ms: u32) -> Vec<u8> {
        encoded(&Message::OsMonoProfile(OsMonoProfile {
            ping_number: number,
            start_mm: 0,
            length_mm: 10_000,
            timestamp_ms: device_ms,
            ping_hz: 451_127,
            gain_index: 4,
            sos_dmps: 15_000,
            channel_number: 0,
            pulse_duration_sec: 2e-5,
            analog_gain: 74.55,
            max_pwr_db: 10.0,
            min_pwr_db: -10.0,
            transducer_heading_deg: 0.0,
            vehicle_heading_deg: 0.0,
            pwr_results: PowerResults::from_bytes(&[1; 400]).unwrap(),
        }))
    }

    fn encoded(message: &Message<'_>) -> Vec<u8> {
        let mut bytes = vec![0; message.encoded_byte_count()];
        let length = message.encode(3, 0, &mut bytes).unwrap();
        bytes.truncate(length);
        bytes
    }

    /// Ids of the frames in these bytes, and that they are nothing else.
    fn ids(bytes: &[u8]) -> Vec<u16> {
        let mut ids = Vec::new();
        let mut decoder = Decoder::new();
        decoder.feed(bytes, &mut |event| match event {
            Event::Frame(frame) => ids.push(frame.message_id()),
            other => panic!("{other:?}"),
        });
        assert_eq!(decoder.pending_byte_count(), 0);
        ids
    }

    fn sessions(bytes: &[u8]) -> Vec<SessionHeader> {
        let mut found = Vec::new();
        Decoder::new().feed(bytes, &mut |event| {
            if let Event::Frame(frame) = event
                && frame.message_id() == id::JSON
            {
                found.push(SessionHeader::parse(frame.payload()).unwrap());
            }
        });
        found
    }

    #[test]
    fn only_whole_frames_of_the_sonar_stand_behind_the_session() {
        let mut log = LiveSvlog::new(Vec::new(), "tcp://sonar", LogClock::Host);
        let noise = [0x42; 30];
        let forged = encoded(&Message::Json(
            r#"{"timestamp":"1970-01-01T00:00:00Z"}"#.into(),
        ));
        let ack = encoded(&Message::Ack { acked_id: 2197 });
        let damaged: Vec<u8> = profile(7, 7).iter().map(|byte| byte ^ 1).collect();
        let stream = [&noise[..], &forged, &ack, &profile(0, 100), &damaged].concat();
        for piece in stream.chunks(100) {
            log.take(time(0), piece).unwrap();
        }
        log.take(time(17), &profile(1, 117)).unwrap();
        log.take(time(34), &profile(2, 134)[..50]).unwrap();
        log.link_down(time(50)).unwrap();
        log.take(time(51), &profile(3, 151)).unwrap();
        assert_eq!(log.frame_count(), 3);
        let bytes = log.into_inner();
        assert_eq!(ids(&bytes), [10, 2198, 2198, 2198]);
        let sessions = sessions(&bytes);
        assert_eq!(
            (sessions[0].timestamp, sessions[0].device_uptime_s),
            (time(0), Some(0.1))
        );
    }

    #[test]
    fn a_restarted_device_begins_another_session() {
        let mut log = LiveSvlog::new(Vec::new(), "", LogClock::Host);
        for (at, device_ms) in [(0, 90_000), (17, 90_017), (3_000, 5), (3_017, 22)] {
            log.take(time(at), &profile(0, device_ms)).unwrap();
        }
        let bytes = log.into_inner();
        assert_eq!(ids(&bytes), [10, 2198, 2198, 10, 2198, 2198]);
        assert_eq!(sessions(&bytes)[1].timestamp, time(3_000));
        assert_eq!(sessions(&bytes)[1].session_id, 2);
    }

    #[test]
    fn on_the_devices_clock_sessions_begin_at_device_time() {
        let mut log = LiveSvlog::new(Vec::new(), "", LogClock::Device);
        for (at, device_ms) in [(0, 500), (1, 600), (2, 700)] {
            log.take(time(at), &profile(0, device_ms)).unwrap();
        }
        let found = sessions(&log.into_inner());
        let starts: Vec<_> = found.iter().map(|session| session.timestamp).collect();
        assert_eq!(starts, [Timestamp::from_millis(500)]);
    }

    #[test]
    fn a_log_that_is_read_again_keeps_its_sessions() {
        let mut first = LiveSvlog::new(Vec::new(), "", LogClock::Host);
        for (at, device_ms) in [(0, 90_000), (17, 90_017), (3_000, 5)] {
            first.take(time(at), &profile(0, device_ms)).unwrap();
        }
        let bytes = first.into_inner();
        let mut second = LiveSvlog::new(Vec::new(), "", LogClock::Kept);
        // All at once, at another time.
        second.take(time(99_999), &bytes).unwrap();
        assert_eq!(second.into_inner(), bytes);
    }

    /// Takes one byte at a time, and nothing while it is full.
    struct SmallDisk(Vec<u8>, std::rc::Rc<std::cell::Cell<bool>>);

    impl Write for SmallDisk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.1.get() && self.0.len() > 200 {
                return Err(ErrorKind::StorageFull.into());
            }
            self.0.push(bytes[0]);
            Ok(1)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn what_a_full_disk_refuses_is_completed_later() {
        let full = std::rc::Rc::new(std::cell::Cell::new(true));
        let mut log = LiveSvlog::new(SmallDisk(Vec::new(), full.clone()), "", LogClock::Host);
        assert!(log.take(time(0), &profile(0, 0)).is_err());
        assert!(log.catch_up().is_err());
        full.set(false);
        log.catch_up().unwrap();
        assert_eq!(ids(&log.into_inner().0), [10, 2198]);
    }
}
