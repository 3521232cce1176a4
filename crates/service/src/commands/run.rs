//! `echosplat run`: the service.

use std::collections::HashSet;
use std::sync::Arc;

use echosplat_bus::Bus;
use echosplat_driver::{ListenUrl, SonarUrl};
use echosplat_join::StampClock;
use echosplat_pose::PoseUrl;
use echosplat_session::ClockSource;

use crate::arguments::{DiveArguments, PoseClock, RunArguments};
use crate::commands::{judge, show_figures};
use crate::config::{Config, Overrides};
use crate::exit::Finish;
use crate::pipeline::{self, Album, Expectations, Gate, Hooks, Input, Patience, Poses, Setup};
use crate::rig::{PosesTo, Rig};
use crate::signals::Stop;
use crate::web::Page;
use crate::{clock, dives, inputs, logging, maps};

/// # Errors
/// If something asked for cannot be, or the map cannot be written.
pub(crate) fn run(arguments: &RunArguments) -> anyhow::Result<Finish> {
    let overrides = Overrides {
        sonar: arguments.sonar.clone(),
        pose: arguments.pose.clone(),
        time_offset_s: arguments.time_offset_s,
        ..Overrides::default()
    };
    let config = Config::assemble(&arguments.service, overrides)?;
    let album = Album::parse(arguments.service.maps_every.as_deref())?;
    let url = inputs::sonar_url(&config.sonar.url)?;
    if let SonarUrl::File(log) = &url {
        inputs::check_log(log)?;
    }
    if let Some(map) = &config.output.map {
        maps::prepare(map)?;
    }
    let stop = Stop::on_signals()?;
    let page = Page::start(&config)?;
    let bus = inputs::open_bus(config.bus.clone())?;
    inputs::refuse_a_second_service(&bus)?;
    let finish = serve(&config, (album, page.as_ref()), url, &bus, &stop);
    inputs::close_bus(Some(bus));
    finish
}

fn serve(
    config: &Config,
    (album, page): (Option<Album>, Option<&Page>),
    url: SonarUrl,
    bus: &Arc<Bus>,
    stop: &Stop,
) -> anyhow::Result<Finish> {
    let rig = match &url {
        SonarUrl::Sim(scene) => Some(simulate(config, scene, bus)?),
        _ => None,
    };
    let driver = match &rig {
        Some(rig) => rig.driver(config)?,
        None => inputs::driver(config, url),
    };
    let (patience, clock) = match driver.session.clock {
        ClockSource::Device => (Patience::HoldBack, StampClock::Data),
        ClockSource::Host => (Patience::LetGo, StampClock::Host),
    };
    let source = inputs::poses(&config.pose.url, Some(bus), clock)?;
    let is_log = matches!(driver.url, SonarUrl::File(_));
    let recorder = inputs::recorder(config, &driver.session, is_log)?;
    if let Some(page) = page {
        page.control(recorder.as_ref());
    }
    let setup = Setup {
        expectations: Expectations {
            sonar: config.sonar.url.clone(),
            is_live: !is_log,
            ping_interval_s: driver.session.expected_interval_s(),
        },
        inputs: vec![Input::link(driver)],
        poses: Poses::new(&config.pose, source, patience, recorder.clone())?,
        gate: Gate::new(None, None, config.output.duration_s),
        bus: Some(Arc::clone(bus)),
        recorder,
        shed: HashSet::new(),
        epoch: clock::now().nanos().unsigned_abs(),
        hooks: Hooks {
            album,
            on_status: Some(show_figures()),
            is_over: rig.map(Rig::end_of_dive),
            page: page.map(Page::feed),
            page_heartbeats: page.map(Page::heartbeats).unwrap_or_default(),
            ..Hooks::default()
        },
    };
    let outcome = pipeline::run(config, setup, stop)?;
    judge(config.output.truth.as_deref(), &outcome.snapshot)?;
    logging::print(&outcome.status.account());
    Ok(outcome.finish())
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
