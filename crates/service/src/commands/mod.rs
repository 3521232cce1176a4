//! One file per command.

mod bench;
mod calibrate;
mod check;
mod demo;
mod emulate;
mod evaluate;
mod judging;
mod render;
mod replay;
mod run;
mod simulate;
mod watch;

use std::path::Path;

use echosplat_evaluation::{MapPoints, evaluate, table};
use echosplat_model::Snapshot;
use serde_json::Value;

use crate::arguments::Command;
use crate::config::DEFAULT_TOML;
use crate::exit::Finish;
use crate::pipeline::OnStatus;
use crate::{logging, truth};

/// # Errors
/// What stopped the command; `exit::code_of` gives its exit code.
pub(crate) fn run(command: Command) -> anyhow::Result<Finish> {
    match command {
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Emulate(arguments) => emulate::run(&arguments),
        Command::Watch(arguments) => watch::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Config => {
            logging::print(DEFAULT_TOML.trim_end());
            Ok(Finish::Done)
        }
        Command::Check { file } => check::run(&file),
    }
}

/// A line of live figures on a terminal.
fn show_figures() -> OnStatus {
    let figures = logging::figures_line();
    let mut said_s = None;
    Box::new(move |status| {
        let prediction = status.report.prediction;
        // A line for each moment: on a terminal or not, error against time can be read.
        if let Some(found) =
            prediction.filter(|found| said_s.replace(found.dive_s) != Some(found.dive_s))
        {
            tracing::info!(
                "{:.0} s: {:+.4} nats per bin above a constant on {} held-back pings",
                found.dive_s,
                found.gain_per_bin,
                found.pings
            );
        }
        figures.set_message(format!(
            "{:.1} s · {} pings, {:.0}/s · {} + {} Gaussians",
            status.report.dive_s,
            status.report.pings_mapped,
            status.rates.mapped_per_s,
            status.report.mapper.confident,
            status.report.mapper.ambiguous,
        ));
        figures.tick();
    })
}

/// The figures of a finished map, if there is a truth to judge it by; also logged.
///
/// # Errors
/// If the truth cannot be read.
fn judge(truth: Option<&Path>, snapshot: &Snapshot) -> anyhow::Result<Option<Value>> {
    let Some(path) = truth else { return Ok(None) };
    let metrics = evaluate(&MapPoints::from(snapshot), &truth::load(path)?);
    for (name, value) in table::facts(&metrics) {
        tracing::info!("{name}: {value}");
    }
    Ok(Some(serde_json::to_value(metrics)?))
}
