//! What a replay takes: logs or recordings, the poses that belong to them, and what the recorded
//! dive itself decided, so that its map comes out again.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use echosplat_bus::Bus;
use echosplat_driver::{DriverConfig, Pause, SonarUrl, Tape, TapeItem};
use echosplat_georeference::{
    BesideRule, FoundOrigin, Georeference, Heard, OriginFinder, declination,
};
use echosplat_join::{ArrivedPose, StampClock};
use echosplat_pose::{GnssLog, GnssUrl, LogPosesError, PoseSource, PoseUrl};
use echosplat_recording::mcap::{Messages, Record, Recording, RecordingReader, Scan};
use echosplat_session::{ClockSource, SessionConfig};
use serde_json::Value;

use crate::clock;
use crate::config::Config;
use crate::decided::Decided;
use crate::exit::Usage;
use crate::inputs;
use crate::kind::Kind;
use crate::pipeline::{
    Input, Patience, Poses, contradiction, georeference_of, heard_of, tell_separation,
};
use crate::recorder::{BEGIN, Recorder};

/// Topics named in an error.
const NAMED_TOPICS: usize = 8;

/// Logs, or the files of one recorded dive.
pub(crate) struct Replayed {
    paths: Vec<PathBuf>,
    pause: Pause,
    dive: Option<RecordedDive>,
    /// Of the poses inside the logs.
    of_logs: OnceLock<OfLogs>,
}

/// What is known of poses inside logs beside them.
#[derive(Debug, Default)]
struct OfLogs {
    /// Where on Earth each epoch of them counts from.
    origins: Vec<(u32, Georeference)>,
    /// Whether x of their world points elsewhere than east.
    lacks_north: bool,
}

/// Where on Earth poses count from, by their epoch.
type PlacesOfPoses = Vec<(u32, Georeference)>;

/// What a recording says of its dive beside the bytes.
struct RecordedDive {
    scan: Scan,
    /// As the dive asked the sonar, if the recording says it.
    session: Option<SessionConfig>,
    /// The bytes are those of a log, not of a link.
    is_log: bool,
}

/// Whether a file is a recording by its name or its first bytes; what it holds is checked when it is
/// read.
pub(crate) fn is_recording(path: &Path) -> bool {
    let is_named = path
        .extension()
        .is_some_and(|ext| ext.eq_ignore_ascii_case("mcap"));
    is_named || matches!(Kind::of(path), Ok(Kind::Recording))
}

impl Replayed {
    /// Looks into the files: what is no log is refused before anything is started.
    ///
    /// # Errors
    /// Says which file is what instead; also if logs and recordings are mixed.
    pub(crate) fn open(paths: &[PathBuf]) -> anyhow::Result<Self> {
        paths
            .iter()
            .try_for_each(|path| inputs::refuse_foreign(path))?;
        let recordings = paths.iter().filter(|path| is_recording(path)).count();
        if recordings == 0 {
            for path in paths {
                inputs::check_log(path)?;
            }
            return Ok(Self {
                paths: paths.to_owned(),
                pause: Pause::default(),
                dive: None,
                of_logs: OnceLock::new(),
            });
        }
        if recordings < paths.len() {
            let message = "logs (.svlog) and recordings (.mcap) cannot be replayed as one dive";
            return Err(Usage::error(message));
        }
        let scan = Recording::scan(paths).map_err(Usage::error)?;
        if scan.counts.raw == 0 {
            return Err(Usage::error(without_bytes(paths)));
        }
        Ok(Self {
            paths: paths.to_owned(),
            pause: Pause::default(),
            dive: Some(RecordedDive::of(scan)),
            of_logs: OnceLock::new(),
        })
    }

    /// The configuration a recorded dive was mapped with.
    pub(crate) fn settings(&self) -> Option<&str> {
        self.dive.as_ref()?.scan.settings.as_deref()
    }

    /// What the files lack or hold that is not of the dive, a sentence each. Of a log that is found as
    /// it is read.
    pub(crate) fn losses(&self) -> Vec<String> {
        let Some(dive) = &self.dive else {
            return Vec::new();
        };
        let mut losses = dive.scan.losses(false);
        if dive.scan.settings.is_none() {
            let file = self.paths[0].display();
            losses.push(format!(
                "{file} holds no settings of the dive, as what lacks its beginning or was written for ROS: those \
                 of --config or the defaults are used"
            ));
        }
        losses
    }

    /// Holds it, and lets it go on.
    pub(crate) fn pause(&self) -> &Pause {
        &self.pause
    }

    /// The drivers, one log after another, or one tape of a recorded dive.
    pub(crate) fn inputs(&self, config: &Config, rate: f64) -> Vec<Input> {
        match &self.dive {
            Some(dive) => vec![self.tape(dive, config, rate)],
            None => self
                .paths
                .iter()
                .map(|log| of_log(log, config, rate, &self.pause))
                .collect(),
        }
    }

    fn tape(&self, dive: &RecordedDive, config: &Config, rate: f64) -> Input {
        let paths = self.paths.clone();
        let url = SonarUrl::File(paths[0].clone());
        let driver = inputs::driver(config, url);
        Input {
            config: DriverConfig {
                rate,
                tape_is_log: dive.is_log,
                pause: Some(self.pause.clone()),
                session: dive.session.clone().unwrap_or(driver.session),
                ..driver
            },
            tape: Some(Box::new(move || open_tape(&paths))),
            byte_count: Some(dive.scan.counts.raw_bytes),
            records_itself: false,
        }
    }

    /// Where poses come from: as asked, else those that the files hold. Those of a recorded dive are
    /// judged as they were then. Also what a file of them lacks, a sentence each.
    ///
    /// # Errors
    /// If none were asked for and the files hold none: says what to give.
    pub(crate) fn poses(
        &self,
        asked: Option<&PoseUrl>,
        config: &Config,
        bus: Option<&Bus>,
        recorder: Option<Recorder>,
    ) -> anyhow::Result<(Poses, Vec<String>)> {
        let (source, losses) = self.pose_source(asked, bus)?;
        Ok((self.judged(source, asked, config, recorder)?, losses))
    }

    /// Poses of this source, as [`Replayed::poses`] has them.
    ///
    /// # Errors
    /// Names the setting that is out of range.
    pub(crate) fn judged(
        &self,
        source: PoseSource,
        asked: Option<&PoseUrl>,
        config: &Config,
        recorder: Option<Recorder>,
    ) -> anyhow::Result<Poses> {
        let poses = Poses::new(config, source, Patience::HoldBack, recorder)?;
        let takes_its_own = asked.is_none() || matches!(asked, Some(PoseUrl::Log(None)));
        let dive = self
            .dive
            .as_ref()
            .filter(|dive| !dive.is_log && takes_its_own);
        Ok(match dive {
            Some(dive) => poses.of_recording(dive.clock(), self.decided().let_go),
            None => poses,
        })
    }

    /// As [`Replayed::poses`] has them, before anybody judges them; and what a file of them lacks.
    ///
    /// # Errors
    /// As [`Replayed::poses`].
    pub(crate) fn pose_source(
        &self,
        asked: Option<&PoseUrl>,
        bus: Option<&Bus>,
    ) -> anyhow::Result<(PoseSource, Vec<String>)> {
        let source = match asked {
            Some(PoseUrl::Tum(path)) if is_recording(&file_and_topic(path).0) => {
                let (path, topic) = file_and_topic(path);
                inputs::refuse_foreign(&path)?;
                return foreign(&path, topic);
            }
            Some(PoseUrl::Log(Some(topic))) => return foreign(&self.paths[0], Some(topic)),
            Some(PoseUrl::Log(None)) | None => self.own_poses(),
            Some(url) => inputs::poses(url, bus, StampClock::Data),
        };
        Ok((source?, Vec::new()))
    }

    fn own_poses(&self) -> anyhow::Result<PoseSource> {
        let recorded = self.dive.as_ref().map(|dive| &dive.scan.poses);
        let held = match recorded.filter(|poses| !poses.is_empty()) {
            Some(poses) => poses
                .iter()
                .map(|&(pose, arrived)| ArrivedPose { pose, arrived })
                .collect(),
            None => self.poses_of_logs(),
        };
        match held.is_empty() {
            false => Ok(PoseSource::recorded(held)),
            true => Err(Usage::error(format!(
                "replay needs poses, and {} holds none: give --poses F.tum (lines `timestamp tx ty tz \
                 qx qy qz qw`), or --pose zenoh:// to take them from the bus{}",
                self.paths[0].display(),
                self.fixes_are_no_poses()
            ))),
        }
    }

    /// Where a log has fixes instead, in words.
    fn fixes_are_no_poses(&self) -> String {
        let gnss = self.gnss_of_logs();
        match gnss.messages {
            0 => String::new(),
            messages => format!(
                ". Its {messages} NMEA sentences with {} fixes tell where on Earth, and are no poses: they have no attitude, and \
                 end under water",
                gnss.fixes()
            ),
        }
    }

    /// What the recorded dive decided under its load; nothing of a log.
    pub(crate) fn decided(&self) -> Decided {
        let mut decided = Decided::default();
        let dive = self.dive.as_ref().filter(|dive| !dive.is_log);
        for (_, event) in dive.map_or(&[][..], |dive| &dive.scan.events) {
            decided.take(event);
        }
        decided
    }

    /// Where on Earth these poses count from. Fixes are asked where nothing else says it, and tell where they contradict.
    pub(crate) fn places(
        &self,
        asked: Option<&PoseUrl>,
        config: &Config,
        source: &PoseSource,
    ) -> PlacesOfPoses {
        let takes_its_own = asked.is_none() || matches!(asked, Some(PoseUrl::Log(None)));
        let dive = self.dive.as_ref();
        let of_logs = self.of_logs.get().filter(|_| takes_its_own);
        if let Some(dive) = dive.filter(|_| takes_its_own) {
            // What the dive found stands; it judged its poses, which are not judged here yet.
            let events = dive.scan.events.iter();
            return events
                .filter_map(|(_, event)| georeference_of(event))
                .collect();
        }
        let mut places = of_logs.map_or(Vec::new(), |of_logs| of_logs.origins.clone());
        let gnss = self.gnss(asked, config);
        let is_enu = !of_logs.is_some_and(|of_logs| of_logs.lacks_north);
        let rule = config
            .georeference
            .beside(is_enu, config.pose.max_pose_gap_s);
        for found in found_origins(rule, &gnss, source) {
            let given = config.georeference.georeference();
            let known = places.iter().find(|(epoch, _)| *epoch == found.epoch);
            match given.or_else(|| known.map(|(_, place)| place.clone())) {
                Some(known) if found.contradicts(&known) => {
                    tracing::warn!("{}", contradiction(&found, &known));
                }
                Some(_) => {}
                None => {
                    tell_separation(&found);
                    places.push((found.epoch, found.georeference));
                }
            }
        }
        places
    }

    /// Fixes beside poses: those of the file of poses, else of the logs or the recording, on the clock of poses.
    fn gnss(&self, asked: Option<&PoseUrl>, config: &Config) -> GnssLog {
        let bag = match asked {
            Some(PoseUrl::Tum(path)) if is_recording(&file_and_topic(path).0) => {
                Some(file_and_topic(path).0)
            }
            Some(PoseUrl::Log(Some(_))) => self.paths.first().cloned(),
            _ => None,
        };
        let topic = match &config.georeference.gnss {
            Some(GnssUrl::Ros2(topic)) => Some(topic.as_str()),
            _ => None,
        };
        if let Some(bag) = bag {
            let of_bag = told(echosplat_pose::fixes_of_mcap(&bag, topic), &bag);
            if of_bag.messages > 0 {
                return of_bag;
            }
        }
        if let Some(dive) = &self.dive {
            let heard = dive
                .scan
                .events
                .iter()
                .filter_map(|(_, event)| heard_of(event));
            let heard: Vec<Heard> = heard.collect();
            return GnssLog {
                messages: heard.len() as u64,
                heard,
                ..GnssLog::default()
            };
        }
        let mut all = self.gnss_of_logs();
        let offset_s = config.pose.time_offset_s;
        all.heard = all
            .heard
            .into_iter()
            .map(|heard| heard.offset_by(offset_s))
            .collect();
        all
    }

    /// NMEA of all logs, on the time of their profiles.
    fn gnss_of_logs(&self) -> GnssLog {
        let mut all = GnssLog::default();
        for path in self.paths.iter().filter(|path| !is_recording(path)) {
            let of_log = told(echosplat_pose::fixes_of_svlog(path), path);
            all.messages += of_log.messages;
            all.heard.extend(of_log.heard);
        }
        all.heard.sort_by_key(Heard::time);
        all
    }

    /// Poses in `MAVLink` packets of the logs.
    fn poses_of_logs(&self) -> Vec<ArrivedPose> {
        let mut all = Vec::new();
        let mut of_logs = OfLogs::default();
        for path in self.paths.iter().filter(|path| !is_recording(path)) {
            match echosplat_pose::poses_of_svlog(path) {
                Ok(found) => {
                    all.extend(found.poses);
                    of_logs.lacks_north |= found.lacks_north;
                    if of_logs.origins.is_empty() {
                        // The first log's: the poses of the others count from it too.
                        of_logs.origins = found.origins;
                    }
                }
                Err(error) => tracing::debug!(%error, "no poses inside the log"),
            }
        }
        // A replay that is repeated finds the same again.
        let _ = self.of_logs.set(of_logs);
        all.sort_by_key(|arrived| arrived.pose.time);
        all
    }
}

impl RecordedDive {
    fn of(scan: Scan) -> Self {
        let begin = Begun::of(&scan);
        Self {
            session: begin.session,
            is_log: begin.is_log,
            scan,
        }
    }

    /// Whose clock the pings were on.
    fn clock(&self) -> StampClock {
        match self.session.as_ref().map(|session| session.clock) {
            Some(ClockSource::Device) => StampClock::Data,
            _ => StampClock::Host,
        }
    }
}

/// What a recording says first of its run.
pub(crate) struct Begun {
    /// As the dive asked the sonar, if the recording says it.
    pub(crate) session: Option<SessionConfig>,
    /// The bytes are those of a log, not of a link.
    pub(crate) is_log: bool,
    /// Version of the program that recorded it, if the recording says it.
    pub(crate) program: Option<String>,
}

impl Begun {
    pub(crate) fn of(scan: &Scan) -> Self {
        let mut events = scan.events.iter().map(|(_, event)| event);
        let begin = events.find(|event| event["event"] == BEGIN);
        let session = |event: &Value| serde_json::from_value(event["session"].clone()).ok();
        Self {
            session: begin.and_then(session),
            is_log: begin.is_some_and(|event| event["is_log"] == true),
            program: begin
                .and_then(|event| event["program"].as_str())
                .map(str::to_owned),
        }
    }
}

/// What fixes say of the worlds of these poses, and why they do not.
fn found_origins(rule: BesideRule, gnss: &GnssLog, source: &PoseSource) -> Vec<FoundOrigin> {
    if gnss.heard.is_empty() {
        return Vec::new();
    }
    let mut finder = OriginFinder::new(rule);
    let mut heard = gnss.heard.iter().peekable();
    for pose in source.known() {
        while let Some(next) = heard.next_if(|heard| heard.time() <= pose.time) {
            finder.heard(*next);
        }
        finder.pose(&pose);
    }
    finder.finish();
    let counters = finder.counters();
    if counters.fixes > 0 && counters.beside_poses == 0 {
        tracing::warn!(
            "{} fixes of a GNSS receiver came at times without poses, and place nothing",
            gnss.fixes()
        );
    }
    if let Some(trouble) = finder.trouble() {
        tracing::warn!("GNSS: {trouble}");
    }
    if finder.moved_m() > 0.0 {
        tracing::warn!(
            "later fixes of the GNSS receiver have the world's origin {:.1} m from where the first have it, which stays: poses \
             drift",
            finder.moved_m()
        );
    }
    finder.found().to_vec()
}

/// How far a compass is from true north where and when the first fix was, in words.
fn declination_at(heard: &[Heard]) -> Option<String> {
    let fix = heard.iter().find_map(|heard| match heard {
        Heard::Fix(fix) => Some(fix),
        Heard::Heading { .. } => None,
    })?;
    let unix_day = clock::unix_day(fix.time);
    let day = clock::iso_day(unix_day);
    Some(match declination(&fix.place, unix_day) {
        Ok(found) => format!(
            ", which a compass is {:+.1} degrees from there on {day}",
            found.declination_deg
        ),
        Err(error) => format!("; {error} ({day})"),
    })
}

/// Fixes of a log, having told what of them is not used.
fn told(found: Result<GnssLog, LogPosesError>, path: &Path) -> GnssLog {
    let log = match found {
        Ok(log) => log,
        Err(error) => {
            tracing::debug!(%error, "no fixes inside the file");
            return GnssLog::default();
        }
    };
    let name = path.display();
    if log.refused > 0 {
        let first = log.first_fault.as_deref().unwrap_or_default();
        tracing::warn!(
            "{name}: {} GNSS messages in it cannot be used; the first: {first}",
            log.refused
        );
    }
    if log.magnetic_headings > 0 && log.fixes() > 0 {
        tracing::info!(
            "{name}: its {} magnetic headings (HDG, HDM) are not used: HDT is a heading from true north{}",
            log.magnetic_headings,
            declination_at(&log.heard).unwrap_or_default()
        );
    }
    if log.messages > 0 && log.fixes() == 0 {
        tracing::warn!("{name}: {} GNSS messages in it, and no fix", log.messages);
    }
    log
}

/// `F.mcap` and `/odom` of `F.mcap#/odom`. A file of the whole name goes first.
fn file_and_topic(path: &Path) -> (PathBuf, Option<&str>) {
    let parts = path.to_str().and_then(|text| text.rsplit_once('#'));
    match parts {
        Some((file, topic)) if !topic.is_empty() && !path.exists() => (file.into(), Some(topic)),
        _ => (path.to_owned(), None),
    }
}

/// Poses in an MCAP file of another program, and what that lacks.
fn foreign(path: &Path, topic: Option<&str>) -> anyhow::Result<(PoseSource, Vec<String>)> {
    let held = echosplat_pose::poses_of_mcap(path, topic).map_err(Usage::error)?;
    Ok((PoseSource::recorded(held.poses), held.losses))
}

/// Why there is nothing to map: what the files hold instead.
fn without_bytes(paths: &[PathBuf]) -> String {
    let file = paths[0].display();
    if paths.iter().all(|path| inputs::is_empty(path)) {
        return format!("{file}: the file is empty; expected a recording (.mcap)");
    }
    let mut topics: Vec<String> = Vec::new();
    for path in paths {
        let Ok(mut messages) = Messages::open(path) else {
            continue;
        };
        while let Ok(Some(message)) = messages.next_message() {
            let channel = messages.channel(message.header.channel_id);
            let name = channel.map(|channel| format!("{} ({})", channel.topic, channel.schema));
            topics.extend(name.filter(|name| !topics.contains(name)));
        }
    }
    topics.sort();
    topics.truncate(NAMED_TOPICS);
    let held = match topics.is_empty() {
        true => "no messages at all".to_owned(),
        false => topics.join(", "),
    };
    format!(
        "{file}: holds no bytes of a sonar (topic /sonar/raw), so there is nothing to map; it has {held}. \
         Poses of another program go beside a log: `echosplat replay LOG --poses {file}`"
    )
}

fn of_log(log: &Path, config: &Config, rate: f64, pause: &Pause) -> Input {
    let url = SonarUrl::File(log.to_owned());
    Input {
        config: DriverConfig {
            rate,
            pause: Some(pause.clone()),
            ..inputs::driver(config, url)
        },
        tape: None,
        byte_count: fs::metadata(log).ok().map(|metadata| metadata.len()),
        records_itself: false,
    }
}

/// The bytes and the link's news of a recording, in the order they came, with a mark behind each pose
/// that says how many there were.
///
/// # Errors
/// If a file is no recording.
pub(crate) fn open_tape(paths: &[PathBuf]) -> anyhow::Result<Tape> {
    let mut reader = RecordingReader::open(paths).map_err(Usage::error)?;
    let mut poses = 0;
    let next = move || loop {
        let recorded = match reader.next_message() {
            Ok(recorded) => recorded?,
            Err(error) => return Some(Err(error.to_string())),
        };
        let item = match recorded.record {
            Record::LinkUp => TapeItem::LinkUp,
            Record::LinkDown => TapeItem::LinkDown,
            Record::HalfFrameExpired => TapeItem::HalfFrameExpired,
            Record::Raw(bytes) => TapeItem::Bytes(bytes),
            Record::Pose(_) => {
                poses += 1;
                TapeItem::Mark(poses)
            }
            _ => continue,
        };
        return Some(Ok((recorded.host_time, item)));
    };
    Ok(Box::new(std::iter::from_fn(next)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_stands_behind_the_file_unless_a_file_is_called_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let (file, topic) = (path("a.mcap"), path("a.mcap#/odom"));
        assert_eq!(file_and_topic(&topic), (file.clone(), Some("/odom")));
        assert_eq!(file_and_topic(&file), (file.clone(), None));
        let odd = path("b#2.mcap");
        fs::write(&odd, "").unwrap();
        assert_eq!(file_and_topic(&odd), (odd.clone(), None));
        let none = path("a.mcap#");
        assert_eq!(file_and_topic(&none), (none.clone(), None));
    }
}
