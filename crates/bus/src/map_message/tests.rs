use super::*;
use crate::test_support::{gaussian, same};
use echosplat_model::Timestamp;
use glam::DVec3;
use proptest::prelude::*;

fn delta(gaussian_count: u32, removed_count: u32) -> Delta {
    Delta {
        epoch: u64::MAX,
        sequence: 7,
        time: Timestamp::from_nanos(-5),
        through_ping: 99,
        origin_m: DVec3::new(0.1, 1e6 + 0.3, -0.0),
        intensity_unit: 0.1,
        tile: TileKey { x: -1, y: 2, z: 0 },
        gaussians: (0..gaussian_count).map(gaussian).collect(),
        removed: (1000..1000 + removed_count).collect(),
    }
}

fn cut(max_message_bytes: usize) -> Cut<'static> {
    Cut {
        max_message_bytes,
        frame_id: "map",
    }
}

fn decoded(message: &WireMessage) -> MapMessage {
    MapMessage::decode(&message.payload, &message.attachment).unwrap()
}

fn collected(messages: &[WireMessage]) -> Option<(Delta, bool)> {
    let mut collector = DeltaCollector::new(1_000_000);
    let mut found = None;
    for message in messages {
        found = collector.push(decoded(message));
    }
    found
}

#[test]
fn a_delta_comes_back_whole_at_every_size_of_message() {
    let sent = delta(500, 5000);
    for max_message_bytes in [4096, 16_384, 64_000, 1_000_000] {
        let messages = cut(max_message_bytes).delta(&sent, true);
        let largest = messages.iter().map(WireMessage::byte_count).max();
        assert!(largest <= Some(max_message_bytes), "{largest:?}");
        let (found, is_final) = collected(&messages).unwrap();
        assert!(is_final);
        assert!(same(&found.gaussians, &sent.gaussians));
        assert_eq!(found, sent);
    }
}

#[test]
fn a_small_delta_is_one_message_and_an_empty_one_too() {
    assert_eq!(cut(64_000).delta(&delta(10, 10), false).len(), 1);
    let nothing = delta(0, 0);
    let messages = cut(64_000).delta(&nothing, true);
    assert_eq!(messages.len(), 1);
    assert_eq!(collected(&messages), Some((nothing, true)));
}

#[test]
fn a_missing_chunk_costs_its_delta_and_no_other() {
    let messages = cut(4096).delta(&delta(200, 0), false);
    assert!(messages.len() > 2);
    let next = cut(64_000).delta(&delta(1, 0), false);
    for missing in 0..messages.len() {
        let mut collector = DeltaCollector::new(1_000_000);
        let mut kept: Vec<_> = messages.clone();
        kept.remove(missing);
        let found = kept
            .iter()
            .filter_map(|m| collector.push(decoded(m)))
            .count();
        assert_eq!(found, 0, "without chunk {missing}");
        assert!(collector.push(decoded(&next[0])).is_some());
    }
}

fn answer(tiles: Vec<TileKey>) -> SnapshotAnswer {
    use crate::delta::TileState;
    let like = delta(0, 0);
    let state = |(n, tile): (usize, TileKey)| TileState {
        tile,
        gaussians: (0..100 * n as u32).map(gaussian).collect(),
    };
    SnapshotAnswer {
        epoch: like.epoch,
        sequence: like.sequence,
        time: like.time,
        through_ping: like.through_ping,
        origin_m: like.origin_m,
        intensity_unit: like.intensity_unit,
        is_final: false,
        since: Some(3),
        tiles: tiles.into_iter().enumerate().map(state).collect(),
    }
}

#[test]
fn an_answer_comes_back_in_any_order_empty_tiles_included() {
    let tile = |x| TileKey { x, y: 0, z: -7 };
    for sent in [answer(vec![]), answer((0..4).map(tile).collect())] {
        let mut messages: Vec<_> = cut(8192).answer(&sent).collect();
        messages.reverse();
        let mut collector = SnapshotCollector::new(1_000_000);
        for message in &messages {
            collector.push(decoded(message));
        }
        assert_eq!(collector.finish(), Some(sent));
    }
}

/// Readers of before find points and members as they were, and a message without reasons is one.
#[test]
fn reasons_are_beside_the_points_and_may_be_missing() {
    let mut sent = delta(3, 1);
    let message = |sent: &Delta| cut(64_000).delta(sent, false).remove(0);
    let with = message(&sent);
    let document: serde_json::Value = serde_json::from_slice(&with.attachment).unwrap();
    let first = sent.gaussians[0].why.bytes();
    let text = document["why"].as_str().unwrap();
    assert_eq!(
        (text.len(), text),
        (12, &*attachment::text_of(&header_of(&with).why))
    );
    assert_eq!(header_of(&with).why[0].bytes(), first);
    sent.gaussians
        .iter_mut()
        .for_each(|gaussian| gaussian.why = Why::default());
    let without = message(&sent);
    assert_eq!(without.payload, with.payload);
    assert!(!String::from_utf8_lossy(&without.attachment).contains("why"));
    assert_eq!(decoded(&without).gaussians, sent.gaussians);
    // Fewer than there are points, or of a newer program.
    let few = String::from_utf8_lossy(&with.attachment).replace(text, "/wEC");
    let few = MapMessage::decode(&with.payload, few.as_bytes()).unwrap();
    assert!(
        few.gaussians
            .iter()
            .all(|gaussian| gaussian.why == Why::default())
    );
    let odd = String::from_utf8_lossy(&with.attachment).replace(text, "AAA=");
    let refused = MapHeader::parse(odd.as_bytes()).unwrap_err();
    assert!(matches!(
        refused,
        AttachmentError::Member { member: "why", .. }
    ));
}

fn header_of(message: &WireMessage) -> MapHeader {
    decoded(message).header
}

#[test]
fn an_answer_with_a_hole_or_from_two_publishers_is_none() {
    let sent = answer((0..4).map(|x| TileKey { x, y: 0, z: 0 }).collect());
    let messages: Vec<_> = cut(8192).answer(&sent).collect();
    let mut collector = SnapshotCollector::new(1_000_000);
    for message in &messages[1..] {
        collector.push(decoded(message));
    }
    assert_eq!(collector.finish(), None);

    let other = SnapshotAnswer { epoch: 1, ..sent };
    let mut collector = SnapshotCollector::new(1_000_000);
    let others: Vec<_> = cut(8192).answer(&other).collect();
    for message in messages.iter().chain(&others) {
        collector.push(decoded(message));
    }
    assert_eq!(collector.finish(), None);
}

#[test]
fn what_is_too_large_is_let_go() {
    let mut collector = DeltaCollector::new(100);
    let found: Vec<_> = cut(4096)
        .delta(&delta(200, 0), false)
        .iter()
        .filter_map(|message| collector.push(decoded(message)))
        .collect();
    assert!(found.is_empty());
    assert!(collector.incomplete_count() > 0);
}

#[test]
fn attachments_out_of_range_are_named() {
    let good = String::from_utf8(cut(64_000).delta(&delta(0, 2), false)[0].attachment.clone());
    let good = good.unwrap();
    assert!(MapHeader::parse(good.as_bytes()).is_ok());
    let bad = [
        (r#""chunks":1"#, r#""chunks":0"#, "chunk"),
        (r#""chunks":1"#, r#""chunks":4000000000"#, "chunk"),
        (r#""tile":"-1_2_0""#, r#""tile":"here""#, "tile"),
        (r#""final""#, r#""part":3,"parts":2,"final""#, "part"),
    ];
    for (from, to, name) in bad {
        assert!(good.contains(from), "{from} in {good}");
        let refused = MapHeader::parse(good.replace(from, to).as_bytes());
        assert!(matches!(refused, Err(AttachmentError::Member { member, .. }) if member == name));
    }
    let removed = vec!["1"; MAX_REMOVED_PER_MESSAGE + 1].join(",");
    let many = good.replace("1000,1001", &removed);
    let refused = MapHeader::parse(many.as_bytes());
    assert!(matches!(
        refused,
        Err(AttachmentError::Member {
            member: "removed",
            ..
        })
    ));
    let huge = vec![b' '; 100_000];
    assert_eq!(
        MapHeader::parse(&huge),
        Err(AttachmentError::Size { found: 100_000 })
    );
    let deep = "[".repeat(60_000);
    assert!(MapHeader::parse(deep.as_bytes()).is_err());
    let infinite = good.replace("1000000.3", "1e999");
    assert!(MapHeader::parse(infinite.as_bytes()).is_err());
}

proptest! {
    #[test]
    fn no_text_upsets_it(text in "\\PC{0,200}", payload in proptest::collection::vec(any::<u8>(), 0..100)) {
        let _ = MapMessage::decode(&payload, text.as_bytes());
    }

    #[test]
    fn no_order_of_chunks_upsets_the_collector(order in proptest::collection::vec(0_usize..6, 0..40)) {
        let messages = cut(4096).delta(&delta(200, 0), false);
        let mut collector = DeltaCollector::new(1000);
        for index in order {
            if let Some((found, _)) = collector.push(decoded(&messages[index % messages.len()])) {
                prop_assert!(same(&found.gaussians, &delta(200, 0).gaussians));
            }
        }
    }
}

/// `README.md` has a row for each member, field and encoding there is.
#[test]
fn the_contract_names_everything_in_a_message() {
    let contract = include_str!("../../README.md");
    let says = |word: &str| assert!(contract.contains(&format!("`{word}`")), "{word}");
    let header = MapHeader {
        part: Some(Part { part: 0, parts: 1 }),
        since: Some(3),
        ..decoded(&cut(64_000).delta(&delta(1, 1), true)[0]).header
    };
    let members: serde_json::Value = serde_json::from_slice(&header.to_json()).unwrap();
    for (member, _) in members.as_object().unwrap() {
        says(member);
    }
    for field in point_cloud::field_names() {
        says(field);
    }
    for encoding in [point_cloud::ENCODING, crate::MapFrame::ENCODING] {
        says(encoding);
    }
    let keys = crate::Keys::new("<prefix>", "<node>").unwrap();
    for key in [
        keys.pose(),
        keys.ping(),
        keys.deltas().replace('*', "<tile>"),
        keys.snapshot(),
        keys.static_transform(),
        keys.status(),
        keys.alive(),
        keys.alive_as("<role>", "<zid>"),
    ] {
        says(&key);
    }
}
