//! How well a map foretells pings of its own dive that it has not seen: made between its pings, so
//! that none has to be kept from it.

use std::sync::Arc;
use std::time::Instant;

use echosplat_model::{Ping, Snapshot};
use echosplat_pose::PoseSource;
use echosplat_prediction::held_out::{HeldOut, Pair, score as score_pairs};
use echosplat_prediction::{MapRenderer, pair_of};
use echosplat_simulator::SimulatedSonar;

use echosplat_service::config::Config;
use echosplat_service::pipeline::Poses;

/// Pings scored, and as many of the map's own that the fit is made on.
const PINGS: usize = 400;

/// `None` where nothing was heard.
///
/// # Errors
/// If a setting of the poses is out of range.
pub(super) fn score(
    sonar: &SimulatedSonar,
    map: &Snapshot,
    config: &Config,
) -> anyhow::Result<Option<HeldOut>> {
    let stride = (sonar.dive().pings() / PINGS).max(1);
    let indices = || (0..sonar.dive().pings()).step_by(stride);
    let own = indices().filter_map(|index| sonar.ping(index).to_ping().ok());
    let unseen = indices().filter_map(|index| between(sonar, index));
    let fit = pairs(sonar, map, config, own)?;
    let held = pairs(sonar, map, config, unseen)?;
    Ok(score_pairs(&fit, &held))
}

/// A ping halfway to the next, with noise of its own; where the sonar rests while it listens, one
/// more from the same place.
fn between(sonar: &SimulatedSonar, index: usize) -> Option<Arc<Ping>> {
    let dive = sonar.dive();
    let later = match dive.view_of(index) {
        Some(_) => 0.0,
        None => 0.5,
    };
    let time_s = dive.transmit_s(index) + later * dive.ping_interval_s();
    let sequence = (dive.pings() + index) as u64;
    let ping = sonar.ping_at(sequence, time_s, &dive.settings_at(index));
    ping.to_ping().ok()
}

/// Each ping that has its pose, beside what the map says of it.
fn pairs(
    sonar: &SimulatedSonar,
    map: &Snapshot,
    config: &Config,
    pings: impl Iterator<Item = Arc<Ping>>,
) -> anyhow::Result<Vec<Pair>> {
    let mut renderer = MapRenderer::new(map.origin_m, map.intensity_unit, &map.gaussians);
    let source = PoseSource::File(sonar.dive().reported_poses().to_vec().into());
    let mut poses = Poses::waited_for(config, source)?;
    let mut pairs = Vec::new();
    for ping in pings {
        poses.push(ping, Instant::now());
        while let Some(joined) = poses.pop() {
            pairs.push(pair_of(&mut renderer, &joined.posed, &config.mapper));
        }
    }
    Ok(pairs)
}
