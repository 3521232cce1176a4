//! A dive with unplugs, a pose outage, a step of the clock and a full disk: its recording gives the very
//! maps of the dive.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, ensure};

use super::outcome::Outcome;
use super::recorded;
use super::shim::Shim;
use super::trial::{Link, Plan, Setup, Trial};
use super::vehicle::PoseFault;

const DISK_BYTES: u64 = 48 << 20;
const UNPLUGS: usize = 5;
const STEP_S: f64 = -3600.0;
/// A replay makes the finished map, so the dive has to finish its own: a busy machine may need minutes.
pub(super) const FINISH_WITHIN_S: u64 = 240;
const END_LIMIT: Duration = Duration::from_secs(FINISH_WITHIN_S + 60);

pub(super) fn run(setup: &Setup) -> Outcome {
    let mut outcome = Outcome::new("replayed", "a dive with everything comes out again");
    if let Err(error) = dive_and_replay(setup, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn dive_and_replay(setup: &Setup, outcome: &mut Outcome) -> anyhow::Result<()> {
    let shim = Shim::compile(&setup.out.join("replayed-clock"))?;
    let mut plan = Plan::new("replayed", Link::Tcp);
    plan.environment = shim.environment();
    plan.disk_bytes = Some(DISK_BYTES);
    plan.settings = format!("[pipeline]\nfinish_within_s = {FINISH_WITHIN_S}\n");
    let mut trial = Trial::start(setup, &plan)?;
    dive(&mut trial, &shim, outcome)?;
    let status = trial.program.terminate(END_LIMIT);
    let code = status.and_then(|status| status.code());
    outcome.expect(code == Some(3), || format!("the dive ended with {code:?}"));
    let disk = trial.disk.as_ref().context("the dive was recorded on it")?;
    note_replay(setup, &trial, disk.path(), outcome)?;
    trial.leave(outcome);
    Ok(())
}

/// Replays what a dive that has ended recorded, and notes whether its maps come out again.
///
/// # Errors
/// If there is no recording, it is not replayed, or a map cannot be read.
pub(super) fn note_replay(
    setup: &Setup,
    trial: &Trial,
    recordings: &Path,
    outcome: &mut Outcome,
) -> anyhow::Result<()> {
    let again = trial.folder.join("again.ply");
    replay(setup, recordings, &again)?;
    let compared = compare(&trial.map(), &again)?;
    outcome.figure("maps compared", compared.len() as f64);
    for (name, is_same) in compared {
        outcome.expect(is_same, || format!("the replay's {name} is another"));
    }
    Ok(())
}

fn dive(trial: &mut Trial, shim: &Shim, outcome: &mut Outcome) -> anyhow::Result<()> {
    let begins = trial.wait_mapping();
    outcome.expect(begins, || "the service does not begin to map".to_owned());
    trial.pass(Duration::from_secs(8));
    for _ in 0..UNPLUGS {
        trial.unplug();
        trial.pass(Duration::from_millis(300));
        trial.plug_in()?;
        trial.pass(Duration::from_secs(1));
    }
    trial.set_pose_fault(Some(PoseFault::Off));
    trial.pass(Duration::from_secs(3));
    trial.set_pose_fault(None);
    trial.pass(Duration::from_secs(2));
    if let Some(disk) = &trial.disk {
        disk.fill();
    }
    trial.pass(Duration::from_secs(3));
    let told = trial.program.log().standing().contains("recording-fails");
    outcome.expect(told, || "the full disk is not told".to_owned());
    if let Some(disk) = &trial.disk {
        disk.free();
    }
    trial.pass(Duration::from_secs(3));
    shim.set_offset(STEP_S)?;
    trial.vehicle.shift_stamps(STEP_S);
    trial.pass(Duration::from_secs(10));
    Ok(())
}

fn replay(setup: &Setup, recordings: &Path, map: &Path) -> anyhow::Result<()> {
    let mut command = Command::new(&setup.program);
    command
        .arg("replay")
        .args(recorded::files(recordings)?)
        .arg("--map")
        .arg(map)
        .args(["--threads", "1"]);
    let output = command.stdin(Stdio::null()).output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(
        matches!(output.status.code(), Some(0 | 3)),
        "the replay ended with {}: {}",
        output.status,
        said.lines().last().unwrap_or_default()
    );
    Ok(())
}

/// Every map of the dive beside that of the replay: its name, and whether they are the same.
fn compare(live: &Path, again: &Path) -> anyhow::Result<Vec<(String, bool)>> {
    let numbered = |map: &Path, number: usize| -> PathBuf {
        match number {
            0 => map.to_owned(),
            _ => map.with_extension(format!("{number}.ply")),
        }
    };
    let mut compared = Vec::new();
    for number in 0.. {
        let (live, again) = (numbered(live, number), numbered(again, number));
        if number > 0 && !live.exists() && !again.exists() {
            break;
        }
        let read = |path: &Path| fs::read(path).with_context(|| path.display().to_string());
        let name = again
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        compared.push((name, read(&live)? == read(&again)?));
    }
    Ok(compared)
}
