//! One function for each kind of file.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use echosplat_firmware_protocol::{Decoder, Event, id};
use echosplat_model::{Gaussian, Timestamp};
use echosplat_recording::mcap::{Record, Recording, RecordingReader, Scan};
use echosplat_recording::svlog::{SvlogReader, Tail};
use echosplat_recording::{ply, tum};
use echosplat_session::{
    ClockSource, Session, SessionConfig, SessionCounters, SessionEvent, UnitHeard,
};
use serde_json::{Map, Value, json};

use super::pings::{PingTally, span_fact, span_of};
use super::{Found, LEFT_OUT, refused};
use crate::clock;
use crate::config::Config;
use crate::exit::Usage;
use crate::replayed::Begun;

type Facts = Map<String, Value>;

/// The files of one dive, each that does not go on from those before it by itself.
///
/// # Errors
/// Names the file that is no recording.
pub(super) fn recordings(files: &[PathBuf]) -> anyhow::Result<Vec<Found>> {
    let mut found = Vec::new();
    let mut rest = files.to_owned();
    while !rest.is_empty() {
        // Its errors name the file.
        let scan = Recording::scan(&rest).map_err(Usage::error)?;
        let (together, apart): (Vec<_>, Vec<_>) =
            rest.into_iter().partition(|file| !is_left_out(&scan, file));
        if together.is_empty() || apart.is_empty() {
            let files = [together, apart].concat();
            let facts = recording(&files, &scan)?;
            found.push(Found { files, facts });
            break;
        }
        let scan = Recording::scan(&together).map_err(Usage::error)?;
        let facts = recording(&together, &scan)?;
        found.push(Found {
            files: together,
            facts,
        });
        rest = apart;
    }
    Ok(found)
}

/// Nothing of the file goes on from those before it.
fn is_left_out(scan: &Scan, file: &Path) -> bool {
    let parts = || {
        let parts = scan.parts.iter();
        parts.filter(|part| part.path.as_deref() == Some(file))
    };
    let is_taken = parts().any(|part| part.taken_count + part.repeated_count > 0);
    !is_taken && parts().any(|part| part.left_out_count > 0)
}

fn recording(files: &[PathBuf], scan: &Scan) -> anyhow::Result<Facts> {
    let settings = scan.settings.as_deref().unwrap_or_default();
    let config: Config = toml::from_str(settings).unwrap_or_default();
    let begun = Begun::of(scan);
    let found = recorded_pings(files, &begun, &config).map_err(Usage::error)?;
    let (pings, units, counters) = found;
    let poses = span_of(scan.poses.iter().map(|(pose, _)| pose.time));
    let with_poses = pings.count_within(poses);
    let mut facts = Facts::new();
    facts.insert("files".to_owned(), files.len().into());
    let made_by = begun.program.map(|version| format!("EchoSplat {version}"));
    facts.insert("made_by".to_owned(), made_by.into());
    facts.insert("span".to_owned(), span_fact(scan.span));
    facts.extend(pings.facts());
    facts.insert("units".to_owned(), units_fact(&units));
    facts.insert("poses".to_owned(), scan.poses.len().into());
    facts.insert("pose_span".to_owned(), span_fact(poses));
    facts.insert("pings_within_poses".to_owned(), with_poses.into());
    facts.insert("replays_without_poses".to_owned(), (with_poses > 0).into());
    facts.insert("settings".to_owned(), main_settings(scan, &config));
    facts.insert("records".to_owned(), counted(scan));
    facts.insert(
        "damage".to_owned(),
        json!({
            "is_cut": scan.is_cut,
            "is_checksum_wrong": scan.parts.iter().any(|part| part.condition.is_checksum_wrong),
            "damaged_bytes": scan.damaged_byte_count,
            "undecodable_records": scan.undecodable_count,
            "frames_bad": counters.frames_bad,
            "bytes_skipped": counters.bytes_skipped,
        }),
    );
    facts.insert("losses".to_owned(), scan.losses(false).into());
    Ok(facts)
}

/// The pings that the bytes hold, with the clock they were mapped by.
fn recorded_pings(
    files: &[PathBuf],
    begun: &Begun,
    config: &Config,
) -> Result<(PingTally, Vec<UnitHeard>, SessionCounters), echosplat_recording::mcap::RecordingError>
{
    let mut reader = RecordingReader::open(files)?;
    let mut session: Option<Session> = None;
    let mut tally = PingTally::default();
    let mut newest = clock::now();
    while let Some(recorded) = reader.next_message()? {
        let now = recorded.host_time;
        newest = now;
        if session.is_none() && !matches!(recorded.record, Record::Raw(_)) {
            continue;
        }
        let session = session.get_or_insert_with(|| session_for(begun, config, now));
        match recorded.record {
            Record::Raw(bytes) => session.receive(&bytes, now),
            Record::LinkUp => session.link_restored(now),
            Record::LinkDown => session.link_lost(now),
            Record::HalfFrameExpired => session.expire_half_frame(now),
            _ => {}
        }
        drain(session, &mut tally);
    }
    let Some(mut session) = session else {
        return Ok((tally, Vec::new(), SessionCounters::default()));
    };
    session.finish(newest);
    drain(&mut session, &mut tally);
    Ok((tally, session.units(), session.counters()))
}

/// Which units were heard, and which of them is mapped.
fn units_fact(units: &[UnitHeard]) -> Value {
    let words = |unit: &UnitHeard| {
        let what = match unit.is_mapped {
            true => "mapped",
            false => "left out",
        };
        format!("{}: {} profiles, {what}", unit.label, unit.profiles)
    };
    units.iter().map(words).collect::<Vec<_>>().into()
}

/// As a replay has it.
fn session_for(begun: &Begun, config: &Config, now: Timestamp) -> Session {
    let session = begun.session.as_ref().unwrap_or(&config.session).clone();
    match begun.is_log {
        true => Session::listening(session, now),
        false => Session::replaying(session, now),
    }
}

fn drain(session: &mut Session, tally: &mut PingTally) {
    while let Some(event) = session.poll_event() {
        if let SessionEvent::Ping { ping, .. } = event {
            tally.insert(&ping);
        }
    }
}

fn main_settings(scan: &Scan, config: &Config) -> Value {
    if scan.settings.is_none() {
        return Value::Null;
    }
    json!({
        "sonar.url": config.sonar.url,
        "pose.url": config.pose.url.to_string(),
        "session.range_length_m": config.session.range_length_m,
        "session.clock": config.session.clock,
        "pose.time_offset_s": config.pose.time_offset_s,
        "mapper.resolution_m": config.mapper.resolution_m,
    })
}

fn counted(scan: &Scan) -> Value {
    let counts = &scan.counts;
    json!({
        "raw": counts.raw,
        "raw_bytes": counts.raw_bytes,
        "link_ups": counts.link_ups,
        "link_downs": counts.link_downs,
        "events": counts.events,
        "statuses": counts.statuses,
        "map_deltas": counts.deltas,
    })
}

pub(super) fn log(file: &Path) -> anyhow::Result<Facts> {
    let wrong = |error: &dyn std::fmt::Display| refused(file, error);
    let opened = File::open(file).map_err(|error| wrong(&error))?;
    let mut reader = SvlogReader::new(BufReader::new(opened)).map_err(|error| wrong(&error))?;
    let config = SessionConfig {
        clock: ClockSource::Device,
        ..SessionConfig::default()
    };
    let mut session = Session::listening(config, clock::now());
    let (mut tally, mut wrapped) = (PingTally::default(), Wrapped::default());
    let mut decoder = Box::new(Decoder::new());
    while let Some(piece) = reader.next_piece().map_err(|error| wrong(&error))? {
        decoder.feed(piece, &mut |event| wrapped.take(&event));
        session.receive(piece, clock::now());
        drain(&mut session, &mut tally);
    }
    session.finish(clock::now());
    drain(&mut session, &mut tally);
    let counters = session.counters();
    let is_cut = !matches!(reader.tail(), Some(Tail::Whole));
    let mut facts = tally.facts();
    facts.insert("units".to_owned(), units_fact(&session.units()));
    facts.insert("sessions".to_owned(), wrapped.sessions.into());
    facts.insert("attitudes".to_owned(), wrapped.attitudes.into());
    facts.insert("positions".to_owned(), wrapped.positions.into());
    facts.insert("velocities".to_owned(), wrapped.velocities.into());
    let moves = wrapped.positions > 0 || wrapped.velocities > 0;
    let replays = wrapped.attitudes > 0 && moves;
    facts.insert("replays_without_poses".to_owned(), replays.into());
    facts.insert(
        "damage".to_owned(),
        json!({
            "is_cut": is_cut,
            "frames_bad": counters.frames_bad,
            "bytes_skipped": counters.bytes_skipped,
            "profiles_rejected": counters.profiles_rejected.total(),
        }),
    );
    Ok(facts)
}

/// What a log holds beside profiles: `MAVLink` as JSON in message 150, sessions in message 10.
#[derive(Debug, Default)]
struct Wrapped {
    sessions: u64,
    attitudes: u64,
    positions: u64,
    /// Of vehicles without positions.
    velocities: u64,
}

impl Wrapped {
    fn take(&mut self, event: &Event<'_>) {
        let Event::Frame(frame) = event else { return };
        match frame.message_id() {
            id::JSON => self.sessions += 1,
            id::MAVLINK => {
                let message: Value = serde_json::from_slice(frame.payload()).unwrap_or_default();
                match message["message"]["type"].as_str() {
                    Some("ATTITUDE" | "ATTITUDE_QUATERNION") => self.attitudes += 1,
                    Some("LOCAL_POSITION_NED") => self.positions += 1,
                    Some("VISION_POSITION_DELTA" | "VISION_SPEED_ESTIMATE") => self.velocities += 1,
                    Some("ODOMETRY") => {
                        self.attitudes += 1;
                        self.positions += 1;
                    }
                    _ => {}
                }
            }
            _ => {}
        }
    }
}

pub(super) fn trajectory(file: &Path) -> anyhow::Result<Facts> {
    let opened = File::open(file).map_err(|error| refused(file, &error))?;
    let found = tum::read(BufReader::new(opened)).map_err(|error| refused(file, &error))?;
    let span = span_of(found.poses.iter().map(|pose| pose.time));
    let positions = found
        .poses
        .iter()
        .map(|pose| pose.world_from_vehicle.translation_m);
    let mut facts = Facts::new();
    facts.insert("poses".to_owned(), found.poses.len().into());
    if found.not_finite_count > 0 {
        let count = found.not_finite_count;
        facts.insert("rows_not_finite".to_owned(), count.into());
    }
    facts.insert("pose_span".to_owned(), span_fact(span));
    let (low, high) = positions.fold((None, None), |(low, high), p| {
        let low = low.map_or(p, |low: glam::DVec3| low.min(p));
        let high = high.map_or(p, |high: glam::DVec3| high.max(p));
        (Some(low), Some(high))
    });
    facts.insert("least_m".to_owned(), json!(low.map(|p| p.to_array())));
    facts.insert("greatest_m".to_owned(), json!(high.map(|p| p.to_array())));
    Ok(facts)
}

pub(super) fn map(file: &Path) -> anyhow::Result<Facts> {
    let wrong = |error: &dyn std::fmt::Display| refused(file, error);
    let opened = File::open(file).map_err(|error| wrong(&error))?;
    let map = ply::read(BufReader::new(opened)).map_err(|error| wrong(&error))?;
    let beside = ply::ambiguous_path(file);
    let means = map
        .gaussians
        .iter()
        .map(|gaussian: &Gaussian| gaussian.mean_m);
    let (low, high) = means.fold((None, None), |(low, high), p| {
        let low = low.map_or(p, |low: glam::Vec3| low.min(p));
        let high = high.map_or(p, |high: glam::Vec3| high.max(p));
        (Some(low), Some(high))
    });
    let mut facts = Facts::new();
    facts.insert("gaussians".to_owned(), map.gaussians.len().into());
    if map.refused.count > 0 {
        facts.insert(LEFT_OUT.to_owned(), map.refused.to_string().into());
    }
    facts.insert("has_ambiguous_file".to_owned(), beside.is_file().into());
    facts.insert("origin_m".to_owned(), json!(map.origin_m.to_array()));
    if let Some(place) = &map.notes.georeference {
        facts.insert("georeference".to_owned(), place.line().into());
    }
    facts.insert("least_m".to_owned(), json!(low.map(|p| p.to_array())));
    facts.insert("greatest_m".to_owned(), json!(high.map(|p| p.to_array())));
    Ok(facts)
}
