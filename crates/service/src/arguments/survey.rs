//! Of the commands that measure in maps.

use std::path::PathBuf;

use clap::Args;
use echosplat_model::glam::DVec3;

use super::values::{key_and_value, place, positive};
use crate::measuring::{Asked, STEP_M, What};

#[derive(Debug, Args)]
pub struct MeasureArguments {
    /// The map; its ambiguous part is left out
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    #[command(flatten)]
    pub(crate) asked: AskedArguments,
    /// Where what was measured goes as a shape on Earth, or as rows
    #[arg(long, value_name = "OUT.geojson|kml|csv")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub struct ReportArguments {
    /// The map; its ambiguous part is found beside it
    #[arg(value_name = "MAP.ply")]
    pub(crate) map: PathBuf,
    /// Where the report goes; beside the map without
    #[arg(long, value_name = "OUT.html")]
    pub(crate) out: Option<PathBuf>,
    /// The dive's recordings, or what a run printed with --json: track, settings, date, and how pings scored
    #[arg(long, value_name = "FILE", num_args = 1..)]
    pub(crate) dive: Vec<PathBuf>,
    /// The dive's poses, where no recording holds them: a TUM file or a log
    #[arg(long, value_name = "FILE")]
    pub(crate) track: Option<PathBuf>,
    /// Its heading
    #[arg(long, value_name = "TEXT")]
    pub(crate) title: Option<String>,
    /// A line of the title block, as "Client=Harbour Ltd"; repeatable
    #[arg(long, value_name = "NAME=TEXT", value_parser = key_and_value)]
    pub(crate) about: Vec<(String, String)>,
    /// Measures, a line each as `measure` takes them behind the map; what stands behind # is its name
    #[arg(long, value_name = "FILE")]
    pub(crate) measures: Option<PathBuf>,
    /// From one place of the map to another; this and those below are repeatable
    #[arg(long, num_args = 2, value_names = ["X,Y,Z", "X,Y,Z"], value_parser = place, allow_hyphen_values = true)]
    pub(crate) distance: Vec<DVec3>,
    /// The pile that stands there
    #[arg(long, value_name = "X,Y,Z", value_parser = place, allow_hyphen_values = true)]
    pub(crate) pile: Vec<DVec3>,
    /// The plane that lies there
    #[arg(long, value_name = "X,Y,Z", value_parser = place, allow_hyphen_values = true)]
    pub(crate) plane: Vec<DVec3>,
    /// The highest along a line
    #[arg(long, num_args = 2, value_names = ["X,Y,Z", "X,Y,Z"], value_parser = place, allow_hyphen_values = true)]
    pub(crate) profile: Vec<DVec3>,
    /// All that lies along a line
    #[arg(long, num_args = 2, value_names = ["X,Y,Z", "X,Y,Z"], value_parser = place, allow_hyphen_values = true)]
    pub(crate) section: Vec<DVec3>,
}

impl ReportArguments {
    /// What is measured without a file, in the order of their kinds.
    pub(crate) fn asked(&self) -> Vec<Asked> {
        let one = |all: &[DVec3], what: fn(DVec3) -> What| -> Vec<What> {
            all.iter().map(|at_m| what(*at_m)).collect()
        };
        let two = |all: &[DVec3], what: fn([DVec3; 2]) -> What| -> Vec<What> {
            let ends = all.chunks_exact(2);
            ends.map(|ends| what([ends[0], ends[1]])).collect()
        };
        let all = [
            two(&self.distance, What::Distance),
            one(&self.pile, What::Pile),
            one(&self.plane, What::Plane),
            two(&self.profile, What::Profile),
            two(&self.section, What::Section),
        ];
        all.concat().into_iter().map(Asked::usual).collect()
    }
}

#[derive(Debug, Args)]
pub struct CompareArguments {
    /// The map of before
    #[arg(value_name = "BEFORE.ply")]
    pub(crate) before: PathBuf,
    /// The map of after
    #[arg(value_name = "AFTER.ply")]
    pub(crate) after: PathBuf,
    /// Where what changed goes: as points on Earth, or in colours on a page that turns the map and prints
    #[arg(long, value_name = "OUT.geojson|kml|html")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// One size of a map.
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("what").required(true)))]
pub(crate) struct AskedArguments {
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
    #[arg(long, value_name = "METRES", value_parser = positive, default_value_t = STEP_M, requires = "profile")]
    pub(crate) step: f64,
}

impl AskedArguments {
    /// # Errors
    /// If nothing is asked for, which the command line does not let through.
    pub(crate) fn asked(&self) -> Result<Asked, String> {
        let ends = |given: &Option<Vec<DVec3>>| given.as_deref()?.try_into().ok();
        let what = ends(&self.distance)
            .map(What::Distance)
            .or(self.pile.map(What::Pile))
            .or(self.plane.map(What::Plane))
            .or_else(|| ends(&self.profile).map(What::Profile))
            .or_else(|| ends(&self.section).map(What::Section));
        Ok(Asked {
            what: what.ok_or(
                "nothing is asked for: --distance, --pile, --plane, --profile or --section",
            )?,
            within_m: self.within,
            step_m: self.step,
        })
    }
}
