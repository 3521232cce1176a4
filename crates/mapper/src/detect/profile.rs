//! A ping's profile as evidence: what is noise, what is echo, and what an echo may hide.

use echosplat_model::Ping;

use crate::MapperConfig;
use crate::detect::bin_state::BinState;
use crate::detect::compact::{Powers, States};
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
    /// Runs of bins that are another sonar's pulses: they say nothing either.
    pub(crate) bursts: Box<[(u32, u32)]>,
    /// Mean power of the noise in this ping.
    pub(crate) noise: f32,
    /// What the seabed sends back, as thought; empty where none is known.
    pub(crate) ground: Powers,
    /// Strongest power of late.
    strongest: f32,
    /// An echo is above this.
    threshold: f32,
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
    /// An echo is above this power.
    pub(crate) fn threshold(&self) -> f32 {
        self.threshold
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
    pub(crate) fn tolerate(&mut self, tolerance_m: f32, bin_length_m: f32) {
        self.widen = widen_bins(tolerance_m.into(), bin_length_m.into());
    }

    /// Has nothing nearer than this say anything from the next [`Levels::renew`] on: the transducer is known to ring there.
    pub(crate) fn ring_until(&mut self, range_m: f64, range_start_m: f64, bin_length_m: f64) {
        self.rings = bins_nearer(range_m, range_start_m, bin_length_m);
    }

    /// Tells echoes from noise and from the seabed, and passes over what is doubted.
    pub(crate) fn judge(&mut self, intensity: &[f32], ground: &Backdrop) {
        let count = intensity.len();
        let raised = |bin: usize| {
            let ground = ground.most.get(bin).copied().unwrap_or(0.0);
            self.threshold.max(GROUND_FACTOR * ground)
        };
        let doubted = || self.doubted.iter().chain(&self.bursts);
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
        let dull = self.threshold.powf(DULL_SHARE) * self.strongest.powf(1.0 - DULL_SHARE);
        for (bin, state) in states.iter_mut().enumerate() {
            let level = raised(bin);
            if *state == BinState::Dark && level > self.threshold && level > dull {
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

/// A bin stands out from the seabed above this many times its power.
const GROUND_FACTOR: f32 = 5.0;
/// Where a threshold leaves less than this share of the decibels up to the strongest echo, darkness
/// says little.
const DULL_SHARE: f32 = 0.35;
/// Bins without the seabed that tell noise.
const LEAST_QUIET_BINS: usize = 48;

/// Darkness this far behind an echo is weak evidence: a structure's own thickness and its shadow.
const SHADOW_LENGTH_M: f64 = 0.6;

/// Where noise is low the transducer is heard to ring for so long beyond the blanking: it falls by 10 dB in 0.1 m or
/// faster, and ends 0.35 to 0.5 m away where real units had their noise.
pub(crate) const RING_DOWN_M: f64 = 0.5;
/// Bins that speckle may make dark in it, one after the other.
const RING_DOWN_GAP: usize = 3;

/// What is learnt of the noise and the strongest echo as pings come in.
#[derive(Debug, Clone, Default)]
pub(crate) struct Levels {
    noise: Option<f32>,
    strongest: f32,
    /// The same of all pings heard, echoes or not.
    loudest: f32,
    /// Pings in a row that were too loud to be believed.
    wild: u32,
    ringing: Ringing,
}

/// No echo is so many times the strongest before it; unless so many pings in a row say so.
const WILD: f32 = 1e6;
const BELIEVED_AFTER: u32 = 8;

impl Levels {
    /// Of a unit that is known to ring.
    pub(crate) fn ringing(ringing: Ringing) -> Self {
        Self {
            ringing,
            ..Self::default()
        }
    }

    /// The strongest power of late.
    pub(crate) fn strongest(&self) -> f32 {
        self.strongest
    }

    /// Turns a ping into evidence and learns from it. `tolerance_m` widens the echoes; `ground` is
    /// what the seabed sends back, empty where none is known; `bursts` are no echoes.
    pub(crate) fn profile(
        &mut self,
        ping: &Ping,
        tolerance_m: f64,
        ground: &Backdrop,
        bursts: Box<[(u32, u32)]>,
        config: &MapperConfig,
    ) -> Profile {
        let bin_length_m = ping.settings().bin_length_m();
        let mut profile = Profile {
            intensity: Powers::default(),
            state: States::default(),
            echoes: Box::default(),
            doubted: Box::default(),
            bursts,
            noise: 0.0,
            strongest: 0.0,
            threshold: 0.0,
            blank: blank_bins(ping, config.blanking_m),
            widen: widen_bins(tolerance_m, bin_length_m),
            shadow: (SHADOW_LENGTH_M / bin_length_m) as usize,
            most_ring_down: (RING_DOWN_M / bin_length_m) as usize,
            rings: 0,
            ground: Powers::default(),
        };
        let settings = ping.settings();
        let rings_until_m = self.ringing.until_m(settings.gain_index);
        profile.ring_until(rings_until_m, settings.range_start_m, bin_length_m);
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
        let noise = self.learn_noise(open, ground.most.get(blank..).unwrap_or_default());
        let of_echoes = greatest_without(intensity, blank, &profile.bursts);
        if of_echoes > config.detection_factor * noise {
            self.strongest = risen(self.strongest, of_echoes);
        }
        let floor = self.strongest * 10f32.powf(-0.1 * config.dynamic_range_db);
        profile.intensity = Powers::of(intensity, peak);
        profile.noise = noise;
        profile.strongest = self.strongest;
        profile.threshold = (config.detection_factor * noise).max(floor);
        profile.doubted = Box::default();
        profile.judge(intensity, ground);
    }

    /// Whether a ping is evidence of anything: its receiver is not at its stop, and it is not louder
    /// than can be, a glitch and not a glint. Nothing else is learnt of one that is not.
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

    /// Mean power of the noise. A ping full of echoes is held to what pings before it showed.
    fn learn_noise(&mut self, open: &[f32], ground: &[f32]) -> f32 {
        let mut sorted = open.to_vec();
        if let Some(before) = self.noise.filter(|_| !ground.is_empty()) {
            let bins = open.iter().zip(ground);
            let quiet = bins.filter(|&(_, &ground)| ground < 0.3 * before);
            sorted = quiet.map(|(&power, _)| power).collect();
            if sorted.len() < LEAST_QUIET_BINS {
                return before;
            }
        }
        if sorted.is_empty() {
            return self.noise.unwrap_or(0.0);
        }
        let here = mean_of_noise(&mut sorted);
        let before = self.noise.unwrap_or(here);
        // The floor sinks fast and rises slowly: gain steps are a few decibels, echoes many.
        let now = if here < before {
            0.5 * (before + here)
        } else {
            before + 0.05 * (here.min(4.0 * before) - before)
        };
        self.noise = Some(now.max(f32::MIN_POSITIVE));
        here.min(4.0 * now).max(f32::MIN_POSITIVE)
    }
}

/// Mean power of exponentially distributed noise from the lower quartile of bins that are mostly noise:
/// `q₁/₄ = −ln(3/4)·mean`. Sorts them; 0 of none.
pub(crate) fn mean_of_noise(powers: &mut [f32]) -> f32 {
    const QUARTILE_OVER_MEAN: f32 = 0.287_682;
    let quarter = powers.len() / 4;
    if powers.is_empty() {
        return 0.0;
    }
    *powers.select_nth_unstable_by(quarter, f32::total_cmp).1 / QUARTILE_OVER_MEAN
}

/// Rises at once and falls slowly, so that one glint does not hide what follows.
fn risen(strongest: f32, peak: f32) -> f32 {
    peak.max(strongest * 0.9995)
}

/// The greatest power; 0 of none.
pub(crate) fn greatest(powers: &[f32]) -> f32 {
    powers.iter().copied().fold(0.0, f32::max)
}

/// The greatest power from bin `blank` on, without some runs of bins in growing order.
fn greatest_without(powers: &[f32], blank: usize, runs: &[(u32, u32)]) -> f32 {
    let (mut most, mut from) = (0.0_f32, blank);
    for &(start, end) in runs {
        most = most.max(greatest(&powers[from.min(start as usize)..start as usize]));
        from = end as usize;
    }
    most.max(greatest(&powers[from..]))
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
