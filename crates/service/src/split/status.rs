//! What a driver tells of its own part.

use echosplat_bus::TapeKeeperCounters;
use echosplat_driver::DriverStatus;
use echosplat_pose::PoseSourceStatus;
use serde::Serialize;

use crate::pipeline::{Link, Notice, Rates};
use crate::recorder::RecorderCounters;
use crate::supervisor::PartReport;

/// A driver at one moment.
#[derive(Debug, Serialize)]
pub(super) struct VehicleStatus {
    /// As of a service that maps.
    pub(super) status_version: u32,
    /// `driver`.
    pub(super) role: &'static str,
    /// Host time.
    pub(super) time_ns: i64,
    /// Whether this is the last of it.
    #[serde(rename = "final")]
    pub(super) is_final: bool,
    /// Since the start.
    pub(super) wall_s: f64,
    pub(super) rates: Rates,
    /// The link to the sonar.
    pub(super) link: Link,
    /// Of the sonar's driver.
    pub(super) sonar: DriverStatus,
    /// Poses that came, and what became of them.
    pub(super) poses: PoseSourceStatus,
    /// What is kept for mappers.
    pub(super) tape: TapeKeeperCounters,
    /// Raw pings that the bus dropped.
    pub(super) pings_not_published: u64,
    pub(super) recording: Option<RecorderCounters>,
    /// Why the recording lacks something just now.
    pub(super) recording_fault: Option<String>,
    /// Whether the threads of the run are alive.
    pub(super) parts: Vec<PartReport>,
    /// The drill that is armed.
    pub(super) drill: Option<String>,
    /// Lines of the log that are missing in it, since nobody read it.
    pub(super) log_lines_dropped: u64,
    /// What is wrong, and what was.
    pub(super) notices: Vec<Notice>,
    pub(super) memory_bytes: u64,
}

impl VehicleStatus {
    /// The same in a few lines for people.
    pub(super) fn account(&self) -> String {
        format!(
            "{} pings heard, {} poses, {} records for mappers, {} that a mapper missed\n\
             {} damaged frames, {} bytes skipped",
            self.sonar.session.pings,
            self.poses.accepted,
            self.tape.next,
            self.tape.missed,
            self.sonar.session.frames_bad,
            self.sonar.session.bytes_skipped,
        )
    }

    /// In one line.
    pub(super) fn line(&self) -> String {
        format!(
            "{:.1} pings/s heard, {} records for mappers",
            self.rates.pings_per_s, self.tape.next
        )
    }
}
