//! A ping's profile as evidence: what is noise, what is echo, and what an echo may hide.

use echosplat_model::Ping;

use crate::MapperConfig;
use crate::detect::bin_state::BinState;
use crate::detect::compact::{Powers, States};
use crate::detect::noise_over_range::{SECTIONS, section_edge_m};
use crate::detect::ringing::Ringing;

/// One ping's intensities and what they say, shapes `[bin_count]`.
#[derive(Debug, Clone)]
pub(crate) struct Profile {
    /// Linear power at one gain, with noise that is flat over range.
    pub(crate) intensity: Powers,
    /// What each bin says, echoes widened by the localisation error.
    pub(crate) state: States,
    /// Runs of bins above the threshold, half-open, not widened.
    pub(crate) echoes: Box<[(u32, u32)]>,
    /// Runs of bins that may be echoes heard again: they say nothing.
    pub(crate) doubted: Box<[(u32, u32)]>,
    /// Runs of bins that are another sonar's pulses or the vehicle itself, by where they begin: they say nothing either.
    pub(crate) foreign: Box<[(u32, u32)]>,
    range_start_m: f32,
    bin_length_m: f32,
    /// Mean power of the noise in this ping.
    pub(crate) noise: f32,
    /// What echoes are told from: the noise, and that of a silent simulator would make darkness infinitely telling.
    pub(crate) background: f32,
    /// What the seabed sends back, as thought; empty where none is known.
    pub(crate) ground: Powers,
    /// Strongest power of late at about the range of the loudest echo of this ping.
    strongest_here: f32,
    /// The same at about each range, by section of it.
    strongest: Powers,
    /// An echo is above this, and no side lobe.
    threshold: f32,
    /// Echoes below this fraction of the strongest at about their range are side lobes of the beam.
    side_lobe_fraction: f32,
    blank: usize,
    /// Bins that echoes are widened by, and that they may hide.
    widen: usize,
    shadow: usize,
    /// Most bins beyond the blanking that the transducer may still ring in.
    most_ring_down: usize,
    /// Bins from the ping's start that are known to ring in every ping of its gain.
    rings: usize,
}

/// What the seabed sends back, power per bin; both empty where none is known.
#[derive(Debug, Clone, Default)]
pub(crate) struct Backdrop {
    pub(crate) expected: Vec<f32>,
    /// The most it may be with heights a little off.
    pub(crate) most: Vec<f32>,
}

impl Profile {
    /// Echoes are above these powers, shape `[bin_count]`.
    pub(crate) fn thresholds(&self, bin_count: usize) -> Vec<f32> {
        let mut thresholds = vec![self.threshold; bin_count];
        let mut start = 0;
        for (section, strongest) in self.strongest.iter().enumerate() {
            let end = self.end_of(section).clamp(start, bin_count);
            thresholds[start..end].fill(self.threshold.max(self.side_lobe_fraction * strongest));
            start = end;
        }
        thresholds
    }

    /// Strongest power of late, when the ping came, at about the range of its loudest echo.
    pub(crate) fn strongest_here(&self) -> f32 {
        self.strongest_here
    }

    /// The first bin that may say anything: beyond the blanking, and beyond where the transducer is known to ring.
    pub(crate) fn first_bin(&self) -> usize {
        self.blank.max(self.rings)
    }

    /// Bins of echoes above `least` that nothing within two bins is above, ascending.
    pub(crate) fn peaks(&self, intensity: &[f32], least: f32) -> Vec<usize> {
        let around = |bin: usize| {
            greatest(&intensity[bin.saturating_sub(2)..(bin + 3).min(intensity.len())])
        };
        let bins = self.echoes.iter();
        bins.flat_map(|&(start, end)| start as usize..end as usize)
            .filter(|&bin| intensity[bin] > least && around(bin) <= intensity[bin])
            .collect()
    }

    /// Whether there is an echo in a bin, or within the localisation error of it.
    pub(crate) fn is_lit(&self, bin: usize) -> bool {
        self.state.at(bin) == BinState::Lit
    }

    /// Has echoes light places this much nearer and farther from the next [`Self::judge`] on.
    pub(crate) fn tolerate(&mut self, tolerance_m: f32) {
        self.widen = widen_bins(tolerance_m.into(), self.bin_length_m.into());
    }

    /// Has nothing nearer than this say anything from the next [`Levels::renew`] on: the transducer is known to ring there.
    pub(crate) fn ring_until(&mut self, range_m: f64) {
        self.rings = self.bins_nearer(range_m);
    }

    /// The first bin beyond a section of range.
    fn end_of(&self, section: usize) -> usize {
        self.bins_nearer(section_edge_m(section + 1))
    }

    fn bins_nearer(&self, range_m: f64) -> usize {
        let (start_m, length_m) = (self.range_start_m, self.bin_length_m);
        bins_nearer(range_m, start_m.into(), length_m.into())
    }

    /// Tells echoes from noise and from the seabed, and passes over what is doubted.
    pub(crate) fn judge(&mut self, intensity: &[f32], ground: &Backdrop) {
        let count = intensity.len();
        let least = self.thresholds(count);
        let raised = |bin: usize| {
            let ground = ground.most.get(bin).copied().unwrap_or(0.0);
            least[bin].max(GROUND_FACTOR * ground)
        };
        let doubted = || self.doubted.iter().chain(&self.foreign);
        let mut is_doubted = vec![false; doubted().next().map_or(0, |_| count)];
        for &(start, end) in doubted() {
            is_doubted[start as usize..end as usize].fill(true);
        }
        let ring_down = ring_down_end(intensity, self.blank, self.most_ring_down, raised);
        let ring_down = ring_down.max(self.rings);
        let doubts =
            |bin: usize| bin < ring_down || is_doubted.get(bin).is_some_and(|&doubted| doubted);
        let level = |bin: usize| {
            if doubts(bin) {
                f32::INFINITY
            } else {
                raised(bin)
            }
        };
        let echoes = runs_above(intensity, self.blank, level);
        let mut states = states(count, self.blank, &echoes, self.widen, self.shadow);
        // The brighter the seabed, the fewer structures would stand out: their absence is no news.
        for (bin, state) in states.iter_mut().enumerate() {
            let level = raised(bin);
            if *state != BinState::Dark || !(level > least[bin]) {
                continue;
            }
            let dull = least[bin].powf(DULL_SHARE) * self.strongest_here.powf(1.0 - DULL_SHARE);
            if level > dull {
                *state = BinState::Shadowed;
            }
        }
        for (bin, state) in states.iter_mut().enumerate() {
            if doubts(bin) && *state != BinState::Lit {
                *state = BinState::Blank;
            }
        }
        self.echoes = echoes.into();
        self.state = States::of(&states);
        self.ground = Powers::of(&ground.expected, greatest(&ground.expected));
    }
}

/// Ratio over the seabed's power; found.
/// A bin stands out from the seabed above this many times its power.
const GROUND_FACTOR: f32 = 5.0;
/// Fraction of decibels; found.
/// Where a threshold leaves less than this share of the decibels up to the strongest echo, darkness
/// says little.
const DULL_SHARE: f32 = 0.35;
/// Fraction of the strongest of late; found.
/// Noise is reckoned with at least so far below the strongest echo of late.
const LEAST_NOISE: f32 = 1e-4;
/// Sections, found: a factor of two.
/// What is heard of an echo off the beam's axis or by another way is at about its range: within a factor of two.
const NEAR_SECTIONS: usize = 4;
/// Ratio of power, physics: 40 to 52 dB a decade.
/// What is left, a section of range further, of what comes after an echo: real units' echoes fall by 40 dB a decade.
const FALL_PER_SECTION: f32 = 0.513;
/// Ratio left after each ping, found: 1 dB in 115.
/// What is left of the strongest echo after each ping: 1 dB in 115.
const LEFT: f32 = 0.998;
/// Bins that tell noise; found.
/// Bins without the seabed that tell noise.
const LEAST_QUIET_BINS: usize = 48;

/// Metres, found: thickness and shadow.
/// Darkness this far behind an echo is weak evidence: a structure's own thickness and its shadow.
const SHADOW_LENGTH_M: f64 = 0.6;

/// Metres, measured: ends 0.35 to 0.5 m away.
/// Where noise is low the transducer is heard to ring for so long beyond the blanking: it falls by 10 dB in 0.1 m or
/// faster, and ends 0.35 to 0.5 m away where real units had their noise.
pub(crate) const RING_DOWN_M: f64 = 0.5;
/// Bins dark by speckle; found.
/// Bins that speckle may make dark in it, one after the other.
const RING_DOWN_GAP: usize = 3;

/// What is learnt of the noise and the strongest echo as pings come in.
#[derive(Debug, Clone, Default)]
pub(crate) struct Levels {
    noise: Option<f32>,
    strongest: f32,
    /// The same by section of range.
    strongest_at: Vec<f32>,
    /// The same of all pings heard, echoes or not.
    loudest: f32,
    /// Pings in a row that were too loud to be believed.
    wild: u32,
    ringing: Ringing,
}

/// Ratio of power; found.
/// No echo is so many times the strongest before it; unless so many pings in a row say so.
const WILD: f32 = 1e6;
/// Pings in a row; found.
const BELIEVED_AFTER: u32 = 8;

impl Levels {
    /// Of a unit that is known to ring.
    pub(crate) fn ringing(ringing: Ringing) -> Self {
        Self {
            ringing,
            ..Self::default()
        }
    }

    /// The strongest power of late about as far away as what the newest ping heard loudest.
    pub(crate) fn strongest(&self) -> f32 {
        self.strongest
    }

    /// Turns a ping into evidence and learns from it. `tolerance_m` widens the echoes; `ground` is
    /// what the seabed sends back, empty where none is known; `foreign` are no echoes.
    pub(crate) fn profile(
        &mut self,
        ping: &Ping,
        tolerance_m: f64,
        ground: &Backdrop,
        foreign: Box<[(u32, u32)]>,
        config: &MapperConfig,
    ) -> Profile {
        let bin_length_m = ping.settings().bin_length_m();
        let mut profile = Profile {
            intensity: Powers::default(),
            state: States::default(),
            echoes: Box::default(),
            doubted: Box::default(),
            foreign,
            range_start_m: ping.settings().range_start_m as f32,
            bin_length_m: bin_length_m as f32,
            noise: 0.0,
            background: 0.0,
            strongest_here: 0.0,
            strongest: Powers::default(),
            threshold: 0.0,
            side_lobe_fraction: 10f32.powf(-0.1 * config.dynamic_range_db),
            blank: blank_bins(ping, config.blanking_m),
            widen: widen_bins(tolerance_m, bin_length_m),
            shadow: (SHADOW_LENGTH_M / bin_length_m) as usize,
            most_ring_down: (RING_DOWN_M / bin_length_m) as usize,
            rings: 0,
            ground: Powers::default(),
        };
        let rings_until_m = self.ringing.until_m(ping.settings().gain_index);
        profile.ring_until(rings_until_m);
        self.renew(&mut profile, ping.intensity(), ground, config);
        profile
    }

    /// Makes a profile anew of a ping's power, and learns from it.
    pub(crate) fn renew(
        &mut self,
        profile: &mut Profile,
        intensity: &[f32],
        ground: &Backdrop,
        config: &MapperConfig,
    ) {
        let blank = profile.first_bin().min(intensity.len());
        let open = &intensity[blank..];
        let peak = greatest(open);
        let ground_here = ground.most.get(blank..).unwrap_or_default();
        let (measured, floor) = self.learn_noise(open, ground_here);
        // What is at the floor is no echo, and is reckoned with as the noise that it shows.
        let noise = measured.max(floor);
        let threshold = (config.detection_factor * measured).max(ABOVE_FLOOR * floor);
        let loudest = self.learn_strongest_at(profile, intensity, threshold);
        let near = self.strongest_near();
        if let Some(section) = loudest {
            self.strongest = near[section];
        }
        profile.intensity = Powers::of(intensity, peak);
        profile.noise = noise;
        profile.background = noise.max(LEAST_NOISE * self.strongest);
        profile.strongest_here = self.strongest;
        profile.strongest = Powers::of(&near, greatest(&near));
        profile.threshold = threshold;
        profile.doubted = Box::default();
        profile.judge(intensity, ground);
    }

    /// Takes in the strongest echo that a ping has at each range. Returns the section of the strongest of all, if there is
    /// one.
    fn learn_strongest_at(
        &mut self,
        profile: &Profile,
        intensity: &[f32],
        threshold: f32,
    ) -> Option<usize> {
        self.strongest_at.resize(SECTIONS, 0.0);
        let count = intensity.len();
        let mut start = profile.first_bin().min(count);
        let mut loudest = (threshold, None);
        for (section, strongest) in self.strongest_at.iter_mut().enumerate() {
            let end = profile.end_of(section).clamp(start, count);
            let peak = greatest_without(&intensity[..end], start, &profile.foreign);
            let is_echo = peak > threshold;
            *strongest = risen(*strongest, if is_echo { peak } else { 0.0 });
            if peak > loudest.0 {
                loudest = (peak, Some(section));
            }
            start = end;
        }
        loudest.1
    }

    /// The strongest echo of late at about each section of range, or what is left of one that came long before.
    fn strongest_near(&self) -> Vec<f32> {
        let mut left = 0.0_f32;
        let near = |section: usize| {
            let first = section.saturating_sub(NEAR_SECTIONS);
            left = FALL_PER_SECTION * left.max(self.strongest_at[first]);
            let around = first..(section + NEAR_SECTIONS + 1).min(SECTIONS);
            left.max(greatest(&self.strongest_at[around]))
        };
        (0..SECTIONS).map(near).collect()
    }

    /// Whether a ping is evidence of anything: its receiver is not at its stop, and it is not louder than can be, a glitch
    /// and not a specular return. Nothing else is learnt of one that is not.
    pub(crate) fn hears(&mut self, ping: &Ping, blanking_m: f64) -> bool {
        let open = &ping.intensity()[blank_bins(ping, blanking_m)..];
        if open.is_empty() || is_clipped(open) {
            return false;
        }
        let peak = greatest(open);
        let is_loud = self.loudest > 0.0 && peak / WILD > self.loudest;
        self.wild = if is_loud { self.wild + 1 } else { 0 };
        let is_wild = (1..BELIEVED_AFTER).contains(&self.wild);
        if !is_wild {
            self.loudest = risen(self.loudest, peak);
        }
        !is_wild
    }

    /// Mean power of the noise, and the floor of the ping's decibels if noise lies below it, else 0. A ping full of echoes is
    /// held to what pings before it showed.
    fn learn_noise(&mut self, open: &[f32], ground: &[f32]) -> (f32, f32) {
        let mut sorted = open.to_vec();
        if let Some(before) = self.noise.filter(|_| !ground.is_empty()) {
            let bins = open.iter().zip(ground);
            let quiet = bins.filter(|&(_, &ground)| ground < 0.3 * before);
            sorted = quiet.map(|(&power, _)| power).collect();
            if sorted.len() < LEAST_QUIET_BINS {
                return (before, 0.0);
            }
        }
        if sorted.is_empty() {
            return (self.noise.unwrap_or(0.0), 0.0);
        }
        let heard = Noise::of(&mut sorted);
        let here = match heard {
            Noise::Mean(mean) | Noise::AtMost { mean, .. } => mean,
        };
        let before = self.noise.unwrap_or(here);
        let here = match heard {
            Noise::Mean(_) => here,
            // Nothing speaks against what was before: that there is at most so much does not say that there is more.
            Noise::AtMost { .. } => here.min(before),
        };
        // The floor sinks fast and rises slowly: gain steps are a few decibels, echoes many.
        let now = if here < before {
            0.5 * (before + here)
        } else {
            before + 0.05 * (here.min(4.0 * before) - before)
        };
        self.noise = Some(now.max(f32::MIN_POSITIVE));
        (here.min(4.0 * now).max(f32::MIN_POSITIVE), heard.floor())
    }
}

/// Ratio of power, assumed: 1 dB.
/// An echo is so far above the floor of a ping whose noise lies below it, 1 dB: what is at the floor itself may be anything
/// less.
const ABOVE_FLOOR: f32 = 1.26;
/// Power, measured: units' decibels begin at −45.
/// Where real units' decibels begin, −45 dB: what is there holds no noise at all. By a margin for rounding.
pub(crate) const SILENCE: f32 = 3.2e-5;

/// What the bins of a ping say of the mean power of its noise.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Noise {
    Mean(f32),
    /// A quarter of the bins or more is at the floor of the ping's decibels, which span 90 dB at most: what they held is not
    /// known.
    AtMost {
        mean: f32,
        floor: f32,
    },
}

impl Noise {
    /// Of bins that are mostly noise; sorts them.
    ///
    /// Of exponential noise the fraction `1 − exp(−floor/mean)` lies below the floor. The mean that makes the fraction that is
    /// there the likeliest is `−floor/ln(1 − fraction)`; echoes in other bins only raise it.
    fn of(powers: &mut [f32]) -> Self {
        let mean = mean_of_noise(powers);
        let Some(floor) = floor_of(powers) else {
            return Self::Mean(mean);
        };
        let at_floor = powers.iter().filter(|&&power| power <= floor).count() as f32;
        // All of them: half a bin may have been above it.
        let fraction = at_floor.min(powers.len() as f32 - 0.5) / powers.len() as f32;
        Self::AtMost {
            mean: -floor / (-fraction).ln_1p(),
            floor,
        }
    }

    /// 0 where noise is above it.
    fn floor(self) -> f32 {
        match self {
            Self::Mean(_) => 0.0,
            Self::AtMost { floor, .. } => floor,
        }
    }
}

/// The least power, where a quarter of the bins have it and it is not silence: the ping's decibels end there, and what was
/// less is shown as that.
fn floor_of(powers: &[f32]) -> Option<f32> {
    let least = powers.iter().copied().min_by(f32::total_cmp)?;
    let at_least = powers.iter().filter(|&&power| power <= least).count();
    (least > SILENCE && 4 * at_least > powers.len()).then_some(least)
}

/// Mean power of exponentially distributed noise from the lower quartile of bins that are mostly noise:
/// `q₁/₄ = −ln(3/4)·mean`. Sorts them; 0 of none.
pub(crate) fn mean_of_noise(powers: &mut [f32]) -> f32 {
    /// Ratio, physics: −ln(3/4).
    const QUARTILE_OVER_MEAN: f32 = 0.287_682;
    let quarter = powers.len() / 4;
    if powers.is_empty() {
        return 0.0;
    }
    *powers.select_nth_unstable_by(quarter, f32::total_cmp).1 / QUARTILE_OVER_MEAN
}

/// Rises at once and falls slowly, so that one specular return does not hide what follows.
fn risen(strongest: f32, peak: f32) -> f32 {
    peak.max(strongest * LEFT)
}

/// The greatest power; 0 of none.
pub(crate) fn greatest(powers: &[f32]) -> f32 {
    powers.iter().copied().fold(0.0, f32::max)
}

/// The greatest power from bin `blank` on, without some runs of bins in growing order.
fn greatest_without(powers: &[f32], blank: usize, runs: &[(u32, u32)]) -> f32 {
    let (mut most, mut from) = (0.0_f32, blank);
    for &(start, end) in runs {
        let until = powers.len().min(start as usize);
        let before = powers.get(from..until).unwrap_or_default();
        most = most.max(greatest(before));
        from = from.max(end as usize);
    }
    most.max(greatest(powers.get(from..).unwrap_or_default()))
}

/// Bins that echoes are widened by where places are told to `tolerance_m`.
pub(crate) fn widen_bins(tolerance_m: f64, bin_length_m: f64) -> usize {
    (tolerance_m / bin_length_m).ceil() as usize
}

/// Whether a quarter of the bins or more hold the very same largest power: a receiver at its stop,
/// or a scale without a span. Silence is not: there is nothing to be heard.
fn is_clipped(open: &[f32]) -> bool {
    let peak = greatest(open);
    let at_peak = open.iter().filter(|&&power| power >= peak).count();
    peak > 0.0 && open.len() > 1 && 4 * at_peak >= open.len()
}

/// Bins that begin nearer than the blanking.
pub(crate) fn blank_bins(ping: &Ping, blanking_m: f64) -> usize {
    let settings = ping.settings();
    let bins = bins_nearer(blanking_m, settings.range_start_m, settings.bin_length_m());
    bins.min(settings.bin_count)
}

/// Bins that begin nearer than this, if there are so many.
fn bins_nearer(range_m: f64, range_start_m: f64, bin_length_m: f64) -> usize {
    ((range_m - range_start_m) / bin_length_m).ceil().max(0.0) as usize
}

fn runs_above(intensity: &[f32], from: usize, threshold: impl Fn(usize) -> f32) -> Vec<(u32, u32)> {
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for (bin, &power) in intensity.iter().enumerate().skip(from) {
        if !(power > threshold(bin)) {
            continue;
        }
        match runs.last_mut() {
            Some((_, end)) if *end as usize == bin => *end += 1,
            _ => runs.push((bin as u32, bin as u32 + 1)),
        }
    }
    runs
}

/// Where what goes on from the blanking without a gap ends, if that is near enough to be ringing.
fn ring_down_end(
    intensity: &[f32],
    blank: usize,
    most_bins: usize,
    threshold: impl Fn(usize) -> f32,
) -> usize {
    let is_loud = |bin: usize| {
        intensity
            .get(bin)
            .is_some_and(|&power| power > threshold(bin))
    };
    let goes_on = |&bin: &usize| (bin..bin + RING_DOWN_GAP).any(is_loud);
    let bins = (blank..intensity.len()).take_while(goes_on).count();
    match bins <= most_bins {
        true => blank + bins,
        false => blank,
    }
}

fn states(
    bin_count: usize,
    blank: usize,
    echoes: &[(u32, u32)],
    widen: usize,
    shadow: usize,
) -> Vec<BinState> {
    let mut states = vec![BinState::Dark; bin_count];
    for &(_, end) in echoes {
        let end = end as usize;
        states[end..(end + widen + shadow).min(bin_count)].fill(BinState::Shadowed);
    }
    for &(start, end) in echoes {
        let first = (start as usize).saturating_sub(widen);
        states[first..(end as usize + widen).min(bin_count)].fill(BinState::Lit);
    }
    states[..blank].fill(BinState::Blank);
    states
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::{PingSettings, Timestamp};

    /// Noise lets nothing through.
    fn strict() -> MapperConfig {
        MapperConfig {
            detection_factor: 12.0,
            ..MapperConfig::default()
        }
    }

    fn ping(intensity: Vec<f32>) -> Ping {
        let settings = PingSettings {
            range_start_m: 0.0,
            range_length_m: 0.02 * intensity.len() as f64,
            bin_count: intensity.len(),
            speed_of_sound_mps: 1500.0,
            frequency_hz: 450e3,
            pulse_duration_s: 2e-5,
            gain_index: 0,
        };
        Ping::new(0, Timestamp::ZERO, settings, intensity).unwrap()
    }

    /// Exponential noise of mean 1 at its own quantiles, shuffled by a fixed stride.
    fn noise(count: usize) -> Vec<f32> {
        (0..count)
            .map(|i| -(1.0 - ((i * 997) % count) as f32 / count as f32 - 0.5 / count as f32).ln())
            .collect()
    }

    #[test]
    fn the_noise_floor_is_its_mean_and_noise_is_dark() {
        let mut levels = Levels::default();
        let profile = levels.profile(
            &ping(noise(600)),
            0.04,
            &Backdrop::default(),
            Box::default(),
            &strict(),
        );
        assert!((profile.noise - 1.0).abs() < 0.05, "{}", profile.noise);
        assert!(profile.echoes.is_empty());
        assert_eq!(profile.state.at(24), BinState::Blank);
        assert_eq!(profile.state.at(25), BinState::Dark);
    }

    #[test]
    fn noise_below_the_floor_of_a_pings_decibels_is_at_most_that_and_echoes_above_it_are_heard() {
        let factor = strict().detection_factor;
        for (below, clamped_of_100) in [0.1_f32, 0.3, 0.6, 0.9, 0.99, 0.9999]
            .into_iter()
            .flat_map(|below| [8, 50, 100].map(|share| (below, share)))
        {
            let floor = -(-below).ln_1p();
            let echo = 2.0 * (1.05 * factor).max(ABOVE_FLOOR * floor);
            let mut levels = Levels::default();
            for index in 0..100 {
                let is_clamped = index * 37 % 100 < clamped_of_100;
                let mut power = noise(600);
                power[300..303].fill(echo);
                if is_clamped {
                    power.iter_mut().for_each(|power| *power = power.max(floor));
                }
                let ground = Backdrop::default();
                let heard = levels.profile(&ping(power), 0.04, &ground, Box::default(), &strict());
                let case = format!("{below} below, {clamped_of_100} of 100, {index}");
                assert_eq!(*heard.echoes, [(300, 303)], "{case}");
                let is_hidden = is_clamped && below > 0.25;
                let most = if is_hidden { floor.max(1.1) } else { 1.1 };
                assert!(heard.noise <= most, "{} with {case}", heard.noise);
            }
            // What all pings hide is at most what they show; else it is what the others heard.
            let learnt = levels.noise.unwrap();
            let most = if clamped_of_100 == 100 { 1.8 } else { 1.15 };
            assert!(learnt < most, "{learnt} with {below} below");
        }
    }

    #[test]
    fn an_echo_is_lit_as_wide_as_the_error_and_shadows_what_is_behind() {
        let mut intensity = noise(600);
        intensity[300] = 1000.0;
        intensity[301] = 500.0;
        let profile = Levels::default().profile(
            &ping(intensity),
            0.04,
            &Backdrop::default(),
            Box::default(),
            &strict(),
        );
        assert_eq!(*profile.echoes, [(300, 302)]);
        let state = |bin: usize| profile.state.at(bin);
        assert_eq!((state(297), state(298)), (BinState::Dark, BinState::Lit));
        assert_eq!(
            (state(303), state(304)),
            (BinState::Lit, BinState::Shadowed)
        );
        assert_eq!(
            (state(333), state(334)),
            (BinState::Shadowed, BinState::Dark)
        );
    }

    #[test]
    fn side_lobes_are_told_from_echoes_at_their_range_alone_and_not_for_long() {
        let mut levels = Levels::default();
        let mut echoes = |strong: &[(usize, f32)]| {
            let mut power = noise(600);
            for &(bin, level) in strong {
                power[bin..bin + 3].fill(level);
            }
            let profile = levels.profile(
                &ping(power),
                0.04,
                &Backdrop::default(),
                Box::default(),
                &strict(),
            );
            profile.echoes.to_vec()
        };
        // At 1.2 m, and 40 dB weaker at 1.6 and 8 m.
        assert_eq!(
            echoes(&[(60, 1e6), (80, 100.0), (400, 100.0)]),
            [(60, 63), (400, 403)]
        );
        // The strong one is no longer there.
        assert_eq!(echoes(&[(80, 100.0)]), []);
        for _ in 0..4_000 {
            echoes(&[]);
        }
        assert_eq!(echoes(&[(80, 100.0)]), [(80, 83)]);
    }

    #[test]
    fn what_rings_on_beyond_the_blanking_is_no_echo_and_says_nothing() {
        let judged = |ring_down_bins: usize| {
            let mut intensity = noise(600);
            intensity[25..25 + ring_down_bins].fill(1000.0);
            intensity[27] = 1.0;
            intensity[300] = 1000.0;
            let (ground, config) = (Backdrop::default(), strict());
            Levels::default().profile(&ping(intensity), 0.04, &ground, Box::default(), &config)
        };
        let rings = judged(10);
        assert_eq!(*rings.echoes, [(300, 301)]);
        assert_eq!(
            [30, 36].map(|bin| rings.state.at(bin)),
            [BinState::Blank, BinState::Dark]
        );
        // What goes on for a metre is a surface.
        assert_eq!(judged(50).echoes.len(), 3);
    }

    #[test]
    fn a_ping_full_of_echoes_does_not_raise_the_floor() {
        let mut levels = Levels::default();
        for _ in 0..20 {
            levels.profile(
                &ping(noise(600)),
                0.04,
                &Backdrop::default(),
                Box::default(),
                &strict(),
            );
        }
        let echoes = (0..600).map(|bin| 1000.0 + bin as f32).collect();
        let full = levels.profile(
            &ping(echoes),
            0.04,
            &Backdrop::default(),
            Box::default(),
            &strict(),
        );
        assert_eq!(*full.echoes, [(25, 600)]);
    }

    #[test]
    fn a_receiver_at_its_stop_hears_nothing() {
        let mut levels = Levels::default();
        let mut clipped = noise(600);
        clipped[200..400].fill(1e4);
        for power in [vec![1000.0; 600], clipped] {
            assert!(!levels.hears(&ping(power), 0.5));
        }
        assert!(levels.hears(&ping(noise(600)), 0.5));
        assert!(!levels.hears(&ping(noise(600)), 100.0));
    }

    #[test]
    fn a_glitch_is_not_heard_and_a_new_gain_is_believed_in_the_end() {
        let mut levels = Levels::default();
        let loud = || ping(noise(600).iter().map(|power| 1e8 * power).collect());
        assert!(levels.hears(&ping(noise(600)), 0.5));
        assert!(!levels.hears(&loud(), 0.5));
        assert!(levels.hears(&ping(noise(600)), 0.5));
        let heard: Vec<bool> = (0..9).map(|_| levels.hears(&loud(), 0.5)).collect();
        assert_eq!(heard, [[false; 7].as_slice(), &[true; 2]].concat());
    }

    #[test]
    fn silence_is_dark() {
        let profile = Levels::default().profile(
            &ping(vec![0.0; 600]),
            0.04,
            &Backdrop::default(),
            Box::default(),
            &strict(),
        );
        assert!(profile.echoes.is_empty());
        assert!(profile.noise > 0.0);
    }
}
