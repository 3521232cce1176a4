//! A short simulated dive, made once for all tests that only read it.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use crate::harness::Program;

/// Pings of the dive: 24 s at 40 a second. In less, next to nothing is seen from enough places.
pub(crate) const PING_COUNT: u64 = 960;

const LONG: Duration = Duration::from_secs(120);

/// Its directory.
pub(crate) fn dive() -> &'static Path {
    static DIVE: OnceLock<PathBuf> = OnceLock::new();
    DIVE.get_or_init(|| {
        let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("dive");
        let out = directory.display().to_string();
        Program::echosplat(&["simulate", "--duration", "24", "--out", &out])
            .wait_exit_code(0, LONG);
        directory
    })
}

/// One of its files.
pub(crate) fn file(name: &str) -> String {
    dive().join(name).display().to_string()
}

/// The arguments of a replay of it.
pub(crate) fn replay(more: &[&str]) -> Vec<String> {
    let own = ["replay", &file("dive.svlog"), "--poses", &file("dive.tum")];
    own.iter().chain(more).map(ToString::to_string).collect()
}
