//! Pulses of another sonar that pings at nearly the same rate: they walk through the ranges, ping after ping.
//!
//! Whenever the beam comes back to where it was, what stays in its place is at its range again, but for what the vehicle
//! moved. A pulse goes on, evenly and at one power, for as long as it crosses the range that is listened to, and all its
//! walks are at one rate: that is learnt from long ways in which a beam came back, and what then goes at that rate for a
//! short one is no echo.
//!
//! Deliberately absent: walkers as slow as the vehicle moves along its beam, what comes before the first long way, and the
//! first pings of each walk.
//!
//! Cost: at most 24 peaks of a ping against 24 of an earlier one, and 24 pings for each two that are alike.

use std::collections::VecDeque;

use echosplat_measurement::PingGeometry;

use crate::detect::profile::Profile;

/// Pings that teach a rate; found.
/// Pings of a way that teaches a rate, and of one that tells a pulse; of each as many as the latter are asked.
const LONG: usize = 9 * SHORT;
/// Pings that tell a pulse; found.
const SHORT: usize = 24;
/// Pulses before a rate is known; found.
/// Pulses that have to go at a rate before it is known, and rates that are kept.
const LEAST_TAUGHT: u32 = 24;
/// Rates kept; bounds work.
const MOST_RATES: usize = 8;
/// Pings, found: 30 %.
/// Of those asked that may miss the pulse, which is not told where it falls into a stronger echo: 30 %.
const MOST_MISSED: usize = 7;
/// Tolerances; found.
/// Where echoes are dense some lie on any way: a pulse has twice as many as ways beside it, nearer and further by so many
/// times the tolerance.
const BESIDE: f32 = 4.0;
/// Ratio of power, physics: without speckle, 3 dB.
/// A pulse comes straight and has no speckle: its power stays within 3 dB.
const MOST_CHANGE: f32 = 2.0;
/// Bins, derived: a pulse's length.
/// A pulse is some bins long and has its peak anywhere in them.
const TOLERANCE_BINS: f32 = 3.0;
/// Fraction of its peak, found: 9 dB.
/// A pulse goes on where power is at least this fraction of its peak: 9 dB.
const PULSE_FRACTION: f32 = 0.125;
/// Strongest peaks of a ping asked; bounds work.
const MOST_ASKED: usize = 24;

/// The peaks of one ping.
#[derive(Debug)]
struct Heard {
    geometry: PingGeometry,
    /// Range, metres, and power.
    peaks: Vec<(f32, f32)>,
}

/// At which pulses walk.
#[derive(Debug)]
struct Rate {
    walk_m: f32,
    taught: u32,
}

/// Remembers the pings before, newest first, and the rates, metres a ping.
#[derive(Debug, Default)]
pub(crate) struct Walkers {
    before: VecDeque<Heard>,
    rates: Vec<Rate>,
}

impl Walkers {
    /// Runs of bins of a ping, half-open, that are a walking pulse; all its echoes have to be in the profile.
    pub(crate) fn runs(
        &mut self,
        geometry: &PingGeometry,
        intensity: &[f32],
        profile: &Profile,
    ) -> Vec<(u32, u32)> {
        let mut bins = profile.peaks(intensity, 0.0);
        bins.sort_by(|&a, &b| intensity[b].total_cmp(&intensity[a]));
        bins.truncate(MOST_ASKED);
        bins.sort_unstable();
        let range_m =
            |bin: usize| geometry.range_start_m + (bin as f32 + 0.5) * geometry.bin_length_m;
        let peaks: Vec<(f32, f32)> = bins.iter().map(|&b| (range_m(b), intensity[b])).collect();
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for (&bin, &peak) in bins.iter().zip(&peaks) {
            self.learn(geometry, peak);
            if self.is_pulse(geometry, peak) {
                let (start, end) = pulse(intensity, profile.first_bin(), bin);
                match runs.last_mut() {
                    Some(last) if last.1 >= start => last.1 = last.1.max(end),
                    _ => runs.push((start, end)),
                }
            }
        }
        self.before.push_front(Heard {
            geometry: *geometry,
            peaks,
        });
        self.before.truncate(LONG);
        runs
    }

    /// Whether a peak has gone a short way at a known rate.
    fn is_pulse(&self, geometry: &PingGeometry, peak: (f32, f32)) -> bool {
        let mut known = self.rates.iter().filter(|rate| rate.taught >= LEAST_TAUGHT);
        known.any(|rate| self.went(geometry, peak, rate.walk_m, SHORT))
    }

    /// Learns the rates of all long ways that end at a peak.
    fn learn(&mut self, geometry: &PingGeometry, (range_m, power): (f32, f32)) {
        let Some(first) = self.before.get(LONG - 1) else {
            return;
        };
        let least_m = TOLERANCE_BINS * geometry.bin_length_m;
        let starts = first
            .peaks
            .iter()
            .filter(|(then_m, then)| is_alike(*then, power) && (range_m - then_m).abs() > least_m);
        let walks = starts.map(|(then_m, _)| (range_m - then_m) / LONG as f32);
        let long: Vec<f32> = walks
            .filter(|&walk_m| {
                self.went(geometry, (range_m, power), walk_m, LONG)
                    && self.is_no_place(geometry, walk_m)
            })
            .collect();
        let tolerance_m = TOLERANCE_BINS * geometry.bin_length_m / LONG as f32;
        for walk_m in long {
            let alike = |rate: &&mut Rate| (rate.walk_m - walk_m).abs() <= 2.0 * tolerance_m;
            if let Some(rate) = self.rates.iter_mut().find(alike) {
                rate.taught = rate.taught.saturating_add(1);
                rate.walk_m += (walk_m - rate.walk_m) / rate.taught.min(1000) as f32;
                continue;
            }
            self.rates
                .sort_by_key(|rate| std::cmp::Reverse(rate.taught));
            self.rates.truncate(MOST_RATES - 1);
            self.rates.push(Rate { walk_m, taught: 1 });
        }
    }

    /// Whether a peak came here by so many metres a ping over the last so many pings.
    fn went(
        &self,
        geometry: &PingGeometry,
        (range_m, power): (f32, f32),
        walk_m: f32,
        pings: usize,
    ) -> bool {
        let tolerance_m = TOLERANCE_BINS * geometry.bin_length_m;
        let hears = |off_m: f32, back: usize| {
            let expected_m = range_m + off_m - back as f32 * walk_m;
            self.before.get(back - 1).is_some_and(|past| {
                let mut peaks = past.peaks.iter();
                peaks.any(|&(at_m, then)| {
                    (at_m - expected_m).abs() <= tolerance_m && is_alike(then, power)
                })
            })
        };
        let asked = || (1..=SHORT).map(|step| step * (pings / SHORT));
        let mut missed = asked().filter(|&back| !hears(0.0, back));
        if missed.nth(MOST_MISSED).is_some() {
            return false;
        }
        let heard = |off_m| asked().filter(|&back| hears(off_m, back)).count();
        let beside_m = BESIDE * tolerance_m;
        heard(-beside_m) + heard(beside_m) <= heard(0.0)
    }

    /// Whether two pings on a long way had one beam, and so would have heard what stays in its place at one range, but for
    /// what the vehicle moved: an edge that the beam sweeps along comes back with it.
    fn is_no_place(&self, geometry: &PingGeometry, walk_m: f32) -> bool {
        let tolerance_m = TOLERANCE_BINS * geometry.bin_length_m;
        let way = (1..=SHORT).map(|step| step * (LONG / SHORT));
        let asked: Vec<(usize, &PingGeometry)> = std::iter::once((0, geometry))
            .chain(way.filter_map(|back| Some((back, &self.before.get(back - 1)?.geometry))))
            .collect();
        asked.iter().enumerate().any(|(index, &(back, now))| {
            let mut earlier = asked[index + 1..].iter();
            earlier.any(|&(further, then)| {
                let walked_m = walk_m.abs() * (further - back) as f32;
                is_one_beam(then, now) && walked_m > most_change_m(then, now) + tolerance_m
            })
        })
    }
}

/// Whether two beams are at most half their width apart across.
fn is_one_beam(then: &PingGeometry, now: &PingGeometry) -> bool {
    let (then_axes, axes) = (&then.pose.axes, &now.pose.axes);
    let aside = axes.x_axis.dot(then_axes.y_axis).abs();
    let half_rad = (0.5 * now.beam.azimuth_width_deg).to_radians();
    aside <= half_rad && axes.x_axis.dot(then_axes.x_axis) > 0.0
}

fn is_alike(a: f32, b: f32) -> bool {
    a < MOST_CHANGE * b && b < MOST_CHANGE * a
}

/// The most that the range of a fixed place in the beam changed between two pings, metres: what the vehicle moved
/// along the directions of the beam.
fn most_change_m(then: &PingGeometry, now: &PingGeometry) -> f32 {
    let moved_m = now.pose.position_m - then.pose.position_m;
    let axes = &now.pose.axes;
    let aside = (0.5 * now.beam.azimuth_width_deg).to_radians().sin();
    let above = (0.5 * now.beam.elevation_width_deg).to_radians().sin();
    moved_m.dot(axes.x_axis).abs()
        + aside * moved_m.dot(axes.y_axis).abs()
        + above * moved_m.dot(axes.z_axis).abs()
}

/// The pulse around its peak, and a bin on each side.
fn pulse(intensity: &[f32], blank: usize, peak: usize) -> (u32, u32) {
    let goes_on = |&bin: &usize| intensity[bin] >= PULSE_FRACTION * intensity[peak];
    let start = (blank..=peak).rev().take_while(goes_on).last();
    let end = (peak..intensity.len()).take_while(goes_on).last();
    let start = start.unwrap_or(peak).saturating_sub(1).max(blank);
    let end = (end.unwrap_or(peak) + 2).min(intensity.len());
    (start as u32, end as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::heard::heard;

    const FIRST_M: f32 = 3.0;
    const STEP_M: f32 = 0.015;

    /// Of each of 300 pings, how many bins are a walking pulse: beside a wall at 2 m there is an echo of the power and at
    /// the range given for the ping, and the vehicle moves so many metres ahead between two pings.
    fn told(echo: impl Fn(usize) -> (f32, f32), move_m: f32) -> Vec<u32> {
        let mut walkers = Walkers::default();
        let ping = |ping: usize| {
            let (range_m, power) = echo(ping);
            let (mut geometry, intensity, profile, _) =
                heard(0.0, &[(2.0, 1e4), (range_m.into(), power)]);
            geometry.pose.position_m.x = ping as f32 * move_m;
            let runs = walkers.runs(&geometry, &intensity, &profile);
            let at = (range_m / geometry.bin_length_m) as u32;
            assert!(runs.iter().all(|&(start, end)| start <= at && at < end));
            runs.iter().map(|(start, end)| end - start).sum()
        };
        (0..300).map(ping).collect()
    }

    fn walk_m(ping: usize) -> f32 {
        FIRST_M + ping as f32 * STEP_M
    }

    #[test]
    fn a_pulse_that_walks_is_told_once_its_rate_is_known() {
        let told = told(|ping| (walk_m(ping), 1e3), 0.0);
        let first = LONG + LEAST_TAUGHT as usize;
        assert!(told[..LONG].iter().all(|&bins| bins == 0));
        assert!(
            told[first..].iter().all(|bins| (3..=6).contains(bins)),
            "{told:?}"
        );
    }

    #[test]
    fn what_stays_or_comes_nearer_as_the_vehicle_moves_is_no_pulse() {
        assert!(told(|_| (FIRST_M, 1e3), 0.0).iter().all(|&bins| bins == 0));
        let nearer = |ping| (walk_m(300 - ping), 1e3);
        assert!(told(nearer, STEP_M).iter().all(|&bins| bins == 0));
    }

    #[test]
    fn an_echo_that_fades_and_comes_is_no_pulse() {
        let speckled = |ping: usize| (walk_m(ping), [3e2, 1e3, 3e3][ping * 7 % 3]);
        assert!(told(speckled, 0.0).iter().all(|&bins| bins == 0));
    }
}
