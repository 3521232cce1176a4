//! The command line over the configuration file.

use echosplat_pose::PoseUrl;

use crate::arguments::{BusArguments, ServiceArguments};
use crate::exit::Usage;

use super::Config;

/// Programs around the service connect to it, whenever it comes, and leave the listening to it:
/// peers do not pass on what two others say.
const HELPER: [(&str, &str); 2] = [("listen/endpoints", "[]"), ("connect/timeout_ms", "-1")];

fn owned((key, value): (&str, &str)) -> (String, String) {
    (key.to_owned(), value.to_owned())
}

/// What a command adds to the shared arguments.
#[derive(Debug, Clone, Default)]
pub(crate) struct Overrides {
    pub(crate) sonar: Option<String>,
    pub(crate) pose: Option<PoseUrl>,
    pub(crate) time_offset_s: Option<f64>,
}

impl Config {
    /// The file's settings, or the defaults, with the command line's on top.
    ///
    /// # Errors
    /// If the file is wrong, or a value of the command line is out of range.
    pub(crate) fn assemble(
        arguments: &ServiceArguments,
        overrides: Overrides,
    ) -> anyhow::Result<Self> {
        let mut config = match &arguments.config {
            Some(file) => Self::load(file)?,
            None => Self::default(),
        };
        config.sonar.url = overrides.sonar.unwrap_or(config.sonar.url);
        config.sonar.seed = arguments.seed.unwrap_or(config.sonar.seed);
        config.pose.url = overrides.pose.unwrap_or(config.pose.url);
        let offset_s = overrides.time_offset_s;
        config.pose.time_offset_s = offset_s.unwrap_or(config.pose.time_offset_s);
        config.mapper.threads = arguments.threads.unwrap_or(config.mapper.threads);
        let pipeline = &mut config.pipeline;
        pipeline.hold_back_every = arguments.hold_back.unwrap_or(pipeline.hold_back_every);
        let output = &mut config.output;
        output.map = arguments.map.clone().or(output.map.take());
        output.truth = arguments.truth.clone().or(output.truth.take());
        output.record = arguments.record.clone().or(output.record.take());
        output.duration_s = arguments.duration.or(output.duration_s);
        config.override_bus(&arguments.bus);
        config.checked()
    }

    /// Defaults with the command line's ways to other programs on top.
    ///
    /// # Errors
    /// If a value is out of range.
    pub(crate) fn with_bus(arguments: &BusArguments) -> anyhow::Result<Self> {
        let mut config = Self::default();
        let has_file = arguments.zenoh_config.is_some();
        if !has_file && std::env::var_os("ZENOH_CONFIG").is_none() {
            config.bus.zenoh.extend(HELPER.map(owned));
        }
        config.override_bus(arguments);
        config.checked()
    }

    fn override_bus(&mut self, arguments: &BusArguments) {
        let bus = &mut self.bus;
        if let Some(prefix) = &arguments.prefix {
            bus.prefix.clone_from(prefix);
        }
        if let Some(node) = &arguments.node {
            bus.node.clone_from(node);
        }
        if arguments.zenoh_config.is_some() {
            bus.zenoh_config_file.clone_from(&arguments.zenoh_config);
        }
        bus.zenoh.extend(arguments.zenoh.iter().cloned());
    }

    /// The settings, if all are in range.
    ///
    /// # Errors
    /// Names the first that is not.
    pub(crate) fn checked(self) -> anyhow::Result<Self> {
        match self.check() {
            Ok(()) => Ok(self),
            Err(bad) => Err(Usage::error(format!(
                "command line: {}: {}",
                bad.key, bad.message
            ))),
        }
    }
}
