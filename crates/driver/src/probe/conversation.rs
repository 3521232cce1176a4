//! The few words with one sonar.

use std::io;
use std::time::Duration;

use echosplat_firmware_protocol::{
    Decoder, DeviceInformation, Event, Frame, Message, OsPingParams, id, product_of_message,
};
use tokio::time::{Instant, timeout, timeout_at};

use super::{ProbedIdentity, ProbedProfile, ProbedUnit, in_words};
use crate::transport::Transport;
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
    /// Of whose kind a message was that no `OmniScan` 450 sends.
    other_product: Option<&'static str>,
    profile: Option<ProbedProfile>,
}

/// Asks until identity and profile are there, or `deadline`.
pub(super) async fn hold(
    link: &mut Transport,
    url: &SonarUrl,
    deadline: Instant,
) -> Result<ProbedUnit, String> {
    let began = Instant::now();
    let mut heard = Heard::default();
    let question = request(id::DEVICE_INFORMATION);
    let until = deadline.min(began + LISTEN);
    let listened = heard.listen(link, until, &question).await;
    let was_pinging = heard.profile.is_some();
    let answers = heard.frames > 0;
    let mut outcome = listened;
    // Nothing is asked of what is no sonar of ours.
    if let Some(words) = heard.of_another_device() {
        return Err(words);
    }
    if outcome.is_ok() && answers && !was_pinging {
        outcome = heard.listen(link, deadline, &settings(true)).await;
        // Whatever came of it: what was started here is stopped here.
        stop(link).await;
    }
    if let Some(words) = heard.of_another_device() {
        return Err(words);
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
    async fn listen(
        &mut self,
        link: &mut Transport,
        until: Instant,
        question: &[u8],
    ) -> io::Result<()> {
        let mut decoder = Box::<Decoder>::default();
        let mut ask_at = Instant::now();
        while !(self.identity.is_some() && self.profile.is_some()) && Instant::now() < until {
            if Instant::now() >= ask_at {
                link.write(question.to_vec()).await?;
                ask_at += ASK_EVERY;
            }
            // Not by then: it is asked again.
            if let Ok(bytes) = timeout_at(ask_at.min(until), link.read()).await {
                self.take(&bytes?, &mut decoder);
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
            Ok(Message::Unknown { message_id, .. }) => {
                self.other_product = self.other_product.or(product_of_message(message_id));
            }
            _ => {}
        }
    }

    /// What it is, if that is known and it is no `OmniScan` 450.
    fn of_another_device(&self) -> Option<String> {
        let information = self.identity.map(DeviceInformation::from);
        let says = information.filter(|says| !says.is_omniscan_450() && says.product().is_some());
        let device = match (says, self.other_product) {
            (Some(says), _) => says.to_string(),
            (None, Some(product)) if self.profile.is_none() => product.to_owned(),
            _ => return None,
        };
        let text = "answers, and is no OmniScan 450, whose profiles are mapped here";
        Some(format!("{device} {text}"))
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
async fn stop(link: &mut Transport) {
    for frame in [settings(false), short_stop()] {
        if link.write(frame).await.is_err() {
            return;
        }
    }
    let drained = async { while link.read().await.is_ok() {} };
    // One that goes on pinging is not waited for.
    let _ = timeout(DRAIN, drained).await;
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
