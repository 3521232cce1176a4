//! The configuration: one struct per table of the TOML file, defaults in code, all checked before
//! anything starts.

mod choices;
mod errors;
mod faults;
mod georeference;
mod keys;
mod memory;
mod overrides;

use std::path::{Path, PathBuf};
use std::time::Duration;

use echosplat_bus::{BusConfig, BusError};
use echosplat_driver::SonarUrl;
use echosplat_join::Covariances;
use echosplat_mapper::{ConfigError as MapperError, MapperConfig};
use echosplat_model::glam::DVec3;
use echosplat_model::{Pose, Switch};
use echosplat_pose::PoseUrl;
use echosplat_session::SessionConfig;
use echosplat_web::WebConfig;
use serde::{Deserialize, Serialize};

use crate::exit::Usage;
pub(crate) use choices::{Calibrate, RecordFormat};
use errors::BadSetting;
pub(crate) use georeference::GeoreferenceConfig;
#[cfg(test)]
pub(crate) use keys::is_known;
pub(crate) use overrides::Overrides;

/// `config/default.toml`, which equals [`Config::default`].
pub(crate) const DEFAULT_TOML: &str = include_str!("../../../../config/default.toml");

/// `config/basic.toml`: what an owner sets.
pub(crate) const BASIC_TOML: &str = include_str!("../../../../config/basic.toml");

/// Longest configuration file read.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Everything that can be set.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    pub(crate) sonar: SonarConfig,
    pub(crate) session: SessionConfig,
    /// Where poses come from, and how they belong to pings.
    pub pose: PoseConfig,
    /// How the map is made.
    pub mapper: MapperConfig,
    /// What happens between them.
    pub pipeline: PipelineConfig,
    pub(crate) georeference: GeoreferenceConfig,
    pub(crate) output: OutputConfig,
    pub(crate) bus: BusConfig,
    pub(crate) web: WebConfig,
}

/// Where pings come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct SonarConfig {
    /// Where the sonar is.
    pub(crate) url: String,
    /// Seed of a simulated sonar.
    pub(crate) seed: u64,
    /// Longest wait for a connection or for bytes to be taken.
    pub(crate) io_timeout_s: f64,
    /// First wait before connecting again; it doubles.
    pub(crate) reconnect_min_s: f64,
    /// Longest wait before connecting again.
    pub(crate) reconnect_max_s: f64,
    /// A link without a byte for so long is lost.
    pub(crate) silence_timeout_s: f64,
}

impl Default for SonarConfig {
    fn default() -> Self {
        Self {
            url: "tcp://192.168.2.92:51200".to_owned(),
            seed: 1,
            io_timeout_s: 1.0,
            reconnect_min_s: 0.05,
            reconnect_max_s: 0.5,
            silence_timeout_s: 5.0,
        }
    }
}

/// Where poses come from, and how they belong to pings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseConfig {
    /// Where poses come from.
    pub(crate) url: PoseUrl,
    /// Added to the pings' times before poses are looked up.
    pub time_offset_s: f64,
    /// Coefficients B and C of the compass's deviation.
    pub(crate) compass_deviation_deg: [f64; 2],
    /// Whether the covariances that poses come with weigh pings.
    pub(crate) covariances: Covariances,
    /// Longest time between two poses that is interpolated across.
    pub(crate) max_pose_gap_s: f64,
    /// How long a ping waits for later poses, to tell their jitter from motion; 0 interpolates.
    pub(crate) lookahead_s: f64,
    /// Whether jitter of poses is taken out.
    pub(crate) smoothing: Switch,
    /// Most poses held.
    pub(crate) capacity: usize,
    /// Most pings that wait for a pose.
    pub(crate) waiting_pings: usize,
    /// Longest that a ping of a real sonar waits for its pose.
    pub(crate) max_wait_s: f64,
    /// How the sonar is mounted.
    pub(crate) vehicle_from_sensor: MountConfig,
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self {
            url: PoseUrl::Zenoh,
            compass_deviation_deg: [0.0; 2],
            time_offset_s: 0.0,
            covariances: Covariances::Use,
            max_pose_gap_s: 0.5,
            lookahead_s: 0.1,
            smoothing: Switch::Auto,
            capacity: 65_536,
            waiting_pings: 256,
            max_wait_s: 2.0,
            vehicle_from_sensor: MountConfig::default(),
        }
    }
}

/// Where the sensor sits on the vehicle, and how it is turned.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct MountConfig {
    /// The sensor's place on the vehicle: forward, left, up.
    pub(crate) translation_m: [f64; 3],
    /// Yaw about up, then pitch about left, then roll about forward.
    pub(crate) yaw_pitch_roll_deg: [f64; 3],
}

impl MountConfig {
    /// `vehicle_from_sensor`.
    pub(crate) fn pose(&self) -> Pose {
        let [yaw, pitch, roll] = self.yaw_pitch_roll_deg.map(f64::to_radians);
        Pose::from_yaw_pitch_roll(yaw, pitch, roll, DVec3::from_array(self.translation_m))
    }
}

/// What waits, and what is shown when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PipelineConfig {
    /// Pings between the sonar's thread and the mapper's.
    pub(crate) queue_pings: usize,
    /// Time between two published states of the map, on the pings' clock.
    pub snapshot_interval_s: f64,
    /// Every so many-th ping is left out of the map, to judge it by; 0 leaves out none.
    pub(crate) hold_back_every: u64,
    /// Whether the dive is asked if clock, mount, compass and speed of sound are as configured.
    pub(crate) calibrate: Calibrate,
    /// Longest that a part of the service may work without a sign of life.
    pub(crate) hang_limit_s: f64,
    /// How long the map may be finished once a signal asked for an end; 0 writes it as it stands.
    pub(crate) finish_within_s: f64,
    /// A live dive leaves pings out of the map while the service holds this much memory.
    pub(crate) memory_bytes: u64,
}

impl Default for PipelineConfig {
    fn default() -> Self {
        Self {
            queue_pings: 256,
            snapshot_interval_s: 0.05,
            hold_back_every: 0,
            calibrate: Calibrate::Tell,
            hang_limit_s: 15.0,
            finish_within_s: 2.5,
            memory_bytes: 2 << 30,
        }
    }
}

/// What is written where.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct OutputConfig {
    /// The map, on exit; `{time}` in its name stands for when the run began.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) map: Option<PathBuf>,
    /// The vehicle's way as the map has it, on exit; `{time}` as in `map`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) track: Option<PathBuf>,
    /// What the final map is judged by.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) truth: Option<PathBuf>,
    /// Directory of recordings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) record: Option<PathBuf>,
    /// What recordings are written as.
    pub(crate) record_format: RecordFormat,
    /// A recording goes on in a new file beyond this.
    pub(crate) record_rotate_bytes: u64,
    /// Stop after this much of the pings' clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) duration_s: Option<f64>,
}

impl Default for OutputConfig {
    fn default() -> Self {
        Self {
            map: None,
            track: None,
            truth: None,
            record: None,
            record_format: RecordFormat::Mcap,
            record_rotate_bytes: 1 << 30,
            duration_s: None,
        }
    }
}

impl Config {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// All that is wrong, a line each: file, line, key, and what is allowed.
    pub(crate) fn load(file: &Path) -> anyhow::Result<Self> {
        let text = read_bounded(file)
            .map_err(|error| Usage::error(format!("configuration {}: {error}", file.display())))?;
        Self::parse(file, &text)
    }

    fn parse(file: &Path, text: &str) -> anyhow::Result<Self> {
        faults::read(text).map_err(|found| {
            let lines = found.iter().map(|fault| fault.located(file));
            Usage::faults(lines.collect())
        })
    }

    /// # Errors
    /// The first setting out of range, or what takes most where all together take too much memory.
    pub(crate) fn check(&self) -> Result<(), BadSetting> {
        self.sonar.check()?;
        self.session.check().map_err(|error| {
            let message = format!(
                "is {}; allowed is {} to {}",
                error.value, error.low, error.high
            );
            BadSetting::new(format!("session.{}", error.key), message)
        })?;
        self.pose.check()?;
        self.mapper.check().map_err(bad_mapper_setting)?;
        check_resolution(self.mapper.resolution_m)?;
        self.pipeline.check()?;
        self.georeference.check()?;
        self.output.check()?;
        self.bus.check().map_err(bad_bus_setting)?;
        if let (PoseUrl::Ros2(_), None) = (&self.pose.url, self.bus.ros_domain_id) {
            return Err(BadSetting::new("pose.url", BusError::NoRosDomain));
        }
        let bad_web = |(key, message)| BadSetting::new(format!("web.{key}"), message);
        self.web.check().map_err(bad_web)?;
        memory::check(self)
    }
}

/// What stamps in nanoseconds reach to, 292 years, and so the most that two clocks can be apart, seconds: Unix time
/// against one that begins with the dive is 1.8e9.
pub(crate) const MOST_OFFSET_S: f64 = 9.2e9;

/// Finest voxels that can be asked for, metres: a beam of 0.8° is as wide 36 cm from the sonar, within
/// its blanking, and every halving takes eight times the memory.
const FINEST_M: f64 = 0.005;

fn check_resolution(resolution_m: f64) -> Result<(), BadSetting> {
    let is_fine = resolution_m > 0.0 && resolution_m < FINEST_M;
    let message = || {
        format!(
            "is {resolution_m}; allowed is 0, which takes what the beam resolves, or {FINEST_M} to 10: \
             finer voxels show no more and take memory by the third power"
        )
    };
    match is_fine {
        true => Err(BadSetting::new("mapper.resolution_m", message())),
        false => Ok(()),
    }
}

fn bad_mapper_setting(error: MapperError) -> BadSetting {
    match error {
        MapperError::OutOfRange {
            key,
            value,
            low,
            high,
        } => {
            let message = format!("is {value}; allowed is {low} to {high}");
            BadSetting::new(format!("mapper.{key}"), message)
        }
        MapperError::Beam(error) => {
            let message = format!(
                "is {}; allowed is {} to {}",
                error.value, error.low, error.high
            );
            BadSetting::new(format!("mapper.beam.{}", error.name), message)
        }
        other => BadSetting::new("mapper", other),
    }
}

fn bad_bus_setting(error: BusError) -> BadSetting {
    match error {
        BusError::Config {
            key,
            found,
            allowed,
        } => BadSetting::new(
            format!("bus.{key}"),
            format!("is {found}; allowed is {allowed}"),
        ),
        other => BadSetting::new("bus", other),
    }
}

impl SonarConfig {
    fn check(&self) -> Result<(), BadSetting> {
        let url: Result<SonarUrl, _> = self.url.parse();
        url.map_err(|error| BadSetting::new("sonar.url", error))?;
        within("sonar.io_timeout_s", self.io_timeout_s, 0.05, 60.0)?;
        within("sonar.reconnect_min_s", self.reconnect_min_s, 0.01, 60.0)?;
        let least = self.reconnect_min_s;
        within("sonar.reconnect_max_s", self.reconnect_max_s, least, 60.0)?;
        within(
            "sonar.silence_timeout_s",
            self.silence_timeout_s,
            0.2,
            600.0,
        )
    }
}

impl PoseConfig {
    fn check(&self) -> Result<(), BadSetting> {
        let most_s = MOST_OFFSET_S;
        within("pose.time_offset_s", self.time_offset_s, -most_s, most_s)?;
        for value in self.compass_deviation_deg {
            within("pose.compass_deviation_deg", value, -45.0, 45.0)?;
        }
        within("pose.max_pose_gap_s", self.max_pose_gap_s, 0.001, 60.0)?;
        within("pose.lookahead_s", self.lookahead_s, 0.0, 1.0)?;
        within("pose.capacity", self.capacity as f64, 2.0, 1e7)?;
        within(
            "pose.waiting_pings",
            self.waiting_pings as f64,
            1.0,
            65_536.0,
        )?;
        within("pose.max_wait_s", self.max_wait_s, 0.01, 3600.0)?;
        let mount = &self.vehicle_from_sensor;
        for value in mount.translation_m {
            within("pose.vehicle_from_sensor.translation_m", value, -1e3, 1e3)?;
        }
        for value in mount.yaw_pitch_roll_deg {
            within(
                "pose.vehicle_from_sensor.yaw_pitch_roll_deg",
                value,
                -360.0,
                360.0,
            )?;
        }
        Ok(())
    }
}

impl PipelineConfig {
    /// How long the map may be finished once a signal asked for an end.
    pub(crate) fn finish_within(&self) -> Duration {
        Duration::from_secs_f64(self.finish_within_s)
    }

    fn check(&self) -> Result<(), BadSetting> {
        within(
            "pipeline.queue_pings",
            self.queue_pings as f64,
            1.0,
            65_536.0,
        )?;
        within(
            "pipeline.snapshot_interval_s",
            self.snapshot_interval_s,
            0.01,
            3600.0,
        )?;
        within("pipeline.hang_limit_s", self.hang_limit_s, 1.0, 3600.0)?;
        let finish_within_s = self.finish_within_s;
        within("pipeline.finish_within_s", finish_within_s, 0.0, 3600.0)?;
        let memory = self.memory_bytes as f64;
        within("pipeline.memory_bytes", memory, 1e6, 1e15)?;
        match self.hold_back_every {
            1 => Err(BadSetting::new(
                "pipeline.hold_back_every",
                "is 1, which leaves nothing for the map; allowed is 0 for none, or 2 and more",
            )),
            _ => Ok(()),
        }
    }
}

impl OutputConfig {
    fn check(&self) -> Result<(), BadSetting> {
        let rotate = self.record_rotate_bytes as f64;
        within("output.record_rotate_bytes", rotate, 1e6, 1e15)?;
        if let Some(track) = &self.track
            && crate::pipeline::track::Kind::of(track).is_none()
        {
            return Err(BadSetting::new(
                "output.track",
                format!(
                    "is {}; a way is written as .tum, poses as other programs read them, or as .csv, with sigmas",
                    track.display()
                ),
            ));
        }
        within(
            "output.duration_s",
            self.duration_s.unwrap_or(1.0),
            1e-3,
            1e9,
        )
    }
}

fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), BadSetting> {
    match value >= low && value <= high {
        true => Ok(()),
        false => Err(BadSetting::new(
            key,
            format!("is {value}; allowed is {low} to {high}"),
        )),
    }
}

fn read_bounded(file: &Path) -> std::io::Result<String> {
    let bytes = echosplat_input::read(file, MAX_FILE_BYTES)?;
    String::from_utf8(bytes).map_err(|_| std::io::Error::other("it is no text in UTF-8"))
}

#[cfg(test)]
mod tests;
