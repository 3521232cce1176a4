//! `echosplat measure MAP.ply`: sizes in a map, each with its sigma.

pub(super) mod shapes;

use echosplat_recording::export::placed::Shape;

use crate::arguments::MeasureArguments;
use crate::exit::{Finish, Usage};
use crate::measuring::{asserted, measure};
use crate::{logging, maps};

/// # Errors
/// If the map cannot be read, or what was asked for is not there.
pub(crate) fn run(arguments: &MeasureArguments) -> anyhow::Result<Finish> {
    let map = maps::read(&arguments.map)?;
    let samples = asserted(map.origin_m, &map.gaussians);
    let place = map.notes.georeference.as_ref();
    let asked = arguments.asked.asked().map_err(Usage::error)?;
    let measured = measure(&asked, &samples, place)
        .map_err(|error| Usage::error(format!("map {}: {error}", arguments.map.display())))?;
    if let Some(out) = &arguments.out {
        shapes::write(out, &arguments.map, place, &measured.rows, |place| {
            let places = measured
                .shape
                .iter()
                .map(|at| place.place_of(*at))
                .collect::<Vec<_>>();
            let shape = match places[..] {
                [only] => Shape::Point(only),
                _ => Shape::Line(places),
            };
            vec![shapes::feature(
                measured.name,
                shape,
                &measured.facts,
                place,
            )]
        })?;
    }
    match arguments.json {
        true => logging::print(&measured.facts.to_string()),
        false => measured.lines.iter().for_each(|line| logging::print(line)),
    }
    Ok(maps::finish_of(&map))
}
