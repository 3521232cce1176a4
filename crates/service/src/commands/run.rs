//! `echosplat run`: the service, or its part on one of two machines.

use std::sync::Arc;

use echosplat_bus::{Bus, DRIVER_ROLE};
use echosplat_driver::{DriverConfig, ListenUrl, SonarUrl};
use echosplat_join::StampClock;
use echosplat_metrics::Truth;
use echosplat_pose::PoseUrl;
use echosplat_session::ClockSource;

use crate::arguments::{DiveArguments, PoseClock, Role, RunArguments};
use crate::commands::{judge, show_figures};
use crate::config::{Config, Overrides};
use crate::decided::Decided;
use crate::exit::{Finish, Usage};
use crate::pipeline::{
    self, Album, Expectations, Gate, Gnss, Hooks, Input, Outcome, Pace, Part, Patience, Poses,
    Setup, Shedding, range_of,
};
use crate::recorder::Recorder;
use crate::rig::{PosesTo, Rig};
use crate::signals::Stop;
use crate::split::{Resumed, Vehicle, VehicleTape};
use crate::web::Page;
use crate::{clock, dives, inputs, logging, maps, truth};

/// # Errors
/// If something asked for cannot be, or the map cannot be written.
pub(crate) fn run(arguments: &RunArguments) -> anyhow::Result<Finish> {
    refuse_what_is_the_others(arguments)?;
    let config = configuration(arguments)?;
    if arguments.role != Role::All && config.georeference.gnss.is_some() {
        tracing::warn!(
            "georeference.gnss is not read with --role driver or mapper: `echosplat georeference` places the map afterwards"
        );
    }
    match arguments.role {
        Role::Driver => drive(&config),
        Role::All | Role::Mapper => run_and_map(arguments, &config),
    }
}

/// The file's settings with the command line's on top.
///
/// # Errors
/// If one of them is wrong.
pub(crate) fn configuration(arguments: &RunArguments) -> anyhow::Result<Config> {
    let overrides = Overrides {
        sonar: arguments.sonar.clone(),
        pose: arguments.pose.clone(),
        time_offset_s: arguments.time_offset_s,
        ..Overrides::default()
    };
    Config::assemble(&arguments.service, overrides)
}

/// What is asked for on the command line and another role does.
fn refuse_what_is_the_others(arguments: &RunArguments) -> anyhow::Result<()> {
    let service = &arguments.service;
    let of_mapper = [
        ("--map", service.map.is_some()),
        ("--maps-every", service.maps_every.is_some()),
        ("--truth", service.truth.is_some()),
        ("--web", service.web.is_some()),
    ];
    let of_driver = [
        ("--sonar", arguments.sonar.is_some()),
        ("--pose", arguments.pose.is_some()),
    ];
    let resume = ("--resume", !arguments.resume.is_empty());
    let refused: &[_] = match arguments.role {
        Role::All => &[resume],
        Role::Driver => &[
            of_mapper[0],
            of_mapper[1],
            of_mapper[2],
            of_mapper[3],
            resume,
        ],
        Role::Mapper => &of_driver,
    };
    let Some((option, _)) = refused.iter().find(|(_, is_asked)| *is_asked) else {
        return Ok(());
    };
    let whose = match arguments.role {
        Role::Mapper => "driver",
        Role::All | Role::Driver => "mapper",
    };
    Err(Usage::error(format!(
        "{option} is for --role {whose}: leave it out here, and give it there"
    )))
}

fn run_and_map(arguments: &RunArguments, config: &Config) -> anyhow::Result<Finish> {
    let is_whole = arguments.role == Role::All;
    let album = Album::parse(arguments.service.maps_every.as_deref())?;
    let url = inputs::sonar_url(&config.sonar.url)?;
    if let (SonarUrl::File(log), true) = (&url, is_whole) {
        inputs::check_log(log)?;
    }
    let resumed = Resumed::open(&arguments.resume)?;
    if let Some(map) = &config.output.map {
        maps::prepare(map)?;
    }
    let stop = Stop::on_signals()?;
    // What is wrong with it shall not be found out after the dive.
    let truth = config.output.truth.as_deref();
    let truth = truth.map(truth::load).transpose()?;
    let page = Page::start(config)?;
    let bus = inputs::open_bus(config.bus.clone())?;
    let shown = (album, page.as_ref());
    let outcome = if is_whole {
        inputs::refuse_a_second_service(&bus, Part::Whole.roles())?;
        serve(config, shown, url, &bus, &stop).map(Some)
    } else {
        let part = Part::Mapper(Default::default());
        inputs::refuse_a_second_service(&bus, part.roles())?;
        map_what_the_driver_hears(config, shown, resumed, &bus, &stop)
    };
    let finish = outcome.map(|outcome| match outcome {
        Some(outcome) => conclude(&outcome, truth.as_ref()),
        None => Finish::Done,
    });
    inputs::close_bus(Some(bus));
    finish
}

/// `--role driver`.
fn drive(config: &Config) -> anyhow::Result<Finish> {
    let url = inputs::sonar_url(&config.sonar.url)?;
    if let SonarUrl::File(log) = &url {
        return Err(Usage::error(format!(
            "--role driver talks to a sonar, and {} is a log: map it with `echosplat replay`",
            log.display()
        )));
    }
    let output = &config.output;
    if output.map.is_some() || output.track.is_some() || config.web.address.is_some() {
        tracing::info!(
            "output.map, output.track and web.address of the configuration are for --role mapper"
        );
    }
    let stop = Stop::on_signals()?;
    let bus = inputs::open_bus(config.bus.clone())?;
    inputs::refuse_a_second_service(&bus, &[DRIVER_ROLE])?;
    let (driver, rig) = sonar(config, url, &bus)?;
    let (_, clock) = clock_of(&driver);
    let vehicle = Vehicle {
        config,
        poses: inputs::poses(&config.pose.url, Some(&bus), clock)?,
        driver,
        bus: &bus,
        is_over: rig.map(Rig::end_of_dive),
    };
    let finish = vehicle.run(&stop);
    inputs::close_bus(Some(bus));
    finish
}

fn sonar(
    config: &Config,
    url: SonarUrl,
    bus: &Arc<Bus>,
) -> anyhow::Result<(DriverConfig, Option<Rig>)> {
    let rig = match &url {
        SonarUrl::Sim(scene) => Some(simulate(config, scene, bus)?),
        _ => None,
    };
    let driver = match &rig {
        Some(rig) => rig.driver(config)?,
        None => inputs::driver(config, url),
    };
    Ok((driver, rig))
}

/// Whose clock the pings are on, and what that means for those whose poses are late.
fn clock_of(driver: &DriverConfig) -> (Patience, StampClock) {
    match driver.session.clock {
        ClockSource::Device => (Patience::HoldBack, StampClock::Data),
        ClockSource::Host => (Patience::LetGo, StampClock::Host),
    }
}

/// `--role mapper`: waits for the driver first; `None` if an end was asked for before it was there.
fn map_what_the_driver_hears(
    config: &Config,
    (album, page): (Option<Album>, Option<&Page>),
    mut resumed: Option<Resumed>,
    bus: &Arc<Bus>,
    stop: &Stop,
) -> anyhow::Result<Option<Outcome>> {
    let decided = resumed.as_mut().map(Resumed::take_decided);
    let losses = resumed.as_ref().map_or(Vec::new(), Resumed::losses);
    for loss in &losses {
        tracing::warn!("--resume: {loss}");
    }
    let let_go = decided.as_ref().map(|decided| decided.let_go.clone());
    let queue_pings = config.pipeline.queue_pings;
    let met = VehicleTape::meet(bus.follow_tape(), resumed, queue_pings, stop)?;
    let Some((tape, source)) = met else {
        return Ok(None);
    };
    let begin = tape.begin().clone();
    let (patience, clock) = begin.clock();
    let recorder = inputs::recorder_of_tape(config, &begin)?;
    if let Some(page) = page {
        page.control(recorder.as_ref());
    }
    let poses = Poses::new(config, source, patience, recorder.clone())?;
    let duration_s = config.output.duration_s.or(begin.duration_s);
    let setup = Setup {
        expectations: Expectations {
            sonar: begin.sonar.clone(),
            pace: Pace::Live,
            ping_interval_s: begin.session.expected_interval_s(),
            range_m: range_of(&begin.session),
        },
        part: Part::Mapper(tape.state()),
        inputs: vec![tape.recorded_by(recorder.clone()).into_input()],
        shedding: shedding(config, patience, recorder.clone(), decided),
        losses,
        places: Vec::new(),
        poses: poses.of_tape(clock, begin.guards_poses, let_go.unwrap_or_default()),
        gate: Gate::new(None, None, duration_s),
        bus: Some(Arc::clone(bus)),
        recorder,
        epoch: clock::now().nanos().unsigned_abs(),
        hooks: hooks(album, page),
    };
    pipeline::run(config, setup, stop).map(Some)
}

/// By the load where the sonar waits for nobody; first as a recording says that was resumed.
fn shedding(
    config: &Config,
    patience: Patience,
    recorder: Option<Recorder>,
    decided: Option<Decided>,
) -> Shedding {
    let by_load = patience == Patience::LetGo;
    let shedding = Shedding::as_it_comes(by_load, config.pipeline.memory_bytes, recorder);
    match decided {
        Some(decided) => shedding.resuming(decided),
        None => shedding,
    }
}

fn hooks(album: Option<Album>, page: Option<&Page>) -> Hooks {
    Hooks {
        album,
        on_status: Some(show_figures()),
        page: page.map(Page::feed),
        page_heartbeats: page.map(Page::heartbeats).unwrap_or_default(),
        ..Hooks::default()
    }
}

fn conclude(outcome: &Outcome, truth: Option<&Truth>) -> Finish {
    if let Some(truth) = truth {
        judge(truth, &outcome.snapshot);
    }
    logging::print(&outcome.status.account());
    outcome.finish()
}

fn serve(
    config: &Config,
    (album, page): (Option<Album>, Option<&Page>),
    url: SonarUrl,
    bus: &Arc<Bus>,
    stop: &Stop,
) -> anyhow::Result<Outcome> {
    let (driver, rig) = sonar(config, url, bus)?;
    let (patience, clock) = clock_of(&driver);
    let source = inputs::poses(&config.pose.url, Some(bus), clock)?;
    let is_log = matches!(driver.url, SonarUrl::File(_));
    let recorder = inputs::recorder(config, &driver.session, is_log)?;
    if let Some(page) = page {
        page.control(recorder.as_ref());
    }
    let gnss = gnss(config, bus, recorder.as_ref())?;
    let setup = Setup {
        expectations: Expectations {
            sonar: config.sonar.url.clone(),
            pace: match is_log {
                true => Pace::AsMapped,
                false => Pace::Live,
            },
            ping_interval_s: driver.session.expected_interval_s(),
            range_m: range_of(&driver.session),
        },
        part: Part::Whole,
        inputs: vec![Input::link(driver)],
        shedding: shedding(config, patience, recorder.clone(), None),
        losses: Vec::new(),
        places: Vec::new(),
        poses: Poses::new(config, source, patience, recorder.clone())?.beside(gnss),
        gate: Gate::new(None, None, config.output.duration_s),
        bus: Some(Arc::clone(bus)),
        recorder,
        epoch: clock::now().nanos().unsigned_abs(),
        hooks: Hooks {
            is_over: rig.map(Rig::end_of_dive),
            ..hooks(album, page)
        },
    };
    pipeline::run(config, setup, stop)
}

/// The receiver that is configured, if one is.
fn gnss(config: &Config, bus: &Bus, recorder: Option<&Recorder>) -> anyhow::Result<Option<Gnss>> {
    let Some(url) = &config.georeference.gnss else {
        return Ok(None);
    };
    let source = inputs::gnss(url, bus)?;
    Ok(Some(Gnss::new(config, source, recorder.cloned())))
}

/// The sonar of `sim://SCENE`, at real time, on a port of its own.
fn simulate(config: &Config, scene: &str, bus: &Arc<Bus>) -> anyhow::Result<Rig> {
    let dive = DiveArguments {
        scene: scene.to_owned(),
        seed: config.sonar.seed,
        ..DiveArguments::default()
    };
    let sonar = dives::sonar(&dive, config.output.duration_s)?;
    let poses = (config.pose.url == PoseUrl::Zenoh).then(|| PosesTo {
        bus: Arc::clone(bus),
        clock: PoseClock::Device,
    });
    Rig::start(sonar, &ListenUrl::Tcp("127.0.0.1:0".to_owned()), 1.0, poses)
}
