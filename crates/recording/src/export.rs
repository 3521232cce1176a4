//! The map in formats of other programs: `.splat` for web viewers, PCD for point cloud tools, npz for
//! numpy, PLY in one file, and glTF; a surface made of it as PLY, OBJ or glTF; on Earth, what [`placed`] has.
//!
//! All in world coordinates. All but npz and OBJ have single precision, which keeps a millimetre up to
//! 10 km from the world's origin; [`in_world`] leaves a map beyond that relative to its own origin.
//! Readers of point clouds take no double: PCL reads such coordinates and then has no point.

mod glb;
mod mesh;
mod npz;
pub mod placed;
mod up;

use std::io::{self, Write};

use echosplat_model::Gaussian;
use echosplat_model::glam::{DVec3, Vec3};
use echosplat_ply::Written;

use crate::ply::{MapFile, notes};
use crate::ramp::color_of_reflectivity;
pub use glb::{write_gaussians_glb, write_mesh_glb};
pub use mesh::{WrittenMesh, write_mesh_obj, write_mesh_ply};
pub use npz::write_npz;
pub use up::Up;

/// Furthest that single precision keeps a millimetre.
pub const SINGLE_PRECISION_M: f64 = 10_000.0;

/// The map with its origin added to every mean, where single precision allows it and every Gaussian
/// can be there; else as it is.
#[must_use]
pub fn in_world(mut map: MapFile) -> MapFile {
    let origin_m = map.origin_m;
    let moved = |gaussian: &Gaussian| Gaussian {
        mean_m: world_m(origin_m, gaussian).as_vec3(),
        ..*gaussian
    };
    let can_be = |gaussian: &Gaussian| !gaussian.is_sound() || moved(gaussian).is_sound();
    if origin_m.length() > SINGLE_PRECISION_M || !map.gaussians.iter().all(can_be) {
        return map;
    }
    map.gaussians = map.gaussians.iter().map(moved).collect();
    map.origin_m = DVec3::ZERO;
    map
}

fn world_m(origin_m: DVec3, gaussian: &Gaussian) -> DVec3 {
    world_of(origin_m, gaussian.mean_m)
}

fn world_of(origin_m: DVec3, place_m: Vec3) -> DVec3 {
    origin_m + place_m.as_dvec3()
}

/// Those that are sound, as every format has them.
fn sound(map: &MapFile) -> impl Iterator<Item = &Gaussian> {
    map.gaussians.iter().filter(|gaussian| gaussian.is_sound())
}

/// Writes `.splat`: 32-byte records of position (f32 × 3), scale (f32 × 3), colour and opacity
/// (u8 × 4) and rotation (w x y z, u8 × 4, 128 + 128·q), relative to the map's origin: give it a map
/// that is [`in_world`]. Nothing in it has room for a version: this is the only one.
///
/// # Errors
/// Of the writer.
pub fn write_splat(map: &MapFile, mut writer: impl Write) -> io::Result<()> {
    for gaussian in sound(map) {
        let (mean, scale) = (gaussian.mean_m.to_array(), gaussian.scale_m.to_array());
        for value in mean.into_iter().chain(scale) {
            writer.write_all(&value.to_le_bytes())?;
        }
        let [r, g, b] = color_of_reflectivity(gaussian.reflectivity);
        writer.write_all(&[r, g, b, gaussian.opacity].map(|c| (255.0 * c).round() as u8))?;
        let q = gaussian.rotation;
        writer.write_all(&[q.w, q.x, q.y, q.z].map(|c| (128.0 + 128.0 * c).round() as u8))?;
    }
    writer.flush()
}

/// Writes PCD 0.7, binary, all f32: `x y z` (metres), `intensity` (reflectivity, dB), `opacity` and
/// `sigma` (metres, may be infinite). Relative to the map's origin, which the header's comment
/// `# origin_m X Y Z` says: give it a map that is [`in_world`]. `# echosplat_points N` is the version of this format.
///
/// # Errors
/// Of the writer.
pub fn write_pcd(map: &MapFile, mut writer: impl Write) -> io::Result<()> {
    let count = sound(map).count();
    writeln!(
        writer,
        "# .PCD v0.7 - Point Cloud Data file format\n# {}\n# {}\nVERSION 0.7\n\
         FIELDS x y z intensity opacity sigma\nSIZE 4 4 4 4 4 4\nTYPE F F F F F F\n\
         COUNT 1 1 1 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
         POINTS {count}\nDATA binary",
        Written::POINTS.comment(),
        notes::origin(map.origin_m)
    )?;
    for gaussian in sound(map) {
        let [x, y, z] = gaussian.mean_m.to_array();
        let intensity_db = reflectivity_db(gaussian);
        for value in [x, y, z, intensity_db, gaussian.opacity, gaussian.sigma_m] {
            writer.write_all(&value.to_le_bytes())?;
        }
    }
    writer.flush()
}

fn reflectivity_db(gaussian: &Gaussian) -> f32 {
    10.0 * gaussian.reflectivity.max(f32::MIN_POSITIVE).log10()
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::Quat;
    use echosplat_model::{MAX_PLACE_M, Standing};

    pub(super) fn map() -> MapFile {
        let gaussian = Gaussian {
            id: 0,
            mean_m: Vec3::new(1.0, 2.0, 3.0),
            rotation: Quat::IDENTITY,
            scale_m: Vec3::splat(0.5),
            opacity: 1.0,
            reflectivity: 0.1,
            sigma_m: 0.25,
            position_covariance_m2: Gaussian::known_alike_m2(0.25),
            probability: 1.0,
            standing: Standing::Confident,
            why: echosplat_model::Why::default(),
        };
        MapFile {
            origin_m: DVec3::new(1e6, 0.0, 0.0),
            gaussians: vec![gaussian],
            ..MapFile::default()
        }
    }

    #[test]
    fn a_splat_has_32_bytes() {
        let mut bytes = Vec::new();
        write_splat(&map(), &mut bytes).unwrap();
        assert_eq!(bytes.len(), 32);
        assert_eq!(bytes[..4], 1.0_f32.to_le_bytes());
        assert_eq!(bytes[12..16], 0.5_f32.to_le_bytes());
        assert_eq!(bytes[27..], [255, 255, 128, 128, 128]);
    }

    #[test]
    fn a_point_cloud_is_in_single_precision_and_says_where_it_counts_from() {
        let mut bytes = Vec::new();
        write_pcd(&map(), &mut bytes).unwrap();
        let head = b"POINTS 1\nDATA binary\n";
        let at = bytes.windows(head.len()).position(|w| w == head).unwrap() + head.len();
        let text = String::from_utf8_lossy(&bytes[..at]);
        let says = "\n# echosplat_points 1\n# origin_m 1000000.0 0.0 0.0\n";
        assert!(text.contains(says), "{text}");
        let values = bytes[at..]
            .as_chunks()
            .0
            .iter()
            .map(|b| f32::from_le_bytes(*b));
        let values: Vec<f32> = values.collect();
        assert_eq!(values, [1.0, 2.0, 3.0, -10.0, 1.0, 0.25]);
    }

    #[test]
    fn a_map_near_the_worlds_origin_is_moved_there() {
        let mut near = map();
        near.origin_m = DVec3::new(0.0, -9_000.0, 20.0);
        let near = in_world(near);
        assert_eq!(near.origin_m, DVec3::ZERO);
        assert_eq!(near.gaussians[0].mean_m, Vec3::new(1.0, -8_998.0, 23.0));
        assert_eq!(in_world(map()), map());
        let mut outermost = map();
        outermost.origin_m = DVec3::new(100.0, 0.0, 0.0);
        outermost.gaussians[0].mean_m.x = MAX_PLACE_M;
        assert_eq!(in_world(outermost.clone()), outermost);
    }
}
