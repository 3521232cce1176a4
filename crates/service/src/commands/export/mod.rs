//! `echosplat export MAP.ply OUT`: the map, or its surface, for other programs, in the world's
//! coordinates or in those of the Earth.

pub(crate) mod placed;

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use echosplat_model::Standing;
use echosplat_model::glam::DVec3;
use echosplat_recording::export::{SINGLE_PRECISION_M, Up, in_world};
use echosplat_recording::export::{write_gaussians_glb, write_mesh_glb};
use echosplat_recording::export::{write_mesh_obj, write_mesh_ply};
use echosplat_recording::export::{write_npz, write_pcd, write_splat};
use echosplat_recording::ply::{self, MapFile};
use echosplat_recording::replace::replace_file;
use echosplat_surface::{CELL_M, SurfaceError, surface_of};

use crate::arguments::ExportArguments;
use crate::exit::{Finish, Usage};
use crate::{files, logging, maps};
use placed::PlacedFormat;

/// # Errors
/// If the map cannot be read, or nothing be written there.
pub(crate) fn run(arguments: &ExportArguments) -> anyhow::Result<Finish> {
    let output = Output::of(&arguments.out, arguments.mesh)?;
    if let Some(why) = output.has_no_use_for(arguments) {
        return refused(&arguments.out, why);
    }
    files::prepare("export to", &arguments.out)?;
    if is_same(&arguments.map, &arguments.out) {
        return Err(Usage::error(format!(
            "export to {}: that is the map itself; give another file",
            arguments.out.display()
        )));
    }
    let mut map = maps::read(&arguments.map)?;
    if !arguments.all {
        let is_confident = |standing| standing == Standing::Confident;
        map.gaussians.retain(|g| is_confident(g.standing));
    }
    let finish = maps::finish_of(&map);
    let written = match output {
        Output::Mesh(format) => write_mesh(&map, format, arguments)?,
        Output::Gaussians(format) => write_gaussians(map, format, arguments)?,
        Output::Placed(format) => placed::write(&map, format, arguments)?,
    };
    logging::print(&format!("{}: {written}", arguments.out.display()));
    Ok(finish)
}

/// What was written, in words.
fn write_gaussians(
    mut map: MapFile,
    format: Format,
    arguments: &ExportArguments,
) -> anyhow::Result<String> {
    let out = arguments.out.as_path();
    if format != Format::Glb {
        map = arguments.up.turned(map);
    }
    if format.is_single_precision() {
        map = in_world(map);
        tell_of_origin(map.origin_m, out);
    }
    replace_file(out, |file| format.write(&map, file))
        .map_err(|error| files::cannot_write(out, &error))?;
    Ok(format!("{} Gaussians", map.gaussians.len()))
}

/// What was written, in words.
fn write_mesh(
    map: &MapFile,
    format: MeshFormat,
    arguments: &ExportArguments,
) -> anyhow::Result<String> {
    let out = &arguments.out;
    let surface = surface_of(
        &map.gaussians,
        arguments.cell.map_or(CELL_M, |cell_m| cell_m as f32),
    )
    .map_err(|error| {
        let hint = match error {
            SurfaceError::Cell { .. } | SurfaceError::Large { .. } => " (--cell)",
            _ => "",
        };
        Usage::error(format!("map {}: {error}{hint}", arguments.map.display()))
    })?;
    if surface.triangles.is_empty() {
        tracing::warn!(
            "{}: no surface in {} confident Gaussians; it takes some dozens that are neighbours",
            out.display(),
            map.gaussians.len()
        );
    }
    if format == MeshFormat::Ply && map.origin_m.length() > SINGLE_PRECISION_M {
        tell_of_origin(map.origin_m, out);
    }
    let mut written = String::new();
    replace_file(out, |file| {
        let mesh = match format {
            MeshFormat::Ply => write_mesh_ply(&surface, map.origin_m, arguments.up, file)?,
            MeshFormat::Obj => write_mesh_obj(&surface, map.origin_m, arguments.up, file)?,
            MeshFormat::Glb => {
                let place = map.notes.georeference.as_ref();
                write_mesh_glb(&surface, map.origin_m, place, file)?
            }
        };
        let (triangles, vertices) = (mesh.triangle_count, mesh.vertex_count);
        written = format!("{triangles} triangles between {vertices} vertices");
        Ok(())
    })
    .map_err(|error| files::cannot_write(out, &error))?;
    Ok(written)
}

fn is_same(map: &Path, out: &Path) -> bool {
    let out = out.canonicalize();
    out.is_ok_and(|out| map.canonicalize().is_ok_and(|map| map == out))
}

/// A map too far away for single precision stays relative to its origin, which then has to be known.
fn tell_of_origin(origin_m: DVec3, out: &Path) {
    let [x, y, z] = origin_m.to_array();
    if origin_m.length() > 0.0 {
        tracing::warn!(
            "{}: its coordinates count from {x:?} {y:?} {z:?} m, since single precision keeps no \
             millimetre beyond {SINGLE_PRECISION_M:.0} m from the world's origin; .npz and, of a mesh, .obj do",
            out.display()
        );
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Output {
    Gaussians(Format),
    Mesh(MeshFormat),
    Placed(PlacedFormat),
}

impl Output {
    /// Of what was asked for and says nothing of it: what that is for.
    fn has_no_use_for(self, asked: &ExportArguments) -> Option<&'static str> {
        use PlacedFormat::{Csv, GeoJson, GeoTiff, Kml, Las, Laz, Tum};
        let is = |formats: &[PlacedFormat]| match self {
            Self::Placed(format) => formats.contains(&format),
            _ => false,
        };
        let is_placed = matches!(self, Self::Placed(_));
        let is_on_earth = is_placed && !is(&[Tum]);
        let has_cells = matches!(self, Self::Mesh(_)) || is(&[GeoTiff]);
        let place = &asked.place;
        let unused = [
            (
                asked.cell.is_some() && !has_cells,
                "--cell is for a mesh (--mesh) or a .tif",
            ),
            (
                asked.track.is_some() && !is(&[Csv, Tum, GeoJson, Kml]),
                "--track is for .csv, .tum, .geojson or .kml",
            ),
            (
                asked.crs.is_some() && !is(&[Las, Laz, GeoTiff, Csv]),
                "--crs is for .las, .laz, .tif or .csv",
            ),
            (
                (place.origin.is_some() || place.heading.is_some()) && !is_on_earth,
                "--origin and --heading are for .las, .laz, .tif, .csv, .geojson or .kml; `echosplat georeference` puts them into \
                 the map",
            ),
            (
                asked.separation.is_some() && !is_on_earth,
                "--separation is for .las, .laz, .tif, .csv, .geojson or .kml",
            ),
            (
                asked.up != Up::Z && is_placed,
                "--up is for .ply, .pcd, .npz, .splat and .obj: what lies on Earth has its own axes",
            ),
        ];
        unused
            .into_iter()
            .find_map(|(is_unused, why)| is_unused.then_some(why))
    }

    fn of(out: &Path, is_mesh: bool) -> anyhow::Result<Self> {
        let extension = out.extension().and_then(|extension| extension.to_str());
        let found = match (extension, is_mesh) {
            (Some("ply"), true) => Self::Mesh(MeshFormat::Ply),
            (Some("obj"), true) => Self::Mesh(MeshFormat::Obj),
            (Some("glb"), true) => Self::Mesh(MeshFormat::Glb),
            (Some("splat"), false) => Self::Gaussians(Format::Splat),
            (Some("pcd"), false) => Self::Gaussians(Format::Pcd),
            (Some("npz"), false) => Self::Gaussians(Format::Npz),
            (Some("ply"), false) => Self::Gaussians(Format::Ply),
            (Some("glb"), false) => Self::Gaussians(Format::Glb),
            (Some("las"), false) => Self::Placed(PlacedFormat::Las),
            (Some("laz"), false) => Self::Placed(PlacedFormat::Laz),
            (Some("tif" | "tiff"), false) => Self::Placed(PlacedFormat::GeoTiff),
            (Some("geojson"), false) => Self::Placed(PlacedFormat::GeoJson),
            (Some("kml"), false) => Self::Placed(PlacedFormat::Kml),
            (Some("csv"), false) => Self::Placed(PlacedFormat::Csv),
            (Some("tum"), false) => Self::Placed(PlacedFormat::Tum),
            (_, true) => return refused(out, "a mesh must end in .ply, .obj or .glb"),
            (Some("obj"), false) => return refused(out, ".obj holds triangles: --mesh makes them"),
            (_, false) => {
                let allowed = "it must end in .splat, .pcd, .npz, .ply, .glb, .las, .laz, .tif, .geojson, .kml, .csv or .tum, with \
                     --mesh in .ply, .obj or .glb";
                return refused(out, allowed);
            }
        };
        Ok(found)
    }
}

fn refused<T>(out: &Path, why: &str) -> anyhow::Result<T> {
    Err(Usage::error(format!("export to {}: {why}", out.display())))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum MeshFormat {
    Ply,
    Obj,
    Glb,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Splat,
    Pcd,
    Npz,
    Ply,
    Glb,
}

impl Format {
    fn is_single_precision(self) -> bool {
        matches!(self, Self::Splat | Self::Ply | Self::Pcd)
    }

    fn write(self, map: &MapFile, out: &mut BufWriter<&mut File>) -> io::Result<()> {
        match self {
            Self::Splat => write_splat(map, out),
            Self::Pcd => write_pcd(map, out),
            Self::Npz => write_npz(map, out),
            Self::Ply => ply::write(map, out),
            Self::Glb => write_gaussians_glb(map, out),
        }
    }
}
