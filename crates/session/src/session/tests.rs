//! A session and a scripted device in virtual time.

mod recorded;
mod units;

use std::sync::Arc;

use echosplat_firmware_protocol::{
    OsMonoProfile, OsPingParams, PowerResults, ProtocolVersion, Text,
};
use echosplat_model::Ping;

use super::*;
use crate::config::ClockSource;

const INTERVAL_MS: u32 = 25;
/// Host time at which the device was powered up.
const POWER_UP: Timestamp = Timestamp::from_millis(1_700_000_000_000);

fn config() -> SessionConfig {
    SessionConfig {
        range_length_m: 12.0,
        bin_count: 200,
        ..SessionConfig::default()
    }
}

fn device_config() -> SessionConfig {
    SessionConfig {
        clock: ClockSource::Device,
        ..config()
    }
}

fn frame_of(message: &Message<'_>) -> Vec<u8> {
    let mut frame = vec![0; message.encoded_byte_count()];
    message.encode(1, 0, &mut frame).unwrap();
    frame
}

/// What a profile is made from.
#[derive(Clone, Copy)]
struct Shot {
    number: u32,
    millis: u32,
    length_mm: u32,
    channel: u8,
    gain_index: u16,
    max_db: f32,
    bin_count: usize,
}

impl Shot {
    fn nth(number: u32) -> Self {
        Self {
            number,
            millis: 1_000 + number * INTERVAL_MS,
            length_mm: 12_000,
            channel: 3,
            gain_index: 0,
            max_db: 40.0,
            bin_count: 200,
        }
    }

    fn frame(self) -> Vec<u8> {
        let results: Vec<u8> = (0..2 * self.bin_count).map(|i| (i * 7) as u8).collect();
        frame_of(&Message::OsMonoProfile(OsMonoProfile {
            ping_number: self.number,
            start_mm: 0,
            length_mm: self.length_mm,
            timestamp_ms: self.millis,
            ping_hz: 451_127,
            gain_index: self.gain_index,
            sos_dmps: 15_000,
            channel_number: self.channel,
            pulse_duration_sec: 3e-5,
            analog_gain: 1.0,
            max_pwr_db: self.max_db,
            min_pwr_db: -20.0,
            transducer_heading_deg: 0.0,
            vehicle_heading_deg: 0.0,
            pwr_results: PowerResults::from_bytes(&results).unwrap(),
        }))
    }
}

fn log_header(timestamp: &str) -> Vec<u8> {
    let json = format!("{{\"session_id\": 1, \"timestamp\": {timestamp}}}");
    frame_of(&Message::Json(Text::from(json.as_str())))
}

fn identity() -> Vec<u8> {
    frame_of(&Message::DeviceInformation(DeviceInformation {
        device_type: 104,
        device_revision: 2,
        firmware: [1, 5, 6],
    }))
}

/// What a session sent, read back.
#[derive(Debug, Default, PartialEq)]
struct Sent {
    requested: Vec<u16>,
    /// Payload length and enable of each settings message.
    settings: Vec<(usize, bool)>,
}

fn sent(session: &mut Session) -> Sent {
    let mut sent = Sent::default();
    while let Some(bytes) = session.poll_transmit() {
        let frame = Frame::from_bytes(&bytes).unwrap();
        match Message::parse(&frame).unwrap() {
            Message::GeneralRequest { requested_id } => sent.requested.push(requested_id),
            Message::OsPingParams(OsPingParams { enable, .. }) => {
                sent.settings.push((frame.payload().len(), enable));
            }
            other => panic!("not to be sent: {other:?}"),
        }
    }
    sent
}

fn events(session: &mut Session) -> Vec<SessionEvent> {
    std::iter::from_fn(|| session.poll_event()).collect()
}

fn pings(session: &mut Session) -> Vec<Arc<Ping>> {
    let pings = |event| match event {
        SessionEvent::Ping { ping, .. } => Some(ping),
        _ => None,
    };
    events(session).into_iter().filter_map(pings).collect()
}

/// Runs time to `until`, waking the session only when it asks to be; returns what was sent and
/// when, in milliseconds since power-up.
fn run_to(session: &mut Session, until: Timestamp) -> Vec<(i64, Sent)> {
    let mut log = Vec::new();
    while let Some(due) = session.poll_timeout().filter(|&due| due <= until) {
        session.handle_timeout(due);
        let sent = sent(session);
        if sent != Sent::default() {
            log.push(((due.seconds_since(POWER_UP) * 1e3).round() as i64, sent));
        }
    }
    log
}

fn after_ms(millis: i64) -> Timestamp {
    POWER_UP.offset_by_nanos(millis * 1_000_000)
}

/// Gives the first `count` profiles at the device's pace.
fn stream(session: &mut Session, numbers: std::ops::Range<u32>) {
    for number in numbers {
        let shot = Shot::nth(number);
        session.receive(&shot.frame(), after_ms(shot.millis.into()));
    }
}

#[test]
fn it_asks_who_is_there_and_how_to_ping_until_both_are_answered() {
    let mut session = Session::new(config(), POWER_UP);
    let first = sent(&mut session);
    assert_eq!(
        first.requested,
        [id::DEVICE_INFORMATION, id::PROTOCOL_VERSION]
    );
    assert_eq!(first.settings, [(36, true)]);

    // All of it is lost: it is sent again, the settings in both lengths, ever more slowly.
    let log = run_to(&mut session, after_ms(20_000));
    let settings: Vec<_> = log
        .iter()
        .flat_map(|(at, sent)| sent.settings.iter().map(|&(bytes, _)| (*at, bytes)))
        .collect();
    assert_eq!(
        settings,
        [
            (500, 36),
            (1_500, 34),
            (3_500, 36),
            (7_500, 34),
            (15_500, 36)
        ]
    );
    assert_eq!(session.counters().resends, 5);

    let now = after_ms(21_000);
    session.receive(&identity(), now);
    session.receive(&Shot::nth(800).frame(), now);
    let told = events(&mut session);
    assert!(matches!(told[0], SessionEvent::Warning(_)));
    let firmware = [1, 5, 6];
    let identified = SessionEvent::Identified(DeviceInformation {
        device_type: 104,
        device_revision: 2,
        firmware,
    });
    assert_eq!(told[1], identified);
    assert_eq!(told[2], SessionEvent::Configured);
    assert!(matches!(told[3], SessionEvent::Ping { .. }));
    assert_eq!(run_to(&mut session, after_ms(23_000)), []);
}

#[test]
fn profiles_with_other_settings_are_pings_but_confirm_nothing() {
    let mut session = Session::new(config(), POWER_UP);
    sent(&mut session);
    for number in 0..40 {
        let shot = Shot {
            length_mm: 50_000,
            ..Shot::nth(number)
        };
        let now = after_ms(shot.millis.into());
        session.receive(&shot.frame(), now);
        session.handle_timeout(now);
    }
    let told = events(&mut session);
    assert!(!told.contains(&SessionEvent::Configured));
    assert_eq!(session.counters().pings, 40);
    assert_eq!(session.counters().settings_mismatched, 40);
    assert_eq!(sent(&mut session).settings, [(36, true)]);
    assert!(session.counters().resends >= 1);

    stream(&mut session, 40..45);
    let told = events(&mut session);
    assert!(told.contains(&SessionEvent::Configured));
    assert_eq!(session.counters().pings, 45);
}

#[test]
fn settings_changed_by_somebody_else_and_silence_are_answered_by_asking_again() {
    let mut session = Session::new(config(), POWER_UP);
    session.receive(&identity(), POWER_UP);
    stream(&mut session, 0..10);
    sent(&mut session);
    for number in 10..30 {
        let shot = Shot {
            length_mm: 5_000,
            ..Shot::nth(number)
        };
        let now = after_ms(shot.millis.into());
        session.receive(&shot.frame(), now);
        session.handle_timeout(now);
    }
    assert_eq!(sent(&mut session).settings, [(36, true)]);
    stream(&mut session, 30..32);
    assert_eq!(events(&mut session).last().map(is_ping), Some(true));
    let after_silence = run_to(&mut session, after_ms(10_000));
    assert_eq!(after_silence[0].1.settings, [(36, true)]);
    assert!(after_silence[0].0 > 4_000);
}

fn is_ping(event: &SessionEvent) -> bool {
    matches!(event, SessionEvent::Ping { .. })
}

#[test]
fn refusals_and_strange_frames_are_counted_and_survived() {
    let mut session = Session::new(config(), POWER_UP);
    let nack = Message::Nack {
        nacked_id: id::OS_PING_PARAMS,
        text: Text::from("no"),
    };
    let strange = Message::Unknown {
        message_id: 4711,
        payload: &[1, 2, 3],
    };
    let odd_type = DeviceInformation {
        device_type: 7,
        device_revision: 0,
        firmware: [0; 3],
    };
    let version = ProtocolVersion { version: [1, 0, 0] };
    let acked_id = id::OS_PING_PARAMS;
    for message in [
        nack,
        strange,
        Message::Nop,
        Message::Ack { acked_id },
        Message::Nmea(Text::from("$GPGGA")),
        Message::Mavlink(Text::from("{}")),
        Message::DeviceInformation(odd_type),
        Message::ProtocolVersion(version),
    ] {
        session.receive(&frame_of(&message), POWER_UP);
    }
    let told = events(&mut session);
    let text = "no".to_owned();
    assert_eq!(told[0], SessionEvent::Nack { id: 2197, text });
    assert!(matches!(told[1], SessionEvent::Warning(_)));
    assert_eq!(told[2], SessionEvent::Identified(odd_type));
    let counters = session.counters();
    assert_eq!((counters.nacks, counters.acks), (1, 1));
    assert_eq!((counters.frames_unknown, counters.frames_unused), (1, 2));
    assert_eq!(
        (counters.nmea, counters.mavlink, counters.frames_good),
        (1, 1, 8)
    );
}

#[test]
fn stop_says_enable_0_once_confirmed_in_the_length_that_worked() {
    let mut session = Session::new(config(), POWER_UP);
    sent(&mut session);
    session.stop(POWER_UP);
    assert_eq!(sent(&mut session).settings, [(36, false), (34, false)]);
    assert_eq!(session.poll_timeout(), None);

    let mut session = Session::new(config(), POWER_UP);
    stream(&mut session, 0..3);
    sent(&mut session);
    session.stop(after_ms(2_000));
    assert_eq!(sent(&mut session).settings, [(36, false)]);
    assert_eq!(run_to(&mut session, after_ms(60_000)), []);
}

#[test]
fn a_lost_link_forgets_the_half_frame_and_asks_anew_when_it_is_back() {
    let mut session = Session::new(device_config(), POWER_UP);
    stream(&mut session, 0..10);
    let frame = Shot::nth(10).frame();
    session.receive(&frame[..100], after_ms(1_300));
    session.link_lost(after_ms(1_400));
    assert_eq!(session.poll_transmit(), None);
    assert_eq!(session.counters().bytes_skipped, 100);
    assert_eq!(session.counters().frames_bad, 1);
    session.link_restored(after_ms(61_400));
    let again = sent(&mut session);
    assert_eq!((again.requested.len(), again.settings.len()), (2, 1));
    events(&mut session);
    for number in 2_410..2_420 {
        session.receive(&Shot::nth(number).frame(), after_ms(61_500));
    }
    let told = events(&mut session);
    assert_eq!(told[0], SessionEvent::Configured);
    assert_eq!(told.len(), 11);
    assert_eq!(session.counters().pings_missing, 2_400);
}

#[test]
fn a_half_frame_that_does_not_grow_lets_the_frame_inside_it_go() {
    let mut session = Session::listening(config(), POWER_UP);
    stream(&mut session, 0..2);
    events(&mut session);
    // A damaged header claims the profile that follows it.
    let mut bytes = b"BR\xf0\x02\x03\x00\x00\x00".to_vec();
    bytes.extend(Shot::nth(2).frame());
    let now = after_ms(1_050);
    session.receive(&bytes, now);
    assert_eq!(pings(&mut session).len(), 0);
    let due = session.poll_timeout().unwrap();
    assert_eq!(due, now.offset_by(0.25));
    session.handle_timeout(due);
    assert_eq!(pings(&mut session).len(), 1);
    assert_eq!(session.counters().bytes_skipped, 8);
}

#[test]
fn device_time_wraps_after_49_days_and_counts_on() {
    let mut session = Session::new(device_config(), POWER_UP);
    for i in 0..20 {
        let shot = Shot {
            millis: (u32::MAX - 200).wrapping_add(i * INTERVAL_MS),
            ..Shot::nth(u32::MAX.wrapping_sub(7).wrapping_add(i))
        };
        session.receive(&shot.frame(), POWER_UP);
    }
    let pings = pings(&mut session);
    assert_eq!(pings.len(), 20);
    for pair in pings.windows(2) {
        let step_s = pair[1]
            .transmit_time()
            .seconds_since(pair[0].transmit_time());
        assert!((step_s - 0.025).abs() < 1e-9);
        assert_eq!(pair[1].sequence(), pair[0].sequence() + 1);
    }
    assert_eq!(session.counters().reboots, 0);
}

#[test]
fn a_reboot_in_mid_dive_goes_on_in_sequence_and_on_the_hosts_clock() {
    let mut session = Session::new(config(), POWER_UP);
    stream(&mut session, 0..400);
    let before = pings(&mut session);
    // Powered up again 30 s later.
    let rebooted = after_ms(41_000);
    for i in 0..20 {
        let shot = Shot {
            millis: 500 + i * INTERVAL_MS,
            ..Shot::nth(i)
        };
        let delay_ms = 2 + i64::from(i * 7 % 5);
        let arrival = rebooted.offset_by_nanos((i64::from(shot.millis) + delay_ms) * 1_000_000);
        session.receive(&shot.frame(), arrival);
    }
    let told = events(&mut session);
    let restarts = told.iter().filter(|&e| *e == SessionEvent::Rebooted);
    assert_eq!((restarts.count(), session.counters().reboots), (1, 1));
    let after: Vec<_> = told
        .into_iter()
        .filter_map(|event| match event {
            SessionEvent::Ping { ping, .. } => Some(ping),
            _ => None,
        })
        .collect();
    assert_eq!((before.len(), after.len()), (400, 20));
    assert_eq!(after[0].sequence(), before[399].sequence() + 1);
    for (i, ping) in after.iter().enumerate() {
        let truth = rebooted.offset_by(0.5 + 0.025 * i as f64);
        let error_s = ping.transmit_time().seconds_since(truth);
        assert!(error_s.abs() < 5e-3, "{i}: {error_s}");
    }
}

#[test]
fn a_step_of_the_hosts_clock_is_followed_and_stops_no_waits() {
    for step_s in [3_600.0, -3_600.0] {
        let mut session = Session::new(config(), POWER_UP);
        session.receive(&identity(), POWER_UP);
        stream(&mut session, 0..100);
        pings(&mut session);
        for number in 100..130 {
            let shot = Shot::nth(number);
            let truth = after_ms(shot.millis.into()).offset_by(step_s);
            session.receive(&shot.frame(), truth.offset_by(0.002));
            session.handle_timeout(truth.offset_by(0.002));
            let ping = pings(&mut session).pop().unwrap();
            let error_s = ping.transmit_time().seconds_since(truth);
            assert!(number < 110 || error_s.abs() < 5e-3, "{number}: {error_s}");
        }
        // Silence is noticed three seconds later, not an hour.
        let due = session.poll_timeout().unwrap();
        let stepped_end = after_ms(4_225).offset_by(step_s);
        let wait_s = due.seconds_since(stepped_end);
        assert!((2.0..4.0).contains(&wait_s), "{step_s}: {wait_s}");
    }
}

#[test]
fn order_duplicates_channels_and_nonsense_are_told_apart_and_add_up() {
    let mut session = Session::new(device_config(), POWER_UP);
    stream(&mut session, 0..10);
    let other = Shot {
        channel: 4,
        ..Shot::nth(10)
    };
    let loud = Shot {
        max_db: f32::NAN,
        ..Shot::nth(10)
    };
    let far = Shot {
        length_mm: u32::MAX,
        ..Shot::nth(10)
    };
    let jumped = Shot {
        number: 9_000,
        ..Shot::nth(10)
    };
    let moved = Shot {
        millis: 1_090,
        ..Shot::nth(4)
    };
    for shot in [other, loud, far, Shot::nth(9), Shot::nth(4), moved, jumped] {
        session.receive(&shot.frame(), POWER_UP);
    }
    stream(&mut session, 10..14);
    let counters = session.counters();
    let rejected = counters.profiles_rejected;
    assert_eq!(
        (rejected.other_channel, rejected.scale, rejected.range),
        (1, 1, 1)
    );
    assert_eq!(
        (rejected.duplicate, rejected.late, rejected.unconfirmed),
        (2, 1, 1)
    );
    assert_eq!(counters.pings, 14);
    assert_eq!(counters.profiles, counters.pings + rejected.total());
    let sequences: Vec<_> = pings(&mut session).iter().map(|p| p.sequence()).collect();
    assert_eq!(sequences, (0..14).collect::<Vec<_>>());
}

#[test]
fn any_bytes_are_survived_and_accounted_for() {
    let mut session = Session::new(config(), POWER_UP);
    let mut state = 1_u64;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 56) as u8
    };
    let (mut received, mut good) = (0, 0);
    for i in 0..2_000_u32 {
        let mut frame = Shot::nth(i).frame();
        let hit = usize::from(noise()) * 2 % frame.len();
        match noise() % 3 {
            0 => frame[hit] ^= noise() | 1,
            1 => frame.truncate(hit),
            _ => good += 1,
        }
        received += frame.len() as u64;
        session.receive(&frame, after_ms(i.into()));
        events(&mut session);
    }
    session.finish(after_ms(3_000));
    let counters = session.counters();
    assert_eq!(counters.bytes_received, received);
    let in_frames = counters.frames_good * Shot::nth(0).frame().len() as u64;
    assert_eq!(in_frames + counters.bytes_skipped, received);
    assert!(counters.pings >= good - 2, "{} of {good}", counters.pings);
}

/// Flips each bit with probability `rate`.
fn damage(frame: &mut [u8], rate: f64, random: &mut impl FnMut() -> f64) {
    let mut bit = 0;
    loop {
        // Geometric: the distance to the next flip.
        bit += (random().ln() / (1.0 - rate).ln()) as usize;
        if bit >= 8 * frame.len() {
            return;
        }
        frame[bit / 8] ^= 1 << (bit % 8);
        bit += 1;
    }
}

#[test]
fn of_damaged_frames_hardly_one_in_two_thousand_is_taken_with_wrong_settings_time_or_scale() {
    let mut state = 7_u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    };
    let nth = |number| Shot {
        bin_count: 600,
        ..Shot::nth(number)
    };
    // Most and least power, as they lie in the frame.
    let scale = |frame: &[u8]| -> [u8; 8] { *frame[44..].first_chunk().unwrap() };
    let settings = crate::profile::settings;
    for rate in [1e-4, 1e-3] {
        let mut session = Session::listening(config(), POWER_UP);
        let (mut damaged, mut damaged_taken, mut wrong) = (0_u32, 0_u32, 0_u32);
        for i in 0..15_000 {
            let good = nth(i).frame();
            let mut frame = good.clone();
            damage(&mut frame, rate, &mut random);
            damaged += u32::from(frame != good);
            session.receive(&frame, POWER_UP);
            session.handle_timeout(POWER_UP.offset_by(1.0));
            session.core.clock_is(POWER_UP);
            for event in events(&mut session) {
                let SessionEvent::Ping { ping, frame } = event else {
                    continue;
                };
                let shot = nth(ping.sequence() as u32);
                let truth = shot.frame();
                let Message::OsMonoProfile(profile) =
                    Message::parse(&Frame::from_bytes(&truth).unwrap()).unwrap()
                else {
                    unreachable!()
                };
                let is_right = *ping.settings() == settings(&profile, &config())
                    && ping.transmit_time() == Timestamp::from_millis(shot.millis.into())
                    && scale(&frame) == scale(&truth);
                damaged_taken += u32::from(*frame != *truth);
                wrong += u32::from(!is_right);
            }
        }
        println!("{rate}: {damaged} damaged, {damaged_taken} taken, {wrong} of them wrong");
        assert!(wrong * 2_000 <= damaged, "{rate}: {wrong} of {damaged}");
    }
}

#[test]
fn two_pings_in_one_millisecond_are_two_and_the_same_one_twice_is_one() {
    for order in [[0, 1, 2, 3, 4, 5], [0, 1, 3, 2, 5, 4]] {
        let mut session = Session::new(device_config(), POWER_UP);
        stream(&mut session, 0..10);
        for i in order {
            // 10 and 11, 12 and 13, 14 and 15 within one millisecond each.
            let shot = Shot {
                millis: 1_250 + i / 2 * 50,
                ..Shot::nth(10 + i)
            };
            session.receive(&shot.frame(), POWER_UP);
            session.receive(&shot.frame(), POWER_UP);
        }
        stream(&mut session, 16..18);
        let counters = session.counters();
        assert_eq!(
            (counters.pings, counters.profiles_rejected.duplicate),
            (18, 6)
        );
        assert_eq!(counters.profiles_rejected.total(), 6);
    }
}

#[test]
fn a_late_ping_of_a_live_link_has_its_own_time_on_the_hosts_clock() {
    let mut session = Session::new(config(), POWER_UP);
    stream(&mut session, 0..50);
    stream(&mut session, 53..60);
    pings(&mut session);
    let arrival = after_ms(Shot::nth(60).millis.into());
    session.receive(&Shot::nth(51).frame(), arrival);
    let late = pings(&mut session).pop().unwrap();
    let truth = after_ms(Shot::nth(51).millis.into());
    assert_eq!(late.sequence(), 51);
    assert!(late.transmit_time().seconds_since(truth).abs() < 1e-3);
    let counters = session.counters();
    assert_eq!((counters.pings_late, counters.pings_missing), (1, 2));
}

#[test]
fn a_flood_of_refusals_is_told_rarely_and_forges_no_line() {
    let mut session = Session::new(config(), POWER_UP);
    let text = "no\n2026-01-01 ERROR all is lost \u{1b}[2J\u{202e}".repeat(20);
    let nack = frame_of(&Message::Nack {
        nacked_id: 7,
        text: Text::from(text.as_str()),
    });
    let said = frame_of(&Message::AsciiText(Text::from(text.as_str())));
    let mut told = Vec::new();
    for i in 0..20_000 {
        session.receive(&nack, after_ms(i));
        session.receive(&said, after_ms(i));
        told.extend(events(&mut session));
    }
    assert_eq!(session.counters().nacks, 20_000);
    assert!((2..12).contains(&told.len()), "{}", told.len());
    for event in &told {
        let (SessionEvent::Nack { text, .. } | SessionEvent::Warning(text)) = event else {
            panic!("{event:?}");
        };
        assert!(text.chars().count() < 260 && text.contains("no\\n"));
        assert!(!text.contains(|c: char| c.is_control() || c == '\u{202e}'));
    }
    let last = format!("{:?}", told.last());
    assert!(last.contains("more before this"), "{last}");
}

#[test]
fn the_first_refusal_is_kept_in_words() {
    let mut session = Session::new(config(), POWER_UP);
    assert_eq!(session.first_refusal(), None);
    let odd = |max_db| Shot {
        max_db,
        ..Shot::nth(0)
    };
    session.receive(&odd(f32::NAN).frame(), POWER_UP);
    session.receive(&odd(900.0).frame(), POWER_UP);
    let words = session.first_refusal().unwrap();
    assert!(
        words.contains("NaN") && words.contains("-200 to 200 dB"),
        "{words}"
    );
    assert_eq!(session.counters().profiles_rejected.scale, 2);
}
