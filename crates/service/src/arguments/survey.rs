//! Of the commands that measure in maps.

use std::path::PathBuf;

use clap::Args;
use echosplat_model::glam::DVec3;

use super::values::{place, positive};

#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("what").required(true)))]
pub struct MeasureArguments {
    /// The map; its ambiguous part is left out
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    /// From one place of the map to another: straight, along the ground, and how much higher; metres of the world
    #[arg(long, num_args = 2, value_names = ["X,Y,Z", "X,Y,Z"], value_parser = place, allow_hyphen_values = true,
        group = "what")]
    pub(crate) distance: Option<Vec<DVec3>>,
    /// The pile that stands there: diameter, lean and height
    #[arg(long, value_name = "X,Y,Z", value_parser = place, allow_hyphen_values = true, group = "what")]
    pub(crate) pile: Option<DVec3>,
    /// The plane that lies there, and its tilt
    #[arg(long, value_name = "X,Y,Z", value_parser = place, allow_hyphen_values = true, group = "what")]
    pub(crate) plane: Option<DVec3>,
    /// The highest along a line, seen from above
    #[arg(long, num_args = 2, value_names = ["X,Y,Z", "X,Y,Z"], value_parser = place, allow_hyphen_values = true,
        group = "what")]
    pub(crate) profile: Option<Vec<DVec3>>,
    /// All that lies along a line
    #[arg(long, num_args = 2, value_names = ["X,Y,Z", "X,Y,Z"], value_parser = place, allow_hyphen_values = true,
        group = "what")]
    pub(crate) section: Option<Vec<DVec3>>,
    /// How far around the places given the map is looked at; of a pile along the ground (1 m without), of a plane all
    /// around (1 m), of a distance from its ends (0.5 m), of a profile or section beside the line (0.25 m)
    #[arg(long, value_name = "METRES", value_parser = positive)]
    pub(crate) within: Option<f64>,
    /// Pieces of a profile
    #[arg(long, value_name = "METRES", value_parser = positive, default_value_t = 0.1, requires = "profile")]
    pub(crate) step: f64,
    /// Where what was measured goes as a shape on Earth, or as rows
    #[arg(long, value_name = "OUT.geojson|kml|csv")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub struct CompareArguments {
    /// The map of before
    #[arg(value_name = "BEFORE.ply")]
    pub(crate) before: PathBuf,
    /// The map of after
    #[arg(value_name = "AFTER.ply")]
    pub(crate) after: PathBuf,
    /// Where what changed goes as points on Earth
    #[arg(long, value_name = "OUT.geojson|kml")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}
