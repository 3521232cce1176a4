//! One file per command.

mod calibrate;
mod check;
mod compare;
mod demo;
mod dive_report;
mod emulate;
mod evaluate;
mod export;
mod georeference;
mod handout;
mod info;
mod judging;
mod measure;
mod probe;
mod recover;
mod render;
mod replay;
mod report;
mod run;
mod simulate;
mod watch;

#[cfg(test)]
pub(crate) use run::configuration as run_configuration;

use std::time::{Duration, Instant};

use echosplat_metrics::{MapPoints, Truth, evaluate};
use echosplat_model::Snapshot;
use echosplat_report::table;

use crate::arguments::Command;
use crate::config::{BASIC_TOML, DEFAULT_TOML};
use crate::exit::Finish;
use crate::logging;
use crate::pipeline::{OnStatus, Phase, Status};
use crate::supervisor::arm_drill;

/// Runs one of the commands.
///
/// # Errors
/// What stopped the command; [`crate::exit::end`] gives its exit code.
pub fn run(command: Command) -> anyhow::Result<Finish> {
    if let Command::Demo(_) | Command::Run(_) | Command::Replay(_) = &command {
        arm_drill()?;
    }
    match command {
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Emulate(arguments) => emulate::run(&arguments),
        Command::Probe(arguments) => probe::run(&arguments),
        Command::Watch(arguments) => watch::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Recover(arguments) => recover::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Measure(arguments) => measure::run(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Georeference(arguments) => georeference::run(&arguments),
        Command::Config { basic } => {
            let text = if basic { BASIC_TOML } else { DEFAULT_TOML };
            logging::print(text.trim_end());
            Ok(Finish::Done)
        }
        Command::Check { file } => check::run(&file),
    }
}

/// Away from a terminal the figures are a line of the log, so often.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// A line of live figures, renewed in place on a terminal, else one every ten seconds.
fn show_figures() -> OnStatus {
    let figures = logging::figures_line();
    let mut said_s = None;
    let mut line = Instant::now();
    let mut before = 0;
    Box::new(move |status| {
        let prediction = status.report.prediction;
        // A line for each moment: on a terminal or not, error against time can be read.
        if let Some(found) =
            prediction.filter(|found| said_s.replace(found.dive_s) != Some(found.dive_s))
        {
            tracing::info!(
                "{:.0} s: {:+.4} nats per bin above a constant on {} held-out pings",
                found.dive_s,
                found.gain_per_bin,
                found.pings
            );
        }
        let is_line_due = status.is_final || line.elapsed() >= LINE_EVERY;
        let text = figures_of(status, before);
        if is_line_due && !logging::is_terminal() {
            tracing::info!("{text}");
        }
        if is_line_due {
            line = Instant::now();
            before = status.report.mapper.confident;
        }
        figures.set_message(text);
        figures.tick();
    })
}

/// What came, what became of it, and what the map gained since it had `before` Gaussians.
fn figures_of(status: &Status, before: u64) -> String {
    let report = &status.report;
    let progress = match (status.phase, status.input_share) {
        (Phase::Finishing, _) => " · finishing".to_owned(),
        (_, Some(share)) => format!(" · {:.0} % of the log", 100.0 * share),
        (_, None) => String::new(),
    };
    let notice = status.newest_notice.as_ref();
    let notice = notice.map_or(String::new(), |notice| format!(" · {notice}"));
    let gained = report.mapper.confident as i64 - before as i64;
    format!(
        "{:.1} s{progress} · {} pings received, {:.0}/s, {} mapped, {} without pose · {} Gaussians \
         ({gained:+}) and {} ambiguous{notice}",
        report.dive_s,
        status.ledger.received,
        status.rates.pings_per_s,
        report.pings_mapped,
        status.ledger.without_pose,
        report.mapper.confident,
        report.mapper.ambiguous,
    )
}

/// Logs the figures of a finished map.
fn judge(truth: &Truth, snapshot: &Snapshot) {
    let metrics = evaluate(&MapPoints::from(snapshot), truth);
    for (name, value) in table::facts(&metrics) {
        tracing::info!("{name}: {value}");
    }
}
