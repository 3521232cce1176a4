//! From URLs and paths to what the pipeline takes: drivers, poses, the bus, the recorder.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use echosplat_bus::{Bus, BusConfig, BusError};
use echosplat_driver::{DriverConfig, SonarUrl};
use echosplat_pose::{PoseSource, PoseSourceError, PoseUrl};
use echosplat_recording::svlog::SvlogReader;
use echosplat_session::{ClockSource, SessionConfig};

use crate::config::Config;
use crate::exit::Usage;
use crate::recorder::Recorder;

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

/// Refuses what is no log before anything is started.
///
/// # Errors
/// Says what the file is instead.
pub(crate) fn check_log(path: &Path) -> anyhow::Result<()> {
    let refused =
        |error: &dyn std::fmt::Display| Usage::error(format!("log {}: {error}", path.display()));
    let file = File::open(path).map_err(|error| refused(&error))?;
    SvlogReader::new(BufReader::new(file)).map_err(|error| refused(&error))?;
    Ok(())
}

/// Opens a source of poses. A file is read whole.
///
/// # Errors
/// If the file is wrong, or there is no bus to take poses from.
pub(crate) fn poses(url: &PoseUrl, bus: Option<&Bus>) -> anyhow::Result<PoseSource> {
    PoseSource::open(url, bus).map_err(|error| match error {
        PoseSourceError::Bus(error) => anyhow::Error::new(error),
        PoseSourceError::NoBus => Usage::error(
            "poses from zenoh:// need the bus: give --poses F.tum, or leave out --no-publish",
        ),
        wrong => Usage::error(wrong),
    })
}

/// Opens the bus and says where it leads.
///
/// # Errors
/// If a setting is wrong (then it is the user's), or zenoh fails.
pub(crate) fn open_bus(config: BusConfig) -> anyhow::Result<Arc<Bus>> {
    let bus = Bus::open(config).map_err(|error| match error {
        BusError::Config { .. } | BusError::ConfigFile { .. } | BusError::ZenohSetting { .. } => {
            Usage::error(error)
        }
        other => anyhow::Error::new(other),
    })?;
    let endpoints = bus.endpoints();
    tracing::info!(
        listen = %endpoints.listen.join(" "),
        connect = %endpoints.connect.join(" "),
        keys = bus.keys().alive().trim_end_matches("/alive"),
        "zenoh"
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

/// Starts the recording, if one is asked for, with the configuration in force.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn recorder(config: &Config) -> anyhow::Result<Option<Recorder>> {
    let Some(directory) = &config.output.record else {
        return Ok(None);
    };
    let settings = toml::to_string(config).context("the configuration as TOML")?;
    let rotate_bytes = config.output.record_rotate_bytes;
    Recorder::create(directory, rotate_bytes, settings).map(Some)
}
