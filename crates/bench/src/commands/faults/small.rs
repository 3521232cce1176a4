//! `echosplat bench small`: the service on part of one processor, as on a small computer, beside the same on the whole machine.
//! The simulated sonar runs outside of that part.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Context;
use echosplat_bus::free_port;
use echosplat_metrics::{MapPoints, Metrics, Truth, evaluate_raw};
use echosplat_recording::ply::read_map;
use echosplat_service::arguments::DiveArguments;
use echosplat_service::exit::Finish;
use echosplat_service::signals::Stop;
use echosplat_service::{dives, truth};

use super::grid;
use super::group::Group;
use super::outcome::Outcome;
use super::program::{LOOK_AGAIN, Program};
use super::status::Statuses;
use super::trial::open_bus;
use super::{Told, conclude, tell};
use crate::arguments::SmallBenchArguments;

const FAMILY: &str = "small";
/// What a unit sends at 10 m of range.
const PINGS_PER_S: f64 = 58.0;
/// A survey's 9,600 pings.
const LASTS_S: f64 = 165.0;
const QUICK_LASTS_S: f64 = 20.0;
/// A map is looked for so long after the start.
const START_LIMIT: Duration = Duration::from_secs(30);
/// However late the map is, it is waited for.
const END_LIMIT: Duration = Duration::from_secs(600);
/// 99 of 100 pings are in a published message so soon after they came.
const PUBLISHED_WITHIN_S: f64 = 0.5;
/// The finished map is there so soon after the last ping.
const ENDED_WITHIN_S: f64 = 10.0;
/// Work that waits for the end may take nearly all of that.
const SETTINGS: &str = "[pipeline]\nfinish_within_s = 9\n";
/// Of the map's distance from the truth to that of the whole machine's map.
const MOST_RATIO: f64 = 1.05;

/// One run.
struct Case<'a> {
    arguments: &'a SmallBenchArguments,
    scene: &'a str,
    lasts_s: f64,
    /// None of the whole machine.
    processors: Option<f64>,
}

/// # Errors
/// If something cannot be run or written.
pub(in crate::commands) fn run(arguments: &SmallBenchArguments) -> anyhow::Result<Finish> {
    let stop = Stop::on_signals()?;
    let usual_s = if arguments.options.quick {
        QUICK_LASTS_S
    } else {
        LASTS_S
    };
    let mut outcomes = Vec::new();
    for scene in &arguments.scene {
        let mut whole = None;
        for processors in [None, Some(arguments.processors)] {
            if stop.is_set() {
                break;
            }
            let case = Case {
                arguments,
                scene,
                lasts_s: arguments.seconds.unwrap_or(usual_s),
                processors,
            };
            let (outcome, metrics) = case.run(whole.as_ref());
            tell(&outcome);
            outcomes.push(outcome);
            whole = whole.or(metrics);
        }
    }
    let told = Told {
        name: "small",
        title: "A small computer",
        options: &arguments.options,
        is_whole: !stop.is_set(),
    };
    conclude(&told, &outcomes)
}

impl Case<'_> {
    /// What came of it, and how near the map is to the truth.
    fn run(&self, whole: Option<&Metrics>) -> (Outcome, Option<Metrics>) {
        let on = self
            .processors
            .map_or("the whole machine".to_owned(), |share| {
                format!("{share} of a processor")
            });
        let mut outcome = Outcome::new(FAMILY, format!("{} on {on}", self.scene));
        let metrics = self.lived(&mut outcome, whole);
        let metrics = metrics.map_err(|error| outcome.expect(false, || format!("{error:#}")));
        (outcome, metrics.ok())
    }

    fn lived(&self, outcome: &mut Outcome, whole: Option<&Metrics>) -> anyhow::Result<Metrics> {
        let folder = self.arguments.options.out.join("small");
        fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let map = folder.join(grid::folder(self.scene) + ".ply");
        let config = folder.join("config.toml");
        fs::write(&config, SETTINGS)
            .with_context(|| format!("cannot write {}", config.display()))?;
        let group = self.processors.map(Group::of).transpose()?;
        let file = match &self.arguments.program {
            Some(program) => program.clone(),
            None => std::env::current_exe().context("this program's own file")?,
        };
        let (sonar_port, bus_port) = (free_port()?, free_port()?);
        let url = format!("tcp://127.0.0.1:{sonar_port}");
        let sonar = Program::start(&file, &self.sonar_words(&url, bus_port), &[])?;
        let words = service_words(&url, bus_port, [&config, &map]);
        let mut service = Program::start(&file, &words, &[])?;
        if let Some(group) = &group {
            group.take(service.id())?;
        }
        let bus = open_bus(bus_port)?;
        let mut statuses = Statuses::new(bus.subscribe_status()?);
        let begin = Instant::now();
        wait(&mut service, &mut statuses, START_LIMIT, |statuses| {
            statuses.mapped() > 0
        });
        outcome.expect(statuses.mapped() > 0, || {
            "the service does not begin to map".to_owned()
        });
        let lasts = Duration::from_secs_f64(self.lasts_s);
        let rest = lasts.saturating_sub(begin.elapsed());
        wait(&mut service, &mut statuses, rest, |_| false);
        note_status(&statuses, outcome);
        drop(sonar);
        let ended = Instant::now();
        let status = service.terminate(END_LIMIT);
        let code = status.and_then(|status| status.code());
        outcome.expect(code == Some(0), || {
            format!("the service ended with {code:?}")
        });
        let ended_s = ended.elapsed().as_secs_f64();
        outcome.figure("ended after s", ended_s);
        outcome.expect(ended_s <= ENDED_WITHIN_S, || {
            format!("the map was there {ended_s:.1} s after the last ping")
        });
        let metrics = evaluate_raw(&points(&map)?, &self.truth()?);
        note_map(&metrics, whole, outcome);
        Ok(metrics)
    }

    fn dive(&self) -> DiveArguments {
        DiveArguments {
            scene: self.scene.to_owned(),
            seed: self.arguments.options.seed,
            pings_per_s: Some(PINGS_PER_S),
            ..DiveArguments::default()
        }
    }

    fn truth(&self) -> anyhow::Result<Truth> {
        let sonar = dives::sonar(&self.dive(), Some(self.lasts_s))?;
        Ok(truth::of_simulated(sonar.scene(), sonar.dive()))
    }

    fn sonar_words(&self, url: &str, bus_port: u16) -> Vec<String> {
        let (seed, rate) = (
            self.arguments.options.seed.to_string(),
            PINGS_PER_S.to_string(),
        );
        let connect = format!("connect/endpoints=[\"tcp/127.0.0.1:{bus_port}\"]");
        let words = [
            "emulate",
            "--scene",
            self.scene,
            "--dive",
            "survey",
            "--seed",
            &seed,
            "--pings-per-s",
            &rate,
            "--listen",
            url,
            "--publish-poses",
            "--zenoh",
            "listen/endpoints=[]",
            "--zenoh",
            &connect,
            "--zenoh",
            "connect/timeout_ms=-1",
        ];
        words.map(str::to_owned).to_vec()
    }
}

fn service_words(sonar_url: &str, bus_port: u16, files: [&Path; 2]) -> Vec<String> {
    let listen = format!("listen/endpoints=[\"tcp/127.0.0.1:{bus_port}\"]");
    let [config, map] = files.map(|file| file.display().to_string());
    let words = [
        "run",
        "--config",
        &config,
        "--sonar",
        sonar_url,
        "--map",
        &map,
        "--zenoh",
        &listen,
        "--zenoh",
        "connect/endpoints=[]",
    ];
    words.map(str::to_owned).to_vec()
}

/// Takes statuses for so long, or until `is_so`.
fn wait(
    service: &mut Program,
    statuses: &mut Statuses,
    limit: Duration,
    is_so: impl Fn(&Statuses) -> bool,
) {
    let begin = Instant::now();
    while begin.elapsed() < limit && service.is_running() && !is_so(statuses) {
        statuses.poll();
        std::thread::sleep(LOOK_AGAIN);
    }
}

fn note_status(statuses: &Statuses, outcome: &mut Outcome) {
    let Some(heard) = statuses.newest() else {
        return outcome.expect(false, || "no status came".to_owned());
    };
    let latency_s = |name: &str| {
        let value = heard.status.pointer(&format!("/latency_s/{name}"));
        value.and_then(serde_json::Value::as_f64)
    };
    outcome.figure(
        "50 % published within s",
        latency_s("p50").unwrap_or(f64::NAN),
    );
    let p99_s = latency_s("p99");
    outcome.figure("99 % published within s", p99_s.unwrap_or(f64::NAN));
    outcome.expect(
        p99_s.is_some_and(|p99_s| p99_s <= PUBLISHED_WITHIN_S),
        || format!("99 % of pings were in a published message within {p99_s:?} s"),
    );
    for (name, pointer) in [
        ("pings mapped", "/ledger/mapped"),
        ("pings shed", "/ledger/shed"),
        ("pings without work", "/shedding/pings_without_work"),
        ("pings unpublished", "/shedding/pings_unpublished"),
        ("live confident", "/mapper/confident"),
    ] {
        outcome.figure(name, heard.count(pointer) as f64);
    }
    let shed = heard.count("/ledger/shed");
    outcome.expect(shed == 0, || format!("{shed} pings were shed"));
}

fn points(map: &Path) -> anyhow::Result<MapPoints> {
    let map = read_map(map).with_context(|| format!("the map {}", map.display()))?;
    Ok(MapPoints::new(map.origin_m, &map.gaussians))
}

fn note_map(metrics: &Metrics, whole: Option<&Metrics>, outcome: &mut Outcome) {
    outcome.figure("CD m", metrics.cd_m);
    let Some(whole) = whole else { return };
    let ratio = metrics.cd_m / whole.cd_m;
    outcome.figure("CD over that of the whole machine", ratio);
    outcome.expect(ratio <= MOST_RATIO, || {
        format!("the map is {ratio:.2} times as far from the truth")
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::DVec3;

    #[test]
    fn a_map_is_held_against_that_of_the_whole_machine() {
        let truth = Truth::from_points(&[DVec3::ZERO]);
        let off = |off_m: f64| evaluate_raw(&MapPoints::of_positions([DVec3::X * off_m]), &truth);
        let mut outcome = Outcome::new(FAMILY, "fence");
        note_map(&off(0.02), None, &mut outcome);
        note_map(&off(0.0205), Some(&off(0.02)), &mut outcome);
        assert!(outcome.held, "{outcome:?}");
        note_map(&off(0.03), Some(&off(0.02)), &mut outcome);
        assert!(!outcome.held && (outcome.figures["CD m"] - 0.03).abs() < 1e-9);
    }
}
