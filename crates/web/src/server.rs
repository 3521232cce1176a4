//! Listens, bounds who may connect, and ends.

use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use axum::Router;
use echosplat_bus::BusConfig;
use echosplat_liveness::Heartbeat;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpStream;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio::task;

use crate::about::About;
use crate::access::Access;
use crate::address::is_loopback;
use crate::control::Control;
use crate::feed::Feed;
use crate::hub::{Hub, count};
use crate::routes::{App, router};
use crate::socket::Source;
use crate::workers::{MapWorker, show_scene};
use crate::{WebAddress, WebConfig};

/// Connections at once; more are closed at once.
const MAX_CONNECTIONS: usize = 128;
/// How long a request's head may take.
const HEAD_LIMIT: Duration = Duration::from_secs(10);
/// Bytes of a request's head, and of what is read ahead.
const MAX_HEAD_BYTES: usize = 16 << 10;
/// Headers of a request.
const MAX_HEADERS: usize = 64;
/// How long the end may take, for connections and for the threads, and how often these are looked at.
const END_LIMIT: Duration = Duration::from_millis(500);
const END_TICK: Duration = Duration::from_millis(5);
/// What live deltas take of loopback, bits per second; elsewhere the bus's bandwidth.
const LOOPBACK_BANDWIDTH_BPS: u64 = 100_000_000;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// The address is taken, or none of this machine's.
    #[error(
        "the page cannot be served at {address}: {error}; web.address, or --web, takes a free port of this machine"
    )]
    Listen {
        /// As asked for.
        address: WebAddress,
        /// Of the system.
        error: std::io::Error,
    },
    /// No thread, or no random bytes.
    #[error("the page cannot be served: {0}")]
    System(String),
}

/// Serves the page until it is dropped.
#[derive(Debug)]
pub struct WebServer {
    local: SocketAddr,
    token: String,
    hub: Arc<Hub>,
    accepts: task::JoinHandle<()>,
    threads: Vec<JoinHandle<()>>,
    heartbeats: [Heartbeat; 2],
}

impl WebServer {
    /// Listens at `address`, with tasks of `runtime`. Messages of the map are cut as `bus` says.
    ///
    /// # Errors
    /// If it cannot be listened at.
    pub fn start(
        runtime: &Handle,
        address: &WebAddress,
        config: &WebConfig,
        bus: BusConfig,
        about: About,
        control: Arc<dyn Control>,
    ) -> Result<Self, WebError> {
        let listening = |error| WebError::Listen {
            address: address.clone(),
            error,
        };
        let listener = listen(address).map_err(listening)?;
        let local = listener.local_addr().map_err(listening)?;
        let token = match &config.token {
            Some(token) => token.clone(),
            None => random_token()?,
        };
        let access = Access {
            is_loopback: is_loopback(local.ip()),
            token: token.clone(),
            allowed_hosts: config.allowed_hosts.clone(),
            cockpit_actions: config.cockpit_actions,
        };
        let hub = Arc::new(Hub::new());
        let bandwidth_bps = match access.is_loopback {
            true => LOOPBACK_BANDWIDTH_BPS,
            false => bus.bandwidth_bps,
        };
        let heartbeats = [Heartbeat::new("web-map"), Heartbeat::new("web-scene")];
        let [of_maps, of_scene] = heartbeats.clone();
        let beats = of_maps.clone();
        let mut maps = MapWorker::new(Arc::clone(&hub), bus.clone(), bandwidth_bps, beats);
        let seen = Arc::clone(&hub);
        let threads = vec![
            spawn("web-map", move || of_maps.run_again(|| maps.run()))?,
            spawn("web-scene", move || {
                of_scene.run_again(|| show_scene(&seen, &of_scene));
            })?,
        ];
        let source = Arc::new(Source {
            hub: Arc::clone(&hub),
            bus,
            about,
            needs_token: !access.is_loopback,
        });
        let router = router(App::new(access, source, control));
        let accepts = runtime.spawn(serve(listener, router, Arc::clone(&hub)));
        Ok(Self {
            local,
            token,
            hub,
            accepts,
            threads,
            heartbeats,
        })
    }

    /// Where what there is to show is given.
    #[must_use]
    pub fn feed(&self) -> Feed {
        Feed(Arc::clone(&self.hub))
    }

    /// Whether its own threads are alive; both go on after a panic. Of what is done for a browser
    /// only that browser's connection ends with a panic.
    #[must_use]
    pub fn heartbeats(&self) -> &[Heartbeat] {
        &self.heartbeats
    }

    /// Where it listens.
    #[must_use]
    pub fn local_addr(&self) -> SocketAddr {
        self.local
    }

    /// What to open in a browser; away from loopback with the token, behind a `#`, which browsers keep
    /// to themselves.
    #[must_use]
    pub fn url(&self) -> String {
        match is_loopback(self.local.ip()) {
            true => format!("http://{}/", self.local),
            false => format!("http://{}/#token={}", self.local, self.token),
        }
    }

    /// Whether other machines reach it.
    #[must_use]
    pub fn is_open(&self) -> bool {
        !is_loopback(self.local.ip())
    }
}

impl Drop for WebServer {
    fn drop(&mut self) {
        self.hub.stop();
        let deadline = Instant::now() + END_LIMIT;
        let hangs = |thread: &JoinHandle<()>| !thread.is_finished();
        // One that hangs is left alone.
        let goes_on = || !self.accepts.is_finished() || self.threads.iter().any(hangs);
        while goes_on() && Instant::now() < deadline {
            std::thread::sleep(END_TICK);
        }
    }
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, WebError> {
    let thread = std::thread::Builder::new().name(name.to_owned());
    thread
        .spawn(work)
        .map_err(|error| WebError::System(error.to_string()))
}

/// At the first of the host's addresses that is one of this machine.
fn listen(address: &WebAddress) -> std::io::Result<TcpListener> {
    let places: Vec<SocketAddr> = (address.host.as_str(), address.port)
        .to_socket_addrs()?
        .collect();
    let listener = TcpListener::bind(places.as_slice())?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// 128 random bits.
fn random_token() -> Result<String, WebError> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| WebError::System(error.to_string()))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// How long to wait when the system has no room for another connection.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Until the page is closed.
async fn serve(listener: TcpListener, router: Router, hub: Arc<Hub>) {
    let closing = hub.closing.clone();
    closing
        .run_until_cancelled(accept(listener, router, hub))
        .await;
}

async fn accept(listener: TcpListener, router: Router, hub: Arc<Hub>) {
    let listener = match tokio::net::TcpListener::from_std(listener) {
        Ok(listener) => listener,
        Err(error) => return tracing::error!(%error, "the page is not served"),
    };
    let room = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::debug!(%error, "no connection to the page");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let Ok(permit) = Arc::clone(&room).try_acquire_owned() else {
            count(&hub.counters.connections_refused, 1);
            continue;
        };
        let (router, closing) = (router.clone(), hub.closing.clone());
        tokio::spawn(async move {
            let _permit = permit;
            closing
                .run_until_cancelled(connection(stream, router))
                .await;
        });
    }
}

async fn connection(stream: TcpStream, router: Router) {
    // Small messages go at once.
    let _ = stream.set_nodelay(true);
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_LIMIT)
        .max_buf_size(MAX_HEAD_BYTES)
        .max_headers(MAX_HEADERS)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .with_upgrades()
        .await;
    if let Err(error) = served {
        tracing::trace!(%error, "a connection to the page ended");
    }
}
