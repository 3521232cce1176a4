//! The sonar of a dive.

use std::sync::Arc;

use echosplat_model::{LOOKAHEAD_S, PingSettings, Pose, PosedPing, Switch, Trajectory};
use rayon::prelude::*;

use super::device_side::{DeviceSide, STRONGEST_OVER_FLOOR_DB};
use super::echo::{MovingSensor, power_per_bin};
use super::field::{FieldUnit, Moment};
use super::gain::GainTrack;
use super::radiometry::Radiometry;
use super::{NoiseLevel, Profile, SimulatedPing};
use crate::beam::{Fan, SideLobes};
use crate::disturbances::Swimmer;
use crate::dive::{Dive, structure_or_default};
use crate::random::{Purpose, Random};
use crate::scene::Scene;

/// Pings looked at to find the strongest echo of a dive.
const REFERENCE_PING_COUNT: usize = 192;

/// What a sonar carried along a dive hears. Every ping is a pure function of scene, dive, noise,
/// seed and its number: pings may be made in parallel and in any order.
pub struct SimulatedSonar {
    pub(super) scene: Arc<Scene>,
    pub(super) dive: Arc<Dive>,
    pub(super) fan: Fan,
    pub(super) radiometry: Radiometry,
    device: DeviceSide,
    /// In place of `device` where the noise is that of the field.
    field: Option<FieldUnit>,
    pub(super) seed: u64,
    /// Of the dive's disturbances.
    pub(super) swimmers: Vec<Swimmer>,
    /// The most that the receiver reports, linear power.
    pub(super) stop: f64,
}

/// Power per bin of one ping from a sensor at rest, without any noise, side lobes or loss over range:
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
    let fan = Fan::new(SideLobes::Without);
    power_per_bin(
        scene,
        &sensor,
        settings,
        &fan,
        Radiometry::Even,
        &mut random,
    )
}

/// The fish of a dive.
fn swimmers(scene: &Scene, dive: &Dive, seed: u64) -> Vec<Swimmer> {
    let (low, high) = dive.reach();
    let (scene_low, scene_high) = structure_or_default(scene);
    let fish = dive.disturbances().fish;
    fish.swimmers(seed, low.min(scene_low), high.max(scene_high))
}

impl SimulatedSonar {
    /// Looks at 192 pings of the dive to fix its decibel scale: their strongest bin is 29 dB at
    /// gain step 0, 45 dB above the floor. If none hears anything, the scale is that of a surface
    /// across the whole beam. With the noise of the field the scale is that of a real unit, the same
    /// for every dive, and echoes decide on the gain: a ping every 0.25 s is looked at for that.
    #[must_use]
    pub fn new(scene: Arc<Scene>, dive: Arc<Dive>, noise: NoiseLevel, seed: u64) -> Self {
        let (side_lobes, radiometry) = match noise {
            NoiseLevel::None | NoiseLevel::Nominal => (SideLobes::Without, Radiometry::Even),
            NoiseLevel::Field => (SideLobes::Field, Radiometry::Sea),
            NoiseLevel::Harsh => (SideLobes::Harsh, Radiometry::Even),
        };
        let mut sonar = Self {
            swimmers: swimmers(&scene, &dive, seed),
            scene,
            dive,
            fan: Fan::new(side_lobes),
            radiometry,
            device: DeviceSide {
                level: noise,
                seed,
                strongest: 1.0,
            },
            field: None,
            seed,
            stop: f64::INFINITY,
        };
        if noise.is_field() {
            return sonar.with_field_unit(FieldUnit::new(seed)).with_stop();
        }
        sonar.device.strongest = sonar.strongest_echo();
        sonar.with_stop()
    }

    /// The same with the decibel scale of another: one device that goes from scene to scene.
    #[must_use]
    pub fn on_scale_of(mut self, other: &Self) -> Self {
        self.device.strongest = other.device.strongest;
        match (self.field.take(), &other.field) {
            (Some(own), Some(other)) => {
                let echo_over_noise = other.echo_over_noise();
                self.with_field_unit(own.with_echo_over_noise(echo_over_noise))
            }
            (own, _) => Self { field: own, ..self },
        }
        .with_stop()
    }

    /// The same with as much noise under the echoes that the strongest echo of a ping, before speckle,
    /// stands `over_noise_db` above its mean: the median over 192 pings of the dive. `None` if half of
    /// them hear nothing.
    #[must_use]
    pub fn with_echoes_over_noise(mut self, over_noise_db: f64) -> Option<Self> {
        let mut strongest = self.strongest_echoes();
        strongest.sort_by(f64::total_cmp);
        let median = strongest[strongest.len() / 2];
        if !(median > 0.0) {
            return None;
        }
        let over_noise = 10f64.powf(0.1 * over_noise_db) / median;
        self.device.strongest = 10f64.powf(0.1 * STRONGEST_OVER_FLOOR_DB) / over_noise;
        let scaled = match self.field.take() {
            Some(unit) => self.with_field_unit(unit.with_echo_over_noise(over_noise)),
            None => self,
        };
        Some(scaled.with_stop())
    }

    /// The unit with the gain that the echoes of this dive lead it to.
    fn with_field_unit(mut self, unit: FieldUnit) -> Self {
        let duration_s = self.dive.duration_s();
        let loudest_db = |time_s: &f64| {
            let index = (time_s / self.dive.ping_interval_s()).round() as usize;
            let index = index.min(self.dive.pings().saturating_sub(1));
            let settings = as_transmitted(self.dive.settings_at(index));
            let moment = Moment {
                sequence: index as u64,
                time_s: self.dive.transmit_s(index),
                world_from_sensor: self.dive.pose_during(self.dive.transmit_s(index), 0.0),
            };
            let echoes = self.echoes(moment.sequence, moment.time_s, &settings);
            unit.loudest_db(&moment, &settings, &echoes)
        };
        let times_s = GainTrack::times(duration_s);
        let loudest_db: Vec<f64> = times_s.par_iter().map(loudest_db).collect();
        let gain = GainTrack::following(&loudest_db, duration_s);
        self.field = Some(unit.with_gain(gain));
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
        let settings = self.settings_of(sequence, time_s, *settings);
        let heard = if settings.check().is_ok() {
            let moment = Moment {
                sequence,
                time_s,
                world_from_sensor: pose_after(0.0),
            };
            let mut power = self.received(&moment, &settings, pose_after).power;
            for power in &mut power {
                *power = power.min(self.stop);
            }
            power
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

    /// Linear power per bin as the device reports it, of noiseless echoes.
    pub(super) fn heard(
        &self,
        moment: &Moment,
        settings: &PingSettings,
        echoes: &[f64],
    ) -> Vec<f64> {
        match &self.field {
            Some(unit) => unit.heard(moment, settings, echoes),
            None => self
                .device
                .heard(moment.sequence, settings, echoes.to_vec()),
        }
    }

    /// Mean power of the noise as reported; without noise, what nominal noise would have.
    pub(super) fn mean_noise(&self, settings: &PingSettings) -> f64 {
        match &self.field {
            Some(_) => FieldUnit::mean_noise(settings),
            None => DeviceSide::mean_noise(settings),
        }
    }

    /// Over that, power of an echo of 1.
    pub(super) fn echo_over_noise(&self) -> f64 {
        match &self.field {
            Some(unit) => unit.echo_over_noise(),
            None => self.device.echo_over_noise(),
        }
    }

    /// What the device makes of the settings that it was asked for.
    pub(super) fn settings_of(
        &self,
        sequence: u64,
        time_s: f64,
        asked: PingSettings,
    ) -> PingSettings {
        match &self.field {
            Some(unit) => PingSettings {
                gain_index: unit.gain_index(sequence, time_s),
                ..as_transmitted(asked)
            },
            None => PingSettings {
                gain_index: self.device.gain_index(sequence, time_s, asked.gain_index),
                ..asked
            },
        }
    }

    /// Power per bin without any noise or disturbance, solid angle × sensitivity × reflectivity in
    /// steradian; with the noise of the field weakened by range and angle, in steradian per square metre.
    #[must_use]
    pub fn echoes(&self, sequence: u64, time_s: f64, settings: &PingSettings) -> Vec<f64> {
        let mut random = Random::new(self.seed, Purpose::Rays, sequence);
        let sensor = MovingSensor::new(settings.range_end_m(), |range_m| {
            let later_s = range_m / settings.speed_of_sound_mps;
            self.dive.pose_during(time_s, later_s)
        });
        power_per_bin(
            &self.scene,
            &sensor,
            settings,
            &self.fan,
            self.radiometry,
            &mut random,
        )
    }

    /// Some pings of the dive.
    pub(super) fn reference_pings(&self) -> Vec<usize> {
        let count = self.dive.pings();
        let looked_at = count.min(REFERENCE_PING_COUNT);
        // Spread by the golden ratio: in step with none of the dive's periods.
        let index = |i: usize| ((i as f64 * 0.618_033_988_75).fract() * count as f64) as usize;
        (0..looked_at).map(|i| index(i).min(count - 1)).collect()
    }

    /// Of those, each one's.
    fn strongest_echoes(&self) -> Vec<f64> {
        self.reference_pings()
            .into_par_iter()
            .map(|index| {
                let (sequence, time_s) = (index as u64, self.dive.transmit_s(index));
                let settings = self.settings_of(sequence, time_s, self.dive.settings_at(index));
                let echoes = self.echoes(sequence, time_s, &settings);
                echoes.into_iter().fold(0.0, f64::max)
            })
            .collect()
    }

    fn strongest_echo(&self) -> f64 {
        let strongest = self.strongest_echoes().into_iter().fold(0.0, f64::max);
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

/// Settings with the pulse that a real unit transmits.
fn as_transmitted(settings: PingSettings) -> PingSettings {
    PingSettings {
        pulse_duration_s: FieldUnit::pulse_duration_s(&settings),
        ..settings
    }
}
