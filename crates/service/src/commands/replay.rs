//! `echosplat replay`: the pipeline from logs.

use std::path::{Path, PathBuf};

use echosplat_pose::PoseUrl;
use echosplat_report::table;
use serde_json::Value;

use crate::arguments::ReplayArguments;
use crate::commands::dive_report::{self, Heading};
use crate::commands::judging::{Judge, TruthOf};
use crate::commands::show_figures;
use crate::config::{Config, MOST_OFFSET_S, Overrides};
use crate::exit::{Finish, Usage};
use crate::pipeline::{
    self, Album, Expectations, Finding, Gate, Hooks, Outcome, Pace, Part, PoseReport, Setup,
    Shedding, Span,
};
use crate::replayed::Replayed;
use crate::signals::Stop;
use crate::web::Page;
use crate::{clock, files, inputs, log_clock, logging, maps, truth};

/// # Errors
/// If something asked for cannot be, or the map cannot be written.
pub(crate) fn run(arguments: &ReplayArguments) -> anyhow::Result<Finish> {
    check_part(arguments)?;
    let replayed = Replayed::open(&arguments.logs)?;
    for loss in replayed.losses() {
        tracing::warn!("{loss}");
    }
    let mut config = configuration(arguments, &replayed)?;
    let known = log_clock_of(arguments, &mut config)?;
    if let Some(map) = &config.output.map {
        maps::prepare(map)?;
    }
    let report = report_path(arguments, &config);
    if let Some(report) = &report {
        files::prepare("--report", report)?;
    }
    let stop = Stop::on_signals()?;
    let page = Page::start(&config)?;
    let mut epoch = clock::now().nanos().unsigned_abs();
    loop {
        let judge = judge(arguments, &config, report.as_deref(), page.as_ref())?;
        let outcome = once(
            arguments,
            &replayed,
            (&config, epoch),
            &known,
            (judge.as_ref(), page.as_ref()),
            &stop,
        )?;
        let is_last = !arguments.repeat || stop.is_set();
        if is_last {
            let finish = conclude(arguments, &config, &outcome, judge, report.as_deref())?;
            if let Some(page) = page {
                page.stay(&stop);
            }
            return Ok(finish);
        }
        epoch += 1;
    }
}

/// A recording is replayed with the settings of its dive, unless a file gives others.
fn configuration(arguments: &ReplayArguments, replayed: &Replayed) -> anyhow::Result<Config> {
    let base = match arguments.service.config {
        Some(_) => None,
        None => replayed.settings().map(Config::of_recording).transpose()?,
    };
    let overrides = Overrides {
        base,
        pose: asked_poses(arguments),
        time_offset_s: arguments.time_offset_s,
        ..Overrides::default()
    };
    let mut config = Config::assemble(&arguments.service, overrides)?;
    config.mapper.live_map &= !arguments.finished_only;
    if arguments.service.bus.node.is_none() {
        // A service of the vehicle's own name may be running.
        config.bus.node = "replay".to_owned();
    }
    Ok(config)
}

/// Of logs with a file of poses on a clock of their own; an offset that is given is taken as it is.
fn log_clock_of(arguments: &ReplayArguments, config: &mut Config) -> anyhow::Result<Vec<Finding>> {
    let is_given = arguments.time_offset_s.is_some() || config.pose.time_offset_s.abs() > 0.0;
    let file = match poses_url(arguments, config) {
        Some(PoseUrl::Tum(file)) if !is_given => file,
        _ => return Ok(Vec::new()),
    };
    let found = log_clock::adjust(&arguments.logs, &file, config)?;
    Ok(found.into_iter().collect())
}

/// Poses as the command line asks for them.
fn asked_poses(arguments: &ReplayArguments) -> Option<PoseUrl> {
    let file = arguments.poses.as_ref();
    file.map(|file| PoseUrl::Tum(file.clone()))
        .or_else(|| arguments.pose.clone())
}

/// As the command line asks, or as a configuration file that names a file of them.
fn poses_url(arguments: &ReplayArguments, config: &Config) -> Option<PoseUrl> {
    let of_file = Some(config.pose.url.clone()).filter(|url| {
        arguments.service.config.is_some() && matches!(url, PoseUrl::Tum(_) | PoseUrl::None)
    });
    asked_poses(arguments).or(of_file)
}

/// Where `--report` says or, with a truth, beside the map.
fn report_path(arguments: &ReplayArguments, config: &Config) -> Option<PathBuf> {
    let output = &config.output;
    let beside = || output.map.as_ref().map(|map| map.with_extension("html"));
    let judged = output.truth.as_ref().and_then(|_| beside());
    arguments.report.clone().or(judged)
}

/// With `--json`, standard output is one object and nothing else.
fn judge(
    arguments: &ReplayArguments,
    config: &Config,
    report: Option<&Path>,
    page: Option<&Page>,
) -> anyhow::Result<Option<Judge>> {
    let truth = match &config.output.truth {
        Some(path) => Some(truth::load(path)?),
        None => None,
    };
    if truth.is_none() && report.is_none() {
        return Ok(None);
    }
    let truth = truth.map(|truth| -> TruthOf { Box::new(move || truth) });
    Judge::start(truth, !arguments.json, page.map(Page::feed)).map(Some)
}

fn once(
    arguments: &ReplayArguments,
    replayed: &Replayed,
    (config, epoch): (&Config, u64),
    known: &[Finding],
    (judge, page): (Option<&Judge>, Option<&Page>),
    stop: &Stop,
) -> anyhow::Result<Outcome> {
    let poses_url = poses_url(arguments, config);
    let takes_poses_live = poses_url.as_ref().is_some_and(is_live);
    let bus = match arguments.publish || takes_poses_live {
        true => Some(inputs::open_bus(config.bus.clone())?),
        false => None,
    };
    if let Some(bus) = &bus {
        inputs::refuse_a_second_service(bus, Part::Whole.roles())?;
    }
    let inputs = replayed.inputs(config, arguments.rate);
    let session = &inputs[0].config.session;
    let recorder = inputs::recorder(config, session, true)?;
    if let Some(page) = page {
        page.control(recorder.as_ref());
        page.control_replay(replayed.pause());
    }
    let asked = poses_url.as_ref();
    let (source, losses_of_poses) = replayed.pose_source(asked, bus.as_deref())?;
    let places = replayed.places(asked, config, &source);
    let poses = replayed.judged(source, asked, config, recorder.clone())?;
    let setup = Setup {
        part: Part::Whole,
        inputs,
        poses,
        gate: Gate::new(arguments.start, arguments.end, config.output.duration_s).taking_once(),
        losses: [replayed.losses(), losses_of_poses].concat(),
        places,
        bus: bus.clone().filter(|_| arguments.publish),
        recorder,
        shedding: Shedding::as_before(replayed.decided()),
        epoch,
        expectations: Expectations {
            sonar: arguments.logs[0].display().to_string(),
            pace: match arguments.rate > 0.0 {
                true => Pace::Replayed,
                false => Pace::AsMapped,
            },
            ping_interval_s: 0.0,
            range_m: [0.0; 2],
        },
        hooks: Hooks {
            observer: judge
                .filter(|_| config.mapper.live_map)
                .map(Judge::observer),
            way: judge.map(Judge::way),
            album: Album::parse(arguments.service.maps_every.as_deref())?,
            on_status: Some(show_figures()),
            page: page.map(Page::feed),
            page_heartbeats: page.map(Page::heartbeats).unwrap_or_default(),
            known: known.to_vec(),
            ..Hooks::default()
        },
    };
    let outcome = pipeline::run(config, setup, stop);
    inputs::close_bus(bus);
    let outcome = outcome?;
    if stop.is_set() {
        return Ok(outcome);
    }
    if all_are_early(&outcome) {
        return Err(Usage::error(no_ping_from(arguments)));
    }
    if outcome.status.pings_received == 0 {
        return Err(Usage::error(no_ping_in(arguments)));
    }
    match !takes_poses_live && nothing_overlaps(&outcome) {
        true => Err(Usage::error(no_time_in_common(arguments, &outcome, config))),
        false => Ok(outcome),
    }
}

/// The part of the log that is asked for has a length.
fn check_part(arguments: &ReplayArguments) -> anyhow::Result<()> {
    match (arguments.start, arguments.end) {
        (Some(start), Some(end)) if start >= end => Err(Usage::error(format!(
            "--start {start} --end {end}: nothing lies between; give an end after the start"
        ))),
        _ => Ok(()),
    }
}

/// Whether the log ends before the part that is asked for begins.
fn all_are_early(outcome: &Outcome) -> bool {
    let report = &outcome.status.report;
    report.pings_before_start > 0
        && report.pings_before_start + report.pings_shed == report.pings_taken
}

fn no_ping_from(arguments: &ReplayArguments) -> String {
    let (start, log) = (arguments.start.unwrap_or(0.0), arguments.logs[0].display());
    format!(
        "--start {start}: all pings of {log} are earlier; `echosplat info {log}` says how long it is"
    )
}

fn no_ping_in(arguments: &ReplayArguments) -> String {
    let log = arguments.logs[0].display();
    format!(
        "{log} holds no ping, so there is nothing to map; `echosplat info {log}` says what it holds"
    )
}

/// Whether poses come from somebody who sends them meanwhile.
fn is_live(url: &PoseUrl) -> bool {
    !matches!(url, PoseUrl::Tum(_) | PoseUrl::Log(_) | PoseUrl::None)
}

/// Why no ping has a pose: stamps that say no time, poses too far apart, or two times. Of these both spans, and the
/// offset that would join their beginnings.
fn no_time_in_common(arguments: &ReplayArguments, outcome: &Outcome, config: &Config) -> String {
    let poses = &outcome.status.report.poses;
    let given = asked_poses(arguments).map_or("the log".to_owned(), |url| url.to_string());
    let stamps = pipeline::no_time(poses)
        .or_else(|| of_one_time(poses))
        .map(|why| (why, true))
        .or_else(|| {
            let why = too_far_apart(poses, config.pose.max_pose_gap_s)?;
            Some((why, have_time_in_common(poses)))
        });
    let besides = match stamps {
        Some((why, true)) => return format!("the poses of {given}: {why}"),
        Some((why, false)) => format!("; {why}"),
        None => String::new(),
    };
    let span = |span: Option<Span>| {
        span.map_or("none".to_owned(), |span| {
            let [first_s, last_s] = [span.first_ns, span.last_ns].map(|ns| ns as f64 * 1e-9);
            format!("{first_s:.3} to {last_s:.3} s")
        })
    };
    let offset = poses
        .pose_times
        .zip(poses.ping_times)
        .map(|(poses, pings)| {
            let offset_s = poses.first_ns.saturating_sub(pings.first_ns) as f64 * 1e-9;
            match offset_s.abs() <= MOST_OFFSET_S {
                true => format!(
                    "; --time-offset-s {offset_s:.3} would join their beginnings, which is right if both began together"
                ),
                false => "; one of the two clocks tells no time".to_owned(),
            }
        });
    format!(
        "the poses of {given} ({}) and the pings of {} ({}) have no time in common{}{besides}",
        span(poses.pose_times),
        arguments.logs[0].display(),
        span(poses.ping_times),
        offset.unwrap_or_default()
    )
}

fn have_time_in_common(poses: &PoseReport) -> bool {
    let times = poses.pose_times.zip(poses.ping_times);
    times.is_some_and(|(poses, pings)| {
        poses.first_ns <= pings.last_ns && pings.first_ns <= poses.last_ns
    })
}

/// Poses that all bear one stamp, of which but the first is taken.
fn of_one_time(poses: &PoseReport) -> Option<String> {
    let span = poses.pose_times?;
    let refused = poses.join.poses_out_of_order;
    (span.first_ns == span.last_ns && refused > 0).then(|| {
        format!(
            "all {} of them are stamped {:.3} s; each needs the time at which the vehicle was there, on the clock of the \
             pings",
            refused + poses.join.poses_taken,
            span.first_ns as f64 * 1e-9
        )
    })
}

/// Poses among the pings, none of which lie near enough together; mostly their stamps are in another unit.
fn too_far_apart(poses: &PoseReport, max_gap_s: f64) -> Option<String> {
    let span = poses.pose_times.filter(|_| poses.join.pings_in_gap > 0)?;
    let steps = poses
        .join
        .poses_taken
        .checked_sub(1)
        .filter(|steps| *steps > 0)?;
    let apart_s = span.last_ns.saturating_sub(span.first_ns) as f64 * 1e-9 / steps as f64;
    let unit = match apart_s {
        _ if apart_s <= max_gap_s => return None,
        ..1e3 => "milliseconds",
        ..1e6 => "microseconds",
        _ => "nanoseconds",
    };
    Some(format!(
        "they lie {apart_s:.1} s apart, and only {max_gap_s} s are interpolated across (pose.max_pose_gap_s): if \
         their times are {unit}, write seconds"
    ))
}

fn nothing_overlaps(outcome: &Outcome) -> bool {
    let report = &outcome.status.report;
    report.pings_mapped == 0 && report.poses.join.pings_without_pose() > 0
}

fn conclude(
    arguments: &ReplayArguments,
    config: &Config,
    outcome: &Outcome,
    judge: Option<Judge>,
    report: Option<&Path>,
) -> anyhow::Result<Finish> {
    let mut summary = outcome.status.summary();
    summary["metrics"] = Value::Null;
    if let Some(judge) = judge {
        let verdict = judge.finish(outcome, config.sonar.seed)?;
        if let Some(report) = report {
            let page = dive_report::html(heading(arguments, config), outcome, &verdict, &summary);
            files::write("--report", report, page.as_bytes())?;
            tracing::info!(report = %report.display(), "report written");
        }
        if let Some(found) = &verdict.against_truth {
            for (name, value) in table::facts(&found.metrics) {
                tracing::info!("{name}: {value}");
            }
            summary["metrics"] = serde_json::to_value(found.metrics)?;
        }
    }
    match arguments.json {
        true => logging::print(&summary.to_string()),
        false => logging::print(&outcome.status.account()),
    }
    Ok(outcome.finish())
}

fn heading<'a>(arguments: &ReplayArguments, config: &'a Config) -> Heading<'a> {
    let names = arguments.logs.iter();
    let names: Vec<String> = names
        .filter_map(|log| Some(log.file_name()?.to_string_lossy().into_owned()))
        .collect();
    Heading {
        title: format!("EchoSplat replay: {}", names.join(", ")),
        settings: Some(config),
        text: "echosplat replay: the pipeline from logs. Maps made only to be judged count neither as work nor as \
               time."
            .to_owned(),
        seed: None,
    }
}
