//! `echosplat demo`: no hardware, no configuration: a simulated sonar on loopback, the whole
//! service as it runs at sea, a subscriber of its map, and then how right that map is.

mod report;
mod words;

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, anyhow};
use echosplat_bus::{Bus, BusConfig, MapSubscriber, free_port};
use echosplat_driver::ListenUrl;
use echosplat_join::StampClock;
use echosplat_metrics::curve::Sample;
use echosplat_model::{Gaussian, Snapshot};
use echosplat_report::table;
use echosplat_simulator::SimulatedSonar;
use indicatif::ProgressBar;

use crate::arguments::{DemoArguments, PoseClock};
use crate::commands::judging::Judge;
use crate::config::Config;
use crate::exit::Finish;
use crate::pipeline::{
    self, Expectations, Gate, Hooks, Input, OnFinal, OnStatus, Outcome, Pace, Part, Patience,
    Phase, Poses, Setup, Shedding,
};
use crate::rig::{PosesTo, Rig};
use crate::signals::Stop;
use crate::web::Page;
use crate::{clock, dives, files, inputs, logging, maps, truth};
use report::Results;

/// How long the subscriber may take to have the final map.
const SUBSCRIBER_LIMIT: Duration = Duration::from_secs(20);

/// # Errors
/// If something cannot be started or written, or the subscriber's map is not the service's.
pub(crate) fn run(arguments: &DemoArguments) -> anyhow::Result<Finish> {
    let config = configuration(arguments)?;
    let stop = Stop::on_signals()?;
    let sonar = dives::sonar(&arguments.dive, arguments.duration)?;
    let (scene, dive) = (Arc::clone(sonar.scene()), Arc::clone(sonar.dive()));
    let is_watched = config.web.address.is_some();
    logging::print(&words::plan(
        &dive,
        scene.name(),
        is_watched,
        &arguments.out,
    ));
    let page = Page::start(&config)?;
    let feed = page.as_ref().map(Page::feed);
    let truth = move || truth::of_simulated(&scene, &dive);
    let judge = Judge::start(Some(Box::new(truth)), true, feed.clone())?;
    let buses = Buses::open(&config.bus)?;
    let received = Arc::new(Mutex::new(None));
    let mut setup = set_up(&config, sonar, &buses, &judge, &received)?;
    setup.hooks.page = feed;
    setup.hooks.page_heartbeats = page.as_ref().map(Page::heartbeats).unwrap_or_default();
    if let Some(page) = &page {
        page.control(setup.recorder.as_ref());
    }
    let outcome = pipeline::run(&config, setup, &stop);
    buses.close();
    let outcome = outcome?;
    let dive = &arguments.dive;
    let results = Results {
        title: format!("{}, {}", dive.scene, dive.dive),
        noise: dive.noise.to_string(),
        seed: dive.seed,
        verdict: judge.finish(&outcome, dive.seed)?,
        summary: outcome.status.summary(),
    };
    let finish = conclude(arguments, &outcome, &results, &received)?;
    if let Some(page) = page {
        page.stay(&stop);
    }
    Ok(finish)
}

fn configuration(arguments: &DemoArguments) -> anyhow::Result<Config> {
    let map = arguments.out.join("map.ply");
    maps::prepare(&map)?;
    let mut config = Config::default();
    config.mapper.threads = arguments.threads.unwrap_or(config.mapper.threads);
    config.output.map = Some(map);
    config.web.address.clone_from(&arguments.web);
    // Nothing that runs on the vehicle has this name.
    config.bus.node = "demo".to_owned();
    let pipeline = &mut config.pipeline;
    pipeline.hold_back_every = arguments.hold_back.unwrap_or(pipeline.hold_back_every);
    config.checked()
}

/// Takers of poses and map first, then the sonar that makes them come.
fn set_up(
    config: &Config,
    sonar: SimulatedSonar,
    buses: &Buses,
    judge: &Judge,
    received: &Arc<Received>,
) -> anyhow::Result<Setup> {
    let poses = inputs::poses(&config.pose.url, Some(&buses.service), StampClock::Data)?;
    let subscriber = buses.subscriber.subscribe_map()?;
    let length_s = sonar.dive().duration_s();
    let poses_to = PosesTo {
        bus: Arc::clone(&buses.sonar),
        clock: PoseClock::Device,
    };
    let rate = match config.web.address {
        Some(_) => words::WATCHED_RATE,
        None => 0.0,
    };
    let rig = Rig::start(sonar, &loopback(), rate, Some(poses_to))?;
    logging::print(&format!(
        "The simulated OmniScan 450 is at {}; the map is published on {}.",
        rig.url(),
        buses.service.keys().deltas()
    ));
    let driver = rig.driver(config)?;
    let recorder = inputs::recorder(config, &driver.session, false)?;
    Ok(Setup {
        part: Part::Whole,
        expectations: Expectations {
            sonar: rig.url().to_owned(),
            pace: Pace::AsMapped,
            ping_interval_s: 0.0,
            range_m: [0.0; 2],
        },
        inputs: vec![Input::link(driver)],
        poses: Poses::new(config, poses, Patience::HoldBack, recorder.clone())?,
        gate: Gate::default(),
        bus: Some(Arc::clone(&buses.service)),
        recorder,
        shedding: Shedding::none(),
        places: Vec::new(),
        losses: Vec::new(),
        epoch: clock::now().nanos().unsigned_abs(),
        hooks: Hooks {
            observer: Some(judge.observer()),
            way: Some(judge.way()),
            on_status: Some(progress(length_s, judge.newest())),
            is_over: Some(rig.end_of_dive()),
            on_final: Some(receiving(subscriber, received)),
            ..Hooks::default()
        },
    })
}

/// The map at the subscriber's end, once it was asked for.
type Received = Mutex<Option<anyhow::Result<Arc<Snapshot>>>>;

/// The service, the sonar with its poses, and a subscriber: three sessions that meet on a port of
/// this demo's own.
struct Buses {
    service: Arc<Bus>,
    sonar: Arc<Bus>,
    subscriber: Arc<Bus>,
}

impl Buses {
    fn open(base: &BusConfig) -> anyhow::Result<Self> {
        let endpoint = format!("[\"tcp/127.0.0.1:{}\"]", free_port()?);
        let with = |listen: &str, connect: &str| {
            let settings = [
                ("listen/endpoints", listen),
                ("connect/endpoints", connect),
                ("connect/timeout_ms", "-1"),
            ];
            let owned = |(key, value): (&str, &str)| (key.to_owned(), value.to_owned());
            inputs::open_bus(BusConfig {
                zenoh: settings.map(owned).into(),
                ..base.clone()
            })
        };
        Ok(Self {
            service: with(&endpoint, "[]")?,
            sonar: with("[]", &endpoint)?,
            subscriber: with("[]", &endpoint)?,
        })
    }

    fn close(self) {
        for bus in [self.subscriber, self.sonar, self.service] {
            inputs::close_bus(Some(bus));
        }
    }
}

fn loopback() -> ListenUrl {
    ListenUrl::Tcp("127.0.0.1:0".to_owned())
}

/// A bar over dive time with the newest error.
fn progress(length_s: f64, newest: Arc<Mutex<Option<Sample>>>) -> OnStatus {
    let bar: ProgressBar = logging::progress_bar(
        length_s as u64,
        "{bar:40} {pos:>3} of {len} s of dive · {msg}",
    );
    Box::new(move |status| {
        bar.set_position(status.report.dive_s as u64);
        let newest = newest.lock().unwrap_or_else(PoisonError::into_inner);
        let error = newest.as_ref().map_or("–".to_owned(), |sample| {
            format!("CD {} m", table::metres(sample.metrics.cd_m))
        });
        let work = match status.phase {
            Phase::Finishing => "finishing".to_owned(),
            _ => format!("{:.0} pings/s", status.rates.mapped_per_s),
        };
        let gaussians = status.report.mapper.confident;
        bar.set_message(format!("{error} · {gaussians} Gaussians · {work}"));
        if status.is_final {
            bar.finish_and_clear();
        }
    })
}

/// Keeps what the subscriber has in the end.
fn receiving(subscriber: MapSubscriber, received: &Arc<Received>) -> OnFinal {
    let received = Arc::clone(received);
    Box::new(move |_| {
        let map = subscriber.wait_final(SUBSCRIBER_LIMIT);
        let map = map.map_err(anyhow::Error::new);
        *received.lock().unwrap_or_else(PoisonError::into_inner) = Some(map);
    })
}

fn conclude(
    arguments: &DemoArguments,
    outcome: &Outcome,
    results: &Results,
    received: &Received,
) -> anyhow::Result<Finish> {
    let received = received
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .take()
        .context("the subscriber was never asked")??;
    let same = compare(&outcome.snapshot, &received)?;
    let report = arguments.out.join("report.html");
    files::write("--out", &report, results.html(outcome, same).as_bytes())?;
    logging::print(&outcome.status.account());
    logging::print(&format!(
        "The subscriber, in a session of its own, holds the same {same} Gaussians, bit for bit."
    ));
    logging::print(&written(&arguments.out));
    logging::print(&words::next(&words::called()));
    Ok(outcome.finish())
}

fn written(out: &Path) -> String {
    let at = |name: &str| out.join(name).display().to_string();
    format!("Written: {}, {}", at("map.ply"), at("report.html"))
}

/// Both in order of id; how many they hold.
fn compare(ours: &Snapshot, theirs: &Snapshot) -> anyhow::Result<usize> {
    let differs = |what: String| anyhow!("the subscriber's map is not the service's: {what}");
    if ours.gaussians.len() != theirs.gaussians.len() {
        let (ours, theirs) = (ours.gaussians.len(), theirs.gaussians.len());
        return Err(differs(format!("{theirs} Gaussians in place of {ours}")));
    }
    if ours.origin_m != theirs.origin_m {
        return Err(differs("another origin".to_owned()));
    }
    if ours.intensity_unit.to_bits() != theirs.intensity_unit.to_bits() {
        return Err(differs("another unit of intensity".to_owned()));
    }
    let mut pairs = ours.gaussians.iter().zip(&theirs.gaussians);
    match pairs.find(|(a, b)| !is_same(a, b)) {
        Some((a, b)) => Err(differs(format!("{b:?} in place of {a:?}"))),
        None => Ok(ours.gaussians.len()),
    }
}

/// Bit for bit, so that a sigma that is not a number would be told too.
fn is_same(a: &Gaussian, b: &Gaussian) -> bool {
    let numbers = |g: &Gaussian| {
        let mut numbers = [0; 13];
        let all = g.mean_m.to_array().into_iter().chain(g.rotation.to_array());
        let all = all.chain(g.scale_m.to_array());
        let all = all.chain([g.opacity, g.reflectivity, g.sigma_m]);
        numbers
            .iter_mut()
            .zip(all)
            .for_each(|(bits, number)| *bits = number.to_bits());
        numbers
    };
    a.id == b.id && a.standing == b.standing && numbers(a) == numbers(b)
}
