//! One dive as a page of HTML: what came of it in one sentence, the map, the way, charts and figures.

use echosplat_metrics::Metrics;
use echosplat_metrics::curve::Sample;
use echosplat_model::{Gaussian, Snapshot, Standing};
use echosplat_report::table::{self, metres_unit, quantity};
use echosplat_report::{DiveReport, MapView, OF_MAPS, Plot, Table, Trajectory};
use serde_json::Value;

use crate::commands::judging::{AgainstTruth, Growth, Verdict};
use crate::pipeline::{Notice, Outcome};
use crate::processor;

/// Names a report.
pub(super) struct Heading {
    pub(super) title: String,
    /// What was run, in a sentence or two.
    pub(super) text: String,
    pub(super) seed: Option<u64>,
}

/// As one HTML document; `summary` as `--json` has it.
pub(super) fn html(
    heading: Heading,
    outcome: &Outcome,
    verdict: &Verdict,
    summary: &Value,
) -> String {
    let snapshot = &outcome.snapshot;
    let against_truth = verdict.against_truth.as_ref();
    let way = verdict.trajectory.0.iter();
    let way: Vec<_> = way.map(|(_, place)| *place - snapshot.origin_m).collect();
    let errors_m = against_truth.map(|found| &found.errors_m[..]);
    let mut machine = processor::description();
    let seed = heading
        .seed
        .map(|seed| ("seed".to_owned(), seed.to_string()));
    machine.extend(seed);
    let mut tables = Vec::new();
    tables.extend(against_truth.map(|found| error_table(&found.metrics)));
    tables.push(run_table(summary));
    tables.extend(notice_table(&outcome.status.notices));
    let report = DiveReport {
        title: heading.title,
        text: heading.text,
        verdict: sentence(&Said::of(outcome, &verdict.trajectory, against_truth)),
        view: MapView::new(&snapshot.gaussians, errors_m, &way),
        picture: verdict.picture.clone(),
        trajectory: verdict.trajectory.clone(),
        plots: plots(&verdict.growth, against_truth, snapshot),
        tables,
        notes: match against_truth {
            Some(_) => OF_MAPS.map(str::to_owned).into(),
            None => Vec::new(),
        },
        machine,
    };
    report.to_html()
}

/// What the first sentence is made of.
struct Said<'a> {
    dive_s: f64,
    way_m: f64,
    asserted: usize,
    ambiguous: usize,
    /// Half of what is asserted is known as well as this, one sigma, metres.
    sigma_m: Option<f64>,
    truth: Option<&'a Metrics>,
    worst: Option<&'a str>,
}

impl<'a> Said<'a> {
    fn of(outcome: &'a Outcome, way: &Trajectory, truth: Option<&'a AgainstTruth>) -> Self {
        let gaussians = &outcome.snapshot.gaussians;
        let sigmas = sigmas_m(gaussians);
        Self {
            dive_s: outcome.status.report.dive_s,
            way_m: way.length_m(),
            asserted: sigmas.len(),
            ambiguous: gaussians.len() - sigmas.len(),
            sigma_m: sigmas.get(sigmas.len() / 2).copied(),
            truth: truth.map(|truth| &truth.metrics),
            worst: worst(&outcome.status.notices).map(|notice| notice.sentence.as_str()),
        }
    }
}

/// Of what is asserted, least first.
fn sigmas_m(gaussians: &[Gaussian]) -> Vec<f64> {
    let asserted = gaussians
        .iter()
        .filter(|g| g.standing == Standing::Confident);
    let mut sigmas: Vec<f64> = asserted.map(|g| f64::from(g.sigma_m)).collect();
    sigmas.sort_by(f64::total_cmp);
    sigmas
}

/// What cost the map something, then what still stands, then what came last.
fn worst(notices: &[Notice]) -> Option<&Notice> {
    notices
        .iter()
        .max_by_key(|notice| (notice.is_loss, notice.until_s.is_none(), notice.count))
}

fn sentence(said: &Said) -> String {
    let dive = format!(
        "{} s of dive along {} m",
        quantity(said.dive_s),
        quantity(said.way_m)
    );
    let map = match (said.asserted, said.sigma_m) {
        (0, _) => format!("{dive} gave no map: no surface is asserted"),
        (count, Some(sigma_m)) if sigma_m.is_finite() => format!(
            "{dive} gave a map of {count} Gaussians, half of them known to {} (one sigma)",
            metres_unit(sigma_m)
        ),
        (count, _) => format!("{dive} gave a map of {count} Gaussians"),
    };
    let open = match said.ambiguous {
        0 => String::new(),
        count => format!(", and {count} more that may or may not be surface"),
    };
    let truth = said.truth.filter(|_| said.asserted > 0).map_or(String::new(), |truth| {
        format!(
            "; it is {} from the truth on average (Chamfer distance) and {} at the worst place (Hausdorff), and {} of it \
             lies more than 0.25 m from any surface",
            metres_unit(truth.cd_m),
            metres_unit(truth.hd_m),
            table::percent(truth.confident_false_share)
        )
    });
    let worst = match said.worst {
        None => "; nothing went wrong.".to_owned(),
        Some(worst) => format!("; what went wrong most: {}.", worst.trim_end_matches('.')),
    };
    format!("{map}{open}{truth}{worst}")
}

/// At most four, for a dive with a truth and for one without.
fn plots(growth: &[Growth], truth: Option<&AgainstTruth>, map: &Snapshot) -> Vec<Plot> {
    let line = |name: &str, value: fn(&Growth) -> f64| {
        let points = growth.iter().map(|moment| (moment.dive_s, value(moment)));
        (name.to_owned(), points.collect())
    };
    let over_dive = |y_label: &str, lines| Plot {
        x_label: "dive time, s".to_owned(),
        y_label: y_label.to_owned(),
        x_is_linear: true,
        y_is_linear: true,
        lines,
        marks: Vec::new(),
    };
    let counts = vec![
        line("asserted", |moment| moment.confident as f64),
        line("ambiguous", |moment| moment.ambiguous as f64),
    ];
    let mut plots = Vec::new();
    if let Some(truth) = truth {
        let errors = |name: &str, value: fn(&Sample) -> f64| {
            let points = truth.curve.samples.iter();
            let points = points.map(|sample| (sample.dive_s, value(sample)));
            (name.to_owned(), points.collect())
        };
        let distances = vec![
            errors("Chamfer distance", |sample| sample.metrics.cd_m),
            errors("Hausdorff distance", |sample| sample.metrics.hd_m),
        ];
        plots.push(Plot {
            y_is_linear: false,
            ..over_dive("distance from the truth, m", distances)
        });
        let share = errors("beyond 0.25 m of all truth", |sample| {
            100.0 * sample.metrics.confident_false_share
        });
        plots.push(over_dive("confident but false, %", vec![share]));
    }
    plots.push(over_dive("Gaussians", counts));
    plots.push(match truth {
        Some(_) => over_dive(
            "compute time of the mapper, CPU s",
            vec![line("compute time", |moment| moment.compute_s)],
        ),
        None => sigma_plot(map),
    });
    plots
}

/// How much of the map is known how well.
fn sigma_plot(map: &Snapshot) -> Plot {
    let sigmas = sigmas_m(&map.gaussians);
    let known = sigmas
        .iter()
        .take_while(|sigma_m| sigma_m.is_finite())
        .count();
    let every = (known / 100).max(1);
    let share = |index: usize| 100.0 * (index + 1) as f64 / sigmas.len() as f64;
    let points = (0..known)
        .step_by(every)
        .map(|index| (sigmas[index], share(index)));
    Plot {
        x_label: "sigma of the place, m".to_owned(),
        y_label: "Gaussians known so well or better, %".to_owned(),
        y_is_linear: true,
        lines: vec![("known so well".to_owned(), points.collect())],
        ..Plot::default()
    }
}

fn error_table(metrics: &Metrics) -> Table {
    let facts = table::facts(metrics).into_iter();
    Table {
        title: "The map against the truth".to_owned(),
        columns: vec!["what".to_owned(), "value".to_owned()],
        rows: facts.map(|(name, value)| vec![name, value]).collect(),
        note: String::new(),
    }
}

fn run_table(summary: &Value) -> Table {
    let value = |field: &str| summary[field].as_f64().unwrap_or(0.0);
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    let count = |field: &str| format!("{:.0}", value(field));
    Table {
        title: "The run".to_owned(),
        columns: vec!["what".to_owned(), "value".to_owned()],
        rows: vec![
            row("pings received", count("pings_received")),
            row("pings mapped", count("pings_mapped")),
            row("pings without a pose", count("pings_without_pose")),
            row("damaged frames", count("frames_bad")),
            row(
                "mapper's processor time",
                format!("{:.1} s", value("compute_s")),
            ),
            row("time by the clock", format!("{:.1} s", value("wall_s"))),
            row("Gaussian–bin pairs", quantity(value("pairs"))),
            row(
                "most memory held",
                format!("{:.0} MB", 1e-6 * value("peak_memory_bytes")),
            ),
        ],
        note: String::new(),
    }
}

/// What was wrong, if anything was.
fn notice_table(notices: &[Notice]) -> Option<Table> {
    let row = |notice: &Notice| {
        let until = match notice.until_s {
            Some(until_s) => format!("{until_s:.1} s"),
            None => "to the end".to_owned(),
        };
        vec![
            notice.code.to_string(),
            format!("{:.1} s", notice.since_s),
            until,
            notice.sentence.clone(),
        ]
    };
    (!notices.is_empty()).then(|| Table {
        title: "What went wrong".to_owned(),
        columns: ["notice", "from", "until", "what, and what to do"]
            .map(str::to_owned)
            .into(),
        rows: notices.iter().map(row).collect(),
        note: String::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said() -> Said<'static> {
        Said {
            dive_s: 240.0,
            way_m: 181.4,
            asserted: 17_677,
            ambiguous: 329,
            sigma_m: Some(0.0213),
            truth: None,
            worst: None,
        }
    }

    #[test]
    fn the_verdict_is_one_plain_sentence() {
        assert_eq!(
            sentence(&said()),
            "240 s of dive along 181 m gave a map of 17677 Gaussians, half of them known to 0.021 m (one sigma), and 329 \
             more that may or may not be surface; nothing went wrong."
        );
        let truth = echosplat_metrics::sample::run("online", 1, 3.0, 3);
        let metrics = truth.last().unwrap().metrics;
        let judged = sentence(&Said {
            truth: Some(&metrics),
            worst: Some("No poses came for 3 s: look at the pose source."),
            ambiguous: 0,
            ..said()
        });
        assert!(
            judged.contains("; it is 0.150 m from the truth on average"),
            "{judged}"
        );
        assert!(
            judged.ends_with(
                "; what went wrong most: No poses came for 3 s: look at the pose source."
            ),
            "{judged}"
        );
    }

    #[test]
    fn an_empty_map_is_said_to_be_none() {
        let empty = sentence(&Said {
            asserted: 0,
            ambiguous: 0,
            sigma_m: None,
            ..said()
        });
        assert!(
            empty.contains("gave no map: no surface is asserted; nothing"),
            "{empty}"
        );
        let unknown = sentence(&Said {
            sigma_m: Some(f64::INFINITY),
            ..said()
        });
        assert!(
            !unknown.contains("inf") && !unknown.contains("∞"),
            "{unknown}"
        );
    }
}
