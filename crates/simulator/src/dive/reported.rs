//! The poses a navigation system would report of a dive, with its errors.

use echosplat_model::{Pose, StampedPose, Timestamp};
use glam::{DQuat, DVec2, DVec3};

use super::{BEAMS_PER_VIEW, Dive, Motion, listening_s};
use crate::random::{Purpose, Random};
use crate::sonar::PoseNoise;

const POSES_PER_S: f64 = 50.0;
const LEAD_S: f64 = 0.1;
const TAIL_S: f64 = 1.0;
const DRIFT_TIME_CONSTANT_S: f64 = 60.0;
/// The time after which a random walk has the size by which it is named.
const WALK_TIME_S: f64 = 100.0;
/// Where in the dive the outage begins.
const OUTAGE_AT: f64 = 0.45;

pub(super) fn poses(dive: &Dive, seed: u64) -> Vec<StampedPose> {
    let noise = dive.noise.pose_noise();
    let mut errors = Errors::new(noise, seed);
    let mut poses = match &dive.motion {
        Motion::Moving(_) => moving(dive, &mut errors),
        Motion::Still(_) => still(dive, &mut errors),
    };
    let outage_s = dive.duration_s() * OUTAGE_AT;
    let is_out = |time_s: f64| time_s > outage_s && time_s < outage_s + noise.outage_s;
    poses.retain(|pose| !is_out(pose.time.as_secs_f64()));
    poses
}

fn moving(dive: &Dive, errors: &mut Errors) -> Vec<StampedPose> {
    let count = ((LEAD_S + dive.duration_s() + TAIL_S) * POSES_PER_S).ceil() as u32;
    let pose = |index: u32| {
        let time_s = f64::from(index) / POSES_PER_S - LEAD_S;
        errors.advance(1.0 / POSES_PER_S);
        errors.reported(time_s, &vehicle_at(dive, time_s))
    };
    (0..count).map(pose).collect()
}

/// What a vehicle without noise would report at a time, seconds.
fn vehicle_at(dive: &Dive, time_s: f64) -> Pose {
    let navigation = dive.disturbances.navigation;
    let sensor = dive.pose_during(navigation.held_at_s(time_s), 0.0);
    navigation.world_from_vehicle(&sensor)
}

/// One error per view: its image was taken from one place.
fn still(dive: &Dive, errors: &mut Errors) -> Vec<StampedPose> {
    // The range may grow on the way; the pose is kept until the longest listening ends.
    let listening_s = super::RANGE_CHANGE_RATIO * listening_s(&dive.settings);
    let kept_s = 0.5 * (listening_s + dive.ping_interval_s());
    let mut poses = Vec::with_capacity(2 * dive.pings());
    for index in 0..dive.pings() {
        if index % BEAMS_PER_VIEW == 0 {
            errors.advance(BEAMS_PER_VIEW as f64 * dive.ping_interval_s());
        }
        let time_s = dive.transmit_s(index);
        let truth = vehicle_at(dive, time_s);
        poses.push(errors.reported(time_s, &truth));
        poses.push(errors.reported(time_s + kept_s, &truth));
    }
    poses
}

/// Errors of position (world axes) and of attitude (a rotation vector, sensor's axes).
struct Errors {
    noise: PoseNoise,
    random: Random,
    drift_m: DVec3,
    drift_rad: DVec3,
    offset_m: DVec3,
    turn: DQuat,
    walk: Option<Walk>,
}

impl Errors {
    fn new(noise: PoseNoise, seed: u64) -> Self {
        let mut random = Random::new(seed, Purpose::PoseNoise, 0);
        Self {
            noise,
            // Started from its own spread: the drift is as large at the start as ever.
            drift_m: random.normal3() * noise.drift_m,
            drift_rad: random.normal3() * noise.drift_rad,
            random,
            offset_m: DVec3::ZERO,
            turn: DQuat::IDENTITY,
            walk: Walk::of(noise, seed),
        }
    }

    /// A first-order Gauss–Markov step, exact for any length, and fresh white noise.
    fn advance(&mut self, step_s: f64) {
        let keep = (-step_s / DRIFT_TIME_CONSTANT_S).exp();
        let fresh = (1.0 - keep * keep).sqrt();
        let PoseNoise {
            white_m,
            white_rad,
            drift_m,
            drift_rad,
            ..
        } = self.noise;
        self.drift_m = self.drift_m * keep + self.random.normal3() * (fresh * drift_m);
        self.drift_rad = self.drift_rad * keep + self.random.normal3() * (fresh * drift_rad);
        self.offset_m = self.drift_m + self.random.normal3() * white_m;
        let turn_rad = self.drift_rad + self.random.normal3() * white_rad;
        self.turn = DQuat::from_scaled_axis(turn_rad);
        if let Some(walk) = &mut self.walk {
            walk.advance(step_s);
        }
    }

    fn reported(&self, time_s: f64, truth: &Pose) -> StampedPose {
        let read = Pose {
            rotation: (truth.rotation * self.turn).normalize(),
            translation_m: truth.translation_m + self.offset_m,
        };
        StampedPose {
            time: Timestamp::from_secs_f64(time_s),
            world_from_vehicle: match &self.walk {
                Some(walk) => walk.away(&read),
                None => read,
            },
            uncertainty: None,
            epoch: 0,
        }
    }
}

/// What dead reckoning loses: the sum of all its errors so far, which nothing takes back.
struct Walk {
    /// Of one axis and of the heading, after one second.
    step_m: f64,
    step_rad: f64,
    random: Random,
    offset_m: DVec2,
    heading_rad: f64,
}

impl Walk {
    fn of(noise: PoseNoise, seed: u64) -> Option<Self> {
        let walks = noise.walk_m > 0.0 || noise.walk_rad > 0.0;
        walks.then(|| Self {
            step_m: noise.walk_m / WALK_TIME_S.sqrt(),
            step_rad: noise.walk_rad / WALK_TIME_S.sqrt(),
            random: Random::new(seed, Purpose::PoseWalk, 0),
            offset_m: DVec2::ZERO,
            heading_rad: 0.0,
        })
    }

    fn advance(&mut self, step_s: f64) {
        let draw = self.random.normal3() * step_s.sqrt();
        self.offset_m += draw.truncate() * self.step_m;
        self.heading_rad += draw.z * self.step_rad;
    }

    fn away(&self, pose: &Pose) -> Pose {
        Pose {
            rotation: (DQuat::from_rotation_z(self.heading_rad) * pose.rotation).normalize(),
            translation_m: pose.translation_m + self.offset_m.extend(0.0),
        }
    }
}
