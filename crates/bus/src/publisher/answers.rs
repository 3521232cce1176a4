//! Answers those who ask for the map, or for the place of its frame.

use std::sync::Arc;
use std::time::Instant;

use crossbeam_channel::Receiver;
use echosplat_liveness::Heartbeat;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::Query;

use super::{Shared, lock};
use crate::bus::Link;
use crate::delta::{PublishedMap, SnapshotRequest};
use crate::map_frame::MapFrame;
use crate::map_message::Cut;
use crate::point_cloud;

/// What somebody wants to know.
pub(super) enum Asked {
    /// The map, or part of it.
    Map(Query),
    /// Where the map's own frame lies; without an answer if it has none.
    Frame(Query),
}

/// Apart from the deltas' thread, since a slow link holds an answer up.
pub(super) struct AnswerThread {
    link: Arc<Link>,
    shared: Arc<Shared>,
}

impl AnswerThread {
    pub(super) fn new(link: Arc<Link>, shared: Arc<Shared>) -> Self {
        Self { link, shared }
    }

    /// Ends with the queryables, whose callbacks hold the other ends of the queue.
    pub(super) fn run(&self, queries: &Receiver<Asked>, heartbeat: &Heartbeat) {
        loop {
            heartbeat.rest();
            let Ok(asked) = queries.recv() else { return };
            heartbeat.beat();
            let published = lock(&self.shared.published).clone();
            match (asked, published) {
                (Asked::Map(query), Some(published)) => self.map(&query, &published),
                (Asked::Frame(query), Some(published)) => self.frame(&query, &published),
                (_, None) => lock(&self.shared.counters).queries_dropped += 1,
            }
        }
    }

    fn map(&self, query: &Query, published: &PublishedMap) {
        let parameters = query.parameters();
        match SnapshotRequest::parse(|name| parameters.get(name)) {
            Ok(request) => self.answer(query, published, &request),
            Err(error) => {
                lock(&self.shared.counters).queries_refused += 1;
                // Whoever asked may have gone.
                let _ = query.reply_err(error.to_string()).wait();
            }
        }
    }

    fn answer(&self, query: &Query, published: &PublishedMap, request: &SnapshotRequest) {
        lock(&self.shared.counters).queries_answered += 1;
        {
            let mut pace = lock(&self.shared.pace);
            if let (Some(epoch), Some(since)) = (request.epoch, request.since) {
                pace.asked((epoch, since), Instant::now());
            }
            pace.answer_begins(Instant::now());
        }
        self.reply(query, published, request);
        lock(&self.shared.pace).answer_ends(Instant::now());
    }

    /// Replies take congestion control and priority of the query, from our own subscriber Block and
    /// Background.
    fn reply(&self, query: &Query, published: &PublishedMap, request: &SnapshotRequest) {
        let frame = self.frame_of(published);
        let cut = Cut {
            max_message_bytes: self.link.config.max_message_bytes,
            frame_id: &frame.frame_id(),
        };
        for message in cut.answer(&published.select(request)) {
            let _turn = lock(&self.shared.turn);
            let reply = query
                .reply(self.link.keys.snapshot(), message.payload)
                .encoding(Encoding::from(point_cloud::ENCODING))
                .attachment(message.attachment)
                .wait();
            if let Err(error) = reply {
                tracing::debug!("map query not answered to its end: {error}");
                lock(&self.shared.counters).queries_cut += 1;
                return;
            }
        }
    }

    fn frame(&self, query: &Query, published: &PublishedMap) {
        lock(&self.shared.counters).queries_answered += 1;
        let transform = self.frame_of(published).static_transform(published.time());
        let Some(transform) = transform else { return };
        let reply = query
            .reply(self.link.keys.static_transform(), transform)
            .encoding(Encoding::from(MapFrame::ENCODING))
            .wait();
        lock(&self.shared.counters).queries_cut += u64::from(reply.is_err());
    }

    fn frame_of(&self, published: &PublishedMap) -> MapFrame {
        MapFrame::new(&self.link.config.frame_id, published.origin_m())
    }
}
