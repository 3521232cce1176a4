//! `echosplat bench faults`: the program itself is killed, unplugged, lied to and flooded, as it runs
//! on a vehicle: a child process, a simulated sonar behind a real link, poses on a real bus.
//!
//! Live runs are on the wall's clock, so cases are short and several run at a time.

mod clock;
mod disk;
mod grid;
mod group;
mod hostile;
mod kills;
mod outcome;
mod overload;
mod poses;
mod program;
mod recorded;
mod replayed;
mod shim;
mod side_by_side;
pub(super) mod small;
pub(super) mod soak;
mod sonar;
mod status;
mod trial;
mod unplugs;
mod vehicle;

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use echosplat_report::Report;
use echosplat_simulator::SimulatedSonar;
use serde_json::{Map, json};

use super::{Findings, Says, save};
use crate::arguments::{BenchOptions, FaultFamily, FaultsBenchArguments};
use echosplat_service::arguments::DiveArguments;
use echosplat_service::dives;
use echosplat_service::exit::Finish;
use echosplat_service::signals::Stop;
use outcome::Outcome;
use trial::{Link, Setup};

/// Longer than any case.
const DIVE_S: f64 = 7200.0;

/// One case, to be run.
type Case = Box<dyn Fn(&Setup) -> Outcome + Send + Sync>;

/// # Errors
/// If something cannot be run or written.
pub(super) fn run(arguments: &FaultsBenchArguments) -> anyhow::Result<Finish> {
    let program = arguments.program.as_ref();
    let setup = set_up(&arguments.options, program, "faults", DIVE_S)?;
    let cases = cases(arguments);
    let goes_on = || !setup.stop.is_set();
    let jobs = usize::try_from(arguments.jobs).unwrap_or(1);
    let case = |index: usize| cases[index](&setup);
    let mut outcomes = Vec::new();
    if chosen(arguments, FaultFamily::Kills) && arguments.kills > 0 {
        let one = |index| kills::one(&setup, index);
        let kills = side_by_side::run(arguments.kills, jobs, goes_on, one, |_| {});
        let outcome = kills::summed(&kills);
        tell(&outcome);
        outcomes.push(outcome);
    }
    outcomes.extend(side_by_side::run(cases.len(), jobs, goes_on, case, tell));
    // Empty unless some case did not hold.
    let _ = std::fs::remove_dir(&setup.out);
    let is_whole = goes_on();
    let told = Told {
        name: "faults",
        title: "Faults of a running service",
        options: &arguments.options,
        is_whole,
    };
    conclude(&told, &outcomes)
}

fn tell(outcome: &Outcome) {
    match outcome.held {
        true => tracing::info!("{}", outcome.line()),
        false => tracing::warn!("{}", outcome.line()),
    }
}

/// For dives of so many seconds, whose files are in a folder `name`.
fn set_up(
    options: &BenchOptions,
    program: Option<&PathBuf>,
    name: &str,
    dive_s: f64,
) -> anyhow::Result<Setup> {
    let program = match program {
        Some(program) => program.clone(),
        None => std::env::current_exe().context("this program's own file")?,
    };
    let dive = DiveArguments {
        seed: options.seed,
        ..DiveArguments::default()
    };
    Ok(Setup {
        program,
        simulated: Arc::<SimulatedSonar>::new(dives::sonar(&dive, Some(dive_s))?),
        out: options.out.join(name),
        seed: options.seed,
        stop: Stop::on_signals()?,
    })
}

fn chosen(arguments: &FaultsBenchArguments, family: FaultFamily) -> bool {
    arguments.only.is_empty() || arguments.only.contains(&family)
}

/// All cases asked for but the kills, which are summed up as one.
fn cases(arguments: &FaultsBenchArguments) -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
    let is_chosen = |family| chosen(arguments, family);
    if is_chosen(FaultFamily::Unplugs) && arguments.unplugs > 0 {
        let count = arguments.unplugs;
        cases.push(Box::new(move |setup| {
            unplugs::many(setup, Link::Tcp, count)
        }));
        cases.push(Box::new(move |setup| {
            unplugs::many(setup, Link::Pty, count)
        }));
    }
    if is_chosen(FaultFamily::Grid) {
        let grid = grid::CASES.into_iter();
        cases.extend(grid.map(|case| -> Case { Box::new(move |setup| grid::run(setup, case)) }));
    }
    if is_chosen(FaultFamily::Poses) {
        cases.extend(pose_cases(arguments.options.quick));
    }
    if is_chosen(FaultFamily::Clock) {
        let steps = clock::STEPS.into_iter();
        cases.extend(steps.map(|step| -> Case { Box::new(move |setup| clock::step(setup, step)) }));
        cases.push(Box::new(clock::wrap));
        cases.push(Box::new(clock::reboot));
    }
    if is_chosen(FaultFamily::Replayed) {
        cases.push(Box::new(replayed::run));
    }
    if is_chosen(FaultFamily::Hostile) {
        cases.push(Box::new(hostile::run));
    }
    if is_chosen(FaultFamily::Overload) {
        let factors = overload::FACTORS.into_iter();
        cases.extend(
            factors.map(|factor| -> Case { Box::new(move |setup| overload::run(setup, factor)) }),
        );
    }
    cases
}

/// The longest gaps are left out where it shall be quick.
fn pose_cases(is_quick: bool) -> Vec<Case> {
    let longest_s = if is_quick { 5.0 } else { f64::INFINITY };
    let gaps = poses::GAPS_S
        .into_iter()
        .filter(|&gap_s| gap_s <= longest_s);
    let gaps = gaps.map(|gap_s| -> Case { Box::new(move |setup| poses::gap(setup, gap_s)) });
    let faults = poses::FAULTS.into_iter();
    let faults = faults.map(|fault| -> Case { Box::new(move |setup| poses::fault(setup, fault)) });
    gaps.chain(faults).collect()
}

/// What is said beside the outcomes.
struct Told<'a> {
    name: &'static str,
    title: &'static str,
    options: &'a BenchOptions,
    /// Nothing was left out.
    is_whole: bool,
}

/// Writes what came of it; 3 unless all held.
fn conclude(told: &Told<'_>, outcomes: &[Outcome]) -> anyhow::Result<Finish> {
    let (options, is_whole) = (told.options, told.is_whole);
    let failed: Vec<&Outcome> = outcomes.iter().filter(|one| !one.held).collect();
    let summary = format!(
        "{} of {} cases hold",
        outcomes.len() - failed.len(),
        outcomes.len()
    );
    let mut fields = Map::new();
    fields.insert("case_count".to_owned(), json!(outcomes.len()));
    fields.insert("failed_count".to_owned(), json!(failed.len()));
    fields.insert("is_whole".to_owned(), json!(is_whole));
    fields.insert("cases".to_owned(), serde_json::to_value(outcomes)?);
    let lines: Vec<String> = outcomes.iter().map(Outcome::line).collect();
    let results = Findings {
        name: told.name,
        fields,
        report: Report {
            title: told.title.to_owned(),
            highlights: vec![
                ("cases".to_owned(), outcomes.len().to_string()),
                ("failed".to_owned(), failed.len().to_string()),
            ],
            sections: vec![outcome::section(outcomes)],
            ..Report::default()
        },
        text: format!("{}\n{summary}", lines.join("\n")),
        failures: failed.iter().map(|one| one.line()).collect(),
    };
    let says = if options.json { Says::Json } else { Says::Text };
    save(results, options, says)?;
    Ok(match failed.is_empty() && is_whole {
        true => Finish::Done,
        false => Finish::Lossy,
    })
}
