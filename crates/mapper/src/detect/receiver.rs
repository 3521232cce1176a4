//! What the receiver did to the pings: its gain, and amplification that grows with range. Both are undone by the
//! noise, which a receiver that does neither hears alike at every range and in every ping. And how long it hears its own
//! transducer.
//!
//! Cost: one pass over the bins of a ping, and a sort of them in each of a dive's first pings.

use std::collections::BTreeMap;
use std::sync::Arc;

use echosplat_model::Ping;

use crate::detect::noise_over_range::{NoiseOverRange, Quartile, log_range, lower_quartile};
use crate::detect::ringing::Ringing;

/// Pings, found: some minutes.
/// Pings after which the noise over range is known, some minutes.
const ENOUGH_PINGS: u32 = 16_384;
/// Exponent, derived: 1 dB over a factor of 10.
/// Another power of range is taken over if it changes what is 10 times as far by 1 dB.
const LEAST_CHANGE: f32 = 0.1;
/// Seconds, found: scenes change.
/// Pings further apart than this may show something else.
const TOGETHER_S: f64 = 0.5;
/// Bins to compare two pings' gains; found.
/// Bins above nothing that two pings must share to compare their gains.
const LEAST_SHARED_BINS: usize = 16;
/// Gains; bounds memory.
/// Gains of a unit of which something is learnt: it has 8.
const MOST_GAINS: usize = 64;

/// What is learnt of the receiver as pings come in.
#[derive(Debug, Default)]
pub(crate) struct Receiver {
    noise: NoiseOverRange,
    noise_of_gain: BTreeMap<i16, NoiseOverRange>,
    /// Whether enough pings came since the noise over range was last told.
    is_asked: bool,
    /// Power of range that the noise grows by.
    exponent: f32,
    ringing: Ringing,
    /// Index that the others' gains are over.
    reference: Option<i16>,
    gains: BTreeMap<i16, Gain>,
    before: Option<Arc<Ping>>,
}

/// Of one gain index.
#[derive(Debug, Clone, Copy, Default)]
struct Gain {
    /// Log of its gain of power over that of the reference.
    log: f32,
    /// Steps from or to it that told it.
    steps: f32,
}

impl Receiver {
    /// Learns from the next ping of the dive; bins below `blank` tell nothing.
    pub(crate) fn learn(&mut self, ping: &Arc<Ping>, blank: usize) {
        self.learn_gain(ping, blank);
        self.before = Some(Arc::clone(ping));
        if self.noise.pings() >= ENOUGH_PINGS {
            return;
        }
        self.learn_noise(ping, blank);
        self.is_asked |= self.noise.pings().is_power_of_two();
    }

    /// Takes over what pings so far say of the noise over range and of ringing beyond `told_m`, if it is news. Returns how much the
    /// power of range changes that [`Self::refer`] undoes, 0 if only ringing is news.
    pub(crate) fn settle(&mut self, told_m: f64) -> Option<f32> {
        if !std::mem::take(&mut self.is_asked) {
            return None;
        }
        let change = self
            .noise
            .exponent()
            .map_or(0.0, |told| told - self.exponent);
        let grows_otherwise = change.abs() >= LEAST_CHANGE;
        let change = if grows_otherwise { change } else { 0.0 };
        self.exponent += change;
        let ringing = Ringing::of(&self.noise, &self.noise_of_gain, self.exponent, told_m);
        let rings_otherwise = ringing.is_news(&self.ringing);
        if rings_otherwise {
            self.ringing = ringing;
        }
        (grows_otherwise || rings_otherwise).then_some(change)
    }

    pub(crate) fn ringing(&self) -> &Ringing {
        &self.ringing
    }

    /// The ping as it would be at the gain of the reference, and with noise that is flat over range.
    pub(crate) fn refer(&self, ping: &Arc<Ping>) -> Arc<Ping> {
        let settings = ping.settings();
        let log_gain = self.log_gain(settings.gain_index);
        if log_gain == 0.0 && self.exponent == 0.0 {
            return Arc::clone(ping);
        }
        let log_factor = |bin: usize| -self.exponent * log_range(settings, bin) - log_gain;
        Arc::new(match self.exponent == 0.0 {
            true => ping.scaled(|_| (-log_gain).exp()),
            false => ping.scaled(|bin| log_factor(bin).exp()),
        })
    }

    fn log_gain(&self, index: i16) -> f32 {
        self.gains.get(&index).map_or(0.0, |gain| gain.log)
    }

    fn learn_gain(&mut self, ping: &Ping, blank: usize) {
        let to = ping.settings().gain_index;
        let (Some(before), Some(reference)) = (&self.before, self.reference) else {
            self.reference = Some(to);
            self.gains.insert(to, Gain::default());
            return;
        };
        let from = before.settings().gain_index;
        let is_known = self.gains.contains_key(&to);
        if from == to || (!is_known && self.gains.len() >= MOST_GAINS) {
            return;
        }
        let step = match log_step(before, ping, blank) {
            Some(step) => step,
            None if !is_known => log_quartile_step(before, ping, blank),
            None => return,
        };
        // What one step tells of either end; the reference stays.
        let (told, log) = match to == reference {
            false => (to, self.log_gain(from) + step),
            true => (from, -step),
        };
        let gain = self.gains.entry(told).or_default();
        gain.steps += 1.0;
        gain.log += (log - gain.log) / gain.steps;
    }

    fn learn_noise(&mut self, ping: &Ping, blank: usize) {
        let index = ping.settings().gain_index;
        let quartiles = Quartile::of_ping(ping, blank, self.log_gain(index));
        self.noise.add(&quartiles);
        if self.noise_of_gain.contains_key(&index) || self.noise_of_gain.len() < MOST_GAINS {
            self.noise_of_gain.entry(index).or_default().add(&quartiles);
        }
    }
}

/// Log of how much louder a ping is than the one before it. Echoes and noise alike change with the gain, so the
/// middle of what bins tell is the gain, whatever stands before the sonar. `None` if the two do not compare.
fn log_step(before: &Ping, ping: &Ping, blank: usize) -> Option<f32> {
    let (a, b) = (before.settings(), ping.settings());
    let apart_s = ping.transmit_time().seconds_since(before.transmit_time());
    let is_beside = |bin: usize| {
        let shift_m = a.bin_edge_m(bin) - b.bin_edge_m(bin);
        shift_m.abs() < 0.5 * a.bin_length_m()
    };
    let is_alike = a.bin_count == b.bin_count && is_beside(0) && is_beside(a.bin_count);
    if !is_alike || !(apart_s.abs() < TOGETHER_S) {
        return None;
    }
    let bins = before.intensity().iter().zip(ping.intensity()).skip(blank);
    let heard = bins.filter(|&(&then, &now)| then > 0.0 && now > 0.0);
    let mut ratios: Vec<f32> = heard.map(|(then, now)| now / then).collect();
    if ratios.len() < LEAST_SHARED_BINS {
        return None;
    }
    let middle = ratios.len() / 2;
    let (_, &mut ratio, _) = ratios.select_nth_unstable_by(middle, f32::total_cmp);
    let log = ratio.ln();
    log.is_finite().then_some(log)
}

/// The same by the noise alone, of pings that do not compare bin by bin.
fn log_quartile_step(before: &Ping, ping: &Ping, blank: usize) -> f32 {
    let log_quartile = |ping: &Ping| {
        let mut open = ping.intensity().get(blank..).unwrap_or_default().to_vec();
        lower_quartile(&mut open).max(f32::MIN_POSITIVE).ln()
    };
    log_quartile(ping) - log_quartile(before)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::{PingSettings, Timestamp};

    /// A ping of exponential noise times `power` of the range in metres.
    fn ping(index: u64, gain_index: i16, power: impl Fn(f32) -> f32) -> Ping {
        let settings = PingSettings {
            range_start_m: 0.0,
            range_length_m: 10.0,
            bin_count: 600,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 450e3,
            pulse_duration_s: 2e-5,
            gain_index,
        };
        let mut state = index.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut noise = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            -(1.0 - (state >> 40) as f32 / (1 << 24) as f32)
                .max(1e-7)
                .ln()
        };
        let bins = 0..settings.bin_count;
        let intensity = bins
            .map(|bin| noise() * power(settings.bin_center_m(bin) as f32))
            .collect();
        Ping::new(
            index,
            Timestamp::from_secs_f64(0.02 * index as f64),
            settings,
            intensity,
        )
        .unwrap()
    }

    fn learnt(pings: u64, of: impl Fn(u64) -> Ping) -> Receiver {
        let mut receiver = Receiver::default();
        for index in 0..pings {
            receiver.learn(&Arc::new(of(index)), 30);
            receiver.settle(1.0);
        }
        receiver
    }

    #[test]
    fn noise_that_grows_with_range_is_told_also_over_a_seabed_and_flat_noise_is_left_alone() {
        // The seabed's echo fills every bin beyond 3 m, 100 times the noise there and falling.
        let seabed = |range_m: f32| match range_m > 3.0 {
            true => 100.0 * (3.0 / range_m).powi(3),
            false => 0.0,
        };
        for exponent in [0, 2, 4] {
            let told = |range_m: f32| range_m.powi(exponent);
            let open = learnt(64, |index| ping(index, 0, told));
            let ground = learnt(64, |index| ping(index, 0, |r| told(r) * (1.0 + seabed(r))));
            for receiver in [open, ground] {
                let off = receiver.exponent - exponent as f32;
                assert!(off.abs() < 0.1, "{} for {exponent}", receiver.exponent);
            }
        }
        let flat = learnt(64, |index| ping(index, 0, |_| 1.0));
        assert!(flat.exponent.abs() < 1e-9);
    }

    #[test]
    fn a_step_of_gain_is_told_by_echoes_and_noise_alike() {
        let power = |gain: f32| move |r: f32| gain * if r > 4.0 { 300.0 / r } else { 1.0 };
        let gains = [1.0, 3.0, 12.0];
        let of = |index: u64| {
            let gain_index = [0, 1, 2, 1][(index / 3 % 4) as usize];
            ping(index, gain_index + 4, power(gains[gain_index as usize]))
        };
        let receiver = learnt(120, of);
        for (gain_index, gain) in (4..).zip(gains) {
            let ratio = receiver.log_gain(gain_index).exp() / gain;
            assert!((ratio - 1.0).abs() < 0.15, "{ratio} of {gain}");
        }
        let loud = Arc::new(of(6));
        let referred = receiver.refer(&loud);
        assert!((referred.intensity()[10] * 12.0 / loud.intensity()[10] - 1.0).abs() < 0.15);
    }

    #[test]
    fn ringing_is_told_as_far_as_no_ping_is_without_it_and_a_structure_near_by_is_none() {
        // Falls by 10 dB in 0.35 m, below three times the noise at 2.1 m.
        let ringing = |r: f32| 1.0 + 3e6 * (-r / 0.15).exp();
        let told = |of: &dyn Fn(u64, f32) -> f32| {
            learnt(64, |index| ping(index, 0, |r| of(index, r)))
                .ringing()
                .longest_m()
        };
        let rings = told(&|_, r| ringing(r));
        assert!((1.9..2.5).contains(&rings), "{rings}");
        assert!(told(&|_, _| 1.0) < 1e-9);
        // Ringing that each ping tells by itself.
        assert!(told(&|_, r| 1.0 + 1e6 * (-r / 0.045).exp()) < 1e-9);
        // A wall that stays, ground that fills all beyond 1.5 m.
        let wall = |_, r: f32| if (0.8..1.3).contains(&r) { 300.0 } else { 1.0 };
        assert!(told(&wall) < 1e-9);
        assert!(told(&|_, r| if r > 1.5 { 300.0 / r } else { 1.0 }) < 1e-9);
        // What fills the near ranges for a second and then does not.
        let passes = |index: u64| ping(index, 0, |r| if index < 64 { ringing(r) } else { 1.0 });
        assert!(learnt(64, passes).ringing().longest_m() > 1.9);
        assert!(learnt(128, passes).ringing().longest_m() < 1e-9);
        // Few pings tell nothing.
        let few = learnt(15, |index| ping(index, 0, ringing));
        assert!(few.ringing().longest_m() < 1e-9);
    }

    #[test]
    fn a_gain_that_rings_for_long_is_told_from_one_that_does_not() {
        let power = |gain_index: i16, r: f32| match gain_index {
            4 => 1.0 + 3e6 * (-r / 0.15).exp(),
            _ => 10.0,
        };
        let of = |index: u64| {
            let gain_index = [4, 7, 7][(index / 5 % 3) as usize];
            ping(index, gain_index, |r| power(gain_index, r))
        };
        let receiver = learnt(128, of);
        let [low_m, high_m, other_m] = [4, 7, 5].map(|index| receiver.ringing().until_m(index));
        assert!((1.9..2.5).contains(&low_m), "{low_m}");
        assert!(high_m < 1e-9, "{high_m}");
        // Of a gain that few pings had it is what no pings were without.
        assert!(other_m < low_m, "{other_m}");
        let longest_m = receiver.ringing().longest_m();
        assert!((longest_m - low_m).abs() < 1e-9);
    }

    #[test]
    fn ringing_is_told_of_many_gains_that_few_pings_had_each() {
        let of = |index: u64| ping(index, (index % 4) as i16, |r| 1.0 + 3e6 * (-r / 0.15).exp());
        let receiver = learnt(16, of);
        let until_m = receiver.ringing().until_m(2);
        assert!((1.9..2.5).contains(&until_m), "{until_m}");
    }

    #[test]
    fn silence_and_other_ranges_tell_nothing_and_break_nothing() {
        let receiver = learnt(8, |index| ping(index, index as i16, |_| 0.0));
        assert!(receiver.exponent.abs() < 1e-9);
        let referred = receiver.refer(&Arc::new(ping(9, 3, |_| 1.0)));
        assert!(referred.intensity().iter().all(|power| power.is_finite()));
        let many = learnt(300, |index| ping(index, index as i16, |_| 1.0));
        assert!(many.gains.len() <= MOST_GAINS);
    }
}
