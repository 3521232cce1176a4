//! UDP: what gets lost, doubled and disordered on the way, and who else sends. Every profile is
//! accounted for at every moment.
#![allow(clippy::unwrap_used, reason = "a helper of tests fails where they do")]

mod common;

use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use common::{Scripted, config, next_ping, profile, runtime, serve_at, wait_until};
use crossbeam_channel::bounded;
use echosplat_driver::{DriverEvent, DriverStatus, spawn};
use echosplat_session::ClockSource;

/// What a proxy does to the datagrams of the device.
#[derive(Debug, Clone, Copy)]
struct Weather {
    loss: f64,
    doubled: f64,
    /// A datagram may be overtaken by so many.
    depth: usize,
    seed: u64,
}

/// Between a driver and a device: passes requests on as they are, answers as the weather is.
struct Proxy {
    url: String,
    is_over: Arc<AtomicBool>,
    /// Profiles passed on, doubles counted twice.
    passed: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Proxy {
    fn before(device: &str, weather: Weather) -> Self {
        let here = UdpSocket::bind("127.0.0.1:0").unwrap();
        let there = UdpSocket::bind("127.0.0.1:0").unwrap();
        there.connect(device.trim_start_matches("udp://")).unwrap();
        for socket in [&here, &there] {
            socket
                .set_read_timeout(Some(Duration::from_millis(1)))
                .unwrap();
        }
        let url = format!("udp://{}", here.local_addr().unwrap());
        let is_over = Arc::new(AtomicBool::new(false));
        let passed = Arc::new(AtomicU64::new(0));
        let (over, count) = (Arc::clone(&is_over), Arc::clone(&passed));
        let thread = std::thread::spawn(move || carry(&here, &there, weather, &over, &count));
        Self {
            url,
            is_over,
            passed,
            thread: Some(thread),
        }
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// Uniform in 0 to 1, the same on every run.
fn uniform(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 11) as f64 / (1_u64 << 53) as f64
}

fn carry(
    here: &UdpSocket,
    there: &UdpSocket,
    weather: Weather,
    is_over: &AtomicBool,
    passed: &AtomicU64,
) {
    there.set_nonblocking(true).unwrap();
    let mut state = weather.seed | 1;
    let mut client: Option<SocketAddr> = None;
    let mut waiting: Vec<Vec<u8>> = Vec::new();
    let mut buffer = vec![0; 65_536];
    while !is_over.load(Ordering::Relaxed) {
        if let Ok((byte_count, from)) = here.recv_from(&mut buffer) {
            client = Some(from);
            there.send(&buffer[..byte_count]).unwrap();
        }
        let Some(client) = client else { continue };
        while let Ok(byte_count) = there.recv(&mut buffer) {
            let datagram = &buffer[..byte_count];
            let is_profile = byte_count > 100;
            if !is_profile {
                here.send_to(datagram, client).unwrap();
                continue;
            }
            if uniform(&mut state) < weather.loss {
                continue;
            }
            waiting.push(datagram.to_vec());
            if uniform(&mut state) < weather.doubled {
                waiting.push(datagram.to_vec());
            }
            while waiting.len() > weather.depth {
                // Whichever waits is next, the oldest more often than the others.
                let any = (uniform(&mut state) * waiting.len() as f64) as usize;
                let next = if uniform(&mut state) < 0.3 { 0 } else { any };
                // First the count, so that it is never less than what was received.
                passed.fetch_add(1, Ordering::Relaxed);
                here.send_to(&waiting.remove(next), client).unwrap();
            }
        }
    }
}

/// Every profile is a ping, left out for a reason, or held; every ping is sent or dropped. One
/// ping may be on its way to the channel.
fn assert_balanced(status: &DriverStatus, weather: &impl std::fmt::Debug) {
    let session = &status.session;
    let held = session.profiles - session.pings - session.profiles_rejected.total();
    assert!(held <= 1, "{weather:?}: {status:?}");
    let on_its_way = session
        .pings
        .checked_sub(status.pings_sent + status.pings_dropped);
    let is_little = on_its_way.is_some_and(|pings| pings <= 2);
    assert!(is_little, "{weather:?}: {status:?}");
}

#[test]
fn the_ledger_balances_in_any_weather() {
    let mut seed = 1;
    for loss in [0.0, 0.1, 0.3, 0.5] {
        for (doubled, depth) in [(0.0, 0), (0.2, 8)] {
            seed += 1;
            let weather = Weather {
                loss,
                doubled,
                depth,
                seed,
            };
            let server = serve_at("udp://127.0.0.1:0", Scripted::new(0).0, 10.0);
            let proxy = Proxy::before(server.url(), weather);
            let (sender, events) = bounded(20_000);
            let driver = spawn(
                runtime(),
                config(&proxy.url, ClockSource::Device),
                None,
                sender,
            )
            .unwrap();
            let mut seen = std::collections::BTreeSet::new();
            let mut newest = 0;
            for _ in 0..300 {
                let ping = next_ping(&events);
                assert!(seen.insert(ping.sequence()), "{weather:?}: twice");
                // Its own time, whenever it came.
                let millis = ping.sequence() as i64 * common::INTERVAL_MS;
                assert_eq!(ping.transmit_time().nanos(), millis * 1_000_000);
                newest = ping.sequence().max(newest);
                assert_balanced(&driver.status(), &weather);
            }
            let status = driver.stop();
            assert_balanced(&status, &weather);
            let in_channel = events.try_iter();
            let waiting = in_channel.filter(|e| matches!(e, DriverEvent::Ping { .. }));
            assert_eq!(status.pings_sent, 300 + waiting.count() as u64);
            assert_eq!(
                status.session.pings,
                status.pings_sent + status.pings_dropped
            );
            let rejected = status.session.profiles_rejected;
            assert_eq!(
                (rejected.late, rejected.unconfirmed, status.session.reboots),
                (0, 0, 0),
                "{weather:?}: {rejected:?}"
            );
            assert!(depth == 0 || status.session.pings_late > 0, "{weather:?}");
            assert!(doubled > 0.0 || rejected.duplicate == 0, "{weather:?}");
            assert!(status.session.profiles <= proxy.passed.load(Ordering::Relaxed));
            drop(proxy);
            let _ = server.stop();
        }
    }
}

#[test]
fn nobody_but_the_device_is_heard_or_answered() {
    let server = serve_at("udp://127.0.0.1:0", Scripted::new(0).0, 1.0);
    let weather = Weather {
        loss: 0.0,
        doubled: 0.0,
        depth: 0,
        seed: 1,
    };
    let (sender, events) = bounded(20_000);
    // Through a proxy only to learn at which address the driver listens.
    let spy = UdpSocket::bind("127.0.0.1:0").unwrap();
    let there = UdpSocket::bind("127.0.0.1:0").unwrap();
    there
        .connect(server.url().trim_start_matches("udp://"))
        .unwrap();
    let url = format!("udp://{}", spy.local_addr().unwrap());
    let driver = spawn(runtime(), config(&url, ClockSource::Host), None, sender).unwrap();
    let mut buffer = vec![0; 65_536];
    let (byte_count, victim) = spy.recv_from(&mut buffer).unwrap();
    there.send(&buffer[..byte_count]).unwrap();
    let is_over = Arc::new(AtomicBool::new(false));
    let (over, count) = (Arc::clone(&is_over), Arc::new(AtomicU64::new(0)));
    for socket in [&spy, &there] {
        socket
            .set_read_timeout(Some(Duration::from_millis(1)))
            .unwrap();
    }
    let carrying = std::thread::spawn(move || carry(&spy, &there, weather, &over, &count));
    next_ping(&events);

    // A stranger sends floods, forged profiles and forged refusals; nothing of it is heard.
    let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
    stranger
        .set_read_timeout(Some(Duration::from_millis(1)))
        .unwrap();
    let mut forged = Vec::new();
    profile(4_000_000, 77, 9_000, 400, &mut forged);
    let before = driver.status().session;
    let mut pings = 0_u64;
    while pings < 50 {
        for _ in 0..100 {
            stranger.send_to(&forged, victim).unwrap();
            stranger.send_to(&[0x42; 1_400], victim).unwrap();
        }
        let ping = next_ping(&events);
        assert!((ping.settings().range_length_m - 3.0).abs() < 1e-9);
        pings += 1 + events
            .try_iter()
            .filter(|event| matches!(event, DriverEvent::Ping { .. }))
            .count() as u64;
    }
    let status = driver.status();
    assert_eq!(status.session.bytes_skipped, before.bytes_skipped);
    assert_eq!(status.session.profiles_rejected.total(), 0);
    assert_eq!(status.session.pings_missing, 0);
    let answered = stranger.recv_from(&mut buffer);
    assert!(answered.is_err(), "{answered:?}");
    wait_until("still at it", || {
        driver.status().session.pings > status.session.pings
    });
    let _ = driver.stop();
    is_over.store(true, Ordering::Relaxed);
    carrying.join().unwrap();
    let _ = server.stop();
}
