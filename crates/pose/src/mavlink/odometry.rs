//! What `ODOMETRY` says, in the frames of this program.

use echosplat_model::glam::DVec3;
use echosplat_model::{
    HALF_TURN_ABOUT_X, Pose, PoseCovariance, enu_from_flu, enu_from_ned, flu_from_flu, flu_from_frd,
};
use mavlink::dialects::ardupilotmega::MavFrame;

use super::message::Odometry;
use crate::fault::{self, Fault};
use crate::reckon::Axes;

/// Along the axes of its child frame, with z up.
#[expect(deprecated, reason = "older vehicles call the body's frame so")]
pub(super) fn velocity_of_odometry(odometry: &Odometry) -> Result<(Axes, DVec3), Fault> {
    let is = |frame: MavFrame| odometry.child_frame == frame as u32;
    let mps = odometry.velocity_mps;
    if is(MavFrame::MAV_FRAME_BODY_FRD) || is(MavFrame::MAV_FRAME_BODY_NED) {
        return Ok((Axes::Vehicle, flu_from_frd(mps)));
    }
    if is(MavFrame::MAV_FRAME_LOCAL_FLU) {
        return Ok((Axes::Vehicle, mps));
    }
    if is(MavFrame::MAV_FRAME_LOCAL_NED) {
        return Ok((Axes::World, enu_from_ned(mps)));
    }
    if is(MavFrame::MAV_FRAME_LOCAL_ENU) {
        return Ok((Axes::World, mps));
    }
    Err(Fault::Malformed(format!(
        "ODOMETRY without a position and with its velocity in MAV_FRAME {}; read are LOCAL_NED (1), LOCAL_ENU (4), BODY_NED \
         (8), BODY_FRD (12) and LOCAL_FLU (21)",
        odometry.child_frame
    )))
}

/// In the world with z up that `frame` has, of a vehicle that is forward-left-up.
#[expect(deprecated, reason = "older vehicles call the body's frame so")]
pub(super) fn pose_of_odometry(odometry: &Odometry) -> Result<Pose, Fault> {
    let position_m = fault::vector("position of ODOMETRY", odometry.position_m)?;
    let frame_from_body = fault::rotation("ODOMETRY", odometry.frame_from_body)?;
    let (frame, child) = (odometry.frame, odometry.child_frame);
    let is = |found: u32, frame: MavFrame| found == frame as u32;
    let is_flu = is(child, MavFrame::MAV_FRAME_LOCAL_FLU);
    let is_frd = is(child, MavFrame::MAV_FRAME_BODY_FRD) || is(child, MavFrame::MAV_FRAME_BODY_NED);
    // A body is as its own frame says; where that one is level too, as its world is.
    let frd_or = |otherwise: bool| is_frd || (otherwise && !is_flu);
    let from_frd = |is_frd: bool| match is_frd {
        true => frame_from_body,
        false => frame_from_body * HALF_TURN_ABOUT_X,
    };
    if is(frame, MavFrame::MAV_FRAME_LOCAL_NED) {
        return Ok(Pose {
            rotation: enu_from_flu(from_frd(frd_or(true))),
            translation_m: enu_from_ned(position_m),
        });
    }
    if is(frame, MavFrame::MAV_FRAME_LOCAL_FRD) {
        return Ok(Pose {
            rotation: flu_from_flu(from_frd(frd_or(true))),
            translation_m: flu_from_frd(position_m),
        });
    }
    let is_up =
        is(frame, MavFrame::MAV_FRAME_LOCAL_ENU) || is(frame, MavFrame::MAV_FRAME_LOCAL_FLU);
    match is_up {
        true => Ok(Pose {
            rotation: from_frd(frd_or(false)) * HALF_TURN_ABOUT_X,
            translation_m: position_m,
        }),
        false => Err(Fault::Malformed(format!(
            "ODOMETRY in MAV_FRAME {frame}; read are LOCAL_NED (1), LOCAL_ENU (4), LOCAL_FRD (20) \
             and LOCAL_FLU (21)"
        ))),
    }
}

/// Where xx, xy, xz, yy, yz and zz stand in an upper triangle of 6.
const POSITION: [usize; 6] = [0, 1, 2, 6, 7, 11];
/// Where the variances of roll, pitch and yaw stand there.
const ATTITUDE: [usize; 3] = [15, 18, 20];

/// In the world with z up that the message's frame has; `None` if its sender calls it unknown. What goes between position
/// and attitude is left out, and so is what goes between the angles.
pub(super) fn covariance_of_odometry(odometry: &Odometry) -> Option<PoseCovariance> {
    let told = &odometry.covariance;
    if told[0].is_nan() || told.iter().all(|&value| value == 0.0) {
        return None;
    }
    let [xx, xy, xz, yy, yz, zz] = POSITION.map(|index| told[index]);
    let is = |frame: MavFrame| odometry.frame == frame as u32;
    let position_m2 = if is(MavFrame::MAV_FRAME_LOCAL_NED) {
        [yy, xy, -yz, xx, -xz, zz]
    } else if is(MavFrame::MAV_FRAME_LOCAL_FRD) {
        [xx, -xy, -xz, yy, yz, zz]
    } else {
        [xx, xy, xz, yy, yz, zz]
    };
    Some(PoseCovariance {
        position_m2,
        attitude_rad2: ATTITUDE.map(|index| told[index]),
    })
}
