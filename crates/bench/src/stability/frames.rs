//! Where the map's origin is and which way the sensor looks must not matter.

use echosplat_acoustics::Parameters;
use echosplat_model::Pose;
use glam::{DVec3, Mat3, Vec3};

use super::Row;
use super::dive::{chamfer_m, of_target};
use super::naive;
use super::row::{Comparison, Label};
use super::scene::{Scene, plain, usual};
use super::whole::differing_bits;
use crate::draw::Draw;

const FAR: Label = Label {
    case: "far origins",
    quantity: "intensity of the worst bin, errors relative to the profile's peak",
    why: "The map's origin is an f64 point fixed at the first pose; poses are subtracted from it in \
          f64, and all that follows is f32 on local coordinates.",
};

const FAR_MAP: Label = Label {
    case: "far origins",
    quantity: "Chamfer distance of the map from the one made at the origin, m",
    why: "The same, through session and mapper: the map of a dive made far away is the one made at \
          the origin, moved.",
};

const SAME_BITS: Label = Label {
    case: "far origins",
    quantity: "numbers of the map that differ in any bit, places beyond their rounding",
    why: "A shift that is exact in f64 leaves every local coordinate as it was; only published \
          places of the near map are rounded in the poses' own frame.",
};

const WRAP: Label = Label {
    case: "azimuth across ±180°",
    quantity: "intensity of the worst bin, errors relative to the profile's peak",
    why: "Azimuth is measured from the beam's own axis, so that no bearing is ever subtracted from \
          another.",
};

const TURNS: Label = Label {
    case: "azimuth across ±180°",
    quantity: "bins that differ in any bit",
    why: "A heading is a rotation, not a number that grows: whole turns leave no trace.",
};

pub(super) fn far(seed: u64, quick: bool) -> Vec<Row> {
    let mut rows: Vec<Row> = [1e5, 1e6, 1e7]
        .map(|distance_m| far_row(seed, distance_m))
        .into();
    let dive = of_target(seed, if quick { 240 } else { 480 }, 600);
    let map = |shift_m| dive.map(shift_m).map(|(map, _)| map);
    let here = map(DVec3::ZERO);
    for distance_m in [1e5, 1e6, 1e7] {
        // Not representable: a tenth is none in binary.
        let shift = DVec3::new(distance_m + 0.1, -0.7 * distance_m + 0.3, -0.1);
        let off_m = match (&here, &map(shift)) {
            (Some(here), Some(there)) => chamfer_m(here, there, shift),
            _ => f64::NAN,
        };
        let comparison = Comparison::of(0.0, off_m, 1.0);
        rows.push(comparison.row(FAR_MAP, format!("{distance_m:e} m"), 0.005));
    }
    for power in [17, 20, 23] {
        let shift = DVec3::new(2_f64.powi(power), -2_f64.powi(power), 1024.0);
        let there = map(shift);
        let differing = differing_bits(here.as_ref(), there.as_ref(), shift);
        let comparison = Comparison::of(0.0, differing, 1.0);
        rows.push(comparison.row(SAME_BITS, format!("2^{power} m"), 0.0));
    }
    rows
}

/// A Gaussian and a sensor in the world, by local coordinates and by f32 world coordinates.
fn far_row(seed: u64, distance_m: f64) -> Row {
    let mut draw = Draw::new(seed, 200);
    let away = DVec3::new(distance_m + 0.1, 0.3 - 0.7 * distance_m, -0.1);
    let mut worst: Option<Comparison> = None;
    for _ in 0..50 {
        let (first, now) = (
            away + 0.5 * draw.cube().as_dvec3(),
            away + 0.5 * draw.cube().as_dvec3(),
        );
        let near = usual(&mut draw);
        let in_world = now + near.mean_m.as_dvec3();
        // Truth: the sensor at 0.
        let truth = Scene::new(false).with(near).twin::<f64>();
        let mut scene = Scene::new(false).with(Parameters {
            mean_m: (in_world - first).as_vec3(),
            ..near
        });
        scene.geometry.pose.position_m = (now - first).as_vec3();
        let mut absolute = scene.geometry;
        absolute.pose.position_m = now.as_vec3();
        let gaussian = Parameters {
            mean_m: in_world.as_vec3(),
            ..near
        };
        let comparison = Comparison::of_many(&truth, &scene.program())
            .with_naive_many(&truth, &naive::profile(&absolute, &gaussian));
        worst = Some(worst.map_or(comparison, |worst| worst.worse(comparison)));
    }
    let worst = worst.unwrap_or(Comparison::of(f64::NAN, f64::NAN, 1.0));
    worst.row(FAR, format!("{distance_m:e} m, worst of 50"), 1e-4)
}

fn turned(yaw_rad: f64) -> Mat3 {
    let pose = Pose::from_yaw_pitch_roll(yaw_rad, 0.0, 0.0, DVec3::ZERO);
    Mat3::from_quat(pose.rotation.as_quat())
}

pub(super) fn wrap(_seed: u64, _quick: bool) -> Vec<Row> {
    let mut rows = Vec::new();
    for yaw_deg in [0.0, 90.0, 179.9, 180.0, -180.0, -179.9_f64] {
        // On either side of the beam's axis, so that one lies across the seam.
        let each = [-0.3, 0.3].map(|off_deg: f64| {
            let off = off_deg.to_radians();
            let mut scene = Scene::new(false);
            scene.geometry.pose.axes = turned(yaw_deg.to_radians());
            let ahead = Vec3::new(5.0 * off.cos() as f32, 5.0 * off.sin() as f32, 0.2);
            let gaussian = plain(scene.geometry.pose.axes * ahead);
            let scene = scene.with(gaussian);
            let truth = scene.twin::<f64>();
            let naive = naive::profile_by_bearings(&scene.geometry, &gaussian);
            Comparison::of_many(&truth, &scene.program()).with_naive_many(&truth, &naive)
        });
        let worst = each[0].worse(each[1]);
        rows.push(worst.row(WRAP, format!("heading {yaw_deg}°"), 1e-4));
    }
    for turns in [1, -1, 1000] {
        let differing = [0.3, 2.0, 3.1].map(|yaw: f64| {
            let profile = |turns: f64| {
                let mut scene = Scene::new(false);
                scene.geometry.pose.axes = turned(yaw + std::f64::consts::TAU * turns);
                scene
                    .with(plain(turned(yaw) * Vec3::new(5.0, 0.02, 0.2)))
                    .program()
            };
            let (once, again) = (profile(0.0), profile(f64::from(turns)));
            let pairs = once.iter().zip(&again);
            pairs.filter(|(a, b)| a.to_bits() != b.to_bits()).count()
        });
        let differing = differing.iter().sum::<usize>() as f64;
        let comparison = Comparison::of(0.0, differing, 1.0);
        rows.push(comparison.row(TURNS, format!("{turns} turns"), 0.0));
    }
    rows
}
