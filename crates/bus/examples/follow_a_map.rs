//! Follows the map of a service on this machine until its dive ends: begin
//! `cargo run --release -p echosplat-bus --example follow_a_map`, then `echosplat demo`.

use std::io::Write;
use std::time::Duration;

use echosplat_bus::{Bus, BusConfig};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bus = Bus::open(BusConfig::default())?;
    let map = bus.subscribe_map()?;
    let mut known = None;
    while !map.is_final() {
        known = map.wait_beyond(known, Duration::from_secs(60));
        known.ok_or("no map for a minute")?;
        writeln!(std::io::stdout(), "{} Gaussians", map.gaussian_count())?;
    }
    drop(map);
    Ok(bus.close()?)
}
