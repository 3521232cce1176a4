//! `echosplat watch`: the map of a running service, from wherever it stands.

use std::path::Path;
use std::time::{Duration, Instant};

use echosplat_bus::{Bus, Liveliness, MapSubscriber};
use serde_json::Value;

use crate::arguments::WatchArguments;
use crate::config::Config;
use crate::exit::Finish;
use crate::maps::MapNotes;
use crate::signals::Stop;
use crate::{inputs, logging, maps};

/// How often figures are renewed and the stop flag is asked.
const TICK: Duration = Duration::from_millis(200);

/// After the service is gone, how long its last answers may take to arrive.
const AFTERMATH: Duration = Duration::from_secs(2);

/// # Errors
/// If zenoh cannot be opened or the map cannot be written.
pub(crate) fn run(arguments: &WatchArguments) -> anyhow::Result<Finish> {
    let config = Config::with_bus(&arguments.bus)?;
    if let Some(map) = &arguments.map {
        maps::prepare(map)?;
    }
    let stop = Stop::on_signals()?;
    let bus = inputs::open_bus(config.bus)?;
    tracing::info!(keys = %bus.keys().deltas(), "watching");
    let subscriber = bus.subscribe_map()?;
    let ending = follow(&bus, &subscriber, arguments, &stop)?;
    let finish = conclude(&subscriber, arguments.map.as_deref(), ending)?;
    drop(subscriber);
    inputs::close_bus(Some(bus));
    Ok(finish)
}

/// Why following ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ending {
    /// The service has published its last map and all of it is here.
    Final,
    /// The service is gone without having said so.
    Gone,
    /// Ctrl-C, SIGTERM or `--duration`.
    Asked,
}

fn follow(
    bus: &Bus,
    subscriber: &MapSubscriber,
    arguments: &WatchArguments,
    stop: &Stop,
) -> anyhow::Result<Ending> {
    let status = bus.subscribe_status()?;
    let figures = logging::figures_line();
    let begin = Instant::now();
    let mut gone_since = None;
    let mut known = None;
    let mut newest_status = None;
    loop {
        let position = subscriber.wait_beyond(known, TICK);
        tell_of_new_epoch(known, position);
        if let (Some((_, sequence)), Some(time)) = (position, subscriber.time()) {
            tracing::debug!(sequence, time_ns = time.nanos(), "the map followed");
        }
        known = position;
        if let Some(status) = status.take_newest() {
            tracing::debug!(%status, "status");
            newest_status = Some(status);
        }
        figures.set_message(figures_of(subscriber, newest_status.as_ref()));
        figures.tick();
        if arguments.until_final && subscriber.is_final() {
            return Ok(Ending::Final);
        }
        gone_since = match subscriber.liveliness() {
            Liveliness::Gone => gone_since.or(Some(Instant::now())),
            _ => None,
        };
        let is_gone = gone_since.is_some_and(|since: Instant| since.elapsed() > AFTERMATH);
        if arguments.until_final && is_gone {
            return Ok(Ending::Gone);
        }
        let limit = arguments.duration.map(Duration::from_secs_f64);
        if stop.is_set() || limit.is_some_and(|limit| begin.elapsed() >= limit) {
            return Ok(Ending::Asked);
        }
    }
}

/// Says when the map in hand is no longer the one followed so far.
fn tell_of_new_epoch(before: Option<(u64, u64)>, now: Option<(u64, u64)>) {
    if let (Some((before, _)), Some((now, _))) = (before, now)
        && before != now
    {
        tracing::warn!(
            epoch = now,
            "the service began a new map: the one followed so far is let go, and this one followed; \
             the service keeps the earlier one where it writes its maps"
        );
    }
}

fn figures_of(subscriber: &MapSubscriber, status: Option<&Value>) -> String {
    let state = match subscriber.liveliness() {
        Liveliness::Unknown => "no service yet",
        Liveliness::Alive => "live",
        Liveliness::Gone => "the service is gone",
    };
    let number = |path: &str| {
        let value = status.and_then(|status| status.pointer(path));
        value.and_then(Value::as_f64).unwrap_or(0.0)
    };
    let link = status.and_then(|status| status.pointer("/link/state"));
    format!(
        "{state} · {} Gaussians · {:.0} pings, {:.1}/s · sonar {}",
        subscriber.gaussian_count(),
        number("/pings_received"),
        number("/rates/pings_per_s"),
        link.and_then(Value::as_str).unwrap_or("?"),
    )
}

fn conclude(
    subscriber: &MapSubscriber,
    map: Option<&Path>,
    ending: Ending,
) -> anyhow::Result<Finish> {
    let snapshot = subscriber.newest();
    let counters = serde_json::to_string(&subscriber.counters()).unwrap_or_default();
    tracing::info!(
        ?ending,
        gaussians = subscriber.gaussian_count(),
        position = ?subscriber.position(),
        counters,
        "no longer watching"
    );
    match (snapshot, map) {
        // What was kept from it only the service knows.
        (Some(snapshot), Some(map)) => {
            maps::write(&snapshot, map, &MapNotes::default())?;
        }
        (None, Some(_)) => tracing::warn!("no map came, so none is written"),
        (_, None) => {}
    }
    let is_whole = ending != Ending::Gone || subscriber.is_final();
    Ok(if is_whole {
        Finish::Done
    } else {
        Finish::Lossy
    })
}
