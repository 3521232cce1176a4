//! Noise over range: what the lower quartiles of sections of range say of it, of the quietest pings. Sections grow with range,
//! so that a power of range is a straight line over them.
//!
//! Cost: a sort of the bins of a ping.

use echosplat_model::{Ping, PingSettings};

use crate::detect::profile::SILENCE;

/// Sections a factor of e; grid.
/// Sections of range for each factor of e, in which noise is told.
const SECTIONS_PER_E: f32 = 6.0;
/// Sections, to 400 m; grid.
/// Sections that are told apart, from [`NEAREST_M`] to 400 m.
pub(crate) const SECTIONS: usize = 48;
/// Metres where sections begin; grid.
const NEAREST_M: f32 = 0.15;
/// Bins that tell a quartile; found.
const LEAST_BINS: usize = 6;
/// Sections that tell a slope, derived: a factor of 3.
/// Fewest sections on a line that tell its slope: a factor of 3 in range.
const LEAST_SECTIONS: i32 = 7;
/// Pings averaged, derived: about a second.
const GROUP: f32 = 64.0;
/// Log error times √n; physics.
/// Standard error of the log of a lower quartile of exponential noise, times the root of the number of bins.
const QUARTILE_ERROR: f32 = 2.0;
/// Log power, found: 0.4 dB.
/// Sections this near a straight line lie on it beside their own error: 0.4 dB.
const ROUGHNESS: f32 = 0.1;
/// Exponent, physics: units correct by r² or more.
/// Noise that grows by less than this power of range is flat: units that correct for range do it by r² or more.
const LEAST_EXPONENT: f32 = 0.5;
/// Log of range; found.
/// Least factor of range between two sections whose slope is tried, as its log.
const LEAST_SPAN: f32 = 0.7;
/// Fraction, physics: pings span 90 dB.
/// Sections quieter than this fraction of the loudest bin hold no noise of a receiver: a ping spans at most 90 dB.
const SILENT: f32 = 1e-9;

/// What some pings said of the noise.
#[derive(Debug, Clone)]
pub(crate) struct NoiseOverRange {
    /// Shape `[SECTIONS]`.
    sections: Vec<Section>,
    pings: u32,
}

impl Default for NoiseOverRange {
    fn default() -> Self {
        Self {
            sections: vec![Section::default(); SECTIONS],
            pings: 0,
        }
    }
}

/// The lower quartile of a section of a ping.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Quartile {
    section: usize,
    log_power: f32,
    bins: usize,
}

impl Quartile {
    /// Of all sections of a ping beyond bin `blank` that hold enough, at a gain of power `log_gain` over the reference.
    pub(crate) fn of_ping(ping: &Ping, blank: usize, log_gain: f32) -> Vec<Self> {
        let (settings, power) = (ping.settings(), ping.intensity());
        let loudest = power[blank..].iter().copied().fold(0.0, f32::max);
        // A section that is mostly at the floor of the ping's decibels says nothing of what lies below.
        let least = power.iter().copied().fold(f32::INFINITY, f32::min);
        let section_of = |bin: usize| {
            let log = log_range(settings, bin) - NEAREST_M.ln();
            (log.max(0.0) * SECTIONS_PER_E) as usize
        };
        let (mut told, mut start) = (Vec::new(), blank);
        while start < power.len() {
            let section = section_of(start);
            let is_beyond = |bin: &usize| section_of(*bin) != section;
            let end = (start..power.len()).find(is_beyond).unwrap_or(power.len());
            if section < SECTIONS && end - start >= LEAST_BINS {
                let quartile = lower_quartile(&mut power[start..end].to_vec());
                let is_at_floor = quartile <= least && least > SILENCE;
                if quartile > SILENT * loudest && !is_at_floor {
                    told.push(Self {
                        section,
                        log_power: (quartile * (-log_gain).exp()).ln(),
                        bins: end - start,
                    });
                }
            }
            start = end;
        }
        told
    }
}

impl NoiseOverRange {
    pub(crate) fn add(&mut self, quartiles: &[Quartile]) {
        for quartile in quartiles {
            self.sections[quartile.section].add(quartile.log_power, quartile.bins);
        }
        self.pings = self.pings.saturating_add(1);
    }

    pub(crate) fn pings(&self) -> u32 {
        self.pings
    }

    /// Sections that are told of, nearest first, with the log of their lower quartile undone for a power of range.
    pub(crate) fn levels(&self, exponent: f32) -> Vec<(usize, f32)> {
        let level = |(index, heard): (usize, Heard)| {
            let log_range = NEAREST_M.ln() + (index as f32 + 0.5) / SECTIONS_PER_E;
            (index, heard.log_mean() - exponent * log_range)
        };
        self.told().map(level).collect()
    }

    fn told(&self) -> impl Iterator<Item = (usize, Heard)> {
        let sections = self.sections.iter().enumerate();
        sections.filter_map(|(index, section)| Some((index, section.told()?)))
    }

    /// The power of range that noise grows by: the straight line, log over log, that most sections lie on. Echoes lie
    /// above it, also where the seabed fills every section beyond some range; nothing may lie below.
    ///
    /// `None` if too few sections do.
    pub(crate) fn exponent(&self) -> Option<f32> {
        struct Point {
            x: f32,
            y: f32,
            error: f32,
        }
        let told = self.told();
        let points: Vec<Point> = told
            .map(|(index, heard)| Point {
                x: index as f32 / SECTIONS_PER_E,
                y: heard.log_mean(),
                error: QUARTILE_ERROR / heard.bins.sqrt() + ROUGHNESS,
            })
            .collect();
        let is_on = |p: &Point, slope: f32, offset: f32| {
            (p.y - offset - slope * p.x).abs() <= 2.0 * p.error
        };
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
        let sum =
            |of: &dyn Fn(&Point) -> f32| on.iter().map(|p| of(p) / p.error.powi(2)).sum::<f32>();
        let (w, x, y) = (sum(&|_| 1.0), sum(&|p| p.x), sum(&|p| p.y));
        let (xx, xy) = (sum(&|p| p.x * p.x), sum(&|p| p.x * p.y));
        let exponent = (w * xy - x * y) / (w * xx - x * x);
        Some(match exponent >= LEAST_EXPONENT {
            true => exponent,
            false => 0.0,
        })
    }
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
    fn add(&mut self, log_quartile: f32, bins: usize) {
        self.now.log_sum += log_quartile;
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

/// Log of the range of a bin's middle over 1 m.
pub(crate) fn log_range(settings: &PingSettings, bin: usize) -> f32 {
    (settings.bin_center_m(bin) as f32)
        .max(f32::MIN_POSITIVE)
        .ln()
}

/// 0 of nothing.
pub(crate) fn lower_quartile(powers: &mut [f32]) -> f32 {
    let quarter = powers.len() / 4;
    if powers.is_empty() {
        return 0.0;
    }
    *powers.select_nth_unstable_by(quarter, f32::total_cmp).1
}

/// Nearest range of a section, metres.
pub(crate) fn section_edge_m(index: usize) -> f64 {
    f64::from(NEAREST_M * (index as f32 / SECTIONS_PER_E).exp())
}
