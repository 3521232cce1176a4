//! The command line. Names and values only; what they mean is with the commands.

mod bus;
mod dives;
mod files;
mod live;
mod survey;
mod values;

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

pub(crate) use bus::BusArguments;
pub use dives::DiveArguments;
pub(crate) use dives::{EmulateArguments, PoseClock, SimulateArguments};
pub(crate) use files::{
    CalibrateArguments, EvaluateArguments, ExportArguments, GeoreferenceArguments, InfoArguments,
    Parameter, PlaceArguments, RecoverArguments, RenderArguments,
};
pub(crate) use live::{
    DemoArguments, ProbeArguments, ReplayArguments, Role, RunArguments, ServiceArguments,
    WatchArguments,
};
pub(crate) use survey::{AskedArguments, CompareArguments, MeasureArguments, ReportArguments};
pub use values::positive;

/// The commit that this was built from; `unknown` without git.
pub const COMMIT: &str = env!("ECHOSPLAT_COMMIT");

/// Version and commit of the program.
pub const VERSION: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    " (commit ",
    env!("ECHOSPLAT_COMMIT"),
    ")"
);

/// What to log, and how.
#[derive(Debug, Clone, Args)]
pub struct LoggingArguments {
    /// Say more: once for debug, twice for trace; `RUST_LOG` says it in detail
    #[arg(long, short, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Shape of the log on standard error
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub log_format: LogFormat,
}

/// Shape of a log line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The commands of the product.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// The whole service against a simulated sonar on loopback, then its errors against the truth
    Demo(DemoArguments),
    /// The service: sonar, poses, map, publishing, recording
    Run(RunArguments),
    /// The same pipeline from a log
    Replay(ReplayArguments),
    /// Writes a dive: log, poses and truth
    Simulate(SimulateArguments),
    /// Is the sonar, for any Ping client
    Emulate(EmulateArguments),
    /// Finds sonars over TCP, UDP and serial lines, or says what is in the way
    Probe(ProbeArguments),
    /// Follows the map of a running service
    Watch(WatchArguments),
    /// Judges a map against the truth, or against pings that were kept from it
    Evaluate(EvaluateArguments),
    /// Finds what is wrong with a log's time offset and mount
    Calibrate(CalibrateArguments),
    /// Renders what a sonar would hear of a map, from any pose
    Render(RenderArguments),
    /// Writes a map in another program's format: .splat, .pcd, .npz, .glb or one .ply; its surface; on Earth .las, .laz,
    /// .tif, .geojson and .kml; a track as .csv or .tum
    Export(Box<ExportArguments>),
    /// Says where on Earth a map lies, or puts it into the map: by its origin, or by points that are known in both
    Georeference(GeoreferenceArguments),
    /// Measures in a map, each size with its sigma: a distance, a pile, a plane, a profile, a section
    Measure(MeasureArguments),
    /// Writes what a client is handed of a dive: one page of HTML that prints on A4, with drawings to scale and measures
    Report(ReportArguments),
    /// Lays one map on another of the same place, and says what came, went and moved
    Compare(CompareArguments),
    /// Says what logs, recordings, trajectories, maps and bags of other programs hold
    Info(InfoArguments),
    /// Makes a clean file of a cut or damaged recording or log
    Recover(RecoverArguments),
    /// Prints the default configuration
    Config {
        /// Only what an owner sets
        #[arg(long)]
        basic: bool,
    },
    /// Validates a configuration file: says all that is wrong with it
    Check {
        /// The file to validate
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

/// What the program adds its own commands to.
#[cfg(test)]
#[derive(Debug, clap::Parser)]
#[command(name = "echosplat")]
pub(crate) struct Arguments {
    #[command(flatten)]
    logging: LoggingArguments,
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// A command line without the program's name, as the program reads it.
#[cfg(test)]
pub(crate) fn parsed(words: impl IntoIterator<Item = String>) -> Result<Command, clap::Error> {
    use clap::Parser;
    let words = ["echosplat".to_owned()].into_iter().chain(words);
    Arguments::try_parse_from(words).map(|arguments| arguments.command)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{CommandFactory, Parser};

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn more_is_said_wherever_it_is_asked() {
        let words = ["echosplat", "info", "a.ply", "-vv"];
        assert_eq!(Arguments::try_parse_from(words).unwrap().logging.verbose, 2);
    }

    #[test]
    fn pings_are_held_out_by_the_names_of_before_too() {
        let evaluate = |more: &[&str]| {
            let words = ["echosplat", "evaluate", "a.ply", "--log", "a.svlog"];
            match Arguments::try_parse_from(words.iter().chain(more)).map(|a| a.command) {
                Ok(Command::Evaluate(arguments)) => arguments.held_out,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(evaluate(&["--held-out", "20"]), Some(Some(20)));
        assert_eq!(evaluate(&["--held-back", "20"]), Some(Some(20)));
        assert_eq!(evaluate(&["--held-out", "--json"]), Some(None));
        for name in ["--hold-out", "--hold-back"] {
            let words = ["echosplat", "replay", "a.svlog", name, "20"];
            assert!(Arguments::try_parse_from(words).is_ok(), "{name}");
        }
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        for bad in ["-1", "nan", "inf", "fast"] {
            let parsed =
                Arguments::try_parse_from(["echosplat", "replay", "a.svlog", "--rate", bad]);
            assert!(parsed.is_err(), "{bad}");
        }
        let parsed = Arguments::try_parse_from(["echosplat", "run", "--time-offset-s", "-1.5"]);
        assert!(parsed.is_ok());
    }

    #[test]
    fn zenoh_settings_are_repeatable() {
        let words = ["echosplat", "watch", "--zenoh", "a=1", "--zenoh", "b=[2]"];
        let Ok(Arguments {
            command: Command::Watch(watch),
            ..
        }) = Arguments::try_parse_from(words)
        else {
            panic!("watch takes them");
        };
        assert_eq!(watch.bus.zenoh.len(), 2);
        assert!(Arguments::try_parse_from(["echosplat", "watch", "--zenoh", "=1"]).is_err());
    }
}
