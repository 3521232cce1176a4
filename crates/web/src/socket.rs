//! One browser: what it is sent, and when it is given up.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket};
use echosplat_bus::delta::SnapshotRequest;
use echosplat_bus::{BusConfig, MapEncoder};
use echosplat_model::{Reason, Timestamp};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::sync::broadcast::error::RecvError;
use tokio::time::{Instant, MissedTickBehavior, interval, timeout};

use crate::about::About;
use crate::hub::{Hub, Live, count, lock};
use crate::wire::{self, Kind};
use crate::workers::pose_of;

/// Longest message of a browser; it has little to say.
pub(crate) const MAX_RECEIVED_BYTES: usize = 4096;
/// A browser that does not take a message for so long is given up.
const SEND_LIMIT: Duration = Duration::from_secs(20);
/// Whether it is still there is asked so often, and that we are is said.
const PING_EVERY: Duration = Duration::from_secs(2);
/// Without a word for so long it is not.
const SILENCE_LIMIT: Duration = Duration::from_secs(30);
/// Says nothing else than that the service is there.
const ALIVE: &str = r#"{"kind":"alive"}"#;
/// Between two snapshots that a browser asked for.
const SNAPSHOT_PAUSE: Duration = Duration::from_millis(500);

/// What every browser is served from.
pub(crate) struct Source {
    pub(crate) hub: Arc<Hub>,
    pub(crate) bus: BusConfig,
    pub(crate) about: About,
    pub(crate) needs_token: bool,
}

/// Gone, or too slow.
struct Gone;

/// Serves it until it goes.
pub(crate) async fn serve(socket: WebSocket, source: Arc<Source>) {
    let _watcher = source.hub.watch();
    let (to, from) = socket.split();
    let closing = source.hub.closing.clone();
    let browser = Browser { source, to };
    // However it ends, the connection is closed.
    let _ = closing.run_until_cancelled(browser.run(from)).await;
}

struct Browser {
    source: Arc<Source>,
    to: SplitSink<WebSocket, Message>,
}

impl Browser {
    async fn run(mut self, mut from: SplitStream<WebSocket>) -> Result<(), Gone> {
        let mut maps = self.source.hub.maps.subscribe();
        let mut live = self.source.hub.live.subscribe();
        self.hello().await?;
        let mut waiting = Some(self.source.hub.ask_for_map());
        let mut asked_at = Instant::now();
        let mut heard_at = Instant::now();
        let mut ticks = interval(PING_EVERY);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                published = async { waiting.as_mut()?.await.ok() }, if waiting.is_some() => {
                    waiting = None;
                    let published = published.ok_or(Gone)?;
                    self.snapshot(&published).await?;
                }
                // Until the map is there, its deltas wait.
                message = maps.recv(), if waiting.is_none() => match message {
                    Ok(bytes) => self.send(Message::Binary(bytes)).await?,
                    Err(RecvError::Lagged(missed)) => {
                        count(&self.source.hub.counters.lagged, missed);
                        count(&self.source.hub.counters.resyncs, 1);
                        waiting = Some(self.source.hub.ask_for_map());
                    }
                    Err(RecvError::Closed) => return Err(Gone),
                },
                message = live.recv() => match message {
                    Ok(Live::Text(text)) => self.send(text_message(&text)).await?,
                    Ok(Live::Binary(bytes)) => self.send(Message::Binary(bytes)).await?,
                    Err(RecvError::Lagged(missed)) => {
                        count(&self.source.hub.counters.lagged, missed);
                    }
                    Err(RecvError::Closed) => return Err(Gone),
                },
                message = from.next() => {
                    heard_at = Instant::now();
                    let asks = wants_snapshot(message)?;
                    if asks && waiting.is_none() && asked_at.elapsed() > SNAPSHOT_PAUSE {
                        asked_at = Instant::now();
                        count(&self.source.hub.counters.resyncs, 1);
                        waiting = Some(self.source.hub.ask_for_map());
                    }
                }
                _ = ticks.tick() => {
                    if heard_at.elapsed() > SILENCE_LIMIT {
                        return Err(Gone);
                    }
                    self.send(Message::Ping(Bytes::new())).await?;
                    // Pages do not see pings.
                    self.send(text_message(ALIVE)).await?;
                }
            }
        }
    }

    /// What the page needs before anything else.
    async fn hello(&mut self) -> Result<(), Gone> {
        let hub = &self.source.hub;
        let about = &self.source.about;
        let status = hub.status().map(|(status, _)| (*status).clone());
        // Copied first: who holds the lock holds the mapper up.
        let (track, first_time, pose, errors) = {
            let scene = lock(&hub.scene);
            let track = scene.track.points().to_vec();
            let errors = scene.errors.clone();
            (track, scene.first_time, pose_of(&scene), errors)
        };
        let track = track.iter().map(|point| {
            let [x, y, z] = point.place_m.to_array();
            [point.dive_s, x, y, z]
        });
        let hello = json!({
            "kind": "hello",
            "node": about.node,
            "version": about.version,
            "fan_deg": [about.azimuth_width_deg, about.elevation_width_deg],
            "tile_edge_m": self.source.bus.tile_edge_m,
            "needs_token": self.source.needs_token,
            "first_time_ns": first_time.map(Timestamp::nanos),
            "track": Vec::from_iter(track),
            "pose": pose,
            "errors": errors,
            "reasons": reasons(),
            "status": status,
        });
        self.send(Message::Text(hello.to_string().into())).await
    }

    async fn snapshot(
        &mut self,
        published: &echosplat_bus::delta::PublishedMap,
    ) -> Result<(), Gone> {
        count(&self.source.hub.counters.snapshots, 1);
        let request = SnapshotRequest::default();
        let messages = MapEncoder::answer(&self.source.bus, published, &request);
        for message in messages {
            let bytes = wire::binary(Kind::Snapshot, &message.attachment, &message.payload);
            self.send(Message::Binary(bytes)).await?;
        }
        Ok(())
    }

    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        match timeout(SEND_LIMIT, self.to.send(message)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(Gone),
        }
    }
}

/// Of every reason of a verdict, by its number.
fn reasons() -> Value {
    let said = Reason::ALL.map(|reason| {
        let (name, words, unit) = (reason.name(), reason.words(), reason.unit());
        json!({ "name": name, "words": words, "unit": unit })
    });
    Value::from_iter(said)
}

fn text_message(text: &str) -> Message {
    Message::Text(text.into())
}

/// Whether the browser asks for the map anew; anything else it says is passed over.
fn wants_snapshot(message: Option<Result<Message, axum::Error>>) -> Result<bool, Gone> {
    match message {
        None | Some(Err(_) | Ok(Message::Close(_))) => Err(Gone),
        Some(Ok(Message::Text(text))) => Ok(text.as_str() == "snapshot"),
        Some(Ok(_)) => Ok(false),
    }
}
