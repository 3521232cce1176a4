//! The program `echosplat`: its command line, and which commands it has.
//!
//! What the commands do is in `echosplat-service`, and in `echosplat-bench` where that is built in: a
//! vehicle's program goes without (`--no-default-features`).

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use echosplat_service::arguments::{self, LoggingArguments, VERSION};
use echosplat_service::exit::{self, Finish};
use echosplat_service::{commands, logging, simd};

/// Maps what an imaging sonar hears into Gaussians while the vehicle moves.
#[derive(Debug, Parser)]
#[command(name = "echosplat", version = VERSION, about, propagate_version = true)]
struct Arguments {
    #[command(flatten)]
    logging: LoggingArguments,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    #[command(flatten)]
    Product(Box<arguments::Command>),
    /// Measures the program: speed, stiff and extreme cases, the paper's method
    #[cfg(feature = "bench")]
    #[command(display_order = 12)]
    Bench(echosplat_bench::BenchArguments),
    /// Prints what a shell needs to complete our commands
    Completions {
        /// Whose; its manual says where the output belongs
        #[arg(value_enum, value_name = "SHELL")]
        shell: Shell,
    },
    /// Writes our manual pages, one a command
    Man {
        /// Where they go
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
}

#[cfg(test)]
mod documents;

fn main() -> ExitCode {
    let _log = logging::FlushedAtEnd;
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return exit::end_with_usage(&error),
    };
    logging::start(&arguments.logging);
    exit::end(run(arguments.command))
}

fn run(command: Command) -> anyhow::Result<Finish> {
    simd::start()?;
    match command {
        Command::Product(command) => commands::run(*command),
        #[cfg(feature = "bench")]
        Command::Bench(arguments) => echosplat_bench::run(&arguments),
        Command::Completions { shell } => {
            print_completions(shell);
            Ok(Finish::Done)
        }
        Command::Man { out } => write_manual(&out),
    }
}

fn print_completions(shell: Shell) {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "echosplat", &mut script);
    logging::print(String::from_utf8_lossy(&script).trim_end());
}

fn write_manual(folder: &Path) -> anyhow::Result<Finish> {
    let failed = || format!("cannot write to {}", folder.display());
    std::fs::create_dir_all(folder).with_context(failed)?;
    clap_mangen::generate_to(Arguments::command(), folder).with_context(failed)?;
    Ok(Finish::Done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn there_are_benches_where_they_are_built_in() {
        let asked = Arguments::try_parse_from(["echosplat", "bench", "kernels", "--quick"]);
        assert_eq!(asked.is_ok(), cfg!(feature = "bench"));
    }
}
