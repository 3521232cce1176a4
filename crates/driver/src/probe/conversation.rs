//! The few words with one sonar.

use std::io;
use std::time::{Duration, Instant};

use echosplat_firmware_protocol::{Decoder, Event, Frame, Message, OsPingParams, id};

use super::{ProbedIdentity, ProbedProfile, ProbedUnit, in_words};
use crate::transport::{READ_BYTES, Received, Transport};
use crate::url::SonarUrl;

/// Datagrams get lost, and lines wake up late.
const ASK_EVERY: Duration = Duration::from_millis(400);
/// So long one that pings already is given to show it: pings may be a second apart.
const LISTEN: Duration = Duration::from_millis(1_300);
/// After the request to stop, what is unread may take the request with it when the link closes.
const DRAIN: Duration = Duration::from_millis(250);
/// First bytes of what is no Ping device, to be shown.
const SHOWN_BYTES: usize = 32;

/// What has been heard so far.
#[derive(Default)]
struct Heard {
    bytes: u64,
    frames: u64,
    first_bytes: Vec<u8>,
    identity: Option<ProbedIdentity>,
    profile: Option<ProbedProfile>,
}

/// Asks until identity and profile are there, or `deadline`.
pub(super) fn hold(
    link: &mut dyn Transport,
    url: &SonarUrl,
    deadline: Instant,
) -> Result<ProbedUnit, String> {
    let began = Instant::now();
    let mut heard = Heard::default();
    let listened = heard.listen(link, deadline.min(began + LISTEN), &mut |link| {
        link.write(&request(id::DEVICE_INFORMATION))
    });
    let was_pinging = heard.profile.is_some();
    let answers = heard.frames > 0;
    let mut outcome = listened;
    if outcome.is_ok() && answers && !was_pinging {
        outcome = heard.listen(link, deadline, &mut |link| link.write(&settings(true)));
        // Whatever came of it: what was started here is stopped here.
        stop(link);
    }
    if heard.identity.is_none() && heard.profile.is_none() {
        return Err(heard.in_the_way(url, outcome));
    }
    Ok(ProbedUnit {
        url: url.to_string(),
        identity: heard.identity,
        was_pinging,
        profile: heard.profile,
    })
}

impl Heard {
    /// Asks again and again until identity and profile have come, or `until`. Of one that answers
    /// nothing by then, no profile is asked for.
    fn listen(
        &mut self,
        link: &mut dyn Transport,
        until: Instant,
        ask: &mut dyn FnMut(&mut dyn Transport) -> io::Result<()>,
    ) -> io::Result<()> {
        let mut decoder = Box::<Decoder>::default();
        let mut buffer = vec![0; READ_BYTES];
        let mut ask_at = Instant::now();
        while !(self.identity.is_some() && self.profile.is_some()) && Instant::now() < until {
            if Instant::now() >= ask_at {
                ask(link)?;
                ask_at += ASK_EVERY;
            }
            if let Received::Bytes(byte_count) = link.read(&mut buffer)? {
                self.take(&buffer[..byte_count], &mut decoder);
            }
        }
        Ok(())
    }

    fn take(&mut self, bytes: &[u8], decoder: &mut Decoder) {
        self.bytes += bytes.len() as u64;
        let room = SHOWN_BYTES - self.first_bytes.len();
        self.first_bytes.extend(bytes.iter().take(room));
        decoder.feed(bytes, &mut |event| {
            if let Event::Frame(frame) = event {
                self.take_frame(&frame);
            }
        });
    }

    fn take_frame(&mut self, frame: &Frame<'_>) {
        self.frames += 1;
        match Message::parse(frame) {
            Ok(Message::DeviceInformation(information)) => self.identity = Some(information.into()),
            Ok(Message::OsMonoProfile(profile)) => self.profile = Some(ProbedProfile::of(&profile)),
            _ => {}
        }
    }

    fn in_the_way(&self, url: &SonarUrl, outcome: io::Result<()>) -> String {
        if self.frames > 0 {
            return format!(
                "answers as a Ping device ({} frames), but says neither what it is nor pings",
                self.frames
            );
        }
        if self.bytes > 0 {
            return format!(
                "answers, but not as a Ping device: {} bytes, beginning \"{}\"",
                self.bytes,
                self.first_bytes.escape_ascii()
            );
        }
        match (outcome, url) {
            (Err(error), _) => in_words(url, &error),
            (Ok(()), SonarUrl::Tcp(_)) => "connected, but nothing answers".to_owned(),
            (Ok(()), SonarUrl::Serial { baudrate, .. }) => {
                format!("opened at {baudrate} baud, but nothing answers")
            }
            (Ok(()), _) => "nothing answers".to_owned(),
        }
    }
}

/// Both lengths of the message: which one the unit understands may not have shown.
fn stop(link: &mut dyn Transport) {
    let sent = link
        .write(&settings(false))
        .and_then(|()| link.write(&short_stop()));
    let began = Instant::now();
    let mut buffer = vec![0; READ_BYTES];
    while sent.is_ok() && began.elapsed() < DRAIN {
        if link.read(&mut buffer).is_err() {
            return;
        }
    }
}

fn request(requested_id: u16) -> Vec<u8> {
    let message = Message::GeneralRequest { requested_id };
    let mut frame = vec![0; message.encoded_byte_count()];
    // The buffer is as long as the message says it is.
    let _ = message.encode(0, 0, &mut frame);
    frame
}

/// The settings that everybody's first ping has: 10 m, 600 bins, automatic gain.
fn params(enable: bool) -> OsPingParams {
    OsPingParams {
        start_mm: 0,
        length_mm: 10_000,
        msec_per_ping: 200,
        pulse_len_percent: 0.002,
        filter_duration_percent: 0.0015,
        gain_index: -1,
        num_results: 600,
        enable,
    }
}

fn settings(enable: bool) -> Vec<u8> {
    let message = Message::OsPingParams(params(enable));
    let mut frame = vec![0; message.encoded_byte_count()];
    let _ = message.encode(0, 0, &mut frame);
    frame
}

fn short_stop() -> Vec<u8> {
    let mut frame = vec![0; 64];
    let byte_count = params(false).encode_short(0, 0, &mut frame).unwrap_or(0);
    frame.truncate(byte_count);
    frame
}
