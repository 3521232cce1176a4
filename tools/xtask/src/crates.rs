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

/// The one crate that knows all others.
pub(crate) const SERVICE: &str = "echosplat-service";
/// Reaches the sonar; meets the mapper only in the model.
pub(crate) const DRIVER: &str = "echosplat-driver";
/// Makes the map; meets the driver only in the model.
pub(crate) const MAPPER: &str = "echosplat-mapper";
/// Runs on a microcontroller too.
pub(crate) const FIRMWARE_PROTOCOL: &str = "echosplat-firmware-protocol";

/// Every crate of the workspace: name, folder, kind.
pub(crate) const CRATES: [(&str, &str, Kind); 20] = [
    (FIRMWARE_PROTOCOL, "firmware-protocol/", PURE),
    ("echosplat-model", "crates/model/", PURE),
    ("echosplat-ros", "crates/ros/", PURE),
    ("echosplat-surface", "crates/surface/", PURE),
    ("echosplat-session", "crates/session/", PURE),
    ("echosplat-join", "crates/join/", PURE),
    ("echosplat-liveness", "crates/liveness/", Kind::Io),
    ("echosplat-acoustics", "crates/acoustics/", PURE),
    (MAPPER, "crates/mapper/", PURE),
    ("echosplat-paper", "crates/paper/", PURE),
    ("echosplat-recording", "crates/recording/", PURE_WITH_FILES),
    ("echosplat-simulator", "crates/simulator/", PURE_WITH_FILES),
    (
        "echosplat-evaluation",
        "crates/evaluation/",
        PURE_WITH_FILES,
    ),
    (DRIVER, "crates/driver/", Kind::Io),
    ("echosplat-bus", "crates/bus/", Kind::Io),
    ("echosplat-pose", "crates/pose/", Kind::Io),
    ("echosplat-web", "crates/web/", Kind::Io),
    (SERVICE, "crates/service/", Kind::Io),
    ("xtask", "tools/xtask/", Kind::Tool),
    ("echosplat-soak", "tools/soak/", Kind::Tool),
];

const PURE: Kind = Kind::Pure { files: false };
const PURE_WITH_FILES: Kind = Kind::Pure { files: true };

/// The kind of the crate with this name.
pub(crate) fn kind_of(name: &str) -> Option<Kind> {
    let found = CRATES.iter().find(|(known, ..)| *known == name)?;
    Some(found.2)
}

/// Name and kind of the crate whose sources hold this path, given relative to the workspace.
/// Tests, benches and build scripts are no part of it.
pub(crate) fn crate_of_source(path: &str) -> Option<(&'static str, Kind)> {
    CRATES.iter().find_map(|&(name, folder, kind)| {
        let inside = path.strip_prefix(folder)?.strip_prefix("src/")?;
        let is_test = inside
            .split('/')
            .any(|part| matches!(part, "tests" | "tests.rs"));
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
    }
}
