//! Which crate may do what. A new crate is sorted here before anything else.

/// What a workspace crate may touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Bytes and time come in as arguments: no sockets, no runtime, no clock.
    Pure {
        /// May open files by name.
        files: bool,
    },
    /// Does input and output.
    Io,
    /// No part of the product.
    Tool,
}

/// What a workspace crate is there for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// The service on a vehicle.
    Product,
    /// Says how good a map is: for the commands that are given a truth, and for the proof.
    Judgement,
    /// Measures the product.
    Proof,
}

/// The one crate that knows all others of the product.
pub(crate) const SERVICE: &str = "echosplat-service";
/// Measures the service, and so reaches it.
pub(crate) const BENCH: &str = "echosplat-bench";
/// The program: service and, unless it is built without, benches.
pub(crate) const PROGRAM: &str = "echosplat";
/// Reaches the sonar; meets the mapper only in the model.
pub(crate) const DRIVER: &str = "echosplat-driver";
/// Makes the map; meets the driver only in the model.
pub(crate) const MAPPER: &str = "echosplat-mapper";
/// Runs on a microcontroller too.
pub(crate) const FIRMWARE_PROTOCOL: &str = "echosplat-firmware-protocol";

/// Every crate of the workspace: name, folder, kind.
pub(crate) const CRATES: [(&str, &str, Kind); 28] = [
    (FIRMWARE_PROTOCOL, "firmware-protocol/", PURE),
    ("echosplat-model", "crates/model/", PURE),
    ("echosplat-ros", "crates/ros/", PURE),
    ("echosplat-ply", "crates/ply/", PURE),
    ("echosplat-surface", "crates/surface/", PURE),
    ("echosplat-survey", "crates/survey/", PURE),
    ("echosplat-georeference", "crates/georeference/", PURE),
    ("echosplat-session", "crates/session/", PURE),
    ("echosplat-join", "crates/join/", PURE),
    ("echosplat-input", "crates/input/", PURE_WITH_FILES),
    ("echosplat-liveness", "crates/liveness/", Kind::Io),
    ("echosplat-measurement", "crates/measurement/", PURE),
    (MAPPER, "crates/mapper/", PURE),
    ("echosplat-paper", "crates/paper/", PURE),
    ("echosplat-recording", "crates/recording/", PURE_WITH_FILES),
    ("echosplat-simulator", "crates/simulator/", PURE_WITH_FILES),
    ("echosplat-prediction", "crates/prediction/", PURE),
    ("echosplat-metrics", "crates/metrics/", PURE_WITH_FILES),
    ("echosplat-page", "crates/page/", PURE),
    ("echosplat-report", "crates/report/", PURE),
    (DRIVER, "crates/driver/", Kind::Io),
    ("echosplat-bus", "crates/bus/", Kind::Io),
    ("echosplat-pose", "crates/pose/", Kind::Io),
    ("echosplat-web", "crates/web/", Kind::Io),
    (SERVICE, "crates/service/", Kind::Io),
    (BENCH, "crates/bench/", Kind::Io),
    (PROGRAM, "crates/program/", Kind::Io),
    ("xtask", "tools/xtask/", Kind::Tool),
];

const PURE: Kind = Kind::Pure { files: false };
const PURE_WITH_FILES: Kind = Kind::Pure { files: true };

/// The kind of the crate with this name.
pub(crate) fn kind_of(name: &str) -> Option<Kind> {
    let found = CRATES.iter().find(|(known, ..)| *known == name)?;
    Some(found.2)
}

/// What the crate with this name is there for.
pub(crate) fn purpose_of(name: &str) -> Purpose {
    match name {
        "echosplat-metrics" | "echosplat-report" => Purpose::Judgement,
        BENCH | "echosplat-paper" | "xtask" => Purpose::Proof,
        _ => Purpose::Product,
    }
}

/// Name and kind of the crate whose sources hold this path, given relative to the workspace.
/// Tests, benches and build scripts are no part of it.
pub(crate) fn crate_of_source(path: &str) -> Option<(&'static str, Kind)> {
    CRATES.iter().find_map(|&(name, folder, kind)| {
        let inside = path.strip_prefix(folder)?.strip_prefix("src/")?;
        let is_test = inside
            .split('/')
            .any(|part| matches!(part, "tests" | "tests.rs"));
        // What benches ask and how they judge it is apart from running them.
        let kind = match name == BENCH && !inside.starts_with("commands/") {
            true => PURE,
            false => kind,
        };
        (!is_test).then_some((name, kind))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_belongs_to_its_crate() {
        let found = crate_of_source("crates/mapper/src/fan.rs");
        assert_eq!(found, Some((MAPPER, PURE)));
        assert_eq!(crate_of_source("crates/mapper/src/fan/tests.rs"), None);
        assert_eq!(crate_of_source("crates/mapper/benches/fan.rs"), None);
        assert_eq!(crate_of_source("tests/main.rs"), None);
        let bench = |path| crate_of_source(path).map(|(_, kind)| kind);
        assert_eq!(bench("crates/bench/src/runs/spec.rs"), Some(PURE));
        assert_eq!(bench("crates/bench/src/commands/long.rs"), Some(Kind::Io));
    }
}
