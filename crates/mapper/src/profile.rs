//! A ping's profile as evidence: what is noise, what is echo, and what an echo may hide.

use echosplat_model::Ping;

use crate::MapperConfig;
use crate::compact::{Powers, States};

/// What one bin says of the places at its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum BinState {
    /// Inside the blanking, or outside the ping: nothing.
    Blank = 0,
    /// Looked at and nothing there.
    Dark = 1,
    /// An echo here or within the localisation error.
    Lit = 2,
    /// Dark, but behind an echo that may have hidden it.
    Shadowed = 3,
}

impl BinState {
    /// Of the lower two bits.
    pub(crate) fn of_bits(bits: u8) -> Self {
        match bits & 3 {
            0 => Self::Blank,
            1 => Self::Dark,
            2 => Self::Lit,
            _ => Self::Shadowed,
        }
    }
}

/// One ping's intensities and what they say, shapes `[bin_count]`.
#[derive(Debug, Clone)]
pub(crate) struct Profile {
    /// Linear power as the ping has it.
    pub(crate) intensity: Powers,
    /// What each bin says, echoes widened by the localisation error.
    pub(crate) state: States,
    /// Runs of bins above the threshold, half-open, not widened.
    pub(crate) echoes: Box<[(u32, u32)]>,
    /// Mean power of the noise in this ping.
    pub(crate) noise: f32,
}

/// Darkness this far behind an echo is weak evidence: a structure's own thickness and its shadow.
const SHADOW_LENGTH_M: f64 = 0.6;

/// What is learnt of the noise and the strongest echo as pings come in.
#[derive(Debug, Clone, Default)]
pub(crate) struct Levels {
    noise: Option<f32>,
    strongest: f32,
}

impl Levels {
    /// The strongest power of late.
    pub(crate) fn strongest(&self) -> f32 {
        self.strongest
    }

    /// Turns a ping into evidence and learns from it. `tolerance_m` widens the echoes.
    pub(crate) fn profile(
        &mut self,
        ping: &Ping,
        tolerance_m: f64,
        config: &MapperConfig,
    ) -> Profile {
        let settings = ping.settings();
        let bin_length_m = settings.bin_length_m();
        let blank = blank_bins(ping, config.blanking_m);
        let open = &ping.intensity()[blank..];
        if is_clipped(open) {
            return self.deaf(ping);
        }
        let noise = self.learn_noise(open);
        let peak = open.iter().copied().fold(0.0, f32::max);
        if peak > config.detection_factor * noise {
            // Rises at once and falls slowly, so that one glint does not hide what follows.
            self.strongest = peak.max(self.strongest * 0.9995);
        }
        let floor = self.strongest * 10f32.powf(-0.1 * config.dynamic_range_db);
        let threshold = (config.detection_factor * noise).max(floor);
        let echoes = runs_above(ping.intensity(), blank, threshold);
        let widen = (tolerance_m / bin_length_m).ceil() as usize;
        let shadow = (SHADOW_LENGTH_M / bin_length_m) as usize;
        Profile {
            intensity: Powers::of(ping.intensity()),
            state: states(settings.bin_count, blank, &echoes, widen, shadow),
            echoes: echoes.into(),
            noise,
        }
    }

    /// A ping that is no evidence of anything, and from which nothing is learnt.
    fn deaf(&self, ping: &Ping) -> Profile {
        Profile {
            intensity: Powers::of(ping.intensity()),
            state: States::of(&vec![BinState::Blank; ping.settings().bin_count]),
            echoes: Box::default(),
            noise: self.noise.unwrap_or(f32::MIN_POSITIVE),
        }
    }

    /// Mean noise power of exponentially distributed noise from the lower quartile of the bins:
    /// `q₁/₄ = −ln(3/4)·mean`. A ping full of echoes is held to what pings before it showed.
    fn learn_noise(&mut self, open: &[f32]) -> f32 {
        const QUARTILE_OVER_MEAN: f32 = 0.287_682;
        if open.is_empty() {
            return self.noise.unwrap_or(0.0);
        }
        let mut sorted = open.to_vec();
        let quarter = sorted.len() / 4;
        let (_, &mut quartile, _) = sorted.select_nth_unstable_by(quarter, f32::total_cmp);
        let here = quartile / QUARTILE_OVER_MEAN;
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

/// Whether a quarter of the bins or more hold the very same largest power: a receiver at its stop,
/// or a scale without a span. Silence is not: there is nothing to be heard.
fn is_clipped(open: &[f32]) -> bool {
    let peak = open.iter().copied().fold(0.0, f32::max);
    let at_peak = open.iter().filter(|&&power| power >= peak).count();
    peak > 0.0 && open.len() > 1 && 4 * at_peak >= open.len()
}

/// Bins that begin nearer than the blanking.
fn blank_bins(ping: &Ping, blanking_m: f64) -> usize {
    let settings = ping.settings();
    let bins = (blanking_m - settings.range_start_m) / settings.bin_length_m();
    (bins.ceil().max(0.0) as usize).min(settings.bin_count)
}

fn runs_above(intensity: &[f32], from: usize, threshold: f32) -> Vec<(u32, u32)> {
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for (bin, &power) in intensity.iter().enumerate().skip(from) {
        if !(power > threshold) {
            continue;
        }
        match runs.last_mut() {
            Some((_, end)) if *end as usize == bin => *end += 1,
            _ => runs.push((bin as u32, bin as u32 + 1)),
        }
    }
    runs
}

fn states(
    bin_count: usize,
    blank: usize,
    echoes: &[(u32, u32)],
    widen: usize,
    shadow: usize,
) -> States {
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
    States::of(&states)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::{PingSettings, Timestamp};

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
        let profile = levels.profile(&ping(noise(600)), 0.04, &MapperConfig::default());
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
        let profile = Levels::default().profile(&ping(intensity), 0.04, &MapperConfig::default());
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
    fn a_ping_full_of_echoes_does_not_raise_the_floor() {
        let mut levels = Levels::default();
        for _ in 0..20 {
            levels.profile(&ping(noise(600)), 0.04, &MapperConfig::default());
        }
        let echoes = (0..600).map(|bin| 1000.0 + bin as f32).collect();
        let full = levels.profile(&ping(echoes), 0.04, &MapperConfig::default());
        assert_eq!(*full.echoes, [(25, 600)]);
    }

    #[test]
    fn a_receiver_at_its_stop_hears_nothing() {
        let mut levels = Levels::default();
        levels.profile(&ping(noise(600)), 0.04, &MapperConfig::default());
        let mut clipped = noise(600);
        clipped[200..400].fill(1e4);
        for power in [vec![1000.0; 600], clipped] {
            let profile = levels.profile(&ping(power), 0.04, &MapperConfig::default());
            assert!(profile.echoes.is_empty());
            assert!(profile.state.iter().all(|state| state == BinState::Blank));
            assert!(profile.noise < 2.0);
        }
        assert!(levels.strongest() < 100.0);
    }

    #[test]
    fn silence_is_dark() {
        let profile =
            Levels::default().profile(&ping(vec![0.0; 600]), 0.04, &MapperConfig::default());
        assert!(profile.echoes.is_empty());
        assert!(profile.noise > 0.0);
    }
}
