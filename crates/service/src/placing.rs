//! A place on Earth as the command line gives it.

use echosplat_georeference::{Datum, Georeference, parse_origin};

use crate::arguments::PlaceArguments;
use crate::exit::Usage;

/// Degrees; x of a world is east unless its owner says otherwise.
pub(crate) const EAST_DEG: f64 = 90.0;

/// What was asked for; `None` if nothing was.
///
/// # Errors
/// If it is no place.
pub(crate) fn asked(arguments: &PlaceArguments) -> anyhow::Result<Option<Georeference>> {
    let Some(origin) = &arguments.origin else {
        return Ok(None);
    };
    let place = parse_origin(origin)
        .map_err(|error| Usage::error(format!("--origin {origin}: {error}")))?;
    let datum = arguments.datum.unwrap_or(Datum::Surface);
    let mut found = Georeference::at_origin(place, datum, "--origin");
    found.x_heading_deg = heading(arguments)?.unwrap_or(EAST_DEG);
    Ok(Some(found))
}

/// Of the world's x axis, degrees from true north, if it was given.
///
/// # Errors
/// If it is no heading.
pub(crate) fn heading(arguments: &PlaceArguments) -> anyhow::Result<Option<f64>> {
    match arguments.heading {
        Some(heading) if !(heading.abs() <= 360.0) => Err(Usage::error(format!(
            "--heading {heading}: it must be within -360 to 360 degrees"
        ))),
        found => Ok(found),
    }
}
