//! Figures and tables of a handout.

use echosplat_georeference::{Crs, Place};
use echosplat_model::Standing;
use echosplat_model::glam::DVec3;
use echosplat_report::table::{metres_unit, quantity};
use echosplat_report::{Bearings, Table};
use serde_json::Value;

use super::{Subject, asserted, bounds};
use crate::arguments::VERSION;
use crate::clock;
use crate::config::Config;

fn two(title: &str, rows: Vec<(&str, String)>, note: &str) -> Table {
    let rows = rows.into_iter();
    Table {
        title: title.to_owned(),
        columns: Vec::new(),
        rows: rows
            .map(|(name, value)| vec![name.to_owned(), value])
            .collect(),
        note: note.to_owned(),
    }
}

/// Title block.
pub(super) fn about(subject: &Subject) -> Vec<(String, String)> {
    let mut rows = subject.about.clone();
    if let Some(began) = subject.began {
        rows.push(("Dive".to_owned(), utc(began)));
    }
    rows.push(("Report".to_owned(), utc(clock::now())));
    rows.push(("Made by".to_owned(), format!("EchoSplat {VERSION}")));
    rows
}

/// To the minute.
fn utc(time: echosplat_model::Timestamp) -> String {
    let iso = clock::iso_utc(time);
    match iso.split_once('T') {
        Some((day, time)) => format!("{day} {} UTC", time.get(..5).unwrap_or(time)),
        None => iso,
    }
}

/// What is read first.
pub(super) fn highlights(subject: &Subject, bearings: &Bearings) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut tell = |name: &str, value: String| found.push((name.to_owned(), value));
    let dive_s = subject.run["dive_s"].as_f64().or_else(|| {
        let way = &subject.way.0;
        Some(way.last()?.0 - way.first()?.0)
    });
    if let Some(dive_s) = dive_s {
        tell("dive", duration(dive_s));
    }
    if subject.way.0.len() > 1 {
        tell(
            "way of the sonar",
            format!("{} m", quantity(subject.way.length_m())),
        );
    }
    if let Some((low, high)) = bounds(subject) {
        let size = high - low;
        tell(
            "mapped, x × y × z",
            format!("{:.1} × {:.1} × {:.1} m", size.x, size.y, size.z),
        );
        let [top, bottom] = [high.z, low.z].map(|z| z + bearings.height_offset_m);
        match bearings.is_depth {
            true => tell(
                "depth",
                format!("{:.1} to {:.1} m", -top, -bottom).replace('-', "−"),
            ),
            false => tell(
                "height",
                format!("{bottom:.1} to {top:.1} m").replace('-', "−"),
            ),
        }
    }
    if let Some(sigma_m) = sigma_m(subject, 0.5) {
        tell("half is known to", metres_unit(sigma_m));
    }
    tell("ambiguous, of the map", ambiguous(subject));
    found
}

fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s} s"),
        (h, m, _) => format!("{h} h {m} min"),
    }
}

/// So large a share of what is asserted is known as well as this, one sigma; `None` where that is not known.
fn sigma_m(subject: &Subject, share: f64) -> Option<f64> {
    let mut sigmas: Vec<f64> = asserted(subject).map(|g| f64::from(g.sigma_m)).collect();
    sigmas.sort_by(f64::total_cmp);
    let index = (share * sigmas.len() as f64) as usize;
    sigmas.get(index).copied().filter(|sigma| sigma.is_finite())
}

fn ambiguous(subject: &Subject) -> String {
    let sound = subject.gaussians.iter().filter(|g| g.is_sound());
    let all = sound.clone().count();
    let count = sound.filter(|g| g.standing == Standing::Ambiguous).count();
    match all {
        0 => "no map".to_owned(),
        _ => format!("{:.1} %", 100.0 * count as f64 / all as f64),
    }
}

/// Where the map lies.
pub(super) fn position(subject: &Subject, bearings: &Bearings) -> Table {
    let title = "Where it lies";
    let Some(place) = subject.place else {
        return two(
            title,
            vec![("place on Earth", "not told".to_owned())],
            "Coordinates are those of the poses, z up. `echosplat georeference` puts the place into the map.",
        );
    };
    let utm = Crs::utm_of(&place.place).ok();
    let (low, high) = bounds(subject).unwrap_or_default();
    let points = [
        ("origin of x, y, z", DVec3::ZERO),
        ("middle of the map", 0.5 * (low + high)),
        ("corner, least x and y", low),
        ("corner, most x and y", high),
    ];
    let row = |(name, at_m): (&str, DVec3)| {
        let at = place.place_of(at_m);
        let [latitude, longitude] = degrees(&at);
        let grid = utm.as_ref().and_then(|utm| utm.project(&at).ok());
        let grid = grid.map_or([String::new(), String::new()], |grid| {
            [grid.x, grid.y].map(|metres| format!("{metres:.2}"))
        });
        let world = format!("{:.2}, {:.2}", at_m.x, at_m.y).replace('-', "−");
        [name.to_owned(), world, latitude, longitude]
            .into_iter()
            .chain(grid)
            .collect()
    };
    let name = utm.as_ref().map_or("UTM", |utm| utm.name());
    let code = utm.as_ref().map_or(0, Crs::code);
    Table {
        title: title.to_owned(),
        columns: [
            "",
            "x, y, m",
            "latitude",
            "longitude",
            "east, m",
            "north, m",
        ]
        .map(str::to_owned)
        .into(),
        rows: points.map(row).into(),
        note: format!(
            "WGS 84; east and north in {name} (EPSG:{code}). The x axis points to {:.1}° from true north. {}. Known from: \
             {}.",
            place.x_heading_deg,
            sentence(&bearings.name.replace(", m", ", in metres")),
            place.source
        ),
    }
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(|c| c.to_uppercase().collect::<String>());
    format!("{}{}", first.unwrap_or_default(), letters.as_str())
}

/// To a centimetre, with their hemispheres.
fn degrees(at: &Place) -> [String; 2] {
    let half = |value: f64, [positive, negative]: [&str; 2]| {
        let side = if value < 0.0 { negative } else { positive };
        format!("{:.7}° {side}", value.abs())
    };
    [
        half(at.latitude_deg, ["N", "S"]),
        half(at.longitude_deg, ["E", "W"]),
    ]
}

/// How far the map can be trusted.
pub(super) fn sureness(subject: &Subject) -> Table {
    let count = asserted(subject).count();
    let mut rows = vec![("asserted", format!("{count} Gaussians"))];
    if let Some((half, most)) = sigma_m(subject, 0.5).zip(sigma_m(subject, 0.9)) {
        rows.push((
            "place, one sigma",
            format!(
                "{} for half of it, {} for nine in ten",
                metres_unit(half),
                metres_unit(most)
            ),
        ));
    }
    rows.push((
        "ambiguous",
        format!("{} of the map; drawn apart", ambiguous(subject)),
    ));
    rows.extend(foretold(subject.run).map(|told| ("pings before they were taken in", told)));
    rows.extend(held_out(subject.run).map(|told| ("pings kept from the map", told)));
    let notices = subject.run["notices"].as_array();
    if let Some(notices) = notices {
        let said = match notices.len() {
            0 => "nothing".to_owned(),
            1 => "one thing, on the last page".to_owned(),
            count => format!("{count} things, on the last page"),
        };
        rows.push(("what went wrong", said));
    }
    two(
        "How sure it is",
        rows,
        "Pings were scored by the map before it learned of them: above 0 it foretold what was heard better than noise \
         alone. A Gaussian is asserted where the dive ruled out every other place for its echoes.",
    )
}

fn foretold(run: &Value) -> Option<String> {
    let told = &run["mapper"]["foretold"];
    let pings = told["pings"].as_u64().filter(|pings| *pings > 0)?;
    let gain = told["gain_nats_per_bin"].as_f64()?;
    Some(format!("{gain:+.4} nats a bin above noise, {pings} pings").replace('-', "−"))
}

fn held_out(run: &Value) -> Option<String> {
    let told = &run["prediction"];
    let pings = told["pings"].as_u64().filter(|pings| *pings > 0)?;
    let gain = told["gain_per_bin"].as_f64()?;
    Some(format!("{gain:+.4} nats a bin above a constant, {pings} pings").replace('-', "−"))
}

/// Settings, and what went wrong.
pub(super) fn last(subject: &Subject) -> Vec<Table> {
    let settings = match subject.settings {
        Some(config) => settings(config),
        None => two(
            "Settings",
            vec![("of the dive", "not told".to_owned())],
            "The recording of the dive has them: `--dive`.",
        ),
    };
    let mut tables = vec![settings];
    tables.extend(pings(subject.run));
    tables.extend(notices(subject.run));
    tables
}

fn settings(config: &Config) -> Table {
    let mount = &config.pose.vehicle_from_sensor;
    let three = |numbers: [f64; 3]| numbers.map(quantity).join(", ");
    let session = &config.session;
    let beam = &config.mapper.beam;
    let rows = vec![
        (
            "range asked for",
            format!(
                "{} to {} m",
                quantity(session.range_start_m),
                quantity(session.range_start_m + session.range_length_m)
            ),
        ),
        (
            "speed of sound",
            format!("{} m/s", quantity(session.speed_of_sound_mps)),
        ),
        (
            "beam",
            format!(
                "{}° wide, {}° tall",
                quantity(beam.azimuth_width_deg.into()),
                quantity(beam.elevation_width_deg.into())
            ),
        ),
        (
            "mount, forward, left, up",
            format!("{} m", three(mount.translation_m)),
        ),
        (
            "mount, yaw, pitch, roll",
            format!("{}°", three(mount.yaw_pitch_roll_deg)),
        ),
        ("poses from", source(&config.pose.url.to_string())),
        (
            "time offset",
            format!("{} s", quantity(config.pose.time_offset_s)),
        ),
    ];
    two("Settings", rows, "")
}

/// A source of poses by its kind, and a file without its folder: where it lay is of no use to the reader.
fn source(url: &str) -> String {
    match url.split_once("://") {
        Some(("tum" | "file" | "log", path)) => {
            path.rsplit(['/', '\\']).next().unwrap_or(path).to_owned()
        }
        Some((kind, "")) => kind.to_owned(),
        Some((kind, rest)) => format!("{kind}, {rest}"),
        None => url.to_owned(),
    }
}

fn pings(run: &Value) -> Option<Table> {
    let received = run["pings_received"].as_u64()?;
    let mapped = run["pings_mapped"].as_u64()?;
    let rows = vec![
        ("received", received.to_string()),
        ("in the map", mapped.to_string()),
    ];
    Some(two("Pings", rows, ""))
}

fn notices(run: &Value) -> Option<Table> {
    let notices = run["notices"].as_array().filter(|all| !all.is_empty())?;
    let row = |notice: &Value| {
        let at = |name: &str| notice[name].as_f64();
        let until = at("until_s").map_or("to the end".to_owned(), |s| format!("{s:.0} s"));
        vec![
            notice["code"].as_str().unwrap_or_default().to_owned(),
            format!("{:.0} s", at("since_s").unwrap_or(0.0)),
            until,
            notice["sentence"].as_str().unwrap_or_default().to_owned(),
        ]
    };
    Some(Table {
        title: "What went wrong".to_owned(),
        columns: ["notice", "from", "until", "what, and what to do"]
            .map(str::to_owned)
            .into(),
        rows: notices.iter().map(row).collect(),
        note: String::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::source;

    #[test]
    fn a_source_of_poses_is_named_without_the_folders_of_a_machine() {
        assert_eq!(source("tum:///data/somewhere/dive.tum"), "dive.tum");
        assert_eq!(source("zenoh://"), "zenoh");
        assert_eq!(
            source("mavlink+tcp://127.0.0.1:5777"),
            "mavlink+tcp, 127.0.0.1:5777"
        );
    }
}
