//! How well the running map predicts pings that are kept from it: the error of a dive without a
//! truth. On a thread of its own, whose time is not the mapper's; while the dive goes on nothing waits
//! for it, and what it cannot take in time is left out and counted.
//!
//! Cost: every ten seconds of the dive up to 512 pings are rendered.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::Context;
use crossbeam_channel::{Receiver, Sender, bounded};
use echosplat_liveness::Heartbeat;
use echosplat_mapper::MapperConfig;
use echosplat_model::{PosedPing, Snapshot};
use echosplat_prediction::held_out::{Pair, is_fitted_on, is_held_out, score};
use echosplat_prediction::{MapRenderer, pair_of};
use serde::Serialize;

use crate::thinned::Thinned;

/// Time between two maps that are asked for predictions, on the pings' clock.
const ASKED_EVERY_S: f64 = 10.0;
/// Most pings predicted, and most others that gain and floor are fitted on.
const MOST_PINGS: usize = 256;
/// Pings and maps that wait.
const QUEUE: usize = 1024;

/// What the map of one moment says of pings it was not made of.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Predicted {
    /// On the pings' clock, since the first.
    pub(crate) dive_s: f64,
    /// Pings predicted, of all so far.
    pub(crate) pings: u64,
    /// Mean logarithm of the density of a bin's intensity.
    pub(crate) log_likelihood_per_bin: f64,
    /// That above what a constant says: above 0 the map says something.
    pub(crate) gain_per_bin: f64,
}

enum News {
    Ping(PosedPing),
    Map(Arc<Snapshot>, f64),
}

/// The thread, and what it found.
pub(crate) struct Prediction {
    news: Sender<News>,
    thread: JoinHandle<()>,
    heartbeat: Heartbeat,
    newest: Arc<Mutex<Option<Predicted>>>,
    left_out: AtomicU64,
    every: u64,
    next_s: f64,
}

impl Prediction {
    /// For every `every`-th ping held out, at least 1.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub(crate) fn start(every: u64, config: MapperConfig) -> anyhow::Result<Self> {
        let (news, receiver) = bounded(QUEUE);
        let heartbeat = Heartbeat::new("prediction");
        let beats = heartbeat.clone();
        let newest = Arc::new(Mutex::new(None));
        let shown = Arc::clone(&newest);
        let thread = std::thread::Builder::new()
            .name("prediction".to_owned())
            .spawn(move || {
                beats.run_once(|| predict_all(&receiver, every, &config, &shown));
            })
            .context("cannot start the thread that predicts pings")?;
        Ok(Self {
            news,
            thread,
            heartbeat,
            newest,
            left_out: AtomicU64::new(0),
            every,
            next_s: 0.0,
        })
    }

    /// Whether its thread is alive.
    pub(crate) fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// Takes a ping if it is one of those that are predicted, or fitted on.
    pub(crate) fn ping(&self, posed: &PosedPing) {
        let sequence = posed.ping.sequence();
        if is_held_out(sequence, self.every) || is_fitted_on(sequence, self.every) {
            self.tell(News::Ping(posed.clone()));
        }
    }

    /// Asks a map, when it is time.
    pub(crate) fn map(&mut self, snapshot: &Arc<Snapshot>, dive_s: f64) {
        if dive_s >= self.next_s {
            self.next_s = dive_s + ASKED_EVERY_S;
            self.tell(News::Map(Arc::clone(snapshot), dive_s));
        }
    }

    fn tell(&self, news: News) {
        if self.news.try_send(news).is_err() {
            self.left_out.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// What the newest map asked says.
    pub(crate) fn newest(&self) -> Option<Predicted> {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks the last map, and waits for its answer.
    pub(crate) fn finish(self, last: &Arc<Snapshot>, dive_s: f64) -> Option<Predicted> {
        // The queue may be full, but not for long.
        let _ = self.news.send(News::Map(Arc::clone(last), dive_s));
        drop(self.news);
        let left_out = self.left_out.load(Ordering::Relaxed);
        if left_out > 0 {
            tracing::debug!(
                left_out,
                "pings and maps came faster than they were predicted"
            );
        }
        // A panic in it is told by its heartbeat.
        let _ = self.thread.join();
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn predict_all(
    news: &Receiver<News>,
    every: u64,
    config: &MapperConfig,
    newest: &Mutex<Option<Predicted>>,
) {
    let [mut held, mut fit] = [Thinned::new(MOST_PINGS), Thinned::new(MOST_PINGS)];
    for news in news {
        match news {
            News::Ping(posed) => match is_held_out(posed.ping.sequence(), every) {
                true => held.push(|| posed),
                false => fit.push(|| posed),
            },
            News::Map(snapshot, dive_s) => {
                let found = predict(&snapshot, held.kept(), fit.kept(), config, dive_s);
                if let Some(found) = found {
                    *newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(found);
                }
            }
        }
    }
}

fn predict(
    map: &Snapshot,
    held: &[PosedPing],
    fit: &[PosedPing],
    config: &MapperConfig,
    dive_s: f64,
) -> Option<Predicted> {
    let mut renderer = MapRenderer::new(map.origin_m, map.intensity_unit, &map.gaussians);
    let mut pairs = |pings: &[PosedPing]| -> Vec<Pair> {
        let pair = |posed| pair_of(&mut renderer, posed, config);
        pings.iter().map(pair).collect()
    };
    let found = score(&pairs(fit), &pairs(held))?;
    Some(Predicted {
        dive_s,
        pings: found.ping_count,
        log_likelihood_per_bin: found.map.log_likelihood_per_bin,
        gain_per_bin: found.gain_per_bin,
    })
}
