//! glTF 2.0 in one binary file: a mesh, or Gaussians that fall back to points.

use std::io::{self, Write};

use echosplat_georeference::Georeference;
use echosplat_model::Gaussian;
use echosplat_model::glam::{DVec3, Vec3};
use echosplat_surface::Surface;
use serde_json::{Value, json};

use super::{SINGLE_PRECISION_M, Up, WrittenMesh, in_world, sound};
use crate::ply::HARMONIC_0;
use crate::ply::MapFile;
use crate::ramp::color_of_reflectivity;

/// Kinds of numbers, as glTF numbers them.
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;
/// What a buffer is for, as glTF numbers it.
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;
/// Kinds of primitives, as glTF numbers them.
const POINTS: u32 = 0;
const TRIANGLES: u32 = 4;

const SPLATTING: &str = "KHR_gaussian_splatting";

/// Metres; stands for an infinite sigma, for which glTF has no number.
const UNKNOWN_SIGMA_M: f32 = 1e6;

/// What is written, as it grows.
#[derive(Default)]
struct Glb {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

/// Writes the Gaussians as glTF: points with a colour for every viewer, and as `KHR_gaussian_splatting` places, turns,
/// scales (metres), opacities and colour; `_SIGMA` (metres, a million where unknown) and `_PROBABILITY` beside them. y is
/// up, as glTF has it. Beyond 10 km from the world's origin places count from the node's translation.
///
/// # Errors
/// Of the writer.
pub fn write_gaussians_glb(map: &MapFile, writer: impl Write) -> io::Result<()> {
    let place = map.notes.georeference.clone();
    let map = in_world(Up::Y.turned(map.clone()));
    let all: Vec<&Gaussian> = sound(&map).collect();
    let mut glb = Glb::default();
    let places: Vec<Vec3> = all.iter().map(|g| g.mean_m).collect();
    let color = |g: &&Gaussian| color_of_reflectivity(g.reflectivity);
    let share = |share: f32| ((65_535.0 * share).round() as u16).to_le_bytes();
    let shown = all.iter().flat_map(|g| {
        let [red, green, blue] = color(g).map(linear);
        [red, green, blue, g.opacity].map(share)
    });
    let shown: Vec<u8> = shown.flatten().collect();
    let own = |name: &str| format!("{SPLATTING}:{name}");
    let mut attributes = json!({ "POSITION": glb.places(&places) });
    let count = all.len();
    attributes["COLOR_0"] = glb.column(&shown, U16, "VEC4", count, true);
    let floats = |of: &dyn Fn(&Gaussian) -> Vec<f32>| -> Vec<f32> {
        all.iter().flat_map(|gaussian| of(gaussian)).collect()
    };
    for (name, kind, values) in [
        (
            own("ROTATION"),
            "VEC4",
            floats(&|g| g.rotation.normalize().to_array().to_vec()),
        ),
        (
            own("SCALE"),
            "VEC3",
            floats(&|g| g.scale_m.to_array().to_vec()),
        ),
        (own("OPACITY"), "SCALAR", floats(&|g| vec![g.opacity])),
        (
            own("SH_DEGREE_0_COEF_0"),
            "VEC3",
            floats(&|g| color(&g).map(|c| (c - 0.5) / HARMONIC_0).to_vec()),
        ),
        (
            "_SIGMA".to_owned(),
            "SCALAR",
            floats(&|g| vec![g.sigma_m.min(UNKNOWN_SIGMA_M)]),
        ),
        (
            "_PROBABILITY".to_owned(),
            "SCALAR",
            floats(&|g| vec![g.probability]),
        ),
    ] {
        attributes[name] = glb.floats(&values, kind, count);
    }
    let primitive = json!({
        "mode": POINTS,
        "attributes": attributes,
        "extensions": { SPLATTING: { "kernel": "ellipse", "colorSpace": "srgb_rec709_display" } },
    });
    glb.write(
        (count > 0).then_some(primitive),
        &[SPLATTING],
        map.origin_m,
        place.as_ref(),
        writer,
    )
}

/// Writes the surface as glTF: places, normals and `_SIGMA` of its vertices, and triangles seen from both sides. y is up.
///
/// # Errors
/// Of the writer.
pub fn write_mesh_glb(
    surface: &Surface,
    origin_m: DVec3,
    place: Option<&Georeference>,
    writer: impl Write,
) -> io::Result<WrittenMesh> {
    let (surface, origin_m) = Up::Y.turned_surface(surface.clone(), origin_m);
    let is_near = origin_m.length() <= SINGLE_PRECISION_M;
    let (added_m, left_m) = match is_near {
        true => (origin_m, DVec3::ZERO),
        false => (DVec3::ZERO, origin_m),
    };
    let mut glb = Glb::default();
    let vertices = &surface.vertices;
    let places = vertices
        .iter()
        .map(|v| super::world_of(added_m, v.position_m).as_vec3());
    let places: Vec<Vec3> = places.collect();
    let normals = vertices
        .iter()
        .flat_map(|v| v.normal.normalize_or(Vec3::Y).to_array());
    let normals: Vec<f32> = normals.collect();
    let sigmas: Vec<f32> = vertices
        .iter()
        .map(|v| v.sigma_m.min(UNKNOWN_SIGMA_M))
        .collect();
    let count = vertices.len();
    let attributes = json!({
        "POSITION": glb.places(&places),
        "NORMAL": glb.floats(&normals, "VEC3", count),
        "_SIGMA": glb.floats(&sigmas, "SCALAR", count),
    });
    let corners: Vec<u8> = surface
        .triangles
        .iter()
        .flatten()
        .flat_map(|i| i.to_le_bytes())
        .collect();
    let indices = glb.indices(&corners, 3 * surface.triangles.len());
    let primitive = json!({
        "mode": TRIANGLES, "attributes": attributes, "indices": indices, "material": 0,
    });
    let is_there = !surface.triangles.is_empty();
    glb.write(is_there.then_some(primitive), &[], left_m, place, writer)?;
    Ok(WrittenMesh::of(&surface))
}

/// A channel of a colour as screens take it, 0 to 1, as light: glTF's own colours are linear (IEC 61966-2-1).
fn linear(channel: f32) -> f32 {
    match channel <= 0.040_45 {
        true => channel / 12.92,
        false => ((channel + 0.055) / 1.055).powf(2.4),
    }
}

impl Glb {
    fn places(&mut self, places: &[Vec3]) -> Value {
        let first = places.first().copied().unwrap_or_default();
        let least = places.iter().fold(first, |least, p| least.min(*p));
        let most = places.iter().fold(first, |most, p| most.max(*p));
        let values: Vec<f32> = places.iter().flat_map(Vec3::to_array).collect();
        let index = self.floats(&values, "VEC3", places.len());
        if let Some(accessor) = self.accessors.last_mut() {
            accessor["min"] = json!(least.to_array());
            accessor["max"] = json!(most.to_array());
        }
        index
    }

    fn floats(&mut self, values: &[f32], kind: &str, count: usize) -> Value {
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        self.column(&bytes, F32, kind, count, false)
    }

    fn column(
        &mut self,
        bytes: &[u8],
        component: u32,
        kind: &str,
        count: usize,
        is_share: bool,
    ) -> Value {
        let mut accessor = json!({
            "bufferView": self.view(bytes, VERTICES), "componentType": component, "type": kind, "count": count,
        });
        if is_share {
            accessor["normalized"] = json!(true);
        }
        self.accessors.push(accessor);
        json!(self.accessors.len() - 1)
    }

    fn indices(&mut self, bytes: &[u8], count: usize) -> Value {
        let view = self.view(bytes, INDICES);
        self.accessors.push(json!({
            "bufferView": view, "componentType": U32, "type": "SCALAR", "count": count,
        }));
        json!(self.accessors.len() - 1)
    }

    fn view(&mut self, bytes: &[u8], target: u32) -> usize {
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len(), "target": target,
        }));
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    /// Without a primitive, a scene in which nothing is: glTF allows no empty lists.
    fn write(
        self,
        primitive: Option<Value>,
        extensions: &[&str],
        origin_m: DVec3,
        place: Option<&Georeference>,
        mut writer: impl Write,
    ) -> io::Result<()> {
        let mut asset = json!({
            "version": "2.0", "generator": concat!("echosplat ", env!("CARGO_PKG_VERSION")),
        });
        if let Some(place) = place {
            asset["extras"] = json!({ "georeference": place.line() });
        }
        let mut document = json!({ "asset": asset, "scene": 0, "scenes": [{}] });
        let bytes = primitive.as_ref().map_or(&[][..], |_| &self.bytes);
        if let Some(primitive) = primitive {
            let mut node = json!({ "mesh": 0, "name": "map" });
            if origin_m != DVec3::ZERO {
                node["translation"] = json!(origin_m.to_array());
            }
            if primitive.get("material").is_some() {
                document["materials"] = json!([{ "doubleSided": true }]);
            }
            document["scenes"] = json!([{ "nodes": [0] }]);
            document["nodes"] = json!([node]);
            document["meshes"] = json!([{ "primitives": [primitive] }]);
            document["accessors"] = json!(self.accessors);
            document["bufferViews"] = json!(self.views);
            document["buffers"] = json!([{ "byteLength": bytes.len() }]);
            if !extensions.is_empty() {
                document["extensionsUsed"] = json!(extensions);
            }
        }
        let mut text = serde_json::to_vec(&document)?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let chunks: &[(&[u8], &[u8])] = match bytes.is_empty() {
            true => &[(&text, b"JSON")],
            false => &[(&text, b"JSON"), (bytes, b"BIN\0")],
        };
        let total: usize = 12
            + chunks
                .iter()
                .map(|(chunk, _)| 8 + chunk.len())
                .sum::<usize>();
        let length = |length: usize| u32::try_from(length).map_err(io::Error::other);
        writer.write_all(b"glTF")?;
        writer.write_all(&2_u32.to_le_bytes())?;
        writer.write_all(&length(total)?.to_le_bytes())?;
        for (chunk, kind) in chunks {
            writer.write_all(&length(chunk.len())?.to_le_bytes())?;
            writer.write_all(kind)?;
            writer.write_all(chunk)?;
        }
        writer.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_a_screen_is_a_fifth_of_its_light() {
        // sRGB's byte 188 is half the light (IEC 61966-2-1).
        assert!((linear(188.0 / 255.0) - 0.5).abs() < 0.01);
        assert!((linear(0.5) - 0.214).abs() < 0.001);
        assert_eq!((linear(0.0), linear(1.0)), (0.0, 1.0));
        assert!((linear(0.040_45) - linear(0.040_46)).abs() < 1e-5);
    }
}
