//! Where an observation hears a landmark, and how that moves with what is estimated.

use echosplat_model::glam::{Mat3, Vec3};

use super::landmarks::Observation;
use super::parameters::{COMPASS, LEVER, PARAMETERS, RANGE, TIME, TURN, Values};

/// Freedoms of a landmark; layout.
/// A landmark's place on the map's axes, and how much nearer than it its surface is, metres.
pub(super) const FREE: usize = 4;
pub(super) type Free = [f64; FREE];
/// Parameters, then what a landmark is free in; layout.
pub(super) const ALL: usize = PARAMETERS + FREE;

/// Range and azimuth at which a landmark is to be heard, with their derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub(super) range_m: f32,
    pub(super) azimuth_rad: f32,
    pub(super) by_range: [f64; ALL],
    pub(super) by_azimuth: [f64; ALL],
}

impl Point {
    /// With `s` the landmark in the sensor's frame, `s ← s − (ω t + m + u δ) × s − v t − l`, `t` the time offset and what
    /// the echo takes, `m` the mount's turn and `l` its place, `δ` the compass's deviation about `u`, which is up; ranges are
    /// told `1/(1 + k)` as long as they are.
    pub(super) fn of(observation: &Observation, values: &Values, free: &Free) -> Self {
        let v = values.map(|value| value as f32);
        let [x, y, z, nearer_m] = free.map(|value| value as f32);
        let late_s = v[TIME] + observation.after_s;
        let up = observation.turn.z_axis;
        let [sine, cosine] = heading(&observation.turn);
        let turned = observation.angular_radps * late_s
            + Vec3::new(v[TURN], v[TURN + 1], v[TURN + 2])
            + up * (v[COMPASS] * sine + v[COMPASS + 1] * cosine);
        let lever_m = Vec3::new(0.0, v[LEVER], v[LEVER + 1]);
        let at_m = observation.place_m + observation.turn * Vec3::new(x, y, z);
        let s = at_m - turned.cross(at_m) - observation.linear_mps * late_s - lever_m;
        let range_m = s.length();
        let scale = 1.0 / (1.0 + v[RANGE]);
        let surface_m = range_m - nearer_m;
        let along = s / range_m * scale;
        let across = Vec3::new(-s.y, s.x, 0.0) / (s.x * s.x + s.y * s.y);
        let mut point = Self {
            range_m: surface_m * scale,
            azimuth_rad: s.y.atan2(s.x),
            by_range: [0.0; ALL],
            by_azimuth: [0.0; ALL],
        };
        let mut moves = |index: usize, by: Vec3| {
            point.by_range[index] = f64::from(along.dot(by));
            point.by_azimuth[index] = f64::from(across.dot(by));
        };
        moves(
            TIME,
            -(observation.angular_radps.cross(s) + observation.linear_mps),
        );
        for (axis, along_axis) in [Vec3::X, Vec3::Y, Vec3::Z].into_iter().enumerate() {
            moves(TURN + axis, -along_axis.cross(s));
            moves(PARAMETERS + axis, observation.turn * along_axis);
        }
        moves(COMPASS, -(up * sine).cross(s));
        moves(COMPASS + 1, -(up * cosine).cross(s));
        moves(LEVER, -Vec3::Y);
        moves(LEVER + 1, -Vec3::Z);
        point.by_range[RANGE] = -f64::from(surface_m * scale * scale);
        point.by_range[ALL - 1] = -f64::from(scale);
        point
    }
}

/// Sine and cosine of the heading on the map's axes by `turn`, sensor from map; both 0 if it looks straight up or down.
pub(super) fn heading(turn: &Mat3) -> [f32; 2] {
    let ahead = turn.row(0);
    let level = ahead.x.hypot(ahead.y).max(f32::MIN_POSITIVE);
    [ahead.y / level, ahead.x / level]
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::{EulerRot, Quat};

    #[test]
    fn derivatives_are_those_of_range_and_azimuth() {
        let observation = Observation {
            place_m: Vec3::new(5.0, 0.2, -1.5),
            turn: Mat3::from_quat(Quat::from_euler(EulerRot::ZYX, 0.4, -0.2, 0.3)),
            linear_mps: Vec3::new(0.3, -0.2, 0.1),
            angular_radps: Vec3::new(0.1, -0.05, 0.3),
            after_s: 0.0,
            first_m: 0.0,
            step_m: 0.02,
            heard: Vec::new(),
            weight: 1.0,
            block: 0,
        };
        let at = |index: usize, by: f64| {
            let (mut values, mut free) = ([0.0; PARAMETERS], [0.0; FREE]);
            match index.checked_sub(PARAMETERS) {
                Some(of_landmark) => free[of_landmark] = by,
                None => values[index] = by,
            }
            Point::of(&observation, &values, &free)
        };
        const STEP: f64 = 5e-3;
        for index in 0..ALL {
            let (less, more) = (at(index, -STEP), at(index, STEP));
            let slope = |less: f32, more: f32| f64::from(more - less) / (2.0 * STEP);
            let here = at(index, 0.0);
            let of_range = slope(less.range_m, more.range_m);
            let of_azimuth = slope(less.azimuth_rad, more.azimuth_rad);
            assert!((here.by_range[index] - of_range).abs() < 2e-3, "{index}");
            assert!(
                (here.by_azimuth[index] - of_azimuth).abs() < 2e-3,
                "{index}"
            );
        }
    }
}
