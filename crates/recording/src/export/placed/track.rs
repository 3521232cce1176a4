//! Trajectories with latitude, and as TUM.

use std::io::{self, Write};

use echosplat_georeference::CrsError;
use echosplat_model::StampedPose;
use echosplat_model::glam::DVec3;

use super::Placed;

/// Writes a line for each pose: time (seconds), latitude, longitude (degrees, to a tenth of a millimetre), height over
/// the georeference's datum (metres), heading of the vehicle (degrees from true north), east and north in the CRS, then
/// the pose as it is in the world.
///
/// # Errors
/// Of the writer, or if the projection does not show a pose.
pub fn write_track_csv(
    poses: &[StampedPose],
    placed: &Placed,
    mut writer: impl Write,
) -> io::Result<()> {
    let (code, datum) = (placed.crs.code(), placed.georeference.datum);
    writeln!(
        writer,
        "time_s,latitude_deg,longitude_deg,height_{datum}_m,heading_deg,east_epsg{code},north_epsg{code},x_m,y_m,z_m,qx,qy,qz,qw"
    )?;
    let turn = placed.georeference.enu_from_world();
    for stamped in poses {
        let pose = &stamped.world_from_vehicle;
        let world_m = pose.translation_m;
        let place = placed.georeference.place_of(world_m);
        let wrong = |error: CrsError| io::Error::other(error);
        let at = placed.at(world_m).map_err(wrong)?;
        let forward = turn * (pose.rotation * DVec3::X);
        let heading_deg = forward.x.atan2(forward.y).to_degrees().rem_euclid(360.0);
        let q = pose.rotation;
        writeln!(
            writer,
            "{},{:.9},{:.9},{:.4},{heading_deg:.3},{:.9},{:.9},{:?},{:?},{:?},{:?},{:?},{:?},{:?}",
            stamped.time.as_secs_f64(),
            place.latitude_deg,
            place.longitude_deg,
            place.height_m,
            at.x,
            at.y,
            world_m.x,
            world_m.y,
            world_m.z,
            q.x,
            q.y,
            q.z,
            q.w
        )?;
    }
    writer.flush()
}

/// Writes TUM, for which no place on Earth is needed.
///
/// # Errors
/// Of the writer.
pub fn write_track_tum(poses: &[StampedPose], writer: impl Write) -> io::Result<()> {
    crate::tum::write(poses, writer)
}
