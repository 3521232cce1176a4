//! Which profiles are taken, held, late, or left out.

use super::*;

fn stamp(ping_number: u32, timestamp_ms: u32) -> Stamp {
    Stamp {
        ping_number,
        timestamp_ms,
        start_mm: 0,
        length_mm: 10_000,
        bin_count: 600,
        sos_dmps: 15_000,
        ping_hz: 451_127,
        pulse_duration_s: 2e-5,
    }
}

fn running(is_log: bool) -> Continuity {
    let mut continuity = Continuity::new(is_log, true);
    for i in 0..20 {
        let verdict = continuity.judge(stamp(100 + i, 5_000 + 25 * i));
        assert!(matches!(verdict.this, Fate::Taken(_)));
    }
    continuity
}

fn forward(pings: i64, millis: i64) -> Break {
    Break::Forward(Advance { pings, millis })
}

#[test]
fn lost_profiles_and_a_long_outage_go_on_at_once() {
    let mut c = running(false);
    let after_loss = c.judge(stamp(124, 5_600));
    assert_eq!(after_loss.this, Fate::Taken(forward(5, 125)));
    let after_outage = c.judge(stamp(10_124, 255_600));
    assert_eq!(after_outage.this, Fate::Taken(forward(10_000, 250_000)));
}

#[test]
fn a_pause_is_held_and_confirmed_by_the_next() {
    let mut c = running(false);
    assert_eq!(c.judge(stamp(120, 70_000)).this, Fate::Held);
    let next = c.judge(stamp(121, 70_025));
    assert_eq!(next.held, Some(HeldFate::Taken(forward(1, 64_525))));
    assert_eq!(next.this, Fate::Taken(forward(1, 25)));
    assert_eq!(
        c.judge(stamp(122, 70_050)).this,
        Fate::Taken(forward(1, 25))
    );
}

#[test]
fn damage_in_number_time_or_settings_is_dropped_and_its_neighbours_kept() {
    let mut damaged = [stamp(120, 5_500); 4];
    damaged[0].ping_number ^= 1 << 14;
    damaged[1].timestamp_ms ^= 1 << 12;
    damaged[2].length_mm ^= 1 << 9;
    damaged[3].timestamp_ms &= !0xfff;
    for bad in damaged {
        let mut c = running(false);
        assert_eq!(c.judge(bad).this, Fate::Held, "{bad:?}");
        let next = c.judge(stamp(121, 5_525));
        assert_eq!(next.held, Some(HeldFate::Dropped), "{bad:?}");
        assert_eq!(next.this, Fate::Taken(forward(2, 50)));
    }
}

#[test]
fn new_settings_are_confirmed_by_the_next_with_the_same_or_yet_others() {
    let mut c = running(false);
    let with_length = |n: u32, length_mm| Stamp {
        length_mm,
        ..stamp(100 + n, 5_000 + 25 * n)
    };
    assert_eq!(c.judge(with_length(20, 20_000)).this, Fate::Held);
    let third = c.judge(with_length(21, 30_000));
    assert_eq!(
        (third.this, third.held),
        (Fate::Held, Some(HeldFate::Taken(forward(1, 25))))
    );
    let same = c.judge(with_length(22, 30_000));
    assert_eq!(same.held, Some(HeldFate::Taken(forward(1, 25))));
    assert_eq!(same.this, Fate::Taken(forward(1, 25)));
}

#[test]
fn falling_back_in_both_is_a_reboot_even_at_another_pace() {
    let mut c = running(false);
    c.judge(stamp(50_000, 1_252_500));
    assert_eq!(c.judge(stamp(0, 2_000)).this, Fate::Held);
    assert_eq!(c.judge(stamp(1, 2_200)).held, Some(HeldFate::Dropped));
    let third = c.judge(stamp(2, 2_400));
    assert_eq!(third.held, Some(HeldFate::Taken(Break::Restart)));
    assert_eq!(third.this, Fate::Taken(forward(1, 200)));
}

#[test]
fn a_reboot_soon_after_power_up_is_told_from_disorder_by_going_on() {
    let mut c = Continuity::new(false, true);
    for i in 0..20 {
        c.judge(stamp(i, 25 * i));
    }
    let fates: Vec<Fate> = (0..19)
        .map(|i| c.judge(stamp(i, 10 + 25 * i)).this)
        .collect();
    assert!(fates[..15].iter().all(|&fate| fate == Fate::Misplaced));
    assert_eq!(fates[15], Fate::Taken(Break::Restart));
    assert_eq!(fates[16], Fate::Taken(forward(1, 25)));
}

#[test]
fn repeated_ones_and_ones_without_a_place_are_left_out() {
    let mut c = running(false);
    assert_eq!(c.judge(stamp(119, 5_475)).this, Fate::Duplicate);
    assert_eq!(c.judge(stamp(112, 5_300)).this, Fate::Duplicate);
    assert_eq!(c.judge(stamp(112, 5_290)).this, Fate::Misplaced);
    assert_eq!(c.judge(stamp(120, 5_500)).this, Fate::Taken(forward(1, 25)));
}

#[test]
fn a_block_out_of_order_in_a_log_is_late_however_far_back() {
    let mut c = running(true);
    c.judge(stamp(40_100, 1_005_000));
    for i in 20..600 {
        let late = c.judge(stamp(100 + i, 5_000 + 25 * i)).this;
        assert!(matches!(late, Fate::Late(_)), "{i}: {late:?}");
    }
    let next = c.judge(stamp(40_101, 1_005_025)).this;
    assert_eq!(next, Fate::Taken(forward(1, 25)));
}

#[test]
fn uneven_intervals_lose_nothing() {
    let mut c = running(false);
    let mut taken = 0;
    let mut millis = 5_475;
    for (i, interval) in (120..).zip([100, 12, 60, 9, 90, 25, 25, 14, 120, 25, 25]) {
        millis += interval;
        let verdict = c.judge(stamp(i, millis));
        taken += u32::from(matches!(verdict.this, Fate::Taken(_)));
        taken += u32::from(matches!(verdict.held, Some(HeldFate::Taken(_))));
    }
    assert_eq!(taken, 11);
}

#[test]
fn both_counters_wrap() {
    let mut c = Continuity::new(false, true);
    for i in 0..40u32 {
        let verdict = c.judge(stamp(
            (u32::MAX - 10).wrapping_add(i),
            (u32::MAX - 300).wrapping_add(25 * i),
        ));
        assert!(matches!(verdict.this, Fate::Taken(_)));
        assert!(i == 0 || verdict.this == Fate::Taken(forward(1, 25)));
    }
}

#[test]
fn the_last_one_of_a_log_is_not_lost_for_being_far() {
    let mut c = running(true);
    assert_eq!(c.judge(stamp(120, 70_000)).this, Fate::Held);
    assert_eq!(c.release(), Some(HeldFate::Taken(forward(1, 64_525))));
    assert_eq!(c.release(), None);
}
