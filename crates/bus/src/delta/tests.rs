use std::sync::Arc;

use echosplat_model::{Delta, Gaussian, Snapshot};
use glam::Vec3;
use proptest::prelude::*;

use super::*;
use crate::test_support::{gaussian, same, snapshot};

fn joined() -> (SnapshotDiffer, MapAssembler) {
    (SnapshotDiffer::new(4.0), MapAssembler::new(1_000_000))
}

fn resync(differ: &SnapshotDiffer, assembler: &mut MapAssembler) {
    let answer = differ.published().unwrap().select(&assembler.request());
    assert_eq!(assembler.snapshot(answer), Progress::Applied);
}

fn assert_whole(assembler: &MapAssembler, sent: &Snapshot) {
    let map = assembler.to_snapshot().unwrap();
    assert!(same(&map.gaussians, &sent.gaussians));
    assert_eq!(map.origin_m, sent.origin_m);
    assert_eq!(map.intensity_unit.to_bits(), sent.intensity_unit.to_bits());
    assert_eq!(map.through_ping, sent.through_ping);
    assert!(!assembler.needs_snapshot());
}

#[test]
fn another_unit_alone_is_told_once() {
    let (mut differ, mut assembler) = joined();
    let first = snapshot(5, 1, vec![gaussian(1)]);
    differ.offer(first.clone());
    resync(&differ, &mut assembler);
    let mut pass = |sent: &Arc<Snapshot>| {
        differ.offer(Arc::clone(sent));
        let deltas = differ.next_deltas(None);
        let count = deltas.len();
        for delta in deltas {
            assert_eq!(assembler.delta(delta, false), Progress::Applied);
        }
        let map = assembler.to_snapshot().unwrap();
        assert_eq!(map.intensity_unit.to_bits(), sent.intensity_unit.to_bits());
        count
    };
    let mut second = Snapshot::clone(&first);
    second.intensity_unit *= 2.0;
    let second = Arc::new(second);
    assert_eq!([pass(&first), pass(&second), pass(&second)], [1, 1, 0]);
}

#[test]
fn an_origin_found_after_an_empty_map_was_sent_reaches_its_followers() {
    let (mut differ, mut assembler) = joined();
    let mut empty = Snapshot::clone(&snapshot(5, 1, Vec::new()));
    empty.origin_m = glam::DVec3::ZERO;
    differ.offer(Arc::new(empty));
    resync(&differ, &mut assembler);
    let mut begun = Snapshot::clone(&snapshot(5, 2, vec![gaussian(1)]));
    begun.origin_m = glam::DVec3::new(3.0, -4.0, 5.0);
    differ.offer(Arc::new(begun.clone()));
    for delta in differ.next_deltas(None) {
        assert_eq!(assembler.delta(delta, false), Progress::Applied);
    }
    assert_whole(&assembler, &begun);
}

/// The same ids with some moved to other tiles, some changed by one bit, some gone, some new.
fn stirred(old: &Snapshot) -> Arc<Snapshot> {
    let keep = |g: &&Gaussian| !g.id.is_multiple_of(7);
    let stir = |g: &Gaussian| {
        let mut g = *g;
        match g.id % 5 {
            0 => g.mean_m += Vec3::splat(5.0),
            1 => g.opacity = f32::from_bits(g.opacity.to_bits() ^ 1),
            _ => {}
        }
        g
    };
    let newest = old.gaussians.last().map_or(0, |g| g.id);
    let mut gaussians: Vec<_> = old.gaussians.iter().filter(keep).map(stir).collect();
    gaussians.extend((newest + 1..newest + 40).map(gaussian));
    snapshot(old.epoch, old.sequence + 1, gaussians)
}

#[test]
fn deltas_add_up_to_the_snapshot() {
    let (mut differ, mut assembler) = joined();
    let mut sent = snapshot(5, 1, (0..300).map(gaussian).collect());
    differ.offer(sent.clone());
    resync(&differ, &mut assembler);
    for _ in 0..6 {
        differ.offer(sent.clone());
        for delta in differ.next_deltas(None) {
            assert_eq!(assembler.delta(delta, false), Progress::Applied);
        }
        assert!(differ.is_drained());
        assert_whole(&assembler, &sent);
        sent = stirred(&sent);
    }
}

#[test]
fn the_same_snapshot_again_makes_no_deltas() {
    let (mut differ, _) = joined();
    let sent = snapshot(5, 1, (0..50).map(gaussian).collect());
    differ.offer(sent.clone());
    assert!(!differ.next_deltas(None).is_empty());
    differ.offer(sent);
    assert!(differ.next_deltas(None).is_empty());
}

#[test]
fn a_budget_delays_but_loses_nothing() {
    let (mut differ, mut assembler) = joined();
    let mut sent = snapshot(5, 1, (0..400).map(gaussian).collect());
    differ.offer(sent.clone());
    resync(&differ, &mut assembler);
    let mut rounds = 0;
    while !differ.is_drained() {
        let deltas = differ.next_deltas(Some(3000));
        assert!(!deltas.is_empty());
        let bytes: usize = deltas.iter().map(|d| 64 * d.gaussians.len()).sum();
        assert!(bytes <= 3000);
        for delta in deltas {
            assert_eq!(assembler.delta(delta, false), Progress::Applied);
        }
        rounds += 1;
        if rounds == 5 {
            sent = stirred(&sent);
            differ.offer(sent.clone());
        }
    }
    assert!(rounds > 10);
    assert_whole(&assembler, &sent);
}

#[test]
fn a_budget_of_nothing_still_moves() {
    let (mut differ, _) = joined();
    differ.offer(snapshot(5, 1, (0..20).map(gaussian).collect()));
    let mut rounds = 0;
    while !differ.is_drained() {
        assert_eq!(differ.next_deltas(Some(0)).len(), 1);
        rounds += 1;
    }
    assert_eq!(rounds, 20);
}

#[test]
fn what_changed_most_goes_first() {
    let (mut differ, _) = joined();
    let mut gaussians: Vec<_> = (0..10).map(gaussian).collect();
    for (i, g) in gaussians.iter_mut().enumerate() {
        g.mean_m = Vec3::new(10.0 * i as f32, 0.0, 0.0);
    }
    differ.offer(snapshot(5, 1, gaussians.clone()));
    let _ = differ.next_deltas(None);
    for g in &mut gaussians {
        g.opacity = f32::from_bits(g.opacity.to_bits() ^ 1);
    }
    gaussians[6].mean_m.y += 1.0;
    differ.offer(snapshot(5, 2, gaussians));
    let first = &differ.next_deltas(Some(1100))[0];
    assert_eq!(first.gaussians[0].id, 6);
}

#[test]
fn small_changes_get_their_turn_beside_large_ones() {
    let (mut differ, mut assembler) = joined();
    let mut gaussians: Vec<_> = (0..2).map(gaussian).collect();
    gaussians[0].mean_m = Vec3::ZERO;
    gaussians[1].mean_m = Vec3::new(100.0, 0.0, 0.0);
    let small = gaussians[1].opacity;
    differ.offer(snapshot(5, 1, gaussians.clone()));
    resync(&differ, &mut assembler);
    for delta in differ.next_deltas(None) {
        assembler.delta(delta, false);
    }
    // The first changes wholly in every round; only one of the two fits a round.
    gaussians[1].opacity = f32::from_bits(small.to_bits() ^ 1);
    for round in 2..3000 {
        gaussians[0].mean_m.x = if round % 2 == 0 { 1.0 } else { 2.0 };
        differ.offer(snapshot(5, round, gaussians.clone()));
        if differ.next_deltas(Some(1100))[0].gaussians[0].id == 1 {
            return;
        }
    }
    panic!("the small change never went");
}

#[test]
fn a_lost_delta_is_a_gap_and_only_what_changed_is_fetched() {
    let (mut differ, mut assembler) = joined();
    let mut sent = snapshot(5, 1, (0..300).map(gaussian).collect());
    differ.offer(sent.clone());
    for delta in differ.next_deltas(None) {
        assert_eq!(assembler.delta(delta, false), Progress::Buffered);
    }
    resync(&differ, &mut assembler);
    assert_whole(&assembler, &sent);

    sent = stirred(&sent);
    differ.offer(sent.clone());
    let deltas = differ.next_deltas(None);
    let (expected, found) = (deltas[1].sequence, deltas[2].sequence);
    assert_eq!(assembler.delta(deltas[0].clone(), false), Progress::Applied);
    let lost = assembler.delta(deltas[2].clone(), false);
    assert_eq!(lost, Progress::Gap { expected, found });
    assert_eq!(
        assembler.delta(deltas[3].clone(), false),
        Progress::Buffered
    );
    assert!(assembler.needs_snapshot());

    let answer = differ.published().unwrap().select(&assembler.request());
    assert_eq!(answer.since, Some(expected - 1));
    assert!(answer.tiles.len() < differ.published().unwrap().tiles.len());
    assembler.snapshot(answer);
    assert_whole(&assembler, &sent);
    assert_eq!(assembler.counters().gaps, 1);
}

#[test]
fn an_answer_older_than_the_buffer_is_carried_on_by_it() {
    let (mut differ, mut assembler) = joined();
    let sent = snapshot(5, 1, (0..100).map(gaussian).collect());
    differ.offer(sent.clone());
    let _ = differ.next_deltas(Some(2000));
    let early = differ.published().unwrap().select(&assembler.request());
    while !differ.is_drained() {
        for delta in differ.next_deltas(Some(2000)) {
            assembler.delta(delta, false);
        }
    }
    assembler.snapshot(early);
    assert_whole(&assembler, &sent);
}

#[test]
fn a_new_epoch_starts_from_nothing() {
    let (mut differ, mut assembler) = joined();
    differ.offer(snapshot(5, 1, (0..100).map(gaussian).collect()));
    let _ = differ.next_deltas(None);
    resync(&differ, &mut assembler);
    let sent = snapshot(6, 0, (50..60).map(gaussian).collect());
    differ.offer(sent.clone());
    let deltas = differ.next_deltas(None);
    assert_eq!(deltas[0].sequence, 1);
    let progress = assembler.delta(deltas[0].clone(), false);
    assert_eq!(progress, Progress::NewEpoch { found: 6 });
    resync(&differ, &mut assembler);
    assert_whole(&assembler, &sent);
    assert_eq!(assembler.counters().epochs, 1);
}

#[test]
fn deltas_of_an_older_epoch_do_not_make_it_ask_for_ever() {
    let (mut differ, mut assembler) = joined();
    differ.offer(snapshot(5, 1, (0..100).map(gaussian).collect()));
    for delta in differ.next_deltas(None) {
        assembler.delta(delta, false);
    }
    let sent = snapshot(6, 0, (50..60).map(gaussian).collect());
    differ.offer(sent.clone());
    let _ = differ.next_deltas(None);
    resync(&differ, &mut assembler);
    assert_whole(&assembler, &sent);
}

#[test]
fn a_delta_that_was_never_sent_does_not_make_it_ask_for_ever() {
    let (mut differ, mut assembler) = joined();
    let sent = snapshot(5, 1, (0..100).map(gaussian).collect());
    differ.offer(sent.clone());
    let deltas = differ.next_deltas(None);
    resync(&differ, &mut assembler);
    let mut forged = deltas[0].clone();
    forged.sequence = 1000;
    assembler.delta(forged, false);
    assert!(assembler.needs_snapshot());
    resync(&differ, &mut assembler);
    assert_whole(&assembler, &sent);
    assert_eq!(assembler.counters().deltas_unexplained, 1);
}

#[test]
fn a_tile_that_emptied_is_in_what_changed_since() {
    let (mut differ, mut assembler) = joined();
    differ.offer(snapshot(5, 1, (0..3).map(gaussian).collect()));
    let _ = differ.next_deltas(None);
    resync(&differ, &mut assembler);
    let sent = snapshot(5, 2, vec![]);
    differ.offer(sent.clone());
    let _ = differ.next_deltas(None);
    resync(&differ, &mut assembler);
    assert_whole(&assembler, &sent);
    assert_eq!(assembler.gaussian_count(), 0);
}

#[test]
fn the_end_is_marked_even_when_nothing_changed() {
    let (mut differ, mut assembler) = joined();
    assert!(differ.finish().is_none());
    let sent = snapshot(5, 1, (0..3).map(gaussian).collect());
    differ.offer(sent.clone());
    resync(&differ, &mut assembler);
    for _ in 0..2 {
        let deltas = differ.finish().unwrap();
        let last = deltas.len() - 1;
        for (i, delta) in deltas.into_iter().enumerate() {
            assembler.delta(delta, i == last);
        }
        assert!(assembler.is_final());
        assert_whole(&assembler, &sent);
    }
    assert!(differ.published().unwrap().is_final());
    let mut late = MapAssembler::new(100);
    resync(&differ, &mut late);
    assert!(late.is_final());

    differ.offer(stirred(&sent));
    let _ = differ.next_deltas(None);
    assert!(!differ.published().unwrap().is_final());
}

#[test]
fn a_publisher_that_started_over_is_fetched_whole() {
    let (mut differ, mut assembler) = joined();
    differ.offer(snapshot(5, 1, (0..100).map(gaussian).collect()));
    while !differ.is_drained() {
        let _ = differ.next_deltas(Some(2000));
    }
    resync(&differ, &mut assembler);
    let (mut second, _) = joined();
    let sent = snapshot(5, 1, (7..9).map(gaussian).collect());
    second.offer(sent.clone());
    let _ = second.next_deltas(None);
    assert!(second.published().unwrap().sequence() < assembler.position().unwrap().1);
    resync(&second, &mut assembler);
    assert_whole(&assembler, &sent);
}

#[test]
fn what_is_not_sound_is_counted_and_never_published() {
    let (mut differ, mut assembler) = joined();
    let mut gaussians: Vec<_> = (0..3).map(gaussian).collect();
    gaussians[1].mean_m.x = f32::NAN;
    differ.offer(snapshot(5, 1, gaussians));
    let _ = differ.next_deltas(None);
    resync(&differ, &mut assembler);
    assert_eq!(assembler.gaussian_count(), 2);
    assert_eq!(differ.unsound_count(), 1);
}

#[test]
fn buffer_and_map_are_bounded_by_the_receiver() {
    let mut differ = SnapshotDiffer::new(4.0);
    let mut assembler = MapAssembler::new(50);
    differ.offer(snapshot(5, 1, (0..400).map(gaussian).collect()));
    let mut deltas: Vec<Delta> = Vec::new();
    while !differ.is_drained() {
        deltas.extend(differ.next_deltas(Some(2000)));
    }
    for delta in &deltas {
        assembler.delta(delta.clone(), false);
    }
    assert!(assembler.counters().deltas_overflowed > 0);
    resync(&differ, &mut assembler);
    assert!(assembler.gaussian_count() <= 50);
    assert!(assembler.counters().gaussians_overflowed > 0);
    assembler.restart();
    let mut forged = deltas[0].clone();
    forged.sequence = u64::MAX;
    assembler.delta(forged.clone(), false);
    forged.gaussians = (0..200).map(gaussian).collect();
    assembler.delta(forged, false);
    assert!(assembler.gaussian_count() <= 50);
}

proptest! {
    /// Whatever is lost on the way, one answer at the end makes both sides the same.
    #[test]
    fn any_loss_ends_in_the_same_map(
        losses in proptest::collection::vec(any::<bool>(), 1..40),
        budget in 500_usize..20_000,
    ) {
        let (mut differ, mut assembler) = joined();
        let mut sent = snapshot(5, 1, (0..200).map(gaussian).collect());
        for round in losses.chunks(4) {
            sent = stirred(&sent);
            differ.offer(sent.clone());
            for (delta, lost) in differ.next_deltas(Some(budget)).into_iter().zip(round.iter().cycle()) {
                if !lost {
                    assembler.delta(delta, false);
                }
            }
            if assembler.needs_snapshot() {
                resync(&differ, &mut assembler);
            }
        }
        for delta in differ.finish().unwrap() {
            assembler.delta(delta, false);
        }
        resync(&differ, &mut assembler);
        assert_whole(&assembler, &sent);
        prop_assert!(assembler.is_final());
    }
}
