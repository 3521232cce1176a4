//! Seven faults of sonar, poses and their clock: each is told, nothing gets a number that is none,
//! and mapping goes on when it is over.

use std::time::{Duration, Instant};

use super::outcome::Outcome;
use super::sonar::SonarFault;
use super::trial::{Link, Plan, Setup, Spoil, Trial};
use super::vehicle::PoseFault;

const FAMILY: &str = "grid";
/// A condition is told within so long after it is due, seconds.
const TOLD_WITHIN_S: f64 = 2.0;
/// Mapping goes on within so long after the fault, seconds.
const BACK_WITHIN_S: f64 = 3.0;
/// Waited for at most, to say how long it took.
const BACK_LIMIT: Duration = Duration::from_secs(8);
/// How long a fault lasts if not longer, seconds.
const LASTS_S: f64 = 6.0;

/// One fault.
#[derive(Debug, Clone, Copy)]
pub(super) struct Case {
    name: &'static str,
    spoil: Spoil,
    /// When it can first be known, seconds after its beginning.
    due_s: f64,
}

const fn sonar(name: &'static str, fault: SonarFault) -> Case {
    let spoil = Spoil::Sonar(fault);
    Case {
        name,
        spoil,
        due_s: 0.0,
    }
}

const fn poses(name: &'static str, fault: PoseFault) -> Case {
    let spoil = Spoil::Poses(fault);
    Case {
        name,
        spoil,
        due_s: 0.0,
    }
}

/// Ten per cent of five seconds is what no link delays poses by.
const SLOW_CLOCK: Case = Case {
    due_s: 5.0,
    ..poses("clock slow by 10 %", PoseFault::ClockSlow)
};

/// The grid, and a frame that cannot be.
pub(super) const CASES: [Case; 22] = [
    sonar("sonar off", SonarFault::Off),
    sonar("sonar stuck", SonarFault::Stuck),
    sonar("sonar garbage", SonarFault::Garbage),
    sonar("sonar wrong: speed of sound 0", SonarFault::Wrong),
    sonar("sonar slow: 1 ping in 20", SonarFault::Slow),
    sonar("sonar delayed by 3 s", SonarFault::Delayed),
    sonar("sonar intermittent", SonarFault::Intermittent),
    poses("poses off", PoseFault::Off),
    poses("poses stuck", PoseFault::Stuck),
    poses("poses garbage", PoseFault::Garbage),
    poses(
        "poses wrong: a second publisher 2 m off",
        PoseFault::SecondSource,
    ),
    poses("poses slow: 1 a second", PoseFault::Slow),
    poses("poses delayed by 3 s", PoseFault::Late(3.0)),
    poses("poses intermittent", PoseFault::Intermittent),
    poses("clock off: stamps of 0", PoseFault::ClockOff),
    poses("clock stuck", PoseFault::ClockStuck),
    poses("clock garbage", PoseFault::ClockGarbage),
    poses("clock wrong: 1 h ahead", PoseFault::ClockAhead),
    SLOW_CLOCK,
    poses("clock delayed: 3 s behind", PoseFault::ClockBehind),
    poses(
        "clock intermittent: 1 h ahead every other second",
        PoseFault::ClockIntermittent,
    ),
    poses("poses in north-east-down", PoseFault::Ned),
];

/// Runs one case on a service of its own.
pub(super) fn run(setup: &Setup, case: Case) -> Outcome {
    let mut outcome = Outcome::new(FAMILY, case.name);
    if let Err(error) = spoilt(setup, case, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn spoilt(setup: &Setup, case: Case, outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut trial = Trial::start(setup, &Plan::new(folder(case.name), Link::Tcp))?;
    trial.settle(outcome);
    let begin = Instant::now();
    trial.set_fault(Some(case.spoil));
    trial.pass(Duration::from_secs_f64(
        LASTS_S.max(case.due_s + TOLD_WITHIN_S),
    ));
    note_told(&trial, begin, case.due_s, outcome);
    trial.set_fault(None);
    note_back(&mut trial, BACK_WITHIN_S, outcome);
    trial.end(outcome, &[3]);
    Ok(())
}

/// The name of a case as that of a folder.
pub(super) fn folder(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    name.chars().map(plain).collect()
}

/// Notes what was told since `begin`, and whether in time.
pub(super) fn note_told(trial: &Trial, begin: Instant, due_s: f64, outcome: &mut Outcome) {
    let log = trial.program.log();
    let first = log.first_after(begin);
    outcome.told_after_s = first.map(|told| told.at.duration_since(begin).as_secs_f64());
    let codes = log.codes_after(begin);
    outcome.told = (!codes.is_empty()).then(|| codes.join(", "));
    let limit_s = due_s + TOLD_WITHIN_S;
    let is_told = outcome
        .told_after_s
        .is_some_and(|after_s| after_s <= limit_s);
    outcome.expect(is_told, || format!("nothing was told within {limit_s} s"));
}

/// Notes whether mapping goes on within `limit_s` from now.
pub(super) fn note_back(trial: &mut Trial, limit_s: f64, outcome: &mut Outcome) {
    outcome.back_after_s = trial.maps_again(BACK_LIMIT, None);
    let is_back = outcome
        .back_after_s
        .is_some_and(|after_s| after_s <= limit_s);
    outcome.expect(is_back, || {
        format!("nothing is mapped within {limit_s} s after it")
    });
}
