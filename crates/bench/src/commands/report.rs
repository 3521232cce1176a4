//! `echosplat bench report`: what this version reaches, as one file, and the page that is made of it.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::ValueEnum;
use echosplat_report::results::{Page, Results, with_accuracy};
use echosplat_service::exit::{Finish, Usage};
use echosplat_service::logging;

use super::Machine;
use super::runs::{self, Job, Store};
use crate::arguments::{QueueOptions, ReportBenchArguments, ReportPart};
use crate::report::{Made, Plan, results};
use crate::runs::Spec;

/// # Errors
/// If runs cannot be kept or started, are left or have failed; or if there is no page.
pub(super) fn run(arguments: &ReportBenchArguments) -> anyhow::Result<Finish> {
    match (&arguments.write_page, &arguments.from) {
        (Some(page), Some(from)) => write_page(page, from),
        _ => make(arguments),
    }
}

fn make(arguments: &ReportBenchArguments) -> anyhow::Result<Finish> {
    let plan = Plan::new(arguments.quick);
    let all = specs(&plan, ReportPart::value_variants());
    let asked = match arguments.only.is_empty() {
        true => all.clone(),
        false => specs(&plan, &arguments.only),
    };
    let mut store = Store::open(&cells(&arguments.out))?;
    let job = |spec: &Spec| Job {
        spec: spec.clone(),
        map: None,
    };
    let jobs: Vec<Job> = asked.iter().map(job).collect();
    let queue = QueueOptions {
        seeds: 1,
        budget: Some(arguments.budget),
        jobs: arguments.jobs,
    };
    let made = runs::make(&jobs, &mut store, &queue)?;
    let left = runs::left_out(&asked, &made);
    let failed = made.0.iter().filter(|(_, run)| run.is_err());
    let failed: Vec<String> = failed.map(|(name, _)| name.clone()).collect();
    // What was made before of the other parts belongs to the file too.
    let mut outcomes = store.outcomes(&all);
    outcomes.0.extend(made.0);
    let left_out = runs::left_out(&all, &outcomes);
    let results = results(&plan, &outcomes, facts(arguments, left_out));
    write(
        &arguments.out,
        &(serde_json::to_string_pretty(&results)? + "\n"),
    )?;
    logging::print(&said(&results, all.len(), &arguments.out));
    match (left.len(), failed.first()) {
        (0, None) => Ok(Finish::Done),
        (0, Some(name)) => Err(anyhow!("failed: {name}; {} in all", failed.len())),
        (count, _) => Err(anyhow!(
            "stopped or out of time with {count} runs left; asked again, it goes on where it was"
        )),
    }
}

/// Each once, of all these parts; the first seed of everything first, so that a report that is stopped tells of all parts.
fn specs(plan: &Plan, parts: &[ReportPart]) -> Vec<Spec> {
    let mut specs = runs::once(parts.iter().flat_map(|part| plan.specs(*part)).collect());
    specs.sort_by_key(|spec| spec.seed);
    specs
}

/// Where runs are kept as soon as they are made: `results.cells/` for `results.json`.
fn cells(out: &Path) -> PathBuf {
    out.with_extension("cells")
}

fn facts(arguments: &ReportBenchArguments, left_out: Vec<String>) -> Made {
    let machine = Machine::this();
    let quick = if arguments.quick { " --quick" } else { "" };
    Made {
        version: machine.version.to_owned(),
        commit: machine.commit.to_owned(),
        processor: machine.processor,
        cores: machine.cores,
        jobs: arguments.jobs,
        command: format!("echosplat bench report{quick} --out docs/results.json"),
        left_out,
    }
}

fn said(results: &Results, all: usize, out: &Path) -> String {
    let missed = results.targets.iter().filter(|row| row.verdict == "failed");
    format!(
        "{} of {all} runs made, {:.0} min of runs one after another, {} targets missed\nWritten: {}",
        all - results.left_out.len() - results.failed.len(),
        results.run_s / 60.0,
        missed.count(),
        out.display()
    )
}

/// All or nothing: who reads meanwhile finds the file before.
fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(failed)?;
    }
    let beside = path.with_extension("part");
    std::fs::write(&beside, text).with_context(failed)?;
    std::fs::rename(&beside, path).with_context(failed)
}

fn write_page(page: &Path, from: &Path) -> anyhow::Result<Finish> {
    let json = std::fs::read_to_string(from)
        .map_err(|error| Usage::error(format!("cannot read {}: {error}", from.display())))?;
    let folder = page.with_extension("");
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let made = Page::of(&json, &name)
        .map_err(|error| Usage::error(format!("{}: {error}", from.display())))?;
    clear(&folder)?;
    for (name, svg) in &made.charts {
        write(&folder.join(name), svg)?;
    }
    write(page, &made.text)?;
    logging::print(&format!(
        "Written: {}, {} charts",
        page.display(),
        made.charts.len()
    ));
    if let Some(readme) = readme_of(page) {
        let text = std::fs::read_to_string(&readme)?;
        let results: Results = serde_json::from_str(&json)?;
        if let Some(text) = with_accuracy(&text, &results) {
            write(&readme, &text)?;
            logging::print(&format!(
                "Written: the table of accuracy in {}",
                readme.display()
            ));
        }
    }
    Ok(Finish::Done)
}

/// Charts of a page before are not left beside the new ones.
fn clear(folder: &Path) -> anyhow::Result<()> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Ok(());
    };
    for entry in entries {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "svg") {
            std::fs::remove_file(&path)?;
        }
    }
    Ok(())
}

/// In the folder above the page's.
fn readme_of(page: &Path) -> Option<PathBuf> {
    let folder = page.parent()?;
    let readme = folder.join("..").join("README.md");
    readme.is_file().then_some(readme)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_alone_has_fewer_runs_and_none_twice() {
        let plan = Plan::new(false);
        let all = specs(&plan, ReportPart::value_variants());
        let one = specs(&plan, &[ReportPart::Length]);
        assert!(one.len() < all.len() && one.iter().all(|spec| all.contains(spec)));
        let mut names: Vec<String> = all.iter().map(Spec::name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), all.len());
        assert_eq!(
            cells(Path::new("docs/results.json")),
            Path::new("docs/results.cells")
        );
    }

    #[test]
    fn a_page_replaces_the_charts_before_and_the_readmes_table() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("docs/results")).unwrap();
        std::fs::write(at("docs/results/gone.svg"), "").unwrap();
        let mark = echosplat_report::results::ACCURACY_MARK;
        std::fs::write(at("README.md"), format!("{mark}\nold\n{mark}\n")).unwrap();
        let plan = Plan::new(true);
        let outcomes = crate::runs::Outcomes(
            specs(&plan, ReportPart::value_variants())
                .iter()
                .map(|spec| (spec.name(), Ok(crate::runs::sample_outcome(0.02, 100))))
                .collect(),
        );
        let parsed = crate::arguments::parsed("report", &["--quick"]);
        let crate::arguments::Bench::Report(arguments) = parsed else {
            panic!("it is a report");
        };
        let mut found = results(&plan, &outcomes, facts(&arguments, Vec::new()));
        // The README's noise, which the quick plan has not.
        found.accuracy[0].noise = "field".to_owned();
        write(
            &at("docs/results.json"),
            &serde_json::to_string(&found).unwrap(),
        )
        .unwrap();
        write_page(&at("docs/results.md"), &at("docs/results.json")).unwrap();
        let readme = std::fs::read_to_string(at("README.md")).unwrap();
        assert!(
            readme.contains("|0.020 m|") && !readme.contains("old"),
            "{readme}"
        );
        assert!(!at("docs/results/gone.svg").exists());
        assert!(at("docs/results/memory.svg").is_file());
        assert!(!at("docs/results.part").exists());
    }

    /// Every run made, as many moments as it has.
    fn whole(plan: &Plan) -> crate::runs::Outcomes {
        let specs = specs(plan, ReportPart::value_variants());
        let outcome = |spec: &Spec| crate::runs::Outcome {
            samples: echosplat_metrics::sample::run("", 1, 3.0, spec.moments).samples,
            ..crate::runs::sample_outcome(0.123, 100)
        };
        let made = specs.iter().map(|spec| (spec.name(), Ok(outcome(spec))));
        crate::runs::Outcomes(made.collect())
    }

    #[test]
    fn the_page_of_the_whole_plan_is_short_enough_with_most_targets_missed() {
        let parsed = crate::arguments::parsed("report", &[]);
        let crate::arguments::Bench::Report(arguments) = parsed else {
            panic!("it is a report");
        };
        let plan = Plan::new(false);
        let found = results(&plan, &whole(&plan), facts(&arguments, Vec::new()));
        let failed = found.targets.iter().filter(|row| row.verdict == "failed");
        assert!(failed.count() >= 20 && found.live.len() == 30);
        let page = Page::of(&serde_json::to_string(&found).unwrap(), "results").unwrap();
        assert!(page.charts.len() >= 5, "{:?}", page.charts.len());
        let words = page.text.split_whitespace().count();
        assert!(words > 800, "{words}");
    }

    #[test]
    fn a_file_of_something_else_gives_no_page() {
        let folder = tempfile::tempdir().unwrap();
        let from = folder.path().join("other.json");
        std::fs::write(&from, "{}").unwrap();
        let error = write_page(&folder.path().join("page.md"), &from).unwrap_err();
        assert!(error.to_string().contains("bench report"), "{error}");
        assert!(!folder.path().join("page.md").exists());
    }
}
