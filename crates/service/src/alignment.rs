//! A log's pings in sections with all their poses, to see whether they belong together.

use std::path::Path;
use std::sync::Arc;

use echosplat_join::{ArrivedPose, CompassDeviation};
use echosplat_model::glam::DVec3;
use echosplat_model::{Ping, Timestamp, Trajectory, TrajectoryLimits};
use echosplat_prediction::alignment::{Alignment, SECTION_PINGS, SECTION_S, Setting};

use crate::config::{Config, PoseConfig};
use crate::logs;
use crate::thinned::Thinned;

/// Most sections of a dive that are looked at.
const MOST_SECTIONS: usize = 4;
/// A shorter one at the end tells nothing.
const LEAST_PINGS: usize = 60;

/// Sections of a stream of pings of unknown length, evenly over it.
pub(crate) struct Sections {
    closed: Thinned<Vec<Arc<Ping>>>,
    /// When the one at hand began.
    begin: Option<Timestamp>,
    at_hand: Thinned<Arc<Ping>>,
}

impl Sections {
    pub(crate) fn new() -> Self {
        Self {
            closed: Thinned::new(MOST_SECTIONS),
            begin: None,
            at_hand: Thinned::new(2 * SECTION_PINGS),
        }
    }

    pub(crate) fn take(&mut self, ping: &Arc<Ping>) {
        let time = ping.transmit_time();
        let begin = *self.begin.get_or_insert(time);
        if !(0.0..SECTION_S).contains(&time.seconds_since(begin)) {
            self.close();
            self.begin = Some(time);
        }
        self.at_hand.push(|| Arc::clone(ping));
    }

    fn close(&mut self) {
        let at_hand = std::mem::replace(&mut self.at_hand, Thinned::new(2 * SECTION_PINGS));
        let pings = at_hand.into_kept();
        if pings.len() >= LEAST_PINGS {
            self.closed.push(|| pings);
        }
    }

    /// `None` if too few pings hear anything.
    pub(crate) fn with(mut self, poses: &[ArrivedPose], config: &Config) -> Option<Alignment> {
        self.close();
        let sections = self.closed.into_kept();
        Alignment::new(&sections, trajectory(poses, &config.pose), &config.mapper)
    }
}

/// Of a log and a file of its poses, or without that file those inside the log.
///
/// # Errors
/// Says which of the files is not what it should be.
pub(crate) fn of_log(
    log: &Path,
    poses: Option<&Path>,
    config: &Config,
) -> anyhow::Result<Option<Alignment>> {
    let mut sections = Sections::new();
    logs::pings(log, config, |ping| sections.take(&ping))?;
    Ok(sections.with(&logs::poses(log, poses)?, config))
}

/// As the configuration has it.
pub(crate) fn setting(config: &Config) -> Setting {
    let mount = &config.pose.vehicle_from_sensor;
    Setting {
        time_offset_s: config.pose.time_offset_s,
        yaw_pitch_roll_deg: mount.yaw_pitch_roll_deg,
        translation_m: DVec3::from_array(mount.translation_m),
    }
}

/// In order of time; what cannot be used is left out, as the join does.
fn trajectory(poses: &[ArrivedPose], config: &PoseConfig) -> Trajectory {
    let [b_deg, c_deg] = config.compass_deviation_deg;
    let compass = CompassDeviation { b_deg, c_deg };
    let mut trajectory = Trajectory::new(TrajectoryLimits {
        capacity: poses.len(),
        max_pose_gap_s: config.max_pose_gap_s,
    });
    for arrived in poses {
        let mut pose = arrived.pose;
        pose.world_from_vehicle = compass.corrected(&pose.world_from_vehicle);
        // Out of order or not finite.
        let _ = trajectory.push(pose);
    }
    trajectory
}
