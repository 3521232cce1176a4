//! `echosplat export MAP.ply OUT`: the map for other programs, in the world's coordinates.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use echosplat_model::Standing;
use echosplat_recording::export::{SINGLE_PRECISION_M, in_world};
use echosplat_recording::export::{write_npz, write_pcd, write_splat};
use echosplat_recording::ply::{self, MapFile};
use echosplat_recording::replace::replace_file;

use crate::arguments::ExportArguments;
use crate::exit::{Finish, Usage};
use crate::{files, logging, maps};

/// # Errors
/// If the map cannot be read, or nothing be written there.
pub(crate) fn run(arguments: &ExportArguments) -> anyhow::Result<Finish> {
    let format = Format::of(&arguments.out)?;
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
    if format.is_single_precision() {
        map = in_world(map);
        tell_of_origin(&map, &arguments.out);
    }
    replace_file(&arguments.out, |out| format.write(&map, out))
        .map_err(|error| files::cannot_write(&arguments.out, &error))?;
    logging::print(&format!(
        "{}: {} Gaussians",
        arguments.out.display(),
        map.gaussians.len()
    ));
    Ok(Finish::Done)
}

fn is_same(map: &Path, out: &Path) -> bool {
    let out = out.canonicalize();
    out.is_ok_and(|out| map.canonicalize().is_ok_and(|map| map == out))
}

/// A map too far away for single precision stays relative to its origin, which then has to be known.
fn tell_of_origin(map: &MapFile, out: &Path) {
    let [x, y, z] = map.origin_m.to_array();
    if map.origin_m.length() > 0.0 {
        tracing::warn!(
            "{}: its coordinates count from {x:?} {y:?} {z:?} m, since single precision keeps no \
             millimetre beyond {SINGLE_PRECISION_M:.0} m from the world's origin; .pcd and .npz do",
            out.display()
        );
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Splat,
    Pcd,
    Npz,
    Ply,
}

impl Format {
    fn of(out: &Path) -> anyhow::Result<Self> {
        match out.extension().and_then(|extension| extension.to_str()) {
            Some("splat") => Ok(Self::Splat),
            Some("pcd") => Ok(Self::Pcd),
            Some("npz") => Ok(Self::Npz),
            Some("ply") => Ok(Self::Ply),
            _ => Err(Usage::error(format!(
                "export to {}: it must end in .splat, .pcd, .npz or .ply",
                out.display()
            ))),
        }
    }

    fn is_single_precision(self) -> bool {
        matches!(self, Self::Splat | Self::Ply)
    }

    fn write(self, map: &MapFile, out: &mut BufWriter<&mut File>) -> io::Result<()> {
        match self {
            Self::Splat => write_splat(map, out),
            Self::Pcd => write_pcd(map, out),
            Self::Npz => write_npz(map, out),
            Self::Ply => ply::write(map, out),
        }
    }
}
