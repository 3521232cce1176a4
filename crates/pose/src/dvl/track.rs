//! From the DVL's reports to poses; no socket, no clock.

use std::collections::VecDeque;

use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, StampedPose, Timestamp, flu_from_flu, flu_from_frd};

use super::devices::{Devices, Judged};
use super::report::Report;
use crate::advance::MAX_ADVANCE_S;
use crate::clock::UnknownClock;
use crate::fault::{self, Fault};
use crate::mavlink::message::ned_from_frd;
use crate::status::{PoseSender, PoseSourceStatus, Several};
use echosplat_join::{ArrivedPose, StampClock};

/// Two stamps this near are of one clock.
const ONE_CLOCK_NANOS: i64 = 5_000_000_000;
/// Reports without a usable position for so long are told.
const MISSING_AFTER_S: f64 = 5.0;
/// It sends five positions a second: without any report for so long it is silent.
const SILENT_AFTER_S: f64 = 1.5;
/// Velocities kept between two positions: 26 a second at most, 5 positions a second.
const VELOCITY_COUNT: usize = 64;

/// A position report, with z up.
#[derive(Debug, Clone, Copy)]
struct Fix {
    /// On the DVL's own clock.
    time: Timestamp,
    pose: Pose,
}

/// A velocity between positions, in the vehicle's frame.
#[derive(Debug, Clone, Copy)]
struct Velocity {
    time: Timestamp,
    flu_mps: DVec3,
}

/// Poses of one DVL.
#[derive(Debug)]
pub(super) struct Track {
    stamps: StampClock,
    status: PoseSourceStatus,
    /// Of `position_local`.
    position_clock: UnknownClock,
    /// Of `velocity`, the same or not.
    velocity_clock: UnknownClock,
    fix: Option<Fix>,
    /// Since that position, in order of time.
    velocities: VecDeque<Velocity>,
    devices: Devices,
    first_report: Option<Timestamp>,
    last_line: Option<Timestamp>,
    last_position: Option<Timestamp>,
}

impl Track {
    pub(super) fn new(stamps: StampClock) -> Self {
        Self {
            stamps,
            status: PoseSourceStatus::default(),
            position_clock: UnknownClock::default(),
            velocity_clock: UnknownClock::default(),
            fix: None,
            velocities: VecDeque::new(),
            devices: Devices::default(),
            first_report: None,
            last_line: None,
            last_position: None,
        }
    }

    /// Takes one line; gives the poses that it completes, in order of time.
    pub(super) fn take(
        &mut self,
        report: Result<Option<Report>, String>,
        arrived: Timestamp,
    ) -> Vec<ArrivedPose> {
        self.last_line = Some(arrived);
        let poses = match report {
            Ok(None) => return Vec::new(),
            Ok(Some(report)) => {
                self.status.received += 1;
                self.first_report.get_or_insert(arrived);
                self.poses_of(&report, arrived)
            }
            Err(what) => {
                self.status.received += 1;
                Err(Fault::Malformed(what))
            }
        };
        let poses = poses.unwrap_or_else(|fault| {
            self.status.refuse(&fault);
            Vec::new()
        });
        self.status.accepted += poses.len() as u64;
        let poses = poses.into_iter();
        poses.map(|pose| ArrivedPose { pose, arrived }).collect()
    }

    /// For how long nothing has come from a DVL that was heard before, seconds; `None` while something does.
    pub(super) fn silent_s(&self, now: Timestamp) -> Option<f64> {
        let silent_s = now.seconds_since(self.last_line?);
        (silent_s > SILENT_AFTER_S).then_some(silent_s)
    }

    /// Counters, clock and what is missing from its reports, while these come.
    pub(super) fn status(&self, now: Timestamp) -> PoseSourceStatus {
        let since = self.last_position.or(self.first_report);
        let lacks = since.is_some_and(|since| now.seconds_since(since) > MISSING_AFTER_S)
            && self.silent_s(now).is_none();
        let what = "the DVL reports but gives no valid position; it needs to see the bottom (0.05 \
                    to 50 m away) and its dead reckoning reset once it does";
        let names = self.devices.names().into_iter().enumerate();
        let senders = names.map(|(index, name)| PoseSender {
            name,
            is_used: index == 0,
            ..PoseSender::default()
        });
        let several = self.devices.advice().map(|sentence| Several {
            sentence,
            leaves_out: true,
        });
        PoseSourceStatus {
            other_senders: self.devices.left_out(),
            senders: senders.collect(),
            several,
            missing: lacks.then(|| what.to_owned()),
            lacks_north: true,
            ..self.status.clone()
        }
    }

    fn poses_of(&mut self, report: &Report, arrived: Timestamp) -> Result<Vec<StampedPose>, Fault> {
        match *report {
            Report::Position { status, .. } if status != 0 => Err(Fault::Malformed(format!(
                "position_local with status {status}: the DVL calls it invalid"
            ))),
            Report::Position {
                stamp_s,
                position_m,
                roll_pitch_yaw_deg,
                ..
            } => {
                let fix = fix_of(stamp_s, position_m, roll_pitch_yaw_deg)?;
                match self.devices.position(stamp_s, position_m, arrived) {
                    Judged::Used => {}
                    Judged::First => self.begin_anew(),
                    Judged::LeftOut => return Ok(Vec::new()),
                }
                self.last_position = Some(arrived);
                self.position_clock.observe(fix.time.nanos(), arrived);
                Ok(self.up_to(fix))
            }
            // Without the bottom there is no velocity.
            Report::Velocity {
                is_valid: false, ..
            } => Ok(Vec::new()),
            Report::Velocity { .. } if !self.devices.uses_velocities() => Ok(Vec::new()),
            Report::Velocity {
                valid_us,
                sent_us,
                velocity_mps,
                ..
            } => {
                let velocity_mps = fault::vector("velocity", velocity_mps)?;
                let nanos = |us: i64| us.saturating_mul(1_000);
                self.velocity_clock.observe(nanos(sent_us), arrived);
                self.keep(nanos(valid_us), flu_from_frd(velocity_mps));
                Ok(Vec::new())
            }
        }
    }

    /// Forgets clocks and velocities: they may be another device's.
    fn begin_anew(&mut self) {
        self.position_clock = UnknownClock::default();
        self.velocity_clock = UnknownClock::default();
        self.fix = None;
        self.velocities.clear();
    }

    /// A velocity waits for the position behind it, which tells the attitude at its time.
    fn keep(&mut self, valid: i64, flu_mps: DVec3) {
        let time = Timestamp::from_nanos(self.on_position_clock(valid));
        let last = self.velocities.back().map(|velocity| velocity.time);
        if last.is_none_or(|last| last < time) {
            self.velocities.push_back(Velocity { time, flu_mps });
        }
        if self.velocities.len() > VELOCITY_COUNT {
            self.velocities.pop_front();
        }
    }

    /// The poses at the velocities since the position before, and that of `fix`.
    fn up_to(&mut self, fix: Fix) -> Vec<StampedPose> {
        let before = self.fix.replace(fix);
        let is_past = |velocity: &Velocity| velocity.time <= fix.time;
        let past_count = self.velocities.iter().take_while(|v| is_past(v)).count();
        let past: Vec<Velocity> = self.velocities.drain(..past_count).collect();
        let mut fixes = before.map_or_else(Vec::new, |before| between(&before, &fix, &past));
        fixes.push(fix);
        fixes.into_iter().map(|fix| self.on_host(&fix)).collect()
    }

    /// A stamp of `velocity` as `position_local` would have it.
    fn on_position_clock(&self, valid: i64) -> i64 {
        let Some(fix) = self.fix else { return valid };
        let near = fix.time.nanos();
        if valid.saturating_sub(near).saturating_abs() <= ONE_CLOCK_NANOS {
            return valid;
        }
        let host = valid.saturating_add(self.velocity_clock.offset_nanos(valid));
        host.saturating_sub(self.position_clock.offset_nanos(near))
    }

    fn on_host(&mut self, fix: &Fix) -> StampedPose {
        let stamp = fix.time.nanos();
        let (offset, method) = match self.stamps {
            StampClock::Data => (0, "data"),
            StampClock::Host => (
                self.position_clock.offset_nanos(stamp),
                self.position_clock.method(stamp),
            ),
        };
        self.status.clock_offset_s = Some(offset as f64 * 1e-9);
        self.status.clock_method = Some(method.to_owned());
        StampedPose {
            time: Timestamp::from_nanos(stamp.saturating_add(offset)),
            world_from_vehicle: fix.pose,
            uncertainty: None,
            epoch: self.status.epoch,
        }
    }
}

fn fix_of(stamp_s: f64, position_m: DVec3, roll_pitch_yaw_deg: DVec3) -> Result<Fix, Fault> {
    let position_m = fault::vector("position_local", position_m)?;
    let [roll, pitch, yaw] = roll_pitch_yaw_deg.to_array().map(f64::to_radians);
    let rotation = fault::rotation("position_local", ned_from_frd(roll, pitch, yaw))?;
    if !stamp_s.is_finite() {
        return Err(Fault::NotFinite("ts of position_local".to_owned()));
    }
    Ok(Fix {
        time: Timestamp::from_secs_f64(stamp_s),
        pose: Pose {
            rotation: flu_from_flu(rotation),
            translation_m: flu_from_frd(position_m),
        },
    })
}

/// Poses at the velocities between two positions: attitude between theirs, position moved on by
/// each velocity until the next, and what is then missing to the second spread over the time.
/// Nothing between positions that lie further apart than a velocity is trusted for.
fn between(first: &Fix, second: &Fix, velocities: &[Velocity]) -> Vec<Fix> {
    let span_s = second.time.seconds_since(first.time);
    if !(span_s > 0.0 && span_s <= MAX_ADVANCE_S) {
        return Vec::new();
    }
    let fraction = |time: Timestamp| time.seconds_since(first.time) / span_s;
    let mut moved = Vec::new();
    let (mut time, mut position_m) = (first.time, first.pose.translation_m);
    let mut mps = DVec3::ZERO;
    let inside = velocities.iter().filter(|v| v.time > first.time);
    for velocity in inside.filter(|velocity| velocity.time < second.time) {
        let pose = first
            .pose
            .interpolate(&second.pose, fraction(velocity.time));
        let next_mps = pose.rotation * velocity.flu_mps;
        // Before the first velocity it moved as it then does.
        let mean_mps = if moved.is_empty() {
            next_mps
        } else {
            (mps + next_mps) * 0.5
        };
        position_m += mean_mps * velocity.time.seconds_since(time);
        (time, mps) = (velocity.time, next_mps);
        moved.push((velocity.time, position_m, pose.rotation));
    }
    let arrived_m = position_m + mps * second.time.seconds_since(time);
    let missing_m = second.pose.translation_m - arrived_m;
    let fix = |(time, position_m, rotation): (Timestamp, DVec3, DQuat)| Fix {
        time,
        pose: Pose {
            rotation,
            translation_m: position_m + missing_m * fraction(time),
        },
    };
    moved.into_iter().map(fix).collect()
}
