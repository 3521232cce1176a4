//! The map as messages without a bus, for whoever carries them in another way.

use std::sync::Arc;

use echosplat_model::Snapshot;

use crate::config::BusConfig;
use crate::delta::{PublishedMap, SnapshotDiffer, SnapshotRequest};
use crate::map_frame::MapFrame;
use crate::map_message::{Cut, WireMessage};

/// Makes the messages that a [`crate::MapPublisher`] would send: the same bytes for the same
/// snapshots and budgets. It has its own sequence, which counts its own deltas.
#[derive(Debug)]
pub struct MapEncoder {
    differ: SnapshotDiffer,
    frame_id: String,
    max_message_bytes: usize,
}

/// One message of a delta and where the delta stands.
#[derive(Debug, Clone, PartialEq)]
pub struct DeltaMessage {
    /// Of the map.
    pub epoch: u64,
    /// Of the delta.
    pub sequence: u64,
    /// The bytes.
    pub message: WireMessage,
}

impl MapEncoder {
    /// Takes size of messages, tiles and the frame's name from the bus's settings.
    #[must_use]
    pub fn new(config: &BusConfig) -> Self {
        Self {
            differ: SnapshotDiffer::new(config.tile_edge_m),
            frame_id: config.frame_id.clone(),
            max_message_bytes: config.max_message_bytes,
        }
    }

    /// Makes `snapshot` what the deltas lead to.
    pub fn offer(&mut self, snapshot: Arc<Snapshot>) {
        self.differ.offer(snapshot);
    }

    /// The next deltas, most changed tiles first, at most about `budget_bytes`; `None` is all.
    #[must_use]
    pub fn next_messages(&mut self, budget_bytes: Option<usize>) -> Vec<DeltaMessage> {
        let deltas = self.differ.next_deltas(budget_bytes);
        self.encode(&deltas, false)
    }

    /// All that is pending, its last delta marked final.
    #[must_use]
    pub fn final_messages(&mut self) -> Vec<DeltaMessage> {
        let deltas = self.differ.finish().unwrap_or_default();
        self.encode(&deltas, true)
    }

    fn encode(&self, deltas: &[echosplat_model::Delta], is_last: bool) -> Vec<DeltaMessage> {
        let mut messages = Vec::new();
        for (index, delta) in deltas.iter().enumerate() {
            let frame_id = MapFrame::new(&self.frame_id, delta.origin_m).frame_id();
            let is_final = is_last && index + 1 == deltas.len();
            let cut = self.cut(&frame_id).delta(delta, is_final);
            messages.extend(cut.into_iter().map(|message| DeltaMessage {
                epoch: delta.epoch,
                sequence: delta.sequence,
                message,
            }));
        }
        messages
    }

    fn cut<'a>(&self, frame_id: &'a str) -> Cut<'a> {
        Cut {
            max_message_bytes: self.max_message_bytes,
            frame_id,
        }
    }

    /// Whether nothing is pending.
    #[must_use]
    pub fn is_drained(&self) -> bool {
        self.differ.is_drained()
    }

    /// What all deltas so far add up to; cheap to clone.
    #[must_use]
    pub fn published(&self) -> Option<&PublishedMap> {
        self.differ.published()
    }

    /// The answer to `request` from `published`, which may be of an earlier moment.
    #[must_use]
    pub fn answer(
        config: &BusConfig,
        published: &PublishedMap,
        request: &SnapshotRequest,
    ) -> Vec<WireMessage> {
        let frame_id = MapFrame::new(&config.frame_id, published.origin_m()).frame_id();
        let cut = Cut {
            max_message_bytes: config.max_message_bytes,
            frame_id: &frame_id,
        };
        cut.answer(&published.select(request)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::delta::MapAssembler;
    use crate::map_message::{DeltaCollector, MapMessage, SnapshotCollector};
    use crate::test_support::{gaussian, same, snapshot};

    fn decoded(message: &WireMessage) -> MapMessage {
        MapMessage::decode(&message.payload, &message.attachment).unwrap()
    }

    #[test]
    fn who_joins_late_or_misses_messages_ends_with_the_same_map() {
        let config = BusConfig::default();
        let mut encoder = MapEncoder::new(&config);
        encoder.offer(snapshot(1, 1, (0..3000).map(gaussian).collect()));
        let lost = encoder.next_messages(Some(50_000));
        assert!(!lost.is_empty() && !encoder.is_drained());

        let mut assembler = MapAssembler::new(100_000);
        let join = |encoder: &MapEncoder, assembler: &mut MapAssembler| {
            let request = assembler.request();
            let published = encoder.published().unwrap();
            let mut collector = SnapshotCollector::new(100_000);
            for message in MapEncoder::answer(&config, published, &request) {
                collector.push(decoded(&message));
            }
            assembler.snapshot(collector.finish().unwrap());
        };
        join(&encoder, &mut assembler);
        // Some messages are lost on the way, then what changed since is asked for.
        let _ = encoder.next_messages(Some(50_000));
        join(&encoder, &mut assembler);
        encoder.offer(snapshot(1, 2, (1000..4000).map(gaussian).collect()));
        let mut collector = DeltaCollector::new(100_000);
        let mut rest = encoder.next_messages(None);
        rest.extend(encoder.final_messages());
        for sent in rest {
            let (delta, is_final) = collector.push(decoded(&sent.message)).unwrap();
            assert_eq!((sent.epoch, sent.sequence), (delta.epoch, delta.sequence));
            assembler.delta(delta, is_final);
        }
        let expected: Vec<_> = (1000..4000).map(gaussian).collect();
        assert!(assembler.is_final());
        assert!(same(&assembler.to_snapshot().unwrap().gaussians, &expected));
    }
}
