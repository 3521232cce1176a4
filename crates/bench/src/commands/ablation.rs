//! `echosplat bench ablation`: each optional feature of the mapper on, off and as it chooses by
//! itself.

use std::collections::BTreeMap;

use crate::ablation::{
    self, Case, FEATURES, Feature, Row, State, Variant, case_section, check, check_section,
    variants,
};
use crate::error_time::{Omission, omissions_section};
use crate::runs::{Outcomes, Spec};
use echosplat_report::Report;
use serde_json::{Map, json};

use super::Findings;
use super::runs;
use crate::arguments::AblationBenchArguments;
use echosplat_service::config::Config;
use echosplat_service::exit::Usage;

/// What is run.
struct Plan {
    cases: Vec<Case>,
    features: Vec<Feature>,
    variants: Vec<Variant>,
    seeds: Vec<u64>,
    omissions: Vec<Omission>,
}

/// # Errors
/// If nothing is chosen, or the runs cannot be kept or started.
pub(super) fn run(arguments: &AblationBenchArguments) -> anyhow::Result<Findings> {
    let mut plan = Plan::of(arguments)?;
    let specs = plan.specs();
    let (outcomes, omissions) = runs::make_or_omit(&specs, &arguments.options, &arguments.queue)?;
    plan.omissions.extend(omissions);
    results(&plan, &outcomes)
}

impl Plan {
    fn of(arguments: &AblationBenchArguments) -> anyhow::Result<Self> {
        let quick = arguments.options.quick;
        let all = ablation::cases(quick);
        let scenes: Vec<&str> = all.iter().map(|case| case.scene).collect();
        for name in &arguments.only {
            if !scenes.contains(&name.as_str()) {
                let there = scenes.join(", ");
                return Err(Usage::error(format!(
                    "--only {name}: there are the scenes {there}"
                )));
            }
        }
        let only = &arguments.only;
        let is_chosen = |case: &Case| only.is_empty() || only.iter().any(|n| n == case.scene);
        let (features, mut omissions) = features(arguments);
        if quick {
            let why = "--quick: short dives of three scenes, one seed";
            omissions.push(Omission::new(
                "each feature by itself; the other scenes",
                why,
            ));
        }
        let cases: Vec<Case> = all.into_iter().filter(is_chosen).collect();
        if !quick {
            omissions.extend(ablation::omissions(&cases));
        }
        Ok(Self {
            cases,
            variants: variants(&features, quick),
            features,
            seeds: arguments.queue.seeds_of(&arguments.options),
            omissions,
        })
    }

    fn specs(&self) -> Vec<Spec> {
        let specs = ablation::specs(&self.cases, &self.features, &self.variants, &self.seeds);
        runs::once(specs)
    }
}

/// The features that the configuration knows; the others are listed.
fn features(arguments: &AblationBenchArguments) -> (Vec<Feature>, Vec<Omission>) {
    let others = arguments.part.iter().map(|(key, values)| Feature {
        name: key.rsplit('.').next().unwrap_or(key).to_owned(),
        key: key.clone(),
        values: values.clone(),
    });
    let all: Vec<Feature> = match arguments.part.is_empty() {
        true => FEATURES.into_iter().map(Feature::named).collect(),
        false => others.collect(),
    };
    let (known, unknown): (Vec<Feature>, Vec<Feature>) = all.into_iter().partition(is_known);
    let why = "the configuration has no such setting";
    let omissions = unknown
        .into_iter()
        .map(|feature| Omission::new(feature.key, why));
    (known, omissions.collect())
}

fn is_known(feature: &Feature) -> bool {
    State::ALL.into_iter().all(|state| {
        let setting = (feature.key.clone(), feature.value(state).to_owned());
        Config::of_settings(&BTreeMap::from([setting])).is_ok()
    })
}

fn results(plan: &Plan, outcomes: &Outcomes) -> anyhow::Result<Findings> {
    let Plan {
        cases,
        features,
        variants,
        seeds,
        omissions,
    } = plan;
    let rows_of = |case: &Case| ablation::rows(case, features, variants, seeds, outcomes);
    let by_case: Vec<Vec<Row>> = cases.iter().map(rows_of).collect();
    let rows: Vec<Row> = by_case.concat();
    let check = check(cases, features, variants, seeds, outcomes);
    let mut sections = vec![check_section(&check)];
    sections.extend(by_case.iter().map(|rows| case_section(rows)));
    sections.push(omissions_section(omissions));
    let mut fields = Map::new();
    fields.insert("seeds".to_owned(), json!(seeds));
    fields.insert("rows".to_owned(), json!(rows));
    fields.insert("check".to_owned(), json!(check));
    fields.insert("omissions".to_owned(), json!(omissions));
    fields.insert("runs".to_owned(), runs::to_json(outcomes)?);
    let failed = outcomes.0.iter();
    let failed = failed.filter_map(|(name, run)| Some(format!("{name}: {}", run.as_ref().err()?)));
    let highlight = |name: &str, count: usize| (name.to_owned(), count.to_string());
    Ok(Findings {
        name: "ablation",
        fields,
        report: Report {
            title: "What each feature is worth".to_owned(),
            highlights: vec![
                highlight("features", features.len()),
                highlight("fixed settings better than auto", check.beaten_by.len()),
                highlight("scenes where auto saves", check.saves_on.len()),
            ],
            seeds: seeds.clone(),
            sections,
            ..Report::default()
        },
        text: format!(
            "{}{} features, {} variants, {} kinds of runs omitted",
            ablation::text(&rows),
            features.len(),
            variants.len(),
            omissions.len()
        ),
        // Short dives of a quick look leave no room for savings.
        failures: match variants.len() > 3 {
            true => failed.chain(check.failures()).collect(),
            false => failed.collect(),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::{Bench, parsed};

    fn plan(more: &[&str]) -> anyhow::Result<Plan> {
        match parsed("ablation", more) {
            Bench::Ablation(arguments) => Plan::of(&arguments),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn features_that_the_configuration_does_not_know_are_listed() {
        let words = [
            "--part",
            "mapper.workout_passes=32,4,16",
            "--part",
            "mapper.finish_pases=32,4,16",
            "--seeds",
            "2",
        ];
        let plan = plan(&words).unwrap();
        assert_eq!(plan.features.len(), 1);
        assert_eq!(plan.omissions[0].what, "mapper.finish_pases");
        // A single feature on is everything on, so that each feature alone adds nothing; of the
        // slowest dive there is one seed.
        assert_eq!(plan.variants.len(), 5);
        assert_eq!(plan.specs().len(), 3 * (2 * plan.cases.len() - 1));
    }

    #[test]
    fn scenes_are_chosen_by_name() {
        assert_eq!(plan(&["--only", "wall"]).unwrap().cases.len(), 1);
        let error = plan(&["--only", "wal"]).err().unwrap();
        assert!(error.to_string().contains("pipeline"), "{error}");
    }
}
