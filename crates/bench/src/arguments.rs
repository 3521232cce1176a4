//! The command line of `echosplat bench`. Names and values only; what they mean is with the benches.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use echosplat_service::arguments::positive;

/// Which bench, and how.
#[derive(Debug, Args)]
pub struct BenchArguments {
    #[command(subcommand)]
    pub(crate) bench: Bench,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Bench {
    /// Gaussian–bin pairs per second and core of the rendering kernels
    Kernels(BenchOptions),
    /// Stiff and extreme cases: the program against f64
    Stability(BenchOptions),
    /// The paper's method on the paper's two cases, beside the figures it prints
    Paper(PaperBenchArguments),
    /// Every target of accuracy and robustness over several seeds, and which are met
    Targets(TargetsBenchArguments),
    /// Error against compute time, counted work and dive time, of several methods; and what each
    /// setting trades
    ErrorTime(ErrorTimeBenchArguments),
    /// Error against noise: one survey with its echoes 40 to 6 dB over the noise
    Noise(NoiseBenchArguments),
    /// Each optional feature of the mapper on, off and as it chooses by itself
    Ablation(AblationBenchArguments),
    /// Hours of diving past several structures: whether memory, work per ping and the first structure's
    /// map stay as they were
    Long(LongBenchArguments),
    /// The running service killed, unplugged, lied to and flooded: what is told, lost and left
    Faults(FaultsBenchArguments),
    /// A service for hours, live and from a log, with floods, bursts, steps of the clock and a frozen
    /// subscriber: whether memory and descriptors stay as they were
    Soak(SoakBenchArguments),
    /// The service on part of one processor, beside the same on the whole machine: what is put off, how late maps are, how near
    /// the last is; takes root, for a control group
    Small(SmallBenchArguments),
    /// Error-time, ablation, stability and targets in turn, each within its share of the time
    All(AllBenchArguments),
    /// What this version reaches, as one file: accuracy, live maps, certainty, noise, error against time,
    /// memory and speed; it goes on where it was when it is asked again
    Report(ReportBenchArguments),
    /// Makes one run and prints its outcome
    #[command(hide = true)]
    Run(RunBenchArguments),
}

/// What all benches share.
#[derive(Debug, Clone, Args)]
pub(crate) struct BenchOptions {
    /// Less of everything, for a first look
    #[arg(long)]
    pub(crate) quick: bool,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Where the report goes, as JSON and as HTML
    #[arg(long, value_name = "DIR", default_value = "out/bench")]
    pub(crate) out: PathBuf,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct PaperBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    /// Which of the paper's cases
    #[arg(long, value_enum, default_value_t = PaperCase::Both)]
    pub(crate) case: PaperCase,
    /// Epochs; the paper's 100 without, a fifth of it with --quick
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) epochs: Option<u32>,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct TargetsBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    #[command(flatten)]
    pub(crate) queue: QueueOptions,
    /// Only this section (accuracy, field, certainty, shift, more, live, work, length, threads, frames,
    /// again, own, paper) or this scene; repeatable, and SECTION/SCENE takes what is both
    #[arg(long, value_name = "NAME")]
    pub(crate) only: Vec<String>,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct ErrorTimeBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    #[command(flatten)]
    pub(crate) queue: QueueOptions,
    /// Only the dives of this scene, or the settings (settings); repeatable, and SCENE/DIVE and
    /// SCENE/DIVE/NOISE take less
    #[arg(long, value_name = "NAME")]
    pub(crate) only: Vec<String>,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct NoiseBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    #[command(flatten)]
    pub(crate) queue: QueueOptions,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct AblationBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    #[command(flatten)]
    pub(crate) queue: QueueOptions,
    /// Only this scene; repeatable
    #[arg(long, value_name = "SCENE")]
    pub(crate) only: Vec<String>,
    /// Other settings in place of the mapper's features, as KEY=ON,OFF,AUTO; repeatable
    #[arg(long, hide = true, value_name = "KEY=ON,OFF,AUTO", value_parser = part)]
    pub(crate) part: Vec<(String, [String; 3])>,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct AllBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    #[command(flatten)]
    pub(crate) queue: QueueOptions,
    /// Fail where work or error differ from this table by more than a factor of 1.5
    #[arg(long, value_name = "TABLE.json", requires = "quick")]
    pub(crate) against: Option<PathBuf>,
    /// Write the table of work and error there
    #[arg(long, value_name = "TABLE.json", requires = "quick")]
    pub(crate) write_table: Option<PathBuf>,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct LongBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    /// Length of the dive; 2 without, with --quick ten minutes past two structures
    #[arg(long, value_name = "HOURS", value_parser = positive)]
    pub(crate) hours: Option<f64>,
    /// Pings per second, fewer where the range needs longer
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 58.0)]
    pub(crate) pings_per_s: f64,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct FaultsBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    /// Only these; repeatable, or with commas
    #[arg(long, value_name = "NAME", value_enum, value_delimiter = ',')]
    pub(crate) only: Vec<FaultFamily>,
    /// How often the service is killed
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub(crate) kills: usize,
    /// How often each link is taken away
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub(crate) unplugs: usize,
    /// Services at a time
    #[arg(long, value_name = "N", default_value_t = 4,
        value_parser = clap::value_parser!(u64).range(1..=64))]
    pub(crate) jobs: u64,
    /// Another build of this program, in place of this one
    #[arg(long, hide = true, value_name = "FILE")]
    pub(crate) program: Option<PathBuf>,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct SoakBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    /// How long the live part is; 60, or 1 with --quick
    #[arg(long, value_name = "MINUTES", value_parser = positive)]
    pub(crate) live_minutes: Option<f64>,
    /// How long a dive is replayed; 90, or 4 with --quick
    #[arg(long, value_name = "MINUTES", value_parser = positive)]
    pub(crate) replayed_minutes: Option<f64>,
    /// Another build of this program, in place of this one
    #[arg(long, hide = true, value_name = "FILE")]
    pub(crate) program: Option<PathBuf>,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct SmallBenchArguments {
    #[command(flatten)]
    pub(crate) options: BenchOptions,
    /// What is surveyed; repeatable
    #[arg(long, value_name = "SCENE", default_values = ["fence", "wall", "pier"])]
    pub(crate) scene: Vec<String>,
    /// Part of one processor that the service may use
    #[arg(long, value_name = "N", default_value_t = 0.5, value_parser = positive)]
    pub(crate) processors: f64,
    /// How long each dive lasts; 165, or 20 with --quick
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) seconds: Option<f64>,
    /// Another build of this program, in place of this one
    #[arg(long, hide = true, value_name = "FILE")]
    pub(crate) program: Option<PathBuf>,
}

#[derive(Debug, Clone, Args)]
pub(crate) struct ReportBenchArguments {
    /// The file; what is done so far is kept in a folder beside it
    #[arg(
        long,
        value_name = "FILE.json",
        default_value = "results.json",
        conflicts_with = "write_page"
    )]
    pub(crate) out: PathBuf,
    /// Only this part; repeatable. What is done of the others stays in the file
    #[arg(long, value_name = "PART", value_enum, conflicts_with = "write_page")]
    pub(crate) only: Vec<ReportPart>,
    /// Stop after so many minutes; the same command goes on
    #[arg(long, value_name = "MINUTES", value_parser = positive, default_value_t = 90.0)]
    pub(crate) budget: f64,
    /// Runs at a time, each with one thread of the mapper
    #[arg(long, value_name = "N", default_value_t = 2,
        value_parser = clap::value_parser!(u64).range(1..=64))]
    pub(crate) jobs: u64,
    /// A little of each part, of short dives: whether it works, not what it reaches
    #[arg(long)]
    pub(crate) quick: bool,
    /// Run nothing: make this page of a file, its charts in a folder beside it, and the table of accuracy in
    /// the README above where that has marks for it
    #[arg(long, value_name = "PAGE.md", requires = "from")]
    pub(crate) write_page: Option<PathBuf>,
    /// The file of which the page is made
    #[arg(long, value_name = "FILE.json", requires = "write_page")]
    pub(crate) from: Option<PathBuf>,
}

/// Parts of the report that have runs of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ReportPart {
    /// Finished maps of all scenes and levels of noise.
    Accuracy,
    /// Surveys of four scenes, for what maps say of their certainty.
    Sigma,
    /// Live maps beside the dive ended there.
    Live,
    /// Echoes that sink into the noise.
    Noise,
    /// Error against processor time, by method.
    ErrorTime,
    /// Memory over the length of a dive.
    Length,
}

/// Kinds of faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum FaultFamily {
    /// `kill -9` at random moments.
    Kills,
    /// The link to the sonar taken away and brought back, over TCP and a pseudo-terminal.
    Unplugs,
    /// Seven faults of sonar, poses and clock.
    Grid,
    /// Poses that are away, jump, freeze or come late.
    Poses,
    /// Steps of the host's clock; the device's wraps and begins anew.
    Clock,
    /// A dive with many of these, whose recording has to give its maps again; takes root, for a disk
    /// of limited size.
    Replayed,
    /// Floods of datagrams, and poses that come twice.
    Hostile,
    /// Pings at 10, 100 and 1,000 times the rate.
    Overload,
}

/// What is run of a bench that runs dives, and how long.
#[derive(Debug, Clone, Args)]
pub(crate) struct QueueOptions {
    /// Seeds of each case, counted from --seed; one with --quick
    #[arg(long, value_name = "N", default_value_t = 5,
        value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub(crate) seeds: u64,
    /// Stop after so many minutes; what is left out is listed
    #[arg(long, value_name = "MINUTES", value_parser = positive)]
    pub(crate) budget: Option<f64>,
    /// Runs at a time, each with one thread of the mapper
    #[arg(long, value_name = "N", default_value_t = 2,
        value_parser = clap::value_parser!(u64).range(1..=64))]
    pub(crate) jobs: u64,
}

impl QueueOptions {
    /// Counted from the first; one of them where it shall be quick.
    pub(crate) fn seeds_of(&self, options: &BenchOptions) -> Vec<u64> {
        let count = if options.quick { 1 } else { self.seeds };
        (options.seed..options.seed.saturating_add(count)).collect()
    }
}

/// One run, as benches start it.
#[derive(Debug, Args)]
pub(crate) struct RunBenchArguments {
    /// What to run
    #[arg(value_name = "SPEC.json")]
    pub(crate) spec: String,
    /// Where its map goes
    #[arg(long, value_name = "OUT.ply")]
    pub(crate) keep_map: Option<PathBuf>,
}

/// The paper's cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum PaperCase {
    /// Case 1: three rods and a bar, 249 views.
    Fence,
    /// Case 2: a tower of 20 × 20 × 40 m, 886 views.
    Truss,
    /// One after the other.
    Both,
}

fn part(text: &str) -> Result<(String, [String; 3]), String> {
    let wrong = || "it must read KEY=ON,OFF,AUTO, as in mapper.workout_passes=32,4,16".to_owned();
    let (key, values) = text.split_once('=').ok_or_else(wrong)?;
    let values: Vec<String> = values.split(',').map(str::to_owned).collect();
    Ok((key.to_owned(), values.try_into().map_err(|_| wrong())?))
}

/// What is asked of one bench, as the program parses it.
#[cfg(test)]
pub(crate) fn parsed(bench: &str, more: &[&str]) -> Bench {
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        arguments: BenchArguments,
    }
    let words = [&["bench", bench], more].concat();
    Line::try_parse_from(words).unwrap().arguments.bench
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_count_from_the_first() {
        let seeds = |more: &[&str]| match parsed("targets", more) {
            Bench::Targets(arguments) => arguments.queue.seeds_of(&arguments.options),
            other => panic!("{other:?}"),
        };
        assert_eq!(seeds(&["--seed", "3", "--seeds", "2"]), [3, 4]);
        assert_eq!(seeds(&["--quick"]), [1]);
        assert_eq!(seeds(&[]).len(), 5);
    }
}
