//! `echosplat georeference MAP.ply`: where on Earth a map lies, told or put into it.

use echosplat_georeference::{
    Crs, Declination, DeclinationError, Georeference, Residual, Tie, declination, solve,
};
use echosplat_recording::ply::{MapFile, georeference_map};
use serde_json::{Value, json};

use crate::arguments::GeoreferenceArguments;
use crate::exit::{Finish, Usage};
use crate::placing::{self, EAST_DEG};
use crate::{clock, files, logging, maps};

/// What is known of the map's place, and how well.
struct Found {
    georeference: Georeference,
    residuals: Vec<Residual>,
    heading_sigma_deg: Option<f64>,
    /// Whether it was asked for, and so goes into the map.
    is_new: bool,
}

/// Where a compass points there, and on which day.
struct Compass {
    unix_day: i64,
    declination: Result<Declination, DeclinationError>,
}

impl Compass {
    fn of(arguments: &GeoreferenceArguments, georeference: &Georeference) -> Self {
        let today = || clock::unix_day(clock::now());
        let unix_day = arguments.date.unwrap_or_else(today);
        Self {
            unix_day,
            declination: declination(&georeference.place, unix_day),
        }
    }

    fn line(&self) -> String {
        let day = clock::iso_day(self.unix_day);
        match &self.declination {
            Ok(found) => format!(
                "magnetic north is {:+.2} degrees from true north there on {day}, one sigma {:.2} (WMM): add it to what a compass \
                 says{}",
                found.declination_deg,
                found.sigma_deg,
                match found.is_unsure {
                    true => "; so near a magnetic pole no compass is to be trusted",
                    false => "",
                }
            ),
            Err(error) => {
                format!("no declination for {day}: {error}; --date gives the day of the dive")
            }
        }
    }
}

/// # Errors
/// If the map cannot be read, nothing is known of its place, or it cannot be written.
pub(crate) fn run(arguments: &GeoreferenceArguments) -> anyhow::Result<Finish> {
    let map = maps::read(&arguments.map)?;
    let mut found = found(arguments, &map)?;
    let compass = Compass::of(arguments, &found.georeference);
    if arguments.magnetic {
        let declination = compass.declination.as_ref();
        let declination =
            declination.map_err(|_| Usage::error(format!("--magnetic: {}", compass.line())))?;
        let heading_deg = found.georeference.x_heading_deg + declination.declination_deg;
        found.georeference.x_heading_deg = heading_deg.rem_euclid(360.0);
    }
    let crs = Crs::utm_of(&found.georeference.place).map_err(Usage::error)?;
    if found.is_new {
        put(arguments, &found.georeference)?;
    } else if arguments.out.is_some() {
        return Err(Usage::error(
            "--out needs a place to write: --origin LAT,LON,ALT or --tie X,Y,Z=LAT,LON,DEPTH",
        ));
    }
    match arguments.json {
        true => logging::print(&document(&found, &crs, &compass)?.to_string()),
        false => lines(&found, &crs, &compass)?
            .iter()
            .for_each(|line| logging::print(line)),
    }
    Ok(maps::finish_of(&map))
}

fn found(arguments: &GeoreferenceArguments, map: &MapFile) -> anyhow::Result<Found> {
    let alone = |georeference, is_new| Found {
        georeference,
        residuals: Vec::new(),
        heading_sigma_deg: None,
        is_new,
    };
    if let Some(asked) = placing::asked(&arguments.place)? {
        return Ok(alone(asked, true));
    }
    let held = map.notes.georeference.clone();
    let heading_deg = placing::heading(&arguments.place)?;
    if arguments.tie.is_empty() {
        let held = held.ok_or_else(|| {
            Usage::error(format!(
                "map {}: it does not say where on Earth it lies: give --origin LAT,LON,ALT or --tie \
                 X,Y,Z=LAT,LON,DEPTH",
                arguments.map.display()
            ))
        })?;
        let is_new = heading_deg.is_some();
        let x_heading_deg = heading_deg.unwrap_or(held.x_heading_deg);
        let turned = Georeference {
            x_heading_deg,
            ..held
        };
        return Ok(alone(turned, is_new));
    }
    let ties: Result<Vec<Tie>, String> = arguments.tie.iter().map(|tie| Tie::parse(tie)).collect();
    let ties = ties.map_err(|error| Usage::error(format!("--tie {error}")))?;
    let known_deg = heading_deg.or(held.map(|held| held.x_heading_deg));
    let solved = solve(&ties, known_deg.unwrap_or(EAST_DEG))
        .map_err(|error| Usage::error(format!("--tie: {error}")))?;
    Ok(Found {
        georeference: solved.georeference,
        residuals: solved.residuals,
        heading_sigma_deg: solved.heading_sigma_deg,
        is_new: true,
    })
}

fn put(arguments: &GeoreferenceArguments, georeference: &Georeference) -> anyhow::Result<()> {
    let out = arguments.out.as_ref().unwrap_or(&arguments.map);
    files::prepare("--out", out)?;
    georeference_map(&arguments.map, out, georeference)
        .map_err(|error| files::cannot_write(out, &error))
}

fn lines(found: &Found, crs: &Crs, compass: &Compass) -> anyhow::Result<Vec<String>> {
    let georeference = &found.georeference;
    let place = georeference.place;
    let [x, y, z] = georeference.anchor_m.to_array();
    let at = crs.project(&place)?;
    let grid = crs.grid(&place)?;
    let mut lines = vec![
        format!(
            "{x:.3} {y:.3} {z:.3} of the map is at latitude {:.9}, longitude {:.9}, {:.3} m above {} (from {})",
            place.latitude_deg,
            place.longitude_deg,
            place.height_m,
            georeference.datum.in_words(),
            georeference.source
        ),
        match found.heading_sigma_deg {
            Some(sigma_deg) => format!(
                "x of the map points to {:.3} degrees from true north, one sigma {sigma_deg:.3}",
                georeference.x_heading_deg
            ),
            None => format!(
                "x of the map points to {:.3} degrees from true north",
                georeference.x_heading_deg
            ),
        },
        format!(
            "{crs}: {:.3} {:.3}; north of this grid is {:.3} degrees from true north, its metre {:.6} m",
            at.x, at.y, grid.convergence_deg, grid.scale
        ),
        compass.line(),
    ];
    for (index, residual) in found.residuals.iter().enumerate() {
        let [east, north, up] = residual.enu_m.to_array();
        lines.push(format!(
            "tie {}: {east:+.3} m east, {north:+.3} m north, {up:+.3} m up of where the map has it",
            index + 1
        ));
    }
    if !found.residuals.is_empty() && found.heading_sigma_deg.is_none() {
        lines.push("the heading is as it was: three ties find it too".to_owned());
    }
    Ok(lines)
}

fn document(found: &Found, crs: &Crs, compass: &Compass) -> anyhow::Result<Value> {
    let georeference = &found.georeference;
    let place = georeference.place;
    let at = crs.project(&place)?;
    let grid = crs.grid(&place)?;
    let residuals = found.residuals.iter().map(|r| json!(r.enu_m.to_array()));
    Ok(json!({
        "anchor_m": georeference.anchor_m.to_array(),
        "latitude_deg": place.latitude_deg,
        "longitude_deg": place.longitude_deg,
        "height_m": place.height_m,
        "height_datum": georeference.datum.name(),
        "x_heading_deg": georeference.x_heading_deg,
        "x_heading_sigma_deg": found.heading_sigma_deg,
        "source": georeference.source,
        "epsg": crs.code(),
        "projected": at.to_array(),
        "grid_convergence_deg": grid.convergence_deg,
        "grid_scale": grid.scale,
        "declination_deg": compass.declination.as_ref().ok().map(|found| found.declination_deg),
        "declination_sigma_deg": compass.declination.as_ref().ok().map(|found| found.sigma_deg),
        "declination_date": clock::iso_day(compass.unix_day),
        "residuals_enu_m": residuals.collect::<Vec<_>>(),
    }))
}
