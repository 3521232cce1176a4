//! The sonar of a dive.

use std::sync::Arc;

use echosplat_model::{LOOKAHEAD_S, PingSettings, Pose, PosedPing, Switch, Trajectory};
use rayon::prelude::*;

use super::device_side::DeviceSide;
use super::echo::{MovingSensor, power_per_bin};
use super::{NoiseLevel, Profile, SimulatedPing};
use crate::beam::Fan;
use crate::dive::Dive;
use crate::random::{Purpose, Random};
use crate::scene::Scene;

/// Pings looked at to find the strongest echo of a dive.
const REFERENCE_PING_COUNT: usize = 192;

/// What a sonar carried along a dive hears. Every ping is a pure function of scene, dive, noise,
/// seed and its number: pings may be made in parallel and in any order.
pub struct SimulatedSonar {
    scene: Arc<Scene>,
    dive: Arc<Dive>,
    fan: Fan,
    device: DeviceSide,
    seed: u64,
}

/// Power per bin of one ping from a sensor at rest, without any noise and without side lobes:
/// solid angle × sensitivity × reflectivity in steradian, shape `[bin_count]`. Where its rays fall
/// within their cells depends on `seed`; the mean over several is that of all rays there are.
#[must_use]
pub fn echoes_at_rest(
    scene: &Scene,
    world_from_sensor: &Pose,
    settings: &PingSettings,
    seed: u64,
) -> Vec<f64> {
    let sensor = MovingSensor::new(settings.range_end_m(), |_| *world_from_sensor);
    let mut random = Random::new(seed, Purpose::Rays, 0);
    power_per_bin(scene, &sensor, settings, &Fan::new(false), &mut random)
}

impl SimulatedSonar {
    /// Looks at 192 pings of the dive to fix its decibel scale: their strongest bin is 29 dB at
    /// gain step 0, 45 dB above the floor. If none hears anything, the scale is that of a surface
    /// across the whole beam.
    #[must_use]
    pub fn new(scene: Arc<Scene>, dive: Arc<Dive>, noise: NoiseLevel, seed: u64) -> Self {
        let mut sonar = Self {
            scene,
            dive,
            fan: Fan::new(noise.is_harsh()),
            device: DeviceSide {
                level: noise,
                seed,
                strongest: 1.0,
            },
            seed,
        };
        sonar.device.strongest = sonar.strongest_echo();
        sonar
    }

    /// The same with the decibel scale of another: one device that goes from scene to scene.
    #[must_use]
    pub fn on_scale_of(mut self, other: &Self) -> Self {
        self.device.strongest = other.device.strongest;
        self
    }

    /// The dive it is carried along.
    #[must_use]
    pub fn dive(&self) -> &Arc<Dive> {
        &self.dive
    }

    /// The scene it looks at.
    #[must_use]
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Ping `index` of the dive, as the dive's own settings have it.
    #[must_use]
    pub fn ping(&self, index: usize) -> SimulatedPing {
        let settings = self.dive.settings_at(index);
        self.ping_at(index as u64, self.dive.transmit_s(index), &settings)
    }

    /// Ping `index` joined with what the dive reports of its pose, at the echo time of the middle of
    /// its range, as the service joins a live ping; `None` where reported poses are more than
    /// `max_pose_gap_s` apart. `trajectory` is [`Dive::trajectory`]'s.
    #[must_use]
    pub fn posed_ping(&self, index: usize, trajectory: &Trajectory) -> Option<PosedPing> {
        let ping = self.ping(index).to_ping().ok()?;
        let settings = ping.settings();
        let reference_range_m = settings.range_start_m + 0.5 * settings.range_length_m;
        let time = ping.echo_time(reference_range_m);
        let smoothed = trajectory
            .smoothed_at(time, LOOKAHEAD_S, Switch::Auto)
            .ok()?;
        Some(PosedPing {
            world_from_sensor: smoothed.pose.world_from_vehicle,
            twist: smoothed.twist,
            reference_range_m,
            uncertainty: None,
            jitter: smoothed.jitter,
            ping,
        })
    }

    /// A ping transmitted `time_s` into the dive with any settings; `sequence` picks its noise.
    /// Settings beyond what [`PingSettings::check`] allows give a ping of no power.
    #[must_use]
    pub fn ping_at(&self, sequence: u64, time_s: f64, settings: &PingSettings) -> SimulatedPing {
        let pose_after = |later_s: f64| self.dive.pose_during(time_s, later_s);
        SimulatedPing {
            view: self.dive.view_at(time_s),
            ..self.ping_along(sequence, time_s, settings, pose_after)
        }
    }

    /// As [`Self::ping_at`], but heard on another way through the same scene: `pose_after` says where
    /// the sensor is so many seconds after its transmit.
    #[must_use]
    pub fn ping_along(
        &self,
        sequence: u64,
        time_s: f64,
        settings: &PingSettings,
        pose_after: impl Fn(f64) -> Pose,
    ) -> SimulatedPing {
        let mut settings = *settings;
        settings.gain_index = self
            .device
            .gain_index(sequence, time_s, settings.gain_index);
        let heard = if settings.check().is_ok() {
            let echoes = self.echoes_along(sequence, &settings, pose_after);
            self.device.heard(sequence, &settings, echoes)
        } else {
            Vec::new()
        };
        let profile = Profile::from_power(&heard);
        let device_s = time_s * (1.0 + self.device.level.clock_drift());
        SimulatedPing {
            sequence,
            device_time_ms: (device_s * 1e3).round() as u32,
            settings,
            view: None,
            intensity: profile.intensity(),
            profile,
        }
    }

    /// Power per bin without any noise, solid angle × sensitivity × reflectivity in steradian.
    #[must_use]
    pub fn echoes(&self, sequence: u64, time_s: f64, settings: &PingSettings) -> Vec<f64> {
        self.echoes_along(sequence, settings, |later_s| {
            self.dive.pose_during(time_s, later_s)
        })
    }

    fn echoes_along(
        &self,
        sequence: u64,
        settings: &PingSettings,
        pose_after: impl Fn(f64) -> Pose,
    ) -> Vec<f64> {
        let mut random = Random::new(self.seed, Purpose::Rays, sequence);
        let sensor = MovingSensor::new(settings.range_end_m(), |range_m| {
            pose_after(range_m / settings.speed_of_sound_mps)
        });
        power_per_bin(&self.scene, &sensor, settings, &self.fan, &mut random)
    }

    fn strongest_echo(&self) -> f64 {
        let count = self.dive.pings();
        let looked_at = count.min(REFERENCE_PING_COUNT);
        // Spread by the golden ratio: in step with none of the dive's periods.
        let index = |i: usize| ((i as f64 * 0.618_033_988_75).fract() * count as f64) as usize;
        let strongest = (0..looked_at)
            .into_par_iter()
            .map(|i| {
                let index = index(i).min(count - 1);
                let settings = self.dive.settings_at(index);
                let echoes = self.echoes(index as u64, self.dive.transmit_s(index), &settings);
                echoes.into_iter().fold(0.0, f64::max)
            })
            .reduce(|| 0.0, f64::max);
        if strongest > 0.0 {
            return strongest;
        }
        let mut whole_beam = 0.0;
        let mut random = Random::new(0, Purpose::Rays, 0);
        self.fan
            .for_each(&mut random, |cell| whole_beam += cell.weight);
        whole_beam
    }
}
