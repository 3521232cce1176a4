//! A log read at once, for commands that look at a dive after it: every ping joined with its pose.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use echosplat_model::{Ping, PosedPing};
use echosplat_pose::{JoinCounters, PoseUrl};
use echosplat_recording::svlog::SvlogReader;
use echosplat_session::{ClockSource, Session, SessionConfig, SessionEvent};

use crate::config::Config;
use crate::exit::Usage;
use crate::pipeline::{Patience, Poses};
use crate::{clock, inputs};

/// Calls `take` for each ping of `log` that has its pose in `poses`, in the order of the log and
/// with the mount and the time offset of the configuration, as a replay would.
///
/// # Errors
/// Says which of the files is not what it should be.
pub(crate) fn posed_pings(
    log: &Path,
    poses: &Path,
    config: &Config,
    mut take: impl FnMut(PosedPing),
) -> anyhow::Result<JoinCounters> {
    let source = inputs::poses(&PoseUrl::Tum(poses.to_owned()), None)?;
    let mut poses = Poses::new(&config.pose, source, Patience::HoldBack, None)?;
    pings(log, &config.session, |ping| {
        poses.push(ping, Instant::now());
        while let Some((posed, _)) = poses.next() {
            take(posed);
        }
    })?;
    poses.finish();
    while let Some((posed, _)) = poses.next() {
        take(posed);
    }
    Ok(poses.report().join)
}

/// Calls `take` for each ping of `log`, in its order.
///
/// # Errors
/// If the file is not a log.
pub(crate) fn pings(
    log: &Path,
    config: &SessionConfig,
    mut take: impl FnMut(Arc<Ping>),
) -> anyhow::Result<()> {
    let refused =
        |error: &dyn std::fmt::Display| Usage::error(format!("log {}: {error}", log.display()));
    let file = File::open(log).map_err(|error| refused(&error))?;
    let mut reader = SvlogReader::new(BufReader::new(file)).map_err(|error| refused(&error))?;
    let config = SessionConfig {
        clock: ClockSource::Device,
        ..config.clone()
    };
    let mut session = Session::listening(config, clock::now());
    let mut deliver = |session: &mut Session| {
        while let Some(event) = session.poll_event() {
            if let SessionEvent::Ping { ping, .. } = event {
                take(ping);
            }
        }
    };
    while let Some(piece) = reader.next_piece().map_err(|error| refused(&error))? {
        session.receive(piece, clock::now());
        deliver(&mut session);
    }
    session.finish(clock::now());
    deliver(&mut session);
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
