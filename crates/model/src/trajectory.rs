//! Poses over time, interpolated and never extrapolated.

use std::collections::VecDeque;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::smoothing::{LONGEST_REACH_S, smoothed};
use crate::{Pose, PoseCovariance, Switch, Timestamp, Twist};

/// One sigma of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseUncertainty {
    /// Of the position, along any one axis.
    pub position_m: f64,
    /// Of the attitude, about any one axis.
    pub attitude_rad: f64,
}

/// The vehicle's pose at its time of validity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedPose {
    /// Time of validity, on the clock of the pings.
    pub time: Timestamp,
    /// Pose of the vehicle.
    pub world_from_vehicle: Pose,
    /// As the source says it, if it does.
    pub uncertainty: Option<PoseCovariance>,
    /// Changes when the estimator resets; poses of two epochs are never mixed.
    pub epoch: u32,
}

/// What [`Trajectory::smoothed_at`] finds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothed {
    /// Freed from jitter.
    pub pose: StampedPose,
    /// In the vehicle's frame.
    pub twist: Twist,
    /// One sigma of what was taken away; `None` if nobody looked.
    pub jitter: Option<PoseUncertainty>,
}

/// What [`Trajectory::smoothed_at`] looks ahead by if nobody says otherwise, seconds.
pub const LOOKAHEAD_S: f64 = 0.1;

/// How much a trajectory holds and bridges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrajectoryLimits {
    /// Most poses held; the oldest go first.
    pub capacity: usize,
    /// Longest time between two poses that is interpolated across.
    pub max_pose_gap_s: f64,
}

/// A bounded run of poses in order of time.
#[derive(Debug, Clone)]
pub struct Trajectory {
    limits: TrajectoryLimits,
    poses: VecDeque<StampedPose>,
}

/// Why a pose was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PoseError {
    /// A number is NaN or infinite, or the quaternion has no length.
    #[error("pose is not finite or its quaternion has no length")]
    NotFinite,
    /// Not newer than the newest pose.
    #[error("pose is not newer than the one before it")]
    OutOfOrder,
}

/// Why there is no pose for a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PoseLookupError {
    /// The time lies after the newest pose, which may yet come.
    #[error("no pose that late yet")]
    NotYet,
    /// The time lies before the oldest pose held.
    #[error("no pose that early")]
    TooEarly,
    /// The poses on both sides are further apart than is bridged, or of two epochs.
    #[error(
        "the poses around that time are too far apart, or the estimator was reset between them"
    )]
    Gap,
}

impl Trajectory {
    /// Empty. A capacity below 2 is taken as 2.
    #[must_use]
    pub fn new(limits: TrajectoryLimits) -> Self {
        Self {
            limits,
            poses: VecDeque::new(),
        }
    }

    /// Takes one pose newer than all before.
    ///
    /// # Errors
    /// Says why it was left out; the trajectory is as before.
    pub fn push(&mut self, pose: StampedPose) -> Result<(), PoseError> {
        let StampedPose {
            world_from_vehicle, ..
        } = pose;
        let checked = Pose::checked(
            world_from_vehicle.rotation,
            world_from_vehicle.translation_m,
        )
        .ok_or(PoseError::NotFinite)?;
        if self.poses.back().is_some_and(|last| last.time >= pose.time) {
            return Err(PoseError::OutOfOrder);
        }
        if self.poses.len() >= self.limits.capacity.max(2) {
            self.poses.pop_front();
        }
        self.poses.push_back(StampedPose {
            world_from_vehicle: checked,
            ..pose
        });
        Ok(())
    }

    /// The pose at `time`: translation linear, rotation slerp, between the two around it.
    ///
    /// # Errors
    /// If `time` is outside the poses held or inside a gap.
    pub fn at(&self, time: Timestamp) -> Result<StampedPose, PoseLookupError> {
        let (before, after) = self.around(time)?;
        if before.time == time {
            return Ok(*before);
        }
        let span_s = after.time.seconds_since(before.time);
        let fraction = time.seconds_since(before.time) / span_s;
        Ok(StampedPose {
            time,
            world_from_vehicle: before
                .world_from_vehicle
                .interpolate(&after.world_from_vehicle, fraction),
            uncertainty: before.uncertainty.or(after.uncertainty),
            epoch: before.epoch,
        })
    }

    /// The vehicle's motion at `time`, in its own axes, from the two poses around it.
    ///
    /// # Errors
    /// As [`Trajectory::at`].
    pub fn twist_at(&self, time: Timestamp) -> Result<Twist, PoseLookupError> {
        let (before, after) = self.around(time)?;
        let span_s = after.time.seconds_since(before.time);
        if !(span_s > 0.0) {
            return Ok(Twist::default());
        }
        let (a, b) = (before.world_from_vehicle, after.world_from_vehicle);
        let at = self.at(time)?.world_from_vehicle;
        let turned = a.rotation.conjugate() * b.rotation;
        let turned = if turned.w < 0.0 { -turned } else { turned };
        let linear_mps = at.rotation.conjugate() * ((b.translation_m - a.translation_m) / span_s);
        let angular_radps: DVec3 = turned.to_scaled_axis() / span_s;
        Ok(Twist {
            linear_mps,
            angular_radps,
        })
    }

    /// The pose and motion at `time`, freed from what jitter the poses up to `lookahead_s` after it
    /// show; with a `lookahead_s` of 0, or without `smoothing`, as [`Trajectory::at`] and
    /// [`Trajectory::twist_at`] have them. Smoothing that is on cuts turns too.
    ///
    /// # Errors
    /// As [`Trajectory::at`].
    pub fn smoothed_at(
        &self,
        time: Timestamp,
        lookahead_s: f64,
        smoothing: Switch,
    ) -> Result<Smoothed, PoseLookupError> {
        let (mut pose, twist) = (self.at(time)?, self.twist_at(time)?);
        if !(lookahead_s > 0.0) || smoothing == Switch::Off {
            return Ok(Smoothed {
                pose,
                twist,
                jitter: None,
            });
        }
        let piece = self.piece_around(time, lookahead_s);
        let (smooth, twist, jitter) = smoothed(
            &piece,
            time,
            (pose.world_from_vehicle, twist),
            smoothing == Switch::On,
        );
        pose.world_from_vehicle = smooth;
        Ok(Smoothed {
            pose,
            twist,
            jitter: Some(jitter),
        })
    }

    /// The newest pose held that is no later than `time`.
    #[must_use]
    pub fn at_or_before(&self, time: Timestamp) -> Option<&StampedPose> {
        let after_index = self.poses.partition_point(|pose| pose.time <= time);
        self.poses.get(after_index.checked_sub(1)?)
    }

    /// Poses around `time` without a gap or a reset between them.
    fn piece_around(&self, time: Timestamp, lookahead_s: f64) -> Vec<StampedPose> {
        let first = time.offset_by(-LONGEST_REACH_S);
        let last = time.offset_by(lookahead_s);
        let start = self.poses.partition_point(|pose| pose.time < first);
        let end = self.poses.partition_point(|pose| pose.time <= last);
        let mut piece: Vec<StampedPose> = self.poses.range(start..end).copied().collect();
        let is_break = |pair: &[StampedPose]| {
            let span_s = pair[1].time.seconds_since(pair[0].time);
            span_s > self.limits.max_pose_gap_s || pair[0].epoch != pair[1].epoch
        };
        // What is beyond a break on either side is of no use here.
        let here = piece.partition_point(|pose| pose.time <= time);
        if let Some(after) = piece.windows(2).skip(here).position(is_break) {
            piece.truncate(here + after + 1);
        }
        let before = &piece[..here.min(piece.len())];
        if let Some(at) = before.windows(2).rposition(is_break) {
            piece.drain(..=at);
        }
        piece
    }

    /// The poses on both sides of `time`; the same one twice when it is the last and exact.
    fn around(&self, time: Timestamp) -> Result<(&StampedPose, &StampedPose), PoseLookupError> {
        let after_index = self.poses.partition_point(|pose| pose.time <= time);
        let Some(before) = after_index.checked_sub(1).and_then(|i| self.poses.get(i)) else {
            return Err(match self.poses.is_empty() {
                true => PoseLookupError::NotYet,
                false => PoseLookupError::TooEarly,
            });
        };
        let Some(after) = self.poses.get(after_index) else {
            return match before.time == time {
                true => Ok((before, before)),
                false => Err(PoseLookupError::NotYet),
            };
        };
        let span_s = after.time.seconds_since(before.time);
        let bridged = span_s <= self.limits.max_pose_gap_s && before.epoch == after.epoch;
        if !bridged && before.time != time {
            return Err(PoseLookupError::Gap);
        }
        Ok((before, if bridged { after } else { before }))
    }

    /// Time of the oldest and the newest pose held.
    #[must_use]
    pub fn span(&self) -> Option<(Timestamp, Timestamp)> {
        Some((self.poses.front()?.time, self.poses.back()?.time))
    }

    /// How many poses are held.
    #[must_use]
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether none is held.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn pose(seconds: f64, x: f64, yaw_rad: f64) -> StampedPose {
        StampedPose {
            time: Timestamp::from_secs_f64(seconds),
            world_from_vehicle: Pose::from_yaw_pitch_roll(
                yaw_rad,
                0.0,
                0.0,
                DVec3::new(x, 0.0, 0.0),
            ),
            uncertainty: None,
            epoch: 0,
        }
    }

    fn trajectory(poses: &[StampedPose]) -> Trajectory {
        let mut trajectory = Trajectory::new(TrajectoryLimits {
            capacity: 3,
            max_pose_gap_s: 0.5,
        });
        for &pose in poses {
            trajectory.push(pose).unwrap();
        }
        trajectory
    }

    #[test]
    fn halfway_is_halfway_and_turns_by_slerp() {
        let t = trajectory(&[pose(0.0, 0.0, 0.0), pose(0.2, 1.0, 0.4)]);
        let middle = t.at(Timestamp::from_secs_f64(0.1)).unwrap();
        assert!((middle.world_from_vehicle.translation_m.x - 0.5).abs() < 1e-9);
        let expected = DQuat::from_rotation_z(0.2);
        assert!(middle.world_from_vehicle.rotation.angle_between(expected) < 1e-7);
    }

    #[test]
    fn nothing_is_extrapolated_or_bridged_too_far() {
        let t = trajectory(&[pose(0.0, 0.0, 0.0), pose(1.0, 1.0, 0.0)]);
        let at = |s| t.at(Timestamp::from_secs_f64(s));
        assert_eq!(at(-0.1), Err(PoseLookupError::TooEarly));
        assert_eq!(at(1.1), Err(PoseLookupError::NotYet));
        assert_eq!(at(0.5), Err(PoseLookupError::Gap));
        assert!(at(0.0).is_ok() && at(1.0).is_ok());
    }

    #[test]
    fn poses_of_two_epochs_are_not_mixed() {
        let mut second = pose(0.2, 5.0, 0.0);
        second.epoch = 1;
        let t = trajectory(&[pose(0.0, 0.0, 0.0), second]);
        let between = t.at(Timestamp::from_secs_f64(0.1));
        assert_eq!(between, Err(PoseLookupError::Gap));
    }

    #[test]
    fn bad_and_late_poses_leave_it_as_it_was() {
        let mut t = trajectory(&[pose(0.0, 0.0, 0.0)]);
        assert_eq!(t.push(pose(0.0, 1.0, 0.0)), Err(PoseError::OutOfOrder));
        assert_eq!(t.push(pose(1.0, f64::NAN, 0.0)), Err(PoseError::NotFinite));
        assert_eq!(t.len(), 1);
    }

    #[test]
    fn the_oldest_goes_first() {
        let poses: Vec<_> = (0..5).map(|i| pose(f64::from(i) * 0.1, 0.0, 0.0)).collect();
        let t = trajectory(&poses);
        assert_eq!(t.len(), 3);
        assert_eq!(t.span().unwrap().0, poses[2].time);
    }

    #[test]
    fn the_twist_is_in_the_vehicles_axes() {
        // Facing north (yaw 90°) and moving north at 1 m/s is moving forward.
        let mut a = pose(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let mut b = pose(0.5, 0.0, std::f64::consts::FRAC_PI_2 + 0.1);
        a.world_from_vehicle.translation_m = DVec3::ZERO;
        b.world_from_vehicle.translation_m = DVec3::new(0.0, 0.5, 0.0);
        let twist = trajectory(&[a, b]).twist_at(Timestamp::ZERO).unwrap();
        assert!((twist.linear_mps - DVec3::X).length() < 1e-9);
        assert!((twist.angular_radps - DVec3::Z * 0.2).length() < 1e-6);
    }
}
