//! `echosplat bench …`: what the program can do, measured. Timing, files and words are here; what
//! is computed is in the crates that own it.
//!
//! A bench is a file beside this one that returns [`Findings`], a line in [`run`] and a variant of
//! [`Bench`].

mod ablation;
mod all;
mod error_time;
mod faults;
mod kernels;
mod long;
mod machine;
mod noise;
mod paper;
mod report;
mod runs;
mod stability;
mod targets;

use std::path::Path;

use anyhow::{Context, anyhow};
use echosplat_report::Report;
use serde_json::{Map, Value, json};

use crate::arguments::{Bench, BenchArguments, BenchOptions};
use echosplat_service::exit::Finish;
use echosplat_service::logging;
use machine::Machine;

/// What a bench comes to.
struct Findings {
    /// Name of its files.
    name: &'static str,
    /// Its own fields of the JSON object.
    fields: Map<String, Value>,
    /// Machine and, if there are none, seeds are filled in when it is written.
    report: Report,
    /// For people at a terminal.
    text: String,
    /// One line for each thing that is not as it must be.
    failures: Vec<String>,
}

/// # Errors
/// If something cannot be run or written, or is not as it must be.
pub fn run(arguments: &BenchArguments) -> anyhow::Result<Finish> {
    match &arguments.bench {
        Bench::Kernels(options) => publish(kernels::run(options)?, options),
        Bench::Stability(options) => publish(stability::run(options)?, options),
        Bench::Paper(arguments) => publish(paper::run(arguments)?, &arguments.options),
        Bench::Targets(arguments) => publish(targets::run(arguments)?, &arguments.options),
        Bench::ErrorTime(arguments) => publish(error_time::run(arguments)?, &arguments.options),
        Bench::Noise(arguments) => publish(noise::run(arguments)?, &arguments.options),
        Bench::Ablation(arguments) => publish(ablation::run(arguments)?, &arguments.options),
        Bench::Long(arguments) => publish(long::run(arguments)?, &arguments.options),
        Bench::Faults(arguments) => faults::run(arguments),
        Bench::Soak(arguments) => faults::soak::run(arguments),
        Bench::Small(arguments) => faults::small::run(arguments),
        Bench::All(arguments) => all::run(arguments),
        Bench::Report(arguments) => report::run(arguments),
        Bench::Run(arguments) => runs::run_one(arguments),
    }
}

/// Writes the two files, prints, and fails if anything failed.
fn publish(results: Findings, options: &BenchOptions) -> anyhow::Result<Finish> {
    let failures = results.failures.clone();
    let says = if options.json { Says::Json } else { Says::Text };
    save(results, options, says)?;
    verdict(&failures)
}

/// What is printed on standard output.
#[derive(Debug, Clone, Copy)]
enum Says {
    Nothing,
    Json,
    Text,
}

/// Writes the two files and prints.
fn save(results: Findings, options: &BenchOptions, says: Says) -> anyhow::Result<()> {
    let machine = Machine::this();
    let json = object(&results, options, &machine);
    let mut report = results.report;
    report.subtitle = format!("echosplat bench {}", results.name);
    report.machine.extend(machine.facts());
    if report.seeds.is_empty() {
        report.seeds = vec![options.seed];
    }
    let path = |extension: &str| options.out.join(format!("{}.{extension}", results.name));
    std::fs::create_dir_all(&options.out)
        .with_context(|| format!("cannot make {}", options.out.display()))?;
    write(
        &path("json"),
        &(serde_json::to_string_pretty(&json)? + "\n"),
    )?;
    write(&path("html"), &report.to_html())?;
    match says {
        Says::Nothing => {}
        Says::Json => logging::print(&serde_json::to_string(&json)?),
        Says::Text => {
            logging::print(results.text.trim_end());
            let (json, html) = (path("json"), path("html"));
            logging::print(&format!("Written: {}, {}", json.display(), html.display()));
        }
    }
    Ok(())
}

fn object(results: &Findings, options: &BenchOptions, machine: &Machine) -> Value {
    let mut object = Map::new();
    object.insert("bench".to_owned(), json!(results.name));
    object.insert("machine".to_owned(), json!(machine));
    object.insert("seed".to_owned(), json!(options.seed));
    object.insert("quick".to_owned(), json!(options.quick));
    object.insert("passed".to_owned(), json!(results.failures.is_empty()));
    object.extend(results.fields.clone());
    Value::Object(object)
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

fn verdict(failures: &[String]) -> anyhow::Result<Finish> {
    match failures {
        [] => Ok(Finish::Done),
        [only] => Err(anyhow!("failed: {only}")),
        [first, more @ ..] => Err(anyhow!("failed: {first}; and {} more", more.len())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_failed_is_an_error_and_what_did_not_is_none() {
        assert_eq!(verdict(&[]).unwrap(), Finish::Done);
        let one = verdict(&["a".to_owned()]).unwrap_err().to_string();
        assert_eq!(one, "failed: a");
        let two = verdict(&["a".to_owned(), "b".to_owned()]).unwrap_err();
        assert_eq!(two.to_string(), "failed: a; and 1 more");
    }
}
