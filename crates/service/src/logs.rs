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
    let mut poses = replayed.poses(asked.as_ref(), config, None, None)?;
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

/// All poses of `poses`, or without that file those inside the log.
///
/// # Errors
/// If there are none: says what to give.
pub(crate) fn poses(log: &Path, poses: Option<&Path>) -> anyhow::Result<Vec<ArrivedPose>> {
    let asked = poses.map(|path| PoseUrl::Tum(path.to_owned()));
    let replayed = Replayed::open(&[log.to_owned()])?;
    let mut source = replayed.pose_source(asked.as_ref(), None)?;
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

/// At most some of a stream of unknown length, evenly chosen: when full, every second one goes,
/// and from then on every second one more is passed over.
#[derive(Debug)]
pub(crate) struct Thinned<T> {
    kept: Vec<T>,
    most: usize,
    stride: u64,
    seen: u64,
}

impl<T> Thinned<T> {
    /// `most` is at least 2.
    pub(crate) fn new(most: usize) -> Self {
        Self {
            kept: Vec::new(),
            most,
            stride: 1,
            seen: 0,
        }
    }

    /// Takes the next one, or not; `make` is called only for what is kept.
    pub(crate) fn push(&mut self, make: impl FnOnce() -> T) {
        let index = self.seen;
        self.seen += 1;
        if !index.is_multiple_of(self.stride) {
            return;
        }
        if self.kept.len() == self.most {
            let mut place = 0;
            self.kept.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            self.stride *= 2;
            if !index.is_multiple_of(self.stride) {
                return;
            }
        }
        self.kept.push(make());
    }

    pub(crate) fn kept(&self) -> &[T] {
        &self.kept
    }

    pub(crate) fn into_kept(self) -> Vec<T> {
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_stream_is_thinned_evenly() {
        for (count, expected) in [
            (3, vec![0, 1, 2]),
            (9, vec![0, 4, 8]),
            (8, vec![0, 2, 4, 6]),
        ] {
            let mut thinned = Thinned::new(4);
            (0..count).for_each(|i| thinned.push(|| i));
            assert_eq!(thinned.into_kept(), expected);
        }
    }
}
