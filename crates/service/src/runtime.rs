//! The one runtime of the service: links, the page and signals are its tasks.

use std::io;
use std::sync::LazyLock;
use std::time::Duration;

use anyhow::anyhow;
use echosplat_liveness::Heartbeat;
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::time::interval;

/// What a task does between two waits is short, and what may take long lets go of its worker first.
const WORKERS: usize = 2;
/// Threads for what may take long, made as they are needed: more than the page has connections, so
/// that a link never waits for one.
const MOST_BLOCKING: usize = 256;
/// How often the runtime shows that its tasks go on.
const BEAT_EVERY: Duration = Duration::from_millis(200);

/// Never ended: a task that hangs would keep the program from ending.
struct Network {
    runtime: Runtime,
    heartbeat: Heartbeat,
}

static NETWORK: LazyLock<io::Result<Network>> = LazyLock::new(|| {
    let runtime = Builder::new_multi_thread()
        .worker_threads(WORKERS)
        .max_blocking_threads(MOST_BLOCKING)
        .thread_name("network")
        .enable_all()
        .build()?;
    let heartbeat = Heartbeat::new("network");
    runtime.spawn(beat(heartbeat.clone()));
    Ok(Network { runtime, heartbeat })
});

async fn beat(heartbeat: Heartbeat) {
    let mut due = interval(BEAT_EVERY);
    loop {
        due.tick().await;
        heartbeat.beat();
    }
}

fn network() -> anyhow::Result<&'static Network> {
    let made = NETWORK.as_ref();
    made.map_err(|error| anyhow!("the threads for the network cannot be started: {error}"))
}

/// Where tasks are begun.
///
/// # Errors
/// If the system gives no threads.
pub(crate) fn handle() -> anyhow::Result<Handle> {
    network().map(|network| network.runtime.handle().clone())
}

/// Whether tasks go on at all.
///
/// # Errors
/// As [`handle`].
pub(crate) fn heartbeat() -> anyhow::Result<&'static Heartbeat> {
    network().map(|network| &network.heartbeat)
}
