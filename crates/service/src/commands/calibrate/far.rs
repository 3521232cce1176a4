//! From far off to where maps can tell: by how pings and poses agree, then by a map of each place that is left.

use super::search::{TELLING_ERRORS, gain};
use super::trials::{Dive, Trial};
use echosplat_prediction::alignment::Peak;

use crate::alignment::setting;
use crate::arguments::Parameter;
use crate::config::Config;

/// Most times that all are gone through: what one has wrong hides some of what another has.
const ROUNDS: usize = 4;
/// Most maps of places where a clock may be.
const PLACES: usize = 4;

/// Where the search by maps begins.
///
/// # Errors
/// If too few pings have a pose wherever the clock may be.
pub(super) fn begin(
    dive: &Dive,
    configured: &Config,
    parameters: &[Parameter],
) -> anyhow::Result<Trial> {
    let mut far = configured.clone();
    for _ in 0..ROUNDS {
        let before = far.clone();
        for parameter in parameters {
            far = moved(dive, far, *parameter);
        }
        if far == before {
            break;
        }
    }
    let given = dive.trial(configured);
    if far != *configured {
        let there = dive.trial(&far)?;
        return Ok(match given {
            // That pings and poses agree there is beyond doubt, unless maps say the contrary.
            Ok(given) if is_likelier(&given, &there) => given,
            _ => there,
        });
    }
    let others = match parameters.contains(&Parameter::Time) {
        true => places(dive, configured),
        false => Vec::new(),
    };
    others
        .iter()
        .fold(given, |best, place| match (best, dive.trial(place)) {
            (Ok(best), Ok(other)) if is_likelier(&other, &best) => Ok(other),
            (Err(_), Ok(other)) => Ok(other),
            (best, _) => best,
        })
}

/// Where pings and poses agree best, if that is beyond doubt.
fn moved(dive: &Dive, config: Config, parameter: Parameter) -> Config {
    let found = dive.alignment();
    let found = found.and_then(|a| a.search(parameter.quantity(), &setting(&config)));
    match found.filter(Peak::is_off) {
        Some(peak) => {
            let moved = parameter.shifted(&config, peak.shift);
            let shown = parameter.show_with(parameter.of(&moved), Some(peak.sigma));
            tracing::info!(
                "{}: pings and poses agree best at {shown}",
                parameter.name()
            );
            moved
        }
        None => config,
    }
}

/// Where the clock may be, where pings and poses leave several places.
fn places(dive: &Dive, config: &Config) -> Vec<Config> {
    let quantity = Parameter::Time.quantity();
    let found = dive.alignment();
    let found = found.and_then(|alignment| alignment.search(quantity, &setting(config)));
    let Some(peak) = found.filter(|peak| !peak.is_telling()) else {
        return Vec::new();
    };
    let shifts = [&[peak.shift][..], &peak.rivals].concat();
    let is_elsewhere = |shift: &&f64| shift.abs() > Parameter::Time.step();
    let shifts = shifts.iter().filter(is_elsewhere).take(PLACES);
    shifts
        .map(|shift| Parameter::Time.shifted(config, *shift))
        .collect()
}

fn is_likelier(a: &Trial, b: &Trial) -> bool {
    let (gain, error) = gain(a, b);
    // Not a number where no ping has a pose with both.
    !(gain <= TELLING_ERRORS * error)
}
