//! Of the commands that map, and of those that look at what is there.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use echosplat_pose::PoseUrl;

use super::bus::BusArguments;
use super::dives::DiveArguments;
use super::files::PlaceArguments;
use super::values::{finite, not_negative, positive};
use crate::config::RecordFormat;

const SONAR_HELP: &str = "The sonar: tcp://HOST:PORT, udp://HOST:PORT, \
     serial:///DEVICE?baudrate=N, sim://SCENE or file://LOG.svlog";
const POSE_HELP: &str = "The poses: zenoh://[KEY], mavlink+udp://HOST:PORT[?out], \
     mavlink+tcp://HOST:PORT, mavlink+serial:///DEVICE?baudrate=N, mavlink+zenoh://[PREFIX], \
     each of these four with ?velocity=dvl://HOST for velocities of a DVL beside an autopilot without positions, \
     dvl://HOST, ros2:///TOPIC, log://, tum://POSES.tum or none";
const PLACE_HELP: &str = "Try only there: tcp://HOST:PORT, udp://HOST:PORT or \
     serial:///DEVICE?baudrate=N; repeatable";
const WEB_HELP: &str = "Serves the live page there: HOST:PORT, or a PORT of this machine alone, \
     like 8080; 0.0.0.0:8080 for other machines too";

/// What `run`, `replay` and `demo` share; each overrides its configuration key.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct ServiceArguments {
    /// Configuration file; `echosplat config` prints one
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Where the map is written on exit, `{time}` as when the run began; ambiguous Gaussians go beside it
    #[arg(long, value_name = "OUT.ply")]
    pub(crate) map: Option<PathBuf>,
    /// Where the vehicle's way is written on exit as the map has it, corrected where poses drift: OUT.tum, or OUT.csv with
    /// what was added and its sigmas
    #[arg(long, value_name = "OUT.tum")]
    pub(crate) track: Option<PathBuf>,
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
    pub(crate) place: PlaceArguments,
    #[command(flatten)]
    pub(crate) bus: BusArguments,
}

#[derive(Debug, Args)]
pub struct RunArguments {
    #[command(flatten)]
    pub(crate) service: ServiceArguments,
    #[arg(long, value_name = "URL", help = SONAR_HELP)]
    pub(crate) sonar: Option<String>,
    #[arg(long, value_name = "URL", help = POSE_HELP)]
    pub(crate) pose: Option<PoseUrl>,
    /// Added to the pings' times before poses are looked up
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = finite)]
    pub(crate) time_offset_s: Option<f64>,
    /// Which part of the work this machine does; a driver and a mapper of one --node belong together
    #[arg(long, value_name = "ROLE", value_enum, default_value_t = Role::All)]
    pub(crate) role: Role,
    /// With --role mapper: map first what these recordings hold of the dive, a mapper's or its
    /// driver's in their order, then what comes
    #[arg(long, value_name = "DIVE.mcap", num_args = 1..)]
    pub(crate) resume: Vec<PathBuf>,
}

/// Which part of the work of a dive is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub(crate) enum Role {
    /// All of it
    #[default]
    All,
    /// On the vehicle: sonar, poses and recording; no map
    Driver,
    /// Elsewhere: the map, of what the driver hears
    Mapper,
}

#[derive(Debug, Args)]
pub struct ReplayArguments {
    #[command(flatten)]
    pub(crate) service: ServiceArguments,
    /// Logs (.svlog), one after another, or the recordings (.mcap) of one dive in their order
    #[arg(value_name = "LOG", required = true)]
    pub(crate) logs: Vec<PathBuf>,
    /// Poses as a TUM file, or in an MCAP file of another program (F.mcap, or F.mcap#/TOPIC); without, those that
    /// the log holds
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
    /// Make nothing but the finished map, in about two thirds of the time: work on it waits for the end of the log
    #[arg(long, conflicts_with_all = ["publish", "web", "maps_every", "repeat"])]
    pub(crate) finished_only: bool,
    /// Publish as a live service does, under the node `replay` unless --node names another
    #[arg(long)]
    pub(crate) publish: bool,
    /// The default; kept for scripts
    #[arg(long, hide = true, conflicts_with = "publish")]
    pub(crate) no_publish: bool,
    /// Where the report goes, one HTML file; with --truth beside --map without
    #[arg(long, value_name = "OUT.html")]
    pub(crate) report: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub struct DemoArguments {
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

#[derive(Debug, Args)]
pub struct ProbeArguments {
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
pub struct WatchArguments {
    /// Where the map is written, each minute and at the end; ambiguous Gaussians go beside it
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
