//! Echoes of the vehicle itself, as of a gripper or a frame in the fan: what begins at one range and stays as loud, while
//! the vehicle moves in all three directions. Whatever stands in the water would come nearer or go away: a wall that began at
//! that range in all these pings would keep the vehicle in a plane.
//!
//! Deliberately absent: what swings, as a tether, and parts of a vehicle that has not moved yet.
//!
//! Cost: one logarithm for each bin of a ping, and 64 pings later a pass over all bins.

use echosplat_model::PingSettings;
use echosplat_model::glam::{DMat3, DVec3};

/// Ratio of power, derived: speckle rises so once in 35.
/// An echo begins where power rises by so much, 6 dB, over each of the three bins that end two before it. Noise, speckle and
/// surfaces without end do so once in 35 bins: 6/(5·6·7).
const RISE: f32 = 4.0;
/// Bins, derived: pulses have two.
const BEFORE: usize = 4;
/// Pings, found: a second.
/// Pings after which parts are told anew, and what is left then of what pings before told: a mean of 2,048 pings.
const GROUP: u32 = 64;
/// Fraction left, found: 2,048 pings' mean.
const LEFT: f64 = 0.969;
/// Pings as they are left, found: the first 320.
/// Fewest pings that tell a part, as they are left: the first 320.
const LEAST_PINGS: f64 = 256.0;
/// Fraction of pings, derived: water scatters to an eighth.
/// Share of the pings in which a part begins at its bin, to be found and to be kept. Where the vehicle moves by
/// [`LEAST_SCATTER_BINS`] or more, what stands in the water begins in one bin an eighth of the time.
const FOUND_SHARE: f64 = 0.6;
/// Fraction of pings once known, found: half.
const KEPT_SHARE: f64 = 0.3;
/// Bins, derived: water leaves its bin.
/// One sigma, in the direction of least, of the places from where it was heard: bins, and metres. Poses scatter by centimetres.
const LEAST_SCATTER_BINS: f64 = 3.0;
/// Metres, found: poses scatter by centimetres.
const LEAST_SCATTER_M: f64 = 0.05;
/// Variance of log power, found: 2 dB.
/// Variance of the log of a power that has no speckle, 2 dB, and half of that which one look's speckle and noise have, π²/6.
const STEADY: f64 = 0.21;
/// Variance of log power, derived: half of π²/6.
const SPECKLED: f64 = 0.82;
/// Metres of a part; found.
const LONGEST_M: f64 = 0.5;

/// What pings so far tell of the vehicle's own parts.
#[derive(Debug, Default)]
pub(crate) struct OwnVehicle {
    parts: Vec<Part>,
    heard: Option<Heard>,
}

/// Ranges that a part is heard at, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Part {
    near_m: f64,
    far_m: f64,
}

impl OwnVehicle {
    /// Learns from a ping at the reference's gain, heard from `position_m`; bins below `blank` tell nothing. Whether there
    /// is a part that was not known.
    pub(crate) fn learn(
        &mut self,
        settings: &PingSettings,
        intensity: &[f32],
        position_m: DVec3,
        blank: usize,
    ) -> bool {
        let heard = self.heard.take();
        let heard = heard.filter(|heard| heard.is_of(settings));
        let mut heard = heard.unwrap_or_else(|| Heard::new(settings, position_m));
        heard.add(intensity, position_m, blank);
        let is_told = heard.pings_of_group == 0 && heard.pings >= LEAST_PINGS;
        let parts = is_told.then(|| heard.parts(&self.parts));
        self.heard = Some(heard);
        let Some(parts) = parts else { return false };
        let is_new = |part: &Part| !self.parts.iter().any(|known| known.overlaps(part));
        let is_news = parts.iter().any(is_new);
        self.parts = parts;
        is_news
    }

    /// Range at which the nearest part begins, metres.
    pub(crate) fn nearest_m(&self) -> Option<f64> {
        self.parts.first().map(|part| part.near_m)
    }

    /// Runs of bins, half-open and ascending, that parts are heard in.
    pub(crate) fn runs(&self, start_m: f64, length_m: f64, bin_count: usize) -> Vec<(u32, u32)> {
        let runs = self.parts.iter().map(|part| {
            let bin = |range_m: f64| ((range_m - start_m) / length_m).max(0.0);
            let (start, end) = (bin(part.near_m).round(), bin(part.far_m).round());
            (
                (start as usize).min(bin_count) as u32,
                (end as usize).min(bin_count) as u32,
            )
        });
        runs.filter(|(start, end)| start < end).collect()
    }

    /// The same, of parts that begin in this very ping: the others may not have been there yet.
    pub(crate) fn runs_in(
        &self,
        start_m: f64,
        length_m: f64,
        intensity: &[f32],
    ) -> Vec<(u32, u32)> {
        let mut runs = self.runs(start_m, length_m, intensity.len());
        runs.retain(|&(start, _)| {
            let first = start as usize;
            (first..first + 3).any(|bin| begins_at(intensity, bin, 0))
        });
        runs
    }
}

impl Part {
    fn overlaps(&self, other: &Self) -> bool {
        self.near_m < other.far_m && other.near_m < self.far_m
    }
}

/// What pings of one setting told.
#[derive(Debug)]
struct Heard {
    start_m: f64,
    length_m: f64,
    /// Positions are over that of the first ping.
    origin_m: DVec3,
    pings: f64,
    pings_of_group: u32,
    /// Shape `[bin_count]`.
    bins: Vec<Bin>,
}

/// What they told of a bin, each ping `LEFT` for each group that came since.
#[derive(Debug, Clone, Copy, Default)]
struct Bin {
    log_sum: f64,
    log_square_sum: f64,
    /// Pings in which an echo begins here, and from where they were heard.
    begins: f64,
    position_sum: DVec3,
    outer_sum: DMat3,
}

impl Heard {
    fn new(settings: &PingSettings, position_m: DVec3) -> Self {
        Self {
            start_m: settings.range_start_m,
            length_m: settings.bin_length_m(),
            origin_m: position_m,
            pings: 0.0,
            pings_of_group: 0,
            bins: vec![Bin::default(); settings.bin_count],
        }
    }

    fn is_of(&self, settings: &PingSettings) -> bool {
        let is_same = |a: f64, b: f64| (a - b).abs() < 0.01 * self.length_m;
        let end_m = self.start_m + self.length_m * self.bins.len() as f64;
        self.bins.len() == settings.bin_count
            && is_same(self.start_m, settings.range_start_m)
            && is_same(end_m, settings.range_end_m())
    }

    fn add(&mut self, intensity: &[f32], position_m: DVec3, blank: usize) {
        let at_m = position_m - self.origin_m;
        let outer = outer(at_m);
        for (index, bin) in self.bins.iter_mut().enumerate().skip(blank) {
            let log = f64::from(intensity[index].max(f32::MIN_POSITIVE).ln());
            bin.log_sum += log;
            bin.log_square_sum += log * log;
            if begins_at(intensity, index, blank) {
                bin.begins += 1.0;
                bin.position_sum += at_m;
                bin.outer_sum += outer;
            }
        }
        self.pings += 1.0;
        self.pings_of_group = (self.pings_of_group + 1) % GROUP;
        if self.pings_of_group == 0 {
            self.pings *= LEFT;
            self.bins.iter_mut().for_each(Bin::fade);
        }
    }

    /// All parts, nearest first, of which some are `known`.
    fn parts(&self, known: &[Part]) -> Vec<Part> {
        let edge_m = |bin: usize| self.start_m + self.length_m * bin as f64;
        let is_known = |bin: usize| {
            let (near_m, far_m) = (edge_m(bin.saturating_sub(1)), edge_m(bin + 2));
            let begins = |part: &Part| (near_m..=far_m).contains(&(part.near_m + self.length_m));
            known.iter().any(begins)
        };
        let mut parts: Vec<Part> = Vec::new();
        for bin in 0..self.bins.len() {
            let is_part = match is_known(bin) {
                true => self.share(bin) >= KEPT_SHARE,
                false => self.share(bin) >= FOUND_SHARE && self.is_heard_from_all_over(bin),
            };
            if !(is_part && self.is_steady(bin)) {
                continue;
            }
            let part = Part {
                near_m: edge_m(bin.saturating_sub(1)),
                far_m: edge_m(self.end(bin)),
            };
            match parts.last_mut() {
                Some(last) if last.far_m >= part.near_m => last.far_m = last.far_m.max(part.far_m),
                _ => parts.push(part),
            }
        }
        parts
    }

    fn share(&self, bin: usize) -> f64 {
        self.bins[bin].begins / self.pings
    }

    /// Whether what begins in a bin stays as loud: there, or where the pulse is at its height.
    fn is_steady(&self, bin: usize) -> bool {
        let pulse = &self.bins[bin..(bin + 3).min(self.bins.len())];
        pulse
            .iter()
            .any(|bin| bin.log_variance(self.pings) < STEADY)
    }

    fn is_heard_from_all_over(&self, bin: usize) -> bool {
        let least_m = LEAST_SCATTER_M.max(LEAST_SCATTER_BINS * self.length_m);
        self.bins[bin].is_scattered(least_m)
    }

    /// The bin after the last that a part which begins in `bin` is heard in, and one more.
    fn end(&self, bin: usize) -> usize {
        let longest = (LONGEST_M / self.length_m) as usize;
        let bins = self.bins[bin..].iter().take(longest);
        let steady = bins.take_while(|bin| bin.log_variance(self.pings) < SPECKLED);
        (bin + steady.count().max(1) + 1).min(self.bins.len())
    }
}

impl Bin {
    fn fade(&mut self) {
        self.log_sum *= LEFT;
        self.log_square_sum *= LEFT;
        self.begins *= LEFT;
        self.position_sum *= LEFT;
        self.outer_sum *= LEFT;
    }

    fn log_variance(&self, pings: f64) -> f64 {
        let mean = self.log_sum / pings;
        self.log_square_sum / pings - mean * mean
    }

    /// Whether the places from where something was heard to begin here scatter by more than `sigma_m` in every direction: less
    /// that of a ball, their covariance is still positive definite.
    fn is_scattered(&self, sigma_m: f64) -> bool {
        let mean_m = self.position_sum / self.begins;
        let covariance = self.outer_sum * self.begins.recip() - outer(mean_m);
        let rest = covariance - DMat3::from_diagonal(DVec3::splat(sigma_m * sigma_m));
        let of_two = rest.x_axis.x * rest.y_axis.y - rest.x_axis.y * rest.y_axis.x;
        rest.x_axis.x > 0.0 && of_two > 0.0 && rest.determinant() > 0.0
    }
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// Whether an echo begins in a bin.
fn begins_at(intensity: &[f32], bin: usize, blank: usize) -> bool {
    let Some(first) = bin.checked_sub(BEFORE).filter(|&first| first >= blank) else {
        return false;
    };
    let before = intensity.get(first..bin - 1).unwrap_or_default();
    let most = before.iter().copied().fold(0.0, f32::max);
    intensity.get(bin).is_some_and(|&power| power > RISE * most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::heard::posed;
    use echosplat_model::Pose;

    const BINS: usize = 300;
    const BLANK: usize = 25;

    /// Uniform in (0, 1], always the same.
    fn random(state: &mut u64) -> f32 {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        ((*state >> 40) as f32 + 1.0) / (1 << 24) as f32
    }

    /// What is learnt from pings of 2 cm a bin, in noise of mean 1: where each is heard from and its echoes, metres and power.
    fn learnt(pings: u32, of: impl Fn(u32) -> (DVec3, Vec<(f64, f32)>)) -> OwnVehicle {
        let (mut own, mut state) = (OwnVehicle::default(), 0x9e37_79b9_7f4a_7c15);
        for index in 0..pings {
            let (position_m, echoes) = of(index);
            let mut power: Vec<f32> = (0..BINS).map(|_| -random(&mut state).ln()).collect();
            for (range_m, strength) in echoes {
                let bin = (range_m / 0.02) as usize;
                power[bin..bin + 3].fill(strength);
            }
            let posed = posed(index, power, Pose::IDENTITY);
            let ping = &posed.ping;
            own.learn(ping.settings(), ping.intensity(), position_m, BLANK);
        }
        own
    }

    /// A way that goes 0.5 m to and fro ahead, 0.3 m up and down, and on to the left.
    fn way(index: u32) -> DVec3 {
        let t = f64::from(index);
        DVec3::new(0.5 * (t / 40.0).sin(), t / 200.0, 0.3 * (t / 61.0).sin())
    }

    #[test]
    fn what_stands_at_one_range_wherever_the_vehicle_goes_is_its_own_part() {
        let own = learnt(384, |index| (way(index), vec![(1.1, 3000.0), (3.0, 50.0)]));
        let runs = own.runs(0.0, 0.02, BINS);
        assert_eq!(runs.len(), 2, "{runs:?}");
        assert!(
            runs[0].0 <= 55 && runs[0].1 >= 58 && runs[0].1 - runs[0].0 < 8,
            "{runs:?}"
        );
        let nearest_m = own.nearest_m().unwrap();
        assert!((nearest_m - 1.08).abs() < 0.03, "{nearest_m}");
        // In pings of other bins, also those that end before it.
        assert_eq!(own.runs(0.5, 0.01, 40), []);
        assert_eq!(own.runs(0.5, 0.01, 400)[0].0, 2 * runs[0].0 - 50);
    }

    #[test]
    fn what_stands_in_the_water_is_no_part() {
        // A wall ahead; one beside which the vehicle goes straight on; one before which it rests, and then leaves.
        let ahead = learnt(768, |index| {
            (way(index), vec![(2.5 - way(index).x, 3000.0)])
        });
        let along = learnt(768, |index| {
            (way(index) * DVec3::new(0.0, 1.0, 1.0), vec![(2.5, 3000.0)])
        });
        let left = learnt(768, |index| {
            let at_m = way(index.saturating_sub(600));
            (at_m, vec![(2.5 - at_m.x, 3000.0)])
        });
        for own in [ahead, along, left] {
            assert_eq!(own.nearest_m(), None);
        }
    }

    #[test]
    fn speckle_is_of_the_water() {
        let mut state = 7;
        let powers: Vec<f32> = (0..768)
            .map(|_| -3000.0 * random(&mut state).ln())
            .collect();
        let own = learnt(768, |index| {
            (way(index), vec![(1.1, powers[index as usize])])
        });
        assert_eq!(own.nearest_m(), None);
    }

    #[test]
    fn a_part_stays_known_at_rest_and_is_let_go_when_it_is_gone() {
        let part = vec![(1.1, 3000.0)];
        let at_rest = learnt(8000, |index| (way(index.min(400)), part.clone()));
        assert!(at_rest.nearest_m().is_some());
        let gone = learnt(8000, |index| {
            let heard = if index < 400 {
                part.clone()
            } else {
                Vec::new()
            };
            (way(index), heard)
        });
        assert_eq!(gone.nearest_m(), None);
    }

    #[test]
    fn pings_from_before_a_part_was_there_are_left_as_they_are() {
        let own = learnt(384, |index| (way(index), vec![(1.1, 3000.0)]));
        let mut power = vec![1.0; BINS];
        assert_eq!(own.runs_in(0.0, 0.02, &power), []);
        power[55..58].fill(3000.0);
        assert_eq!(own.runs_in(0.0, 0.02, &power), own.runs(0.0, 0.02, BINS));
    }

    #[test]
    fn silence_tells_nothing_and_breaks_nothing() {
        let mut own = OwnVehicle::default();
        for index in 0..300 {
            let posed = posed(index, vec![0.0; BINS], Pose::IDENTITY);
            let ping = &posed.ping;
            assert!(!own.learn(ping.settings(), ping.intensity(), way(index), BLANK));
        }
    }
}
