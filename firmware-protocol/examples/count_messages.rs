//! Which messages are in a log, and how many bytes are in none:
//! `cargo run --release -p echosplat-firmware-protocol --example count_messages -- examples/sample-dive/dive.svlog`.

use std::collections::BTreeMap;
use std::io::Write;

use echosplat_firmware_protocol::{Decoder, Event};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let log = std::env::args().nth(1).ok_or("give a log")?;
    let (mut counts, mut skipped) = (BTreeMap::new(), 0);
    let mut sink = |event: Event<'_>| match event {
        Event::Frame(frame) => *counts.entry(frame.message_id()).or_insert(0) += 1,
        Event::Skipped(bytes) => skipped += bytes.byte_count,
    };
    let mut decoder = Decoder::new();
    decoder.feed(&std::fs::read(log)?, &mut sink);
    decoder.finish(&mut sink);
    let said = format!("messages by id: {counts:?}, bytes skipped: {skipped}");
    Ok(writeln!(std::io::stdout(), "{said}")?)
}
