//! What a configuration may cost in memory, before anything is allocated.
//!
//! A bound, not a forecast: every queue and store full. The map itself grows with the surface that
//! is seen and is not in it, but for what one ping can light.

use echosplat_model::{Gaussian, Ping, StampedPose};

use super::errors::BadSetting;
use super::{Config, keys};

/// The most that all settings together may ask for; half of what small companion computers have.
const MOST_BYTES: f64 = (2_u64 << 30) as f64;

/// A ping that is remembered: the mapper's 400 bytes, and per bin two powers of a byte each and two
/// bits of state.
const REMEMBERED_BYTES: f64 = 400.0;
const REMEMBERED_BYTES_PER_BIN: f64 = 2.25;
/// A frame's header, its queue's place, and what an allocator adds.
const FRAME_BYTES: f64 = 256.0;
/// A Gaussian of a subscriber, in the map and in what waits to come in: itself and its index.
const HELD_GAUSSIAN_BYTES: f64 = 2.0 * (size_of::<Gaussian>() + 32) as f64;
/// Messages in parts that zenoh puts together at a time: eight priorities, reliable or not.
const MESSAGES_AT_A_TIME: f64 = 16.0;

/// Voxels along the edge of a block of evidence, and what a block takes that was seen from two sides.
const BLOCK_EDGE: f64 = 8.0;
const BLOCK_BYTES: f64 = 2.0 * 1024.0 + 256.0;
/// Echoes at the far end of a ping that the bound is made for.
const ARCS: f64 = 16.0;

/// One setting's part.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cost {
    key: &'static str,
    bytes: f64,
}

/// # Errors
/// If the whole could take more than is allowed; names what takes most.
pub(super) fn check(config: &Config) -> Result<(), BadSetting> {
    let mut costs = costs(config);
    let total: f64 = costs.iter().map(|cost| cost.bytes).sum();
    if total <= MOST_BYTES {
        return Ok(());
    }
    costs.sort_by(|a, b| b.bytes.total_cmp(&a.bytes));
    let largest = costs.iter().take(3);
    let largest: Vec<String> = largest
        .map(|cost| format!("{} {}", cost.key, in_words(cost.bytes)))
        .collect();
    let key = costs.first().map_or("", |cost| cost.key);
    Err(BadSetting::new(
        key,
        format!(
            "asks for too much memory; allowed is {} for all settings together, and they could take \
             {}. Most of it: {}. The default of {} is {}",
            in_words(MOST_BYTES),
            in_words(total),
            largest.join(", "),
            keys::split(key).1,
            keys::find(key).map_or_else(String::new, |key| key.example.to_string()),
        ),
    ))
}

fn costs(config: &Config) -> Vec<Cost> {
    let bins = f64::from(config.session.bin_count);
    let ping = size_of::<Ping>() as f64 + FRAME_BYTES + 4.0 * bins;
    let remembered = REMEMBERED_BYTES + REMEMBERED_BYTES_PER_BIN * bins;
    let pose = size_of::<StampedPose>() as f64;
    let (poses, bus) = (&config.pose, &config.bus);
    let cost = |key, count: usize, each: f64| Cost {
        key,
        bytes: count as f64 * each,
    };
    vec![
        cost("pose.capacity", poses.capacity, pose),
        cost("pose.waiting_pings", poses.waiting_pings, ping),
        cost("pipeline.queue_pings", config.pipeline.queue_pings, ping),
        cost(
            "mapper.history_pings",
            config.mapper.history_pings,
            remembered,
        ),
        cost("mapper.slice_pings", config.mapper.slice_pings, ping),
        cost("mapper.resolution_m", 1, evidence_bytes(config)),
        cost("bus.pose_queue_len", bus.pose_queue_len, pose),
        cost("bus.ping_queue_len", bus.ping_queue_len, ping),
        cost("bus.history_bytes", bus.history_bytes, 1.0),
        cost("bus.max_gaussians", bus.max_gaussians, HELD_GAUSSIAN_BYTES),
        cost(
            "bus.max_received_bytes",
            bus.max_received_bytes,
            MESSAGES_AT_A_TIME,
        ),
    ]
}

/// Evidence that one ping makes with echoes at its far end: arcs as long as the fan is high and as
/// wide as the beam.
fn evidence_bytes(config: &Config) -> f64 {
    let (mapper, session) = (&config.mapper, &config.session);
    let range_m = session.range_start_m + session.range_length_m;
    let extent_m = |width_deg: f32| range_m * f64::from(width_deg).to_radians();
    let voxel_m = mapper.finest_voxel_m(range_m);
    let blocks = |width_deg: f32| 1.0 + extent_m(width_deg) / (BLOCK_EDGE * voxel_m);
    let arc = blocks(mapper.beam.azimuth_width_deg) * blocks(mapper.beam.elevation_width_deg);
    ARCS * BLOCK_BYTES * arc
}

fn in_words(bytes: f64) -> String {
    match bytes >= 1e9 {
        true => format!("{:.1} GiB", bytes / (1_u64 << 30) as f64),
        false => format!("{:.0} MiB", bytes / (1_u64 << 20) as f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_leave_room() {
        let total: f64 = costs(&Config::default()).iter().map(|c| c.bytes).sum();
        assert!(total < 0.5 * MOST_BYTES, "{}", in_words(total));
    }

    #[test]
    fn what_takes_most_is_named() {
        let refusal = |change: &dyn Fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            check(&config).unwrap_err()
        };
        let many = refusal(&|c| c.bus.max_gaussians = 1 << 26);
        assert_eq!(many.key, "bus.max_gaussians");
        assert!(many.message.contains("allowed is 2.0 GiB"), "{many:?}");
        assert!(many.message.contains("is 2000000"), "{many:?}");
        let fine = refusal(&|c| {
            c.mapper.resolution_m = 0.005;
            c.session.range_length_m = 120.0;
        });
        assert_eq!(fine.key, "mapper.resolution_m");
        let together = refusal(&|c| {
            c.mapper.history_pings = 900_000;
            c.pose.capacity = 5_000_000;
        });
        assert!(together.message.contains("pose.capacity"), "{together:?}");
        assert!(together.message.contains("mapper.history_pings"));
    }

    #[test]
    fn fine_voxels_are_allowed_near_by() {
        let mut config = Config::default();
        config.mapper.resolution_m = 0.005;
        assert_eq!(check(&config), Ok(()));
    }
}
