//! From a vehicle's messages to poses; no sockets, no clock.
//!
//! A pose is made of each attitude, at its time since boot, with the position moved there by its
//! velocity (at most [`MAX_ADVANCE_S`](crate::advance::MAX_ADVANCE_S)); or of each `ODOMETRY`,
//! which is preferred while it comes. Where no position comes and a velocity does, positions are reckoned; one that comes
//! ends that.

use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, StampedPose, Timestamp, enu_from_flu, enu_from_ned};
use mavlink::dialects::ardupilotmega::MavFrame;

use super::clock::{VehicleClock, is_unix_us};
use super::message::{Message, Odometry, Sender};
use super::odometry::{covariance_of_odometry, pose_of_odometry};
use super::order::{CountsFrom, MessageKind, Order, Step, content_of};
use super::origin::{Origin, ToldOrigin};
use super::reckoning::{POSITION_LOST_S, Reckoning};
use super::told::{Stamp, Teller, Told, told_of};
use crate::advance::Motion;
use crate::clock::UnknownClock;
use crate::fault::{self, Fault};
use crate::reckon::{Axes, LIVE_PATIENCE_S, LOG_PATIENCE_S, Reckoned};
use crate::status::PoseSourceStatus;
use echosplat_join::{ArrivedPose, StampClock};

/// The better message is waited for so long before the next best is used.
const PREFERRED_FOR_S: f64 = 1.0;
/// An attitude without a position for so long is told.
const MISSING_AFTER_S: f64 = 5.0;
/// Which messages the newest pose was made of; two kinds share no origin for certain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Attitude,
    /// With its `MAV_FRAME`.
    Odometry(u32),
    /// Of attitude and velocity.
    Reckoned,
}

/// When a kind of message came last, and since when.
#[derive(Debug, Clone, Copy)]
struct Heard {
    first: Timestamp,
    newest: Timestamp,
}

impl Heard {
    fn note(heard: &mut Option<Self>, now: Timestamp) {
        let heard = heard.get_or_insert(Self {
            first: now,
            newest: now,
        });
        heard.newest = now;
    }

    fn within(heard: Option<Self>, limit_s: f64, now: Timestamp) -> bool {
        heard.is_some_and(|heard| now.seconds_since(heard.newest).abs() <= limit_s)
    }

    /// Came for so long, and still does.
    fn has_lasted(heard: Option<Self>, limit_s: f64, now: Timestamp) -> bool {
        Self::within(heard, limit_s, now)
            && heard.is_some_and(|heard| heard.newest.seconds_since(heard.first) >= limit_s)
    }
}

/// One sender of messages.
#[derive(Debug)]
pub(crate) struct Vehicle {
    pub(crate) clock: VehicleClock,
    status: PoseSourceStatus,
    boot_order: Order,
    unix_order: Order,
    unix_clock: UnknownClock,
    stamps: StampClock,
    motion: Option<Motion>,
    kind: Option<Kind>,
    /// The counter of resets that came first, and the epoch that it stands for.
    resets: Option<(u8, u32)>,
    newest_epoch: u32,
    attitude: Option<Heard>,
    quaternion: Option<Heard>,
    position: Option<Heard>,
    odometry: Option<Heard>,
    /// When the newest pose was made.
    newest_pose: Option<Timestamp>,
    /// Of what positions count from, on Earth.
    origin: Origin,
    /// How far the newest position lay behind what else is known of the vehicle's clock.
    position_lag_s: f64,
    reckoning: Reckoning,
    /// Epoch of the reckoner of the newest pose that was reckoned.
    reckoned_epoch: Option<u32>,
}

impl Vehicle {
    pub(crate) fn new(stamps: StampClock) -> Self {
        Self::with(stamps, Reckoning::new(LIVE_PATIENCE_S))
    }

    /// Whose messages are all there already, so that poses can wait for the end of every gap.
    pub(crate) fn of_log() -> Self {
        Self::with(StampClock::Data, Reckoning::new(LOG_PATIENCE_S))
    }

    /// The URL names a DVL: nobody else's velocities are taken.
    pub(crate) fn keep_to_dvl(&mut self) {
        self.reckoning.keep_to_dvl();
    }

    fn with(stamps: StampClock, reckoning: Reckoning) -> Self {
        Self {
            clock: VehicleClock::new(stamps),
            status: PoseSourceStatus::default(),
            boot_order: Order::new(CountsFrom::Boot, stamps),
            unix_order: Order::new(CountsFrom::Unix, stamps),
            unix_clock: UnknownClock::default(),
            stamps,
            motion: None,
            kind: None,
            resets: None,
            newest_epoch: 0,
            attitude: None,
            quaternion: None,
            position: None,
            odometry: None,
            newest_pose: None,
            origin: Origin::default(),
            position_lag_s: 0.0,
            reckoning,
            reckoned_epoch: None,
        }
    }

    /// Takes one message of its own; gives the poses that it completes, in order of time.
    pub(crate) fn take(&mut self, message: Message, arrived: Timestamp) -> Vec<ArrivedPose> {
        if message.is_of_pose() {
            self.status.received += 1;
        }
        let pose = self.pose_of(message, arrived).unwrap_or_else(|fault| {
            self.status.refuse(&fault);
            None
        });
        match pose {
            Some(pose) => self.handed_on(vec![pose], arrived),
            None => self.reckoned(arrived),
        }
    }

    /// Takes a velocity that `sender` tells of this vehicle; gives the poses that it completes, in order of time.
    pub(crate) fn aided(
        &mut self,
        sender: Sender,
        message: &Message,
        arrived: Timestamp,
    ) -> Vec<ArrivedPose> {
        match told_of(sender, message) {
            Ok(Some(told)) => self.moves(&told, arrived),
            Ok(None) => Vec::new(),
            Err(fault) => {
                self.refuse_aid(Err(fault));
                Vec::new()
            }
        }
    }

    /// Takes a velocity; gives the poses that it completes, in order of time.
    pub(crate) fn moves(&mut self, told: &Told, arrived: Timestamp) -> Vec<ArrivedPose> {
        let taken = self.reckoning.velocity(told, arrived);
        self.refuse_aid(taken);
        self.reckoned(arrived)
    }

    /// What only reckoning needs is not told wrong while positions come.
    fn refuse_aid(&mut self, taken: Result<(), Fault>) {
        if let Err(fault) = taken
            && matches!(self.kind, None | Some(Kind::Reckoned))
        {
            self.status.refuse(&fault);
        }
    }

    fn handed_on(&mut self, poses: Vec<StampedPose>, arrived: Timestamp) -> Vec<ArrivedPose> {
        if !poses.is_empty() {
            self.status.accepted += poses.len() as u64;
            self.newest_pose = Some(arrived);
        }
        let poses = poses.into_iter();
        poses.map(|pose| ArrivedPose { pose, arrived }).collect()
    }

    /// Poses that were reckoned by now, if positions are.
    fn reckoned(&mut self, arrived: Timestamp) -> Vec<ArrivedPose> {
        if self.kind != Some(Kind::Reckoned) && self.has_to_reckon(arrived) {
            if self.kind.is_some() {
                self.reckoning.begin();
            }
            self.switch_to(Kind::Reckoned);
            self.reckoned_epoch = None;
            tracing::info!("poses: {}", self.reckoning.in_words());
        }
        let made: Vec<Reckoned> = match self.kind {
            // Kept until it is clear whether positions come.
            None => return Vec::new(),
            Some(_) => self.reckoning.take().collect(),
        };
        if self.kind != Some(Kind::Reckoned) {
            return Vec::new();
        }
        let poses = made.iter().map(|made| self.of_reckoned(made)).collect();
        self.handed_on(poses, arrived)
    }

    fn of_reckoned(&mut self, made: &Reckoned) -> StampedPose {
        let before = self.reckoned_epoch.replace(made.epoch);
        if before.is_some_and(|before| before != made.epoch) {
            self.begin_epoch();
        }
        StampedPose {
            time: self.on_host(made.time.nanos()),
            world_from_vehicle: made.world_from_vehicle,
            uncertainty: Some(made.covariance),
            epoch: self.status.epoch,
        }
    }

    fn has_to_reckon(&self, now: Timestamp) -> bool {
        let without_s = match self.kind {
            None => MISSING_AFTER_S,
            Some(_) => POSITION_LOST_S,
        };
        let lacks = |heard| !Heard::within(heard, without_s, now);
        lacks(self.position) && lacks(self.odometry) && self.reckoning.is_ready(now)
    }

    /// What positions are reckoned of, in words; `None` where they are not.
    pub(crate) fn reckons(&self) -> Option<String> {
        (self.kind == Some(Kind::Reckoned)).then(|| self.reckoning.in_words())
    }

    /// The newest time since boot that was heard, nanoseconds.
    pub(crate) fn newest_boot(&self) -> Option<i64> {
        self.boot_order.newest()
    }

    /// Whether the messages of these ids come.
    pub(crate) fn comes(&self, message_id: u32, now: Timestamp) -> bool {
        let heard = match message_id {
            30 => self.attitude,
            31 => self.quaternion,
            32 => self.position,
            331 => self.odometry,
            _ => None,
        };
        Heard::within(heard, 2.0, now)
    }

    /// Messages that came and should have led to a pose.
    pub(crate) fn received(&self) -> u64 {
        self.status.received
    }

    /// Counters, clock and what is missing; rate, link and senders are the caller's.
    pub(crate) fn status(&self, now: Timestamp) -> PoseSourceStatus {
        PoseSourceStatus {
            missing: self.missing(now),
            origin: self.origin(),
            lacks_north: self.kind.is_some() && !self.is_enu(),
            ..self.status.clone()
        }
    }

    /// Where on Earth its poses count from, if their world has true north.
    pub(crate) fn origin(&self) -> Option<ToldOrigin> {
        // What is reckoned counts from wherever that began.
        let is_placed = self.is_enu() && self.kind != Some(Kind::Reckoned);
        self.origin.told().filter(|_| is_placed)
    }

    /// Whether x of its poses' world points east.
    fn is_enu(&self) -> bool {
        match self.kind {
            Some(Kind::Attitude | Kind::Reckoned) => true,
            Some(Kind::Odometry(frame)) => {
                frame == MavFrame::MAV_FRAME_LOCAL_NED as u32
                    || frame == MavFrame::MAV_FRAME_LOCAL_ENU as u32
            }
            None => false,
        }
    }

    fn missing(&self, now: Timestamp) -> Option<String> {
        if Heard::within(self.odometry, PREFERRED_FOR_S, now) {
            return None;
        }
        let lasts = |heard| Heard::has_lasted(heard, MISSING_AFTER_S, now);
        let lacks = |heard| !Heard::within(heard, MISSING_AFTER_S, now);
        let has_attitude = lasts(self.attitude.or(self.quaternion));
        if has_attitude && self.kind == Some(Kind::Reckoned) {
            return self.reckoning.missing(now);
        }
        if has_attitude && lacks(self.position) {
            // One that only has to last is none that is missing.
            let comes = self
                .reckoning
                .silent_s(now)
                .is_some_and(|s| s <= MISSING_AFTER_S);
            return (!comes).then(|| self.reckoning.lacks_all().to_owned());
        }
        let no_attitude = lacks(self.attitude) && lacks(self.quaternion);
        if lasts(self.position) && no_attitude {
            return Some(
                "the vehicle sends a position but no attitude; ask it for ATTITUDE_QUATERNION"
                    .to_owned(),
            );
        }
        let since = self.newest_pose;
        let lacks_poses = since.is_none_or(|at| now.seconds_since(at).abs() > MISSING_AFTER_S);
        (has_attitude && lasts(self.position) && lacks_poses && self.position_lag_s > 0.0).then(|| {
            format!(
                "the vehicle's LOCAL_POSITION_NED is stamped {:.1} s before the attitude that comes with it, and no \
                 pose can be made of both; look for a second, slower route that positions take",
                self.position_lag_s
            )
        })
    }

    fn pose_of(
        &mut self,
        message: Message,
        arrived: Timestamp,
    ) -> Result<Option<StampedPose>, Fault> {
        let content = content_of(&message);
        match message {
            Message::Attitude {
                boot_ms,
                ned_from_frd,
                is_quaternion,
            } => {
                Heard::note(&mut self.attitude, arrived);
                if is_quaternion {
                    Heard::note(&mut self.quaternion, arrived);
                }
                let is_second = !is_quaternion
                    && Heard::within(self.quaternion, PREFERRED_FOR_S, arrived)
                    || Heard::within(self.odometry, PREFERRED_FOR_S, arrived);
                let kind = match is_quaternion {
                    true => MessageKind::Quaternion,
                    false => MessageKind::Attitude,
                };
                let boot = self.booted_at(kind, boot_ms, content, arrived);
                match boot.filter(|_| !is_second) {
                    Some(boot) => self.of_attitude(boot, ned_from_frd, arrived),
                    None => Ok(None),
                }
            }
            Message::Position {
                boot_ms,
                position_ned_m,
                velocity_ned_mps,
            } => {
                Heard::note(&mut self.position, arrived);
                let lag_s = self.boot_order.behind_s(boot_ms);
                match self.booted_at(MessageKind::Position, boot_ms, content, arrived) {
                    Some(boot) => self.take_position(boot, position_ned_m, velocity_ned_mps)?,
                    None => self.position_lag_s = lag_s,
                }
                Ok(None)
            }
            Message::Odometry(odometry) => self.of_odometry(&odometry, content, arrived),
            Message::TimeSync { tc1, ts1 } => {
                if tc1 != 0 {
                    self.clock.answered(tc1, ts1, arrived);
                }
                Ok(None)
            }
            Message::SystemTime { unix_us, boot_ms } => {
                if let Some(boot) =
                    self.booted_at(MessageKind::SystemTime, boot_ms, content, arrived)
                {
                    self.clock.says_unix(unix_us, boot);
                }
                Ok(None)
            }
            Message::Heartbeat(_) => Ok(None),
            Message::GlobalOrigin(fix) => {
                self.origin.says(fix);
                Ok(None)
            }
            Message::GlobalPosition {
                boot_ms,
                fix,
                height_m,
                velocity_ned_mps,
            } => {
                let time = Timestamp::from_millis(boot_ms.into());
                let motion = self.motion.as_ref();
                if let Some(local_m) = motion.and_then(|motion| motion.position_at(time)) {
                    self.origin.is_beside(fix, local_m);
                }
                self.of_estimate(boot_ms, height_m, velocity_ned_mps, arrived);
                Ok(None)
            }
            Message::Height(height_m) => {
                let taken = self.reckoning.height("VFR_HUD", None, height_m, arrived);
                self.refuse_aid(taken);
                Ok(None)
            }
            Message::EstimateStatus { has_velocity } => {
                self.reckoning.estimates(has_velocity);
                Ok(None)
            }
            // Whoever sends them, they come by `aided`.
            Message::PositionDelta { .. } | Message::Speed { .. } => Ok(None),
        }
    }

    /// What `GLOBAL_POSITION_INT` tells beside a place on Earth.
    fn of_estimate(&mut self, boot_ms: u32, height_m: f64, ned_mps: DVec3, arrived: Timestamp) {
        let boot = self.boot_order.unwrapped(boot_ms);
        let name = "GLOBAL_POSITION_INT";
        let taken = self.reckoning.height(name, Some(boot), height_m, arrived);
        self.refuse_aid(taken);
        let told = Told {
            teller: Teller::Estimate,
            sender: Sender::default(),
            stamp: Stamp::Boot(boot),
            before_s: 0.0,
            axes: Axes::World,
            mps: enu_from_ned(ned_mps),
        };
        let taken = self.reckoning.velocity(&told, arrived);
        self.refuse_aid(taken);
    }

    /// Nanoseconds since boot; `None` for what comes late.
    fn booted_at(
        &mut self,
        kind: MessageKind,
        boot_ms: u32,
        content: u64,
        arrived: Timestamp,
    ) -> Option<i64> {
        let step = self
            .boot_order
            .step_boot_ms(kind, boot_ms, content, arrived);
        self.stepped(step, arrived)
    }

    fn stepped(&mut self, step: Step, arrived: Timestamp) -> Option<i64> {
        let boot = match step {
            Step::At(boot) => boot,
            Step::Late => {
                self.status.late += 1;
                return None;
            }
            Step::Anew(boot) => {
                self.clock.forget();
                self.motion = None;
                self.origin.forget();
                self.reckoning.forget();
                self.begin_epoch();
                boot
            }
        };
        self.clock.observe(boot, arrived);
        Some(boot)
    }

    fn begin_epoch(&mut self) {
        self.resets = None;
        self.be_in_epoch(self.newest_epoch.saturating_add(1));
    }

    fn be_in_epoch(&mut self, epoch: u32) {
        self.status.epoch = epoch;
        self.newest_epoch = self.newest_epoch.max(epoch);
    }

    /// By the counter itself: a stray message with another is of another epoch, and those after it are not.
    fn count_resets(&mut self, counter: u8) {
        let (first, epoch) = *self.resets.get_or_insert((counter, self.status.epoch));
        let epoch = epoch.saturating_add(counter.wrapping_sub(first).into());
        if epoch != self.status.epoch {
            self.origin.forget();
        }
        self.be_in_epoch(epoch);
    }

    /// Host time of a time since boot, told in the status.
    fn on_host(&mut self, boot: i64) -> Timestamp {
        let offset = self.clock.offset_at(boot);
        self.tell_clock(offset.nanos, offset.method);
        Timestamp::from_nanos(boot.saturating_add(offset.nanos))
    }

    fn tell_clock(&mut self, offset_nanos: i64, method: &str) {
        self.status.clock_offset_s = Some(offset_nanos as f64 * 1e-9);
        if self.status.clock_method.as_deref() != Some(method) {
            self.status.clock_method = Some(method.to_owned());
        }
    }

    fn take_position(
        &mut self,
        boot: i64,
        position_ned_m: DVec3,
        velocity_ned_mps: DVec3,
    ) -> Result<(), Fault> {
        let position_m = fault::vector("LOCAL_POSITION_NED", position_ned_m)?;
        let velocity_mps = fault::vector("velocity of LOCAL_POSITION_NED", velocity_ned_mps)?;
        self.motion = Some(Motion {
            // On the clock since boot, which no better estimate of an offset ever moves.
            time: Timestamp::from_nanos(boot),
            position_m: enu_from_ned(position_m),
            velocity_mps: enu_from_ned(velocity_mps),
        });
        Ok(())
    }

    fn of_attitude(
        &mut self,
        boot: i64,
        ned_from_frd: DQuat,
        arrived: Timestamp,
    ) -> Result<Option<StampedPose>, Fault> {
        let rotation = enu_from_flu(fault::rotation("the attitude", ned_from_frd)?);
        self.reckoning.attitude(boot, rotation, arrived);
        let motion = self.motion;
        let time = Timestamp::from_nanos(boot);
        let there = motion.and_then(|motion| motion.position_at(time));
        let Some(translation_m) = there else {
            let behind_s = motion.map(|motion| time.seconds_since(motion.time));
            self.position_lag_s = behind_s.unwrap_or(self.position_lag_s);
            return Ok(None);
        };
        self.switch_to(Kind::Attitude);
        Ok(Some(StampedPose {
            time: self.on_host(boot),
            world_from_vehicle: Pose {
                rotation,
                translation_m,
            },
            uncertainty: None,
            epoch: self.status.epoch,
        }))
    }

    fn of_odometry(
        &mut self,
        odometry: &Odometry,
        content: u64,
        arrived: Timestamp,
    ) -> Result<Option<StampedPose>, Fault> {
        let Some(time) = self.time_of_odometry(odometry.time_us, content, arrived) else {
            return Ok(None);
        };
        Heard::note(&mut self.odometry, arrived);
        if odometry.quality < 0 {
            let what = "ODOMETRY of quality -1: the vehicle's estimate has failed";
            return Err(Fault::Malformed(what.to_owned()));
        }
        let world_from_vehicle = pose_of_odometry(odometry)?;
        self.switch_to(Kind::Odometry(odometry.frame));
        self.count_resets(odometry.reset_counter);
        Ok(Some(StampedPose {
            time,
            world_from_vehicle,
            uncertainty: covariance_of_odometry(odometry),
            epoch: self.status.epoch,
        }))
    }

    /// On the host's clock; `None` for what comes late.
    fn time_of_odometry(
        &mut self,
        time_us: u64,
        content: u64,
        arrived: Timestamp,
    ) -> Option<Timestamp> {
        let nanos = i64::try_from(time_us).map_or(i64::MAX, |us| us.saturating_mul(1_000));
        let kind = MessageKind::Odometry;
        if !is_unix_us(time_us) {
            let step = self.boot_order.step(kind, nanos, content, arrived);
            self.stepped(step, arrived)?;
            return Some(self.on_host(nanos));
        }
        if self.unix_order.step(kind, nanos, content, arrived) == Step::Late {
            self.status.late += 1;
            return None;
        }
        if self.stamps == StampClock::Data {
            self.tell_clock(0, "data");
            return Some(Timestamp::from_nanos(nanos));
        }
        self.unix_clock.observe(nanos, arrived);
        let offset = self.unix_clock.offset_nanos(nanos);
        self.tell_clock(offset, self.unix_clock.method(nanos));
        Some(Timestamp::from_nanos(nanos.saturating_add(offset)))
    }

    /// Poses of another kind have another origin.
    fn switch_to(&mut self, kind: Kind) {
        let before = self.kind.replace(kind);
        if before.is_some_and(|before| before != kind) {
            self.begin_epoch();
        }
    }
}
