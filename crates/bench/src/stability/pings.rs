//! Degenerate pings, as frames of the device: rejected or mapped rightly, never mass from nothing.

use echosplat_model::{Snapshot, Standing};

use super::Row;
use super::dive::{Dive, Heard, TARGET_M, heard, noise, of_target, power, water};
use super::row::{Comparison, Label};
use crate::draw::Draw;
use echosplat_metrics::FALSE_BEYOND_M;

const NOTHING: Label = Label {
    case: "degenerate pings",
    quantity: "Gaussians in the map of a dive with nothing to see (naive: echoes in a ping, by half \
               of its own maximum)",
    why: "Settings that no sonar has are rejected by the session; an echo must stand above the \
          ping's own noise, so that what is the same in every bin is none.",
};

const TARGET: Label = Label {
    case: "degenerate pings",
    quantity: "distance of the furthest confident Gaussian from the only target, m",
    why: "Any number of bins that the device offers is mapped; ranges come from the profile's own \
          header.",
};

pub(super) fn rows(seed: u64, quick: bool) -> Vec<Row> {
    let count = if quick { 240 } else { 480 };
    let mut rows: Vec<Row> = [200, 1200].map(|bins| target(seed, count, bins)).into();
    rows.push(nothing("num_results 1", count, |index| {
        let mut draw = Draw::new(seed, u64::from(index));
        heard(10_000, vec![power(noise(&mut draw))])
    }));
    for length_mm in [0, 1, u32::MAX] {
        let input = format!("length {length_mm} mm");
        rows.push(nothing(&input, count, |index| {
            heard(length_mm, water(seed, index, 600))
        }));
    }
    rows.push(nothing("all-zero power", count, |_| {
        heard(10_000, vec![0; 600])
    }));
    rows.push(nothing("saturated power", count, |_| {
        heard(10_000, vec![u16::MAX; 600])
    }));
    rows.push(nothing("saturated after open water", count, |index| {
        let open = index < count / 3;
        let results = if open {
            water(seed, index, 600)
        } else {
            vec![u16::MAX; 600]
        };
        heard(10_000, results)
    }));
    rows.push(nothing("max = min decibels", count, |index| Heard {
        min_db: 30.0,
        max_db: 30.0,
        ..heard(10_000, water(seed, index, 600))
    }));
    rows
}

fn target(seed: u64, count: u32, bins: usize) -> Row {
    let map = of_target(seed, count, bins).map();
    let error_m = map.map_or(f64::NAN, |(snapshot, _)| furthest_m(&snapshot));
    Comparison::of(0.0, error_m, 1.0).row(TARGET, format!("num_results {bins}"), FALSE_BEYOND_M)
}

/// Of what is asserted; a target that is nowhere in the map is not mapped rightly either.
fn furthest_m(snapshot: &Snapshot) -> f64 {
    let (mut furthest_m, mut nearest_m) = (0.0_f64, f64::INFINITY);
    for gaussian in &snapshot.gaussians {
        let off_m = (snapshot.origin_m + gaussian.mean_m.as_dvec3()).distance(TARGET_M);
        nearest_m = nearest_m.min(off_m);
        if gaussian.standing == Standing::Confident {
            furthest_m = furthest_m.max(off_m);
        }
    }
    furthest_m.max(nearest_m)
}

fn nothing(input: &str, count: u32, of: impl Fn(u32) -> Heard) -> Row {
    let lit = naive_echoes(&of(count - 1));
    let map = Dive { count, of }.map();
    let rejected = map.as_ref().map_or(0, |(_, rejected)| *rejected);
    let input = match rejected {
        0 => input.to_owned(),
        _ => format!("{input} ({rejected} of {count} profiles rejected)"),
    };
    let held = map.map_or(f64::NAN, |(snapshot, _)| snapshot.gaussians.len() as f64);
    let comparison = Comparison::of(0.0, held, 1.0).with_naive(lit, 1.0);
    comparison.row(NOTHING, input, 0.0)
}

/// Bins above half of the ping's own maximum, power scaled to it in f32: the intensity threshold
/// as it is commonly put.
fn naive_echoes(heard: &Heard) -> f64 {
    let span = heard.max_db - heard.min_db;
    let linear = |raw: u16| 10_f32.powf((heard.min_db + f32::from(raw) / 65_535.0 * span) / 10.0);
    let power: Vec<f32> = heard.results.iter().map(|&raw| linear(raw)).collect();
    let most = power.iter().copied().fold(0.0, f32::max);
    power.iter().filter(|&&p| p / most > 0.5).count() as f64
}
