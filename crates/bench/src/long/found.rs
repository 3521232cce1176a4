//! What was read off on the way, tenth by tenth, and whether it is as it must be.

use serde::Serialize;

use echosplat_metrics::nullable;
use echosplat_report::table::percent;

/// Memory is filled and work has found its pace by then.
const SETTLED_S: f64 = 600.0;
/// What the map does not need, at most: a computer of 1 GB runs other things too.
const MOST_REST_MB: f64 = 300.0;
/// A day of diving would add 24 MiB.
const MOST_GROWTH_MIB_PER_H: f64 = 1.0;
/// Most over least processor time per ping, minus 1.
const MOST_SPREAD: f64 = 0.1;
/// How much worse the first structure's map may get.
const MOST_WORSE: f64 = 0.05;
/// A tenth with less of it at structures says what transits cost.
const LEAST_STRUCTURE_SHARE: f64 = 0.9;

/// The state of things when a live map was made.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Reading {
    /// Since the first ping.
    pub(crate) dive_s: f64,
    /// Pings mapped so far.
    pub(crate) pings: u64,
    /// Processor seconds of the mapper's threads so far.
    pub(crate) compute_s: f64,
    /// Of the whole process, now.
    pub(crate) resident_bytes: u64,
    /// Of the Gaussians of this map.
    pub(crate) map_bytes: u64,
    /// Of all maps that are held to be published, this one among them.
    pub(crate) published_bytes: u64,
    /// In this map.
    pub(crate) gaussians: usize,
}

/// What a tenth of the dive came to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Tenth {
    /// Its end, since the first ping.
    pub(crate) end_s: f64,
    /// Mapped in it.
    pub(crate) pings: u64,
    /// Processor seconds per ping.
    pub(crate) compute_per_ping_s: f64,
    /// Of the whole process at its end.
    pub(crate) resident_bytes: u64,
    /// Of the map at its end.
    pub(crate) map_bytes: u64,
    /// Without maps that are held to be published, and without what the process held before the first
    /// ping.
    pub(crate) rest_bytes: u64,
    /// In the map at its end.
    pub(crate) gaussians: usize,
    /// Share of it that was spent at structures, 0 to 1.
    pub(crate) structure_share: f64,
}

/// Chamfer distances of what is mapped of the first structure, metres; infinite where nothing is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Errors {
    /// Live, when it is left for the first time.
    #[serde(with = "nullable")]
    pub(crate) first_visit_m: f64,
    /// Live, in the middle of the dive.
    #[serde(with = "nullable")]
    pub(crate) half_m: f64,
    /// Live, at the end.
    #[serde(with = "nullable")]
    pub(crate) end_m: f64,
    /// Of the finished map.
    #[serde(with = "nullable")]
    pub(crate) finished_m: f64,
}

/// All that is known of a dive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Found {
    /// In order.
    pub(crate) tenths: Vec<Tenth>,
    /// Of the first structure.
    pub(crate) errors: Errors,
    /// What the process held before the first ping: scenes and surveys.
    pub(crate) before_bytes: u64,
}

/// A target, and whether it is met.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Asked {
    /// What is asked for.
    pub(crate) quantity: &'static str,
    /// What must be.
    pub(crate) must: String,
    /// What was reached.
    pub(crate) reached: String,
    /// `None` where the dive was too short to say.
    pub(crate) is_met: Option<bool>,
}

impl Found {
    /// Of the readings at the ends of the tenths, in order.
    #[must_use]
    pub(crate) fn new(
        readings: &[Reading],
        stays_s: &[(f64, f64)],
        before_bytes: u64,
        errors: Errors,
    ) -> Self {
        let begin = Reading::default();
        let before = [begin].into_iter().chain(readings.iter().copied());
        let tenth = |(from, to): (Reading, &Reading)| {
            let pings = to.pings - from.pings;
            let rest = to.resident_bytes.saturating_sub(to.published_bytes);
            Tenth {
                end_s: to.dive_s,
                pings,
                compute_per_ping_s: (to.compute_s - from.compute_s) / pings as f64,
                resident_bytes: to.resident_bytes,
                map_bytes: to.map_bytes,
                rest_bytes: rest.saturating_sub(before_bytes),
                gaussians: to.gaussians,
                structure_share: share_within(stays_s, from.dive_s, to.dive_s),
            }
        };
        Self {
            tenths: before.zip(readings).map(tenth).collect(),
            errors,
            before_bytes,
        }
    }

    /// Every target.
    #[must_use]
    pub(crate) fn asked(&self) -> Vec<Asked> {
        let most_mb = self.most_rest_mb();
        let growth = self.growth_mib_per_h();
        let spread = self.compute_spread();
        let worse = self.errors.worse();
        vec![
            Asked {
                quantity: "memory less the published map, most",
                must: format!("≤ {MOST_REST_MB:.0} MB"),
                reached: said(most_mb, |mb| format!("{mb:.0} MB")),
                is_met: most_mb.map(|mb| mb <= MOST_REST_MB),
            },
            Asked {
                quantity: "its growth after ten minutes",
                must: format!("≤ {MOST_GROWTH_MIB_PER_H:.0} MiB/h"),
                reached: said(growth, |mib| format!("{mib:.1} MiB/h")),
                is_met: growth.map(|mib| mib <= MOST_GROWTH_MIB_PER_H),
            },
            Asked {
                quantity: "processor time per ping at structures, most over least minus 1",
                must: format!("≤ {}", percent(MOST_SPREAD)),
                reached: said(spread, percent),
                is_met: spread.map(|spread| spread <= MOST_SPREAD),
            },
            Asked {
                quantity: "CD of the first structure, later over that at the end of its first visit, \
                           minus 1",
                must: format!("≤ {}", percent(MOST_WORSE)),
                reached: match worse.is_finite() {
                    true => percent(worse),
                    false => "∞".to_owned(),
                },
                is_met: Some(worse <= MOST_WORSE),
            },
        ]
    }

    fn most_rest_mb(&self) -> Option<f64> {
        let rests = self.tenths.iter().map(|tenth| tenth.rest_bytes);
        rests.max().map(|bytes| bytes as f64 * 1e-6)
    }

    /// From the first tenth that ends after ten minutes to the last.
    fn growth_mib_per_h(&self) -> Option<f64> {
        let first = self.tenths.iter().find(|tenth| tenth.end_s > SETTLED_S)?;
        let last = self.tenths.last()?;
        let hours = (last.end_s - first.end_s) / 3600.0;
        let grown_mib = (last.rest_bytes as f64 - first.rest_bytes as f64) / f64::from(1 << 20);
        (hours > 0.0).then(|| grown_mib / hours)
    }

    /// Over the tenths at structures; one alone says nothing.
    fn compute_spread(&self) -> Option<f64> {
        let own = self.tenths.iter().filter(|tenth| tenth.is_at_structures());
        let own: Vec<f64> = own.map(|tenth| tenth.compute_per_ping_s).collect();
        let most = own.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let least = own.iter().copied().fold(f64::INFINITY, f64::min);
        (own.len() > 1 && least > 0.0).then(|| most / least - 1.0)
    }
}

impl Tenth {
    /// Whether nearly all of it was spent at structures.
    #[must_use]
    pub(crate) fn is_at_structures(&self) -> bool {
        self.structure_share >= LEAST_STRUCTURE_SHARE
    }
}

impl Errors {
    /// Each with the moment it belongs to.
    #[must_use]
    pub(crate) fn named(&self) -> [(&'static str, f64); 4] {
        [
            ("end of the first visit, live", self.first_visit_m),
            ("half of the dive, live", self.half_m),
            ("end, live", self.end_m),
            ("end, finished", self.finished_m),
        ]
    }

    /// By what share the worst later one is above the first; infinite if anything is missing.
    fn worse(&self) -> f64 {
        let later = [self.half_m, self.end_m, self.finished_m];
        let worst_m = later.into_iter().fold(0.0, f64::max);
        match self.first_visit_m > 0.0 && worst_m.is_finite() && self.first_visit_m.is_finite() {
            true => worst_m / self.first_visit_m - 1.0,
            false => f64::INFINITY,
        }
    }
}

impl Asked {
    /// As in reports.
    #[must_use]
    pub(crate) fn verdict(&self) -> &'static str {
        match self.is_met {
            Some(true) => "met",
            Some(false) => "missed",
            None => "too short to say",
        }
    }

    /// What is to be said if it is missed.
    #[must_use]
    pub(crate) fn failure(&self) -> Option<String> {
        let said = || format!("{}: {} ({})", self.quantity, self.reached, self.must);
        (self.is_met == Some(false)).then(said)
    }
}

fn said(value: Option<f64>, show: impl Fn(f64) -> String) -> String {
    value.map_or("–".to_owned(), show)
}

/// Of the time from `from_s` to `to_s`, the share within any of the spans.
fn share_within(spans_s: &[(f64, f64)], from_s: f64, to_s: f64) -> f64 {
    let within = |(begin, end): &(f64, f64)| (end.min(to_s) - begin.max(from_s)).max(0.0);
    spans_s.iter().map(within).sum::<f64>() / (to_s - from_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Errors = Errors {
        first_visit_m: 0.1,
        half_m: 0.1,
        end_m: 0.104,
        finished_m: 0.05,
    };

    /// Two hours at 10 pings/s, 2 ms each; `rest_mib` beside maps of 1 MB, two of them held.
    fn readings(rest_mib: impl Fn(u64) -> u64) -> Vec<Reading> {
        let reading = |tenth: u64| Reading {
            dive_s: 720.0 * tenth as f64,
            pings: 7200 * tenth,
            compute_s: 14.4 * tenth as f64,
            resident_bytes: (rest_mib(tenth) << 20) + 2_000_000 + 5_000_000,
            map_bytes: 1_000_000,
            published_bytes: 2_000_000,
            gaussians: 17,
        };
        (1..=10).map(reading).collect()
    }

    fn found(readings: &[Reading], errors: Errors) -> Found {
        // A transit of a quarter of the second tenth.
        let stays_s = [(0.0, 720.0), (900.0, 7200.0)];
        Found::new(readings, &stays_s, 5_000_000, errors)
    }

    fn met(found: &Found) -> Vec<Option<bool>> {
        found.asked().iter().map(|asked| asked.is_met).collect()
    }

    #[test]
    fn what_is_flat_meets_everything() {
        // What is filled before ten minutes is no growth.
        let found = found(&readings(|_| 100), GOOD);
        assert_eq!(met(&found), [Some(true); 4]);
        let tenth = &found.tenths[3];
        assert_eq!((tenth.pings, tenth.rest_bytes), (7200, 100 << 20));
        assert!((tenth.compute_per_ping_s - 2e-3).abs() < 1e-12);
        assert!((found.tenths[1].structure_share - 0.75).abs() < 1e-9);
    }

    #[test]
    fn growth_is_per_hour_from_the_first_tenth_after_ten_minutes() {
        // 18 MiB in the 1.8 h after the first tenth.
        let found = found(&readings(|tenth| 100 + 2 * tenth), GOOD);
        assert!((found.growth_mib_per_h().unwrap() - 10.0).abs() < 1e-9);
        assert_eq!(
            met(&found),
            [Some(true), Some(false), Some(true), Some(true)]
        );
        let large = self::found(&readings(|_| 290), GOOD);
        assert_eq!(met(&large)[0], Some(false));
        assert!(large.asked()[0].failure().unwrap().contains("304 MB"));
    }

    #[test]
    fn transits_are_not_held_against_structures() {
        let mut readings = readings(|_| 100);
        // The second tenth costs nothing, and part of it is a transit.
        for reading in &mut readings[1..] {
            reading.compute_s -= 14.0;
        }
        assert_eq!(met(&found(&readings, GOOD))[2], Some(true));
        // The third is all at structures.
        for reading in &mut readings[2..] {
            reading.compute_s -= 2.0;
        }
        assert_eq!(met(&found(&readings, GOOD))[2], Some(false));
    }

    #[test]
    fn a_structure_that_fades_is_told() {
        let of = |errors| met(&found(&readings(|_| 100), errors))[3];
        let faded = Errors {
            half_m: 0.106,
            ..GOOD
        };
        let gone = Errors {
            finished_m: f64::INFINITY,
            ..GOOD
        };
        let never = Errors {
            first_visit_m: f64::INFINITY,
            ..GOOD
        };
        assert_eq!([of(faded), of(gone), of(never)], [Some(false); 3]);
    }

    #[test]
    fn ten_minutes_say_nothing_of_growth() {
        let mut short = readings(|_| 100);
        for reading in &mut short {
            reading.dive_s /= 12.0;
        }
        let found = Found::new(&short, &[(0.0, 60.0)], 0, GOOD);
        assert_eq!(met(&found), [Some(true), None, None, Some(true)]);
        assert_eq!(found.asked()[1].verdict(), "too short to say");
    }
}
