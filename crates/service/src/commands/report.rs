//! `echosplat report MAP.ply`: what a client is handed, of a map and of what is known of its dive.

use std::path::{Path, PathBuf};

use echosplat_metrics::MapPoints;
use echosplat_model::{StampedPose, Timestamp};
use echosplat_recording::mcap::{Recording, Scan};
use echosplat_recording::ply::MapFile;
use echosplat_report::{DiveReport, MapView, Picture, Trajectory};
use serde_json::Value;

use super::dive_report::{self, Said};
use super::export::placed::track;
use super::handout::{self, Subject, date, measures};
use crate::arguments::ReportArguments;
use crate::config::Config;
use crate::exit::{Finish, Usage};
use crate::measuring::{Asked, asserted};
use crate::replayed::{Begun, is_recording};
use crate::{files, logging, maps};

/// Longest output of a run that is read.
const MOST_JSON_BYTES: u64 = 16 << 20;
/// Most poses of a track that are drawn.
const MOST_POSES: usize = 20_000;

/// What is known of a dive beside its map.
#[derive(Default)]
struct Dive {
    run: Value,
    settings: Option<Config>,
    poses: Vec<StampedPose>,
    /// On the host's clock.
    began: Option<Timestamp>,
    losses: Vec<String>,
}

/// # Errors
/// If the map or what is given beside it cannot be read, or the report not be written.
pub(crate) fn run(arguments: &ReportArguments) -> anyhow::Result<Finish> {
    let map = maps::read(&arguments.map)?;
    let out = out(arguments);
    files::prepare("--out", &out)?;
    let dive = dive(arguments)?;
    let place = map.notes.georeference.as_ref();
    let samples = asserted(map.origin_m, &map.gaussians);
    let measures = measures::measured(asked(arguments)?, &samples, place)?;
    let way = trajectory(&dive.poses);
    let posed = dive.poses.first().map(|pose| pose.time);
    let began = posed.and_then(date).or(dive.began);
    let subject = Subject {
        about: arguments.about.clone(),
        origin_m: map.origin_m,
        gaussians: &map.gaussians,
        place,
        way: &way,
        began,
        run: &dive.run,
        settings: dive.settings.as_ref(),
        measures: &measures,
    };
    let html = page(arguments, &map, &subject).to_html();
    files::write("--out", &out, html.as_bytes())?;
    for loss in &dive.losses {
        tracing::warn!("{loss}");
    }
    logging::print(&format!(
        "{}: open it in a browser; it prints on A4, also to PDF",
        out.display()
    ));
    Ok(maps::finish_of(&map))
}

fn out(arguments: &ReportArguments) -> PathBuf {
    let beside = || arguments.map.with_extension("html");
    arguments.out.clone().unwrap_or_else(beside)
}

fn asked(arguments: &ReportArguments) -> anyhow::Result<Vec<(Asked, String)>> {
    let given = arguments.asked().into_iter();
    let mut all: Vec<(Asked, String)> = given.map(|asked| (asked, String::new())).collect();
    if let Some(file) = &arguments.measures {
        all.extend(measures::of_file(file)?);
    }
    Ok(all)
}

fn page(arguments: &ReportArguments, map: &MapFile, subject: &Subject) -> DiveReport {
    let name = arguments.map.file_name().unwrap_or_default();
    let name = name.to_string_lossy().into_owned();
    let way = subject.way.0.iter();
    let way: Vec<_> = way.map(|(_, at_m)| *at_m - map.origin_m).collect();
    let points = MapPoints::new(map.origin_m, &map.gaussians);
    DiveReport {
        title: arguments
            .title
            .clone()
            .unwrap_or_else(|| format!("Sonar survey: {name}")),
        text: format!(
            "The map {name} of a dive with a forward-looking sonar, made of 3-D Gaussians."
        ),
        verdict: dive_report::sentence(&Said::of_subject(subject)),
        handout: handout::of(subject),
        view: MapView::new(&map.gaussians, None, &way),
        picture: Picture::of_map(&points),
        trajectory: subject.way.clone(),
        plots: Vec::new(),
        tables: Vec::new(),
        notes: Vec::new(),
        machine: Vec::new(),
    }
}

/// What is told by `--dive` and `--track`.
fn dive(arguments: &ReportArguments) -> anyhow::Result<Dive> {
    let mut dive = match &arguments.dive[..] {
        [] => Dive::default(),
        [only] if is_json(only) => Dive {
            run: printed(only)?,
            ..Dive::default()
        },
        recordings => recorded(recordings)?,
    };
    if let Some(path) = &arguments.track {
        dive.poses = track(path)?;
    }
    Ok(dive)
}

fn is_json(path: &Path) -> bool {
    path.extension()
        .is_some_and(|end| end.eq_ignore_ascii_case("json"))
}

/// What a run printed with `--json`.
fn printed(path: &Path) -> anyhow::Result<Value> {
    let wrong = |why: String| Usage::error(format!("--dive {}: {why}", path.display()));
    echosplat_input::readable(path).map_err(wrong)?;
    let size = std::fs::metadata(path).map_or(0, |found| found.len());
    if size > MOST_JSON_BYTES {
        return Err(wrong(format!(
            "has {size} bytes; {MOST_JSON_BYTES} are read"
        )));
    }
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    let value: Value = serde_json::from_str(&text).map_err(|error| {
        wrong(format!(
            "{error}; it must be what a run printed with --json"
        ))
    })?;
    match value["pings_received"].is_u64() {
        true => Ok(value),
        false => Err(wrong(
            "it has no pings_received; it must be what a run printed with --json".to_owned(),
        )),
    }
}

fn recorded(paths: &[PathBuf]) -> anyhow::Result<Dive> {
    if let Some(path) = paths.iter().find(|path| !is_recording(path)) {
        return Err(Usage::error(format!(
            "--dive {}: it is no recording (.mcap) and not what a run printed with --json (.json)",
            path.display()
        )));
    }
    let scan: Scan = Recording::scan(paths).map_err(Usage::error)?;
    let settings = scan.settings.as_deref();
    // A recording of a replay has the time of that.
    let is_log = Begun::of(&scan).is_log;
    let began = scan.span.map(|(first, _)| first).filter(|_| !is_log);
    Ok(Dive {
        losses: scan.losses(false),
        run: scan.last_status.unwrap_or_default(),
        // Those of another version are not worth a report.
        settings: settings.and_then(|settings| toml::from_str(settings).ok()),
        poses: scan.poses.into_iter().map(|(pose, _)| pose).collect(),
        began,
    })
}

/// Of the vehicle; the sonar's own place on it is left out.
fn trajectory(poses: &[StampedPose]) -> Trajectory {
    let Some(first) = poses.first() else {
        return Trajectory::default();
    };
    let every = poses.len().div_ceil(MOST_POSES).max(1);
    let at = |pose: &StampedPose| {
        (
            pose.time.seconds_since(first.time),
            pose.world_from_vehicle.translation_m,
        )
    };
    Trajectory(poses.iter().step_by(every).map(at).collect())
}
