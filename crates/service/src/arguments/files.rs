//! Of the commands that work on files: maps, logs, recordings.

use std::path::PathBuf;

use clap::Args;
use echosplat_georeference::Datum;
use echosplat_model::glam::DVec3;
use echosplat_recording::export::Up;

use super::values::{datum, day, finite, not_negative, place, positive, sweep, up_axis};

#[derive(Debug, Args)]
pub struct EvaluateArguments {
    /// The map
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    /// A scene, a mesh, points or a simulated dive's directory
    #[arg(long, value_name = "TRUTH", required_unless_present = "held_out")]
    pub(crate) truth: Option<PathBuf>,
    /// A mesh made of the map (`export --mesh`), judged beside it
    #[arg(long, value_name = "MESH", requires = "truth")]
    pub(crate) mesh: Option<PathBuf>,
    /// Also with the map shifted and turned onto the truth: what poses that drift do beside that
    #[arg(long, requires = "truth")]
    pub(crate) aligned: bool,
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
pub struct CalibrateArguments {
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
pub struct RenderArguments {
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
pub struct ExportArguments {
    /// The map; its ambiguous part is found beside it
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    /// Where it goes; the ending says the format
    #[arg(value_name = "OUT.splat|pcd|npz|ply|obj|glb|las|laz|tif|geojson|kml|csv|tum")]
    pub(crate) out: PathBuf,
    /// The surface of what the map asserts as open sheets of triangles, .ply (a sigma per vertex), .obj or .glb
    #[arg(long, conflicts_with = "all")]
    pub(crate) mesh: bool,
    /// Edge of the cells of a mesh (0.035 without) or of a .tif (0.1); larger ones lose what is smaller
    #[arg(long, value_name = "METRES", value_parser = finite)]
    pub(crate) cell: Option<f64>,
    /// The axis of the file that points up: z as the map has it, y for programs of computer graphics, -y for
    /// viewers of Gaussians
    #[arg(long, value_name = "z|y|-y", default_value = "z", value_parser = up_axis(), allow_hyphen_values = true)]
    pub(crate) up: Up,
    /// With the ambiguous Gaussians
    #[arg(long)]
    pub(crate) all: bool,
    /// The dive's poses, for .csv, .tum, .geojson and .kml: a TUM file, a recording or a log
    #[arg(long, value_name = "FILE")]
    pub(crate) track: Option<PathBuf>,
    /// Coordinates of .las, .laz, .tif and .csv; the UTM zone of the place without
    #[arg(long, value_name = "EPSG:CODE")]
    pub(crate) crs: Option<String>,
    #[command(flatten)]
    pub(crate) place: PlaceArguments,
    /// Height over the WGS 84 ellipsoid of what heights are counted from; they are then told over the ellipsoid
    #[arg(long, value_name = "METRES", value_parser = finite, allow_negative_numbers = true)]
    pub(crate) separation: Option<f64>,
    /// Only what the map asserts, as it is without this too
    #[arg(long, conflicts_with = "all")]
    pub(crate) confident: bool,
}

/// Where on Earth the world's origin lies.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct PlaceArguments {
    /// Where on Earth the world's origin lies: degrees north, degrees east, metres up
    #[arg(long, value_name = "LAT,LON,ALT", allow_hyphen_values = true)]
    pub(crate) origin: Option<String>,
    /// What its metres up are counted from: surface (of the water, without this), msl or ellipsoid
    #[arg(long, value_name = "DATUM", value_parser = datum(), requires = "origin")]
    pub(crate) datum: Option<Datum>,
    /// Heading of the world's x axis, degrees from true north; 90, which is east, without
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, value_parser = finite)]
    pub(crate) heading: Option<f64>,
}

#[derive(Debug, Args)]
pub struct GeoreferenceArguments {
    /// The map; its ambiguous part is found beside it
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    /// A point that is known in the map (metres) and on Earth (degrees, metres down); three find the heading too
    #[arg(
        long,
        value_name = "X,Y,Z=LAT,LON,DEPTH",
        allow_hyphen_values = true,
        conflicts_with = "origin"
    )]
    pub(crate) tie: Vec<String>,
    #[command(flatten)]
    pub(crate) place: PlaceArguments,
    /// --heading is by a magnetic compass: its declination there is added
    #[arg(long, requires = "heading")]
    pub(crate) magnetic: bool,
    /// The day of the dive, for the declination; today without
    #[arg(long, value_name = "YYYY-MM-DD", value_parser = day)]
    pub(crate) date: Option<i64>,
    /// Where the map with its place goes; without, into the map itself
    #[arg(long, value_name = "OUT.ply")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub struct InfoArguments {
    /// Recordings (.mcap), logs (.svlog), trajectories (.tum), maps (.ply) and bags of other programs (.mcap); the
    /// files of one dive are told as one
    #[arg(value_name = "FILE", required = true)]
    pub(crate) files: Vec<PathBuf>,
    /// Of maps: tell why what they say of this place is confident, ambiguous or not there; world coordinates, metres
    #[arg(long, value_name = "X,Y,Z", value_parser = place, allow_hyphen_values = true)]
    pub(crate) why: Option<DVec3>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub struct RecoverArguments {
    /// A recording (.mcap) or a log (.svlog)
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Where the clean one goes; beside it without
    #[arg(long, value_name = "OUT")]
    pub(crate) out: Option<PathBuf>,
    /// For programs of ROS: bytes, poses, map and frame alone, as OUT.ros.mcap
    #[arg(long)]
    pub(crate) ros: bool,
}
