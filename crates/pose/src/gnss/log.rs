//! Fixes inside logs: NMEA in wrapper packets (id 109) of a `.svlog`, `NavSatFix` in a foreign MCAP.

use std::collections::BTreeMap;
use std::io::BufReader;
use std::path::Path;

use echosplat_firmware_protocol::{Decoder, Event, Message as Packet, id};
use echosplat_georeference::Heard;
use echosplat_georeference::nmea::{NmeaReceiver, Told};
use echosplat_model::Timestamp;
use echosplat_recording::mcap::{Channel, Messages};
use echosplat_recording::svlog::{SessionHeader, SvlogError, SvlogReader};
use echosplat_ros::NavSatFix;

use super::fix_message::fix_of;
use crate::log::{LogPosesError, Ros1Reader, cannot_read};

/// Fixes of one log; a day at 10 Hz.
const MOST_HEARD: usize = 864_000;
/// Topics of fixes in one file.
const MOST_TOPICS: usize = 64;

/// What a log's receiver told.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GnssLog {
    /// In order of time: of a `.svlog` on the time that its profiles are given, else the messages' own.
    pub heard: Vec<Heard>,
    /// Messages that came, fix or not.
    pub messages: u64,
    /// Of these, those that say that there is no fix.
    pub no_fix: u64,
    /// Of these, those with a magnetic heading, which is not used.
    pub magnetic_headings: u64,
    /// Of these, those that were cut, damaged, or have a number that cannot be.
    pub refused: u64,
    /// What was wrong with the first.
    pub first_fault: Option<String>,
}

impl GnssLog {
    /// How many fixes there are.
    #[must_use]
    pub fn fixes(&self) -> usize {
        let is_fix = |heard: &&Heard| matches!(heard, Heard::Fix(_));
        self.heard.iter().filter(is_fix).count()
    }

    fn in_order(mut self) -> Self {
        self.heard.sort_by_key(Heard::time);
        self
    }
}

/// What NMEA in a log tells. Times of day are put on the time of profiles as a vehicle's clock is, by whatever profile
/// follows them soonest.
///
/// # Errors
/// If it is no `.svlog`.
pub fn fixes_of_svlog(path: &Path) -> Result<GnssLog, LogPosesError> {
    let format = |reason: SvlogError| LogPosesError::Format {
        path: path.to_owned(),
        reason: reason.to_string(),
    };
    let file = echosplat_input::open_file(path).map_err(|reason| LogPosesError::Io {
        path: path.to_owned(),
        reason,
    })?;
    let mut reader = SvlogReader::new(BufReader::new(file)).map_err(format)?;
    let mut decoder = Box::new(Decoder::new());
    let mut log = SvlogGnss::default();
    while let Some(piece) = reader.next_piece().map_err(format)? {
        decoder.feed(piece, &mut |event| log.take(&event));
    }
    decoder.finish(&mut |event| log.take(&event));
    Ok(log.finish())
}

#[derive(Default)]
struct SvlogGnss {
    receiver: NmeaReceiver,
    heard: Vec<Heard>,
    start: Timestamp,
    session: Session,
}

/// Since the newest session packet.
#[derive(Default)]
struct Session {
    first_ms: Option<u32>,
    channel: Option<u8>,
    /// Of the newest profile, since the first, seconds.
    newest_s: Option<f64>,
    /// The receiver's time of the newest sentence behind the newest profile, seconds.
    unmatched_s: Option<f64>,
    /// Time since the first profile minus the receiver's time, seconds.
    least_s: Option<f64>,
    /// Each with the receiver's time, and that of the profile before it.
    told: Vec<(Told, Option<f64>, Option<f64>)>,
}

impl SvlogGnss {
    fn take(&mut self, event: &Event<'_>) {
        let Event::Frame(frame) = event else { return };
        match frame.message_id() {
            id::JSON => {
                if let Ok(header) = SessionHeader::parse(frame.payload()) {
                    self.end_session();
                    self.start = header.timestamp;
                }
            }
            id::NMEA => {
                let session = &mut self.session;
                self.receiver.take(frame.payload(), |told, at_s| {
                    session.unmatched_s = at_s.or(session.unmatched_s);
                    if session.told.len() < MOST_HEARD {
                        session.told.push((told, at_s, session.newest_s));
                    }
                });
            }
            id::OS_MONO_PROFILE => {
                if let Ok(Packet::OsMonoProfile(profile)) = Packet::parse(frame) {
                    self.session
                        .profile(profile.channel_number, profile.timestamp_ms);
                }
            }
            _ => {}
        }
    }

    fn end_session(&mut self) {
        let session = std::mem::take(&mut self.session);
        let room = MOST_HEARD.saturating_sub(self.heard.len());
        let start = self.start;
        let on_its_clock = session.told.iter().filter_map(|&(told, at_s, profile_s)| {
            let by_receiver = at_s
                .zip(session.least_s)
                .map(|(at_s, least_s)| at_s + least_s);
            let since_first_s = by_receiver.or(profile_s)?;
            Some(told.at(start.offset_by(since_first_s)))
        });
        self.heard.extend(on_its_clock.take(room));
    }

    fn finish(mut self) -> GnssLog {
        self.end_session();
        let counters = self.receiver.counters();
        let log = GnssLog {
            heard: self.heard,
            messages: counters.fixes
                + counters.no_fix
                + counters.headings
                + counters.magnetic_headings
                + counters.others
                + counters.refused,
            no_fix: counters.no_fix,
            magnetic_headings: counters.magnetic_headings,
            refused: counters.refused,
            first_fault: counters.first_fault.clone(),
        };
        log.in_order()
    }
}

impl Session {
    fn profile(&mut self, channel: u8, timestamp_ms: u32) {
        if *self.channel.get_or_insert(channel) != channel {
            return;
        }
        let first_ms = *self.first_ms.get_or_insert(timestamp_ms);
        // The counter wraps after 49.7 days; no session is half as long.
        let since_ms = timestamp_ms.wrapping_sub(first_ms).cast_signed();
        let since_s = f64::from(since_ms) * 1e-3;
        self.newest_s = Some(since_s);
        if let Some(at_s) = self.unmatched_s.take() {
            let apart_s = since_s - at_s;
            self.least_s = Some(self.least_s.map_or(apart_s, |least_s| least_s.min(apart_s)));
        }
    }
}

/// The fixes of `topic`, or else of the topic of `NavSatFix` that holds most of them; none where there is no such topic.
///
/// # Errors
/// If it cannot be read as MCAP.
pub fn fixes_of_mcap(path: &Path, topic: Option<&str>) -> Result<GnssLog, LogPosesError> {
    let wrong = |error| cannot_read(path, error);
    let mut messages = Messages::open(path).map_err(wrong)?;
    let mut topics: BTreeMap<String, GnssLog> = BTreeMap::new();
    while let Some(message) = messages.next_message().map_err(wrong)? {
        let channel = messages.channel(message.header.channel_id);
        let Some((channel, is_ros1)) = channel.and_then(of_fixes) else {
            continue;
        };
        if topic.is_some_and(|topic| topic != channel.topic) {
            continue;
        }
        if !topics.contains_key(&channel.topic) && topics.len() == MOST_TOPICS {
            continue;
        }
        let log = topics.entry(channel.topic.clone()).or_default();
        log.messages += 1;
        let decoded = match is_ros1 {
            true => ros1_fix(&message.data),
            false => {
                NavSatFix::decode(&message.data).map_err(|error| format!("NavSatFix: {error}"))
            }
        };
        match decoded.and_then(|message| fix_of(&message)) {
            Ok(Some(fix)) if log.heard.len() < MOST_HEARD => log.heard.push(Heard::Fix(fix)),
            Ok(Some(_)) => {}
            Ok(None) => log.no_fix += 1,
            Err(fault) => {
                log.refused += 1;
                log.first_fault.get_or_insert(fault);
            }
        }
    }
    // Of two with as many the first by name.
    let most = topics.into_values().rev().max_by_key(|log| log.heard.len());
    Ok(most.unwrap_or_default().in_order())
}

fn of_fixes(channel: &Channel) -> Option<(&Channel, bool)> {
    let name = channel.schema.rsplit(['/', ':', '.']).next()?;
    let is_ros1 = match channel.encoding.as_str() {
        "cdr" => false,
        "ros1" => true,
        _ => return None,
    };
    matches!(name, "NavSatFix" | "NavSatFix_").then_some((channel, is_ros1))
}

fn ros1_fix(data: &[u8]) -> Result<NavSatFix, String> {
    let mut reader = Ros1Reader::new(data);
    let (stamp, _) = reader.header()?;
    let [status] = reader.bytes()?;
    let [_, _] = reader.bytes()?;
    let [latitude_deg, longitude_deg, altitude_m] = reader.f64s()?;
    let covariance_m2 = reader.f64s()?;
    let [covariance_type] = reader.bytes()?;
    Ok(NavSatFix {
        stamp,
        status: status.cast_signed(),
        latitude_deg,
        longitude_deg,
        altitude_m,
        covariance_m2,
        covariance_type,
    })
}

#[cfg(test)]
mod tests;
