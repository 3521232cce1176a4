//! From URLs and paths to what the pipeline takes: drivers, poses, the bus, the recorder.

use std::io::BufReader;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use echosplat_bus::{Bus, BusConfig, BusError};
use echosplat_driver::{DriverConfig, SonarUrl};
use echosplat_join::StampClock;
use echosplat_pose::{GnssSource, GnssUrl, PoseSource, PoseSourceError, PoseUrl};
use echosplat_recording::foreign;
use echosplat_recording::svlog::LogClock;
use echosplat_recording::svlog::SvlogReader;
use echosplat_session::{ClockSource, SessionConfig};
use serde_json::Value;

use crate::config::Config;
use crate::exit::Usage;
use crate::recorder::{BEGIN, Recorder, RecorderConfig};
use crate::runtime;
use crate::split::Begin;

/// A sonar's URL.
///
/// # Errors
/// Says what is wrong with it and what would be right.
pub(crate) fn sonar_url(text: &str) -> anyhow::Result<SonarUrl> {
    text.parse().map_err(Usage::error)
}

/// How the link to `url` is kept; a log is on its own clock.
pub(crate) fn driver(config: &Config, url: SonarUrl) -> DriverConfig {
    let clock = match url {
        SonarUrl::File(_) | SonarUrl::Sim(_) => ClockSource::Device,
        _ => config.session.clock,
    };
    DriverConfig {
        session: SessionConfig {
            clock,
            ..config.session.clone()
        },
        io_timeout_s: config.sonar.io_timeout_s,
        reconnect_min_s: config.sonar.reconnect_min_s,
        reconnect_max_s: config.sonar.reconnect_max_s,
        silence_timeout_s: config.sonar.silence_timeout_s,
        ..DriverConfig::new(url)
    }
}

/// Refuses what is no log before anything is started. It is read again later: a pipe is none.
///
/// # Errors
/// Says what the file is instead.
pub(crate) fn check_log(path: &Path) -> anyhow::Result<()> {
    let refused =
        |error: &dyn std::fmt::Display| Usage::error(format!("log {}: {error}", path.display()));
    let file = echosplat_input::open_file(path).map_err(|error| refused(&error))?;
    SvlogReader::new(BufReader::new(file)).map_err(|error| refused(&error))?;
    Ok(())
}

/// Refuses a file that another program packed or wrote, and says what makes one that is read of it.
/// What is no regular file is somebody else's to refuse.
///
/// # Errors
/// If it is one.
pub(crate) fn refuse_foreign(path: &Path) -> anyhow::Result<()> {
    let opened = echosplat_input::open_file(path).ok();
    match opened.and_then(|file| foreign::of_file(&file, path)) {
        Some(what) => Err(Usage::error(format!("{}: {what}", path.display()))),
        None => Ok(()),
    }
}

/// Whether a file holds nothing at all.
pub(crate) fn is_empty(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|metadata| metadata.len() == 0)
}

/// Opens a source of poses. A file is read whole. `stamps` is the clock of the pings.
///
/// # Errors
/// If the file is wrong, or there is no bus to take poses from.
pub(crate) fn poses(
    url: &PoseUrl,
    bus: Option<&Bus>,
    clock: StampClock,
) -> anyhow::Result<PoseSource> {
    let runtime = runtime::handle()?;
    PoseSource::open(&runtime, url, bus, clock).map_err(|error| match error {
        PoseSourceError::Bus(error) => anyhow::Error::new(error),
        PoseSourceError::NoBus => Usage::error(format!(
            "poses from {url} need the bus: give --poses F.tum instead"
        )),
        wrong => Usage::error(wrong),
    })
}

/// Begins to listen to a satellite receiver.
///
/// # Errors
/// If a topic of ROS is named and the bus refuses.
pub(crate) fn gnss(url: &GnssUrl, bus: &Bus) -> anyhow::Result<GnssSource> {
    let source = GnssSource::open(&runtime::handle()?, url, Some(bus));
    source.with_context(|| format!("georeference.gnss = \"{url}\""))
}

/// How long others may take to answer that they are there.
const OTHERS_ANSWER: Duration = Duration::from_millis(500);

/// Two services of one name would publish under one key and mix their poses.
///
/// # Errors
/// If a service of this node is there already in one of these roles.
pub(crate) fn refuse_a_second_service(bus: &Bus, roles: &[&str]) -> anyhow::Result<()> {
    match bus.service_alive_elsewhere(roles, OTHERS_ANSWER)? {
        None => Ok(()),
        Some(other) => Err(Usage::error(format!("{other} (--node)"))),
    }
}

/// Opens the bus and says where it leads.
///
/// # Errors
/// If a setting is wrong (then it is the user's), or zenoh fails.
pub(crate) fn open_bus(config: BusConfig) -> anyhow::Result<Arc<Bus>> {
    let bus = Bus::open(config).map_err(|error| match error {
        BusError::Config { .. }
        | BusError::ConfigFile { .. }
        | BusError::ZenohSetting { .. }
        | BusError::Endpoint { .. } => Usage::error(error),
        other => anyhow::Error::new(other),
    })?;
    tracing::info!(
        keys = bus.keys().alive().trim_end_matches("/alive"),
        "zenoh: {}",
        bus.endpoints()
    );
    Ok(Arc::new(bus))
}

/// Closes the bus within its limit, once nothing else holds it.
pub(crate) fn close_bus(bus: Option<Arc<Bus>>) {
    if let Some(bus) = bus.and_then(Arc::into_inner)
        && let Err(error) = bus.close()
    {
        tracing::warn!(%error, "zenoh");
    }
}

/// Where recordings go that the page begins, if nothing else is configured.
const RECORDINGS: &str = "recordings";

/// Starts the recording, if one is asked for, with the configuration in force and how the bytes are
/// to be read: as `session` has it, of a log or of a link. With a page there is a recorder too, which
/// waits to be begun.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn recorder(
    config: &Config,
    session: &SessionConfig,
    is_log: bool,
) -> anyhow::Result<Option<Recorder>> {
    let log_clock = match is_log {
        true => LogClock::Kept,
        false => live_clock(session),
    };
    let begin = serde_json::json!({ "event": BEGIN, "is_log": is_log, "session": session });
    begin_recorder(config, log_clock, begin)
}

/// The same for a driver, or for a mapper of what one hears.
///
/// # Errors
/// As [`recorder`].
pub(crate) fn recorder_of_tape(config: &Config, begin: &Begin) -> anyhow::Result<Option<Recorder>> {
    begin_recorder(config, live_clock(&begin.session), begin.to_value())
}

fn live_clock(session: &SessionConfig) -> LogClock {
    match session.clock {
        ClockSource::Host => LogClock::Host,
        ClockSource::Device => LogClock::Device,
    }
}

fn begin_recorder(
    config: &Config,
    log_clock: LogClock,
    mut begin: Value,
) -> anyhow::Result<Option<Recorder>> {
    let asked = config.output.record.as_deref();
    if asked.is_none() && config.web.address.is_none() {
        return Ok(None);
    }
    begin["program"] = env!("CARGO_PKG_VERSION").into();
    let directory = asked.unwrap_or(Path::new(RECORDINGS));
    let settings = toml::to_string(config).context("the configuration as TOML")?;
    let recorder_config = RecorderConfig {
        rotate_bytes: config.output.record_rotate_bytes,
        format: config.output.record_format,
        log_clock,
    };
    let recorder = Recorder::idle(directory, recorder_config, settings, Some(begin));
    if asked.is_some() {
        recorder.begin()?;
    }
    Ok(Some(recorder))
}
