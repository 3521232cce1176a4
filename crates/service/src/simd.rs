//! Which vector instructions this process takes.

use echosplat_measurement::simd_level;

use crate::exit::Usage;

/// Has the process take a level that is not the processor's best, by its name.
const VARIABLE: &str = "ECHOSPLAT_SIMD";

/// Takes the level that the environment names, if it names one.
///
/// # Errors
/// If this processor does not have it.
pub fn start() -> anyhow::Result<()> {
    let Some(name) = std::env::var_os(VARIABLE).filter(|name| !name.is_empty()) else {
        return Ok(());
    };
    let held = simd_level::hold_to(&name.to_string_lossy());
    held.map_err(|error| Usage::error(format!("{VARIABLE}: {error}")))
}

/// The level that is in use, as `avx2`.
#[must_use]
pub fn name() -> &'static str {
    simd_level::name_of(simd_level::level())
}

/// Says in the log which level a map is made with.
pub(crate) fn tell() {
    let rounding = match simd_level::has_fused_multiply_add(simd_level::level()) {
        true => "",
        false => {
            "; without fused multiply-add maps differ in their last digits from those of processors \
             that have it"
        }
    };
    tracing::info!(
        simd = name(),
        "the map is made with {} instructions{rounding}",
        name()
    );
}
