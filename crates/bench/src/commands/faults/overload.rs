//! Pings at many times the rate: what is shed, in what order, and that the recording knows.

use std::collections::HashSet;
use std::time::Duration;

use anyhow::Context;
use echosplat_recording::mcap::{Record, RecordingReader};

use super::outcome::Outcome;
use super::recorded::{self, recorded_pings};
use super::replayed::{FINISH_WITHIN_S, note_replay};
use super::sonar::{PING_INTERVAL_MS, SonarFault};
use super::trial::{Link, Plan, Setup, Trial};

const FAMILY: &str = "overload";
/// Times the rate asked for.
pub(super) const FACTORS: [u32; 3] = [10, 100, 1000];
const LASTS: Duration = Duration::from_secs(8);
/// All that waits is in the map, and the rate is as asked for again.
const AFTERWARDS: Duration = Duration::from_secs(5);
const END_LIMIT: Duration = Duration::from_secs(FINISH_WITHIN_S + 60);
/// What the service may hold.
const MEMORY_BYTES: u64 = 512 << 20;
/// 99 of 100 pings are in the mapper's channel so soon after they were read.
const TAKEN_WITHIN_MS: f64 = 20.0;

pub(super) fn run(setup: &Setup, factor: u32) -> Outcome {
    let mut outcome = Outcome::new(FAMILY, format!("{factor} times the rate"));
    if let Err(error) = overloaded(setup, factor, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn overloaded(setup: &Setup, factor: u32, outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut plan = Plan::new(format!("overload-{factor}"), Link::Tcp);
    plan.settings =
        format!("[pipeline]\nmemory_bytes = {MEMORY_BYTES}\nfinish_within_s = {FINISH_WITHIN_S}\n");
    let mut trial = Trial::start(setup, &plan)?;
    trial.settle(outcome);
    let before = trial.sonar.sent_count();
    trial.sonar.set_crowd(factor);
    let most_bytes = most_memory_bytes(&mut trial, LASTS);
    let sent = trial.sonar.sent_count() - before;
    trial.sonar.set_crowd(1);
    let most_bytes = most_bytes.max(most_memory_bytes(&mut trial, AFTERWARDS));
    trial.sonar.set_fault(Some(SonarFault::Off));
    trial.pass(Duration::from_secs(2));
    outcome.figure("pings a second", sent as f64 / LASTS.as_secs_f64());
    outcome.figure("most memory MiB", most_bytes as f64 / f64::from(1 << 20));
    outcome.expect(most_bytes <= MEMORY_BYTES, || {
        format!("{most_bytes} bytes of memory")
    });
    note_status(&trial, outcome);
    let status = trial.program.terminate(END_LIMIT);
    let code = status.and_then(|status| status.code());
    outcome.expect(matches!(code, Some(0 | 3)), || {
        format!("the service ended with {code:?}")
    });
    note_recording(&trial, factor, outcome)?;
    note_replay(setup, &trial, &trial.folder.join("recordings"), outcome)?;
    trial.leave(outcome);
    Ok(())
}

/// The most that the program was seen to hold while time passed.
fn most_memory_bytes(trial: &mut Trial, lasts: Duration) -> u64 {
    let mut most = 0;
    trial.wait(lasts, |trial| {
        most = most.max(trial.program.memory_bytes());
        false
    });
    most
}

fn note_status(trial: &Trial, outcome: &mut Outcome) {
    let Some(heard) = trial.statuses.newest() else {
        return outcome.expect(false, || "no status came".to_owned());
    };
    let path_ms = |name: &str| {
        let value = heard.status.pointer(&format!("/sonar/ping_path_ms/{name}"));
        value.and_then(serde_json::Value::as_f64)
    };
    let (p99, p99_9) = (path_ms("p99"), path_ms("p99_9"));
    outcome.figure("99 % taken in within ms", p99.unwrap_or(f64::NAN));
    outcome.figure("99.9 % within ms", p99_9.unwrap_or(f64::NAN));
    outcome.expect(p99.is_some_and(|p99| p99 <= TAKEN_WITHIN_MS), || {
        format!("99 % of pings were taken in within {p99:?} ms")
    });
    for (name, pointer) in [
        ("pings mapped", "/ledger/mapped"),
        ("pings shed", "/ledger/shed"),
        ("pings without work", "/shedding/pings_without_work"),
        ("pings unpublished", "/shedding/pings_unpublished"),
    ] {
        outcome.figure(name, heard.count(pointer) as f64);
    }
    let lost = heard.count("/recording/lost_messages");
    outcome.figure("messages lost", lost as f64);
    outcome.expect(lost == 0, || format!("the recording lacks {lost} messages"));
    let (shed, without_work) = (
        heard.count("/ledger/shed"),
        heard.count("/shedding/pings_without_work"),
    );
    outcome.expect(shed == 0 || without_work > 0, || {
        format!("{shed} pings were shed while work on the map went on")
    });
}

/// Every ping that was sent is in it, and every decision.
fn note_recording(trial: &Trial, factor: u32, outcome: &mut Outcome) -> anyhow::Result<()> {
    let folder = trial.folder.join("recordings");
    let recorded = recorded_pings(&folder)?;
    let sent: HashSet<u32> = trial.sonar.sent().iter().map(|ping| ping.number).collect();
    let missing = sent.difference(&recorded).count() as u64;
    // A sonar lets go of what its link does not take, a millisecond's pings at a time.
    let unheard = trial.refused_count() * u64::from(factor.div_ceil(PING_INTERVAL_MS));
    outcome.figure("pings sent", sent.len() as f64);
    outcome.figure(
        "pings that the link did not take",
        missing.min(unheard) as f64,
    );
    outcome.expect(missing <= unheard, || {
        format!("{missing} of {} pings are not in the log", sent.len())
    });
    let events = events(&folder)?;
    let told = events.iter().filter(|name| *name == "work_shed").count();
    outcome.figure("changes of work recorded", told as f64);
    Ok(())
}

/// Names of the events in the recordings of a folder.
fn events(folder: &std::path::Path) -> anyhow::Result<Vec<String>> {
    let mut reader = RecordingReader::open(&recorded::files(folder)?).context("the recording")?;
    let mut names = Vec::new();
    while let Some(recorded) = reader.next_message()? {
        if let Record::Event(event) = recorded.record {
            names.extend(event["event"].as_str().map(str::to_owned));
        }
    }
    Ok(names)
}
