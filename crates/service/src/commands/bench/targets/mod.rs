//! `echosplat bench targets`: every target of accuracy and robustness, and which are met.
//!
//! Each run is a process of its own, so that its memory and processor time are its own and one
//! that dies is a row that failed. What is done is kept in a file of JSON lines beside the report:
//! the same program asked again goes on from there.

mod chosen;
mod held_out;
mod one;
mod queue;
mod store;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use echosplat_evaluation::report::Report;
use echosplat_evaluation::targets::{self, Case, Results as Outcomes, Row, Spec, Verdict};
use echosplat_evaluation::{MapPoints, distance_between};
use serde_json::{Map, Value, json};

use super::Results;
use crate::arguments::TargetsBenchArguments;
use crate::maps;
use crate::signals::Stop;
pub(super) use one::run_one;
use queue::{Job, Queue};
use store::Store;

/// # Errors
/// If nothing is chosen, or the runs cannot be kept or started.
pub(super) fn run(arguments: &TargetsBenchArguments) -> anyhow::Result<Results> {
    let cases = chosen::cases(arguments)?;
    let seeds = chosen::seeds(arguments);
    let mut store = Store::open(&arguments.options.out)?;
    let jobs = jobs(&cases, &seeds, &store);
    let all = jobs.len();
    let left = jobs.into_iter().filter(|job| !store.has(job)).collect();
    let budget_s = arguments.budget.map(|minutes| 60.0 * minutes);
    let queue = Queue {
        jobs: left,
        all,
        at_once: arguments.jobs as usize,
        deadline: budget_s.map(|seconds| Instant::now() + Duration::from_secs_f64(seconds)),
        stop: Stop::on_signals()?,
    };
    let failures = queue.run(&mut store)?;
    let mut outcomes = store.outcomes(&wanted(&cases, &seeds));
    let failed = failures.into_iter().map(|(name, why)| (name, Err(why)));
    outcomes.0.extend(failed);
    compare_maps(&cases, &seeds, &store, &mut outcomes);
    results(&cases, &seeds, &outcomes)
}

/// Each run once, the first seed of all cases before the next seed of any.
fn wanted(cases: &[Case], seeds: &[u64]) -> Vec<Spec> {
    let runs = |seed: &u64| cases.iter().flat_map(|case| case.runs(*seed)).collect();
    let mut specs: Vec<Spec> = seeds.iter().flat_map::<Vec<Spec>, _>(runs).collect();
    let mut seen = std::collections::BTreeSet::new();
    specs.retain(|spec| seen.insert(spec.name()));
    specs
}

fn jobs(cases: &[Case], seeds: &[u64], store: &Store) -> Vec<Job> {
    let comparing = cases.iter().filter(|case| case.compares_maps);
    let kept = comparing.flat_map(|case| seeds.iter().flat_map(|seed| case.runs(*seed)));
    let kept: std::collections::BTreeSet<String> = kept.map(|spec| spec.name()).collect();
    let job = |spec: Spec| Job {
        map: kept.contains(&spec.name()).then(|| store.map_of(&spec)),
        spec,
    };
    wanted(cases, seeds).into_iter().map(job).collect()
}

/// Fills in how far maps of dives that took place elsewhere are from the one that did not.
fn compare_maps(cases: &[Case], seeds: &[u64], store: &Store, outcomes: &mut Outcomes) {
    let mut read: BTreeMap<PathBuf, Option<MapPoints>> = BTreeMap::new();
    let mut points = |spec: &Spec| {
        let path = store.map_of(spec);
        let points = read.entry(path.clone()).or_insert_with(|| {
            let map = maps::read(&path).ok()?;
            let points = MapPoints::new(map.origin_m, &map.gaussians);
            Some(points.moved(&spec.placement.pose().inverse()))
        });
        points.as_ref().map(MapPoints::positions)
    };
    let comparing = cases.iter().filter(|case| case.compares_maps);
    for runs in comparing.flat_map(|case| seeds.iter().map(|seed| case.runs(*seed))) {
        let [elsewhere, here] = &runs[..] else {
            continue;
        };
        let apart = points(elsewhere).zip(points(here));
        if let Some(Ok(outcome)) = outcomes.0.get_mut(&elsewhere.name()) {
            outcome.from_unmoved_m = apart.map(|(a, b)| distance_between(&a, &b));
        }
    }
}

fn results(cases: &[Case], seeds: &[u64], outcomes: &Outcomes) -> anyhow::Result<Results> {
    let rows: Vec<Row> = cases
        .iter()
        .flat_map(|case| case.rows(seeds, outcomes))
        .collect();
    let left_out: Vec<String> = wanted(cases, seeds)
        .iter()
        .filter(|spec| outcomes.of(spec).is_none())
        .map(Spec::name)
        .collect();
    let count = |verdict| rows.iter().filter(|row| row.verdict == verdict).count();
    let [passed, failed, incomplete] =
        [Verdict::Passed, Verdict::Failed, Verdict::Incomplete].map(count);
    let summary = format!(
        "{passed} rows pass, {failed} fail, {incomplete} are incomplete; {} runs left out",
        left_out.len()
    );
    let mut fields = Map::new();
    fields.insert("seeds".to_owned(), json!(seeds));
    fields.insert("rows".to_owned(), serde_json::to_value(&rows)?);
    fields.insert("runs".to_owned(), runs_json(outcomes)?);
    fields.insert("left_out".to_owned(), json!(left_out));
    let highlights = [
        ("rows passed", passed),
        ("failed", failed),
        ("incomplete", incomplete),
        ("runs left out", left_out.len()),
    ];
    let notes = left_out.iter().map(|name| format!("Left out: {name}."));
    Ok(Results {
        name: "targets",
        fields,
        report: Report {
            title: "Targets".to_owned(),
            highlights: highlights
                .map(|(name, count)| (name.to_owned(), count.to_string()))
                .into(),
            seeds: seeds.to_vec(),
            notes: notes.collect(),
            sections: targets::sections(&rows, outcomes),
            ..Report::default()
        },
        text: targets::text(&rows) + &left_out_text(&left_out) + &summary,
        failures: rows.iter().filter_map(failure).collect(),
    })
}

fn runs_json(outcomes: &Outcomes) -> anyhow::Result<Value> {
    let run = |(name, result): (&String, &Result<targets::Outcome, String>)| {
        Ok(match result {
            Ok(outcome) => json!({"run": name, "outcome": serde_json::to_value(outcome)?}),
            Err(why) => json!({"run": name, "failed": why}),
        })
    };
    outcomes.0.iter().map(run).collect()
}

fn left_out_text(left_out: &[String]) -> String {
    left_out
        .iter()
        .map(|name| format!("left out: {name}\n"))
        .collect()
}

/// A row that claims nothing has not passed either.
fn failure(row: &Row) -> Option<String> {
    let said = match row.verdict {
        Verdict::Passed | Verdict::Shown => return None,
        Verdict::Incomplete if row.must.is_none() => return None,
        Verdict::Incomplete => format!("{} seeds left out", row.left_out_count),
        Verdict::Failed => {
            let shown = |value| row.unit.show(value);
            format!("median {}, worst {}", shown(row.median), shown(row.worst))
        }
    };
    Some(format!("{}, {}: {said}", row.case, row.quantity))
}
