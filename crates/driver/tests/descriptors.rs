//! Links that come and go leave nothing open. Alone in its binary: it counts the whole process's
//! file descriptors.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a helper of tests fails where they do")]

mod common;

use std::time::{Duration, Instant};

use common::{Scripted, connect, next, next_is, next_ping, serve_at};
use echosplat_driver::DriverEvent;
use echosplat_session::ClockSource;

/// By a named command many more: this is what runs with every change.
const UNPLUGS: u64 = 20;

fn open_descriptors() -> usize {
    std::fs::read_dir("/proc/self/fd").unwrap().count()
}

#[test]
fn a_link_unplugged_again_and_again_leaks_no_descriptor() {
    let directory = tempfile::tempdir().unwrap();
    let line = format!("serial://{}", directory.path().join("sonar").display());
    let first = serve_at("tcp://127.0.0.1:0", Scripted::new(0).0, 1.0);
    let tcp = first.url().to_owned();
    let _ = first.stop();
    for url in [tcp, line] {
        let mut server = serve_at(&url, Scripted::new(0).0, 1.0);
        let (driver, events) = connect(&url, ClockSource::Host);
        next_ping(&events);
        let mut longest = Duration::ZERO;
        let before = open_descriptors();
        for _ in 0..UNPLUGS {
            let _ = server.stop();
            next(&events, |event| {
                matches!(event, DriverEvent::LinkDown { .. }).then_some(())
            });
            server = serve_at(&url, Scripted::new(0).0, 1.0);
            let back = Instant::now();
            next_is(&events, &DriverEvent::LinkUp);
            next_ping(&events);
            longest = longest.max(back.elapsed());
        }
        // Asserted generously: other tests share the machine.
        println!("{url}: pings again {longest:?} after the device is back, at most");
        assert!(longest < Duration::from_secs(10));
        assert_eq!(open_descriptors(), before);
        let status = driver.stop();
        assert_eq!(
            (status.connects, status.disconnects),
            (UNPLUGS + 1, UNPLUGS)
        );
        let _ = server.stop();
    }
}
