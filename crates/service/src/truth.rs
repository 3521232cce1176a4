//! The truth a map is judged by: a scene, a mesh, points, or what a simulated dive left behind.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use echosplat_metrics::Truth;
use echosplat_recording::replace::replace_file;
use echosplat_simulator::{BUILT_IN_SCENES, Dive, Scene, SurfacePoint, seen_surface};

use crate::dives;
use crate::exit::Usage;
use crate::scene_files::SceneFiles;

const SCENE_FILE: &str = "scene.toml";
const SEEN_FILE: &str = "seen.ply";
const DIRECTORY: &str = "truth";

/// By what `path` is: a simulated dive's directory (then only what its pings saw is asked for), a
/// scene, its built-in name, a mesh, or points.
///
/// # Errors
/// Says what is wrong with it.
pub(crate) fn load(path: &Path) -> anyhow::Result<Truth> {
    for directory in [path.to_owned(), path.join(DIRECTORY)] {
        if directory.join(SEEN_FILE).is_file() {
            return of_dive(&directory);
        }
    }
    let name = path.to_str().unwrap_or_default();
    if !path.exists() && BUILT_IN_SCENES.iter().any(|(known, _)| *known == name) {
        return Ok(Truth::from_scene(&Arc::new(dives::scene(name)?), None));
    }
    load_file(path)
}

fn load_file(path: &Path) -> anyhow::Result<Truth> {
    Truth::load(path).map_err(|error| refused(&error))
}

/// The error names the file.
fn refused(error: &dyn std::fmt::Display) -> anyhow::Error {
    Usage::error(format!("truth: {error}"))
}

/// The scene's surface, and of it what was seen; the file of that holds places only, what they
/// belong to is asked of the scene.
fn of_dive(directory: &Path) -> anyhow::Result<Truth> {
    let scene_file = directory.join(SCENE_FILE);
    let scene = Scene::load(&scene_file).map_err(|error| refused(&error))?;
    let places = load_file(&directory.join(SEEN_FILE))?;
    let surface_point = |place: &SurfacePoint| {
        let (_, normal, is_seabed) = scene.nearest(place.position);
        SurfacePoint {
            position: place.position,
            normal,
            is_seabed,
        }
    };
    let seen = places.seen().iter().map(surface_point).collect();
    Ok(Truth::from_scene(&Arc::new(scene), Some(seen)))
}

/// What a dive's map is judged by, without a detour over files.
pub fn of_simulated(scene: &Arc<Scene>, dive: &Dive) -> Truth {
    Truth::from_scene(scene, Some(seen_surface(scene, dive)))
}

/// Writes `DIR/truth/`: the scene's file with its meshes, and the places seen, as binary PLY with
/// normals.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn write(
    directory: &Path,
    scene_files: &SceneFiles,
    scene: &Scene,
    dive: &Dive,
) -> anyhow::Result<()> {
    let directory = directory.join(DIRECTORY);
    std::fs::create_dir_all(&directory)
        .and_then(|()| scene_files.write(&directory, SCENE_FILE))
        .and_then(|()| {
            let seen = points_ply(&seen_surface(scene, dive));
            replace_file(&directory.join(SEEN_FILE), |file| file.write_all(&seen))
        })
        .with_context(|| format!("cannot write the truth to {}", directory.display()))
}

fn points_ply(points: &[SurfacePoint]) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
        points.len()
    );
    for property in ["x", "y", "z", "nx", "ny", "nz"] {
        bytes += &format!("property double {property}\n");
    }
    let mut bytes = (bytes + "end_header\n").into_bytes();
    for point in points {
        let numbers = point.position.to_array().into_iter();
        for number in numbers.chain(point.normal.to_array()) {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_simulator::{DiveKind, DiveOptions, NoiseLevel};

    #[test]
    fn what_a_dive_saw_survives_its_files() {
        let text = BUILT_IN_SCENES[0].1;
        let scene = Scene::parse(text, None).unwrap();
        let options = DiveOptions {
            duration_s: 3.0,
            ..DiveOptions::default()
        };
        let dive = Dive::plan_with(DiveKind::Survey, &scene, NoiseLevel::None, 1, &options);
        let dive = dive.unwrap();
        let directory = tempfile::tempdir().unwrap();
        let files = SceneFiles::of(text, Path::new("")).unwrap();
        write(directory.path(), &files, &scene, &dive).unwrap();
        let read = load(directory.path()).unwrap();
        let direct = of_simulated(&Arc::new(scene), &dive);
        let places =
            |truth: &Truth| -> Vec<_> { truth.seen().iter().map(|p| p.position).collect() };
        assert_eq!(places(&read), places(&direct));
        assert!(!read.seen().is_empty());
    }
}
