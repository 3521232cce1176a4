//! Where the map's points are, and who is handed what goes out.

use std::sync::Mutex;

use super::*;
use crate::{MapFrame, point_cloud};

/// What callbacks and subscribers were given.
type Kept = Arc<Mutex<Vec<Vec<u8>>>>;

fn kept(store: &Kept) -> Vec<Vec<u8>> {
    store.lock().unwrap().clone()
}

fn listen(bus: &Bus, key: &str) -> (Kept, zenoh::pubsub::Subscriber<()>) {
    let store = Kept::default();
    let in_callback = Arc::clone(&store);
    let subscriber = bus.session_for_tests().declare_subscriber(key.to_owned());
    let subscriber = subscriber.callback(move |sample| {
        let bytes = sample.payload().to_bytes().into_owned();
        in_callback.lock().unwrap().push(bytes);
    });
    (store, subscriber.wait().unwrap())
}

fn asked(bus: &Bus, key: &str) -> Vec<Vec<u8>> {
    let replies = bus.session_for_tests().get(key).wait().unwrap();
    let mut found = Vec::new();
    while let Ok(reply) = replies.recv() {
        let sample = reply.into_result().unwrap();
        assert_eq!(sample.encoding().to_string(), MapFrame::ENCODING);
        found.push(sample.payload().to_bytes().into_owned());
    }
    found
}

/// Transforms and clouds that the publisher's process was handed.
fn tapped(bus: &Bus) -> (Kept, Kept) {
    let (transforms, clouds) = (Kept::default(), Kept::default());
    let store = Arc::clone(&transforms);
    bus.on_static_transform(Box::new(move |bytes| {
        store.lock().unwrap().push(bytes.to_vec());
    }));
    let store = Arc::clone(&clouds);
    bus.on_delta(Box::new(move |cloud, note| {
        MapMessage::decode(&cloud, &note).unwrap();
        store.lock().unwrap().push(cloud.to_vec());
    }));
    (transforms, clouds)
}

fn at(origin_m: DVec3, epoch: u64) -> Arc<Snapshot> {
    Arc::new(Snapshot {
        epoch,
        origin_m,
        ..(*round(1)).clone()
    })
}

#[test]
fn a_far_map_has_a_frame_of_its_own_whose_place_is_told_kept_and_answered() {
    let (sender, receiver) = pair();
    let key = sender.keys().static_transform();
    let (heard, _subscriber) = listen(&receiver, &key);
    let putting = sender.session_for_tests().declare_publisher(key.clone());
    let putting = putting.wait().unwrap();
    until("the subscriber is known", || {
        putting.matching_status().wait().unwrap().matching()
    });
    let (transforms, clouds) = tapped(&sender);
    let publisher = sender.publish_map().unwrap();
    let far_m = DVec3::new(500_000.125, 0.1, -3.0);
    let second_m = far_m + DVec3::X;
    for (epoch, origin_m) in [(7, far_m), (8, second_m)] {
        publisher.offer(at(origin_m, epoch));
        publisher.flush(LONG).unwrap();
        let told = MapFrame::new("map", origin_m).static_transform(round(1).time);
        let told = told.unwrap();
        assert_eq!(kept(&transforms).last(), Some(&told));
        until("it is heard", || kept(&heard).last() == Some(&told));
        assert_eq!(asked(&receiver, &key), [told]);
    }
    assert_eq!(kept(&transforms).len(), 2, "once for each epoch");
    assert_eq!(publisher.counters().static_transforms, 2);
    for cloud in kept(&clouds) {
        assert_eq!(point_cloud::decode(&cloud).unwrap().frame_id, "map_local");
    }
}

#[test]
fn a_map_in_the_poses_frame_needs_no_transform() {
    let bus = Bus::open(config("[]", "[]")).unwrap();
    let (transforms, clouds) = tapped(&bus);
    let publisher = bus.publish_map().unwrap();
    publisher.offer(at(DVec3::ZERO, 7));
    publisher.flush(LONG).unwrap();
    assert!(!kept(&clouds).is_empty());
    for cloud in kept(&clouds) {
        assert_eq!(point_cloud::decode(&cloud).unwrap().frame_id, "map");
    }
    assert_eq!(kept(&transforms), Vec::<Vec<u8>>::new());
    let key = bus.keys().static_transform();
    assert_eq!(asked(&bus, &key), Vec::<Vec<u8>>::new());
}

#[test]
fn every_message_is_handed_over_whether_or_not_anybody_subscribes() {
    let bus = Bus::open(config("[]", "[]")).unwrap();
    let (_, clouds) = tapped(&bus);
    let publisher = bus.publish_map().unwrap();
    for n in 0..3 {
        publisher.offer(round(n));
        let seen = publisher.counters().deltas;
        until("some go", || publisher.counters().deltas > seen);
    }
    publisher.flush(LONG).unwrap();
    let handed_over = kept(&clouds).len() as u64;
    assert_eq!(handed_over, publisher.counters().messages);
    assert!(handed_over > 3);
}
