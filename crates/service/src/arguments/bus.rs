//! How any command reaches other programs.

use std::path::PathBuf;

use clap::Args;

use super::values::key_and_value;

/// How to reach other programs.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct BusArguments {
    /// First part of every key
    #[arg(long, value_name = "NAME")]
    pub(crate) prefix: Option<String>,
    /// The vehicle's name, second part of every key
    #[arg(long, value_name = "NAME")]
    pub(crate) node: Option<String>,
    /// zenoh configuration file in place of the safe default
    #[arg(long, value_name = "FILE")]
    pub(crate) zenoh_config: Option<PathBuf>,
    /// One zenoh setting, as key=json5; repeatable
    #[arg(long, value_name = "KEY=JSON5", value_parser = key_and_value)]
    pub(crate) zenoh: Vec<(String, String)>,
}
