//! A subscriber that no longer reads what it is sent.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use crate::MapPublisher;

/// Passes bytes on between a listening session and one that connects, until it is frozen: then
/// both its sockets stay open, and nobody reads.
struct Proxy {
    port: u16,
    frozen: Arc<AtomicBool>,
}

impl Proxy {
    fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let proxy = Self {
            port: listener.local_addr().unwrap().port(),
            frozen: Arc::default(),
        };
        let frozen = Arc::clone(&proxy.frozen);
        std::thread::spawn(move || {
            let (near, _) = listener.accept().unwrap();
            let far = TcpStream::connect(("127.0.0.1", port)).unwrap();
            let ends = (near.try_clone().unwrap(), far.try_clone().unwrap());
            let back = Arc::clone(&frozen);
            std::thread::spawn(move || pass(ends.1, ends.0, &back));
            pass(near, far, &frozen);
        });
        proxy
    }
}

/// Until the end, or until it is frozen and then for as long as the test's process lives.
fn pass(mut from: TcpStream, mut to: TcpStream, frozen: &AtomicBool) {
    let mut bytes = vec![0; 65_536];
    loop {
        while frozen.load(Ordering::Relaxed) {
            std::thread::park();
        }
        match from.read(&mut bytes) {
            Ok(count) if count > 0 && to.write_all(&bytes[..count]).is_ok() => {}
            _ => return,
        }
    }
}

/// Resident memory of this process in kibibytes, where the system tells.
fn resident_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Offers pings, a hundred times as fast as a sonar does, and maps between them; the longest that
/// 99.9 % of these took both together, and the longest of all.
fn burst(sender: &Bus, publisher: &MapPublisher, count: u64) -> [Duration; 2] {
    let rounds: Vec<_> = (0..20).map(round).collect();
    let mut took = Vec::new();
    for (n, map) in (0..count).zip(rounds.iter().cycle()) {
        let begin = Instant::now();
        sender.publish_ping(vec![7; 1262].into(), Timestamp::from_millis(n as i64));
        publisher.offer(Arc::clone(map));
        took.push(begin.elapsed());
        std::thread::sleep(Duration::from_micros(200));
    }
    took.sort_unstable();
    [took[took.len() * 999 / 1000], took[took.len() - 1]]
}

#[test]
fn a_frozen_subscriber_costs_pings_and_deltas_that_are_counted_and_no_waiting() {
    const BURST: u64 = 8000;
    let port = free_port();
    let here = format!("['tcp/127.0.0.1:{port}']");
    let sender = Bus::open(config("[]", &here)).unwrap();
    let proxy = Proxy::to(port);
    let through = format!("['tcp/127.0.0.1:{}']", proxy.port);
    let receiver = Bus::open(config(&through, "[]")).unwrap();
    let pings = receiver.subscribe_pings().unwrap();
    let map = receiver.subscribe_map().unwrap();
    let publisher = sender.publish_map().unwrap();
    publisher.offer(round(0));
    let mut offered = 0;
    until("pings arrive", || {
        sender.publish_ping(vec![1].into(), Timestamp::ZERO);
        offered += 1;
        pings.next_within(Duration::from_millis(50)).is_some()
    });
    until("the map arrives", || map.gaussian_count() > 0);
    let unhindered = burst(&sender, &publisher, BURST);
    println!("calls while it reads: 99.9 % within, and all within {unhindered:?}");
    proxy.frozen.store(true, Ordering::Relaxed);

    let resident = resident_kib();
    let hindered = burst(&sender, &publisher, BURST);
    let grown = resident_kib().zip(resident);
    let grown = grown.map(|(now, then)| now.saturating_sub(then));
    println!("calls while it does not: {hindered:?}; memory grown by {grown:?} KiB");
    until("every ping is accounted for", || {
        let counters = sender.counters();
        let told = counters.pings_sent + counters.pings_dropped + counters.pings_failed;
        told == offered + 2 * BURST
    });
    let counters = publisher.counters();
    assert!(counters.snapshots_replaced > 0, "{counters:?}");
    assert_eq!(counters.messages_failed, 0);
}
