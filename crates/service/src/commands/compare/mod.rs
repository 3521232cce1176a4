//! `echosplat compare BEFORE.ply AFTER.ply`: what came, went and moved.

mod page;

use std::path::PathBuf;

use echosplat_model::Gaussian;
use echosplat_recording::export::placed::Shape;
use echosplat_survey::{Change, Compared, Kind, compare, samples_of};
use serde_json::{Value, json};

use super::measure::shapes;
use crate::arguments::CompareArguments;
use crate::exit::{Finish, Usage};
use crate::{files, logging, maps};

/// # Errors
/// If one of the maps cannot be read, or they share too little.
pub(crate) fn run(arguments: &CompareArguments) -> anyhow::Result<Finish> {
    let mut before = maps::read(&arguments.before)?;
    let mut after = maps::read(&arguments.after)?;
    // So that places and Gaussians are as many.
    for map in [&mut before, &mut after] {
        map.gaussians.retain(Gaussian::is_sound);
    }
    let [old, new] = [&before, &after].map(|map| samples_of(map.origin_m, &map.gaussians));
    let found = compare(&old, &new).map_err(|error| {
        let (before, after) = (arguments.before.display(), arguments.after.display());
        Usage::error(format!("{before} and {after}: {error}"))
    })?;
    let is_page = |out: &&PathBuf| out.extension().is_some_and(|end| end == "html");
    if let Some(out) = arguments.out.as_ref().filter(is_page) {
        let names = [&arguments.before, &arguments.after].map(|path| path.display().to_string());
        let html = page::html(&names, [&before, &after], &found);
        files::write("--out", out, html.as_bytes())?;
    } else if let Some(out) = &arguments.out {
        let place = before.notes.georeference.as_ref();
        shapes::write(out, &arguments.before, place, "", |place| {
            let one = |change: &Change| {
                let shape = Shape::Point(place.place_of(change.at_m));
                shapes::feature(name(change.kind), shape, &facts(change), place)
            };
            found.changes.iter().map(one).collect()
        })?;
    }
    match arguments.json {
        true => logging::print(&document(&found).to_string()),
        false => changes(&found)
            .chain(comparison(&found))
            .for_each(|line| logging::print(&line)),
    }
    Ok(maps::finish_of(&before))
}

fn name(kind: Kind) -> &'static str {
    match kind {
        Kind::Came => "came",
        Kind::Went => "went",
        Kind::Moved => "moved",
    }
}

/// Each change in words; that there is none if there is none.
fn changes(found: &Compared) -> impl Iterator<Item = String> {
    let nothing = found.changes.is_empty();
    let nothing = nothing.then(|| "nothing came, went or moved".to_owned());
    found.changes.iter().map(line).chain(nothing)
}

fn line(change: &Change) -> String {
    let [x, y, z] = change.at_m.to_array();
    let [width, depth, height] = change.size_m.to_array();
    let moved = match change.kind {
        Kind::Moved => {
            let [east, north, up] = change.by_m.to_array();
            format!(", by {east:+.2},{north:+.2},{up:+.2}")
        }
        Kind::Came | Kind::Went => String::new(),
    };
    format!(
        "{}: {x:.2},{y:.2},{z:.2}{moved} ± {:.2} m, {width:.2} by {depth:.2} by {height:.2} m, {} Gaussians of \
         probability {:.2}",
        name(change.kind),
        change.sigma_m,
        change.count,
        change.probability
    )
}

/// How the maps lie on each other, and how much of the first was not compared.
fn comparison(found: &Compared) -> impl Iterator<Item = String> {
    let alignment = &found.alignment;
    let [x, y, z] = alignment.move_m.to_array();
    let laid = format!(
        "the second map is laid on the first by {:+.2} degrees about up and {x:+.3},{y:+.3},{z:+.3} m; {} pairs are \
         {:.3} m apart (root mean square)",
        alignment.turn_deg, alignment.pairs, alignment.residual_m
    );
    let percent = 100.0 * found.not_looked_at;
    let unseen = (percent >= 0.5).then(|| {
        format!(
            "{percent:.0} % of the first map lie where the second has nothing near: it is not compared"
        )
    });
    [laid].into_iter().chain(unseen)
}

fn facts(change: &Change) -> Value {
    json!({
        "kind": name(change.kind),
        "at_m": change.at_m.to_array(),
        "by_m": change.by_m.to_array(),
        "sigma_m": change.sigma_m,
        "size_m": change.size_m.to_array(),
        "gaussians": change.count,
        "probability": change.probability,
    })
}

fn document(found: &Compared) -> Value {
    let alignment = &found.alignment;
    json!({
        "turn_deg": alignment.turn_deg,
        "move_m": alignment.move_m.to_array(),
        "pivot_m": alignment.pivot_m.to_array(),
        "residual_m": alignment.residual_m,
        "sigma_m": alignment.sigma_m,
        "pairs": alignment.pairs,
        "not_looked_at": found.not_looked_at,
        "changes": found.changes.iter().map(facts).collect::<Vec<_>>(),
    })
}
