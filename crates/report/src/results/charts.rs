//! The charts of the page, each a file.

use super::data::{Curve, Live, Point, Results, Sigma, Watched};
use crate::Plot;

/// Of one page.
pub const MOST_CHARTS: usize = 8;

type Line = (String, Vec<(f64, f64)>);

/// A file's name, what it shows, and its contents.
pub(super) struct Chart {
    pub(super) name: String,
    pub(super) shows: String,
    pub(super) svg: String,
}

impl Chart {
    fn of(name: &str, shows: &str, plot: &Plot) -> Option<Self> {
        let is_drawn = plot.lines.iter().any(|line| !line.1.is_empty());
        is_drawn.then(|| Self {
            name: format!("{name}.svg"),
            shows: shows.to_owned(),
            svg: plot.to_svg_file(),
        })
    }
}

/// All of them, in the order of the page; what was not run has none.
pub(super) fn all(results: &Results) -> Vec<Chart> {
    let mut charts: Vec<Chart> = Vec::new();
    charts.extend(live(results));
    charts.extend(sigma(results));
    charts.extend(probability(results));
    charts.extend(noise(results));
    charts.extend(results.error_time.iter().filter_map(error_time));
    charts.extend(memory(results));
    charts
}

fn plot(x_label: &str, y_label: &str, lines: Vec<Line>) -> Plot {
    Plot {
        x_label: x_label.to_owned(),
        y_label: y_label.to_owned(),
        lines,
        ..Plot::default()
    }
}

fn live(results: &Results) -> Option<Chart> {
    let first = results.live.first()?.seed;
    let own = || results.live.iter().filter(|live| live.seed == first);
    let mut scenes: Vec<&str> = own().map(|live| live.scene.as_str()).collect();
    scenes.dedup();
    let line = |scene: &str, kind: &str, of: fn(&Live) -> Option<Point>| {
        let moments = own().filter(|live| live.scene == scene);
        let points = moments.filter_map(|live| Some((100.0 * live.share, of(live)?.cd_m)));
        (format!("{scene}, {kind}"), points.collect())
    };
    let lines = scenes.iter().flat_map(|scene| {
        [
            line(scene, "live", |live| Some(live.live)),
            line(scene, "ended there", |live| live.ended),
        ]
    });
    let drawn = Plot {
        x_is_linear: true,
        ..plot("share of the dive, %", "CD, m", lines.collect())
    };
    let shows = "CD of live maps over the dive, beside the same dive ended there";
    Chart::of("live", shows, &drawn)
}

fn sigma(results: &Results) -> Option<Chart> {
    let line = |sigma: &Sigma| (sigma.noise.clone(), sigma.tenths_m.clone());
    let mut lines: Vec<Line> = results.sigma.iter().map(line).collect();
    let along = lines.iter().flat_map(|line| &line.1).map(|point| point.0);
    let (low, high) = along.fold((f64::INFINITY, 0.0_f64), |(low, high), at| {
        (low.min(at), high.max(at))
    });
    if high > 0.0 {
        lines.push(("as told".to_owned(), vec![(low, low), (high, high)]));
    }
    let drawn = plot("sigma told, rms, m", "error found, rms, m", lines);
    Chart::of("sigma", "Error over sigma, in tenths by sigma", &drawn)
}

fn probability(results: &Results) -> Option<Chart> {
    let line = |sigma: &Sigma| {
        let points = sigma.probability.iter();
        let points = points.map(|(told, found, _)| (*told, *found));
        (sigma.noise.clone(), points.collect())
    };
    let mut lines: Vec<Line> = results.sigma.iter().map(line).collect();
    if !lines.is_empty() {
        lines.push(("as told".to_owned(), vec![(0.0, 0.0), (1.0, 1.0)]));
    }
    let drawn = Plot {
        x_is_linear: true,
        y_is_linear: true,
        ..plot(
            "probability told",
            "share with surface within 0.10 m",
            lines,
        )
    };
    Chart::of("probability", "Probability told and found", &drawn)
}

fn noise(results: &Results) -> Option<Chart> {
    let line = |pings: &str| {
        let own = results.noise.iter().filter(|level| level.pings == pings);
        // An empty map has no distance.
        let asserted = own.filter(|level| level.run.confident > 0);
        let mut points: Vec<(f64, f64)> = asserted
            .map(|level| (level.over_noise_db, level.run.cd_m))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        (format!("{pings} pings"), points)
    };
    let drawn = Plot {
        x_is_linear: true,
        ..plot(
            "strongest echo over mean noise, dB",
            "CD, m",
            vec![line("field"), line("nominal")],
        )
    };
    Chart::of("noise", "CD as the echoes sink into the noise", &drawn)
}

fn error_time(watched: &Watched) -> Option<Chart> {
    let line = |curve: &Curve| {
        let points = curve.points.iter();
        let points = points.map(|point| (point.compute_s, point.cd_m));
        (curve.method.clone(), points.collect())
    };
    let lines = watched.curves.iter().map(line).collect();
    let drawn = plot("processor time, s", "CD, m", lines);
    let words = watched
        .dive
        .split([',', ' '])
        .filter(|word| !word.is_empty());
    let name = format!("error-{}", words.collect::<Vec<_>>().join("-"));
    let shows = format!("{}: CD over processor time", watched.dive);
    Chart::of(&name, &shows, &drawn)
}

fn memory(results: &Results) -> Option<Chart> {
    let mut lines: Vec<Line> = Vec::new();
    for case in &results.length {
        let points = case.runs.iter();
        let points = points.map(|run| (run.dive_s, run.peak_bytes as f64 * 1e-6));
        lines.push((case.scene.clone(), points.collect()));
    }
    let drawn = Plot {
        x_is_linear: true,
        y_is_linear: true,
        ..plot("length of the dive, s", "peak memory, MB", lines)
    };
    Chart::of("memory", "Peak memory over the length of the dive", &drawn)
}
