//! Simulated dives as the command line names them.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use echosplat_simulator::{
    BUILT_IN_SCENES, DISTURBANCE_KEYS, DisturbanceKey, Disturbances, Dive, DiveOptions, NoiseLevel,
    Scene, SimulatedSonar,
};
use rayon::prelude::*;

use crate::arguments::DiveArguments;
use crate::exit::Usage;

/// A scene by its built-in name, or from a file.
///
/// # Errors
/// If it is neither, or the file is no scene.
pub(crate) fn scene(name_or_path: &str) -> anyhow::Result<Scene> {
    scene_with_text(name_or_path).map(|(scene, _)| scene)
}

/// The same, with the text it was made of.
///
/// # Errors
/// As [`scene`].
pub(crate) fn scene_with_text(name_or_path: &str) -> anyhow::Result<(Scene, String)> {
    let built_in = BUILT_IN_SCENES
        .iter()
        .find(|(name, _)| *name == name_or_path);
    let is_path = Path::new(name_or_path).exists() || name_or_path.contains(['/', '.']);
    match (built_in, is_path) {
        (None, true) => Scene::load_with_text(name_or_path),
        (found, _) => {
            let text = found.map_or("", |(_, text)| text).to_owned();
            Scene::named(name_or_path).map(|scene| (scene, text))
        }
    }
    .map_err(|error| Usage::error(format!("--scene: {error}")))
}

/// Plans the dive and makes the sonar that is carried along it.
///
/// # Errors
/// If there is no such scene, or the dive cannot be made in it.
pub fn sonar(arguments: &DiveArguments, duration_s: Option<f64>) -> anyhow::Result<SimulatedSonar> {
    sonar_with(
        arguments,
        duration_s,
        arguments.noise,
        Disturbances::default(),
    )
}

/// As [`sonar`], with poses of another noise than that of the pings, and what the water adds.
///
/// # Errors
/// As [`sonar`].
pub fn sonar_with(
    arguments: &DiveArguments,
    duration_s: Option<f64>,
    pose_noise: NoiseLevel,
    disturbances: Disturbances,
) -> anyhow::Result<SimulatedSonar> {
    let scene = scene(&arguments.scene)?;
    made(scene, arguments, duration_s, pose_noise, disturbances)
}

/// As [`sonar`], in a scene that was read already, on a dive with disturbances.
///
/// # Errors
/// If the dive cannot be made in it, or a disturbance cannot be in this dive.
pub(crate) fn sonar_disturbed(
    scene: Scene,
    arguments: &DiveArguments,
    duration_s: Option<f64>,
    disturbances: Disturbances,
) -> anyhow::Result<SimulatedSonar> {
    made(scene, arguments, duration_s, arguments.noise, disturbances)
}

fn made(
    scene: Scene,
    arguments: &DiveArguments,
    duration_s: Option<f64>,
    pose_noise: NoiseLevel,
    disturbances: Disturbances,
) -> anyhow::Result<SimulatedSonar> {
    let defaults = DiveOptions::default();
    let options = DiveOptions {
        duration_s: duration_s.unwrap_or(defaults.duration_s),
        pings_per_s: arguments.pings_per_s.unwrap_or(defaults.pings_per_s),
        disturbances,
        ..defaults
    };
    let noise = arguments.noise;
    let dive = Dive::plan_with(arguments.dive, &scene, pose_noise, arguments.seed, &options)
        .map_err(|error| Usage::error(format!("--scene {}: {error}", arguments.scene)))?;
    let (scene, dive) = (Arc::new(scene), Arc::new(dive));
    Ok(SimulatedSonar::new(scene, dive, noise, arguments.seed))
}

/// What `--disturb` says of itself in `--help`.
pub(crate) fn disturb_help() -> String {
    let off = Disturbances::default();
    let line = |key: &DisturbanceKey| {
        let (low, high) = key.range;
        let (name, meaning) = (key.name, key.meaning);
        let default = key.of(&off);
        let unless_given = match default.is_finite() {
            true => format!("; {default} without"),
            false => String::new(),
        };
        format!("\n  {name:17} {meaning} ({low} to {high}{unless_given})")
    };
    let keys: String = DISTURBANCE_KEYS.iter().map(line).collect();
    format!(
        "What the water adds, as KEY=VALUE; repeatable. Nothing without; each comes from the dive's seed and \
         changes nothing else of it:\n{keys}"
    )
}

/// The frames of some pings as the device sends them, made on all processors.
pub(crate) fn frames(sonar: &SimulatedSonar, pings: Range<usize>, device_id: u8) -> Vec<Vec<u8>> {
    pings
        .into_par_iter()
        .filter_map(|index| sonar.ping(index).frame(device_id))
        .collect()
}
