//! A log read at once, for commands that look at a dive after it: every ping joined with its pose.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use crossbeam_channel::bounded;
use echosplat_driver::DriverEvent;
use echosplat_join::{ArrivedPose, JoinCounters};
use echosplat_model::{Ping, PosedPing};
use echosplat_pose::PoseUrl;

use crate::config::Config;
use crate::pipeline::Drivers;
use crate::replayed::Replayed;

/// Calls `take` for each ping of `log` that has its pose in `poses`, or without that file inside the
/// log itself; in the order of the log and with the mount and the time offset of the configuration,
/// as a replay would.
///
/// # Errors
/// Says which of the files is not what it should be.
pub(crate) fn posed_pings(
    log: &Path,
    poses: Option<&Path>,
    config: &Config,
    mut take: impl FnMut(PosedPing),
) -> anyhow::Result<JoinCounters> {
    let asked = poses.map(|path| PoseUrl::Tum(path.to_owned()));
    let replayed = Replayed::open(&[log.to_owned()])?;
    let decided = replayed.decided();
    let (mut poses, _) = replayed.poses(asked.as_ref(), config, None, None)?;
    events(&replayed, config, |event| match event {
        DriverEvent::ClockStepped => poses.clock_stepped(),
        DriverEvent::Mark(count) => {
            poses.take_through(count);
            while let Some(joined) = poses.pop() {
                take(joined.posed);
            }
        }
        DriverEvent::Ping { ping, .. } if !decided.leaves_out(ping.sequence()) => {
            poses.push(ping, Instant::now());
            while let Some(joined) = poses.pop() {
                take(joined.posed);
            }
        }
        _ => {}
    })?;
    poses.finish();
    while let Some(joined) = poses.pop() {
        take(joined.posed);
    }
    Ok(poses.report().join)
}

/// Says what the recording `log`, or the file of poses, lacks; and whether that is anything.
///
/// # Errors
/// As [`posed_pings`].
pub(crate) fn tell_losses(log: &Path, poses: Option<&Path>) -> anyhow::Result<bool> {
    let replayed = Replayed::open(&[log.to_owned()])?;
    let asked = poses.map(|path| PoseUrl::Tum(path.to_owned()));
    let (_, of_poses) = replayed.pose_source(asked.as_ref(), None)?;
    let losses = [replayed.losses(), of_poses].concat();
    for loss in &losses {
        tracing::warn!("{loss}");
    }
    Ok(!losses.is_empty())
}

/// All poses of `poses`, or without that file those inside the log.
///
/// # Errors
/// If there are none: says what to give.
pub(crate) fn poses(log: &Path, poses: Option<&Path>) -> anyhow::Result<Vec<ArrivedPose>> {
    let asked = poses.map(|path| PoseUrl::Tum(path.to_owned()));
    let replayed = Replayed::open(&[log.to_owned()])?;
    let (mut source, _) = replayed.pose_source(asked.as_ref(), None)?;
    Ok(std::iter::from_fn(|| source.try_next()).collect())
}

/// Calls `take` for each ping of `log`, in its order.
///
/// # Errors
/// If the file is not a log.
pub(crate) fn pings(
    log: &Path,
    config: &Config,
    mut take: impl FnMut(Arc<Ping>),
) -> anyhow::Result<()> {
    let replayed = Replayed::open(&[log.to_owned()])?;
    events(&replayed, config, |event| {
        if let DriverEvent::Ping { ping, .. } = event {
            take(ping);
        }
    })
}

/// Pings that wait between the driver's thread and this one.
const QUEUE: usize = 64;

/// What a driver tells of the log, as a replay hears it.
fn events(
    replayed: &Replayed,
    config: &Config,
    mut take: impl FnMut(DriverEvent),
) -> anyhow::Result<()> {
    let (sender, events) = bounded(QUEUE);
    let inputs = replayed.inputs(config, 0.0);
    let drivers = Drivers::start(inputs, None, sender)?;
    for event in events {
        take(event);
    }
    drop(drivers);
    Ok(())
}
