//! Clocks that step, wrap or begin anew in mid-dive: the host's and the device's.

use std::time::{Duration, Instant};

use echosplat_bus::MapSubscriber;

use super::grid::{folder, note_back, note_told};
use super::outcome::Outcome;
use super::shim::Shim;
use super::trial::{Link, PING_INTERVAL_S, Plan, Setup, Trial};

const FAMILY: &str = "clock";
const BACK_WITHIN_S: f64 = 1.0;
const HOUR_S: f64 = 3600.0;
/// The device's counter wraps so long after its start, in the middle of a run.
const WRAPS_AFTER_MS: u32 = 10_000;
/// Away while it starts again.
const REBOOT: Duration = Duration::from_millis(500);
/// What is seen of times after a step.
const LOOK: Duration = Duration::from_secs(3);
/// Ten pings, and what the map needs to show them.
const TEN_PINGS: Duration = Duration::from_millis(800);
/// Times of pings are known to this after ten of them, seconds.
const TIME_ERROR_S: f64 = 0.005;

/// A step of the host's clock.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    hours: f64,
    /// Whether the poses are stamped by the same clock.
    with_poses: bool,
}

pub(super) const STEPS: [Step; 4] = [
    Step {
        hours: 1.0,
        with_poses: true,
    },
    Step {
        hours: -1.0,
        with_poses: true,
    },
    Step {
        hours: 1.0,
        with_poses: false,
    },
    Step {
        hours: -1.0,
        with_poses: false,
    },
];

/// The host's clock steps under the program.
pub(super) fn step(setup: &Setup, step: Step) -> Outcome {
    let poses = if step.with_poses { "with" } else { "without" };
    // Told apart by letters, since the name is that of a folder too.
    let way = if step.hours > 0.0 { "ahead" } else { "back" };
    let hours = step.hours.abs();
    let name = format!("host stepped {way} by {hours} h {poses} the poses");
    let mut outcome = Outcome::new(FAMILY, name.as_str());
    if let Err(error) = stepped(setup, &name, step, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn stepped(setup: &Setup, name: &str, step: Step, outcome: &mut Outcome) -> anyhow::Result<()> {
    let shim = Shim::compile(&setup.out.join(folder(&format!("{name} clock"))))?;
    let mut plan = Plan::new(folder(name), Link::Tcp);
    plan.environment = shim.environment();
    let mut trial = Trial::start(setup, &plan)?;
    let map = trial.bus.subscribe_map()?;
    trial.settle(outcome);
    let begin = Instant::now();
    let offset_s = step.hours * HOUR_S;
    shim.set_offset(offset_s)?;
    if step.with_poses {
        trial.vehicle.shift_stamps(offset_s);
    }
    note_back(&mut trial, BACK_WITHIN_S, outcome);
    trial.pass(LOOK);
    note_told(&trial, begin, 0.0, outcome);
    note_times(&mut trial, &map, offset_s, outcome);
    trial.end(outcome, &[0, 3]);
    Ok(())
}

/// The device's counter of milliseconds wraps.
pub(super) fn wrap(setup: &Setup) -> Outcome {
    let mut outcome = Outcome::new(FAMILY, "device's counter wraps");
    if let Err(error) = wrapped(setup, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn wrapped(setup: &Setup, outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut plan = Plan::new("wrap", Link::Tcp);
    plan.clock_ms = u32::MAX - WRAPS_AFTER_MS;
    let mut trial = Trial::start(setup, &plan)?;
    let map = trial.bus.subscribe_map()?;
    trial.settle(outcome);
    let wraps_s = f64::from(WRAPS_AFTER_MS) * 1e-3;
    let is_near = |trial: &mut Trial| trial.sonar.dive_s().is_some_and(|s| s > wraps_s - 0.2);
    trial.wait(Duration::from_secs(20), is_near);
    let (begin, mapped) = (Instant::now(), trial.statuses.mapped());
    trial.pass(LOOK);
    let gained = trial.statuses.mapped() - mapped;
    let least = (0.5 * LOOK.as_secs_f64() / PING_INTERVAL_S) as u64;
    outcome.figure("pings mapped meanwhile", gained as f64);
    outcome.expect(gained >= least, || {
        format!("only {gained} pings were mapped")
    });
    let told = trial.program.log().first_after(begin).cloned();
    outcome.expect(told.is_none(), || format!("it was told as wrong: {told:?}"));
    note_times(&mut trial, &map, 0.0, outcome);
    trial.end(outcome, &[0, 3]);
    Ok(())
}

/// The device loses power for a moment and counts from 0 again.
pub(super) fn reboot(setup: &Setup) -> Outcome {
    let mut outcome = Outcome::new(FAMILY, "device starts again");
    if let Err(error) = rebooted(setup, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn rebooted(setup: &Setup, outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut trial = Trial::start(setup, &Plan::new("reboot", Link::Tcp))?;
    let map = trial.bus.subscribe_map()?;
    trial.settle(outcome);
    trial.unplug();
    trial.pass(REBOOT);
    trial.sonar.reboot();
    trial.plug_in()?;
    note_back(&mut trial, BACK_WITHIN_S, outcome);
    trial.pass(LOOK);
    note_times(&mut trial, &map, 0.0, outcome);
    trial.end(outcome, &[0, 3]);
    Ok(())
}

/// Notes how far the times of pings in the map are from when they were sent, and that none goes
/// back; the program's clock is `offset_s` ahead.
fn note_times(trial: &mut Trial, map: &MapSubscriber, offset_s: f64, outcome: &mut Outcome) {
    let begin = Instant::now();
    let mut times = Vec::new();
    while begin.elapsed() < TEN_PINGS {
        trial.pass(Duration::from_millis(50));
        times.extend(
            map.newest()
                .map(|snapshot| snapshot.time.offset_by(-offset_s)),
        );
    }
    let sent = trial.sonar.sent();
    let errors = times.iter().filter_map(|time| {
        let errors = sent.iter().rev().take(400);
        let errors = errors.map(|ping| time.seconds_since(ping.host_time).abs());
        errors.min_by(f64::total_cmp)
    });
    let worst_s = errors.fold(0.0, f64::max);
    outcome.figure("error of times ms", worst_s * 1e3);
    outcome.expect(!times.is_empty() && worst_s <= TIME_ERROR_S, || {
        format!("times of pings are wrong by {:.1} ms", worst_s * 1e3)
    });
    outcome.expect(times.is_sorted(), || "times of pings went back".to_owned());
}
