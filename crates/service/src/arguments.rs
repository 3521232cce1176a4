//! The command line. Names and values only; what they mean is with the commands.

use std::path::PathBuf;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use echosplat_pose::PoseUrl;
use echosplat_simulator::{DiveKind, NoiseLevel};
use echosplat_surface::CELL_M;

use crate::recorder::RecordFormat;

pub(crate) const VERSION: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    " (commit ",
    env!("ECHOSPLAT_COMMIT"),
    ")"
);

const SONAR_HELP: &str = "The sonar: tcp://HOST:PORT, udp://HOST:PORT, \
     serial:///DEVICE?baudrate=N, sim://SCENE or file://LOG.svlog";
const POSE_HELP: &str = "The poses: zenoh://[KEY], mavlink+udp://HOST:PORT[?out], \
     mavlink+tcp://HOST:PORT, mavlink+serial:///DEVICE?baudrate=N, mavlink+zenoh://[PREFIX], \
     dvl://HOST, log://, tum://POSES.tum or none";
const PLACE_HELP: &str = "Try only there: tcp://HOST:PORT, udp://HOST:PORT or \
     serial:///DEVICE?baudrate=N; repeatable";
const WEB_HELP: &str = "Serves the live page there: HOST:PORT, or a PORT of this machine alone, \
     like 8080; 0.0.0.0:8080 for other machines too";
const LISTEN_HELP: &str =
    "tcp://HOST:PORT, udp://HOST:PORT, serial:///PATH/OF/LINK or serial://pty";

/// Maps what an imaging sonar hears into Gaussians while the vehicle moves.
#[derive(Debug, Parser)]
#[command(name = "echosplat", version = VERSION, about, propagate_version = true)]
pub(crate) struct Arguments {
    #[command(flatten)]
    pub(crate) logging: LoggingArguments,
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// What to log, and how.
#[derive(Debug, Clone, Args)]
pub(crate) struct LoggingArguments {
    /// Say more: once for debug, twice for trace; `RUST_LOG` says it in detail
    #[arg(long, short, global = true, action = clap::ArgAction::Count)]
    pub(crate) verbose: u8,
    /// Shape of the log on standard error
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub(crate) log_format: LogFormat,
}

/// Shape of a log line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
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
    /// Measures the program: speed, stiff and extreme cases, the paper's method
    Bench(BenchArguments),
    /// Writes a map in another program's format: .splat, .pcd, .npz or one .ply; or its surface
    Export(ExportArguments),
    /// Says what a log, a recording, a trajectory or a map holds
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
    /// Prints what a shell needs to complete our commands
    Completions {
        /// Whose; its manual says where the output belongs
        #[arg(value_enum, value_name = "SHELL")]
        shell: clap_complete::Shell,
    },
}

/// What `run`, `replay` and `demo` share; each overrides its configuration key.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct ServiceArguments {
    /// Configuration file; `echosplat config` prints one
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Where the map is written on exit; ambiguous Gaussians go beside it
    #[arg(long, value_name = "OUT.ply")]
    pub(crate) map: Option<PathBuf>,
    /// Keeps the map as it is every so many seconds of the dive too, as DIR/0120.ply
    #[arg(long, num_args = 2, value_names = ["SECONDS", "DIR"])]
    pub(crate) maps_every: Option<Vec<String>>,
    /// Directory for recordings of all that is received
    #[arg(long, value_name = "DIR")]
    pub(crate) record: Option<PathBuf>,
    /// What recordings are written as
    #[arg(long, value_name = "FORMAT", value_enum)]
    pub(crate) record_format: Option<RecordFormat>,
    /// Judge the final map against this: a scene, a mesh, points or a simulated dive
    #[arg(long, value_name = "TRUTH")]
    pub(crate) truth: Option<PathBuf>,
    /// Stop after this many seconds of the pings' clock
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) duration: Option<f64>,
    /// Threads of the mapper; 0 takes one per processor
    #[arg(long, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// Seed of everything random
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,
    /// Leave every Nth ping out of the map, for `evaluate --held-out`; 0 leaves out none
    #[arg(long = "hold-out", alias = "hold-back", value_name = "N")]
    pub(crate) hold_back: Option<u64>,
    #[arg(long, value_name = "ADDRESS", help = WEB_HELP)]
    pub(crate) web: Option<String>,
    #[command(flatten)]
    pub(crate) bus: BusArguments,
}

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

#[derive(Debug, Args)]
pub(crate) struct RunArguments {
    #[command(flatten)]
    pub(crate) service: ServiceArguments,
    #[arg(long, value_name = "URL", help = SONAR_HELP)]
    pub(crate) sonar: Option<String>,
    #[arg(long, value_name = "URL", help = POSE_HELP)]
    pub(crate) pose: Option<PoseUrl>,
    /// Added to the pings' times before poses are looked up
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = finite)]
    pub(crate) time_offset_s: Option<f64>,
}

#[derive(Debug, Args)]
pub(crate) struct ReplayArguments {
    #[command(flatten)]
    pub(crate) service: ServiceArguments,
    /// Logs (.svlog), one after another, or the recordings (.mcap) of one dive in their order
    #[arg(value_name = "LOG", required = true)]
    pub(crate) logs: Vec<PathBuf>,
    /// Poses as a TUM file; without, those that the log holds
    #[arg(long, value_name = "F.tum", conflicts_with = "pose")]
    pub(crate) poses: Option<PathBuf>,
    #[arg(long, value_name = "URL", help = POSE_HELP)]
    pub(crate) pose: Option<PoseUrl>,
    /// Added to the pings' times before poses are looked up
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = finite)]
    pub(crate) time_offset_s: Option<f64>,
    /// Times real time; 0 is as fast as possible
    #[arg(long, value_name = "FACTOR", default_value_t = 0.0, value_parser = not_negative)]
    pub(crate) rate: f64,
    /// Leave out what is earlier, in seconds of the log
    #[arg(long, value_name = "SECONDS", value_parser = not_negative)]
    pub(crate) start: Option<f64>,
    /// Leave out what is later, in seconds of the log
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) end: Option<f64>,
    /// Begin again at the end, with an empty map, until told to stop
    #[arg(long = "loop")]
    pub(crate) repeat: bool,
    /// Publish as a live service does, under the node `replay` unless --node names another
    #[arg(long)]
    pub(crate) publish: bool,
    /// The default; kept for scripts
    #[arg(long, hide = true, conflicts_with = "publish")]
    pub(crate) no_publish: bool,
    /// Where the report goes, error against time as HTML; beside --map without
    #[arg(long, value_name = "OUT.html")]
    pub(crate) report: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct DemoArguments {
    /// Where map and report go
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    pub(crate) out: PathBuf,
    /// Only so many seconds of the dive
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) duration: Option<f64>,
    /// Threads of the mapper; 0 takes one per processor
    #[arg(long, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// Leave every Nth ping out of the map; 0 leaves out none
    #[arg(long = "hold-out", alias = "hold-back", value_name = "N")]
    pub(crate) hold_back: Option<u64>,
    #[arg(long, value_name = "ADDRESS", help = WEB_HELP)]
    pub(crate) web: Option<String>,
    #[command(flatten)]
    pub(crate) dive: DiveArguments,
}

/// Which dive is simulated.
#[derive(Debug, Clone, Args)]
pub(crate) struct DiveArguments {
    /// A scene's name (fence, truss, pier, …) or its TOML file
    #[arg(long, value_name = "SCENE", default_value = "fence")]
    pub(crate) scene: String,
    /// How the vehicle moves
    #[arg(long, default_value = "survey", value_parser = dive_kind())]
    pub(crate) dive: DiveKind,
    /// How much is wrong with pings and poses
    #[arg(long, default_value = "nominal", value_parser = noise_level())]
    pub(crate) noise: NoiseLevel,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Pings per second; 40 without
    #[arg(long, value_name = "N", value_parser = positive)]
    pub(crate) pings_per_s: Option<f64>,
}

impl Default for DiveArguments {
    fn default() -> Self {
        Self {
            scene: "fence".to_owned(),
            dive: DiveKind::Survey,
            noise: NoiseLevel::Nominal,
            seed: 1,
            pings_per_s: None,
        }
    }
}

#[derive(Debug, Args)]
pub(crate) struct SimulateArguments {
    #[command(flatten)]
    pub(crate) dive: DiveArguments,
    /// Where the dive goes
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Only so many seconds of the dive
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) duration: Option<f64>,
}

#[derive(Debug, Args)]
pub(crate) struct EmulateArguments {
    #[command(flatten)]
    pub(crate) dive: DiveArguments,
    #[arg(long, value_name = "URL", default_value = "tcp://127.0.0.1:51200", help = LISTEN_HELP)]
    pub(crate) listen: String,
    /// Times real time; 0 is as fast as the client takes it
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = not_negative)]
    pub(crate) rate: f64,
    /// Publish the dive's poses over zenoh, in step with its pings
    #[arg(long)]
    pub(crate) publish_poses: bool,
    /// Clock of these poses; host at rate 1, else device
    #[arg(long, value_enum, value_name = "CLOCK")]
    pub(crate) pose_clock: Option<PoseClock>,
    /// Only so many seconds of the dive
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) duration: Option<f64>,
    #[command(flatten)]
    pub(crate) bus: BusArguments,
}

/// Clock that poses are stamped with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum PoseClock {
    /// This machine's.
    Host,
    /// The dive's own, from 0.
    Device,
}

#[derive(Debug, Args)]
pub(crate) struct ProbeArguments {
    /// Seconds for all places together, tried side by side
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = positive)]
    pub(crate) timeout: f64,
    #[arg(long, value_name = "URL", help = PLACE_HELP)]
    pub(crate) sonar: Vec<String>,
    /// Where the call to all units goes; 255.255.255.255:30303 without --sonar
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub(crate) discovery: Option<String>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct WatchArguments {
    /// Where the map is written on exit; ambiguous Gaussians go beside it
    #[arg(long, value_name = "OUT.ply")]
    pub(crate) map: Option<PathBuf>,
    /// End when the service has published its final map or is gone
    #[arg(long)]
    pub(crate) until_final: bool,
    /// End after this many seconds
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) duration: Option<f64>,
    #[command(flatten)]
    pub(crate) bus: BusArguments,
}

#[derive(Debug, Args)]
pub(crate) struct EvaluateArguments {
    /// The map
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    /// A scene, a mesh, points or a simulated dive's directory
    #[arg(long, value_name = "TRUTH", required_unless_present = "held_out")]
    pub(crate) truth: Option<PathBuf>,
    /// A mesh made of the map (`export --mesh`), judged beside it
    #[arg(long, value_name = "MESH", requires = "truth")]
    pub(crate) mesh: Option<PathBuf>,
    /// Score the pings that `--hold-out N` kept from the map; the map says which
    #[arg(long, alias = "held-back", value_name = "N", num_args = 0..=1, requires = "log",
        value_parser = clap::value_parser!(u64).range(2..))]
    pub(crate) held_out: Option<Option<u64>>,
    /// The log the map was made of
    #[arg(long, value_name = "LOG", requires = "held_out")]
    pub(crate) log: Option<PathBuf>,
    /// Its poses, as a TUM file; not needed where the log holds them
    #[arg(long, value_name = "F.tum", requires = "held_out")]
    pub(crate) poses: Option<PathBuf>,
    /// Draw the held-out pings, measured beside predicted
    #[arg(long, value_name = "OUT.svg", requires = "held_out")]
    pub(crate) picture: Option<PathBuf>,
    /// Configuration file the map was made with: mount, time offset, blanking, beam
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct CalibrateArguments {
    /// A log of a dive around some structure
    #[arg(value_name = "LOG")]
    pub(crate) log: PathBuf,
    /// Its poses, as a TUM file; not needed where the log holds them
    #[arg(long, value_name = "F.tum")]
    pub(crate) poses: Option<PathBuf>,
    /// Configuration file with the mount and time offset to begin with
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Only this one; repeatable
    #[arg(long, value_name = "NAME", value_enum)]
    pub(crate) only: Vec<Parameter>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct InfoArguments {
    /// A recording (.mcap), a log (.svlog), a trajectory (.tum) or a map (.ply); the files of one
    /// recording in order
    #[arg(value_name = "FILE", required = true)]
    pub(crate) files: Vec<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct RecoverArguments {
    /// A recording (.mcap) or a log (.svlog)
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Where the clean one goes; beside it without
    #[arg(long, value_name = "OUT")]
    pub(crate) out: Option<PathBuf>,
}

/// What may be wrong with how poses belong to pings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Parameter {
    /// Time offset between pings and poses
    Time,
    /// The mount's, about up
    Yaw,
    /// The mount's, about left
    Pitch,
    /// The mount's, about forward
    Roll,
}

#[derive(Debug, Args)]
pub(crate) struct RenderArguments {
    /// The map
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    /// Where the sonar is, as a TUM file; not needed where the log holds it
    #[arg(long, value_name = "F.tum", required_unless_present = "log")]
    pub(crate) poses: Option<PathBuf>,
    /// A log whose pings are rendered, measured beside predicted; without one, a ping at each pose
    #[arg(long, value_name = "LOG")]
    pub(crate) log: Option<PathBuf>,
    /// Only the pings at these times, seconds from the first
    #[arg(long, value_name = "SECONDS", num_args = 1.., value_parser = not_negative,
        conflicts_with = "ping")]
    pub(crate) at: Vec<f64>,
    /// Only the pings with these numbers: of the log, or counted from 0 along the poses
    #[arg(long, value_name = "N", num_args = 1..)]
    pub(crate) ping: Vec<u64>,
    /// Sweep the beam over so many degrees from one pose
    #[arg(long, value_name = "DEGREES", value_parser = sweep)]
    pub(crate) sweep_deg: Option<f64>,
    /// Beams of the sweep
    #[arg(long, value_name = "N", default_value_t = 64, requires = "sweep_deg",
        value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub(crate) beams: u32,
    /// Near end of a ping, metres, where no log says it
    #[arg(long, value_name = "METRES", default_value_t = 0.0, conflicts_with = "log",
        value_parser = not_negative)]
    pub(crate) start_m: f64,
    /// Far end of a ping, metres, where no log says it
    #[arg(long, value_name = "METRES", default_value_t = 10.0, conflicts_with = "log",
        value_parser = positive)]
    pub(crate) range_m: f64,
    /// Bins of a ping, where no log says it
    #[arg(long, value_name = "N", default_value_t = 600, conflicts_with = "log")]
    pub(crate) bins: usize,
    /// Speed of sound, metres a second, where no log says it
    #[arg(long, value_name = "MPS", default_value_t = 1500.0, conflicts_with = "log",
        value_parser = positive)]
    pub(crate) speed_of_sound: f64,
    /// Length of the pulse, microseconds, where no log says it
    #[arg(long, value_name = "US", default_value_t = 20.0, conflicts_with = "log",
        value_parser = not_negative)]
    pub(crate) pulse_us: f64,
    /// One sigma of the sensor's position, metres, that blurs the rendering
    #[arg(long, value_name = "METRES", default_value_t = 0.0, value_parser = not_negative)]
    pub(crate) position_sigma_m: f64,
    /// One sigma of its attitude, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, value_parser = not_negative)]
    pub(crate) attitude_sigma_deg: f64,
    /// Let nothing hide anything
    #[arg(long)]
    pub(crate) no_occlusion: bool,
    /// Configuration file: mount, time offset, beam
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// The picture, range upward: PNG, or SVG with axes
    #[arg(long, value_name = "OUT.png|svg")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON object on standard output: intensities per ping and bin
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ExportArguments {
    /// The map; its ambiguous part is found beside it
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    /// Where it goes; the ending says the format
    #[arg(value_name = "OUT.splat|pcd|npz|ply|obj")]
    pub(crate) out: PathBuf,
    /// The surface of what the map asserts as open sheets of triangles, .ply (a sigma per vertex) or .obj
    #[arg(long, conflicts_with = "all")]
    pub(crate) mesh: bool,
    /// Edge of the mesh's cells; larger ones give fewer triangles and lose what is smaller
    #[arg(long, value_name = "METRES", requires = "mesh", default_value_t = CELL_M)]
    pub(crate) cell: f32,
    /// With the ambiguous Gaussians
    #[arg(long)]
    pub(crate) all: bool,
    /// Only what the map asserts, as it is without this too
    #[arg(long, conflicts_with = "all")]
    pub(crate) confident: bool,
}

#[derive(Debug, Args)]
pub(crate) struct BenchArguments {
    #[command(subcommand)]
    pub(crate) bench: Bench,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Bench {
    /// Gaussian–bin pairs per second and core of the rendering kernels
    Kernels(BenchOptions),
    /// Stiff and extreme cases: the program against f64 and against naive f32
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
    /// Each optional part of the mapper on, off and as it chooses by itself
    Ablation(AblationBenchArguments),
    /// Hours of diving past several structures: whether memory, work per ping and the first structure's
    /// map stay as they were
    Long(LongBenchArguments),
    /// The running service killed, unplugged, lied to and flooded: what is told, lost and left
    Faults(FaultsBenchArguments),
    /// Error-time, ablation, stability and targets in turn, each within its share of the time
    All(AllBenchArguments),
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
    /// Only this section (accuracy, field, shift, more, live, work, length, threads, frames, own,
    /// paper) or this scene; repeatable, and SECTION/SCENE takes what is both
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
    /// Other settings in place of the mapper's parts, as KEY=ON,OFF,AUTO; repeatable
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

fn dive_kind() -> impl TypedValueParser<Value = DiveKind> {
    PossibleValuesParser::new(DiveKind::ALL.map(DiveKind::as_str))
        .try_map(|name| name.parse::<DiveKind>())
}

fn noise_level() -> impl TypedValueParser<Value = NoiseLevel> {
    PossibleValuesParser::new(NoiseLevel::ALL.map(NoiseLevel::as_str))
        .try_map(|name| name.parse::<NoiseLevel>())
}

fn number(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .map_err(|_| "it must be a number".to_owned())
}

fn finite(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    match value.is_finite() {
        true => Ok(value),
        false => Err("it must be finite".to_owned()),
    }
}

fn not_negative(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    match value >= 0.0 {
        true => Ok(value),
        false => Err("it must be 0 or more".to_owned()),
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    match value > 0.0 {
        true => Ok(value),
        false => Err("it must be more than 0".to_owned()),
    }
}

fn sweep(text: &str) -> Result<f64, String> {
    let value = positive(text)?;
    match value <= 360.0 {
        true => Ok(value),
        false => Err("it must be at most 360".to_owned()),
    }
}

fn part(text: &str) -> Result<(String, [String; 3]), String> {
    let wrong = || "it must read KEY=ON,OFF,AUTO, as in mapper.workout_passes=32,4,16".to_owned();
    let (key, values) = text.split_once('=').ok_or_else(wrong)?;
    let values: Vec<String> = values.split(',').map(str::to_owned).collect();
    Ok((key.to_owned(), values.try_into().map_err(|_| wrong())?))
}

fn key_and_value(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((key, value)) if !key.is_empty() => Ok((key.to_owned(), value.to_owned())),
        _ => Err("it must read key=json5, as in connect/endpoints=[\"tcp/10.0.0.2:7447\"]".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
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
    fn seeds_count_from_the_first() {
        let seeds = |more: &[&str]| {
            let words = ["echosplat", "bench", "targets"].iter().chain(more);
            let Ok(Arguments {
                command: Command::Bench(bench),
                ..
            }) = Arguments::try_parse_from(words)
            else {
                panic!("bench takes them");
            };
            match bench.bench {
                Bench::Targets(arguments) => arguments.queue.seeds_of(&arguments.options),
                _ => panic!("it is another bench"),
            }
        };
        assert_eq!(seeds(&["--seed", "3", "--seeds", "2"]), [3, 4]);
        assert_eq!(seeds(&["--quick"]), [1]);
        assert_eq!(seeds(&[]).len(), 5);
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
