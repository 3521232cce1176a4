//! `echosplat replay`: the pipeline from logs.

use echosplat_driver::{DriverConfig, SonarUrl};
use echosplat_pose::{PoseSource, PoseUrl};
use serde_json::Value;

use crate::arguments::ReplayArguments;
use crate::commands::{judge, show_figures};
use crate::config::{Config, Overrides};
use crate::exit::{Finish, Usage};
use crate::pipeline::{self, Gate, Hooks, Outcome, Patience, Poses, Setup};
use crate::signals::Stop;
use crate::{clock, inputs, logging, maps};

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
    let stop = Stop::on_signals()?;
    let mut epoch = clock::now().nanos().unsigned_abs();
    loop {
        let outcome = once(arguments, &config, epoch, &stop)?;
        let is_last = !arguments.repeat || stop.is_set();
        if is_last {
            return conclude(arguments, &config, &outcome);
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

fn once(
    arguments: &ReplayArguments,
    config: &Config,
    epoch: u64,
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
    let driver = |log: &std::path::PathBuf| DriverConfig {
        rate: arguments.rate,
        ..inputs::driver(config, SonarUrl::File(log.clone()))
    };
    arguments.logs.iter().map(driver).collect()
}

fn conclude(
    arguments: &ReplayArguments,
    config: &Config,
    outcome: &Outcome,
) -> anyhow::Result<Finish> {
    let mut summary = outcome.status.summary();
    let metrics = judge(config.output.truth.as_deref(), &outcome.snapshot)?;
    summary["metrics"] = metrics.map_or(Value::Null, |metrics| metrics);
    match arguments.json {
        true => logging::print(&summary.to_string()),
        false => logging::print(&outcome.status.account()),
    }
    Ok(outcome.finish())
}
