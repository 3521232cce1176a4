//! Logs in any order and cut off, and recordings of all that a session was given, which are read again.

use super::*;

#[test]
fn a_log_with_two_sessions_has_two_bases_and_one_sequence() {
    let mut session = Session::listening(config(), POWER_UP);
    session.receive(&log_header("\"1970-01-01T01:00:00Z\""), POWER_UP);
    stream(&mut session, 0..10);
    session.receive(&log_header("\"1970-01-01T02:00:00Z\""), POWER_UP);
    for number in 0..5 {
        let shot = Shot {
            length_mm: 20_000,
            gain_index: 3,
            channel: 9,
            millis: 80_000 + number * 100,
            ..Shot::nth(number)
        };
        session.receive(&shot.frame(), POWER_UP);
    }
    // Of a unit that is not the one before so few are believed once there is no other.
    session.finish(POWER_UP);
    assert_eq!(
        (session.poll_transmit(), session.poll_timeout()),
        (None, None)
    );
    let pings = pings(&mut session);
    assert_eq!(pings.len(), 15);
    for (i, ping) in pings.iter().enumerate() {
        let time_s = match i {
            0..10 => 3_600.0 + 0.025 * i as f64,
            _ => 7_200.0 + 0.1 * (i - 10) as f64,
        };
        assert!((ping.transmit_time().as_secs_f64() - time_s).abs() < 1e-9);
        assert_eq!(ping.sequence(), i as u64);
    }
    assert_eq!(pings[12].settings().gain_index, 3);
    assert!((pings[12].settings().range_length_m - 20.0).abs() < 1e-9);
    assert_eq!(session.counters().log_sessions, 2);
}

#[test]
fn a_log_without_time_is_on_device_time() {
    for header in [Vec::new(), log_header("null"), log_header("\"yesterday\"")] {
        let mut session = Session::listening(config(), POWER_UP);
        session.receive(&header, POWER_UP);
        stream(&mut session, 4..6);
        let first = pings(&mut session).remove(0);
        assert_eq!(first.transmit_time(), Timestamp::from_millis(1_100));
    }
}

#[test]
fn a_log_out_of_order_and_cut_off_gives_what_is_whole() {
    let mut session = Session::listening(config(), POWER_UP);
    let mut log = log_header("\"1970-01-01T00:00:00Z\"");
    let numbers = [0, 1, 2, 5, 3, 4, 6, 7, 20, 21, 8, 9, 22, 23];
    for number in numbers {
        log.extend(Shot::nth(number).frame());
    }
    let last = Shot::nth(24).frame();
    log.extend(&last[..last.len() - 1]);
    for piece in log.chunks(1_000) {
        session.receive(piece, POWER_UP);
    }
    session.finish(POWER_UP);
    let sequences: Vec<_> = pings(&mut session).iter().map(|p| p.sequence()).collect();
    assert_eq!(sequences, numbers.map(u64::from));
    let counters = session.counters();
    assert_eq!(counters.profiles_rejected.total(), 0);
    assert_eq!((counters.pings_late, counters.pings_missing), (4, 10));
    assert_eq!(counters.bytes_skipped, last.len() as u64 - 1);
    assert_eq!((counters.frames_bad, counters.profiles), (1, 14));
}

#[test]
fn blocks_of_a_log_in_another_order_are_all_pings_each_at_its_own_time() {
    let mut order: Vec<u32> = (0..8)
        .flat_map(|block| match block {
            0 => 0..100,
            _ => (8 - block) * 100..(9 - block) * 100,
        })
        .collect();
    assert_eq!(order.len(), 800);
    let mut session = Session::listening(config(), POWER_UP);
    let mut log = log_header("\"1970-01-01T00:00:00Z\"");
    for &number in &order {
        // The sonar was set to another range for the third block.
        let length_mm = if number / 100 == 3 { 20_000 } else { 12_000 };
        log.extend(
            Shot {
                length_mm,
                ..Shot::nth(number)
            }
            .frame(),
        );
    }
    for piece in log.chunks(10_000) {
        session.receive(piece, POWER_UP);
    }
    session.finish(POWER_UP);
    let pings = pings(&mut session);
    for ping in &pings {
        let time_s = 0.025 * ping.sequence() as f64;
        assert!((ping.transmit_time().as_secs_f64() - time_s).abs() < 1e-9);
    }
    let mut sequences: Vec<u32> = pings.iter().map(|ping| ping.sequence() as u32).collect();
    sequences.sort_unstable();
    order.sort_unstable();
    assert_eq!(sequences, order);
    let counters = session.counters();
    assert_eq!((counters.pings_late, counters.pings_missing), (600, 0));
    assert_eq!(
        (counters.reboots, counters.profiles_rejected.total()),
        (0, 0)
    );
}

/// What a session was given, as its tape has it.
#[derive(Debug)]
enum Given {
    Bytes(Vec<u8>),
    HalfFrameExpired,
    LinkDown,
    LinkUp,
}

/// Pings and what is told of them; what only a session that asks can tell is left out.
fn told_of_pings(session: &mut Session) -> Vec<SessionEvent> {
    let is_asking = |event: &SessionEvent| *event == SessionEvent::Configured;
    events(session)
        .into_iter()
        .filter(|event| !is_asking(event))
        .collect()
}

#[test]
fn a_replay_of_all_that_was_given_gives_the_same_pings_bit_for_bit() {
    for seed in 1..=20_u64 {
        for clock in [ClockSource::Host, ClockSource::Device] {
            let config = SessionConfig { clock, ..config() };
            let (tape, expected, counters) = faulty_dive(&config, seed);
            assert!(
                expected.len() > 300 && counters.reboots >= 1,
                "{counters:?}"
            );
            assert!(counters.pings_late > 0 && counters.frames_bad > 0);
            let expiries = tape
                .iter()
                .filter(|(_, given)| matches!(given, Given::HalfFrameExpired));
            assert!(expiries.count() > 0);
            let mut replay = Session::replaying(config, tape[0].0);
            let mut told = Vec::new();
            for (time, given) in &tape {
                match given {
                    Given::Bytes(bytes) => replay.receive(bytes, *time),
                    Given::HalfFrameExpired => replay.expire_half_frame(*time),
                    Given::LinkDown => replay.link_lost(*time),
                    Given::LinkUp => replay.link_restored(*time),
                }
                // However often it is asked, a replay gives up nothing by itself.
                assert!(!replay.handle_timeout(time.offset_by(5.0)));
                told.extend(told_of_pings(&mut replay));
            }
            replay.finish(tape[tape.len() - 1].0);
            told.extend(told_of_pings(&mut replay));
            assert_eq!(told.len(), expected.len(), "seed {seed}");
            assert!(told == expected, "seed {seed}");
            let again = replay.counters();
            assert_eq!(again.pings, counters.pings);
            assert_eq!(again.profiles_rejected, counters.profiles_rejected);
            assert_eq!(again.bytes_skipped, counters.bytes_skipped);
            assert_eq!(
                (replay.poll_transmit(), replay.poll_timeout()),
                (None, None)
            );
        }
    }
}

/// A live session through cut frames, disorder, lost links, reboots and steps of the host's clock;
/// what it was given, what it told, and its counters.
fn faulty_dive(
    config: &SessionConfig,
    seed: u64,
) -> (Vec<(Timestamp, Given)>, Vec<SessionEvent>, SessionCounters) {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut one_in = move |n: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 33).is_multiple_of(n)
    };
    let mut session = Session::new(config.clone(), POWER_UP);
    let (mut tape, mut told) = (vec![(POWER_UP, Given::LinkUp)], Vec::new());
    session.link_restored(POWER_UP);
    let (mut now, mut number, mut waiting) = (POWER_UP, 1_000_u32, Vec::new());
    for i in 0..600 {
        number += 1;
        if i == 300 {
            number = 0;
        }
        now = now.offset_by(0.025 + if one_in(5) { 0.012 } else { 0.0 });
        if one_in(150) {
            now = now.offset_by(if one_in(2) { 3_600.0 } else { -3_600.0 });
        }
        let mut frame = Shot::nth(number).frame();
        if one_in(12) {
            frame.truncate(frame.len() / 2);
        }
        if one_in(10) {
            waiting = frame;
            continue;
        }
        frame.extend(std::mem::take(&mut waiting));
        for piece in frame.chunks(if one_in(2) { 97 } else { 5_000 }) {
            session.receive(piece, now);
            tape.push((now, Given::Bytes(piece.to_vec())));
        }
        if one_in(4) {
            now = now.offset_by(0.3);
        }
        if session.handle_timeout(now) {
            tape.push((now, Given::HalfFrameExpired));
        }
        if one_in(60) {
            session.link_lost(now);
            tape.push((now, Given::LinkDown));
            now = now.offset_by(1.0);
            session.link_restored(now);
            tape.push((now, Given::LinkUp));
        }
        while session.poll_transmit().is_some() {}
        told.extend(told_of_pings(&mut session));
    }
    session.stop(now);
    session.finish(now);
    told.extend(told_of_pings(&mut session));
    (tape, told, session.counters())
}
