//! `echosplat bench error-time`: error against compute time, counted work and dive time, of several
//! methods; and what each setting trades.

use crate::error_time::{
    self, Case, Endings, Omission, Sweep, case_section, endings, omissions_section, sweep_section,
};
use crate::runs::{Ending, Outcomes, Spec};
use anyhow::anyhow;
use echosplat_mapper::{Mapper, MapperConfig};
use echosplat_report::Report;
use echosplat_simulator::{DiveKind, NoiseLevel};
use serde_json::{Map, Value, json};

use super::Findings;
use super::runs;
use crate::arguments::ErrorTimeBenchArguments;
use echosplat_service::exit::Usage;

/// Scenes that settings are moved on.
const SWEPT: [&str; 2] = ["fence", "pier"];
/// Names the settings on the command line.
const SETTINGS: &str = "settings";

/// What is run.
struct Plan {
    cases: Vec<Case>,
    sweeps: Vec<Sweep>,
    seeds: Vec<u64>,
    omissions: Vec<Omission>,
}

/// # Errors
/// If nothing is chosen, or the runs cannot be kept or started.
pub(super) fn run(arguments: &ErrorTimeBenchArguments) -> anyhow::Result<Findings> {
    let mut plan = Plan::of(arguments)?;
    let specs = plan.specs();
    let (outcomes, omissions) = runs::make_or_omit(&specs, &arguments.options, &arguments.queue)?;
    plan.omissions.extend(omissions);
    results(&plan, &outcomes)
}

impl Plan {
    fn of(arguments: &ErrorTimeBenchArguments) -> anyhow::Result<Self> {
        let quick = arguments.options.quick;
        let all = error_time::cases(quick);
        let mut omissions = error_time::omissions(&all, quick);
        let only = &arguments.only;
        for name in only {
            if name != SETTINGS && !all.iter().any(|case| is_named(case, name)) {
                return Err(Usage::error(unknown(name, &all)));
            }
        }
        let is_chosen = |name: &str| only.is_empty() || only.iter().any(|only| only == name);
        let sweeps = match !quick && is_chosen(SETTINGS) {
            true => sweeps(arguments.options.seed)?,
            false => Vec::new(),
        };
        let (cases, others): (Vec<Case>, Vec<Case>) = all
            .into_iter()
            .partition(|case| only.is_empty() || only.iter().any(|name| is_named(case, name)));
        let others = others.iter().map(Case::name);
        omissions.extend(others.map(|name| Omission::new(name, "not asked for with --only")));
        if !quick && sweeps.is_empty() {
            omissions.push(Omission::new(SETTINGS, "not asked for with --only"));
        }
        Ok(Self {
            cases,
            sweeps,
            seeds: arguments.queue.seeds_of(&arguments.options),
            omissions,
        })
    }

    /// The first seed of all cases, then the settings, then dives cut short, then the other seeds.
    fn specs(&self) -> Vec<Spec> {
        let first = self.seeds.first().copied().unwrap_or_default();
        let of_seed = |seed: u64| {
            let own = self.cases.iter();
            own.flat_map(move |case| case.specs(seed, first))
        };
        let swept = self.sweeps.iter().flat_map(Sweep::specs);
        let cut = |seed: u64| self.cases.iter().flat_map(move |case| case.cut_specs(seed));
        let others = self.seeds.iter().skip(1);
        let others = others.flat_map(|seed| of_seed(*seed).chain(cut(*seed)));
        let of_first = of_seed(first).chain(swept).chain(cut(first));
        runs::once(of_first.chain(others).collect())
    }
}

fn is_named(case: &Case, name: &str) -> bool {
    let full = format!("{}/{}/{}", case.scene, case.dive, case.noise);
    full == name || full.starts_with(&format!("{name}/"))
}

fn unknown(name: &str, all: &[Case]) -> String {
    let mut scenes: Vec<&str> = all.iter().map(|case| case.scene).collect();
    scenes.sort_unstable();
    scenes.dedup();
    format!(
        "--only {name}: there are {SETTINGS}, the scenes {}, SCENE/DIVE and SCENE/DIVE/NOISE",
        scenes.join(", ")
    )
}

fn sweeps(seed: u64) -> anyhow::Result<Vec<Sweep>> {
    let edges: Vec<(&'static str, f64)> = SWEPT
        .into_iter()
        .map(|scene| Ok((scene, automatic_voxel_m(scene, seed)?)))
        .collect::<anyhow::Result<_>>()?;
    Ok(error_time::sweeps(&edges, seed))
}

/// The edge of a voxel that the mapper takes by itself, from what it says after one ping.
fn automatic_voxel_m(scene: &str, seed: u64) -> anyhow::Result<f64> {
    let spec = Spec {
        duration_s: Some(1.0),
        ..Spec::new(scene, DiveKind::Survey, NoiseLevel::Nominal, seed)
    };
    let sonar = runs::sonar(&spec)?;
    let trajectory = sonar.dive().trajectory(1.0);
    let ping = sonar.posed_ping(0, &trajectory);
    let ping = ping.ok_or_else(|| anyhow!("{scene}: the first ping has no pose"))?;
    let mut mapper = Mapper::new(MapperConfig {
        threads: 1,
        slice_pings: 1,
        ..MapperConfig::default()
    })?;
    mapper.insert(&ping);
    Ok(mapper.status().voxel_m.into())
}

fn results(plan: &Plan, outcomes: &Outcomes) -> anyhow::Result<Findings> {
    let seeds = &plan.seeds;
    let own = plan.cases.iter();
    let endings: Vec<Endings> = own
        .flat_map(|case| endings(case, seeds, outcomes))
        .collect();
    let mut sections: Vec<_> = plan
        .cases
        .iter()
        .map(|case| case_section(case, seeds, outcomes))
        .collect();
    sections.extend(
        plan.sweeps
            .iter()
            .map(|sweep| sweep_section(sweep, outcomes)),
    );
    sections.push(omissions_section(&plan.omissions));
    let count = |ending: Ending| {
        let ended = outcomes.0.values().filter(|run| Ending::of(run) == ending);
        ended.count()
    };
    let highlights =
        Ending::ALL.map(|ending| (ending.as_str().to_owned(), count(ending).to_string()));
    let failed = outcomes.0.iter();
    let failures =
        failed.filter_map(|(name, run)| Some(format!("{name}: {}", run.as_ref().err()?)));
    Ok(Findings {
        name: "error-time",
        fields: fields(plan, &endings, outcomes)?,
        report: Report {
            title: "Error against run time".to_owned(),
            highlights: highlights.into(),
            seeds: seeds.clone(),
            sections,
            ..Report::default()
        },
        text: format!(
            "{}{} runs, {} kinds of runs omitted",
            error_time::text(&endings),
            outcomes.0.len(),
            plan.omissions.len()
        ),
        failures: failures.collect(),
    })
}

fn fields(
    plan: &Plan,
    endings: &[Endings],
    outcomes: &Outcomes,
) -> anyhow::Result<Map<String, Value>> {
    let curves = |case: &Case| {
        let curves = case.curves(&plan.seeds, outcomes);
        json!({"case": case.name(), "curves": curves})
    };
    let sweep = |sweep: &Sweep| json!({"scene": sweep.scene, "points": sweep.points(outcomes)});
    let mut fields = Map::new();
    fields.insert("seeds".to_owned(), json!(plan.seeds));
    fields.insert("cases".to_owned(), plan.cases.iter().map(curves).collect());
    fields.insert("endings".to_owned(), json!(endings));
    fields.insert(
        "settings".to_owned(),
        plan.sweeps.iter().map(sweep).collect(),
    );
    fields.insert("omissions".to_owned(), json!(plan.omissions));
    fields.insert("runs".to_owned(), runs::to_json(outcomes)?);
    Ok(fields)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::{Bench, parsed};

    fn plan(more: &[&str]) -> anyhow::Result<Plan> {
        match parsed("error-time", more) {
            Bench::ErrorTime(arguments) => Plan::of(&arguments),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn dives_are_chosen_by_scene_dive_and_noise() {
        let count = |more: &[&str]| plan(more).unwrap().cases.len();
        assert!(count(&["--quick"]) < count(&[]));
        assert_eq!(count(&["--only", "fence/survey/harsh"]), 1);
        assert_eq!(count(&["--only", "fence/survey"]), 3);
        assert_eq!(count(&["--only", "settings"]), 0);
        let error = plan(&["--only", "fense"]).err().unwrap();
        assert!(error.to_string().contains("pier, pipeline"), "{error}");
    }

    #[test]
    fn settings_come_after_the_first_seed_and_what_is_not_asked_for_is_listed() {
        let all = plan(&["--seeds", "2"]).unwrap();
        let specs = all.specs();
        let at = |wanted: fn(&Spec) -> bool| specs.iter().position(wanted).unwrap();
        assert!(
            at(|spec| spec.settings.contains_key("mapper.slice_pings")) < at(|spec| spec.seed == 2)
        );
        let one = plan(&["--only", "wall"]).unwrap();
        assert!(one.sweeps.is_empty());
        let listed = |what: &str| one.omissions.iter().any(|omission| omission.what == what);
        assert!(listed("settings") && listed("pier, survey, nominal"));
    }
}
