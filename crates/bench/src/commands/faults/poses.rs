//! Poses that are away for a while, jump, freeze or come late: no ping is mapped on a pose that is
//! not there, and the first one that has a pose is.

use std::time::{Duration, Instant};

use super::grid::{folder, note_back, note_told};
use super::outcome::Outcome;
use super::trial::{Link, Plan, Setup, Trial};
use super::vehicle::PoseFault;

const FAMILY: &str = "poses";
/// Longest gap that is bridged, as configured by default, seconds.
const MAX_POSE_GAP_S: f64 = 0.5;
/// Times of pings and poses are known to so many pings at the two ends of a gap together.
const EDGE_PINGS: i64 = 2;
/// Counters have settled after so long: pings wait for poses for 2 s.
const SETTLED: Duration = Duration::from_millis(3_500);
const BACK_WITHIN_S: f64 = 1.0;

/// Gaps, seconds.
pub(super) const GAPS_S: [f64; 8] = [0.1, 0.3, 0.7, 1.0, 2.0, 5.0, 20.0, 60.0];

/// Other faults: name, fault, how long it lasts (s).
pub(super) const FAULTS: [(&str, PoseFault, f64); 5] = [
    ("jump of 2 m", PoseFault::Jump(2.0), 4.0),
    ("jump of 40 m", PoseFault::Jump(40.0), 4.0),
    ("frozen", PoseFault::Stuck, 6.0),
    ("late by 1 s", PoseFault::Late(1.0), 6.0),
    ("late by 4 s", PoseFault::Late(4.0), 6.0),
];

/// No poses for `gap_s`.
pub(super) fn gap(setup: &Setup, gap_s: f64) -> Outcome {
    let mut outcome = Outcome::new(FAMILY, format!("away for {gap_s} s"));
    if let Err(error) = away(setup, gap_s, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn away(setup: &Setup, gap_s: f64, outcome: &mut Outcome) -> anyhow::Result<()> {
    let plan = Plan::new(folder(&format!("gap {gap_s}")), Link::Tcp);
    let mut trial = Trial::start(setup, &plan)?;
    trial.settle(outcome);
    let before = without_pose(&trial);
    let (first_stamp, begin) = (trial.vehicle.stamps().len(), Instant::now());
    trial.set_pose_fault(Some(PoseFault::Off));
    trial.pass(Duration::from_secs_f64(gap_s));
    trial.set_pose_fault(None);
    let is_bridged = gap_s < MAX_POSE_GAP_S;
    if !is_bridged {
        note_back(&mut trial, BACK_WITHIN_S, outcome);
    }
    trial.pass(SETTLED);
    if !is_bridged {
        note_told(&trial, begin, gap_s, outcome);
    }
    let left_out = without_pose(&trial) - before;
    let inside = pings_in_gap(&trial, first_stamp);
    outcome.figure("pings in the gap", inside as f64);
    outcome.figure("pings left out", left_out as f64);
    let wanted = if is_bridged { 0 } else { inside };
    outcome.expect(left_out >= wanted - EDGE_PINGS, || {
        format!("{} pings of the gap were mapped", wanted - left_out)
    });
    outcome.expect(left_out <= wanted + EDGE_PINGS, || {
        format!("{} pings that have poses were left out", left_out - wanted)
    });
    trial.end(outcome, &[0, 3]);
    Ok(())
}

/// Pings without a pose so far, as the status has it.
fn without_pose(trial: &Trial) -> i64 {
    let names = ["pings_too_early", "pings_in_gap", "pings_pose_never_came"];
    let Some(heard) = trial.statuses.newest() else {
        return 0;
    };
    let counts = names.map(|name| heard.count(&format!("/poses/{name}")));
    counts.iter().sum::<u64>() as i64
}

/// Pings sent in the longest time without a pose since the pose of this index.
fn pings_in_gap(trial: &Trial, first: usize) -> i64 {
    let stamps = trial.vehicle.stamps();
    let stamps = stamps.get(first.saturating_sub(1)..).unwrap_or_default();
    let gaps = stamps.iter().zip(stamps.iter().skip(1));
    let longest = gaps.max_by(|a, b| {
        let length_s = |(from, to): &(&_, &echosplat_model::Timestamp)| to.seconds_since(**from);
        length_s(a).total_cmp(&length_s(b))
    });
    let Some((from, to)) = longest else { return 0 };
    let sent = trial.sonar.sent();
    let is_inside = |time| time > *from && time < *to;
    sent.iter().filter(|ping| is_inside(ping.host_time)).count() as i64
}

/// A jump, a freeze, poses that come late.
pub(super) fn fault(setup: &Setup, (name, fault, lasts_s): (&str, PoseFault, f64)) -> Outcome {
    let mut outcome = Outcome::new(FAMILY, name);
    if let Err(error) = spoilt(setup, (name, fault, lasts_s), &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn spoilt(
    setup: &Setup,
    (name, fault, lasts_s): (&str, PoseFault, f64),
    outcome: &mut Outcome,
) -> anyhow::Result<()> {
    let mut trial = Trial::start(setup, &Plan::new(folder(name), Link::Tcp))?;
    trial.settle(outcome);
    let begin = Instant::now();
    trial.set_pose_fault(Some(fault));
    trial.pass(Duration::from_secs_f64(lasts_s));
    note_told(&trial, begin, 0.0, outcome);
    trial.set_pose_fault(None);
    note_back(&mut trial, BACK_WITHIN_S, outcome);
    // A jump makes a new map and loses nothing else.
    trial.end(outcome, &[0, 3]);
    Ok(())
}
