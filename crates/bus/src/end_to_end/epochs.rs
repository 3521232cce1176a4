//! A map that starts anew while it is followed.

use super::*;

/// A smaller map of the next epoch, some ids the same and none where it was.
fn smaller(epoch: u64, count: u32) -> Arc<Snapshot> {
    let member = |id: u32| {
        let mut g = gaussian(id);
        g.mean_m += Vec3::splat(50.0);
        g
    };
    snapshot(epoch, 1, (100..100 + count).map(member).collect())
}

#[test]
fn followers_and_late_joiners_end_with_the_new_map_alone() {
    let (receiver, sender) = pair();
    let sender_config = BusConfig {
        // So little that the first map is never whole when the second begins.
        bandwidth_bps: 400_000,
        ..config(&format!("['{}']", receiver.endpoints().listen[0]), "[]")
    };
    drop(sender);
    let sender = Bus::open(sender_config).unwrap();
    let publisher = sender.publish_map().unwrap();
    let follower = receiver.subscribe_map().unwrap();
    publisher.offer(round(3));
    until("the first map begins to arrive", || {
        follower.gaussian_count() > 50
    });
    publisher.offer(smaller(8, 60));
    until("the new one is told", || {
        follower.position().is_some_and(|(epoch, _)| epoch == 8)
    });
    let late = receiver.subscribe_map().unwrap();
    publisher.offer(smaller(8, 40));
    publisher.flush(LONG).unwrap();
    for subscriber in [&follower, &late] {
        let map = subscriber.wait_final(LONG).unwrap();
        assert_eq!(map.epoch, 8);
        assert!(same(&map.gaussians, &smaller(8, 40).gaussians));
    }
    assert_eq!(follower.counters().assembler.epochs, 1);
    assert_eq!(late.counters().assembler.epochs, 0);
}

#[test]
fn epochs_in_quick_succession_end_with_the_last() {
    let (receiver, sender) = pair();
    let publisher = sender.publish_map().unwrap();
    let follower = receiver.subscribe_map().unwrap();
    for epoch in 8..40 {
        publisher.offer(smaller(epoch, 200 - epoch as u32));
        if epoch % 8 == 0 {
            let known = follower.position();
            let _ = follower.wait_beyond(known, Duration::from_millis(100));
        }
    }
    publisher.flush(LONG).unwrap();
    until("the last map is there", || {
        let map = follower.wait_final(LONG).unwrap();
        map.epoch == 39 && same(&map.gaussians, &smaller(39, 161).gaussians)
    });
}
