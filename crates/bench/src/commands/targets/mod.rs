//! `echosplat bench targets`: every target of accuracy and robustness, and which are met.

mod chosen;

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::runs::{Outcomes, Spec};
use crate::targets::{self, Case, Row, Verdict};
use echosplat_metrics::{MapPoints, distance_between};
use echosplat_report::Report;
use serde_json::{Map, json};

use super::Findings;
use super::runs::{self, Job, Store};
use crate::arguments::TargetsBenchArguments;
use echosplat_service::maps;

/// # Errors
/// If nothing is chosen, or the runs cannot be kept or started.
pub(super) fn run(arguments: &TargetsBenchArguments) -> anyhow::Result<Findings> {
    let cases = chosen::cases(arguments)?;
    let seeds = arguments.queue.seeds_of(&arguments.options);
    let mut store = Store::open(&arguments.options.out)?;
    let jobs = jobs(&cases, &seeds, &store);
    let mut outcomes = runs::make(&jobs, &mut store, &arguments.queue)?;
    compare_maps(&cases, &seeds, &store, &mut outcomes);
    results(&cases, &seeds, &outcomes)
}

/// Each run once, the first seed of all cases before the next seed of any.
fn wanted(cases: &[Case], seeds: &[u64]) -> Vec<Spec> {
    let of_seed = |seed: &u64| cases.iter().flat_map(|case| case.runs(*seed)).collect();
    runs::once(seeds.iter().flat_map::<Vec<Spec>, _>(of_seed).collect())
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

fn results(cases: &[Case], seeds: &[u64], outcomes: &Outcomes) -> anyhow::Result<Findings> {
    let rows: Vec<Row> = cases
        .iter()
        .flat_map(|case| case.rows(seeds, outcomes))
        .collect();
    let left_out = runs::left_out(&wanted(cases, seeds), outcomes);
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
    fields.insert("runs".to_owned(), runs::to_json(outcomes)?);
    fields.insert("left_out".to_owned(), json!(left_out));
    let highlights = [
        ("rows passed", passed),
        ("failed", failed),
        ("incomplete", incomplete),
        ("runs left out", left_out.len()),
    ];
    let notes = left_out.iter().map(|name| format!("Left out: {name}."));
    Ok(Findings {
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
