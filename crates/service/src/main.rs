//! The program `echosplat`: arguments, configuration, wiring, shutdown.
//!
//! It alone knows all the other parts. It deliberately holds no mathematics, no protocol and no
//! file format of its own.

mod arguments;
mod clock;
mod commands;
mod config;
mod dives;
mod exit;
mod files;
mod fingerprint;
mod inputs;
mod logging;
mod logs;
mod maps;
mod pipeline;
mod processor;
mod recorder;
mod replayed;
mod rig;
mod scene_files;
mod signals;
mod supervisor;
mod truth;
mod web;

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    let arguments = arguments::Arguments::parse();
    logging::start(&arguments.logging);
    match commands::run(arguments.command) {
        Ok(finish) => finish.code(),
        Err(error) => {
            tracing::debug!(?error, "failed");
            for line in exit::lines(&error) {
                logging::complain(&line);
            }
            exit::code_of(&error)
        }
    }
}
