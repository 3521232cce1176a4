//! Makes deltas of the maps offered, and sends them.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use echosplat_liveness::Heartbeat;
use echosplat_model::{Delta, Snapshot};
use glam::DVec3;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::qos::{CongestionControl, Priority};

use super::rounds::Rounds;
use super::{FlushReport, Sent, Shared, lock};
use crate::bus::Link;
use crate::delta::{PublishedMap, SnapshotDiffer};
use crate::map_frame::MapFrame;
use crate::map_message::{Cut, WireMessage};
use crate::point_cloud;
use crate::taps::Taps;

/// Makes deltas and sends them.
pub(super) struct DeltaThread {
    link: Arc<Link>,
    shared: Arc<Shared>,
    heartbeat: Heartbeat,
    differ: SnapshotDiffer,
    rounds: Rounds,
    taps: Taps,
    /// Sequence of the newest snapshot taken.
    offered: u64,
    /// Epoch and origin of the frame that was told of last.
    told: Option<(u64, DVec3)>,
}

/// What one look at the orders gave.
struct Work {
    snapshot: Option<Arc<Snapshot>>,
    flushes: Option<u64>,
    stop: bool,
}

impl DeltaThread {
    pub(super) fn new(link: Arc<Link>, shared: Arc<Shared>, heartbeat: Heartbeat) -> Self {
        Self {
            differ: SnapshotDiffer::new(link.config.tile_edge_m),
            rounds: Rounds::new(Duration::from_secs_f64(link.config.publish_interval_s)),
            taps: link.taps.current(),
            link,
            shared,
            heartbeat,
            offered: 0,
            told: None,
        }
    }

    /// Until the end; may be called again after a panic, whose deltas subscribers then miss by
    /// their sequence.
    pub(super) fn run(&mut self) {
        loop {
            let work = self.next_work();
            self.heartbeat.beat();
            if let Some(snapshot) = work.snapshot {
                self.offered = snapshot.sequence;
                self.differ.offer(snapshot);
            }
            if let Some(ticket) = work.flushes {
                self.flush(ticket);
            } else if work.stop {
                return;
            } else {
                self.round();
            }
        }
    }

    /// Waits until there is something to publish, a flush, or the end.
    fn next_work(&self) -> Work {
        let mut orders = lock(&self.shared.orders);
        self.heartbeat.rest();
        while !orders.is_urgent() && orders.snapshot.is_none() && self.differ.is_drained() {
            let waited = self.shared.ordered.wait(orders);
            orders = waited.unwrap_or_else(PoisonError::into_inner);
        }
        let flushes = orders.flushes_asked;
        Work {
            snapshot: orders.snapshot.take(),
            flushes: (orders.flushes_done < flushes).then_some(flushes),
            stop: orders.stop,
        }
    }

    /// What the pace allows since the last round, spread over the time until the next.
    fn round(&mut self) {
        let begin = Instant::now();
        let budget = self.rounds.begin(begin, self.bps(begin));
        let deltas = self.differ.next_deltas(Some(budget));
        self.publish_state();
        self.send(&deltas, false);
        let is_drained = self.differ.is_drained();
        self.pause_until(|rounds, has_newer_map| rounds.next_round(is_drained || has_newer_map));
        if !is_drained {
            let now = Instant::now();
            lock(&self.shared.pace).filled(now - begin, now);
        }
    }

    /// Bits per second that deltas may take.
    fn bps(&self, now: Instant) -> f64 {
        lock(&self.shared.pace).bps(now)
    }

    fn flush(&mut self, ticket: u64) {
        let deltas = self.differ.finish().unwrap_or_default();
        self.publish_state();
        self.send(&deltas, true);
        let published = self.differ.published();
        let mut orders = lock(&self.shared.orders);
        orders.flushes_done = ticket;
        orders.report = Some(FlushReport {
            epoch: published.map(PublishedMap::epoch),
            sequence: published.map_or(0, PublishedMap::sequence),
        });
        self.shared.flushed.notify_all();
    }

    /// Before the deltas go out: who asks in between gets them in the answer, and again as deltas
    /// of a sequence it has already. The other way round it would miss them.
    fn publish_state(&self) {
        let state = self.differ.published().cloned().map(Arc::new);
        *lock(&self.shared.published) = state;
    }

    fn send(&mut self, deltas: &[Delta], is_last: bool) {
        // The deltas of a round are of one epoch, and so of one origin.
        let origin_m = deltas.first().map_or(DVec3::ZERO, |delta| delta.origin_m);
        let frame = MapFrame::new(&self.link.config.frame_id, origin_m);
        if let Some(first) = deltas.first() {
            self.tell_frame(&frame, first);
        }
        let cut = Cut {
            max_message_bytes: self.link.config.max_message_bytes,
            frame_id: &frame.frame_id(),
        };
        for (index, delta) in deltas.iter().enumerate() {
            let is_final = is_last && index + 1 == deltas.len();
            for message in cut.delta(delta, is_final) {
                self.put(&message, is_last);
            }
            lock(&self.shared.pace).handed_over(delta.epoch, delta.sequence);
        }
        if deltas.is_empty() {
            self.note_sent();
        }
        let mut counters = lock(&self.shared.counters);
        counters.deltas += deltas.len() as u64;
        counters.gaussians_unsound = self.differ.unsound_count();
    }

    /// At the first delta of each epoch, and when the origin moved: where the map's own frame lies,
    /// if it has one. Lost on a congested link it can still be asked for.
    fn tell_frame(&mut self, frame: &MapFrame, first: &Delta) {
        let place = Some((first.epoch, first.origin_m));
        if self.told == place {
            return;
        }
        self.told = place;
        let Some(transform) = frame.static_transform(first.time) else {
            return;
        };
        if let Some(tap) = &self.taps.static_transform {
            tap(Arc::from(transform.as_slice()));
        }
        let session = &self.link.session;
        let put = session
            .put(self.link.keys.static_transform(), transform)
            .encoding(Encoding::from(MapFrame::ENCODING))
            .congestion_control(CongestionControl::Drop)
            .wait();
        let mut counters = lock(&self.shared.counters);
        counters.static_transforms += 1;
        counters.messages_failed += u64::from(put.is_err());
    }

    fn put(&mut self, message: &WireMessage, is_last: bool) {
        if let Some(tap) = &self.taps.delta {
            let bytes = |bytes: &[u8]| Arc::from(bytes);
            tap(bytes(&message.payload), bytes(&message.attachment));
        }
        self.heartbeat.beat();
        let byte_count = message.byte_count();
        let control = match is_last {
            true => CongestionControl::Block,
            false => CongestionControl::Drop,
        };
        let turn = is_last.then(|| lock(&self.shared.turn));
        let put = self
            .link
            .session
            .put(
                self.link.keys.delta(message.tile),
                message.payload.as_slice(),
            )
            .encoding(Encoding::from(point_cloud::ENCODING))
            .attachment(message.attachment.as_slice())
            .congestion_control(control)
            .priority(Priority::DataLow)
            .wait();
        drop(turn);
        {
            let mut counters = lock(&self.shared.counters);
            counters.messages += 1;
            counters.bytes += byte_count as u64;
            counters.messages_failed += u64::from(put.is_err());
        }
        if put.is_ok() {
            self.note_sent();
        }
        if !is_last {
            // Bursts are what a slow link drops.
            self.rounds.sent(byte_count, self.bps(Instant::now()));
            self.pause_until(Rounds::next_message);
        }
    }

    fn note_sent(&self) {
        let sequence = self.offered;
        let mut sent = lock(&self.shared.sent);
        if sent.is_none_or(|before| before.sequence != sequence) {
            *sent = Some(Sent {
                sequence,
                at: Instant::now(),
            });
        }
    }

    /// Sleeps until the moment that `until` makes of the rounds and of whether a newer map waits, unless something urgent
    /// comes up.
    fn pause_until(&self, until: impl Fn(&Rounds, bool) -> Option<Instant>) {
        self.heartbeat.rest();
        let mut orders = lock(&self.shared.orders);
        while !orders.is_urgent() {
            let time = until(&self.rounds, orders.snapshot.is_some());
            let left = time.map(|time| time.saturating_duration_since(Instant::now()));
            let Some(left) = left.filter(|left| !left.is_zero()) else {
                return;
            };
            let waited = self.shared.ordered.wait_timeout(orders, left);
            orders = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
