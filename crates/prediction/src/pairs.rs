//! Pings beside what a map says of them.

use echosplat_mapper::{MapperConfig, geometry_of};
use echosplat_model::{PingSettings, PosedPing};

use crate::MapRenderer;
use crate::held_out::Pair;

/// Bins within the blanking.
#[must_use]
pub fn blank_bins(settings: &PingSettings, config: &MapperConfig) -> usize {
    let blank_m = config.blanking_m - settings.range_start_m;
    let blank = (blank_m / settings.bin_length_m()).ceil().max(0.0) as usize;
    blank.min(settings.bin_count)
}

/// A ping beside what a map says of it, without its blanked bins.
pub fn pair_of(renderer: &mut MapRenderer, posed: &PosedPing, config: &MapperConfig) -> Pair {
    let geometry = geometry_of(posed, renderer.origin_m(), config);
    let blank = blank_bins(posed.ping.settings(), config);
    Pair {
        measured: posed.ping.intensity()[blank..].to_vec(),
        rendered: renderer.ping(&geometry)[blank..].to_vec(),
    }
}
