//! The sections of the page, each with its heading.

use echosplat_metrics::curve::Spread;

use super::data::{Case, Judged, Live, Point, Results, Run};
use super::readme::{ACCURACY_MARK, accuracy_table};
use crate::table;

/// Said of a part without runs.
const NOT_RUN: &str = "Not run yet.\n";
/// A computer this many times slower stands for those on small vehicles.
const SLOWER: f64 = 3.0;

pub(super) fn median(runs: &[Run], of: fn(&Run) -> f64) -> f64 {
    Spread::of(runs.iter().map(of)).median
}

fn worst(runs: &[Run], of: fn(&Run) -> f64) -> f64 {
    Spread::of(runs.iter().map(of)).max
}

pub(super) fn metres(value: f64) -> String {
    table::metres_unit(value)
}

pub(super) fn percent(share: f64) -> String {
    table::percent(share)
}

/// A heading, what is below it, and a table unless it is empty.
fn section(heading: &str, words: &str, header: &[&str], rows: &[Vec<String>]) -> String {
    if rows.is_empty() {
        return format!("## {heading}\n\n{NOT_RUN}");
    }
    let rule = "|---".repeat(header.len());
    let lines: Vec<String> = rows.iter().map(|row| line(row)).collect();
    format!(
        "## {heading}\n\n{words}\n\n{}{rule}|\n{}",
        line(header),
        lines.concat()
    )
}

/// Of a table. Without spaces around its cells, so that who counts words counts no lines between them.
pub(super) fn line<T: AsRef<str>>(cells: &[T]) -> String {
    let cells: Vec<&str> = cells.iter().map(AsRef::as_ref).collect();
    format!("|{}|\n", cells.join("|"))
}

pub(super) fn accuracy(results: &Results) -> String {
    let table = accuracy_table(results);
    let row = |case: &Case| {
        let runs = &case.runs;
        let empty = runs.iter().all(|run| run.confident == 0);
        let shown = |text: String| if empty { "–".to_owned() } else { text };
        vec![
            format!("{}, {}, {}", case.scene, case.dive, case.noise),
            runs.len().to_string(),
            shown(metres(median(runs, |run| run.cd_m))),
            shown(metres(worst(runs, |run| run.cd_m))),
            shown(metres(median(runs, |run| run.p99_m))),
            shown(metres(median(runs, |run| run.hd_m))),
            match empty {
                true => "nothing asserted".to_owned(),
                false => percent(median(runs, |run| run.false_share)),
            },
        ]
    };
    let run = results.accuracy.iter().filter(|case| !case.runs.is_empty());
    let rows: Vec<Vec<String>> = run.map(row).collect();
    let words = format!(
        "Surveys of four scenes, medians over the seeds:\n\n{ACCURACY_MARK}\n\n{table}\n{ACCURACY_MARK}\n\n\
         All dives. HD hangs on a single Gaussian and moves by a factor of three when sums are rounded otherwise; \
         the 99th percentile does not."
    );
    let header = [
        "dive",
        "seeds",
        "CD",
        "worst CD",
        "99th percentile",
        "HD",
        "false",
    ];
    section("Accuracy", &words, &header, &rows)
}

pub(super) fn live(results: &Results) -> String {
    let compared = |live: &Live| {
        let ended: Point = live.ended?;
        Some(vec![
            live.scene.clone(),
            format!("{:.0} %", 100.0 * live.share),
            metres(live.live.cd_m),
            metres(ended.cd_m),
            metres(live.live.p99_m),
            metres(ended.p99_m),
            percent(live.live.false_share),
        ])
    };
    let rows: Vec<Vec<String>> = results.live.iter().filter_map(compared).collect();
    let words = "What is published while the dive goes on, beside the same dive cut there and ended. Both are judged \
                 by all that the whole dive sees.";
    let header = [
        "survey, nominal",
        "at",
        "CD, live",
        "ended",
        "99th, live",
        "ended",
        "false, live",
    ];
    section("The live map", words, &header, &rows)
}

pub(super) fn sigma(results: &Results) -> String {
    let row = |sigma: &super::data::Sigma| {
        let ratios = sigma.tenths_m.iter().map(|(told, found)| found / told);
        let spread = Spread::of(ratios);
        let groups = sigma.probability.iter().filter(|group| group.2 >= 300);
        let off = groups.map(|(told, found, _)| 100.0 * (told - found).abs());
        vec![
            sigma.noise.clone(),
            sigma.maps.to_string(),
            percent(sigma.within_share),
            format!("{:.2} to {:.2}", spread.min, spread.max),
            format!("{:.1} points", off.fold(0.0, f64::max)),
        ]
    };
    let rows: Vec<Vec<String>> = results.sigma.iter().map(row).collect();
    let words = "Each Gaussian tells its sigma and the probability of surface within 0.10 m. Surveys of four scenes \
                 pooled. Within two sigma 90 to 99 % are asked for.";
    let header = [
        "noise",
        "maps",
        "within 2 σ",
        "error over sigma, tenths",
        "probability off, most",
    ];
    section("How sure the map is", words, &header, &rows)
}

pub(super) fn noise(results: &Results) -> String {
    let mut levels_db: Vec<f64> = results.noise.iter().map(|at| at.over_noise_db).collect();
    levels_db.sort_by(|a, b| b.total_cmp(a));
    levels_db.dedup();
    let row = |pings: &str, what: &str, of: fn(&Run) -> String| {
        let cell = |db: &f64| {
            let mut own = results.noise.iter().filter(|at| at.pings == pings);
            let found = own.find(|at| at.over_noise_db.total_cmp(db).is_eq());
            found.map_or("–".to_owned(), |at| of(&at.run))
        };
        let cells = levels_db.iter().map(cell);
        [format!("{pings}, {what}")]
            .into_iter()
            .chain(cells)
            .collect()
    };
    let cd = |run: &Run| match run.confident {
        0 => "nothing".to_owned(),
        _ => table::metres(run.cd_m),
    };
    let false_share = |run: &Run| format!("{:.1}", 100.0 * run.false_share);
    let mut kinds: Vec<&str> = results.noise.iter().map(|at| at.pings.as_str()).collect();
    kinds.dedup();
    let of_kind = |pings: &&str| [row(pings, "CD m", cd), row(pings, "false %", false_share)];
    let rows: Vec<Vec<String>> = kinds.iter().flat_map(of_kind).collect();
    let words = "One survey of the fence, its strongest echoes so far above the mean noise. What is lost must be \
                 ambiguous or absent, never false; where nothing is asserted, there is no distance.";
    let header: Vec<String> = levels_db.iter().map(|db| format!("{db:.0} dB")).collect();
    let header = [&["pings".to_owned()], &header[..]].concat();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    section("Noise", words, &header, &rows)
}

pub(super) fn error_time(results: &Results) -> String {
    let dives = results.error_time.iter();
    let rows = dives.flat_map(|watched| {
        let curves = watched.curves.iter();
        curves.filter_map(|curve| {
            let last = curve.points.last()?;
            let at_best = curve
                .points
                .iter()
                .min_by(|a, b| a.cd_m.total_cmp(&b.cd_m))?;
            Some(vec![
                watched.dive.clone(),
                curve.method.clone(),
                metres(at_best.cd_m),
                format!("{:.1} s", at_best.compute_s),
                metres(last.cd_m),
                percent(last.false_share),
            ])
        })
    });
    let rows: Vec<Vec<String>> = rows.collect();
    let words = "The paper's method takes images, so it runs where a dive has them; it is \
                 [named with its authors](develop/method.md#sources). Methods that take all pings at once are run anew for \
                 each point.";
    let header = ["dive", "method", "best CD", "after", "last CD", "false"];
    section("Error against time", words, &header, &rows)
}

pub(super) fn length(results: &Results) -> String {
    let rows = results.length.iter().flat_map(|case| {
        case.runs.iter().map(|run| {
            vec![
                case.scene.clone(),
                format!("{:.0} s", run.dive_s),
                format!("{:.0} MB", run.peak_bytes as f64 * 1e-6),
                run.confident.to_string(),
                format!("{:.2} ms", 1e3 * run.live_s / run.pings.max(1) as f64),
                metres(run.cd_m),
            ]
        })
    });
    let rows: Vec<Vec<String>> = rows.collect();
    let words = "The same structure for one, two and four times the usual dive, nominal noise, seed 1. The process \
                 holds the simulator too.";
    let header = [
        "scene",
        "dive",
        "peak memory",
        "Gaussians",
        "processor time a ping",
        "CD",
    ];
    section("Memory over length", words, &header, &rows)
}

pub(super) fn speed(results: &Results) -> String {
    let surveys = results.accuracy.iter();
    let surveys = surveys.filter(|case| case.dive == "survey" && !case.runs.is_empty());
    let timed = surveys.filter(|case| case.noise == "nominal" || case.noise == "field");
    let row = |case: &Case| {
        let runs = &case.runs;
        let live = median(runs, |run| run.live_s / run.dive_s);
        let all = median(runs, |run| run.total_s / run.dive_s);
        vec![
            format!("{}, {}", case.scene, case.noise),
            format!("{live:.2} s"),
            format!("{all:.2} s"),
            format!("{:.0}", median(runs, |run| run.pings as f64 / run.total_s)),
            format!("{:.1}", SLOWER * live),
        ]
    };
    let rows: Vec<Vec<String>> = timed.map(row).collect();
    let pings_per_s = results.accuracy.iter().flat_map(|case| &case.runs);
    let pings_per_s = pings_per_s.map(|run| run.pings as f64 / run.dive_s);
    let words = format!(
        "Processor time of the mapper's one thread for a second of sonar, {} runs at a time on {} × {}, at {:.0} pings a \
         second. The last column is an estimate, not a measurement: cores kept busy by the live map on a computer a \
         third as fast, which is three times the first column. `mapper.work_pairs_per_ping` bounds it.",
        results.jobs,
        results.cores,
        results.processor,
        Spread::of(pings_per_s).median,
    );
    let header = [
        "survey",
        "live",
        "with the finish",
        "pings/s, one thread",
        "cores, a third as fast (estimate)",
    ];
    section("Speed", &words, &header, &rows)
}

pub(super) fn missed(results: &Results) -> String {
    let count = |verdict: &str| {
        let own = results.targets.iter();
        own.filter(|row| row.verdict == verdict).count()
    };
    let row = |judged: &Judged| {
        vec![
            judged.case.clone(),
            judged.quantity.clone(),
            judged.asked.clone(),
            judged.median.clone(),
            judged.worst.clone(),
            judged
                .times
                .map_or("–".to_owned(), |times| format!("{times:.2} times")),
        ]
    };
    let failed = results.targets.iter().filter(|row| row.verdict == "failed");
    let rows: Vec<Vec<String>> = failed.map(row).collect();
    let counts = format!(
        "Of {} targets {} are met, {} are missed and {} have runs that are missing. The median over the seeds must meet \
         a limit, and the worst seed 1.5 times of it.",
        results.targets.len(),
        count("passed"),
        rows.len(),
        count("incomplete"),
    );
    if rows.is_empty() {
        return format!("## What is missed\n\n{counts}\n");
    }
    let header = [
        "dive",
        "what",
        "asked",
        "median",
        "worst",
        "median over limit",
    ];
    section("What is missed", &counts, &header, &rows)
}
