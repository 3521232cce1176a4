//! What disturbances do to a ping on its way: to the echoes in the water, to the power at the receiver.

use echosplat_model::{PingSettings, Pose};
use rayon::prelude::*;

use super::echo::{Gathered, Listener, MovingSensor};
use super::field::Moment;
use super::simulated::SimulatedSonar;
use crate::disturbances::Disturbances;
use crate::random::{Purpose, Random};

/// Nearer than this the transducer rings: its bins are not asked what fraction of them is clipped.
const BLANKING_M: f64 = 0.5;

/// A ping as it reaches the end of the receiver.
pub(super) struct Received {
    /// Noiseless, as [`SimulatedSonar::echoes`].
    pub(super) echoes: Vec<f64>,
    /// As reported but for the stop.
    pub(super) power: Vec<f64>,
}

impl SimulatedSonar {
    pub(super) fn received(
        &self,
        moment: &Moment,
        settings: &PingSettings,
        pose_after: impl Fn(f64) -> Pose,
    ) -> Received {
        let echoes = self.disturbed_echoes(moment, settings, pose_after);
        let mut power = self.heard(moment, settings, &echoes);
        if let Some(pulses) = self.pulses(moment, settings) {
            let mean_noise = self.mean_noise(settings);
            for (power, pulse) in power.iter_mut().zip(pulses) {
                *power += mean_noise * pulse;
            }
        }
        Received { echoes, power }
    }

    /// Power per bin without noise, with all that the water and the vehicle add to echoes.
    fn disturbed_echoes(
        &self,
        moment: &Moment,
        reported: &PingSettings,
        pose_after: impl Fn(f64) -> Pose,
    ) -> Vec<f64> {
        let Disturbances {
            sound,
            surface,
            copies,
            multiples,
            ..
        } = *self.dive.disturbances();
        let elapsed = moment.time_s / self.dive.duration_s();
        let settings = sound.in_water(reported, elapsed);
        let sensor = MovingSensor::new(settings.range_end_m(), |range_m| {
            pose_after(range_m / settings.speed_of_sound_mps)
        });
        let listener = Listener {
            scene: &self.scene,
            sensor: &sensor,
            fan: &self.fan,
            radiometry: self.radiometry,
        };
        let mut random = Random::new(self.seed, Purpose::Rays, moment.sequence);
        let (mut direct, mut added) = (Gathered::new(&settings), Gathered::new(&settings));
        listener.for_each_echo(direct.reach_m(&settings), &mut random, |echo| {
            direct.add_echo(echo, self.radiometry);
            if surface.is_there() {
                for arrival in surface.images(&listener, echo).into_iter().flatten() {
                    added.add(arrival.middle_m, arrival.half_m, arrival.power);
                }
            }
        });
        for fish in &self.swimmers {
            if let Some((range_m, power)) = fish.echo(&listener, moment.time_s) {
                added.add(range_m, 0.0, power);
            }
        }
        let mut echoes = direct.into_bins(&settings);
        for (echo, added) in echoes.iter_mut().zip(added.into_bins(&settings)) {
            *echo += added;
        }
        multiples.add_to(&mut echoes, reported);
        copies.add_to(&mut echoes, reported.bin_length_m());
        echoes
    }

    /// Power per bin of other sonars over the mean noise, if there are any.
    fn pulses(&self, moment: &Moment, settings: &PingSettings) -> Option<Vec<f64>> {
        let Disturbances { spikes, walker, .. } = self.dive.disturbances();
        let is_quiet = spikes.per_ping <= 0.0 && walker.walk_mps.abs() <= 0.0;
        if is_quiet {
            return None;
        }
        let mut pulses = vec![0.0; settings.bin_count];
        spikes.add_to(&mut pulses, self.seed, moment.sequence);
        walker.add_to(&mut pulses, settings, self.seed, moment.time_s);
        Some(pulses)
    }

    /// The same with its receiver's stop where the dive's disturbances have it.
    pub(super) fn with_stop(mut self) -> Self {
        let saturation = self.dive.disturbances().saturation;
        self.stop = saturation.stop(|| self.echo_bins());
        self
    }

    /// Power of all bins of 192 pings in which the echo is above the mean noise.
    fn echo_bins(&self) -> Vec<f64> {
        let of_ping = |index: &usize| {
            let (sequence, time_s) = (*index as u64, self.dive.transmit_s(*index));
            let settings = self.settings_of(sequence, time_s, self.dive.settings_at(*index));
            let pose_after = |later_s| self.dive.pose_during(time_s, later_s);
            let moment = Moment {
                sequence,
                time_s,
                world_from_sensor: pose_after(0.0),
            };
            let received = self.received(&moment, &settings, pose_after);
            let audible = 1.0 / self.echo_over_noise();
            let is_echo = |bin: &usize| {
                received.echoes[*bin] > audible && settings.bin_center_m(*bin) > BLANKING_M
            };
            let bins = (0..settings.bin_count).filter(is_echo);
            bins.map(|bin| received.power[bin]).collect::<Vec<f64>>()
        };
        self.reference_pings()
            .par_iter()
            .flat_map_iter(of_ping)
            .collect()
    }
}

#[cfg(test)]
mod tests;
