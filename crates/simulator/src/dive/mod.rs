//! Dives: where the sensor is, when it pings, and what poses are reported of it.

mod error;
mod reported;
mod survey;
mod track;
mod viewpoints;

use echosplat_model::{PingSettings, Pose, StampedPose, Timestamp, Trajectory, TrajectoryLimits};
use glam::DVec3;

use crate::disturbances::Disturbances;
use crate::scene::Scene;
use crate::sonar::NoiseLevel;
pub use error::DiveError;
use survey::Survey;
pub(crate) use survey::structure_or_default;
pub use viewpoints::BEAMS_PER_VIEW;

/// Speed of sound of every simulated dive.
pub(crate) const SPEED_OF_SOUND_MPS: f64 = 1500.0;
const FREQUENCY_HZ: f64 = 451_127.0;
/// Pulse length as a fraction of the two-way time: the device's typical setting.
const PULSE_FRACTION: f64 = 0.002;
/// What the device needs beside the two-way time of a ping.
const PING_OVERHEAD_S: f64 = 0.0035;
/// Share of a harsh dive after which the range grows, and by how much.
const RANGE_CHANGE_AT: f64 = 0.6;
const RANGE_CHANGE_RATIO: f64 = 1.2;

/// How the sensor moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DiveKind {
    /// Continuous motion around or along the scene with heave and roll, the heading sweeping.
    Survey,
    /// Still images from planes at the four sides, facing the centroid: the paper's.
    Viewpoints,
    /// Yaw only, from one place: resolves no elevation.
    Pan,
    /// The survey at one depth without roll: leaves the mirror image open.
    Level,
}

impl DiveKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Survey, Self::Viewpoints, Self::Pan, Self::Level];

    /// As on the command line and in reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Survey => "survey",
            Self::Viewpoints => "viewpoints",
            Self::Pan => "pan",
            Self::Level => "level",
        }
    }
}

impl std::fmt::Display for DiveKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

impl std::str::FromStr for DiveKind {
    type Err = DiveError;

    fn from_str(name: &str) -> Result<Self, DiveError> {
        let found = Self::ALL.into_iter().find(|kind| kind.as_str() == name);
        found.ok_or_else(|| DiveError::UnknownKind(name.to_owned()))
    }
}

/// How long and how densely to ping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiveOptions {
    /// Length of a survey, pan or level dive, 1 to 100,000 s; the survey itself is the same for
    /// any length, only cut sooner or later.
    pub duration_s: f64,
    /// Pings per second, 1 to 200, rounded to whole milliseconds between pings and lowered where
    /// the range needs longer.
    pub pings_per_s: f64,
    /// Share of a viewpoint dive's views that are kept, 0 to 1.
    pub view_share: f64,
    /// What is added to pings and poses; nothing by default.
    pub disturbances: Disturbances,
}

impl Default for DiveOptions {
    fn default() -> Self {
        Self {
            duration_s: 240.0,
            pings_per_s: 40.0,
            view_share: 1.0,
            disturbances: Disturbances::default(),
        }
    }
}

/// One dive, planned: a pure function of kind, scene, noise, seed and options.
///
/// Time starts at 0 with the first ping, in seconds on the dive's own clock; that of the reported
/// poses is the same, and that of the pings too but for the drift of harsh noise.
#[derive(Debug, Clone)]
pub struct Dive {
    kind: DiveKind,
    settings: PingSettings,
    interval_s: f64,
    ping_count: usize,
    motion: Motion,
    noise: NoiseLevel,
    disturbances: Disturbances,
    reported: Vec<StampedPose>,
}

#[derive(Debug, Clone)]
enum Motion {
    Moving(Survey),
    /// One pose per ping, kept while it listens.
    Still(Vec<Pose>),
}

impl Dive {
    /// A dive of the default length: 240 s at 40 pings/s, or the scene's number of views.
    ///
    /// # Errors
    /// If the scene leaves no room for it.
    pub fn plan(
        kind: DiveKind,
        scene: &Scene,
        noise: NoiseLevel,
        seed: u64,
    ) -> Result<Self, DiveError> {
        Self::plan_with(kind, scene, noise, seed, &DiveOptions::default())
    }

    /// As [`Self::plan`], of any length.
    ///
    /// # Errors
    /// If an option is out of range or the scene leaves no room.
    pub fn plan_with(
        kind: DiveKind,
        scene: &Scene,
        noise: NoiseLevel,
        seed: u64,
        options: &DiveOptions,
    ) -> Result<Self, DiveError> {
        options.check()?;
        let (motion, range_m) = match kind {
            DiveKind::Viewpoints => viewpoints::plan(scene, seed, options.view_share)?,
            _ => survey::plan(kind, scene, seed)?,
        };
        let settings = settings_for(range_m);
        let least_ms =
            (1e3 * (listening_s(&settings) * RANGE_CHANGE_RATIO + PING_OVERHEAD_S)).ceil();
        let interval_s = 1e-3 * (1e3 / options.pings_per_s).round().max(least_ms);
        let ping_count = match &motion {
            Motion::Still(poses) => poses.len(),
            Motion::Moving(_) => (options.duration_s / interval_s).round().max(1.0) as usize,
        };
        let mut dive = Self {
            kind,
            settings,
            interval_s,
            ping_count,
            motion,
            noise,
            disturbances: options.disturbances,
            reported: Vec::new(),
        };
        dive.check_surface()?;
        dive.reported = reported::poses(&dive, seed);
        Ok(dive)
    }

    fn check_surface(&self) -> Result<(), DiveError> {
        let (surface_m, highest_m) = (self.disturbances.surface.height_m, self.reach().1.z);
        match surface_m > highest_m {
            true => Ok(()),
            false => Err(DiveError::SurfaceTooLow {
                surface_m,
                highest_m,
            }),
        }
    }

    /// What is added to its pings and poses.
    #[must_use]
    pub fn disturbances(&self) -> &Disturbances {
        &self.disturbances
    }

    /// How it moves.
    #[must_use]
    pub fn kind(&self) -> DiveKind {
        self.kind
    }

    /// Number of pings.
    #[must_use]
    pub fn pings(&self) -> usize {
        self.ping_count
    }

    /// From the first ping to the end of the last.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.ping_count as f64 * self.interval_s
    }

    /// Time between pings, whole milliseconds.
    #[must_use]
    pub fn ping_interval_s(&self) -> f64 {
        self.interval_s
    }

    /// Settings of the dive's first ping: what a client of the device asks for.
    #[must_use]
    pub fn settings(&self) -> PingSettings {
        self.settings
    }

    /// Settings of ping `index`: in a harsh dive the range grows on the way.
    #[must_use]
    pub fn settings_at(&self, index: usize) -> PingSettings {
        let mut settings = self.settings;
        if self.range_change_at().is_some_and(|first| index >= first) {
            settings.range_length_m = after_range_change(settings.range_length_m);
        }
        settings
    }

    /// First ping after the range has grown, if it does.
    #[must_use]
    pub fn range_change_at(&self) -> Option<usize> {
        let at = (self.ping_count as f64 * RANGE_CHANGE_AT) as usize;
        self.noise.is_harsh().then_some(at)
    }

    /// When ping `index` is transmitted, seconds.
    #[must_use]
    pub fn transmit_s(&self, index: usize) -> f64 {
        index as f64 * self.interval_s
    }

    /// Number of the image ping `index` is a beam of: in a viewpoint dive, views follow one another
    /// with [`BEAMS_PER_VIEW`] pings each, from the rightmost beam to the leftmost.
    #[must_use]
    pub fn view_of(&self, index: usize) -> Option<u32> {
        let is_still = matches!(self.motion, Motion::Still(_));
        is_still.then_some((index / BEAMS_PER_VIEW) as u32)
    }

    pub(crate) fn view_at(&self, time_s: f64) -> Option<u32> {
        self.view_of(self.index_at(time_s))
    }

    /// The ping under way at a time.
    fn index_at(&self, time_s: f64) -> usize {
        // A thousandth of an interval early still belongs to the ping: times are rounded.
        let position = (time_s / self.interval_s + 1e-3).max(0.0) as usize;
        position.min(self.ping_count.saturating_sub(1))
    }

    /// Where the sensor truly is, world from sensor. A survey goes on before and after its pings;
    /// a viewpoint dive keeps each beam's pose while it listens, beam azimuth included.
    #[must_use]
    pub fn truth_at(&self, time: Timestamp) -> Pose {
        self.pose_during(time.as_secs_f64(), 0.0)
    }

    /// Where it is `later_s` after the transmit of the ping under way at `time_s`.
    pub(crate) fn pose_during(&self, time_s: f64, later_s: f64) -> Pose {
        match &self.motion {
            Motion::Moving(survey) => survey.pose_at(time_s + later_s),
            Motion::Still(poses) => poses
                .get(self.index_at(time_s))
                .copied()
                .unwrap_or(Pose::IDENTITY),
        }
    }

    /// The vehicle's poses with the errors of the dive's noise, in order of time, as any pose
    /// source would give them; `vehicle_from_sensor` is the identity. From 0.1 s before the first
    /// ping to 1 s after the last, 50 per second; in a viewpoint dive two per ping, at its transmit and
    /// when it has listened, so that nothing is interpolated between beams.
    #[must_use]
    pub fn reported_poses(&self) -> &[StampedPose] {
        &self.reported
    }

    /// All reported poses at once, for joining with pings.
    #[must_use]
    pub fn trajectory(&self, max_pose_gap_s: f64) -> Trajectory {
        let mut trajectory = Trajectory::new(TrajectoryLimits {
            capacity: self.reported.len(),
            max_pose_gap_s,
        });
        for &pose in &self.reported {
            // Planned in order and finite, so none is ever refused.
            let taken = trajectory.push(pose);
            debug_assert!(taken.is_ok());
        }
        trajectory
    }

    /// Corners of the box the sensor's positions span.
    pub(crate) fn reach(&self) -> (DVec3, DVec3) {
        let every = (self.ping_count / 2000).max(1);
        (0..self.ping_count)
            .step_by(every)
            .map(|index| self.pose_during(self.transmit_s(index), 0.0).translation_m)
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| {
                (low.min(p), high.max(p))
            })
    }
}

impl DiveOptions {
    fn check(&self) -> Result<(), DiveError> {
        let option = |name, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                return Ok(());
            }
            Err(DiveError::Option {
                name,
                value,
                low,
                high,
            })
        };
        option("duration_s", self.duration_s, 1.0, 1e5)?;
        option("pings_per_s", self.pings_per_s, 1.0, 200.0)?;
        option("view_share", self.view_share, 0.0, 1.0)?;
        Ok(self.disturbances.check()?)
    }
}

/// 600 bins, 1200 where they would be coarser than 3 cm.
fn settings_for(range_m: f64) -> PingSettings {
    let pulse_s = PULSE_FRACTION * (2.0 * range_m / SPEED_OF_SOUND_MPS);
    PingSettings {
        range_start_m: 0.0,
        range_length_m: whole_millimetres(range_m),
        bin_count: if range_m <= 18.0 { 600 } else { 1200 },
        speed_of_sound_mps: SPEED_OF_SOUND_MPS,
        frequency_hz: FREQUENCY_HZ,
        // As a profile carries it.
        pulse_duration_s: f64::from(pulse_s as f32),
        gain_index: 0,
    }
}

fn listening_s(settings: &PingSettings) -> f64 {
    2.0 * settings.range_end_m() / settings.speed_of_sound_mps
}

pub(crate) fn after_range_change(range_length_m: f64) -> f64 {
    whole_millimetres(range_length_m * RANGE_CHANGE_RATIO)
}

/// What the device's settings can say.
fn whole_millimetres(length_m: f64) -> f64 {
    (length_m * 1e3).round() * 1e-3
}

#[cfg(test)]
mod tests;
