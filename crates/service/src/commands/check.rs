//! `echosplat check FILE`.

use std::path::Path;

use crate::config::Config;
use crate::exit::Finish;
use crate::logging;

/// # Errors
/// All that is wrong with the file, a line each: line, key, and what is allowed.
pub(crate) fn run(file: &Path) -> anyhow::Result<Finish> {
    Config::load(file)?;
    logging::print(&format!("{}: valid", file.display()));
    Ok(Finish::Done)
}
