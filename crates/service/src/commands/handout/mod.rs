//! What a client is handed of a dive: the pages of its report that are printed.

mod facts;
pub(super) mod measures;

use echosplat_georeference::{Datum, Georeference};
use echosplat_model::glam::DVec3;
use echosplat_model::{Gaussian, Standing, Timestamp};
use echosplat_report::{Bearings, Drawn, Handout, Sheet, Shown, Side, Trajectory};
use serde_json::Value;

use self::measures::Named;
use crate::config::Config;

/// What is known of a dive and its map.
pub(super) struct Subject<'a> {
    /// Rows of the title block.
    pub(super) about: Vec<(String, String)>,
    /// Of the map, metres of the world.
    pub(super) origin_m: DVec3,
    /// Places relative to that.
    pub(super) gaussians: &'a [Gaussian],
    pub(super) place: Option<&'a Georeference>,
    /// Where the sonar was, metres of the world.
    pub(super) way: &'a Trajectory,
    /// Unix time, where the clock of the dive is one.
    pub(super) began: Option<Timestamp>,
    /// Of the run, as its status or `--json` has it; null where nobody kept it.
    pub(super) run: &'a Value,
    pub(super) settings: Option<&'a Config>,
    pub(super) measures: &'a [Named],
}

/// Times before are no dates but seconds since something began.
const FIRST_DATE_S: f64 = 1e9;

/// A time that is a date.
pub(super) fn date(time: Timestamp) -> Option<Timestamp> {
    (time.as_secs_f64() > FIRST_DATE_S).then_some(time)
}

/// The pages.
pub(super) fn of(subject: &Subject) -> Handout {
    let bearings = bearings(subject);
    let track: Vec<DVec3> = subject.way.0.iter().map(|(_, at_m)| *at_m).collect();
    let numbered = measures::numbered(subject.measures);
    let drawn = Drawn {
        origin_m: subject.origin_m,
        gaussians: subject.gaussians,
        changes: &[],
        track_m: &track,
        numbered: &numbered,
        bearings: &bearings,
    };
    let mut sheets = drawn.sheets();
    if track.len() > 1 {
        let way = drawn.figure(Side::Above, Shown::Track, 150.0);
        sheets.push(Sheet::new("Trajectory").figure(way).heights(subject.way));
    }
    sheets.extend(measures::sheet(subject.measures, subject.place));
    Handout {
        about: facts::about(subject),
        highlights: facts::highlights(subject, &bearings),
        tables: vec![
            facts::position(subject, &bearings),
            facts::sureness(subject),
        ],
        sheets,
        last: facts::last(subject),
    }
}

/// How heights are told: as depth below the water where they are counted from there.
fn bearings(subject: &Subject) -> Bearings {
    let Some(place) = subject.place else {
        return Bearings {
            name: "z, m (up, in the frame of the poses)".to_owned(),
            ..Bearings::default()
        };
    };
    let middle_m = bounds(subject).map_or(DVec3::ZERO, |(low, high)| 0.5 * (low + high));
    let is_depth = place.datum == Datum::Surface;
    let from = place.datum.in_words();
    Bearings {
        x_heading_deg: Some(place.x_heading_deg),
        height_offset_m: place.place_of(middle_m).height_m - middle_m.z,
        is_depth,
        name: match is_depth {
            true => format!("depth below {from}, m"),
            false => format!("height above {from}, m"),
        },
    }
}

fn asserted<'a>(subject: &'a Subject) -> impl Iterator<Item = &'a Gaussian> {
    let sound = subject.gaussians.iter().filter(|g| g.is_sound());
    sound.filter(|g| g.standing == Standing::Confident)
}

/// Least and most of what is asserted, metres of the world.
fn bounds(subject: &Subject) -> Option<(DVec3, DVec3)> {
    let places = asserted(subject).map(|g| subject.origin_m + g.mean_m.as_dvec3());
    places
        .map(|at_m| (at_m, at_m))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

#[cfg(test)]
mod tests;
