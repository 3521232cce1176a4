//! What a map's header says in comments.

use echosplat_georeference::Georeference;
use echosplat_model::glam::DVec3;
use echosplat_model::{INTENSITY_UNITS, is_origin};
use echosplat_ply::Written;

use super::{MapFile, MapFileError};
use crate::export::Up;

/// Comments that say something to a reader of maps, and so are no free text.
const ORIGIN: &str = "origin_m";
const INTENSITY_UNIT: &str = "intensity_unit";
const HELD_OUT_EVERY: &str = "held_out_every";
const UP_AXIS: &str = "up_axis";
pub(super) const GEOREFERENCE: &str = "georeference";

const OWN: [&str; 5] = [
    ORIGIN,
    INTENSITY_UNIT,
    HELD_OUT_EVERY,
    UP_AXIS,
    GEOREFERENCE,
];

/// Most comment lines of a header, and the most characters of one: a reader takes 64 KiB of it.
const MOST_COMMENTS: usize = 32;
const LONGEST_COMMENT: usize = 256;

/// The header's comments.
pub(super) fn comments(map: &MapFile) -> Vec<String> {
    let mut comments = vec![
        Written::MAP.comment(),
        origin(map.origin_m),
        format!("{INTENSITY_UNIT} {:?}", map.intensity_unit),
    ];
    if map.notes.held_out_every > 1 {
        comments.push(format!("{HELD_OUT_EVERY} {}", map.notes.held_out_every));
    }
    comments.extend(up_axis(map.notes.up));
    comments.extend(map.notes.georeference.iter().map(georeference));
    let free = map.notes.comments.iter().take(MOST_COMMENTS);
    comments.extend(free.filter_map(|comment| free_comment(comment)));
    comments
}

/// The comment that says what is added to every place.
pub(crate) fn origin(origin_m: DVec3) -> String {
    let (x, y, z) = origin_m.into();
    format!("{ORIGIN} {x:?} {y:?} {z:?}")
}

/// The comment that says where on Earth the world lies.
pub(super) fn georeference(georeference: &Georeference) -> String {
    format!("{GEOREFERENCE} {}", georeference.line())
}

/// The comment that says which axis points up, where it is not z.
pub(crate) fn up_axis(up: Up) -> Option<String> {
    (up != Up::Z).then(|| format!("{UP_AXIS} {}", up.name()))
}

/// One line without control characters; `None` if it would be read as one of ours.
fn free_comment(text: &str) -> Option<String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let is_own = |word: &&str| OWN.contains(word);
    let line = words.join(" ");
    let is_own = words.first().is_some_and(is_own) || Written::is_said_by(&line);
    let shown = line.chars().filter(|c| !c.is_control());
    (!is_own && !words.is_empty()).then(|| shown.take(LONGEST_COMMENT).collect())
}

/// A map without Gaussians that says what the comments do.
pub(super) fn read(comments: &[String]) -> Result<MapFile, MapFileError> {
    let mut map = MapFile::default();
    let says_origin = |comment: &String| comment.split_whitespace().next() == Some(ORIGIN);
    if !comments.iter().any(says_origin) {
        map.lacks
            .push("`comment origin_m`, so that its places are taken for the world's");
    }
    for comment in comments {
        match comment.split_whitespace().collect::<Vec<_>>()[..] {
            [ORIGIN, x, y, z] => map.origin_m = place(x, y, z)?,
            [INTENSITY_UNIT, unit] => map.intensity_unit = positive(unit)?,
            [HELD_OUT_EVERY, every] => map.notes.held_out_every = every_nth(every)?,
            [UP_AXIS, up] => map.notes.up = axis(up)?,
            [GEOREFERENCE, ref words @ ..] => map.notes.georeference = Some(place_on_earth(words)?),
            _ => {}
        }
    }
    Ok(map)
}

fn place(x: &str, y: &str, z: &str) -> Result<DVec3, MapFileError> {
    let number = |text: &str| text.parse().unwrap_or(f64::NAN);
    let origin_m = DVec3::new(number(x), number(y), number(z));
    let wrong = "`comment origin_m` needs three numbers of 1e8 m at most";
    is_origin(origin_m)
        .then_some(origin_m)
        .ok_or(MapFileError::Comment(wrong))
}

fn place_on_earth(words: &[&str]) -> Result<Georeference, MapFileError> {
    Georeference::parse(&words.join(" ")).map_err(MapFileError::Georeference)
}

fn positive(unit: &str) -> Result<f32, MapFileError> {
    let unit: f32 = unit.parse().unwrap_or(f32::NAN);
    let is_unit = INTENSITY_UNITS.contains(&unit);
    let wrong = "`comment intensity_unit` needs a number within 1e-30 to 1e30";
    is_unit.then_some(unit).ok_or(MapFileError::Comment(wrong))
}

fn every_nth(every: &str) -> Result<u64, MapFileError> {
    let every = every.parse().ok().filter(|every| *every >= 2);
    let wrong = "`comment held_out_every` needs a whole number of 2 or more";
    every.ok_or(MapFileError::Comment(wrong))
}

fn axis(name: &str) -> Result<Up, MapFileError> {
    let wrong = "`comment up_axis` needs z, y or -y";
    Up::of(name).ok_or(MapFileError::Comment(wrong))
}
