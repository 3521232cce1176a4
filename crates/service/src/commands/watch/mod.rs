//! `echosplat watch`: the map of a running service, from wherever it stands.

mod telling;

use std::time::{Duration, Instant};

use echosplat_bus::{Bus, Liveliness, MapSubscriber};
use serde_json::Value;

use crate::arguments::WatchArguments;
use crate::config::Config;
use crate::exit::Finish;
use crate::maps::RunNotes;
use crate::pipeline::Keeper;
use crate::signals::Stop;
use crate::{inputs, logging, maps};
use telling::{Seen, Telling};

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
    tracing::info!("watching {}; Ctrl-C ends it", bus.keys().deltas());
    let subscriber = bus.subscribe_map()?;
    // What was kept from it only the service knows.
    let keeper = arguments.map.clone();
    let mut keeper = keeper.map(|map| Keeper::new(map, RunNotes::default()).due_at_once());
    let ending = follow(&bus, &subscriber, (arguments, keeper.as_mut()), &stop)?;
    let finish = conclude(&subscriber, keeper, ending)?;
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
    (arguments, mut keeper): (&WatchArguments, Option<&mut Keeper>),
    stop: &Stop,
) -> anyhow::Result<Ending> {
    let status = bus.subscribe_status()?;
    let figures = logging::figures_line();
    let begin = Instant::now();
    let service = bus.keys().alive().trim_end_matches("/alive").to_owned();
    let mut telling = Telling::new(service, begin);
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
        let seen = seen(subscriber, newest_status.as_ref());
        figures.set_message(seen.line());
        figures.tick();
        telling.tell(&seen, Instant::now());
        if let Some(keeper) = &mut keeper {
            keeper.tick(|| subscriber.newest().filter(|map| !map.gaussians.is_empty()));
            telling.tell_of_file(keeper.fault());
        }
        if arguments.until_final && seen.is_final {
            return Ok(Ending::Final);
        }
        gone_since = match seen.liveliness {
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

fn seen<'a>(subscriber: &MapSubscriber, status: Option<&'a Value>) -> Seen<'a> {
    let counters = subscriber.counters();
    Seen {
        liveliness: subscriber.liveliness(),
        position: subscriber.position(),
        is_final: subscriber.is_final(),
        gaussians: subscriber.gaussian_count(),
        unsound: counters.gaussians_unsound,
        first_unsound: subscriber.first_unsound(),
        malformed: counters.messages_malformed,
        first_fault: subscriber.first_fault(),
        status,
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

fn conclude(
    subscriber: &MapSubscriber,
    keeper: Option<Keeper>,
    ending: Ending,
) -> anyhow::Result<Finish> {
    let snapshot = subscriber.newest();
    let counters = serde_json::to_string(&subscriber.counters()).unwrap_or_default();
    tracing::debug!(position = ?subscriber.position(), counters, "no longer watching");
    let seen = seen(subscriber, None);
    let asked_for_a_file = keeper.is_some();
    logging::print(&telling::account(ending, &seen, asked_for_a_file));
    let has_map = snapshot.is_some();
    if let (Some(snapshot), Some(keeper)) = (snapshot, keeper) {
        keeper.finish(&snapshot)?;
    }
    let is_whole = ending != Ending::Gone || seen.is_final;
    let lacks_file = asked_for_a_file && !has_map;
    Ok(match is_whole && seen.unsound == 0 && !lacks_file {
        true => Finish::Done,
        false => Finish::Lossy,
    })
}
