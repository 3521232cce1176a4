//! A satellite receiver beside the poses of a run.

use echosplat_georeference::{FoundOrigin, Heard, OriginFinder};
use echosplat_liveness::Heartbeat;
use echosplat_model::{StampedPose, Timestamp};
use echosplat_pose::{GnssSource, GnssStatus};
use echosplat_recording::mcap::Record;
use serde::Serialize;
use serde_json::{Value, json};

use crate::clock;
use crate::config::Config;
use crate::recorder::Recorder;

/// The event of a recording with what a receiver told, on the clock of poses.
const GNSS: &str = "gnss";
/// Seconds; nearer ones are not recorded, as they are not used.
const RECORDED_EVERY_S: f64 = 0.9;

/// What became of fixes.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct GnssReport {
    /// Of the receiver.
    #[serde(flatten)]
    pub(crate) source: GnssStatus,
    /// Fixes beside a pose.
    pub(crate) beside_poses: u64,
    /// Why the newest fixes found no origin.
    pub(crate) trouble: Option<String>,
    /// How far a later origin was from the first, at most, metres.
    pub(crate) moved_m: f64,
}

/// Fixes in, paired with the poses that are taken.
pub(crate) struct Gnss {
    source: GnssSource,
    finder: OriginFinder,
    /// From the clock of pings to that of poses, seconds.
    offset_s: f64,
    recorder: Option<Recorder>,
    /// Newest fix and newest heading recorded.
    recorded: [Option<Timestamp>; 2],
}

impl Gnss {
    pub(crate) fn new(config: &Config, source: GnssSource, recorder: Option<Recorder>) -> Self {
        let rule = config.georeference.beside(true, config.pose.max_pose_gap_s);
        Self {
            offset_s: match source.is_on_clock_of_pings() {
                true => config.pose.time_offset_s,
                false => 0.0,
            },
            source,
            finder: OriginFinder::new(rule),
            recorder,
            recorded: [None; 2],
        }
    }

    /// Takes what came. `lacks_north` asks the source of poses.
    pub(crate) fn take_what_came(&mut self, lacks_north: impl Fn() -> bool) {
        let mut is_first = true;
        while let Some(heard) = self.source.try_next() {
            if std::mem::take(&mut is_first) {
                self.finder.is_enu(!lacks_north());
            }
            let heard = heard.offset_by(self.offset_s);
            self.record(&heard);
            self.finder.heard(heard);
        }
    }

    fn record(&mut self, heard: &Heard) {
        let Some(recorder) = &self.recorder else {
            return;
        };
        let newest = &mut self.recorded[usize::from(matches!(heard, Heard::Heading { .. }))];
        let time = heard.time();
        if newest.is_none_or(|newest| time.seconds_since(newest).abs() >= RECORDED_EVERY_S) {
            *newest = Some(time);
            let event = json!({ "event": GNSS, "heard": heard.line() });
            recorder.record(clock::now(), Record::Event(event));
        }
    }

    pub(crate) fn pose(&mut self, pose: &StampedPose) {
        self.finder.pose(pose);
    }

    /// No more poses come, or they begin anew.
    pub(crate) fn finish(&mut self) {
        self.finder.finish();
    }

    pub(crate) fn found(&self) -> Vec<FoundOrigin> {
        self.finder.found().to_vec()
    }

    pub(crate) fn heartbeat(&self) -> Option<&Heartbeat> {
        self.source.heartbeat()
    }

    pub(crate) fn report(&self) -> GnssReport {
        GnssReport {
            source: self.source.status(),
            beside_poses: self.finder.counters().beside_poses,
            trouble: self.finder.trouble().map(str::to_owned),
            moved_m: self.finder.moved_m(),
        }
    }
}

/// What a recorded dive's receiver told.
pub(crate) fn heard_of(event: &Value) -> Option<Heard> {
    let is_it = event["event"] == GNSS;
    Heard::parse(event["heard"].as_str().filter(|_| is_it)?)
}
