//! `MAVLink` messages as JSON in packets of id 150, between the profiles of a `.svlog`.
//!
//! A profile's time is its session's `timestamp` plus the device time since that session's first
//! profile. The vehicle's clock since boot differs from the device's by a constant: packets are
//! logged as they arrive, so the profile behind a message is no older than it, and the least
//! difference between the two is the constant.

use std::io::BufReader;
use std::path::Path;

use echosplat_firmware_protocol::{Decoder, Event, Frame, Message as Packet, id};
use echosplat_model::Timestamp;
use echosplat_recording::svlog::{SessionHeader, SvlogError, SvlogReader};

use super::found::{LogPosesError, in_order};
use crate::mavlink::json;
use crate::mavlink::message::{Message, Sender, Station};
use crate::mavlink::origin::OriginEpochs;
use crate::mavlink::vehicle::Vehicle;
use echosplat_georeference::Georeference;
use echosplat_join::ArrivedPose;

const NANOS_PER_MILLI: i64 = 1_000_000;
/// Stamps beyond 2001 are Unix time already, not time since boot.
const LEAST_UNIX_NANOS: i64 = 1_000_000_000_000_000_000;

/// Poses of a log, and where on Earth they count from.
#[derive(Debug)]
pub struct SvlogPoses {
    /// On the time that the log's profiles are given.
    pub poses: Vec<ArrivedPose>,
    /// Where each epoch's world lies that the vehicle says so of.
    pub origins: Vec<(u32, Georeference)>,
    /// Whether x of their world points somewhere else than east.
    pub lacks_north: bool,
}

/// The poses of one vehicle in a log, of several of an autopilot and of the one with most, on the time that the log's profiles are given.
///
/// # Errors
/// If it is no `.svlog`, or there are no poses in it; then what it holds instead.
pub fn poses_of_svlog(path: &Path) -> Result<SvlogPoses, LogPosesError> {
    let io = |reason| LogPosesError::Io {
        path: path.to_owned(),
        reason,
    };
    let format = |reason: SvlogError| LogPosesError::Format {
        path: path.to_owned(),
        reason: reason.to_string(),
    };
    let file = echosplat_input::open_file(path).map_err(io)?;
    let mut reader = SvlogReader::new(BufReader::new(file)).map_err(format)?;
    let mut decoder = Box::new(Decoder::new());
    let mut log = Log::default();
    while let Some(piece) = reader.next_piece().map_err(format)? {
        decoder.feed(piece, &mut |event| log.take(&event));
    }
    decoder.finish(&mut |event| log.take(&event));
    log.finish(path).map_err(|reason| LogPosesError::None {
        path: path.to_owned(),
        reason,
    })
}

/// Senders told apart; a log of a vehicle has a few.
const MOST_SENDERS: usize = 16;

/// What was read so far.
#[derive(Default)]
struct Log {
    voices: Vec<Voice>,
    packet_count: u64,
    position_count: u64,
    first_fault: Option<String>,
    start: Timestamp,
    profile: Profiles,
}

/// One sender of messages.
struct Voice {
    sender: Sender,
    is_autopilot: bool,
    vehicle: Vehicle,
    session: Session,
    poses: Vec<ArrivedPose>,
    /// Of the newest pose.
    epoch: Option<u32>,
    epochs: OriginEpochs,
    origins: Vec<(u32, Georeference)>,
}

impl Voice {
    fn new(sender: Sender) -> Self {
        Self {
            sender,
            is_autopilot: false,
            vehicle: Vehicle::of_log(),
            session: Session::default(),
            poses: Vec::new(),
            epoch: None,
            epochs: OriginEpochs::default(),
            origins: Vec::new(),
        }
    }

    /// When what has no stamp of its own counts as arrived.
    fn newest_boot(&self) -> Timestamp {
        Timestamp::from_nanos(self.vehicle.newest_boot().unwrap_or(0))
    }

    fn keep(&mut self, poses: Vec<ArrivedPose>) {
        for pose in poses {
            // One that is reckoned waits for what completes it, and is older than that.
            let heard = pose.pose.time.max(pose.arrived);
            self.session.unmatched_boot = Some(heard.nanos());
            self.session.poses.push(pose);
            if self.epoch.replace(pose.pose.epoch) != Some(pose.pose.epoch) {
                self.note_origin();
            }
        }
    }

    /// Poses of the newest epoch count from where the vehicle says by now.
    fn note_origin(&mut self) {
        let Some(epoch) = self.epoch else { return };
        let told = self.vehicle.origin();
        let found = self.epochs.of(epoch, told.as_ref());
        let is_known = self.origins.iter().any(|(known, _)| *known == epoch);
        self.origins
            .extend(found.filter(|_| !is_known).map(|place| (epoch, place)));
    }

    fn end_session(&mut self, start: Timestamp) {
        let session = std::mem::take(&mut self.session);
        self.poses.extend(session.on_its_clock(start));
    }
}

/// Profiles since the newest session packet.
#[derive(Default)]
struct Profiles {
    first_ms: Option<u32>,
    channel: Option<u8>,
}

/// Since the newest session packet.
#[derive(Default)]
struct Session {
    /// Nanoseconds since boot of the newest message behind the newest profile.
    unmatched_boot: Option<i64>,
    /// Time since the first profile minus time since boot.
    least: Option<i64>,
    /// On the clock since boot.
    poses: Vec<ArrivedPose>,
}

impl Log {
    fn take(&mut self, event: &Event<'_>) {
        let Event::Frame(frame) = event else { return };
        match frame.message_id() {
            id::JSON => {
                if let Ok(header) = SessionHeader::parse(frame.payload()) {
                    self.end_session();
                    self.start = header.timestamp;
                }
            }
            id::MAVLINK => self.take_mavlink(frame.payload()),
            id::OS_MONO_PROFILE => self.take_profile(frame),
            _ => {}
        }
    }

    fn take_mavlink(&mut self, text: &[u8]) {
        self.packet_count += 1;
        let (sender, message) = match json::parse(text) {
            Ok(Some(found)) => found,
            Ok(None) => return,
            Err(what) => {
                let fault = || format!("MAVLink packet: {what}");
                self.first_fault.get_or_insert_with(fault);
                return;
            }
        };
        if message.is_aiding() {
            // From whomever, it may tell any of the vehicles how it moves.
            for voice in &mut self.voices {
                let poses = voice.vehicle.aided(sender, &message, voice.newest_boot());
                voice.keep(poses);
            }
            return;
        }
        let Some(voice) = voice_of(&mut self.voices, sender) else {
            return;
        };
        if let Message::Heartbeat(station) = message {
            voice.is_autopilot = station == Station::Autopilot;
        }
        let is_beside = matches!(
            message,
            Message::GlobalOrigin(_)
                | Message::GlobalPosition { .. }
                | Message::Height(_)
                | Message::EstimateStatus { .. }
        );
        if is_beside {
            let poses = voice.vehicle.take(message, voice.newest_boot());
            voice.keep(poses);
            return voice.note_origin();
        }
        let Some(boot) = boot_nanos(&message) else {
            return;
        };
        self.position_count += u64::from(matches!(message, Message::Position { .. }));
        // When it arrived is not written down; of a log only the order matters.
        let arrived = Timestamp::from_nanos(boot);
        let poses = voice.vehicle.take(message, arrived);
        voice.keep(poses);
    }

    fn take_profile(&mut self, frame: &Frame<'_>) {
        let Ok(Packet::OsMonoProfile(profile)) = Packet::parse(frame) else {
            return;
        };
        let channel = self.profile.channel.get_or_insert(profile.channel_number);
        if *channel != profile.channel_number {
            return;
        }
        let first_ms = self.profile.first_ms.get_or_insert(profile.timestamp_ms);
        // The counter wraps after 49.7 days; no session is half as long.
        let since_ms = profile.timestamp_ms.wrapping_sub(*first_ms).cast_signed();
        for voice in &mut self.voices {
            voice.session.take_profile(since_ms);
        }
    }

    fn end_session(&mut self) {
        self.profile = Profiles::default();
        let start = self.start;
        self.voices
            .iter_mut()
            .for_each(|voice| voice.end_session(start));
    }

    fn finish(mut self, path: &Path) -> Result<SvlogPoses, String> {
        let made = self.voices.iter();
        let made_count: usize = made.map(|v| v.session.poses.len() + v.poses.len()).sum();
        self.end_session();
        let place = |voice: &&mut Voice| (voice.is_autopilot, voice.poses.len());
        let with_poses = self
            .voices
            .iter_mut()
            .filter(|voice| !voice.poses.is_empty());
        if let Some(voice) = with_poses.max_by_key(place) {
            let (sender, poses) = (voice.sender, std::mem::take(&mut voice.poses));
            let status = voice.vehicle.status(Timestamp::ZERO);
            let (origins, lacks_north) = (std::mem::take(&mut voice.origins), status.lacks_north);
            self.tell_others(path, sender);
            return Ok(SvlogPoses {
                poses: in_order(poses),
                origins,
                lacks_north,
            });
        }
        let statuses = self
            .voices
            .iter()
            .map(|voice| voice.vehicle.status(Timestamp::ZERO));
        let fault = statuses.filter_map(|status| status.first_fault).next();
        let received = self.voices.iter().any(|voice| voice.vehicle.received() > 0);
        Err(match self.first_fault.or(fault) {
            Some(fault) => fault,
            None if self.packet_count == 0 => "there are no MAVLink packets (id 150) in it".into(),
            None if made_count > 0 => "there are no profiles to tell the sonar's clock by".into(),
            None if received && self.position_count == 0 => {
                "its MAVLink packets have attitudes but no LOCAL_POSITION_NED, no ODOMETRY and no velocity over ground for 5 s \
                 (VISION_POSITION_DELTA): the vehicle knew no position"
                    .into()
            }
            None => format!(
                "its {} MAVLink packets have no ATTITUDE with a LOCAL_POSITION_NED within 0.5 s",
                self.packet_count
            ),
        })
    }

    fn tell_others(&self, path: &Path, used: Sender) {
        let others = self.voices.iter().filter(|voice| !voice.poses.is_empty());
        for other in others {
            tracing::warn!(
                "{}: it holds poses of two vehicles; those of {used} are used, {} of {} are left out",
                path.display(),
                other.poses.len(),
                other.sender
            );
        }
    }
}

fn voice_of(voices: &mut Vec<Voice>, sender: Sender) -> Option<&mut Voice> {
    let index = voices.iter().position(|voice| voice.sender == sender);
    let index = index.unwrap_or(voices.len());
    if index == voices.len() {
        if index == MOST_SENDERS {
            return None;
        }
        voices.push(Voice::new(sender));
    }
    voices.get_mut(index)
}

impl Session {
    fn take_profile(&mut self, since_ms: i32) {
        if let Some(boot) = self.unmatched_boot.take() {
            let apart = i64::from(since_ms) * NANOS_PER_MILLI - boot;
            self.least = Some(self.least.map_or(apart, |least| least.min(apart)));
        }
    }

    fn on_its_clock(self, start: Timestamp) -> impl Iterator<Item = ArrivedPose> {
        let least = self.least;
        self.poses.into_iter().filter_map(move |arrived| {
            let mut pose = arrived.pose;
            if pose.time.nanos() < LEAST_UNIX_NANOS {
                let since_first = pose.time.nanos().saturating_add(least?);
                pose.time = start.offset_by_nanos(since_first);
            }
            Some(ArrivedPose::at_its_stamp(pose))
        })
    }
}

/// Of the messages that poses are made of; the Unix time that a vehicle claims is not asked.
fn boot_nanos(message: &Message) -> Option<i64> {
    match message {
        Message::Attitude { boot_ms, .. } | Message::Position { boot_ms, .. } => {
            Some(i64::from(*boot_ms) * NANOS_PER_MILLI)
        }
        Message::Odometry(odometry) => i64::try_from(odometry.time_us)
            .ok()
            .map(|us| us.saturating_mul(1_000)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_firmware_protocol::{OsMonoProfile, PowerResults};
    use echosplat_recording::svlog::SvlogWriter;

    fn frame(message: &Packet<'_>) -> Vec<u8> {
        let mut bytes = vec![0; 4096];
        let length = message.encode(1, 0, &mut bytes).unwrap();
        bytes.truncate(length);
        bytes
    }

    fn profile(timestamp_ms: u32) -> Vec<u8> {
        let results = [0; 400];
        frame(&Packet::OsMonoProfile(OsMonoProfile {
            ping_number: timestamp_ms / 50,
            start_mm: 0,
            length_mm: 10_000,
            timestamp_ms,
            ping_hz: 451_127,
            gain_index: 0,
            sos_dmps: 15_000,
            channel_number: 0,
            pulse_duration_sec: 3e-5,
            analog_gain: 1.0,
            max_pwr_db: 60.0,
            min_pwr_db: -20.0,
            transducer_heading_deg: 0.0,
            vehicle_heading_deg: 0.0,
            pwr_results: PowerResults::from_bytes(&results).unwrap(),
        }))
    }

    fn mavlink(kind: &str, boot_ms: u32, fields: &str) -> Vec<u8> {
        let json = format!(
            r#"{{"header":{{"system_id":1,"component_id":1,"sequence":0}},"message":{{"type":"{kind}","time_boot_ms":{boot_ms},{fields}}}}}"#
        );
        frame(&Packet::Mavlink(json.as_str().into()))
    }

    fn attitude(boot_ms: u32) -> Vec<u8> {
        mavlink("ATTITUDE", boot_ms, r#""roll":0.0,"pitch":0.0,"yaw":0.0"#)
    }

    fn position(boot_ms: u32) -> Vec<u8> {
        let fields = r#""x":1.0,"y":2.0,"z":3.0,"vx":0.0,"vy":0.0,"vz":0.0"#;
        mavlink("LOCAL_POSITION_NED", boot_ms, fields)
    }

    fn poses_of(frames: &[Vec<u8>]) -> Result<SvlogPoses, LogPosesError> {
        let start = Timestamp::from_millis(1_714_564_800_000);
        let header = SessionHeader::new(start, 3, "tcp://192.168.2.92:51200");
        let mut writer = SvlogWriter::new(Vec::new(), &header).unwrap();
        frames
            .iter()
            .for_each(|frame| writer.write_frame(frame).unwrap());
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), writer.finish().unwrap()).unwrap();
        poses_of_svlog(file.path())
    }

    #[test]
    fn poses_are_on_the_time_of_the_profiles() {
        // The sonar was switched on 70 s before the autopilot; messages come up to 30 ms late.
        let mut frames = Vec::new();
        for i in 0..100_u32 {
            let now_ms = 1_000 + i * 50;
            frames.push(profile(70_000 + now_ms));
            frames.push(position(now_ms + 10));
            frames.push(attitude(now_ms + 20 + (i % 3) * 10));
        }
        let fields = r#""lat":601700000,"lon":249400000,"alt":-1500"#;
        frames.insert(8, mavlink("GLOBAL_POSITION_INT", 1_110, fields));
        let found = poses_of(&frames).unwrap();
        let [(0, origin)] = &found.origins[..] else {
            panic!("the vehicle says where it is on Earth")
        };
        // It is 1 m north and 2 m east of there, and 3 m below.
        assert!(
            (origin.place.latitude_deg - 60.17 + 1.0 / 111_420.0).abs() < 1e-7,
            "{origin:?}"
        );
        assert!((origin.place.height_m - 1.5).abs() < 1e-3, "{origin:?}");
        let poses = found.poses;
        assert_eq!(poses.len(), 100);
        // At the first profile boot time is 1,000 ms; the first attitude is 20 ms behind it.
        let since_start_ms = poses[0].pose.time.nanos() / 1_000_000 - 1_714_564_800_000;
        assert!((0..=40).contains(&(since_start_ms)), "{since_start_ms}");
        let place = poses[0].pose.world_from_vehicle.translation_m;
        let expected = echosplat_model::glam::DVec3::new(2.0, 1.0, -3.0);
        assert_eq!(place, expected);
    }

    /// An autopilot that is switched on again counts from elsewhere.
    #[test]
    fn after_a_reboot_an_origin_has_to_be_said_again() {
        let log = |says_again: bool| {
            let mut frames = Vec::new();
            let says = |latitude: i32| {
                let fields = format!(r#""latitude":{latitude},"longitude":249400000,"altitude":0"#);
                mavlink("GPS_GLOBAL_ORIGIN", 0, &fields)
            };
            for i in 0..400_u32 {
                // Booted again after ten seconds.
                let boot_ms = if i < 200 {
                    60_000 + i * 50
                } else {
                    1_000 + i * 50
                };
                frames.push(profile(i * 50));
                frames.push(position(boot_ms));
                frames.push(attitude(boot_ms + 10));
                if i == 20 {
                    frames.push(says(601_700_000));
                }
                if i == 300 && says_again {
                    frames.push(says(601_800_000));
                }
            }
            let origins = poses_of(&frames).unwrap().origins;
            origins
                .into_iter()
                .map(|(epoch, place)| (epoch, place.place.latitude_deg))
                .collect::<Vec<_>>()
        };
        let [(0, latitude_deg)] = log(false)[..] else {
            panic!("only the first world is placed")
        };
        assert!((latitude_deg - 60.17).abs() < 1e-9);
        let [(0, _), (1, latitude_deg)] = log(true)[..] else {
            panic!("both are")
        };
        assert!((latitude_deg - 60.18).abs() < 1e-9);
    }

    /// A log of attitude and of what the DVL extension tells the autopilot, blind from and to so many milliseconds.
    fn log_of_velocities(blind_ms: std::ops::Range<u32>) -> Vec<Vec<u8>> {
        let delta = r#"{"header":{"system_id":255,"component_id":0},"message":{"type":"VISION_POSITION_DELTA",
            "time_usec":0,"time_delta_usec":100000,"position_delta":[0.05,0,0],"confidence":90}}"#;
        let mut frames = Vec::new();
        for i in 0..800_u32 {
            // The sonar was switched on 70 s before the autopilot.
            let now_ms = 1_000 + i * 50;
            frames.push(profile(70_000 + now_ms));
            frames.push(attitude(now_ms));
            if i % 2 == 0 && !blind_ms.contains(&now_ms) {
                frames.push(frame(&Packet::Mavlink(delta.into())));
            }
        }
        frames
    }

    #[test]
    fn a_log_of_velocities_alone_gives_poses_on_the_time_of_the_profiles() {
        let poses = poses_of(&log_of_velocities(20_000..25_000)).unwrap().poses;
        // All but the last, which wait for a velocity behind them.
        assert!((790..800).contains(&poses.len()), "{}", poses.len());
        assert!(poses.iter().all(|pose| pose.pose.epoch == 0));
        let (first, last) = (&poses[0].pose, &poses[poses.len() - 1].pose);
        let since_start_ms = first.time.nanos() / 1_000_000 - 1_714_564_800_000;
        assert!((0..=100).contains(&since_start_ms), "{since_start_ms}");
        let moved_m =
            last.world_from_vehicle.translation_m - first.world_from_vehicle.translation_m;
        let passed_s = last.time.seconds_since(first.time);
        // Yaw 0 is north.
        assert!((moved_m.y - 0.5 * passed_s).abs() < 0.01, "{moved_m}");
    }

    #[test]
    fn a_log_whose_gap_is_too_long_goes_on_in_another_epoch() {
        let poses = poses_of(&log_of_velocities(20_000..30_000)).unwrap().poses;
        let mut epochs: Vec<u32> = poses.iter().map(|pose| pose.pose.epoch).collect();
        epochs.dedup();
        assert_eq!(epochs, [0, 1]);
        let gaps = poses.windows(2);
        let gaps = gaps.map(|two| two[1].pose.time.seconds_since(two[0].pose.time));
        let longest_s = gaps.fold(0.0, f64::max);
        assert!((3.5..4.5).contains(&longest_s), "{longest_s}");
    }

    #[test]
    fn a_log_without_poses_says_what_it_has_instead() {
        let said = |frames: &[Vec<u8>]| poses_of(frames).unwrap_err().to_string();
        assert!(said(&[profile(0)]).contains("no MAVLink packets"));
        assert!(said(&[profile(0), attitude(0)]).contains("knew no position"));
        let no_profile = said(&[position(0), attitude(0)]);
        assert!(no_profile.contains("no profiles"), "{no_profile}");
        assert!(no_profile.contains("--poses F.tum"));
    }
}
