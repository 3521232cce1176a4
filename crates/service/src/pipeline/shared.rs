//! What the mapper's thread and the one that watches over it tell each other.

use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::calibration::Found;
use echosplat_driver::DriverEvent;
use echosplat_mapper::{LeftOut, MapperStatus};
use echosplat_model::Snapshot;
use echosplat_prediction::frame_check::FrameVerdict;
use serde::Serialize;

use super::effort::EffortReport;
use super::latency::LatencyReport;
use super::listening::ListeningReport;
use super::poses::PoseReport;
use super::prediction::Predicted;
use super::shedding::SheddingReport;
use super::track::Track;

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Phase {
    /// Pings are mapped.
    Running,
    /// No more pings are wanted; the sonar is to be stopped.
    InputEnded,
    /// The mapper goes through the whole dive.
    Finishing,
}

/// What the mapper's thread did so far.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct MapperReport {
    /// Pings that this thread took from the sonar's.
    pub(crate) pings_taken: u64,
    /// Pings left out for want of memory, or as the recorded dive left them out.
    pub(crate) pings_shed: u64,
    /// What is given up for want of time and memory.
    pub(crate) shedding: SheddingReport,
    /// Pings whose evidence is in the map.
    pub pings_mapped: u64,
    /// Pings kept from the map to judge it by.
    #[serde(rename = "pings_held_back")]
    pub(crate) pings_held_out: u64,
    /// Pings before `--start`.
    pub(crate) pings_before_start: u64,
    /// Pings past `--end` or `--duration`, or after being told to stop.
    pub(crate) pings_after_end: u64,
    /// Pings whose pose was not finite.
    pub(crate) pings_rejected: u64,
    /// Pings that a log held twice, taken once.
    pub(crate) pings_repeated: u64,
    /// Maps handed on.
    pub(crate) snapshots: u64,
    /// Maps of earlier epochs, each kept apart.
    pub(crate) maps: u64,
    /// Of the newest map handed on.
    pub(crate) newest_sequence: u64,
    /// From the first ping to the newest map, on the pings' clock.
    pub dive_s: f64,
    /// All that was done so far.
    #[serde(flatten)]
    pub work: Spent,
    /// All that was done when the finish began.
    pub before_finish: Spent,
    /// Of the live map.
    pub(crate) latency_s: LatencyReport,
    /// How well the map predicts pings that are kept from it, if some are.
    pub(crate) prediction: Option<Predicted>,
    /// What became of poses.
    pub(crate) poses: PoseReport,
    /// Whether what the sonar says is alive.
    pub(crate) listening: ListeningReport,
    /// Whether poses can be read as they are, once the dive has told.
    pub(crate) frames: Option<FrameVerdict>,
    /// What the dive told of clock, mount, compass and speed of sound, by the newest estimate.
    pub(crate) calibration: Option<Found>,
    /// What each kind of work took, by its name.
    pub(crate) effort: EffortReport,
    /// The mapper's own words.
    pub(crate) mapper: MapperStatus,
    /// Features that the dive so far does not need, and why.
    pub left_out: Vec<LeftOut>,
}

/// What the mapper had done at some moment; maps made only to be judged do not count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Spent {
    /// Processor seconds of its threads.
    pub compute_s: f64,
    /// Gaussian–bin pairs.
    pub pairs: u64,
    /// Voxel observations.
    #[serde(rename = "voxel_looks")]
    pub voxel_observations: u64,
}

/// The link to the sonar, as its driver tells of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct Link {
    /// `waiting`, `up`, `lost`.
    pub(crate) state: LinkState,
    /// Times it was lost.
    pub(crate) losses: u64,
    /// Why it was lost last.
    pub(crate) last_reason: Option<String>,
    /// What the device said it is.
    pub(crate) device: Option<String>,
    /// Whether profiles show the settings asked for; `null` where no sonar is asked.
    pub(crate) configured: Option<bool>,
    /// Newest warning about the device.
    pub(crate) warning: Option<String>,
}

/// Whether the sonar is there.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LinkState {
    /// It was not there yet.
    #[default]
    Waiting,
    /// It is.
    Up,
    /// It was, and is looked for again.
    Lost,
}

/// Shared by the two threads; nobody holds a lock for longer than a copy takes.
#[derive(Debug)]
pub(crate) struct Shared {
    phase: AtomicU8,
    /// Nothing more comes from the sonar's thread, whether or not it has let go of its end.
    input_closed: AtomicBool,
    report_wanted: AtomicBool,
    report: Mutex<MapperReport>,
    link: Mutex<Link>,
    newest_map: Mutex<Option<Arc<Snapshot>>>,
    /// Of the finished map, where it is asked for.
    track: Mutex<Option<Track>>,
}

impl Shared {
    pub(crate) fn new() -> Self {
        Self {
            phase: AtomicU8::new(Phase::Running as u8),
            input_closed: AtomicBool::new(false),
            report_wanted: AtomicBool::new(false),
            report: Mutex::default(),
            link: Mutex::default(),
            newest_map: Mutex::default(),
            track: Mutex::default(),
        }
    }

    /// The map as it stands.
    pub(crate) fn newest_map(&self) -> Option<Arc<Snapshot>> {
        lock(&self.newest_map).clone()
    }

    pub(crate) fn keep_map(&self, map: &Arc<Snapshot>) {
        *lock(&self.newest_map) = Some(Arc::clone(map));
    }

    pub(super) fn keep_track(&self, track: Track) {
        *lock(&self.track) = Some(track);
    }

    pub(super) fn take_track(&self) -> Option<Track> {
        lock(&self.track).take()
    }

    pub(crate) fn phase(&self) -> Phase {
        match self.phase.load(Ordering::Acquire) {
            0 => Phase::Running,
            1 => Phase::InputEnded,
            _ => Phase::Finishing,
        }
    }

    /// Phases only go forward.
    pub(crate) fn set_phase(&self, phase: Phase) {
        self.phase.fetch_max(phase as u8, Ordering::AcqRel);
    }

    pub(crate) fn close_input(&self) {
        self.input_closed.store(true, Ordering::Release);
    }

    pub(crate) fn input_is_closed(&self) -> bool {
        self.input_closed.load(Ordering::Acquire)
    }

    /// Asks the mapper's thread for a report.
    pub(crate) fn ask_for_report(&self) {
        self.report_wanted.store(true, Ordering::Relaxed);
    }

    /// The newest report there is.
    pub(crate) fn report(&self) -> MapperReport {
        lock(&self.report).clone()
    }

    pub(crate) fn report_is_wanted(&self) -> bool {
        self.report_wanted.swap(false, Ordering::Relaxed)
    }

    pub(crate) fn hand_over(&self, report: MapperReport) {
        *lock(&self.report) = report;
    }

    /// The link as it stands; of a log or a tape, which no sonar is asked for, without what is asked.
    pub(crate) fn link(&self, asks_a_sonar: bool) -> Link {
        let link = lock(&self.link).clone();
        Link {
            configured: asks_a_sonar.then_some(link.configured == Some(true)),
            ..link
        }
    }

    /// Keeps what the driver tells of the link; what it does not log itself is logged here.
    pub(crate) fn link_event(&self, event: DriverEvent) {
        let mut link = lock(&self.link);
        match event {
            DriverEvent::LinkUp => link.state = LinkState::Up,
            DriverEvent::LinkDown { reason } => {
                link.state = LinkState::Lost;
                link.losses += 1;
                link.configured = Some(false);
                link.last_reason = Some(reason);
            }
            DriverEvent::Identified(information) => {
                let device = information.to_string();
                tracing::info!(%device, "the sonar is identified");
                link.device = Some(device);
            }
            DriverEvent::Configured => {
                tracing::info!("the sonar pings as asked");
                link.configured = Some(true);
            }
            DriverEvent::Warning(warning) => link.warning = Some(warning),
            DriverEvent::Nack { id, text } => {
                link.warning = Some(format!("request {id} refused: {text}"));
            }
            DriverEvent::Rebooted => link.warning = Some("the sonar was restarted".to_owned()),
            DriverEvent::Ping { .. }
            | DriverEvent::ClockStepped
            | DriverEvent::Mark(_)
            | DriverEvent::GoesOn
            | DriverEvent::Ended => {}
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_only_go_forward() {
        let shared = Shared::new();
        shared.set_phase(Phase::Finishing);
        shared.set_phase(Phase::InputEnded);
        assert_eq!(shared.phase(), Phase::Finishing);
    }

    #[test]
    fn the_link_is_told_of() {
        let shared = Shared::new();
        shared.link_event(DriverEvent::LinkUp);
        shared.link_event(DriverEvent::LinkDown {
            reason: "unplugged".into(),
        });
        let link = shared.link(true);
        assert_eq!((link.state, link.losses), (LinkState::Lost, 1));
        assert_eq!(link.last_reason.as_deref(), Some("unplugged"));
        assert_eq!(link.configured, Some(false));
        assert_eq!(shared.link(false).configured, None, "nobody is asked");
    }

    #[test]
    fn a_report_is_made_when_asked_for() {
        let shared = Shared::new();
        assert!(!shared.report_is_wanted());
        shared.ask_for_report();
        assert!(shared.report_is_wanted());
        assert!(!shared.report_is_wanted());
    }
}
