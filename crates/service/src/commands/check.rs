//! `echosplat check FILE`.

use std::path::Path;

use crate::config::Config;
use crate::exit::Finish;
use crate::logging;

/// # Errors
/// The first thing wrong with the file: its line, key, and what is allowed.
pub(crate) fn run(file: &Path) -> anyhow::Result<Finish> {
    Config::load(file)?;
    logging::print(&format!("{}: valid", file.display()));
    Ok(Finish::Done)
}
