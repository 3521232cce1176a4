//! `kill -9` at random moments: what was recorded is there, and replays.

use std::collections::HashSet;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use super::outcome::Outcome;
use super::recorded::recorded_pings;
use super::trial::{Link, Plan, Setup, Trial};
use crate::draw::Draw;

const FAMILY: &str = "kills";
/// After the first pings in the map, seconds.
const EARLIEST_S: f64 = 0.2;
const LATEST_S: f64 = 3.0;
/// A ping that was on its way when the program died.
const MOST_LOST: usize = 1;
/// Every so many-th recording is replayed as well as read.
const REPLAY_EVERY: usize = 20;

/// What one kill came to.
pub(super) struct Kill {
    outcome: Outcome,
    sent: usize,
    lost: usize,
    was_replayed: bool,
}

/// Starts the service, kills it, and looks at what it left.
pub(super) fn one(setup: &Setup, index: usize) -> Kill {
    let mut kill = Kill {
        outcome: Outcome::new(FAMILY, format!("kill {index}")),
        sent: 0,
        lost: 0,
        was_replayed: false,
    };
    if let Err(error) = killed(setup, index, &mut kill) {
        kill.outcome.expect(false, || format!("{error:#}"));
    }
    kill
}

fn killed(setup: &Setup, index: usize, kill: &mut Kill) -> anyhow::Result<()> {
    let name = format!("kill-{index}");
    let mut trial = Trial::start(setup, &Plan::new(name, Link::Tcp))?;
    let begins = trial.wait_mapping();
    kill.outcome
        .expect(begins, || "the service does not begin to map".to_owned());
    let mut draw = Draw::new(setup.seed, 100 + index as u64);
    let moment_s = draw.finely_between(EARLIEST_S, LATEST_S);
    trial.pass(Duration::from_secs_f64(moment_s));
    let killed_at = Instant::now();
    trial.program.kill();
    let sent = trial.sonar.sent();
    let sent: Vec<u32> = sent
        .iter()
        .filter(|ping| ping.at < killed_at)
        .map(|ping| ping.number)
        .collect();
    let recordings = trial.folder.join("recordings");
    let recorded: HashSet<u32> = recorded_pings(&recordings)?;
    kill.sent = sent.len();
    kill.lost = sent
        .iter()
        .filter(|number| !recorded.contains(number))
        .count();
    kill.outcome.expect(kill.lost <= MOST_LOST, || {
        format!(
            "{} of {} pings are not in the recording",
            kill.lost, kill.sent
        )
    });
    if index.is_multiple_of(REPLAY_EVERY) {
        kill.was_replayed = true;
        let fault = replay_fault(setup, &trial);
        kill.outcome
            .expect(fault.is_none(), || fault.unwrap_or_default());
    }
    trial.leave(&kill.outcome);
    Ok(())
}

/// What is wrong with a replay of what `trial` recorded.
fn replay_fault(setup: &Setup, trial: &Trial) -> Option<String> {
    let files = super::recorded::files(&trial.folder.join("recordings"));
    let files = match files {
        Ok(files) => files,
        Err(error) => return Some(format!("{error:#}")),
    };
    let mut command = Command::new(&setup.program);
    command
        .arg("replay")
        .args(files)
        .args(["--json", "--threads", "1"]);
    let output = command.stdin(Stdio::null()).output();
    let output = match output {
        Ok(output) => output,
        Err(error) => return Some(format!("replay does not start: {error}")),
    };
    if !matches!(output.status.code(), Some(0 | 3)) {
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.lines().last().unwrap_or_default().to_owned();
        return Some(format!("replay ended with {}: {last}", output.status));
    }
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    let mapped = summary["pings_mapped"].as_u64().unwrap_or(0);
    (mapped == 0).then(|| "replay maps no ping of the recording".to_owned())
}

/// All kills as one case.
pub(super) fn summed(kills: &[Kill]) -> Outcome {
    let mut outcome = Outcome::new(FAMILY, format!("{} times at a random moment", kills.len()));
    for kill in kills {
        outcome.expect(kill.outcome.held, || {
            format!("{}: {}", kill.outcome.case, kill.outcome.broken.join("; "))
        });
    }
    let sum = |count: fn(&Kill) -> usize| kills.iter().map(count).sum::<usize>() as f64;
    let most = kills.iter().map(|kill| kill.lost).max().unwrap_or(0);
    outcome.figure("pings sent", sum(|kill| kill.sent));
    outcome.figure("pings lost", sum(|kill| kill.lost));
    outcome.figure("most lost in one", most as f64);
    outcome.figure("replayed", sum(|kill| usize::from(kill.was_replayed)));
    outcome
}
