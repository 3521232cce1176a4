//! Several units on one link or in one log: one is mapped, whole, and the others are told.

use super::*;
use crate::units::UnitHeard;

/// One unit, and where its counters stood when the log began.
#[derive(Debug, Clone, Copy)]
struct Unit {
    channel: u8,
    source: u8,
    heading_deg: f32,
    first_number: u32,
    first_millis: u32,
    /// Tells its pings from others'.
    max_db: f32,
}

const FORWARD: Unit = Unit {
    channel: 0,
    source: 1,
    heading_deg: 0.0,
    first_number: 1_000,
    first_millis: 25_000,
    max_db: 40.0,
};

impl Unit {
    fn frame(&self, index: u32, source: u8) -> Vec<u8> {
        let results: Vec<u8> = (0..400).map(|i| (i * 7 + index) as u8).collect();
        let message = Message::OsMonoProfile(OsMonoProfile {
            ping_number: self.first_number + index,
            start_mm: 0,
            length_mm: 12_000,
            timestamp_ms: self.first_millis + index * INTERVAL_MS,
            ping_hz: 451_127,
            gain_index: 0,
            sos_dmps: 15_000,
            channel_number: self.channel,
            pulse_duration_sec: 3e-5,
            analog_gain: 1.0,
            max_pwr_db: self.max_db,
            min_pwr_db: -20.0,
            transducer_heading_deg: self.heading_deg,
            vehicle_heading_deg: 0.0,
            pwr_results: PowerResults::from_bytes(&results).unwrap(),
        });
        let mut frame = vec![0; message.encoded_byte_count()];
        message.encode(source, 0, &mut frame).unwrap();
        frame
    }
}

/// What a session made of two units whose profiles came in some order.
struct Outcome {
    /// Of the forward unit, and of the other.
    pings: [usize; 2],
    units: Vec<UnitHeard>,
    warnings: usize,
    rejected: u64,
}

/// `order` says of each profile which unit sends it; of `wrong` in a hundred the source is another.
fn heard(mut session: Session, other: &Unit, order: &[usize], wrong: u32) -> Outcome {
    let units = [&FORWARD, other];
    let mut sent = [0_u32; 2];
    let mut outcome = Outcome {
        pings: [0; 2],
        units: Vec::new(),
        warnings: 0,
        rejected: 0,
    };
    let take = |session: &mut Session, outcome: &mut Outcome| {
        for event in events(session) {
            match event {
                SessionEvent::Ping { frame, .. } => {
                    let frame = Frame::from_bytes(&frame).unwrap();
                    let Ok(Message::OsMonoProfile(profile)) = Message::parse(&frame) else {
                        panic!("a ping is made of a profile");
                    };
                    let is_other = profile.max_pwr_db != FORWARD.max_db;
                    outcome.pings[usize::from(is_other)] += 1;
                }
                SessionEvent::Warning(_) => outcome.warnings += 1,
                _ => {}
            }
        }
    };
    for (step, &whose) in order.iter().enumerate() {
        let unit = units[whose];
        let is_wrong = (step as u32).wrapping_mul(2_654_435_761) % 100 < wrong;
        let source = if is_wrong { 77 } else { unit.source };
        let now = after_ms(i64::from(FORWARD.first_millis) + 12 * step as i64);
        session.receive(&unit.frame(sent[whose], source), now);
        sent[whose] += 1;
        take(&mut session, &mut outcome);
    }
    session.finish(after_ms(10_000_000));
    take(&mut session, &mut outcome);
    outcome.units = session.units();
    outcome.rejected = session.counters().profiles_rejected.total();
    outcome
}

/// One profile each in turn; two of the other to one; bursts of up to seven; and at random.
fn orders() -> Vec<Vec<usize>> {
    let bursts = |step: usize| [1, 5, 2, 7, 1, 1, 3, 6][step / 2 % 8];
    let in_bursts = (0..200).flat_map(|step| vec![step % 2; bursts(step)]);
    let random = |step: u64| (step.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 33) as usize & 1;
    vec![
        (0..400).map(|step| step % 2).collect(),
        (0..400).map(|step| usize::from(step % 3 != 0)).collect(),
        in_bursts.collect(),
        // The forward unit is heard first.
        std::iter::once(0).chain((1..400).map(random)).collect(),
    ]
}

fn others() -> Vec<(&'static str, Unit)> {
    let labels = [
        (
            "channel",
            Unit {
                channel: 1,
                ..FORWARD
            },
        ),
        (
            "source",
            Unit {
                source: 2,
                ..FORWARD
            },
        ),
        (
            "heading",
            Unit {
                heading_deg: 90.0,
                ..FORWARD
            },
        ),
        (
            "all three",
            Unit {
                channel: 4,
                source: 9,
                heading_deg: -90.0,
                ..FORWARD
            },
        ),
    ];
    let counters = [
        ("in step", 0, 0_i32),
        ("3 ms later", 0, 3),
        ("powered up together", 6, 9),
        ("powered up later", 40_000, 777_777),
        ("powered up earlier", -900, -20_000),
    ];
    let mut all = Vec::new();
    for (_, unit) in labels {
        for (when, numbers, millis) in counters {
            all.push((
                when,
                Unit {
                    first_number: FORWARD.first_number.wrapping_add_signed(numbers),
                    first_millis: FORWARD.first_millis.wrapping_add_signed(millis),
                    max_db: 50.0,
                    ..unit
                },
            ));
        }
    }
    all
}

#[test]
fn of_two_units_one_is_mapped_whole_and_the_other_told_however_they_differ_and_alternate() {
    for (when, other) in others() {
        for order in orders() {
            for is_log in [true, false] {
                let session = match is_log {
                    true => Session::listening(config(), POWER_UP),
                    false => Session::new(config(), POWER_UP),
                };
                let outcome = heard(session, &other, &order, 0);
                let sent = order.iter().filter(|&&whose| whose == 0).count();
                let case = format!("{other:?} {when}, {}..., log {is_log}", order[1]);
                assert_eq!(outcome.pings, [sent, 0], "{case}");
                assert_eq!(outcome.units.len(), 2, "{case}");
                assert!(outcome.units[0].is_mapped && !outcome.units[1].is_mapped);
                assert_eq!(outcome.units[0].label.source, FORWARD.source);
                assert_eq!(outcome.rejected, (order.len() - sent) as u64, "{case}");
                assert!(outcome.warnings >= 1, "{case}");
            }
        }
    }
}

#[test]
fn units_that_say_the_same_of_themselves_are_told_by_their_counts() {
    for (numbers, millis) in [(40_000, 777_777), (-900, -20_000), (-59, 2), (52_001, 13)] {
        let other = Unit {
            first_number: FORWARD.first_number.wrapping_add_signed(numbers),
            first_millis: FORWARD.first_millis.wrapping_add_signed(millis),
            max_db: 50.0,
            ..FORWARD
        };
        for order in orders() {
            let outcome = heard(Session::listening(config(), POWER_UP), &other, &order, 0);
            let sent = order.iter().filter(|&&whose| whose == 0).count();
            let case = format!("{numbers} pings, {millis} ms, {}...", order[1]);
            assert_eq!(outcome.pings, [sent, 0], "{case}");
            assert_eq!(outcome.units.len(), 2, "{case}");
        }
    }
    // In step to the last millisecond, as synchronised units are, in turn: contents tell them.
    let twin = Unit {
        max_db: 50.0,
        ..FORWARD
    };
    let order: Vec<usize> = (0..400).map(|step| step % 2).collect();
    let outcome = heard(Session::listening(config(), POWER_UP), &twin, &order, 0);
    assert_eq!((outcome.pings, outcome.units.len()), ([200, 0], 2));
}

#[test]
fn a_wrong_source_on_some_packets_is_no_other_unit() {
    for wrong in [1, 5, 20, 60] {
        let alone = vec![0; 400];
        let outcome = heard(
            Session::listening(config(), POWER_UP),
            &FORWARD,
            &alone,
            wrong,
        );
        assert_eq!(outcome.pings, [400, 0], "{wrong} of 100");
        assert_eq!(outcome.rejected, 0, "{wrong} of 100");
        assert_eq!(outcome.units.len(), 1, "{wrong} of 100");
    }
    // Nor does it let another unit in.
    let other = Unit {
        channel: 1,
        first_number: 70_000,
        first_millis: 900,
        max_db: 50.0,
        ..FORWARD
    };
    for order in orders() {
        let sent = order.iter().filter(|&&whose| whose == 0).count();
        let outcome = heard(Session::listening(config(), POWER_UP), &other, &order, 10);
        assert_eq!(outcome.pings, [sent, 0]);
    }
}

#[test]
fn a_key_chooses_by_channel_source_or_heading() {
    let side = Unit {
        channel: 1,
        source: 2,
        heading_deg: 270.0,
        first_number: 9,
        first_millis: 400,
        max_db: 50.0,
    };
    let order: Vec<usize> = (0..400).map(|step| step % 2).collect();
    let chosen = |config: SessionConfig| {
        let session = Session::listening(config, POWER_UP);
        assert!(session.chooses_a_unit());
        heard(session, &side, &order, 0)
    };
    let keys = [
        SessionConfig {
            channel: Some(1),
            ..config()
        },
        SessionConfig {
            source: Some(2),
            ..config()
        },
        SessionConfig {
            heading_deg: Some(-90.0),
            ..config()
        },
        SessionConfig {
            source: Some(2),
            heading_deg: Some(285.0),
            ..config()
        },
    ];
    for key in keys {
        let case = format!("{key:?}");
        assert_eq!(chosen(key).pings, [0, 200], "{case}");
    }
    let nobody = chosen(SessionConfig {
        source: Some(9),
        ..config()
    });
    assert_eq!(nobody.pings, [0, 0]);
    assert_eq!(nobody.units.len(), 2);
    assert!(nobody.units.iter().all(|unit| !unit.is_mapped));
}

#[test]
fn the_same_unit_goes_on_in_the_next_session_of_a_log() {
    let side = Unit {
        source: 2,
        heading_deg: 90.0,
        first_number: 1,
        first_millis: 1,
        max_db: 50.0,
        ..FORWARD
    };
    let mut session = Session::listening(config(), POWER_UP);
    for (first, second) in [(&FORWARD, &side), (&side, &FORWARD)] {
        session.receive(&log_header("\"1970-01-01T00:01:00Z\""), POWER_UP);
        for index in 0..50 {
            session.receive(&first.frame(index, first.source), POWER_UP);
            session.receive(&second.frame(index, second.source), POWER_UP);
        }
    }
    session.finish(POWER_UP);
    assert_eq!(session.counters().pings, 100);
    let units = session.units();
    assert_eq!(units.len(), 2);
    assert_eq!((units[0].label.source, units[0].profiles), (1, 100));
    // One that is alone and has another number now is mapped.
    let renumbered = Unit {
        source: 7,
        ..FORWARD
    };
    session.receive(&log_header("\"1970-01-01T00:09:00Z\""), POWER_UP);
    for index in 0..50 {
        session.receive(&renumbered.frame(index, 7), POWER_UP);
    }
    session.finish(POWER_UP);
    assert_eq!(session.counters().pings, 150);
}
