//! Whether pings that no search saw bear out what was found.

use super::search::{TELLING_ERRORS, Verdict, gain_on};
use super::trials::{Dive, Trial};
use crate::arguments::Parameter;
use crate::config::Config;

/// Of a parameter by all that was found: where it is not as configured, a map with that one as configured is asked.
///
/// # Errors
/// If no map can be made.
pub(super) fn verdict(
    dive: &Dive,
    configured: &Config,
    best: &Trial,
    parameter: Parameter,
    last: Verdict,
) -> anyhow::Result<Verdict> {
    let moved = parameter.of(&best.config) - parameter.of(configured);
    if moved.abs() < f64::EPSILON {
        return Ok(last);
    }
    let Ok(as_configured) = dive.trial(&parameter.set_as_in(&best.config, configured)) else {
        // So far off that pings have no poses: there is nothing to compare with.
        return Ok(Verdict::Off);
    };
    let (gain, error) = gain_on(&best.verifying, &as_configured.verifying);
    // Not a number where no ping has a pose with both.
    Ok(match gain <= TELLING_ERRORS * error {
        true => Verdict::Unverified,
        false => Verdict::Off,
    })
}
