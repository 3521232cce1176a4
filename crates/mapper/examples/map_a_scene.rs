//! A simulated minute past the fence becomes a map: `cargo run --release -p echosplat-mapper --example map_a_scene`.
//! [`map_a_log`](map_a_log.rs) does it with a recorded dive.

use std::io::Write;
use std::sync::Arc;

use echosplat_mapper::{Mapper, MapperConfig};
use echosplat_simulator::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene, SimulatedSonar};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (scene, noise, seed) = (Arc::new(Scene::named("fence")?), NoiseLevel::Nominal, 1);
    let minute = DiveOptions {
        duration_s: 60.0,
        ..DiveOptions::default()
    };
    let dive = Dive::plan_with(DiveKind::Survey, &scene, noise, seed, &minute)?;
    let dive = Arc::new(dive);
    let sonar = SimulatedSonar::new(scene, dive.clone(), noise, seed);
    let mut mapper = Mapper::new(MapperConfig::default())?;
    let trajectory = dive.trajectory(0.5);
    for ping in (0..dive.pings()).filter_map(|index| sonar.posed_ping(index, &trajectory)) {
        mapper.insert(&ping);
    }
    let map = mapper.finish();
    Ok(writeln!(
        std::io::stdout(),
        "{} Gaussians",
        map.gaussians.len()
    )?)
}
