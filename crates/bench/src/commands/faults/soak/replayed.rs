//! A long dive from its log, as fast as it goes.

use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use echosplat_bus::free_port;
use echosplat_model::StampedPose;

use super::memory::Sample;
use super::{SETTINGS, environment, note_growth, path};
use crate::commands::faults::outcome::Outcome;
use crate::commands::faults::program::{LOOK_AGAIN, Program};
use crate::commands::faults::status::Statuses;
use crate::commands::faults::trial::{Setup, open_bus};

/// Working out all there is at the end of hours.
const FINISH_LIMIT: Duration = Duration::from_secs(1800);

pub(super) fn run(setup: &Setup, minutes: f64) -> Outcome {
    let mut outcome = Outcome::new("soak", "replayed");
    if let Err(error) = replayed(setup, minutes, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn replayed(setup: &Setup, minutes: f64, outcome: &mut Outcome) -> anyhow::Result<()> {
    let folder = setup.out.join("replayed");
    // What a former run left.
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    simulate(setup, minutes, &path(&folder, "dive"))?;
    let config = path(&folder, "config.toml");
    fs::write(&config, SETTINGS)?;
    let port = free_port()?;
    let (log, poses) = (
        path(&folder, "dive/dive.svlog"),
        path(&folder, "dive/dive.tum"),
    );
    let (map, listen) = (
        path(&folder, "map.ply"),
        format!("listen/endpoints=[\"tcp/127.0.0.1:{port}\"]"),
    );
    let words = [
        "replay",
        &log,
        "--poses",
        &poses,
        "--map",
        &map,
        "--config",
        &config,
        "--threads",
        "1",
        "--publish",
        "--node",
        "vehicle",
        "--zenoh",
        &listen,
    ];
    let begin = Instant::now();
    let mut program = Program::start(&setup.program, &words.map(str::to_owned), &environment())?;
    let bus = open_bus(port)?;
    let mut statuses = Statuses::new(bus.subscribe_status()?);
    let mut samples = Vec::new();
    let mut descriptors = Vec::new();
    while program.is_running() && !setup.stop.is_set() {
        std::thread::sleep(LOOK_AGAIN);
        if !statuses.poll() {
            continue;
        }
        let Some(heard) = statuses.newest() else {
            continue;
        };
        if heard.status["phase"] != "running" {
            break;
        }
        descriptors.push(program.descriptor_count());
        samples.push(Sample {
            dive_s: heard.status["dive_s"].as_f64().unwrap_or(0.0),
            bytes: heard.count("/memory_bytes"),
        });
    }
    let code = program.wait(FINISH_LIMIT).and_then(|status| status.code());
    outcome.expect(code == Some(0), || {
        format!("the replay ended with {code:?}")
    });
    outcome.figure("wall s", begin.elapsed().as_secs_f64());
    // A file's poses stay with the pings, so that logs in any order find theirs.
    let poses = fs::read_to_string(&poses)?.lines().count();
    let pose_bytes_per_s = (poses * size_of::<StampedPose>()) as f64 / (60.0 * minutes);
    note_growth(&samples, minutes, pose_bytes_per_s, outcome);
    // The first statuses come while the bus still opens.
    let thirds: Vec<_> = descriptors
        .chunks(descriptors.len().div_ceil(3).max(1))
        .collect();
    if let [_, middle, last] = thirds[..] {
        let [middle, last] = [middle, last].map(|counts| counts.iter().min().copied());
        outcome.figure("descriptors", last.unwrap_or(0) as f64);
        outcome.expect(last <= middle, || {
            format!("{last:?} descriptors are open where {middle:?} were")
        });
    }
    let fault = super::super::trial::map_fault(&folder.join("map.ply"));
    outcome.expect(fault.is_none(), || fault.unwrap_or_default());
    if outcome.held {
        let _ = fs::remove_dir_all(&folder);
    }
    Ok(())
}

fn simulate(setup: &Setup, minutes: f64, out: &str) -> anyhow::Result<()> {
    let (seed, duration_s) = (setup.seed.to_string(), (60.0 * minutes).to_string());
    let mut command = Command::new(&setup.program);
    command.args([
        "simulate",
        "--seed",
        &seed,
        "--duration",
        &duration_s,
        "--out",
        out,
    ]);
    let output = command.stdin(Stdio::null()).output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "no dive is simulated: {said}");
    Ok(())
}
