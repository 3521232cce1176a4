//! One dive as a page of HTML: what came of it in one sentence, the map, the way, charts and figures.

use echosplat_metrics::Metrics;
use echosplat_metrics::curve::Sample;
use echosplat_model::{Gaussian, Snapshot, Standing};
use echosplat_report::table::{self, metres_unit, quantity};
use echosplat_report::{DiveReport, MapView, OF_MAPS, Plot, Table, Trajectory};
use serde_json::Value;

use crate::commands::handout::{self, Subject, date};
use crate::commands::judging::{AgainstTruth, Growth, Verdict};
use crate::config::Config;
use crate::pipeline::{Notice, Outcome};
use crate::processor;

/// Names a report.
pub(super) struct Heading<'a> {
    pub(super) title: String,
    pub(super) settings: Option<&'a Config>,
    /// What was run, in a sentence or two.
    pub(super) text: String,
    pub(super) seed: Option<u64>,
}

/// As one HTML document; `summary` as `--json` has it.
pub(super) fn html(
    heading: Heading<'_>,
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
    let subject = Subject {
        about: Vec::new(),
        origin_m: snapshot.origin_m,
        gaussians: &snapshot.gaussians,
        place: outcome.place.as_ref(),
        way: &verdict.trajectory,
        began: date(snapshot.time),
        run: summary,
        settings: heading.settings,
        measures: &[],
    };
    let report = DiveReport {
        title: heading.title,
        text: heading.text,
        handout: handout::of(&subject),
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
pub(super) struct Said<'a> {
    /// How long and how far, where that is known: seconds, metres.
    dive: Option<(f64, f64)>,
    asserted: usize,
    ambiguous: usize,
    /// Half of what is asserted is known as well as this, one sigma, metres.
    sigma_m: Option<f64>,
    truth: Option<&'a Metrics>,
    worst: Option<&'a str>,
    /// Whether it is known what went wrong.
    is_judged: bool,
}

impl<'a> Said<'a> {
    fn of(outcome: &'a Outcome, way: &Trajectory, truth: Option<&'a AgainstTruth>) -> Self {
        let gaussians = &outcome.snapshot.gaussians;
        let sigmas = sigmas_m(gaussians);
        Self {
            dive: Some((outcome.status.report.dive_s, way.length_m())),
            asserted: sigmas.len(),
            ambiguous: gaussians.len() - sigmas.len(),
            sigma_m: sigmas.get(sigmas.len() / 2).copied(),
            truth: truth.map(|truth| &truth.metrics),
            worst: worst(&outcome.status.notices).map(|notice| notice.sentence.as_str()),
            is_judged: true,
        }
    }
}

impl<'a> Said<'a> {
    /// Of a map, and of what is known of its dive.
    pub(super) fn of_subject(subject: &'a Subject) -> Self {
        let sigmas = sigmas_m(subject.gaussians);
        let way = &subject.way.0;
        let dive_s = subject.run["dive_s"].as_f64();
        let dive_s = dive_s.or_else(|| Some(way.last()?.0 - way.first()?.0));
        Self {
            dive: dive_s
                .filter(|_| way.len() > 1)
                .map(|dive_s| (dive_s, subject.way.length_m())),
            asserted: sigmas.len(),
            ambiguous: subject.gaussians.len() - sigmas.len(),
            sigma_m: sigmas.get(sigmas.len() / 2).copied(),
            truth: None,
            worst: worst_told(subject.run),
            is_judged: subject.run["notices"].is_array(),
        }
    }
}

/// As [`worst`], of a status.
fn worst_told(run: &Value) -> Option<&str> {
    let rank = |notice: &&Value| {
        let is_loss = notice["is_loss"].as_bool() == Some(true);
        (
            is_loss,
            notice["until_s"].is_null(),
            notice["count"].as_u64(),
        )
    };
    run["notices"].as_array()?.iter().max_by_key(rank)?["sentence"].as_str()
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

pub(super) fn sentence(said: &Said) -> String {
    let map = match said.dive {
        Some((dive_s, way_m)) => format!(
            "{} s of dive along {} m gave",
            quantity(dive_s),
            quantity(way_m)
        ),
        None => "This is".to_owned(),
    };
    let map = match (said.asserted, said.sigma_m) {
        (0, _) => format!("{map} no map: no surface is asserted"),
        (count, Some(sigma_m)) if sigma_m.is_finite() => format!(
            "{map} a map of {count} Gaussians, half of them known to {} (one sigma)",
            metres_unit(sigma_m)
        ),
        (count, _) => format!("{map} a map of {count} Gaussians"),
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
        None if !said.is_judged => ".".to_owned(),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn said() -> Said<'static> {
        Said {
            dive: Some((240.0, 181.4)),
            asserted: 17_677,
            ambiguous: 329,
            sigma_m: Some(0.0213),
            truth: None,
            worst: None,
            is_judged: true,
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
        let alone = sentence(&Said {
            dive: None,
            is_judged: false,
            ambiguous: 0,
            ..said()
        });
        assert_eq!(
            alone,
            "This is a map of 17677 Gaussians, half of them known to 0.021 m (one sigma)."
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
