//! `echosplat evaluate MAP.ply`: against a truth, against pings that were kept from it, or both.

use std::path::Path;

use echosplat_metrics::{
    MapPoints, certainty, evaluate, evaluate_aligned, evaluate_mesh, mesh_places,
};
use echosplat_model::PosedPing;
use echosplat_prediction::held_out::{HeldOut, Pair, is_fitted_on, is_held_out, score};
use echosplat_prediction::{MapRenderer, blank_bins, pair_of};
use echosplat_recording::ply::MapFile;
use echosplat_report::table::{self, significant};
use echosplat_report::{Column, Panel, SonarImage};
use serde_json::{Map, Value};

use crate::arguments::EvaluateArguments;
use crate::commands::render::write_picture;
use crate::config::Config;
use crate::exit::{Finish, Usage};
use crate::logs;
use crate::thinned::Thinned;
use crate::{logging, maps, truth};

/// Most held-out pings scored, and most others the fit is made on.
const MOST_PINGS: usize = 8192;

/// # Errors
/// If map, truth or log cannot be read, or no ping was held out.
pub(crate) fn run(arguments: &EvaluateArguments) -> anyhow::Result<Finish> {
    let map = maps::read(&arguments.map)?;
    let mut said = Value::Object(Map::new());
    if let Some(path) = &arguments.truth {
        let truth = truth::load(path)?;
        let points = MapPoints::new(map.origin_m, &map.gaussians);
        let metrics = evaluate(&points, &truth);
        if !arguments.json {
            logging::print(table::metrics(&metrics).trim_end());
        }
        said = serde_json::to_value(metrics)?;
        if arguments.aligned
            && let Some(aligned) = evaluate_aligned(&points, &truth)
        {
            if !arguments.json {
                logging::print(table::aligned_map(&aligned).trim_end());
            }
            said["aligned"] = serde_json::to_value(aligned)?;
        }
        if let Some(found) = certainty(map.origin_m, &map.gaussians, &truth) {
            if !arguments.json {
                logging::print(table::certainty(&found).trim_end());
            }
            said["certainty"] = serde_json::to_value(found)?;
        }
        if let Some(path) = &arguments.mesh {
            // Its errors name the file.
            let places = mesh_places(path).map_err(Usage::error)?;
            let metrics = evaluate_mesh(&places, &points, &truth);
            if !arguments.json {
                logging::print(table::mesh(&metrics).trim_end());
            }
            said["mesh"] = serde_json::to_value(metrics)?;
        }
    }
    if let (Some(asked), Some(log)) = (arguments.held_out, &arguments.log) {
        let every = held_out_every(&arguments.map, &map, asked)?;
        let config = match &arguments.config {
            Some(file) => Config::load(file)?,
            None => Config::default(),
        };
        let pings = rendered(&map, every, log, arguments.poses.as_deref(), &config)?;
        let found = score_of(&pings, log, every)?;
        if let Some(path) = &arguments.picture {
            write_picture(path, picture(&pings.held, &found).to_svg().as_bytes())?;
        }
        if !arguments.json {
            logging::print(&account(&found));
        }
        said["held_back"] = serde_json::to_value(found)?;
    }
    if arguments.json {
        logging::print(&said.to_string());
    }
    Ok(maps::finish_of(&map))
}

/// Which pings were kept from the map, by the map's own word: a score on pings that it was made of
/// says nothing of others.
///
/// # Errors
/// If the map says nothing, or something else than was asked for.
fn held_out_every(path: &Path, map: &MapFile, asked: Option<u64>) -> anyhow::Result<u64> {
    let refused = |why: String| Err(Usage::error(format!("map {}: {why}", path.display())));
    match (map.notes.held_out_every, asked) {
        (0, _) => refused(
            "it does not say that pings were kept from it, so all may be in it; make it with \
             --hold-out N, then --held-out scores those"
                .to_owned(),
        ),
        (kept, Some(asked)) if asked != kept => refused(format!(
            "of every {kept} pings one was kept from it, so --held-out {asked} would score pings \
             that it was made of; allowed is --held-out {kept}, or --held-out alone"
        )),
        (kept, _) => Ok(kept),
    }
}

/// One ping beside what the map says of it, without its blanked bins.
pub(super) struct Rendered {
    at_s: f64,
    /// Near edge of the first bin that counts.
    range_start_m: f64,
    range_length_m: f64,
    pub(super) pair: Pair,
}

struct RenderedPings {
    held: Vec<Rendered>,
    /// Of the map's own pings as many, halfway between the held ones.
    fit: Vec<Rendered>,
}

fn rendered(
    map: &MapFile,
    every: u64,
    log: &Path,
    poses: Option<&Path>,
    config: &Config,
) -> anyhow::Result<RenderedPings> {
    let mut renderer = MapRenderer::new(map.origin_m, map.intensity_unit, &map.gaussians);
    let [mut held, mut fit] = [Thinned::new(MOST_PINGS), Thinned::new(MOST_PINGS)];
    let mut first = None;
    logs::posed_pings(log, poses, config, |posed| {
        let time = posed.ping.transmit_time();
        let at_s = time.seconds_since(*first.get_or_insert(time));
        let sequence = posed.ping.sequence();
        let render = || render(&mut renderer, &posed, at_s, config);
        if is_held_out(sequence, every) {
            held.push(render);
        } else if is_fitted_on(sequence, every) {
            fit.push(render);
        }
    })?;
    Ok(RenderedPings {
        held: held.into_kept(),
        fit: fit.into_kept(),
    })
}

pub(super) fn render(
    renderer: &mut MapRenderer,
    posed: &PosedPing,
    at_s: f64,
    config: &Config,
) -> Rendered {
    let settings = posed.ping.settings();
    let range_start_m = settings.bin_edge_m(blank_bins(settings, &config.mapper));
    Rendered {
        at_s,
        range_start_m,
        range_length_m: settings.range_end_m() - range_start_m,
        pair: pair_of(renderer, posed, &config.mapper),
    }
}

fn score_of(pings: &RenderedPings, log: &Path, every: u64) -> anyhow::Result<HeldOut> {
    let pairs = |all: &[Rendered]| all.iter().map(|one| one.pair.clone()).collect::<Vec<_>>();
    score(&pairs(&pings.fit), &pairs(&pings.held)).ok_or_else(|| {
        Usage::error(format!(
            "log {}: of its pings with a pose, {} are held out by {every} and {} are not; both \
             must be there, and something heard",
            log.display(),
            pings.held.len(),
            pings.fit.len()
        ))
    })
}

fn picture(held: &[Rendered], found: &HeldOut) -> SonarImage {
    let column = |one: &Rendered, intensity: Vec<f32>| Column {
        range_start_m: one.range_start_m,
        range_length_m: one.range_length_m,
        intensity,
    };
    let measured = held
        .iter()
        .map(|one| column(one, one.pair.measured.clone()));
    let predicted = held.iter().map(|one| {
        let rendered = one.pair.rendered.iter();
        column(one, rendered.map(|&i| found.predicted(i)).collect())
    });
    let panel = |title: &str, columns| Panel {
        title: title.to_owned(),
        columns,
    };
    let ends = [held.first(), held.last()];
    SonarImage {
        title: format!("{} pings that the map was not made of", found.ping_count),
        panels: vec![
            panel("measured", measured.collect()),
            panel(
                "predicted by the map, with its noise floor",
                predicted.collect(),
            ),
        ],
        across: "time, seconds".to_owned(),
        across_limits: ends.map(|one| one.map_or(0.0, |one| one.at_s)),
        notes: account(found).lines().map(str::to_owned).collect(),
    }
}

fn account(found: &HeldOut) -> String {
    let HeldOut { map, constant, .. } = found;
    format!(
        "{} held-out pings, {} bins: {:+.4} nats per bin against a constant\n\
         the map: log likelihood {:.4} per bin ({} looks), L1 {}; gain {:.3}, noise floor {}\n\
         a constant of {}: log likelihood {:.4} per bin ({} looks), L1 {}",
        found.ping_count,
        found.bin_count,
        found.gain_per_bin,
        map.log_likelihood_per_bin,
        rounded(map.looks),
        significant(map.l1, 5),
        found.gain,
        significant(found.noise_floor, 4),
        significant(found.constant_level, 4),
        constant.log_likelihood_per_bin,
        rounded(constant.looks),
        significant(constant.l1, 5),
    )
}

fn rounded(looks: f64) -> f64 {
    (looks * 100.0).round() / 100.0
}
