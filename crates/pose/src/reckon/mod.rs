//! Poses of attitude, velocity over ground and depth; no socket, no clock.
//!
//! The place is the integral of the velocity, each turned into the world by the attitude between those around its time, and
//! linear in between. Up is by a depth sensor where there is one, else by the integral. The world is east, north, up and begins
//! at the first use; a depth sensor counts from the surface.
//!
//! Where the velocity is missing, as over a bottom that a Doppler log does not see, the last one is carried on for
//! [`BRIDGED_S`], and the place grows unsure. When it comes back in time, the place is that of a way between both ends, which is
//! nearer by far: poses step there. After a longer gap a new epoch begins. Poses wait for the next velocity, no longer than the
//! reckoner's patience: poses of a log can wait for the end of every gap, and for what shows how velocities go on behind it.

mod depth;
mod node;
mod slope;
mod turns;

use std::collections::VecDeque;

use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, PoseCovariance, Timestamp};

use crate::fault::{self, Fault};
use depth::Depths;
use node::{Node, Stretch};
use slope::{Known, Recent, SLOPE_S, Slope};
use turns::{Turn, Turns};

/// Seconds, assumed: a gap of 5 s and a report.
/// Without a velocity for longer than this there are no poses, and an epoch ends.
pub(crate) const BRIDGED_S: f64 = 6.0;
/// Seconds, derived: half of what pings wait.
/// Poses of a live source wait no longer for the next velocity: for some reports of a slow Doppler log.
pub(crate) const LIVE_PATIENCE_S: f64 = 1.0;
/// Seconds, derived: the longest gap, and what shows how velocities go on.
/// Poses of a log wait for so long.
pub(crate) const LOG_PATIENCE_S: f64 = BRIDGED_S + SLOPE_S + 1.0;
/// Seconds, assumed: the slowest Doppler log.
/// Velocities further apart have a gap between them.
const GAP_S: f64 = 1.0;
/// Metres a second, as for poses.
/// No vehicle that maps moves faster over ground.
const FASTEST_MPS: f64 = 5.0;
/// Metres, physics: the deepest sea.
const DEEPEST_M: f64 = 12_000.0;
/// Velocities that wait for their attitude, bounds memory.
/// Two seconds of the fastest source, 50 a second.
const VELOCITY_COUNT: usize = 128;
/// Poses made that nobody has taken, bounds memory.
/// Those of 10 s, 400 a second.
const MADE_COUNT: usize = 4_096;
/// Seconds; assumed.
/// A velocity stamped further ahead of the newest attitude is of another clock.
const AHEAD_S: f64 = 2.0;
/// Radians, assumed: a small compass and gyro, half a degree.
/// One sigma of the attitude about each axis, which does not change with the way.
const ATTITUDE_SIGMA_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Which axes a velocity is told along.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Axes {
    /// The vehicle's: forward, left, up.
    Vehicle,
    /// East, north, up.
    World,
}

/// A velocity over ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Velocity {
    /// When it was true, on the clock of the attitudes.
    pub(crate) time: Timestamp,
    pub(crate) axes: Axes,
    /// Metres a second.
    pub(crate) mps: DVec3,
}

/// A pose that was reckoned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reckoned {
    /// That of its attitude.
    pub(crate) time: Timestamp,
    pub(crate) world_from_vehicle: Pose,
    /// Against where its epoch began.
    pub(crate) covariance: PoseCovariance,
    /// Counts gaps that were too long.
    pub(crate) epoch: u32,
}

/// Integrates.
#[derive(Debug)]
pub(crate) struct Reckoner {
    /// How long poses wait for the next velocity before the last one is carried on, seconds.
    patience_s: f64,
    turns: Turns,
    /// Attitudes that no pose was made of yet, in order of time.
    waiting: VecDeque<(Timestamp, DQuat)>,
    /// That wait for attitudes around them, in order of time.
    velocities: VecDeque<Velocity>,
    /// In the world, and not reached yet: behind a gap some wait for more.
    turned: VecDeque<Known>,
    /// Up to the node.
    recent: Recent,
    depths: Depths,
    /// Where the newest velocity was turned into the world.
    node: Option<Node>,
    epoch: u32,
    /// That were not taken yet; the oldest go first.
    made: VecDeque<Reckoned>,
}

impl Reckoner {
    pub(crate) fn new(patience_s: f64) -> Self {
        Self {
            patience_s,
            turns: Turns::default(),
            waiting: VecDeque::new(),
            velocities: VecDeque::new(),
            turned: VecDeque::new(),
            recent: Recent::default(),
            depths: Depths::default(),
            node: None,
            epoch: 0,
            made: VecDeque::new(),
        }
    }

    /// The world begins anew with the next velocity.
    pub(crate) fn restart(&mut self) {
        *self = Self {
            epoch: self.epoch,
            ..Self::new(self.patience_s)
        };
    }

    /// Takes a unit quaternion that turns forward-left-up to east-north-up. One no newer than those before is left out.
    pub(crate) fn attitude(&mut self, time: Timestamp, world_from_vehicle: DQuat) {
        if self.turns.push(time, world_from_vehicle) {
            self.waiting.push_back((time, world_from_vehicle));
            self.go_on();
        }
    }

    /// Takes a velocity. One no newer than those before, or far ahead of the attitudes, is left out.
    ///
    /// # Errors
    /// If it is not finite, or faster than any vehicle.
    pub(crate) fn velocity(&mut self, what: &str, velocity: Velocity) -> Result<(), Fault> {
        let mps = fault::vector(what, velocity.mps)?.length();
        if mps > FASTEST_MPS {
            return Err(Fault::Malformed(format!(
                "{what} tells a speed of {mps:.1} m/s; no vehicle that maps moves faster than {FASTEST_MPS} m/s over ground"
            )));
        }
        let newest = self.velocities.back().map(|before| before.time);
        let newest = newest.or(self.turned.back().map(|before| before.time));
        let newest = newest.or(self.node.map(|node| node.time));
        let is_new = newest.is_none_or(|newest| velocity.time > newest);
        let ahead_s = self
            .turns
            .newest()
            .map(|at| velocity.time.seconds_since(at));
        if is_new && ahead_s.is_some_and(|ahead_s| ahead_s <= AHEAD_S) {
            if self.velocities.len() == VELOCITY_COUNT {
                self.velocities.pop_front();
            }
            self.velocities.push_back(velocity);
            self.go_on();
        }
        Ok(())
    }

    /// Takes a height above the surface, metres, negative below. One no newer than those before is left out.
    ///
    /// # Errors
    /// If it is not finite, or of no sea.
    pub(crate) fn height(&mut self, what: &str, time: Timestamp, z_m: f64) -> Result<(), Fault> {
        if !z_m.is_finite() {
            return Err(Fault::NotFinite(what.to_owned()));
        }
        if z_m.abs() > DEEPEST_M {
            return Err(Fault::Malformed(format!(
                "{what} tells {z_m:.0} m, which is in no sea"
            )));
        }
        let ahead_s = self.turns.newest().map(|at| time.seconds_since(at));
        if ahead_s.is_some_and(|ahead_s| ahead_s <= AHEAD_S) {
            self.depths.push(time, z_m);
        }
        Ok(())
    }

    /// The poses made since this was asked last, in order of time.
    pub(crate) fn take(&mut self) -> impl Iterator<Item = Reckoned> {
        self.made.drain(..)
    }

    fn go_on(&mut self) {
        while let Some(velocity) = self.velocities.front() {
            let mps = match (velocity.axes, self.turns.at(velocity.time)) {
                (_, Turn::NotYet) => break,
                (Axes::World, _) => Some(velocity.mps),
                (Axes::Vehicle, Turn::Is(rotation)) => Some(rotation * velocity.mps),
                (Axes::Vehicle, Turn::Never) => None,
            };
            let time = velocity.time;
            self.velocities.pop_front();
            self.turned.extend(mps.map(|mps| Known { time, mps }));
        }
        while let Some(next) = self.turned.front().copied() {
            if self.waits_behind_gap(&next) {
                break;
            }
            self.reach(next);
            self.turned.pop_front();
        }
        self.carry_on();
    }

    /// Whether more velocities are waited for, to tell how they go on behind a gap.
    fn waits_behind_gap(&self, next: &Known) -> bool {
        let (Some(node), Some(newest)) = (self.node, self.turns.newest()) else {
            return false;
        };
        let gap_s = next.time.seconds_since(node.time);
        let last = self.turned.back().map_or(next.time, |last| last.time);
        let is_known =
            last.seconds_since(next.time) >= SLOPE_S || self.turned.len() >= VELOCITY_COUNT;
        let has_patience = newest.seconds_since(node.time) <= self.patience_s;
        (GAP_S..=BRIDGED_S).contains(&gap_s) && has_patience && !is_known
    }

    /// Makes the poses up to the next velocity, the first of those turned, and goes on from there.
    fn reach(&mut self, next: Known) {
        let gap_s = |node: &Node| next.time.seconds_since(node.time);
        let Some(before) = self.node.filter(|node| gap_s(node) <= BRIDGED_S) else {
            if let Some(node) = self.node {
                self.carry(&node);
                self.epoch += 1;
            }
            return self.begin(next);
        };
        let stretch = match gap_s(&before) > GAP_S {
            true => {
                let behind = Slope::through(self.turned.iter(), next.time);
                let slopes = [self.recent.slope(), behind];
                self.recent.clear();
                Stretch::across(&before, next, slopes)
            }
            false => Stretch::between(&before, next),
        };
        while let Some(&(at, rotation)) = self.waiting.front().filter(|(at, _)| *at <= next.time) {
            self.waiting.pop_front();
            self.make(&stretch, at, rotation);
        }
        let mut node = self.levelled(&stretch, next.time);
        // Behind a gap the stretch ends at a smoothed velocity.
        node.mps = next.mps;
        self.node = Some(node);
        self.recent.push(next);
    }

    fn begin(&mut self, first: Known) {
        self.depths.begin();
        let mut node = Node::first(first);
        node.place_m.z = self.depths.at(first.time, 0.0, 0.0).unwrap_or(0.0);
        self.waiting.retain(|(at, _)| *at >= first.time);
        self.node = Some(node);
        self.recent.clear();
        self.recent.push(first);
    }

    /// Makes poses with the last velocity where the next has been waited for long enough.
    fn carry_on(&mut self) {
        let Some(newest) = self.turns.newest() else {
            return;
        };
        let Some(node) = self.node else {
            // Until the first velocity: those before it go with none.
            let is_old = |at: Timestamp| newest.seconds_since(at) > self.patience_s;
            while self.waiting.front().is_some_and(|(at, _)| is_old(*at)) {
                self.waiting.pop_front();
            }
            return;
        };
        if newest.seconds_since(node.time) <= self.patience_s {
            return;
        }
        self.carry(&node);
        self.waiting.clear();
    }

    /// Makes the poses that the velocity is carried on for.
    fn carry(&mut self, node: &Node) {
        let stretch = Stretch::carried(node);
        let until = node.time.offset_by(BRIDGED_S);
        while let Some(&(at, rotation)) = self.waiting.front().filter(|(at, _)| *at <= until) {
            self.waiting.pop_front();
            if at >= node.time {
                self.make(&stretch, at, rotation);
            }
        }
    }

    /// A point of a stretch, its height by the depth sensor where that tells one.
    fn levelled(&mut self, stretch: &Stretch, at: Timestamp) -> Node {
        let mut node = stretch.at(at);
        let z_m = self.depths.at(at, node.mps.z, node.place_m.z);
        node.has_depth = z_m.is_some();
        node.place_m.z = z_m.unwrap_or(node.place_m.z);
        node
    }

    fn make(&mut self, stretch: &Stretch, at: Timestamp, rotation: DQuat) {
        let node = self.levelled(stretch, at);
        let [level_m2, up_m2] = node.variances_m2();
        if self.made.len() == MADE_COUNT {
            self.made.pop_front();
        }
        self.made.push_back(Reckoned {
            time: at,
            world_from_vehicle: Pose {
                rotation,
                translation_m: node.place_m,
            },
            covariance: PoseCovariance {
                position_m2: [level_m2, 0.0, 0.0, level_m2, 0.0, up_m2],
                attitude_rad2: [ATTITUDE_SIGMA_RAD.powi(2); 3],
            },
            epoch: self.epoch,
        });
    }
}

#[cfg(test)]
mod tests;
