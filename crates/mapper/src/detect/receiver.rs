//! What the receiver did to the pings: its gain, and amplification that grows with range. Both are undone by the
//! noise, which a receiver that does neither hears alike at every range and in every ping. And how long it hears its own
//! transducer.
//!
//! Cost: one pass over the bins of a ping, and a sort of them in each of a dive's first pings.

use std::collections::BTreeMap;
use std::sync::Arc;

use echosplat_model::{Ping, PingSettings};

/// Sections of range for each factor of e, in which noise is told.
const SECTIONS_PER_E: f32 = 6.0;
/// Sections that are told apart, from [`NEAREST_M`] to 400 m.
const SECTIONS: usize = 48;
const NEAREST_M: f32 = 0.15;
/// Fewest bins of a section that tell a quartile.
const LEAST_BINS: usize = 6;
/// Fewest sections on a line that tell its slope: a factor of 3 in range.
const LEAST_SECTIONS: i32 = 7;
/// Pings whose noise is averaged, about a second.
const GROUP: f32 = 64.0;
/// Pings after which the noise over range is known, some minutes.
const ENOUGH_PINGS: u32 = 16_384;
/// Another power of range is taken over if it changes what is 10 times as far by 1 dB.
const LEAST_CHANGE: f32 = 0.1;
/// Standard error of the log of a lower quartile of exponential noise, times the root of the number of bins.
const QUARTILE_ERROR: f32 = 2.0;
/// Sections this near a straight line lie on it beside their own error: 0.4 dB.
const ROUGHNESS: f32 = 0.1;
/// Noise that grows by less than this power of range is flat: units that correct for range do it by r² or more.
const LEAST_EXPONENT: f32 = 0.5;
/// Least factor of range between two sections whose slope is tried, as its log.
const LEAST_SPAN: f32 = 0.7;
/// Sections quieter than this part of the loudest bin hold no noise of a receiver: a ping spans at most 90 dB.
const SILENT: f32 = 1e-9;
/// The transducer is heard to ring where even the quietest pings are above so many times the noise.
const RINGS: f32 = 3.0;
/// Ringing dies away: from one section to the next it grows by no more than this, as its log.
const MOST_RISE: f32 = 0.2;
/// Pings that tell ringing.
const LEAST_RINGING_PINGS: u32 = 16;
/// Ringing that ends elsewhere by less is no news, metres.
const LEAST_RINGING_CHANGE_M: f64 = 0.1;
/// Pings further apart than this may show something else.
const TOGETHER_S: f64 = 0.5;
/// Bins above nothing that two pings must share to compare their gains.
const LEAST_SHARED_BINS: usize = 16;
/// Gains of a unit of which something is learnt: it has 8.
const MOST_GAINS: usize = 64;

/// What is learnt of the receiver as pings come in.
#[derive(Debug, Default)]
pub(crate) struct Receiver {
    /// Shape `[SECTIONS]`, empty before the first ping.
    sections: Vec<Section>,
    pings: u32,
    /// Whether enough pings came since the noise over range was last told.
    is_asked: bool,
    /// Power of range that the noise grows by.
    exponent: f32,
    /// Where the transducer is no longer heard to ring, if that is beyond what is taken for ringing in each ping, metres.
    rings_until_m: f64,
    /// Index that the others' gains are over.
    reference: Option<i16>,
    gains: BTreeMap<i16, Gain>,
    before: Option<Arc<Ping>>,
}

/// Noise at some range.
#[derive(Debug, Clone, Copy, Default)]
struct Section {
    /// Of the pings of late.
    now: Heard,
    /// Of the quietest group of pings: what the seabed fills is free of it when the vehicle is higher or rolls.
    quietest: Option<Heard>,
}

/// What some pings had in a section.
#[derive(Debug, Clone, Copy, Default)]
struct Heard {
    /// Sum over pings of the log of the lower quartile.
    log_sum: f32,
    pings: f32,
    bins: f32,
}

impl Heard {
    fn log_mean(&self) -> f32 {
        self.log_sum / self.pings
    }
}

impl Section {
    fn add(&mut self, quartile: f32, bins: usize) {
        self.now.log_sum += quartile.ln();
        self.now.pings += 1.0;
        self.now.bins += bins as f32;
        if self.now.pings >= GROUP {
            let before = self.quietest.unwrap_or(self.now);
            let is_quieter = self.now.log_mean() < before.log_mean();
            self.quietest = Some(if is_quieter { self.now } else { before });
            self.now = Heard::default();
        }
    }

    fn told(&self) -> Option<Heard> {
        let now = (self.now.pings > 0.0).then_some(self.now);
        self.quietest.or(now)
    }
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
        if self.pings >= ENOUGH_PINGS {
            return;
        }
        self.learn_noise(ping, blank);
        self.pings += 1;
        self.is_asked |= self.pings.is_power_of_two();
    }

    /// Takes over what pings so far say of the noise over range and of ringing beyond `told_m`, if it is news. Returns how much the
    /// power of range changes that [`Self::refer`] undoes, 0 if only ringing is news.
    pub(crate) fn settle(&mut self, told_m: f64) -> Option<f32> {
        if !std::mem::take(&mut self.is_asked) {
            return None;
        }
        let change = exponent_of(&self.sections).map_or(0.0, |told| told - self.exponent);
        let grows_otherwise = change.abs() >= LEAST_CHANGE;
        let change = if grows_otherwise { change } else { 0.0 };
        self.exponent += change;
        let rings_until_m = match self.pings >= LEAST_RINGING_PINGS {
            true => rings_until_m(&self.sections, self.exponent, told_m),
            false => 0.0,
        };
        let rings_otherwise = (rings_until_m - self.rings_until_m).abs() >= LEAST_RINGING_CHANGE_M;
        if rings_otherwise {
            self.rings_until_m = rings_until_m;
        }
        (grows_otherwise || rings_otherwise).then_some(change)
    }

    /// Where the transducer is no longer heard to ring, metres; 0 if every ping tells it by itself.
    pub(crate) fn rings_until_m(&self) -> f64 {
        self.rings_until_m
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
        self.sections.resize(SECTIONS, Section::default());
        let (settings, power) = (ping.settings(), ping.intensity());
        let log_gain = self.log_gain(settings.gain_index);
        let loudest = power[blank..].iter().copied().fold(0.0, f32::max);
        let section_of = |bin: usize| {
            let log = log_range(settings, bin) - NEAREST_M.ln();
            (log.max(0.0) * SECTIONS_PER_E) as usize
        };
        let mut start = blank;
        while start < power.len() {
            let section = section_of(start);
            let is_beyond = |bin: &usize| section_of(*bin) != section;
            let end = (start..power.len()).find(is_beyond).unwrap_or(power.len());
            if section < SECTIONS && end - start >= LEAST_BINS {
                let quartile = lower_quartile(&mut power[start..end].to_vec());
                if quartile > SILENT * loudest {
                    self.sections[section].add(quartile * (-log_gain).exp(), end - start);
                }
            }
            start = end;
        }
    }
}

/// Log of the range of a bin's middle over 1 m.
fn log_range(settings: &PingSettings, bin: usize) -> f32 {
    (settings.bin_center_m(bin) as f32)
        .max(f32::MIN_POSITIVE)
        .ln()
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

/// 0 of nothing.
fn lower_quartile(powers: &mut [f32]) -> f32 {
    let quarter = powers.len() / 4;
    if powers.is_empty() {
        return 0.0;
    }
    *powers.select_nth_unstable_by(quarter, f32::total_cmp).1
}

/// The power of range that noise grows by: the straight line, log over log, that most sections lie on. Echoes lie
/// above it, also where the seabed fills every section beyond some range; nothing may lie below.
///
/// `None` if too few sections do.
fn exponent_of(sections: &[Section]) -> Option<f32> {
    struct Point {
        x: f32,
        y: f32,
        error: f32,
    }
    let told = sections.iter().enumerate();
    let told = told.filter_map(|(index, section)| Some((index, section.told()?)));
    let points: Vec<Point> = told
        .map(|(index, heard)| Point {
            x: index as f32 / SECTIONS_PER_E,
            y: heard.log_mean(),
            error: QUARTILE_ERROR / heard.bins.sqrt() + ROUGHNESS,
        })
        .collect();
    let is_on =
        |p: &Point, slope: f32, offset: f32| (p.y - offset - slope * p.x).abs() <= 2.0 * p.error;
    let mut best = (0.0, 0.0, 0);
    for (i, a) in points.iter().enumerate() {
        for b in &points[i + 1..] {
            if b.x - a.x < LEAST_SPAN {
                continue;
            }
            let slope = (b.y - a.y) / (b.x - a.x);
            let offset = a.y - slope * a.x;
            let count = |p: &Point| match is_on(p, slope, offset) {
                true => 1,
                false => -i32::from(p.y < offset + slope * p.x),
            };
            let score: i32 = points.iter().map(count).sum();
            if score > best.2 {
                best = (slope, offset, score);
            }
        }
    }
    let (slope, offset, score) = best;
    if score < LEAST_SECTIONS {
        return None;
    }
    let on: Vec<&Point> = points.iter().filter(|p| is_on(p, slope, offset)).collect();
    let sum = |of: &dyn Fn(&Point) -> f32| on.iter().map(|p| of(p) / p.error.powi(2)).sum::<f32>();
    let (w, x, y) = (sum(&|_| 1.0), sum(&|p| p.x), sum(&|p| p.y));
    let (xx, xy) = (sum(&|p| p.x * p.x), sum(&|p| p.x * p.y));
    let exponent = (w * xy - x * y) / (w * xx - x * x);
    Some(match exponent >= LEAST_EXPONENT {
        true => exponent,
        false => 0.0,
    })
}

/// Where ringing ends that goes on beyond `told_m`, metres; 0 if none does. It is what no group of pings was without, from
/// the nearest section on and ever weaker: a structure is not in all pings, or has quiet before it.
fn rings_until_m(sections: &[Section], exponent: f32, told_m: f64) -> f64 {
    let edge_m = |index: usize| f64::from(NEAREST_M * (index as f32 / SECTIONS_PER_E).exp());
    let level = |index: usize, heard: Heard| {
        let log_range = NEAREST_M.ln() + (index as f32 + 0.5) / SECTIONS_PER_E;
        heard.log_mean() - exponent * log_range
    };
    let told = sections.iter().enumerate();
    let told: Vec<(usize, f32)> = told
        .filter_map(|(index, section)| Some((index, level(index, section.told()?))))
        .collect();
    let noise = told
        .iter()
        .map(|&(_, level)| level)
        .fold(f32::MAX, f32::min);
    let mut before: Option<(usize, f32)> = None;
    for &(index, level) in &told {
        let goes_on = match before {
            Some((last, last_level)) => index == last + 1 && level <= last_level + MOST_RISE,
            None => edge_m(index) <= told_m,
        };
        if !(goes_on && level > noise + RINGS.ln()) {
            break;
        }
        before = Some((index, level));
    }
    let end_m = before.map_or(0.0, |(last, _)| edge_m(last + 1));
    if end_m > told_m { end_m } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::Timestamp;

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
            learnt(64, |index| ping(index, 0, |r| of(index, r))).rings_until_m()
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
        assert!(learnt(64, passes).rings_until_m() > 1.9);
        assert!(learnt(128, passes).rings_until_m() < 1e-9);
        // Few pings tell nothing.
        let few = learnt(15, |index| ping(index, 0, ringing));
        assert!(few.rings_until_m() < 1e-9);
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
