//! Ctrl-C, SIGTERM and a terminal that is closed: the first asks for an orderly end, one that comes later ends at once.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use anyhow::Context;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

/// Shells and supervisors send one request several times over; only a later one is impatience.
const ONE_REQUEST: Duration = Duration::from_secs(1);

/// Whether the program shall end; cheap to copy and to ask.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stop {
    asked: Arc<AtomicBool>,
    seen: Arc<OnceLock<Instant>>,
    /// Whether the next signal ends the program at once.
    impatient: Arc<AtomicBool>,
}

impl Stop {
    /// Set by the first Ctrl-C, SIGTERM or SIGHUP.
    ///
    /// # Errors
    /// If the handlers cannot be installed.
    pub(crate) fn on_signals() -> anyhow::Result<Self> {
        let stop = Self::default();
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&stop.impatient))
                .and_then(|_| flag::register(signal, Arc::clone(&stop.asked)))
                .context("cannot install the handlers of Ctrl-C, SIGTERM and SIGHUP")?;
        }
        Ok(stop)
    }

    /// Whether to end; to be asked now and then, also while ending.
    pub(crate) fn is_set(&self) -> bool {
        let is_set = self.asked.load(Ordering::Relaxed);
        if is_set && self.seen.get_or_init(Instant::now).elapsed() > ONE_REQUEST {
            self.impatient.store(true, Ordering::Relaxed);
        }
        is_set
    }
}
