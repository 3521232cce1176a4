//! The simulator's device behind a real socket, at the far end of a driver.
#![allow(clippy::unwrap_used, reason = "a helper of tests fails where they do")]

mod common;

use std::sync::Arc;

use common::{config, next_ping, runtime};
use crossbeam_channel::bounded;
use echosplat_driver::{DriverConfig, ServeOptions, serve, spawn};
use echosplat_session::{ClockSource, SessionConfig};
use echosplat_simulator::{Dive, DiveKind, NoiseLevel, Scene, SimulatedDevice, SimulatedSonar};

#[test]
fn a_dive_arrives_as_it_was_simulated_ping_for_ping() {
    let scene = Arc::new(Scene::named("fence").unwrap());
    let noise = NoiseLevel::Nominal;
    let dive = Arc::new(Dive::plan(DiveKind::Survey, &scene, noise, 1).unwrap());
    let sonar = Arc::new(SimulatedSonar::new(scene, Arc::clone(&dive), noise, 1));
    let device = Box::new(SimulatedDevice::new(Arc::clone(&sonar)));
    let listen = "tcp://127.0.0.1:0".parse().unwrap();
    let server = serve(&listen, device, ServeOptions::default()).unwrap();
    let settings = dive.settings();
    let config = DriverConfig {
        session: SessionConfig {
            range_start_m: settings.range_start_m,
            range_length_m: settings.range_length_m,
            ping_interval_ms: (1e3 * dive.ping_interval_s()).round() as u32,
            bin_count: u16::try_from(settings.bin_count).unwrap(),
            clock: ClockSource::Device,
            ..SessionConfig::default()
        },
        ..config(server.url(), ClockSource::Device)
    };
    let (sender, events) = bounded(64);
    let driver = spawn(runtime(), config, None, sender).unwrap();
    for index in 0..100 {
        let ping = next_ping(&events);
        let simulated = sonar.ping(index);
        assert_eq!(ping.sequence(), index as u64);
        let time_s = dive.transmit_s(index);
        assert!((ping.transmit_time().as_secs_f64() - time_s).abs() < 1e-3);
        assert_eq!(ping.settings().bin_count, simulated.intensity.len());
        let strongest = simulated.intensity.iter().copied().fold(0.0, f32::max);
        for (received, sent) in ping.intensity().iter().zip(&simulated.intensity) {
            // One step of 16 bits over the scale, which has less than 200 dB.
            let is_near = (received - sent).abs() <= 1e-3 * sent + 1e-9 * strongest;
            assert!(is_near, "{received} for {sent}");
        }
    }
    assert!(driver.stop().stop_sent);
    let _ = server.stop();
}
