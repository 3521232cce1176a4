use super::*;
use crate::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene};

fn device(noise: NoiseLevel) -> SimulatedDevice {
    let scene = Arc::new(Scene::named("fence").unwrap());
    let options = DiveOptions {
        duration_s: 4.0,
        ..DiveOptions::default()
    };
    let dive = Dive::plan_with(DiveKind::Survey, &scene, noise, 1, &options).unwrap();
    SimulatedDevice::new(Arc::new(SimulatedSonar::new(
        scene,
        Arc::new(dive),
        noise,
        1,
    )))
}

fn params(enable: bool) -> OsPingParams {
    OsPingParams {
        start_mm: 0,
        length_mm: 10_000,
        msec_per_ping: 25,
        pulse_len_percent: 0.002,
        filter_duration_percent: 0.0015,
        gain_index: 0,
        num_results: 600,
        enable,
    }
}

fn ms(millis: i64) -> Timestamp {
    Timestamp::from_millis(millis)
}

fn send(device: &mut SimulatedDevice, message: &Message<'_>, now: Timestamp) {
    device.receive(&encoded(message, 0).unwrap(), now);
}

/// Every intact frame's id and whole bytes.
fn frames(bytes: &[u8]) -> Vec<(u16, Vec<u8>)> {
    let mut found = Vec::new();
    let mut decoder = Decoder::new();
    decoder.feed(bytes, &mut |event| match event {
        Event::Frame(frame) => found.push((frame.message_id(), frame.bytes().to_vec())),
        Event::Skipped(skipped) => panic!("{skipped:?}"),
    });
    assert_eq!(decoder.pending_byte_count(), 0);
    found
}

fn ids(bytes: &[u8]) -> Vec<u16> {
    frames(bytes).iter().map(|(id, _)| *id).collect()
}

fn run_until(device: &mut SimulatedDevice, end: Timestamp) -> Vec<(u16, Vec<u8>)> {
    let mut all = Vec::new();
    while let Some(due) = device.next_due().filter(|&due| due <= end) {
        all.extend(frames(&device.advance(due)));
    }
    all
}

#[test]
fn it_tells_who_it_is_and_refuses_what_it_does_not_know() {
    let mut device = device(NoiseLevel::None);
    assert_eq!(device.next_due(), None);
    for requested_id in [id::DEVICE_INFORMATION, id::PROTOCOL_VERSION, id::STATUS] {
        send(
            &mut device,
            &Message::GeneralRequest { requested_id },
            ms(5),
        );
    }
    let old_speed_of_sound = Message::Unknown {
        message_id: 1002,
        payload: &1_500_000u32.to_le_bytes(),
    };
    send(&mut device, &old_speed_of_sound, ms(5));
    let speed = Message::SetSpeedOfSound {
        speed_of_sound_mmps: 1_500_000,
    };
    send(&mut device, &speed, ms(5));
    send(&mut device, &Message::SetSyncChannelNumber(CHANNEL), ms(5));
    let answers = frames(&device.advance(ms(5)));
    let answer_ids: Vec<u16> = answers.iter().map(|(id, _)| *id).collect();
    assert_eq!(answer_ids, [4, 5, 2, 2, 1, 1]);
    assert_eq!(answers[0].1[8..14], [104, 2, 1, 5, 6, 0]);
    assert_eq!(answers[3].1[8..10], 1002u16.to_le_bytes());
    let counters = device.counters();
    assert_eq!(
        (counters.requests, counters.nacks, counters.frames),
        (3, 2, 6)
    );
    assert!(device.advance(ms(10_000)).is_empty());
}

#[test]
fn enabled_it_sends_the_dives_pings_and_disabled_nothing() {
    let mut device = device(NoiseLevel::Nominal);
    let sonar = device.sonar.clone();
    send(&mut device, &Message::OsPingParams(params(true)), ms(700));
    assert_eq!(device.next_ping_due(), Some(ms(700)));
    let sent = run_until(&mut device, ms(2_000));
    let profiles: Vec<_> = sent
        .iter()
        .filter(|(id, _)| *id == id::OS_MONO_PROFILE)
        .collect();
    assert_eq!(profiles.len(), 53);
    // The very bytes of the sonar itself: nothing is lost on the wire.
    for (index, (_, bytes)) in profiles.iter().enumerate() {
        assert_eq!(bytes, &sonar.ping(index).frame(DEVICE_ID).unwrap());
    }
    assert_eq!(sent.iter().filter(|(id, _)| *id == id::STATUS).count(), 1);
    send(
        &mut device,
        &Message::OsPingParams(params(false)),
        ms(2_001),
    );
    assert_eq!(device.next_due(), None);
    assert!(device.advance(ms(3_000)).is_empty());
    // Started again the dive has gone on, and nothing is made up for.
    send(&mut device, &Message::OsPingParams(params(true)), ms(3_700));
    assert_eq!(device.next_ping_due(), Some(ms(3_700)));
    let again = frames(&device.advance(ms(3_700)));
    assert_eq!(again[0].0, id::OS_MONO_PROFILE);
    let sent = run_until(&mut device, ms(60_000));
    assert!(device.is_finished() && sent.len() < 60);
    let counters = device.counters();
    assert_eq!((counters.enables, counters.disables), (2, 1));
}

#[test]
fn a_dive_that_is_over_begins_anew_once_it_is_stopped_and_started_again() {
    let mut device = device(NoiseLevel::Nominal);
    let sonar = device.sonar.clone();
    send(&mut device, &Message::OsPingParams(params(true)), ms(0));
    run_until(&mut device, ms(60_000));
    // Asked again by the same client, it has nothing more to send.
    send(&mut device, &Message::OsPingParams(params(true)), ms(8_000));
    assert!(device.is_finished() && device.next_due().is_none());
    for enable in [false, true] {
        send(
            &mut device,
            &Message::OsPingParams(params(enable)),
            ms(9_000),
        );
    }
    assert_eq!(device.next_ping_due(), Some(ms(9_000)));
    assert_eq!(device.dive_time(), ms(0));
    let again = frames(&device.advance(ms(9_000)));
    assert_eq!(again[0].1, sonar.ping(0).frame(DEVICE_ID).unwrap());
}

#[test]
fn it_obeys_the_settings_of_its_client() {
    let mut device = device(NoiseLevel::None);
    let asked = OsPingParams {
        start_mm: 1_000,
        length_mm: 30_000,
        msec_per_ping: 0,
        num_results: 5_000,
        pulse_len_percent: f32::NAN,
        ..params(true)
    };
    let speed = Message::SetSpeedOfSound {
        speed_of_sound_mmps: 1_450_000,
    };
    send(&mut device, &speed, ms(0));
    send(&mut device, &Message::OsPingParams(asked), ms(0));
    device.advance(ms(0));
    // 31 m there and back at 1450 m/s takes 42.8 ms, and 3.5 ms more.
    assert_eq!(device.next_ping_due(), Some(ms(47)));
    let sent = frames(&device.advance(ms(47)));
    let frame = Frame::from_bytes(&sent[0].1).unwrap();
    let Ok(Message::OsMonoProfile(profile)) = Message::parse(&frame) else {
        panic!("no profile");
    };
    assert_eq!((profile.start_mm, profile.length_mm), (1_000, 30_000));
    assert_eq!((profile.sos_dmps, profile.timestamp_ms), (14_500, 47));
    assert_eq!(profile.pwr_results.len(), 1200);
    assert!(profile.pulse_duration_sec > 0.0);
}

#[test]
fn ranges_scale_with_the_speed_of_sound_it_is_told() {
    let peak_m = |speed_of_sound_mmps: u32| {
        let mut device = device(NoiseLevel::None);
        let speed = Message::SetSpeedOfSound {
            speed_of_sound_mmps,
        };
        send(&mut device, &speed, ms(0));
        send(&mut device, &Message::OsPingParams(params(true)), ms(0));
        let sent = frames(&device.advance(ms(2_000)));
        // The strongest echo of all these pings is the same place for both speeds.
        let mut best = (f32::NEG_INFINITY, 0.0);
        for (_, bytes) in sent {
            let frame = Frame::from_bytes(&bytes).unwrap();
            if let Ok(Message::OsMonoProfile(profile)) = Message::parse(&frame) {
                let bin = profile
                    .pwr_results
                    .iter()
                    .position(|raw| raw == 65535)
                    .unwrap();
                if profile.max_pwr_db > best.0 {
                    best = (profile.max_pwr_db, (bin as f64 + 0.5) / 60.0);
                }
            }
        }
        best.1
    };
    let ratio = peak_m(1_425_000) / peak_m(1_500_000);
    assert!((ratio - 0.95).abs() < 0.006, "{ratio}");
}

#[test]
fn a_harsh_dive_changes_the_range_once_until_told_otherwise() {
    let mut device = device(NoiseLevel::Harsh);
    send(&mut device, &Message::OsPingParams(params(true)), ms(0));
    let length_mm = |sent: &[(u16, Vec<u8>)]| {
        let last = sent
            .iter()
            .rfind(|(id, _)| *id == id::OS_MONO_PROFILE)
            .unwrap();
        u32::from_le_bytes(last.1[16..20].try_into().unwrap())
    };
    assert_eq!(length_mm(&run_until(&mut device, ms(2_390))), 10_000);
    assert_eq!(length_mm(&run_until(&mut device, ms(2_500))), 12_000);
    send(&mut device, &Message::OsPingParams(params(true)), ms(2_500));
    assert_eq!(length_mm(&run_until(&mut device, ms(3_500))), 10_000);
}

#[test]
fn noise_and_floods_do_it_no_harm() {
    let mut device = device(NoiseLevel::None);
    device.receive(&[0x42, 0x52, 0xff, 0xff, 7, 7, 7], ms(0));
    let request = encoded(
        &Message::GeneralRequest {
            requested_id: id::DEVICE_INFORMATION,
        },
        0,
    )
    .unwrap();
    for _ in 0..20_000 {
        device.receive(&request, ms(0));
    }
    let counters = device.counters();
    assert!(counters.requests >= 19_999);
    assert!(counters.replies_dropped > 0 && counters.bytes_skipped > 0);
    let waiting = device.advance(ms(0));
    assert!(waiting.len() <= MAX_WAITING_REPLY_BYTES);
    assert!(ids(&waiting).iter().all(|&id| id == id::DEVICE_INFORMATION));
}
