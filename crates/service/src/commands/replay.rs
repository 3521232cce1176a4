//! `echosplat replay`: the pipeline from logs.

use std::path::{Path, PathBuf};

use anyhow::Context;
use echosplat_driver::{DriverConfig, SonarUrl};
use echosplat_evaluation::report::Report;
use echosplat_evaluation::table;
use echosplat_pose::{PoseSource, PoseUrl};
use serde_json::Value;

use crate::arguments::ReplayArguments;
use crate::commands::judging::{Judge, Verdict};
use crate::commands::show_figures;
use crate::config::{Config, Overrides};
use crate::exit::{Finish, Usage};
use crate::pipeline::{self, Gate, Hooks, Outcome, Patience, Poses, Setup};
use crate::signals::Stop;
use crate::{clock, inputs, logging, maps, processor, truth};

/// # Errors
/// If something asked for cannot be, or the map cannot be written.
pub(crate) fn run(arguments: &ReplayArguments) -> anyhow::Result<Finish> {
    let config = configuration(arguments)?;
    for log in &arguments.logs {
        inputs::check_log(log)?;
    }
    if let Some(map) = &config.output.map {
        maps::prepare(map)?;
    }
    let report = report_path(arguments, &config);
    if arguments.report.is_some() && report.is_none() {
        return Err(Usage::error(
            "--report needs a --truth to judge by".to_owned(),
        ));
    }
    if let Some(report) = &report {
        maps::prepare(report)?;
    }
    let stop = Stop::on_signals()?;
    let mut epoch = clock::now().nanos().unsigned_abs();
    loop {
        let judge = judge(arguments, &config)?;
        let outcome = once(arguments, &config, epoch, judge.as_ref(), &stop)?;
        let is_last = !arguments.repeat || stop.is_set();
        if is_last {
            return conclude(arguments, &config, &outcome, judge, report.as_deref());
        }
        epoch += 1;
    }
}

fn configuration(arguments: &ReplayArguments) -> anyhow::Result<Config> {
    let file = arguments.poses.as_ref();
    let overrides = Overrides {
        pose: file
            .map(|file| PoseUrl::Tum(file.clone()))
            .or_else(|| arguments.pose.clone()),
        time_offset_s: arguments.time_offset_s,
        ..Overrides::default()
    };
    Config::assemble(&arguments.service, overrides)
}

/// Where `--report` says, or beside the map; nowhere without a truth.
fn report_path(arguments: &ReplayArguments, config: &Config) -> Option<PathBuf> {
    let output = &config.output;
    let beside = || output.map.as_ref().map(|map| map.with_extension("html"));
    output.truth.as_ref()?;
    arguments.report.clone().or_else(beside)
}

/// With `--json`, standard output is one object and nothing else.
fn judge(arguments: &ReplayArguments, config: &Config) -> anyhow::Result<Option<Judge>> {
    let Some(path) = &config.output.truth else {
        return Ok(None);
    };
    let truth = truth::load(path)?;
    Judge::start(move || truth, !arguments.json).map(Some)
}

fn once(
    arguments: &ReplayArguments,
    config: &Config,
    epoch: u64,
    judge: Option<&Judge>,
    stop: &Stop,
) -> anyhow::Result<Outcome> {
    let bus = match arguments.no_publish {
        true => None,
        false => Some(inputs::open_bus(config.bus.clone())?),
    };
    let source = inputs::poses(&config.pose.url, bus.as_deref())?;
    let is_file = matches!(source, PoseSource::File(_));
    let recorder = inputs::recorder(config)?;
    let setup = Setup {
        drivers: drivers(arguments, config),
        poses: Poses::new(&config.pose, source, Patience::HoldBack, recorder.clone())?,
        gate: Gate::new(arguments.start, arguments.end, config.output.duration_s),
        bus: bus.clone(),
        recorder,
        epoch,
        hooks: Hooks {
            observer: judge.map(Judge::observer),
            on_status: Some(show_figures()),
            ..Hooks::default()
        },
    };
    let outcome = pipeline::run(config, setup, stop);
    inputs::close_bus(bus);
    let outcome = outcome?;
    match is_file && !stop.is_set() && nothing_overlaps(&outcome) {
        true => Err(Usage::error(format!(
            "the poses of {} and the pings of {} have no time in common; --time-offset-s shifts \
             the pings",
            config.pose.url,
            arguments.logs[0].display()
        ))),
        false => Ok(outcome),
    }
}

fn nothing_overlaps(outcome: &Outcome) -> bool {
    let report = &outcome.status.report;
    report.pings_mapped == 0 && report.poses.join.pings_without_pose() > 0
}

fn drivers(arguments: &ReplayArguments, config: &Config) -> Vec<DriverConfig> {
    let driver = |log: &PathBuf| DriverConfig {
        rate: arguments.rate,
        ..inputs::driver(config, SonarUrl::File(log.clone()))
    };
    arguments.logs.iter().map(driver).collect()
}

fn conclude(
    arguments: &ReplayArguments,
    config: &Config,
    outcome: &Outcome,
    judge: Option<Judge>,
    report: Option<&Path>,
) -> anyhow::Result<Finish> {
    let mut summary = outcome.status.summary();
    summary["metrics"] = Value::Null;
    if let Some(judge) = judge {
        let verdict = judge.finish(outcome, config.sonar.seed)?;
        for (name, value) in table::facts(&verdict.metrics) {
            tracing::info!("{name}: {value}");
        }
        if let Some(report) = report {
            std::fs::write(report, html(&verdict, &summary))
                .with_context(|| format!("cannot write {}", report.display()))?;
            tracing::info!(report = %report.display(), "report written");
        }
        summary["metrics"] = serde_json::to_value(verdict.metrics)?;
    }
    match arguments.json {
        true => logging::print(&summary.to_string()),
        false => logging::print(&outcome.status.account()),
    }
    Ok(outcome.finish())
}

fn html(verdict: &Verdict, summary: &Value) -> String {
    let text = "The map at moments of the dive, and at its end, against the truth. Maps made only \
                to be judged count neither as work nor as time.";
    let section = verdict.section("Error against time".to_owned(), text.to_owned(), summary);
    let report = Report {
        title: "EchoSplat replay".to_owned(),
        subtitle: "echosplat replay".to_owned(),
        highlights: verdict.highlights(),
        machine: processor::description(),
        sections: vec![section],
        ..Report::default()
    };
    report.to_html()
}
