//! Pings with their motion, and as they would be with another clock, mount or speed of sound.

use std::sync::Arc;

use echosplat_model::glam::{DMat3, DQuat, Mat3, Quat, Vec3};

use super::parameters::{COMPASS, LEVER, RANGE, TIME, TURN, Values};
use super::point::heading;
use crate::accumulate::fan::Fan;
use crate::accumulate::history::{FAN_SIGMAS, Keyframe};

/// Pings asked; bounds work.
/// Most pings that are asked, evenly over those remembered.
const MOST_PINGS: usize = 8192;
/// Seconds either way; found.
/// Motion is told by pings this much before and after, seconds.
const MOTION_S: f64 = 0.2;
/// Seconds off together; found.
/// Length of the blocks of time whose observations may be off together, seconds.
const BLOCK_S: f64 = 10.0;

/// A ping with its motion.
#[derive(Debug, Clone)]
pub(crate) struct Moving {
    pub(crate) keyframe: Arc<Keyframe>,
    pub(super) linear_mps: Vec3,
    pub(super) angular_radps: Vec3,
    /// Number of the block of time it is in.
    pub(crate) block: u32,
}

impl Moving {
    /// As it was if `values` are what is wrong.
    fn corrected(&self, values: &Values) -> Self {
        let v = values.map(|v| v as f32);
        let mut keyframe = Keyframe::clone(&self.keyframe);
        let geometry = &mut keyframe.geometry;
        let axes = geometry.pose.axes;
        let turn = axes.transpose();
        let [sine, cosine] = heading(&turn);
        let turned = self.angular_radps * v[TIME]
            + Vec3::new(v[TURN], v[TURN + 1], v[TURN + 2])
            + turn.z_axis * (v[COMPASS] * sine + v[COMPASS + 1] * cosine);
        let moved = self.linear_mps * v[TIME] + Vec3::new(0.0, v[LEVER], v[LEVER + 1]);
        geometry.pose.position_m += axes * moved;
        geometry.pose.axes = axes * Mat3::from_quat(Quat::from_scaled_axis(turned));
        geometry.range_start_m *= 1.0 + v[RANGE];
        geometry.bin_length_m *= 1.0 + v[RANGE];
        keyframe.fan = Fan::of(&keyframe.blurred_geometry(), FAN_SIGMAS);
        Self {
            keyframe: Arc::new(keyframe),
            ..self.clone()
        }
    }
}

/// The pings that others before and after tell the motion of.
pub(crate) fn moving(pings: &[Arc<Keyframe>]) -> Vec<Moving> {
    let Some(first) = pings.first() else {
        return Vec::new();
    };
    let stride = pings.len() / MOST_PINGS + 1;
    let since = |keyframe: &Keyframe, other: &Keyframe| keyframe.time.seconds_since(other.time);
    let (mut before, mut after) = (0, 0);
    // Counted one by one, since stamps may leap.
    let (mut block, mut block_time) = (0, first.time);
    let mut found = Vec::new();
    for (index, keyframe) in pings.iter().enumerate() {
        while before < index && since(keyframe, &pings[before]) > MOTION_S {
            before += 1;
        }
        after = after.max(index);
        while after + 1 < pings.len() && since(&pings[after + 1], keyframe) < MOTION_S {
            after += 1;
        }
        if !(0.0..BLOCK_S).contains(&keyframe.time.seconds_since(block_time)) {
            (block, block_time) = (block + 1, keyframe.time);
        }
        if index % stride == 0
            && let Some((linear_mps, angular_radps)) =
                motion(&pings[before], keyframe, &pings[after])
        {
            found.push(Moving {
                keyframe: Arc::clone(keyframe),
                linear_mps,
                angular_radps,
                block,
            });
        }
    }
    found
}

/// Velocity and rate of turn in the middle one's own frame.
fn motion(before: &Keyframe, keyframe: &Keyframe, after: &Keyframe) -> Option<(Vec3, Vec3)> {
    let seconds = after.time.seconds_since(before.time);
    if !(0.5 * MOTION_S..2.5 * MOTION_S).contains(&seconds) {
        return None;
    }
    let axes = |keyframe: &Keyframe| {
        let Mat3 {
            x_axis,
            y_axis,
            z_axis,
        } = keyframe.geometry.pose.axes;
        DMat3::from_cols(x_axis.as_dvec3(), y_axis.as_dvec3(), z_axis.as_dvec3())
    };
    let turn = DQuat::from_mat3(&(axes(before).transpose() * axes(after)));
    let moved_m = after.geometry.pose.position_m - before.geometry.pose.position_m;
    let linear_mps = axes(keyframe).transpose() * (moved_m.as_dvec3() / seconds);
    Some((
        linear_mps.as_vec3(),
        (turn.to_scaled_axis() / seconds).as_vec3(),
    ))
}

/// All of them as they were if `values` are what is wrong.
pub(crate) fn corrected(moving: &[Moving], values: &Values) -> Vec<Moving> {
    moving
        .iter()
        .map(|moving| moving.corrected(values))
        .collect()
}
