//! A live dive over UDP with floods, strangers, a frozen subscriber, steps of the clock and bursts of
//! pings, a round of all of them a minute.

use std::process::Command;
use std::time::{Duration, Instant};

use super::memory::{MIB, Sample};
use super::{SETTINGS, environment, note_growth};
use crate::commands::faults::hostile::{Flood, client_port, counted};
use crate::commands::faults::outcome::Outcome;
use crate::commands::faults::program::Program;
use crate::commands::faults::shim::Shim;
use crate::commands::faults::trial::{Link, Plan, Setup, Trial};
use crate::commands::faults::vehicle::PoseFault;

/// How long a flood, a frozen subscriber and a burst last.
const FLOOD: Duration = Duration::from_secs(5);
const FROZEN: Duration = Duration::from_secs(12);
const BURST: Duration = Duration::from_secs(4);
/// With nothing wrong in between.
const REST: Duration = Duration::from_secs(4);
const HOUR_S: f64 = 3600.0;
/// Times the rate: what a datagram socket's buffer holds of one instant.
const BURST_FACTOR: u32 = 10;
/// Share of the true pings that a flood may cost.
const MOST_LOST: f64 = 0.01;

pub(super) fn run(setup: &Setup, minutes: f64) -> Outcome {
    let mut outcome = Outcome::new("soak", "live");
    if let Err(error) = lived(setup, minutes, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn lived(setup: &Setup, minutes: f64, outcome: &mut Outcome) -> anyhow::Result<()> {
    let shim = Shim::compile(&setup.out.join("soak-clock"))?;
    let mut plan = Plan::new("live", Link::Udp);
    plan.environment = [shim.environment(), environment()].concat();
    SETTINGS.clone_into(&mut plan.settings);
    let mut trial = Trial::start(setup, &plan)?;
    trial.settle(outcome);
    let mut live = Live {
        begin: Instant::now(),
        samples: Vec::new(),
        descriptors: Vec::new(),
        round: Round::default(),
        shim,
    };
    let lasts = Duration::from_secs_f64(60.0 * minutes);
    while live.begin.elapsed() < lasts && !setup.stop.is_set() && trial.program.is_running() {
        live.once(setup, &mut trial)?;
    }
    outcome.expect(trial.program.is_running(), || {
        "the service ended".to_owned()
    });
    note_growth(&live.samples, minutes, 0.0, outcome);
    live.round.note(outcome);
    live.note_descriptors(outcome);
    let path_ms = trial.statuses.newest().and_then(|heard| {
        let path = heard.status.pointer("/sonar/ping_path_ms/p99_9");
        path.and_then(serde_json::Value::as_f64)
    });
    outcome.figure(
        "99.9 % of pings taken in within ms",
        path_ms.unwrap_or(f64::NAN),
    );
    trial.end(outcome, &[0, 3]);
    Ok(())
}

struct Live {
    begin: Instant,
    samples: Vec<Sample>,
    /// After each round.
    descriptors: Vec<usize>,
    round: Round,
    shim: Shim,
}

/// What all rounds so far came to.
#[derive(Debug, Default)]
struct Round {
    count: u32,
    sent: u64,
    lost: u64,
    datagrams: u64,
    answers: u64,
    /// What memory grew by while a subscriber was frozen, each time.
    frozen_mib: Vec<f64>,
    not_back: u32,
}

impl Live {
    fn once(&mut self, setup: &Setup, trial: &mut Trial) -> anyhow::Result<()> {
        self.flooded(setup, trial)?;
        self.pass(trial, REST);
        self.frozen(setup, trial)?;
        self.pass(trial, REST);
        self.stepped(trial)?;
        trial.sonar.set_crowd(BURST_FACTOR);
        self.pass(trial, BURST);
        trial.sonar.set_crowd(1);
        self.pass(trial, REST);
        self.descriptors.push(trial.descriptor_count());
        self.round.count += 1;
        tracing::info!(
            minutes = self.begin.elapsed().as_secs_f64() / 60.0,
            memory_mib = trial.program.memory_bytes() >> 20,
            descriptors = trial.descriptor_count(),
            "a round more"
        );
        Ok(())
    }

    /// Goes on for so long, and looks at memory meanwhile.
    fn pass(&mut self, trial: &mut Trial, lasts: Duration) {
        let begin = self.begin;
        let mut next = Instant::now();
        let samples = &mut self.samples;
        trial.wait(lasts, |trial| {
            if Instant::now() >= next {
                next += Duration::from_secs(1);
                samples.push(Sample {
                    dive_s: begin.elapsed().as_secs_f64(),
                    bytes: trial.program.memory_bytes(),
                });
            }
            false
        });
    }

    /// Strangers' datagrams, and poses that come twice.
    fn flooded(&mut self, setup: &Setup, trial: &mut Trial) -> anyhow::Result<()> {
        let before = counted(trial);
        let port = client_port(trial)?;
        trial.set_pose_fault(Some(PoseFault::Replayed));
        let flood = Flood::start(port, setup.seed)?;
        self.pass(trial, FLOOD);
        let (datagrams, answers) = flood.stop();
        trial.set_pose_fault(None);
        let after = counted(trial);
        let sent = after.0 - before.0;
        self.round.sent += sent;
        self.round.lost += sent.saturating_sub(after.1 - before.1);
        self.round.datagrams += datagrams;
        self.round.answers += answers;
        Ok(())
    }

    /// A follower of the map that is stopped, and killed later.
    fn frozen(&mut self, setup: &Setup, trial: &mut Trial) -> anyhow::Result<()> {
        let connect = format!("connect/endpoints=[\"tcp/127.0.0.1:{}\"]", trial.bus_port);
        let words = [
            "watch",
            "--zenoh",
            &connect,
            "--zenoh",
            "listen/endpoints=[]",
        ];
        let mut watch = Program::start(&setup.program, &words.map(str::to_owned), &[])?;
        self.pass(trial, REST);
        let before = trial.program.memory_bytes() as f64;
        let id = watch.id().to_string();
        // What cannot be sent leaves it running, which is no worse a subscriber.
        let _ = Command::new("kill").args(["-s", "STOP", &id]).status();
        self.pass(trial, FROZEN);
        let grown = trial.program.memory_bytes() as f64 - before;
        self.round.frozen_mib.push(grown / MIB);
        watch.kill();
        Ok(())
    }

    /// The host's clock an hour ahead, or back again.
    fn stepped(&mut self, trial: &mut Trial) -> anyhow::Result<()> {
        let offset_s = match self.round.count.is_multiple_of(2) {
            true => HOUR_S,
            false => 0.0,
        };
        self.shim.set_offset(offset_s)?;
        trial.vehicle.shift_stamps(offset_s);
        let back = trial.maps_again(Duration::from_secs(5), None);
        self.round.not_back += u32::from(back.is_none());
        Ok(())
    }

    fn note_descriptors(&self, outcome: &mut Outcome) {
        let (first, last) = (self.descriptors.first(), self.descriptors.last());
        let (Some(&first), Some(&last)) = (first, last) else {
            return outcome.expect(false, || "no round was ended".to_owned());
        };
        outcome.figure("descriptors after the first round", first as f64);
        outcome.figure("descriptors after the last", last as f64);
        outcome.expect(last <= first, || {
            format!("{last} descriptors are open where {first} were")
        });
    }
}

impl Round {
    fn note(&self, outcome: &mut Outcome) {
        outcome.figure("rounds", f64::from(self.count));
        outcome.figure("true pings during floods", self.sent as f64);
        outcome.figure("lost of them", self.lost as f64);
        outcome.figure("datagrams of strangers", self.datagrams as f64);
        outcome.figure("answers to them", self.answers as f64);
        // In the first half the map itself grows.
        let mut grown = self.frozen_mib[self.frozen_mib.len() / 2..].to_vec();
        grown.sort_by(f64::total_cmp);
        let middle = grown.get(grown.len() / 2).copied().unwrap_or(f64::NAN);
        outcome.figure(
            "MiB more with a frozen subscriber, middle of the second half",
            middle,
        );
        let most = grown.last().copied().unwrap_or(f64::NAN);
        outcome.figure(
            "MiB more with a frozen subscriber, most of the second half",
            most,
        );
        outcome.figure("steps without mapping after", f64::from(self.not_back));
        let share = self.lost as f64 / self.sent.max(1) as f64;
        outcome.expect(share <= MOST_LOST, || {
            format!(
                "{} of {} true pings are not in the map",
                self.lost, self.sent
            )
        });
        outcome.expect(self.answers == 0, || {
            format!("{} datagrams went to strangers", self.answers)
        });
        outcome.expect(self.not_back == 0, || {
            format!("{} times nothing was mapped after a step", self.not_back)
        });
    }
}
