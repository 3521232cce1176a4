//! What is told of a run: rates, every counter of what was left out and why, link, latency,
//! memory.

use std::time::{Duration, Instant};

use echosplat_bus::{MapPublisherCounters, RosCounters, Unreached};
use echosplat_driver::DriverStatus;
use echosplat_liveness::Drill;
use serde::Serialize;
use serde_json::{Value, json};

use super::diagnosis::finding_of_units;
use super::notices::Notice;
use super::shared::{Link, MapperReport, Phase};
use crate::recorder::RecorderCounters;
use crate::split::TapeReport;
use crate::supervisor::PartReport;
use crate::{logging, processor, simd};

/// Of the members of a status and what they mean. Members may be added without another one.
pub(crate) const STATUS_VERSION: u32 = 1;

/// Share of pings left out beyond which a run counts as lossy.
const LOSSY_SHARE: f64 = 0.01;

/// One run at one moment.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Status {
    /// [`STATUS_VERSION`].
    pub(crate) status_version: u32,
    /// Host time.
    pub(crate) time_ns: i64,
    /// How far the run is.
    pub(crate) phase: Phase,
    /// Whether this is the last of it.
    #[serde(rename = "final")]
    pub(crate) is_final: bool,
    /// Since the start.
    pub(crate) wall_s: f64,
    /// Intact profiles decoded.
    pub(crate) pings_received: u64,
    /// Pings not in the map, all reasons together.
    pub(crate) pings_left_out: u64,
    pub(crate) rates: Rates,
    /// The link to the sonar.
    pub(crate) link: Link,
    /// Vector instructions that the map is made with.
    pub(crate) simd: &'static str,
    /// Of the mapper's thread.
    #[serde(flatten)]
    pub(crate) report: MapperReport,
    /// Of the sonar's thread.
    pub(crate) sonar: DriverStatus,
    /// Of the map's publisher.
    pub(crate) publisher: Option<MapPublisherCounters>,
    /// Of what is published for ROS.
    pub(crate) ros: Option<RosCounters>,
    /// Raw pings that the bus dropped.
    pub(crate) pings_not_published: u64,
    pub(crate) recording: Option<RecorderCounters>,
    /// Why the recording lacks something just now.
    pub(crate) recording_fault: Option<String>,
    /// Why the map could not be written last.
    pub(crate) map_fault: Option<String>,
    /// That another service maps under the same name.
    pub(crate) other_service: Option<String>,
    /// Where nobody is reached on the bus, while nobody is.
    pub(crate) bus_unreached: Vec<Unreached>,
    /// Whether a replay is held; `null` where nothing is replayed.
    pub(crate) replay_is_held: Option<bool>,
    /// Whether the threads of the run are alive.
    pub(crate) parts: Vec<PartReport>,
    /// The drill that is armed.
    pub(crate) drill: Option<String>,
    /// Lines of the log that are missing in it, since nobody read it.
    pub(crate) log_lines_dropped: u64,
    /// What is wrong, and what was.
    pub(crate) notices: Vec<Notice>,
    /// Warnings that the log left out since many of their kind came.
    pub(crate) warnings_left_out: u64,
    #[serde(skip)]
    pub(crate) newest_notice: Option<String>,
    /// How much of the logs has been read, 0 to 1; `null` for a sonar.
    pub(crate) input_share: Option<f64>,
    /// Of a mapper whose driver is elsewhere: what came from there.
    pub(crate) tape: Option<TapeReport>,
    /// What is known to be missing or wrong in the recordings that are read, a sentence each.
    pub(crate) input_losses: Vec<String>,
    /// Where every ping received is.
    pub(crate) ledger: Ledger,
    pub(crate) memory_bytes: u64,
    pub(crate) peak_memory_bytes: u64,
}

/// Where the pings are: `received` is the sum of all others, at any moment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Ledger {
    /// Intact pings that the session made of profiles.
    pub(crate) received: u64,
    /// In the map.
    pub(crate) mapped: u64,
    /// Kept from the map to judge it by.
    pub(crate) held_out: u64,
    /// Without a pose.
    pub(crate) without_pose: u64,
    /// With a pose or motion that cannot be.
    pub(crate) rejected: u64,
    /// Twice in the logs, and taken once.
    pub(crate) repeated: u64,
    /// Before `--start` or after `--end`, `--duration` or the end asked for.
    pub(crate) not_wanted: u64,
    /// Dropped since a queue was full, or as the recorded dive had dropped them.
    pub(crate) shed: u64,
    /// Between the sonar's thread and the mapper's.
    pub(crate) queued: u64,
    /// Waiting for poses.
    pub(crate) waiting: u64,
}

impl Ledger {
    fn of(report: &MapperReport, sonar: &DriverStatus) -> Self {
        let join = &report.poses.join;
        let taken = report.pings_taken;
        Self {
            received: sonar.pings_sent + sonar.pings_dropped,
            mapped: report.pings_mapped,
            held_out: report.pings_held_out,
            without_pose: join.pings_without_pose() - join.pings_dropped_full,
            rejected: report.pings_rejected,
            repeated: report.pings_repeated,
            not_wanted: report.pings_before_start + report.pings_after_end,
            shed: sonar.pings_dropped + join.pings_dropped_full + report.pings_shed,
            queued: sonar.pings_sent.saturating_sub(taken),
            waiting: report.poses.waiting as u64,
        }
    }
}

/// Per second of wall time, since the status before.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct Rates {
    pub(crate) pings_per_s: f64,
    pub(crate) mapped_per_s: f64,
    pub(crate) bytes_per_s: f64,
}

/// Makes rates of counters.
#[derive(Debug, Default)]
pub(crate) struct RateMeter {
    before: Option<(Instant, [u64; 3])>,
    rates: Rates,
}

/// Rates over less would be those of a few pings.
const RATES_OVER: Duration = Duration::from_millis(900);

impl RateMeter {
    /// Takes the counters of the moment.
    pub(crate) fn measure(&mut self, now: Instant, counters: [u64; 3]) {
        let (then, old) = *self.before.get_or_insert((now, counters));
        let passed = now.saturating_duration_since(then);
        if passed < RATES_OVER {
            return;
        }
        let rate = |i: usize| counters[i].saturating_sub(old[i]) as f64 / passed.as_secs_f64();
        self.rates = Rates {
            pings_per_s: rate(0),
            mapped_per_s: rate(1),
            bytes_per_s: rate(2),
        };
        self.before = Some((now, counters));
    }

    /// Over the last second or so.
    pub(crate) fn rates(&self) -> Rates {
        self.rates
    }
}

impl Status {
    /// From what the threads report; the rest is measured here.
    pub(crate) fn of(report: MapperReport, sonar: DriverStatus) -> Self {
        let received = intact_profiles(&sonar);
        Self {
            status_version: STATUS_VERSION,
            time_ns: crate::clock::now().nanos(),
            phase: Phase::Running,
            is_final: false,
            wall_s: 0.0,
            pings_received: received,
            pings_left_out: sonar.pings_dropped
                + report.poses.join.pings_without_pose()
                + report.pings_rejected
                + report.pings_shed,
            rates: Rates::default(),
            link: Link::default(),
            simd: simd::name(),
            ledger: Ledger::of(&report, &sonar),
            report,
            sonar,
            publisher: None,
            ros: None,
            pings_not_published: 0,
            recording: None,
            recording_fault: None,
            map_fault: None,
            other_service: None,
            bus_unreached: Vec::new(),
            replay_is_held: None,
            parts: Vec::new(),
            drill: Drill::armed().map(ToString::to_string),
            log_lines_dropped: logging::lines_dropped(),
            notices: Vec::new(),
            warnings_left_out: logging::warnings_left_out(),
            newest_notice: None,
            input_share: None,
            tape: None,
            input_losses: Vec::new(),
            memory_bytes: processor::memory_bytes(),
            peak_memory_bytes: processor::peak_memory_bytes(),
        }
    }

    /// What `--json` prints of a finished run; fields may be added to it.
    pub(crate) fn summary(&self) -> Value {
        let session = &self.sonar.session;
        json!({
            "status_version": self.status_version,
            "pings_received": self.pings_received,
            "pings_mapped": self.report.pings_mapped,
            "pings_held_back": self.report.pings_held_out,
            "pings_without_pose": self.report.poses.join.pings_without_pose(),
            "frames_bad": session.frames_bad,
            "bytes_skipped": session.bytes_skipped,
            "simd": self.simd,
            "gaussians": self.report.mapper.confident,
            "ambiguous": self.report.mapper.ambiguous,
            "compute_s": self.report.work.compute_s,
            "wall_s": self.wall_s,
            "dive_s": self.report.dive_s,
            "peak_memory_bytes": self.peak_memory_bytes,
            "pairs": self.report.work.pairs,
            "snapshots": self.report.snapshots,
            "lossy": self.loss(),
            "tape": self.tape,
            "poses": self.report.poses,
            "pings_before_start": self.report.pings_before_start,
            "pings_after_end": self.report.pings_after_end,
            "sonar": self.sonar,
            "prediction": self.report.prediction,
            "mapper": self.report.mapper,
            "effort": self.report.effort,
            "calibration": self.report.calibration,
            "recording": self.recording,
            "ledger": self.ledger,
            "parts": self.parts,
            "notices": self.notices,
            "maps": 1 + self.report.maps,
        })
    }

    /// The same in a few lines for people.
    pub(crate) fn account(&self) -> String {
        let without_pose = self.report.poses.join.pings_without_pose();
        let mapper = &self.report.mapper;
        let held_out = match self.report.pings_held_out {
            0 => String::new(),
            count => format!(", {count} held out"),
        };
        let prediction = self.report.prediction.map_or(String::new(), |found| {
            format!(
                "\n{:+.4} nats per bin above a constant on {} held-out pings",
                found.gain_per_bin, found.pings
            )
        });
        let foretold = match mapper.foretold.pings {
            0 => String::new(),
            pings => format!(
                "\n{:+.4} nats per bin above noise on {pings} pings before they were taken in",
                mapper.foretold.gain_nats_per_bin
            ),
        };
        format!(
            "{} pings received, {} mapped{held_out}, {without_pose} without a pose\n\
             {} damaged frames, {} bytes skipped\n\
             {} Gaussians, and {} ambiguous\n\
             {:.1} s of dive in {:.1} s, {:.1} s of computing, at most {:.0} MB of memory{foretold}{prediction}",
            self.pings_received,
            self.report.pings_mapped,
            self.sonar.session.frames_bad,
            self.sonar.session.bytes_skipped,
            mapper.confident,
            mapper.ambiguous,
            self.report.dive_s,
            self.wall_s,
            self.report.work.compute_s,
            self.peak_memory_bytes as f64 * 1e-6,
        )
    }

    /// Why the run counts as lossy, if it does: damage, truncation, or more than 1 % left out.
    pub(crate) fn loss(&self) -> Option<String> {
        // Which file, and what of it: damaged frames follow from that.
        if !self.input_losses.is_empty() {
            return Some(self.input_losses.join("; "));
        }
        let session = &self.sonar.session;
        let damaged = damaged_profiles(&self.sonar);
        if session.bytes_skipped > 0 || session.frames_bad > 0 || damaged > 0 {
            return Some(format!(
                "{} damaged frames, {damaged} damaged profiles, {} bytes skipped",
                session.frames_bad, session.bytes_skipped
            ));
        }
        let repeated = self.report.pings_repeated;
        if repeated > 0 {
            return Some(format!(
                "{repeated} of {} pings came twice, as if a log were given twice or held another: they \
                 were taken once",
                self.pings_received
            ));
        }
        let missing = self.tape.as_ref().map_or(0, |tape| tape.counters.missing);
        if missing > 0 {
            return Some(format!("{missing} records of the driver never came"));
        }
        let left_out = self.pings_left_out;
        let share = left_out as f64 / (self.pings_received.max(1)) as f64;
        if share > LOSSY_SHARE {
            return Some(format!(
                "{left_out} of {} pings are not in the map",
                self.pings_received
            ));
        }
        let lost = self
            .recording
            .map_or(0, |recording| recording.lost_messages);
        if lost > 0 {
            return Some(format!("{lost} messages are not in the recording"));
        }
        // A log may be over before anybody asks what is wrong.
        if let Some(units) = finding_of_units(&self.sonar) {
            return Some(units.sentence);
        }
        let notice = self.notices.iter().find(|notice| notice.is_loss)?;
        Some(notice.sentence.clone())
    }

    /// Profiles whose fields say what no sonar does.
    pub(crate) fn profiles_refused(&self) -> u64 {
        implausible_profiles(&self.sonar)
    }
}

/// A sentence on services under the same node, if there are any.
pub(super) fn other_service(others: &[String]) -> Option<String> {
    (!others.is_empty()).then(|| {
        format!(
            "another service maps under the same node ({}): both publish under one key; end one, or \
             give it a --node of its own",
            others.join(", ")
        )
    })
}

/// Profiles whose frame and fields were sound, whether or not they were new.
fn intact_profiles(sonar: &DriverStatus) -> u64 {
    let session = &sonar.session;
    session.profiles.saturating_sub(damaged_profiles(sonar))
}

fn damaged_profiles(sonar: &DriverStatus) -> u64 {
    let rejected = sonar.session.profiles_rejected;
    implausible_profiles(sonar) + rejected.unconfirmed
}

fn implausible_profiles(sonar: &DriverStatus) -> u64 {
    let rejected = sonar.session.profiles_rejected;
    rejected.payload + rejected.implausible()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sonar(profiles: u64) -> DriverStatus {
        let mut sonar = DriverStatus::default();
        sonar.session.profiles = profiles;
        sonar
    }

    #[test]
    fn a_few_pings_without_a_pose_are_no_loss_and_many_are() {
        let mut report = MapperReport::default();
        report.poses.join.pings_too_early = 10;
        assert_eq!(Status::of(report.clone(), sonar(1000)).loss(), None);
        report.poses.join.pings_too_early = 11;
        assert!(Status::of(report, sonar(1000)).loss().is_some());
    }

    #[test]
    fn damage_is_a_loss_and_not_a_ping() {
        let mut cut = sonar(1000);
        cut.session.frames_bad = 1;
        cut.session.profiles_rejected.scale = 1;
        let status = Status::of(MapperReport::default(), cut);
        assert_eq!(status.pings_received, 999);
        assert!(status.loss().is_some());
    }

    #[test]
    fn the_summary_has_what_is_promised() {
        let summary = Status::of(MapperReport::default(), sonar(0)).summary();
        for field in [
            "pings_received",
            "pings_mapped",
            "pings_held_back",
            "pings_without_pose",
            "frames_bad",
            "bytes_skipped",
            "gaussians",
            "ambiguous",
            "compute_s",
            "wall_s",
            "peak_memory_bytes",
        ] {
            assert!(summary[field].is_number(), "{field}");
        }
    }

    #[test]
    fn rates_are_per_second_since_the_last_look() {
        let mut meter = RateMeter::default();
        let begin = Instant::now();
        meter.measure(begin, [5, 5, 5]);
        assert_eq!(meter.rates(), Rates::default());
        meter.measure(begin + Duration::from_secs(2), [105, 5, 25]);
        let rates = meter.rates();
        assert!((rates.pings_per_s - 50.0).abs() < 1e-9);
        assert!((rates.bytes_per_s - 10.0).abs() < 1e-9);
    }
}
