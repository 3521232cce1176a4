//! What two routes, boots, outliers and clocks that wrap do to the order of messages.

use echosplat_join::StampClock;
use echosplat_model::Timestamp;

use super::order::{CountsFrom, MessageKind, Order, Step};

const UNIX_MS: i64 = 1_700_000_000_000;
const KINDS: [MessageKind; 2] = [MessageKind::Position, MessageKind::Quaternion];

/// A message on its way: when it arrives, after the vehicle was switched on first; its stamp; and what it says.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sent {
    arrives_ms: i64,
    boot_ms: i64,
    content: u64,
}

/// Every 20 ms, by a route that takes so long.
fn stream(from_ms: i64, to_ms: i64, booted_ms: i64, route_ms: i64) -> Vec<Sent> {
    let at = (from_ms..to_ms).step_by(20);
    at.map(|now_ms| Sent {
        arrives_ms: now_ms + route_ms,
        boot_ms: now_ms - booted_ms,
        // No vehicle under way says the same twice.
        content: now_ms as u64,
    })
    .collect()
}

/// What became of messages of two kinds, in the order of their arrival.
#[derive(Debug, Default, PartialEq)]
struct Became {
    taken: Vec<Sent>,
    late: usize,
    anew: Vec<i64>,
}

fn ordered(mut sent: Vec<Sent>) -> Became {
    sent.sort_by_key(|sent| sent.arrives_ms);
    let mut order = Order::new(CountsFrom::Boot, StampClock::Host);
    let mut became = Became::default();
    for message in sent {
        for kind in KINDS {
            let arrived = Timestamp::from_millis(UNIX_MS + message.arrives_ms);
            let boot_ms = message.boot_ms.rem_euclid(1 << 32) as u32;
            match order.step_boot_ms(kind, boot_ms, message.content, arrived) {
                Step::Late => became.late += 1,
                step => {
                    if let Step::Anew(_) = step {
                        became.anew.push(message.arrives_ms);
                    }
                    if kind == KINDS[0] {
                        became.taken.push(message);
                    }
                }
            }
        }
    }
    became
}

const LATENESSES_MS: [i64; 12] = [
    50, 110, 330, 750, 1_230, 1_990, 2_010, 2_510, 5_030, 14_990, 30_050, 60_000,
];

#[test]
fn a_second_later_route_changes_nothing() {
    // Also of a vehicle that was switched on while the link was up, and across the wrap.
    for booted_ms in [0, -100_000, -((1 << 32) - 40_000)] {
        let first = stream(0, 80_000, booted_ms, 2);
        for lateness_ms in LATENESSES_MS {
            let second = stream(0, 80_000 - lateness_ms, booted_ms, 2 + lateness_ms);
            let copies = second.len();
            let became = ordered([first.clone(), second].concat());
            assert_eq!(became.taken, first, "{booted_ms} {lateness_ms}");
            assert_eq!((became.late, became.anew.len()), (copies * 2, 0));
        }
    }
}

#[test]
fn a_few_late_copies_change_nothing() {
    let first = stream(0, 70_000, -100_000, 2);
    for lateness_ms in LATENESSES_MS {
        for count in [1, 3, 40] {
            let from_ms = 65_000 - lateness_ms;
            let copies = stream(from_ms, from_ms + count * 20, -100_000, lateness_ms + 7);
            let became = ordered([first.clone(), copies].concat());
            assert_eq!(became.taken, first, "{lateness_ms} {count}");
            assert_eq!(became.anew.len(), 0);
        }
    }
}

#[test]
fn copies_that_come_while_the_first_route_is_silent_are_no_boot() {
    for (silent_ms, lateness_ms) in [(1_000, 2_510), (4_000, 5_030), (20_000, 30_050)] {
        let before = stream(0, 50_000, 0, 2);
        let after = stream(50_000 + silent_ms, 80_000, 0, 2);
        let late = stream(0, 79_000 - lateness_ms, 0, 2 + lateness_ms);
        let became = ordered([before, after, late].concat());
        assert_eq!(became.anew.len(), 0, "{silent_ms} {lateness_ms}");
    }
}

#[test]
fn the_later_route_alone_goes_on_as_the_first_did() {
    for lateness_ms in LATENESSES_MS {
        let first = stream(0, 70_000, -50_000, 2);
        let late = stream(0, 140_000, -50_000, 2 + lateness_ms);
        let became = ordered([first, late].concat());
        let whole = stream(0, 140_000, -50_000, 0);
        let stamps = |sent: &[Sent]| sent.iter().map(|s| s.boot_ms).collect::<Vec<_>>();
        assert_eq!(stamps(&became.taken), stamps(&whole), "{lateness_ms}");
        assert_eq!(became.anew.len(), 0);
    }
}

#[test]
fn the_later_route_first_gives_way_to_the_sooner_one() {
    for lateness_ms in LATENESSES_MS {
        let late = stream(0, 30_000, -100_000, 2 + lateness_ms);
        let soon = stream(lateness_ms + 1_000, 100_000, -100_000, 2);
        let became = ordered([late, soon.clone()].concat());
        assert_eq!(became.anew.len(), 0, "{lateness_ms}");
        let taken = became
            .taken
            .iter()
            .filter(|sent| soon.contains(sent))
            .count();
        assert!(
            taken + 10 > soon.len(),
            "{lateness_ms}: {taken} of {}",
            soon.len()
        );
    }
}

#[test]
fn a_boot_begins_anew_at_once_whatever_a_later_route_still_brings() {
    for uptime_ms in [3_500, 30_000, 900_000] {
        for first_heard_ms in [0, 500, 8_000, 30_000] {
            for lateness_ms in [0, 110, 2_510, 30_050, 60_000] {
                let switched_on_ms = 70_000 - uptime_ms;
                let before = stream(switched_on_ms.max(0), 70_000, switched_on_ms, 2);
                let booted_ms = 70_500;
                let after = stream(booted_ms + first_heard_ms, 200_000, booted_ms, 2);
                let mut sent = [before.clone(), after.clone()].concat();
                if lateness_ms > 0 {
                    let late = |sent: &Sent| Sent {
                        arrives_ms: sent.arrives_ms + lateness_ms,
                        ..*sent
                    };
                    let copies = [before, after.clone()].concat();
                    sent.extend(copies.iter().map(late));
                }
                let became = ordered(sent);
                let case = (uptime_ms, first_heard_ms, lateness_ms);
                // What counts on beyond the newest stamp before is told apart by nothing.
                let is_told = uptime_ms > first_heard_ms + 3_000;
                if is_told {
                    let at_ms = became.anew.first().copied().unwrap_or(i64::MAX);
                    let waited_ms = at_ms - after[0].arrives_ms;
                    assert!((0..200).contains(&waited_ms), "{case:?}: {waited_ms}");
                    assert_eq!(became.anew.len(), 1, "{case:?}");
                }
                let taken = became.taken.iter().filter(|sent| after.contains(sent));
                assert!(taken.count() + 110 > after.len(), "{case:?}");
            }
        }
    }
}

#[test]
fn a_boot_after_the_clock_wrapped_is_one() {
    let before = stream(0, 70_000, -((1 << 32) - 40_000), 2);
    let after = stream(71_000, 100_000, 71_000, 2);
    let became = ordered([before, after].concat());
    assert_eq!(became.anew, [71_042]);
}

#[test]
fn a_boot_that_cannot_be_takes_three_seconds() {
    let before = stream(0, 70_000, -100_000, 2);
    // It counts from 30 s at once, as a simulator may.
    let after = stream(70_000, 100_000, 40_000, 2);
    let became = ordered([before, after].concat());
    assert_eq!(became.anew, [73_002]);
}

#[test]
fn a_few_stamps_ahead_of_their_time_are_left_out_alone() {
    for (every, ahead_ms) in [(50, 1_000), (50, 60_000), (7, 400), (200, 3_600_000)] {
        let mut sent = stream(0, 60_000, 0, 2);
        let is_odd = |index: usize| index % every == every - 1;
        for (_, message) in sent
            .iter_mut()
            .enumerate()
            .filter(|(index, _)| is_odd(*index))
        {
            message.boot_ms += ahead_ms;
        }
        let odd = sent.len() / every;
        let became = ordered(sent.clone());
        assert_eq!(became.taken.len(), sent.len() - odd, "{every} {ahead_ms}");
        assert_eq!((became.late, became.anew.len()), (odd * 2, 0));
    }
}

#[test]
fn a_clock_set_forward_or_a_host_set_back_is_followed() {
    for step_ms in [1_000, 3_600_000] {
        let before = stream(0, 10_000, 0, 2);
        let after = stream(10_000, 20_000, -step_ms, 2);
        let became = ordered([before.clone(), after.clone()].concat());
        let whole = before.len() + after.len();
        assert!(became.taken.len() + 3 >= whole, "{step_ms}");
        assert_eq!(became.anew.len(), 0);
    }
}

#[test]
fn a_stall_and_what_comes_of_it_all_at_once_loses_nothing() {
    let mut sent = stream(0, 20_000, -7_000, 2);
    for message in &mut sent {
        if (5_000..9_000).contains(&message.arrives_ms) {
            message.arrives_ms = 9_000;
        }
    }
    let became = ordered(sent.clone());
    assert_eq!((became.taken.len(), became.late), (sent.len(), 0));
}

#[test]
fn a_clock_that_stands_still_is_handed_on_to_be_told() {
    for says_the_same in [false, true] {
        let mut order = Order::new(CountsFrom::Boot, StampClock::Host);
        let steps = (0..100).map(|i| {
            let content = if says_the_same { 5 } else { i };
            let arrived = Timestamp::from_millis(UNIX_MS + i as i64 * 20);
            order.step_boot_ms(MessageKind::Position, 0, content, arrived)
        });
        let taken = steps.filter(|step| *step == Step::At(0)).count();
        assert!(taken > 90, "{says_the_same}: {taken}");
    }
}

#[test]
fn kinds_that_take_turns_do_not_disturb_one_another() {
    let mut order = Order::new(CountsFrom::Boot, StampClock::Host);
    for i in 0..500_i64 {
        let arrived = Timestamp::from_millis(UNIX_MS + i * 20);
        let (attitude, position) = (100_000 + i * 20, 100_000 + i * 20 - 1_500);
        for (kind, boot_ms) in [
            (MessageKind::Attitude, attitude),
            (MessageKind::Position, position),
        ] {
            let step = order.step_boot_ms(kind, boot_ms as u32, i as u64, arrived);
            assert_eq!(step, Step::At(boot_ms * 1_000_000));
        }
    }
}

#[test]
fn data_on_a_clock_of_their_own_are_ordered_by_their_stamps() {
    let mut order = Order::new(CountsFrom::Boot, StampClock::Data);
    let mut step = |boot_ms: u32, content: u64| {
        let arrived = Timestamp::from_millis(boot_ms.into());
        order.step_boot_ms(MessageKind::Attitude, boot_ms, content, arrived)
    };
    for i in 0..1_000 {
        assert_eq!(
            step(100_000 + i * 20, i.into()),
            Step::At(i64::from(100_000 + i * 20) * 1_000_000)
        );
        if i >= 200 {
            let late = step(100_000 + (i - 200) * 20, (i - 200).into());
            assert_eq!(late, Step::Late, "{i}");
        }
    }
    let booted: Vec<_> = (0..6)
        .map(|i| step(5_000 + i * 20, u64::from(i) + 5_000))
        .collect();
    assert_eq!(booted[..4], [Step::Late; 4]);
    assert_eq!(
        booted[4..],
        [Step::Anew(5_080_000_000), Step::At(5_100_000_000)]
    );
}
