//! Whether what the sonar says is alive: profiles that repeat, that hold one value, or that change as
//! the view does. On the pings' clock; a few operations a bin.

use echosplat_model::{Ping, Timestamp};
use serde::Serialize;

/// Bands of range that the view is followed in.
const BANDS: usize = 32;
/// Times over which the newest and the former view are averaged, seconds.
const NEWEST_S: f64 = 0.3;
const FORMER_S: f64 = 3.0;
/// The power of one ping scatters by 5.6 dB (it is exponential); the mean of a band's bins over 0.3 s
/// by a tenth of that. What moves further than one ping's scatter is another view.
const CHANGE_DB: f64 = 5.6;
/// The view counts as changing for so long after it was seen to, seconds.
const KEPT_S: f64 = 1.0;

/// What can be said of the newest pings without a map.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct ListeningReport {
    /// For how long profiles have been the same to the last bit, seconds.
    pub(crate) same_s: f64,
    /// For how long profiles have held one value in every bin, seconds.
    pub(crate) flat_s: f64,
    /// Whether echoes come and go, as they do when the sonar moves or turns.
    pub(crate) view_changes: bool,
}

/// Follows the pings.
#[derive(Debug, Default)]
pub(crate) struct Listening {
    before: Vec<f32>,
    newest: Option<Timestamp>,
    same_since: Option<Timestamp>,
    flat_since: Option<Timestamp>,
    changed_at: Option<Timestamp>,
    newest_db: [f64; BANDS],
    former_db: [f64; BANDS],
    report: ListeningReport,
}

impl Listening {
    /// Takes the next ping; one older than the newest says nothing.
    pub(crate) fn take(&mut self, ping: &Ping) {
        let time = ping.transmit_time();
        let step_s = self.newest.map(|newest| time.seconds_since(newest));
        // Late, or the clock stepped far: what was followed is followed anew.
        match step_s {
            Some(step_s) if step_s < 0.0 && step_s > -FORMER_S => return,
            Some(step_s) if (0.0..60.0).contains(&step_s) => self.follow(ping, time, step_s),
            _ => {
                *self = Self::default();
                self.newest_db = bands_db(ping.intensity());
                self.former_db = self.newest_db;
            }
        }
        self.newest = Some(time);
        self.before.clear();
        self.before.extend_from_slice(ping.intensity());
    }

    pub(crate) fn report(&self) -> ListeningReport {
        self.report
    }

    fn follow(&mut self, ping: &Ping, time: Timestamp, step_s: f64) {
        let intensity = ping.intensity();
        let is_same = intensity == self.before.as_slice();
        let is_flat = intensity
            .iter()
            .all(|power| power.to_bits() == intensity[0].to_bits());
        let since = |since: Option<Timestamp>, holds: bool| {
            let began = since.or(self.newest);
            holds.then_some(began).flatten()
        };
        self.same_since = since(self.same_since, is_same);
        self.flat_since = since(self.flat_since, is_flat);
        self.follow_view(&bands_db(intensity), time, step_s);
        let lasted_s = |since: Option<Timestamp>| since.map_or(0.0, |s| time.seconds_since(s));
        self.report = ListeningReport {
            same_s: lasted_s(self.same_since),
            flat_s: lasted_s(self.flat_since),
            view_changes: self
                .changed_at
                .is_some_and(|at| time.seconds_since(at) <= KEPT_S),
        };
    }

    fn follow_view(&mut self, db: &[f64; BANDS], time: Timestamp, step_s: f64) {
        let mut most_db = 0.0_f64;
        for (band, &heard_db) in db.iter().enumerate() {
            approach(&mut self.newest_db[band], heard_db, step_s / NEWEST_S);
            approach(&mut self.former_db[band], heard_db, step_s / FORMER_S);
            most_db = most_db.max((self.newest_db[band] - self.former_db[band]).abs());
        }
        if most_db > CHANGE_DB {
            self.changed_at = Some(time);
        }
    }
}

/// Mean power of each band of range, decibels.
fn bands_db(intensity: &[f32]) -> [f64; BANDS] {
    std::array::from_fn(|band| {
        let edge = |band: usize| band * intensity.len() / BANDS;
        let bins = &intensity[edge(band)..edge(band + 1).max(edge(band) + 1).min(intensity.len())];
        let sum: f64 = bins.iter().map(|&power| f64::from(power)).sum();
        10.0 * (sum / bins.len().max(1) as f64).max(1e-12).log10()
    })
}

fn approach(value: &mut f64, newest: f64, weight: f64) {
    *value += weight.min(1.0) * (newest - *value);
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::PingSettings;

    fn ping(seconds: f64, power: impl Fn(usize) -> f32) -> Ping {
        let settings = PingSettings {
            range_start_m: 0.0,
            range_length_m: 10.0,
            bin_count: 320,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 0.0,
            pulse_duration_s: 0.0,
            gain_index: 0,
        };
        let time = Timestamp::from_secs_f64(seconds);
        Ping::new(0, time, settings, (0..320).map(power).collect()).unwrap()
    }

    fn followed(count: u32, power: impl Fn(u32, usize) -> f32) -> ListeningReport {
        let mut listening = Listening::default();
        for i in 0..count {
            listening.take(&ping(f64::from(i) * 0.025, |bin| power(i, bin)));
        }
        listening.report()
    }

    /// Between 0.5 and 1.5, another at each bin and ping.
    fn noise(i: u32, bin: usize) -> f32 {
        let mixed =
            (i.wrapping_mul(7919) ^ (bin as u32).wrapping_mul(104_729)).wrapping_mul(2_654_435_761);
        0.5 + (mixed >> 8) as f32 / (1 << 24) as f32
    }

    #[test]
    fn noise_alone_is_alive_and_no_change_of_view() {
        let report = followed(400, noise);
        assert_eq!(report, ListeningReport::default());
    }

    #[test]
    fn a_profile_that_repeats_and_one_without_a_feature_show() {
        let same = followed(81, |_, bin| noise(1, bin));
        assert!((same.same_s - 2.0).abs() < 1e-6 && same.flat_s == 0.0);
        let flat = followed(81, |_, _| 3.0);
        assert!((flat.flat_s - 2.0).abs() < 1e-6);
    }

    #[test]
    fn an_echo_that_wanders_is_a_change_of_view() {
        let wandering = followed(200, |i, bin| {
            let at = (i as usize * 2) % 320;
            noise(i, bin) + if bin.abs_diff(at) < 4 { 100.0 } else { 0.0 }
        });
        assert!(wandering.view_changes);
        let resting = followed(200, |i, bin| {
            noise(i, bin) + if bin.abs_diff(100) < 4 { 100.0 } else { 0.0 }
        });
        assert!(!resting.view_changes);
    }
}
