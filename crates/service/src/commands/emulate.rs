//! `echosplat emulate`: the sonar, for any Ping client.

use std::time::Duration;

use echosplat_driver::{ListenUrl, ServeStatus};
use serde_json::{Value, json};

use crate::arguments::{EmulateArguments, PoseClock};
use crate::config::Config;
use crate::exit::{Finish, Usage};
use crate::rig::{PosesTo, Rig, Seen};
use crate::signals::Stop;
use crate::{dives, inputs, logging};

const TICK: Duration = Duration::from_millis(50);

/// # Errors
/// If there is no such dive, or the address cannot be listened on.
pub(crate) fn run(arguments: &EmulateArguments) -> anyhow::Result<Finish> {
    let listen: ListenUrl = arguments.listen.parse().map_err(Usage::error)?;
    let config = Config::with_bus(&arguments.bus)?;
    let sonar = dives::sonar(&arguments.dive, arguments.duration)?;
    let stop = Stop::on_signals()?;
    let bus = match arguments.publish_poses {
        true => Some(inputs::open_bus(config.bus)?),
        false => None,
    };
    let poses = bus.clone().map(|bus| PosesTo {
        bus,
        clock: pose_clock(arguments),
    });
    let rig = Rig::start(sonar, &listen, arguments.rate, poses)?;
    tracing::info!(pings = rig.dive().pings(), "listening on {}", rig.url());
    if !arguments.publish_poses {
        tracing::info!(
            "no poses are published: --publish-poses does so, in step with the pings; whoever sends \
             others starts them with the first ping"
        );
    }
    while !stop.is_set() {
        std::thread::sleep(TICK);
    }
    let (served, seen) = rig.stop();
    inputs::close_bus(bus);
    logging::print(&account(&served, &seen).to_string());
    Ok(Finish::Done)
}

/// What the device saw and did.
fn account(served: &ServeStatus, seen: &Seen) -> Value {
    let counters = &seen.counters;
    json!({
        "pings": counters.pings,
        "requests": counters.requests,
        "enables": counters.enables,
        "disables": counters.disables,
        "nacks": counters.nacks,
        "bytes_skipped": counters.bytes_skipped,
        "clients_seen": served.clients_seen,
        "frames_sent": served.frames_sent,
        "frames_dropped": served.frames_dropped,
        "is_pinging": served.is_pinging,
        "is_finished": seen.is_finished,
    })
}

/// At real time poses are stamped as a vehicle's would be, else on the dive's own clock.
fn pose_clock(arguments: &EmulateArguments) -> PoseClock {
    let is_real_time = (arguments.rate - 1.0).abs() < 1e-9;
    arguments.pose_clock.unwrap_or(match is_real_time {
        true => PoseClock::Host,
        false => PoseClock::Device,
    })
}
