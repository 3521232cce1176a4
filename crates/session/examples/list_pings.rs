//! The pings of a log, checked and on one clock, without a socket:
//! `cargo run --release -p echosplat-session --example list_pings -- examples/sample-dive/dive.svlog`.

use std::io::Write;

use echosplat_model::Timestamp;
use echosplat_session::{Session, SessionConfig, SessionEvent};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let log = std::env::args().nth(1).ok_or("give a log")?;
    let mut session = Session::listening(SessionConfig::default(), Timestamp::ZERO);
    let mut out = std::io::stdout().lock();
    for piece in std::fs::read(log)?.chunks(4096) {
        session.receive(piece, Timestamp::ZERO);
        while let Some(event) = session.poll_event() {
            if let SessionEvent::Ping { ping, .. } = event {
                let (bins, end_m) = (ping.intensity().len(), ping.settings().range_end_m());
                writeln!(out, "ping {}: {bins} bins to {end_m:.1} m", ping.sequence())?;
            }
        }
    }
    Ok(writeln!(out, "{:?}", session.counters())?)
}
