//! The vehicle's way as the map has it: poses as they came, and corrected as the map's were when it ends.

use std::ffi::OsStr;
use std::io::{self, Write};
use std::path::Path;

use echosplat_mapper::{CorrectedPose, PoseCorrections, PoseSigma};
use echosplat_model::{Pose, StampedPose, Timestamp};
use echosplat_recording::tum;

use crate::files;

/// First line of a table; the rest is in its order. Metres, degrees; the frame of the poses.
const COLUMNS: &str = "time_s,x_m,y_m,z_m,qx,qy,qz,qw,added_x_m,added_y_m,added_z_m,added_turn_deg,\
                       sigma_x_m,sigma_y_m,sigma_z_m,sigma_turn_deg";

/// What a file of the way may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Poses alone, as other programs read them.
    Tum,
    /// Also what was added to each, and one sigma of what it is now.
    Csv,
}

impl Kind {
    /// By the ending of its name; `None` if that is none of them.
    pub(crate) fn of(path: &Path) -> Option<Self> {
        match path.extension().and_then(OsStr::to_str)? {
            "tum" => Some(Self::Tum),
            "csv" => Some(Self::Csv),
            _ => None,
        }
    }
}

/// Poses of the pings that are in the map, as they came: some 70 bytes for each.
#[derive(Debug)]
pub(super) struct PosesAsTheyCame {
    vehicle_from_sensor: Pose,
    /// World from sensor.
    poses: Vec<(Timestamp, Pose)>,
}

impl PosesAsTheyCame {
    pub(super) fn new(vehicle_from_sensor: Pose) -> Self {
        Self {
            vehicle_from_sensor,
            poses: Vec::new(),
        }
    }

    pub(super) fn push(&mut self, time: Timestamp, world_from_sensor: Pose) {
        self.poses.push((time, world_from_sensor));
    }

    /// Poses to come have nothing to do with those so far.
    pub(super) fn begin_anew(&mut self) {
        self.poses.clear();
    }

    /// The vehicle's, as the map has them.
    pub(super) fn corrected(self, corrections: &PoseCorrections) -> Track {
        let sensor_from_vehicle = self.vehicle_from_sensor.inverse();
        let vehicle = |(time, came): (Timestamp, Pose)| {
            let CorrectedPose { pose, sigma } = corrections.corrected(time, came);
            let [came, now] = [came, pose].map(|pose| pose * sensor_from_vehicle);
            Point {
                time,
                came,
                now,
                sigma,
            }
        };
        Track(self.poses.into_iter().map(vehicle).collect())
    }
}

#[derive(Debug, Clone, Copy)]
struct Point {
    time: Timestamp,
    /// World from vehicle.
    came: Pose,
    now: Pose,
    /// Of the sensor's place.
    sigma: Option<PoseSigma>,
}

/// The vehicle's way, a pose for each ping of the map.
#[derive(Debug)]
pub(crate) struct Track(Vec<Point>);

impl Track {
    /// Whether no ping was mapped.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Writes it whole; an earlier file gives way.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn write(&self, path: &Path) -> anyhow::Result<()> {
        files::write_with("--track", path, |file| match Kind::of(path) {
            Some(Kind::Csv) => self.write_csv(file),
            _ => tum::write(&self.stamped(), file),
        })
    }

    fn stamped(&self) -> Vec<StampedPose> {
        let stamped = |point: &Point| StampedPose {
            time: point.time,
            world_from_vehicle: point.now,
            uncertainty: None,
            epoch: 0,
        };
        self.0.iter().map(stamped).collect()
    }

    fn write_csv(&self, mut file: impl Write) -> io::Result<()> {
        writeln!(file, "{COLUMNS}")?;
        for point in &self.0 {
            let (at, q) = (point.now.translation_m, point.now.rotation);
            let added_m = at - point.came.translation_m;
            let turn = point.now.rotation * point.came.rotation.inverse();
            let turn_rad = 2.0 * (turn.z * turn.w.signum()).atan2(turn.w.abs());
            write!(
                file,
                "{:.9},{:.4},{:.4},{:.4},{:.8},{:.8},{:.8},{:.8},{:.4},{:.4},{:.4},{:.4},",
                point.time.as_secs_f64(),
                at.x,
                at.y,
                at.z,
                q.x,
                q.y,
                q.z,
                q.w,
                added_m.x,
                added_m.y,
                added_m.z,
                turn_rad.to_degrees()
            )?;
            match point.sigma {
                Some(PoseSigma {
                    place_m: [x, y, z],
                    turn_rad,
                }) => writeln!(file, "{x:.4},{y:.4},{z:.4},{:.4}", turn_rad.to_degrees())?,
                None => writeln!(file, ",,,")?,
            }
        }
        file.flush()
    }
}

#[cfg(test)]
mod tests {
    use echosplat_model::glam::{DQuat, DVec3};

    use super::*;

    #[test]
    fn the_vehicles_own_poses_are_written_with_what_was_added_and_its_sigma() {
        let mount = Pose {
            translation_m: DVec3::new(0.5, 0.0, 0.0),
            rotation: DQuat::IDENTITY,
        };
        let vehicle = Pose {
            translation_m: DVec3::new(1.0, 2.0, 3.0),
            rotation: DQuat::IDENTITY,
        };
        // The sensor was turned to the left by a quarter, and moved nowhere.
        let turn = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        let now = Pose {
            translation_m: (vehicle * mount).translation_m,
            rotation: turn,
        };
        let sigma = PoseSigma {
            place_m: [0.1, 0.2, 0.3],
            turn_rad: 0.01,
        };
        let point = |sigma: Option<PoseSigma>| Point {
            time: Timestamp::from_millis(1_500),
            came: vehicle,
            now: sigma.map_or(vehicle, |_| now * mount.inverse()),
            sigma,
        };
        let mut csv = Vec::new();
        let track = Track(vec![point(None), point(Some(sigma))]);
        track.write_csv(&mut csv).unwrap();
        let csv = String::from_utf8(csv).unwrap();
        let rows: Vec<Vec<&str>> = csv.lines().map(|row| row.split(',').collect()).collect();
        let of = |row: usize, name: &str| {
            let column = rows[0].iter().position(|column| *column == name);
            rows[row][column.unwrap()]
        };
        assert!(rows.iter().all(|row| row.len() == rows[0].len()));
        assert_eq!(of(1, "time_s"), "1.500000000");
        assert_eq!((of(1, "added_x_m"), of(1, "sigma_x_m")), ("0.0000", ""));
        // The vehicle goes round its sensor.
        assert_eq!((of(2, "x_m"), of(2, "y_m")), ("1.5000", "1.5000"));
        assert_eq!(
            (of(2, "added_x_m"), of(2, "added_y_m")),
            ("0.5000", "-0.5000")
        );
        assert_eq!(of(2, "added_turn_deg"), "90.0000");
        assert_eq!(
            (of(2, "sigma_y_m"), of(2, "sigma_turn_deg")),
            ("0.2000", "0.5730")
        );
    }

    #[test]
    fn poses_go_through_the_mount_and_back() {
        let mount = Pose {
            translation_m: DVec3::new(0.5, -0.2, 0.1),
            rotation: DQuat::from_rotation_y(0.3),
        };
        let vehicle = Pose {
            translation_m: DVec3::new(1.0, 2.0, 3.0),
            rotation: DQuat::from_rotation_z(1.0),
        };
        let mapper =
            echosplat_mapper::Mapper::new(echosplat_mapper::MapperConfig::default()).unwrap();
        let mut came = PosesAsTheyCame::new(mount);
        came.push(Timestamp::from_millis(1), vehicle);
        came.begin_anew();
        came.push(Timestamp::from_millis(2), vehicle * mount);
        let track = came.corrected(&mapper.pose_corrections());
        assert!(!track.is_empty());
        let none = PosesAsTheyCame::new(mount).corrected(&mapper.pose_corrections());
        assert!(none.is_empty());
        let poses = track.stamped();
        assert_eq!(poses.len(), 1);
        let off = poses[0].world_from_vehicle.translation_m - vehicle.translation_m;
        assert!(off.length() < 1e-12, "{off}");
        assert!(
            poses[0]
                .world_from_vehicle
                .rotation
                .angle_between(vehicle.rotation)
                < 1e-7
        );
    }
}
