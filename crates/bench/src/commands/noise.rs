//! `echosplat bench noise`: one survey with its echoes 40 to 6 dB over the noise, and what becomes of its
//! map.

use crate::noise_sweep::{self, Level, Row, levels, section};
use crate::runs::{Outcomes, Spec};
use echosplat_report::Report;
use serde_json::{Map, json};

use super::Findings;
use super::runs;
use crate::arguments::NoiseBenchArguments;

/// # Errors
/// If the runs cannot be kept or started.
pub(super) fn run(arguments: &NoiseBenchArguments) -> anyhow::Result<Findings> {
    let levels = levels(arguments.options.quick);
    let seeds = arguments.queue.seeds_of(&arguments.options);
    let specs = specs(&levels, &seeds);
    let (outcomes, omissions) = runs::make_or_omit(&specs, &arguments.options, &arguments.queue)?;
    let left_out: Vec<String> = omissions
        .into_iter()
        .map(|omission| omission.what)
        .collect();
    results(&levels, &seeds, &outcomes, &left_out)
}

/// All levels of the first seed before those of the next.
fn specs(levels: &[Level], seeds: &[u64]) -> Vec<Spec> {
    let of_seed = |seed: &u64| levels.iter().map(|level| level.spec(*seed)).collect();
    seeds.iter().flat_map::<Vec<Spec>, _>(of_seed).collect()
}

fn results(
    levels: &[Level],
    seeds: &[u64],
    outcomes: &Outcomes,
    left_out: &[String],
) -> anyhow::Result<Findings> {
    let rows: Vec<Row> = noise_sweep::rows(levels, seeds, outcomes);
    let missed = noise_sweep::failures(&rows);
    let failed = outcomes.0.iter();
    let failed = failed.filter_map(|(name, run)| Some(format!("{name}: {}", run.as_ref().err()?)));
    let mut fields = Map::new();
    fields.insert("seeds".to_owned(), json!(seeds));
    fields.insert("levels".to_owned(), json!(rows));
    fields.insert("runs".to_owned(), runs::to_json(outcomes)?);
    fields.insert("left_out".to_owned(), json!(left_out));
    let highlight = |name: &str, count: usize| (name.to_owned(), count.to_string());
    Ok(Findings {
        name: "noise",
        fields,
        report: Report {
            title: "Error against noise".to_owned(),
            highlights: vec![
                highlight("levels", rows.len()),
                highlight("beyond a limit", missed.len()),
                highlight("runs left out", left_out.len()),
            ],
            seeds: seeds.to_vec(),
            notes: left_out
                .iter()
                .map(|name| format!("Left out: {name}."))
                .collect(),
            sections: vec![section(&rows)],
            ..Report::default()
        },
        text: format!(
            "{}{} of {} levels beyond a limit, {} runs left out",
            noise_sweep::text(&rows),
            missed.len(),
            rows.len(),
            left_out.len()
        ),
        failures: failed.chain(missed).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_of_the_first_seed_comes_before_the_next_seed() {
        let levels = levels(true);
        let specs = specs(&levels, &[4, 5]);
        assert_eq!(specs.len(), 2 * levels.len());
        assert!(specs[..levels.len()].iter().all(|spec| spec.seed == 4));
    }

    #[test]
    fn without_runs_nothing_is_claimed() {
        let left_out = ["a".to_owned()];
        let found = results(&levels(false), &[1], &Outcomes::default(), &left_out).unwrap();
        assert!(found.failures.is_empty() && found.text.contains("1 runs left out"));
        assert!(found.report.to_html().contains("incomplete"));
    }
}
