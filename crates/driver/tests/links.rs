//! Drivers and served devices over real sockets, pseudo-terminals and files.
#![allow(clippy::unwrap_used, reason = "a helper of tests fails where they do")]

mod common;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use common::{
    PATIENCE, Scripted, append, config, connect, next, next_is, next_ping, profile, runtime,
    serve_at, wait_until,
};
use crossbeam_channel::bounded;
use echosplat_driver::{
    DriverConfig, DriverError, DriverEvent, LinkState, ListenUrl, ServeError, ServeOptions,
    TapeItem, Tapped, serve, spawn, spawn_tape,
};
use echosplat_firmware_protocol::{Decoder, Event, Message, OsPingParams, Text, id};
use echosplat_model::Timestamp;
use echosplat_session::ClockSource;

/// Identify, configure, stream, stop: the same over every transport.
fn whole_conversation(listen: &str) {
    let (device, enables) = Scripted::new(0);
    let server = serve_at(listen, device, 1.0);
    let (driver, events) = connect(server.url(), ClockSource::Host);
    let device_type = next(&events, |event| match event {
        DriverEvent::Identified(information) => Some(information.device_type),
        _ => None,
    });
    assert_eq!(device_type, 104);
    next_is(&events, &DriverEvent::Configured);
    let first = next_ping(&events);
    let next_nine: Vec<_> = (0..9).map(|_| next_ping(&events)).collect();
    assert!(next_nine[8].sequence() >= first.sequence() + 9);
    assert!((first.settings().range_length_m - 3.0).abs() < 1e-9);
    let status = driver.stop();
    assert_eq!(status.link, LinkState::Stopped);
    assert!(status.stop_sent && status.connects == 1 && status.pings_sent >= 10);
    wait_until("the device is told to stop", || {
        enables.lock().unwrap().last() == Some(&false)
    });
    wait_until("it stops", || !server.status().is_pinging);
    assert_eq!(enables.lock().unwrap().first(), Some(&true));
    let _ = server.stop();
}

#[test]
fn over_tcp() {
    whole_conversation("tcp://127.0.0.1:0");
}

#[test]
fn over_udp() {
    whole_conversation("udp://127.0.0.1:0");
}

#[cfg(unix)]
#[test]
fn over_a_pseudo_terminal() {
    whole_conversation("serial://pty");
}

#[cfg(unix)]
#[test]
fn a_pseudo_terminal_is_linked_to_while_it_is_served_and_replaces_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("sonar");
    let url = format!("serial://{}", link.display());
    whole_conversation(&url);
    assert!(link.symlink_metadata().is_err());

    std::fs::write(&link, "precious").unwrap();
    let listen: ListenUrl = url.parse().unwrap();
    let refused = serve(&listen, Scripted::new(0).0, ServeOptions::default());
    assert!(matches!(refused, Err(ServeError::Listen { .. })));
    assert_eq!(std::fs::read_to_string(&link).unwrap(), "precious");
}

#[test]
fn a_server_that_dies_and_comes_back_is_found_again() {
    let (device, _) = Scripted::new(0);
    let server = serve_at("tcp://127.0.0.1:0", device, 1.0);
    let url = server.url().to_owned();
    let (driver, events) = connect(&url, ClockSource::Host);
    next_ping(&events);
    let _ = server.stop();
    next(&events, |event| {
        matches!(event, DriverEvent::LinkDown { .. }).then_some(())
    });
    assert_eq!(driver.status().link, LinkState::Down);
    let (device, enables) = Scripted::new(0);
    let server = serve_at(&url, device, 1.0);
    next_is(&events, &DriverEvent::LinkUp);
    next_is(&events, &DriverEvent::Configured);
    next_ping(&events);
    let status = driver.stop();
    assert_eq!((status.connects, status.disconnects), (2, 1));
    assert!(status.reason.is_some());
    wait_until("the second device is told to stop", || {
        enables.lock().unwrap().last() == Some(&false)
    });
    let _ = server.stop();
}

#[test]
fn a_link_that_never_was_is_said_once_and_tried_until_stopped() {
    let (driver, events) = connect("tcp://127.0.0.1:1", ClockSource::Host);
    next(&events, |event| {
        matches!(event, DriverEvent::LinkDown { .. }).then_some(())
    });
    let status = driver.stop();
    assert_eq!((status.connects, status.stop_sent), (0, false));
    assert!(
        events
            .try_iter()
            .all(|event| !matches!(event, DriverEvent::LinkDown { .. }))
    );
}

#[test]
fn on_the_device_clock_the_driver_waits_for_room_and_nothing_is_lost() {
    let (device, _) = Scripted::new(2_000);
    let server = serve_at("tcp://127.0.0.1:0", device, 0.0);
    let (sender, events) = bounded(2);
    let bytes = Arc::new(Mutex::new((0, 0)));
    let tapped = Arc::clone(&bytes);
    let tap = Box::new(move |_: Timestamp, shown: Tapped<'_>| {
        let Tapped::Bytes(bytes) = shown else { return };
        let mut sum = tapped.lock().unwrap();
        *sum = (sum.0 + 1, sum.1 + bytes.len() as u64);
    });
    let config = config(server.url(), ClockSource::Device);
    let driver = spawn(runtime(), config, Some(tap), sender).unwrap();
    for sequence in 0..2_000 {
        let ping = next_ping(&events);
        assert_eq!(ping.sequence(), sequence);
        let millis = i64::try_from(sequence).unwrap() * common::INTERVAL_MS;
        assert_eq!(ping.transmit_time(), Timestamp::from_millis(millis));
    }
    let status = driver.stop();
    assert_eq!((status.pings_sent, status.pings_dropped), (2_000, 0));
    assert_eq!(bytes.lock().unwrap().1, status.session.bytes_received);
    let served = server.stop();
    assert!(served.is_finished && served.pings == 2_000);
    assert_eq!(served.frames_dropped, 0);
}

#[test]
fn on_the_hosts_clock_what_finds_no_room_is_dropped_and_counted() {
    let (device, _) = Scripted::new(0);
    let server = serve_at("tcp://127.0.0.1:0", device, 0.0);
    let (sender, events) = bounded(10);
    let driver = spawn(
        runtime(),
        config(server.url(), ClockSource::Host),
        None,
        sender,
    )
    .unwrap();
    wait_until("some are dropped", || driver.status().pings_dropped >= 300);
    drop(events);
    wait_until("the driver ends as nobody listens", || driver.is_finished());
    let status = driver.stop();
    assert!(status.stop_sent && status.pings_sent <= 10);
    assert!(status.pings_sent + status.pings_dropped <= status.session.pings);
    let _ = server.stop();
}

#[test]
fn a_port_in_use_is_named() {
    let server = serve_at("tcp://127.0.0.1:0", Scripted::new(0).0, 1.0);
    let listen: ListenUrl = server.url().parse().unwrap();
    let error = serve(&listen, Scripted::new(0).0, ServeOptions::default()).unwrap_err();
    assert!(matches!(error, ServeError::InUse { .. }));
    assert!(error.to_string().contains(server.url()));
    let _ = server.stop();
}

/// A client that is no driver: sends settings, then reads or does not.
fn bare_client(url: &str, bin_count: u16) -> TcpStream {
    let mut stream = TcpStream::connect(url.trim_start_matches("tcp://")).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut request = Vec::new();
    let settings = OsPingParams {
        start_mm: 0,
        length_mm: 3_000,
        msec_per_ping: 0,
        pulse_len_percent: 0.002,
        filter_duration_percent: 0.0015,
        gain_index: -1,
        num_results: bin_count,
        enable: true,
    };
    append(&Message::OsPingParams(settings), &mut request);
    stream.write_all(&request).unwrap();
    stream
}

/// Ping numbers of the next profiles, `count` at least.
fn numbers(stream: &mut TcpStream, decoder: &mut Decoder, count: usize) -> Vec<u32> {
    let mut numbers = Vec::new();
    let mut buffer = [0; 65_536];
    while numbers.len() < count {
        let byte_count = stream.read(&mut buffer).unwrap();
        assert!(byte_count > 0);
        decoder.feed(&buffer[..byte_count], &mut |event| match event {
            Event::Frame(frame) if frame.message_id() == id::OS_MONO_PROFILE => {
                let number = frame.payload().first_chunk().unwrap();
                numbers.push(u32::from_le_bytes(*number));
            }
            Event::Frame(_) => {}
            Event::Skipped(skipped) => panic!("{skipped:?}"),
        });
    }
    numbers
}

#[test]
fn every_client_hears_everything_but_one_that_does_not_listen_loses_whole_frames() {
    let (device, _) = Scripted::new(0);
    let server = serve_at("tcp://127.0.0.1:0", device, 1_000.0);
    let mut deaf = bare_client(server.url(), 1_200);
    let mut good = bare_client(server.url(), 1_200);
    let mut decoder = Decoder::new();
    let mut before: Option<u32> = None;
    let deadline = Instant::now() + PATIENCE;
    while server.status().frames_dropped == 0 {
        assert!(Instant::now() < deadline);
        for number in numbers(&mut good, &mut decoder, 1) {
            assert!(before.is_none_or(|before| number == before + 1));
            before = Some(number);
        }
    }
    assert_eq!(server.status().clients, 2);
    // What the deaf one finds when it listens after all are whole frames.
    let heard = numbers(&mut deaf, &mut Decoder::new(), 100);
    assert!(heard.is_sorted());
    drop((deaf, good));
    wait_until("both are forgotten", || server.status().clients == 0);
    let _ = server.stop();
}

#[test]
fn a_log_is_read_to_its_end_with_its_own_time() {
    let mut log = Vec::new();
    let json = r#"{"session_id": 1, "timestamp": "1970-01-01T00:01:40Z"}"#;
    append(&Message::Json(Text::from(json)), &mut log);
    for number in 0..200 {
        profile(number, 5_000 + 20 * number, 3_000, 200, &mut log);
    }
    log.truncate(log.len() - 1);
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), &log).unwrap();
    // 200 pings take 4 s; at 400 times that, 10 ms.
    for rate in [0.0, 400.0] {
        let url = format!("file://{}", file.path().display());
        let config = DriverConfig {
            rate,
            ..config(&url, ClockSource::Host)
        };
        let (sender, events) = bounded(5);
        let driver = spawn(runtime(), config, None, sender).unwrap();
        let mut pings = 0;
        next(&events, |event| match event {
            DriverEvent::Ping { ping, .. } => {
                let time_s = 100.0 + 0.02 * f64::from(pings);
                assert!((ping.transmit_time().as_secs_f64() - time_s).abs() < 1e-9);
                pings += 1;
                None
            }
            DriverEvent::Ended => Some(()),
            _ => None,
        });
        assert_eq!(pings, 199);
        let status = driver.stop();
        assert_eq!(
            (status.link, status.session.frames_bad),
            (LinkState::Ended, 1)
        );
        assert!(!status.stop_sent);
    }
}

#[test]
fn what_cannot_be_driven_is_refused_at_once() {
    let (sender, _events) = bounded(1);
    let refused = |url: &str| {
        let config = config(url, ClockSource::Host);
        spawn(runtime(), config, None, sender.clone()).unwrap_err()
    };
    assert!(matches!(
        refused("sim://fence"),
        DriverError::Simulated { .. }
    ));
    let missing = refused("file:///nowhere/dive.svlog").to_string();
    assert!(missing.contains("/nowhere/dive.svlog"));
    let mut odd = config("tcp://127.0.0.1:1", ClockSource::Host);
    odd.session.bin_count = 7;
    let error = spawn(runtime(), odd, None, sender.clone())
        .unwrap_err()
        .to_string();
    assert!(error.contains("bin_count") && error.contains("200 to 1200"));
}

#[test]
fn a_tape_of_a_dive_with_faults_gives_the_same_pings_again() {
    let (sender, events) = bounded(10_000);
    let tape = Arc::new(Mutex::new(Vec::new()));
    let taped = Arc::clone(&tape);
    let tap = Box::new(move |time: Timestamp, shown: Tapped<'_>| {
        let item = TapeItem::of(shown).map(|item| (time, item));
        taped.lock().unwrap().extend(item);
    });
    let first = serve_at("tcp://127.0.0.1:0", Scripted::new(0).0, 5.0);
    let url = first.url().to_owned();
    let driver = spawn(
        runtime(),
        config(&url, ClockSource::Host),
        Some(tap),
        sender,
    )
    .unwrap();
    let mut live = Vec::new();
    let mut server = Some(first);
    for _ in 0..3 {
        for _ in 0..30 {
            live.push(next_ping(&events));
        }
        if let Some(server) = server.take() {
            let _ = server.stop();
        }
        next(&events, |event| match event {
            DriverEvent::Ping { ping, .. } => {
                live.push(ping);
                None
            }
            DriverEvent::LinkDown { .. } => Some(()),
            _ => None,
        });
        server = Some(serve_at(&url, Scripted::new(0).0, 5.0));
    }
    let status = driver.stop();
    live.extend(events.try_iter().filter_map(|event| match event {
        DriverEvent::Ping { ping, .. } => Some(ping),
        _ => None,
    }));
    let tape = std::mem::take(&mut *tape.lock().unwrap());
    let links = tape.iter().filter(|(_, item)| *item == TapeItem::LinkDown);
    assert_eq!(links.count(), 3);
    assert_eq!(live.len() as u64, status.session.pings);
    for rate in [0.0, 50.0] {
        let config = DriverConfig {
            rate,
            ..config("file://dive.mcap", ClockSource::Host)
        };
        let (sender, events) = bounded(3);
        let items = tape.clone().into_iter().map(Ok);
        let driver = spawn_tape(&config, Box::new(items), None, sender).unwrap();
        let mut again = Vec::new();
        next(&events, |event| match event {
            DriverEvent::Ping { ping, .. } => {
                again.push(ping);
                None
            }
            DriverEvent::Ended => Some(()),
            _ => None,
        });
        assert!(again == live, "{} of {}", again.len(), live.len());
        let replayed = driver.stop();
        assert_eq!(replayed.link, LinkState::Ended);
        assert_eq!(
            replayed.session.profiles_rejected,
            status.session.profiles_rejected
        );
    }
    drop(server);
}

#[test]
fn a_tape_that_breaks_off_says_so_and_ends() {
    let mut bytes = Vec::new();
    profile(7, 100, 3_000, 200, &mut bytes);
    let tape = vec![
        Ok((Timestamp::ZERO, TapeItem::LinkUp)),
        Ok((Timestamp::ZERO, TapeItem::Bytes(bytes.into()))),
        Err("it is cut at byte 99".to_owned()),
    ];
    let (sender, events) = bounded(10);
    let config = config("file://dive.mcap", ClockSource::Device);
    let driver = spawn_tape(&config, Box::new(tape.into_iter()), None, sender).unwrap();
    assert_eq!(next_ping(&events).sequence(), 7);
    let words = next(&events, |event| match event {
        DriverEvent::Warning(text) => Some(text),
        _ => None,
    });
    assert!(words.contains("cut at byte 99"), "{words}");
    next_is(&events, &DriverEvent::Ended);
    let _ = driver.stop();
}

#[test]
fn one_that_accepts_and_closes_is_asked_ever_more_slowly() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("tcp://{}", listener.local_addr().unwrap());
    let mut config = config(&url, ClockSource::Host);
    // Doubled from 10 ms: by the eighth attempt 1.27 s have passed.
    (config.reconnect_min_s, config.reconnect_max_s) = (0.01, 60.0);
    let (sender, _events) = bounded(1_000);
    let begin = Instant::now();
    let driver = spawn(runtime(), config, None, sender).unwrap();
    for _ in 0..8 {
        drop(listener.accept().unwrap());
    }
    assert!(begin.elapsed() > Duration::from_millis(1_200));
    let status = driver.stop();
    assert_eq!(status.since_frame_s, None);
    assert!(status.connects >= 7 && status.disconnects >= 7);
}

#[test]
fn what_comes_and_what_does_not_is_told_by_ages_and_words() {
    let server = serve_at("tcp://127.0.0.1:0", Scripted::new(0).0, 1.0);
    let (driver, events) = connect(server.url(), ClockSource::Host);
    next_ping(&events);
    let status = driver.status();
    for age_s in [
        status.since_byte_s,
        status.since_frame_s,
        status.since_profile_s,
        status.since_ping_s,
    ] {
        assert!(age_s.is_some_and(|age_s| (0.0..20.0).contains(&age_s)));
    }
    let _ = driver.stop();
    let _ = server.stop();

    // Noise: bytes, but no frame. Then a profile that no sonar makes.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("tcp://{}", listener.local_addr().unwrap());
    let (driver, _events) = connect(&url, ClockSource::Host);
    let (mut stream, _) = listener.accept().unwrap();
    stream.write_all(&[0x55; 500]).unwrap();
    wait_until("noise is received", || {
        driver.status().since_byte_s.is_some()
    });
    assert_eq!(driver.status().since_frame_s, None);
    let mut frame = Vec::new();
    profile(1, 10, 0, 200, &mut frame);
    stream.write_all(&frame).unwrap();
    wait_until("the profile is refused", || {
        driver.status().first_refusal.is_some()
    });
    let status = driver.status();
    assert!(status.since_profile_s.is_some() && status.since_ping_s.is_none());
    let words = status.first_refusal.unwrap();
    assert_eq!(words, "length of range 0 m; allowed is 0.01 to 300 m");
    drop(stream);
    let _ = driver.stop();
}

#[cfg(unix)]
#[test]
fn paths_that_are_no_line_and_no_log_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo");
    assert!(
        std::process::Command::new("mkfifo")
            .arg(&fifo)
            .status()
            .unwrap()
            .success()
    );
    let file = folder.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let (sender, _events) = bounded(1);
    let refused = |url: String| {
        let config = config(&url, ClockSource::Host);
        spawn(runtime(), config, None, sender.clone())
            .unwrap_err()
            .to_string()
    };
    for (path, what) in [
        (file.as_path(), "a file"),
        (folder.path(), "a directory"),
        (fifo.as_path(), "a fifo"),
    ] {
        let words = refused(format!("serial://{}", path.display()));
        assert!(
            words.contains(what) && words.contains("/dev/ttyUSB0"),
            "{words}"
        );
    }
    let words = refused(format!("file://{}", fifo.display()));
    assert!(words.contains("no file"), "{words}");
}
