//! The command line over the configuration file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use echosplat_model::Timestamp;
use echosplat_pose::PoseUrl;

use crate::arguments::{BusArguments, PlaceArguments, ServiceArguments};
use crate::clock;
use crate::exit::Usage;

use super::{Config, faults};

/// Programs around the service connect to it, whenever it comes, and leave the listening to it:
/// peers do not pass on what two others say.
const HELPER: [(&str, &str); 2] = [("listen/endpoints", "[]"), ("connect/timeout_ms", "-1")];

/// `{time}` in the name of a map as the time given: a service that is started again keeps what it had mapped.
fn dated(file: &Path, time: Timestamp) -> PathBuf {
    match file.to_str() {
        Some(text) => text.replace("{time}", &clock::compact_utc(time)).into(),
        None => file.to_owned(),
    }
}

fn owned((key, value): (&str, &str)) -> (String, String) {
    (key.to_owned(), value.to_owned())
}

/// What a command adds to the shared arguments.
#[derive(Debug, Clone, Default)]
pub(crate) struct Overrides {
    /// Stands for the defaults where no file is given: of a recorded dive.
    pub(crate) base: Option<Config>,
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
            None => overrides.base.unwrap_or_default(),
        };
        config.sonar.url = overrides.sonar.unwrap_or(config.sonar.url);
        config.sonar.seed = arguments.seed.unwrap_or(config.sonar.seed);
        config.pose.url = overrides.pose.unwrap_or(config.pose.url);
        let offset_s = overrides.time_offset_s;
        config.pose.time_offset_s = offset_s.unwrap_or(config.pose.time_offset_s);
        config.mapper.threads = arguments.threads.unwrap_or(config.mapper.threads);
        let pipeline = &mut config.pipeline;
        pipeline.hold_back_every = arguments.hold_back.unwrap_or(pipeline.hold_back_every);
        config.override_place(&arguments.place);
        let output = &mut config.output;
        output.map = arguments
            .map
            .clone()
            .or(output.map.take())
            .map(|map| dated(&map, clock::now()));
        output.track = arguments
            .track
            .clone()
            .or(output.track.take())
            .map(|track| dated(&track, clock::now()));
        output.truth = arguments.truth.clone().or(output.truth.take());
        output.record = arguments.record.clone().or(output.record.take());
        output.record_format = arguments.record_format.unwrap_or(output.record_format);
        output.duration_s = arguments.duration.or(output.duration_s);
        config.web.address = arguments.web.clone().or(config.web.address.take());
        config.override_bus(&arguments.bus);
        config.checked()
    }

    /// What a recorded dive was mapped with. Where its files went, and how many threads it had, is its
    /// own business.
    ///
    /// # Errors
    /// If this version does not understand the settings.
    pub(crate) fn of_recording(settings: &str) -> anyhow::Result<Self> {
        let place = Path::new("settings of the recording");
        let mut config = faults::read(settings).map_err(|found| {
            let mut lines: Vec<String> = found.iter().map(|fault| fault.located(place)).collect();
            lines.push(format!(
                "{}: they were written by another version of EchoSplat than this one, {}; --config FILE gives those \
                 to map it with in their place",
                place.display(),
                env!("CARGO_PKG_VERSION")
            ));
            Usage::faults(lines)
        })?;
        let default = Self::default();
        config.output.map = None;
        config.output.track = None;
        config.output.truth = None;
        config.output.record = None;
        config.mapper.threads = default.mapper.threads;
        config.bus = default.bus;
        config.web = default.web;
        Ok(config)
    }

    /// Defaults with some keys set, each by its dotted name to a TOML value.
    ///
    /// # Errors
    /// If there is no such key, or a value is none of its kind or out of range.
    pub fn of_settings(settings: &BTreeMap<String, String>) -> anyhow::Result<Self> {
        let mut text = String::new();
        for (key, value) in settings {
            let line = format!("{key} = {value}\n");
            toml::from_str::<Self>(&line).map_err(|error| {
                let said = error.message();
                Usage::error(format!("setting {key} = {value}: {said}"))
            })?;
            text += &line;
        }
        Self::parse(Path::new("settings"), &text)
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

    fn override_place(&mut self, asked: &PlaceArguments) {
        let place = &mut self.georeference;
        place.origin = asked.origin.clone().or(place.origin.take());
        if let Some(datum) = asked.datum {
            datum.name().clone_into(&mut place.datum);
        }
        place.x_heading_deg = asked.heading.or(place.x_heading_deg);
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

#[cfg(test)]
mod tests {
    use super::*;

    fn of(settings: &[(&str, &str)]) -> anyhow::Result<Config> {
        let owned = settings.iter().copied().map(owned);
        Config::of_settings(&owned.collect())
    }

    #[test]
    fn settings_are_set_by_their_dotted_names() {
        let config = of(&[
            ("mapper.workout_passes", "48"),
            ("mapper.spawn_evidence", "6.5"),
            ("pose.url", "\"none\""),
        ])
        .unwrap();
        assert_eq!(config.mapper.workout_passes, 48);
        assert!((config.mapper.spawn_evidence - 6.5).abs() < 1e-6);
        assert_eq!(config.pipeline, Config::default().pipeline);
        assert_eq!(of(&[]).unwrap(), Config::default());
    }

    #[test]
    fn settings_of_a_recording_by_a_newer_version_are_named_with_what_helps() {
        let said = Config::of_recording("[mapper]\nnewer_key = 3\n").unwrap_err();
        let said = said.to_string();
        for words in [
            "settings of the recording:2: mapper.newer_key",
            "--config FILE",
        ] {
            assert!(said.contains(words), "{said}");
        }
        assert!(Config::of_recording("[mapper]\nresolution_m = 0.05\n").is_ok());
    }

    #[test]
    fn settings_that_cannot_be_are_named() {
        for (key, value) in [
            ("mapper.finish_pases", "48"),
            ("mapper.workout_passes", "many"),
            ("mapper.spawn_evidence", "-1"),
        ] {
            let said = of(&[(key, value)]).unwrap_err().to_string();
            assert!(said.contains(key) && said.contains(value), "{said}");
        }
    }

    #[test]
    fn a_switch_says_which_words_there_are() {
        for value in ["3", "true", "\"yes\""] {
            let said = of(&[("mapper.parts.glints", value)]).unwrap_err();
            let said = said.to_string();
            assert!(said.contains(r#""on", "off" or "auto""#), "{said}");
        }
        assert_eq!(
            of(&[("mapper.parts.glints", "\"off\"")])
                .unwrap()
                .mapper
                .parts
                .glints,
            echosplat_model::Switch::Off
        );
    }

    #[test]
    fn a_map_bears_the_time_of_its_run_where_asked() {
        let time = Timestamp::from_millis(1_767_323_045_000);
        let at = |name: &str| dated(Path::new(name), time);
        assert_eq!(
            at("maps/{time}.ply"),
            Path::new("maps/20260102T030405Z.ply")
        );
        assert_eq!(at("map.ply"), Path::new("map.ply"));
    }
}
