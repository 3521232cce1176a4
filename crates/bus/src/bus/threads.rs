//! Threads by name, and what may not take for ever.

use std::time::Duration;

use crossbeam_channel::bounded;

use crate::BusError;

/// Starts a named thread.
pub(crate) fn spawn(
    name: &'static str,
    run: impl FnOnce() + Send + 'static,
) -> Result<std::thread::JoinHandle<()>, BusError> {
    let thread = std::thread::Builder::new().name(name.to_owned());
    thread.spawn(run).map_err(|reason| BusError::Zenoh {
        action: format!("start the thread {name}"),
        reason: reason.to_string(),
    })
}

/// Runs `work` on a thread of its own and waits for it no longer than `limit`. A thread of its
/// own also keeps zenoh's blocking calls out of whatever runtime the caller lives in.
pub(super) fn within<T: Send + 'static>(
    action: &'static str,
    limit: Duration,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, BusError> {
    let (sender, receiver) = bounded(1);
    spawn("bus-session", move || {
        // Nobody may be waiting any more.
        let _ = sender.send(work());
    })?;
    receiver
        .recv_timeout(limit)
        .map_err(|_| BusError::TimedOut { action, limit })
}
