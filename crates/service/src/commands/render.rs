//! `echosplat render MAP.ply`: what a sonar would hear of a map, from any pose.

use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

use echosplat_join::StampClock;
use echosplat_mapper::geometry_of;
use echosplat_measurement::PingGeometry;
use echosplat_model::{Ping, PingSettings, PosedPing, StampedPose, Timestamp, Twist};
use echosplat_model::{Trajectory, TrajectoryLimits};
use echosplat_pose::{PoseSource, PoseUrl};
use echosplat_prediction::MapRenderer;
use echosplat_report::{Column, Panel, SonarImage};
use serde_json::{Value, json};

use crate::arguments::RenderArguments;
use crate::config::Config;
use crate::exit::{Finish, Usage};
use crate::logs;
use crate::thinned::Thinned;
use crate::{files, inputs, logging, maps};

/// Most pings of one image.
const MOST_VIEWS: usize = 1024;

/// One column of the image.
struct View {
    posed: PosedPing,
    /// Of the ping in its log, or of the pose in its file.
    number: u64,
    /// Where it lies from left to right.
    across: f64,
    /// Whether the log measured it.
    is_measured: bool,
}

/// # Errors
/// If a file is not what it should be, or nothing is left to be rendered.
pub(crate) fn run(arguments: &RenderArguments) -> anyhow::Result<Finish> {
    let config = configuration(arguments)?;
    let format = Format::of(arguments)?;
    let map = maps::read(&arguments.map)?;
    let views = views(arguments, &config)?;
    let mut renderer = MapRenderer::new(map.origin_m, map.intensity_unit, &map.gaussians);
    let rendered: Vec<Vec<f32>> = views
        .iter()
        .map(|view| {
            let mut geometry = geometry_of(&view.posed, renderer.origin_m(), &config.mapper);
            blur(&mut geometry, arguments);
            renderer.ping(&geometry).to_vec()
        })
        .collect();
    if let Some((path, format)) = &format {
        let image = image(arguments, config.mapper.blanking_m, &views, &rendered);
        write(path, *format, &image)?;
    }
    match arguments.json {
        true => logging::print(&summary(&views, &rendered).to_string()),
        false => logging::print(&format!("{} pings rendered", views.len())),
    }
    Ok(maps::finish_of(&map))
}

fn configuration(arguments: &RenderArguments) -> anyhow::Result<Config> {
    let config = match &arguments.config {
        Some(file) => Config::load(file)?,
        None => Config::default(),
    };
    config.mapper.check().map_err(Usage::error)?;
    Ok(config)
}

/// Adds what an uncertain pose would blur.
fn blur(geometry: &mut PingGeometry, arguments: &RenderArguments) {
    let attitude_sigma_rad = arguments.attitude_sigma_deg.to_radians();
    geometry.range_variance_m2 += arguments.position_sigma_m.powi(2) as f32;
    geometry.azimuth_variance_rad2 += attitude_sigma_rad.powi(2) as f32;
}

/// What the picture is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Png,
    Svg,
}

impl Format {
    fn of(arguments: &RenderArguments) -> anyhow::Result<Option<(&Path, Self)>> {
        let Some(out) = &arguments.out else {
            return match arguments.json {
                true => Ok(None),
                false => Err(Usage::error("give --out OUT.png or OUT.svg, or --json")),
            };
        };
        match out.extension().and_then(|extension| extension.to_str()) {
            Some("png") => Ok(Some((out, Self::Png))),
            Some("svg") => Ok(Some((out, Self::Svg))),
            _ => Err(Usage::error(format!(
                "--out {}: it must end in .png or .svg",
                out.display()
            ))),
        }
    }
}

/// The pings to be rendered, from left to right.
fn views(arguments: &RenderArguments, config: &Config) -> anyhow::Result<Vec<View>> {
    let chosen = match &arguments.log {
        Some(log) => of_log(log, arguments, config)?,
        None => of_poses(arguments, config)?,
    };
    if chosen.is_empty() {
        return Err(Usage::error(
            "no such ping: --at counts seconds from the first one that has its pose, --ping the \
             pings of the log, or the poses of the file, from 0",
        ));
    }
    match arguments.sweep_deg {
        Some(sweep_deg) => sweep(&chosen, sweep_deg, arguments.beams),
        None => Ok(chosen),
    }
}

/// Pings as measured, those that were asked for or an even choice of all.
fn of_log(log: &Path, arguments: &RenderArguments, config: &Config) -> anyhow::Result<Vec<View>> {
    let mut first: Option<Timestamp> = None;
    let mut chosen = Chosen::new(arguments);
    logs::posed_pings(log, arguments.poses.as_deref(), config, |posed| {
        let time = posed.ping.transmit_time();
        let across = time.seconds_since(*first.get_or_insert(time));
        let number = posed.ping.sequence();
        chosen.offer(number, across, || View {
            posed,
            number,
            across,
            is_measured: true,
        });
    })?;
    Ok(chosen.into_views())
}

/// Pings that nobody made, one for each pose or for each time asked for.
fn of_poses(arguments: &RenderArguments, config: &Config) -> anyhow::Result<Vec<View>> {
    // The command line has asked for them where there is no log.
    let Some(file) = &arguments.poses else {
        return Ok(Vec::new());
    };
    let url = PoseUrl::Tum(file.clone());
    let PoseSource::File(poses) = inputs::poses(&url, None, StampClock::Data)? else {
        return Ok(Vec::new());
    };
    let poses: Vec<StampedPose> = poses.collect();
    let Some(first) = poses.first().map(|pose| pose.time) else {
        return Ok(Vec::new());
    };
    let silent = silent_ping(arguments)?;
    let view = |number: u64, pose: &StampedPose| View {
        posed: posed(&silent, pose, config),
        number,
        across: pose.time.seconds_since(first),
        is_measured: false,
    };
    if !arguments.at.is_empty() {
        let mut trajectory = Trajectory::new(TrajectoryLimits {
            capacity: poses.len(),
            max_pose_gap_s: config.pose.max_pose_gap_s,
        });
        for pose in &poses {
            trajectory.push(*pose).map_err(Usage::error)?;
        }
        let at = |seconds: &f64| {
            let pose = trajectory.at(first.offset_by(*seconds));
            let pose = pose.map_err(|error| Usage::error(format!("--at {seconds}: {error}")))?;
            let number = poses.partition_point(|known| known.time < pose.time);
            Ok(view(number as u64, &pose))
        };
        return arguments.at.iter().map(at).collect();
    }
    let mut chosen = Chosen::new(arguments);
    for (pose, number) in poses.iter().zip(0..) {
        chosen.offer(number, pose.time.seconds_since(first), || {
            view(number, pose)
        });
    }
    Ok(chosen.into_views())
}

/// Collects what `--ping` and `--at` ask for, or an even choice of everything.
struct Chosen<'a> {
    pings: &'a [u64],
    times_s: &'a [f64],
    all: Thinned<View>,
    /// For each of `times_s`, the nearest so far and how far off it is.
    nearest: Vec<Option<(f64, View)>>,
}

impl<'a> Chosen<'a> {
    fn new(arguments: &'a RenderArguments) -> Self {
        Self {
            pings: &arguments.ping,
            times_s: &arguments.at,
            all: Thinned::new(MOST_VIEWS),
            nearest: arguments.at.iter().map(|_| None).collect(),
        }
    }

    fn offer(&mut self, number: u64, at_s: f64, view: impl FnOnce() -> View) {
        if !self.times_s.is_empty() {
            let off_s = |wanted: f64| (wanted - at_s).abs();
            let is_nearer = |(slot, wanted): (&Option<(f64, View)>, &f64)| {
                slot.as_ref().is_none_or(|(best, _)| off_s(*wanted) < *best)
            };
            let places = self.nearest.iter().zip(self.times_s).map(is_nearer);
            let places: Vec<bool> = places.collect();
            if places.contains(&true) {
                let view = view();
                for ((slot, wanted), _) in self
                    .nearest
                    .iter_mut()
                    .zip(self.times_s)
                    .zip(places)
                    .filter(|(_, nearer)| *nearer)
                {
                    *slot = Some((off_s(*wanted), view.again()));
                }
            }
        } else if self.pings.is_empty() || self.pings.contains(&number) {
            self.all.push(view);
        }
    }

    fn into_views(self) -> Vec<View> {
        match self.times_s.is_empty() {
            true => self.all.into_kept(),
            false => {
                let nearest = self.nearest.into_iter().flatten();
                nearest.map(|(_, view)| view).collect()
            }
        }
    }
}

impl View {
    fn again(&self) -> Self {
        Self {
            posed: self.posed.clone(),
            ..*self
        }
    }
}

/// A ping with the settings of the command line that heard nothing.
fn silent_ping(arguments: &RenderArguments) -> anyhow::Result<Arc<Ping>> {
    let settings = PingSettings {
        range_start_m: arguments.start_m,
        range_length_m: arguments.range_m - arguments.start_m,
        bin_count: arguments.bins,
        speed_of_sound_mps: arguments.speed_of_sound,
        frequency_hz: 0.0,
        pulse_duration_s: 1e-6 * arguments.pulse_us,
        gain_index: 0,
    };
    // Settings are judged before bins are made.
    settings.check().map_err(Usage::error)?;
    let silence = vec![0.0; settings.bin_count];
    let ping = Ping::new(0, Timestamp::ZERO, settings, silence).map_err(Usage::error)?;
    Ok(Arc::new(ping))
}

/// A sensor at rest.
fn posed(ping: &Arc<Ping>, pose: &StampedPose, config: &Config) -> PosedPing {
    let settings = ping.settings();
    PosedPing {
        world_from_sensor: pose.world_from_vehicle * config.pose.vehicle_from_sensor.pose(),
        twist: Twist::default(),
        reference_range_m: settings.range_start_m + 0.5 * settings.range_length_m,
        uncertainty: None,
        jitter: None,
        ping: Arc::clone(ping),
    }
}

/// Beams side by side from one pose, from left to right as the sensor sees them.
fn sweep(chosen: &[View], sweep_deg: f64, beams: u32) -> anyhow::Result<Vec<View>> {
    let [view] = chosen else {
        return Err(Usage::error(format!(
            "--sweep-deg needs one pose, not {}: choose it by --at or --ping",
            chosen.len()
        )));
    };
    let beam = |index: u32| {
        let share = (f64::from(index) + 0.5) / f64::from(beams);
        let azimuth_deg = sweep_deg * (0.5 - share);
        let azimuth_rad = (azimuth_deg * PI / 180.0) as f32;
        let ping = Ping::clone(&view.posed.ping).with_beam(azimuth_rad, 0);
        View {
            posed: PosedPing {
                ping: Arc::new(ping),
                twist: Twist::default(),
                ..view.posed.clone()
            },
            number: view.number,
            across: azimuth_deg,
            is_measured: false,
        }
    };
    Ok((0..beams).map(beam).collect())
}

fn image(
    arguments: &RenderArguments,
    blanking_m: f64,
    views: &[View],
    rendered: &[Vec<f32>],
) -> SonarImage {
    // The ring of the transducer would outshine all echoes.
    let column = |view: &View, intensity: &[f32]| {
        let settings = view.posed.ping.settings();
        let blank_m = if view.is_measured { blanking_m } else { 0.0 };
        let blank = (blank_m - settings.range_start_m) / settings.bin_length_m();
        let blank = (blank.ceil().max(0.0) as usize).min(intensity.len());
        let range_start_m = settings.bin_edge_m(blank);
        Column {
            range_start_m,
            range_length_m: settings.range_end_m() - range_start_m,
            intensity: intensity[blank..].to_vec(),
        }
    };
    let mut panels = Vec::new();
    if views.iter().all(|view| view.is_measured) {
        let measured = views.iter();
        let measured = measured.map(|view| column(view, view.posed.ping.intensity()));
        panels.push(Panel {
            title: "measured".to_owned(),
            columns: measured.collect(),
        });
    }
    let predicted = views.iter().zip(rendered);
    panels.push(Panel {
        title: "predicted by the map, without noise".to_owned(),
        columns: predicted.map(|(view, i)| column(view, i)).collect(),
    });
    let ends = [views.first(), views.last()];
    SonarImage {
        title: format!("{}: {} pings", arguments.map.display(), views.len()),
        panels,
        across: match arguments.sweep_deg {
            Some(_) => "azimuth, degrees, left positive".to_owned(),
            None => "time, seconds".to_owned(),
        },
        across_limits: ends.map(|view| view.map_or(0.0, |view| view.across)),
        notes: Vec::new(),
    }
}

fn write(path: &Path, format: Format, image: &SonarImage) -> anyhow::Result<()> {
    let bytes = match format {
        Format::Png => image.to_png(),
        Format::Svg => image.to_svg().into_bytes(),
    };
    write_picture(path, &bytes)
}

/// Writes a picture, its directory included.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn write_picture(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    files::write("picture", path, bytes)
}

fn summary(views: &[View], rendered: &[Vec<f32>]) -> Value {
    let ping = |(view, predicted): (&View, &Vec<f32>)| {
        let ping = &view.posed.ping;
        let pose = &view.posed.world_from_sensor;
        json!({
            "number": view.number,
            "across": view.across,
            "beam_azimuth_rad": ping.beam_azimuth_rad(),
            "position_m": pose.translation_m.to_array(),
            "orientation_xyzw": pose.rotation.to_array(),
            "settings": ping.settings(),
            "measured": view.is_measured.then(|| ping.intensity()),
            "predicted": predicted,
        })
    };
    let pings = views.iter().zip(rendered).map(ping);
    json!({ "pings": pings.collect::<Vec<Value>>() })
}
