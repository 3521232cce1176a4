//! Of the commands that simulate.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use echosplat_simulator::{DiveKind, NoiseLevel};

use super::bus::BusArguments;
use super::values::{dive_kind, noise_level, not_negative, positive};

const LISTEN_HELP: &str =
    "tcp://HOST:PORT, udp://HOST:PORT, serial:///PATH/OF/LINK or serial://pty";

/// Which dive is simulated.
#[derive(Debug, Clone, Args)]
pub struct DiveArguments {
    /// A scene's name (fence, truss, pier, …) or its TOML file
    #[arg(long, value_name = "SCENE", default_value = "fence")]
    pub scene: String,
    /// How the vehicle moves
    #[arg(long, default_value = "survey", value_parser = dive_kind())]
    pub dive: DiveKind,
    /// How much is wrong with pings and poses
    #[arg(long, default_value = "nominal", value_parser = noise_level())]
    pub noise: NoiseLevel,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Pings per second; 40 without
    #[arg(long, value_name = "N", value_parser = positive)]
    pub pings_per_s: Option<f64>,
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
pub struct SimulateArguments {
    #[command(flatten)]
    pub(crate) dive: DiveArguments,
    /// Where the dive goes
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Only so many seconds of the dive
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) duration: Option<f64>,
    /// What the water adds, as KEY=VALUE; repeatable, --help lists the keys
    #[arg(long, value_name = "KEY=VALUE", long_help = crate::dives::disturb_help())]
    pub(crate) disturb: Vec<String>,
}

#[derive(Debug, Args)]
pub struct EmulateArguments {
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
