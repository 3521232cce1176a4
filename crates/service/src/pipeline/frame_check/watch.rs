//! What is looked at, when, and what is believed of it.

use std::collections::VecDeque;

use echosplat_model::Timestamp;
use echosplat_model::glam::DQuat;
use echosplat_prediction::frame_check::{FrameReading, FrameVerdict, VehiclePing};

use super::Arrived;
use crate::thinned::Thinned;

/// Standard errors at which one check is believed by itself.
const CERTAIN_ERRORS: f64 = 6.0;
/// What is looked at, of the newest pings.
const WINDOW_S: f64 = 30.0;
/// Pings closer together than this are not looked at; bounds the window.
const LEAST_BETWEEN_S: f64 = WINDOW_S / 1024.0;
/// Most pings of the whole dive that are kept.
const DIVE_PINGS: usize = 1024;
/// Between two checks, on the pings' clock.
const CHECK_EVERY_S: f64 = 15.0;
/// The same once nothing was found wrong twice.
const SETTLED_EVERY_S: f64 = 60.0;
/// And never before the vehicle has turned so far since, degrees.
const TURN_DEG: f64 = 45.0;

/// The pings of the last stretch, when to look at them, and what was found so far.
pub(super) struct Watch {
    epoch: u32,
    window: VecDeque<VehiclePing>,
    /// Of all since it began anew, for what a window does not tell.
    dive: Thinned<VehiclePing>,
    /// On the pings' clock.
    last_check: Option<Timestamp>,
    turn: Turn,
    /// How poses are read.
    pub(super) frames: Belief,
    /// How the sonar is tilted.
    pub(super) tilt: Belief,
}

/// What checks running found.
#[derive(Default)]
pub(super) struct Belief {
    /// By the last check that said anything.
    last: Option<FrameVerdict>,
    pub(super) confirmed: Option<FrameVerdict>,
    /// The last two checks found nothing wrong.
    is_settled: bool,
}

impl Belief {
    /// Two checks running that ask for the same are believed, and one beyond doubt; one that says
    /// nothing changes nothing.
    pub(super) fn take(&mut self, verdict: Option<FrameVerdict>) {
        let Some(verdict) = verdict else {
            return;
        };
        let last = self.last.replace(verdict);
        let asks = |verdict: &FrameVerdict| verdict.is_telling.then(|| verdict.best.sentence());
        let is_right = |verdict: &FrameVerdict| {
            verdict.best == FrameReading::AsGiven && verdict.gain_nats_per_bin_as_given > 0.0
        };
        let both_right = is_right(&verdict) && last.as_ref().is_some_and(is_right);
        self.is_settled = both_right;
        let is_repeated = last.as_ref().and_then(asks) == asks(&verdict);
        if both_right {
            self.confirmed = None;
        } else if verdict.is_telling && (is_repeated || is_certain(&verdict)) {
            self.confirmed = Some(verdict);
        }
    }
}

impl Default for Watch {
    fn default() -> Self {
        Self {
            epoch: 0,
            window: VecDeque::new(),
            dive: Thinned::new(DIVE_PINGS),
            last_check: None,
            turn: Turn::default(),
            frames: Belief::default(),
            tilt: Belief::default(),
        }
    }
}

impl Watch {
    /// A ping that is far from the last in time, or of a new epoch, begins anew.
    pub(super) fn take(&mut self, arrived: Arrived) {
        let time = arrived.ping.ping.transmit_time();
        let since_last = |last: &VehiclePing| time.seconds_since(last.ping.transmit_time());
        let since_s = self.window.back().map_or(WINDOW_S, since_last);
        let is_near = (0.0..WINDOW_S).contains(&since_s) || self.window.is_empty();
        if !is_near || arrived.epoch != self.epoch {
            *self = Self {
                epoch: arrived.epoch,
                ..Self::default()
            };
        } else if since_s < LEAST_BETWEEN_S {
            return;
        }
        self.turn.take(arrived.ping.world_from_vehicle.rotation);
        self.dive.push(|| arrived.ping.clone());
        self.window.push_back(arrived.ping);
        let is_old = |ping: &VehiclePing| time.seconds_since(ping.ping.transmit_time()) > WINDOW_S;
        while self.window.front().is_some_and(is_old) {
            self.window.pop_front();
        }
    }

    pub(super) fn is_due(&self) -> bool {
        let every_s = match self.frames.is_settled {
            true => SETTLED_EVERY_S,
            false => CHECK_EVERY_S,
        };
        // The first one comes a while after the first ping.
        let from = self.last_check.or_else(|| self.first_time());
        let waited_s = self
            .newest_time()
            .zip(from)
            .map(|(now, from)| now.seconds_since(from));
        waited_s.is_some_and(|waited_s| waited_s >= every_s) && self.has_turned()
    }

    /// Whether what came since the last check is enough for one more.
    pub(super) fn has_turned(&self) -> bool {
        self.turn.deg() >= TURN_DEG
    }

    fn first_time(&self) -> Option<Timestamp> {
        self.window.front().map(|ping| ping.ping.transmit_time())
    }

    fn newest_time(&self) -> Option<Timestamp> {
        self.window.back().map(|ping| ping.ping.transmit_time())
    }

    pub(super) fn window(&mut self) -> &[VehiclePing] {
        self.window.make_contiguous()
    }

    pub(super) fn dive(&self) -> &[VehiclePing] {
        self.dive.kept()
    }

    /// A check was made of what came up to now.
    pub(super) fn checked(&mut self) {
        self.last_check = self.newest_time();
        self.turn = Turn::default();
    }
}

fn is_certain(verdict: &FrameVerdict) -> bool {
    let beyond = verdict.gain_best - verdict.gain_nats_per_bin_as_given;
    beyond > CERTAIN_ERRORS * verdict.error_nats_per_bin
}

/// How far the vehicle has turned to and fro: nearly the widest angle between two attitudes.
#[derive(Debug, Default)]
struct Turn {
    /// The first attitude, the one furthest from it, and how far that is, radians.
    first_and_far: Option<(DQuat, DQuat, f64)>,
    widest_rad: f64,
}

impl Turn {
    fn take(&mut self, attitude: DQuat) {
        let start = (attitude, attitude, 0.0);
        let (first, far, far_rad) = self.first_and_far.get_or_insert(start);
        let from_first_rad = first.angle_between(attitude);
        let from_far_rad = far.angle_between(attitude);
        self.widest_rad = self.widest_rad.max(from_first_rad).max(from_far_rad);
        if from_first_rad > *far_rad {
            (*far, *far_rad) = (attitude, from_first_rad);
        }
    }

    fn deg(&self) -> f64 {
        self.widest_rad.to_degrees()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    use echosplat_model::{Ping, PingSettings, Pose};

    fn arrived(time_s: f64, yaw_deg: f64) -> Arrived {
        let settings = PingSettings {
            range_start_m: 0.0,
            range_length_m: 10.0,
            bin_count: 10,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 0.0,
            pulse_duration_s: 0.0,
            gain_index: 0,
        };
        let time = Timestamp::from_secs_f64(time_s);
        let ping = Ping::new(0, time, settings, vec![0.0; 10]).unwrap();
        Arrived {
            epoch: 0,
            ping: VehiclePing {
                ping: Arc::new(ping),
                world_from_vehicle: Pose {
                    rotation: DQuat::from_rotation_z(yaw_deg.to_radians()),
                    ..Pose::IDENTITY
                },
            },
        }
    }

    fn found(best: FrameReading) -> Option<FrameVerdict> {
        Some(FrameVerdict {
            best,
            gain_nats_per_bin_as_given: 0.01,
            gain_best: 0.05,
            error_nats_per_bin: 0.01,
            pings: 500,
            turned_deg: 90.0,
            is_telling: best != FrameReading::AsGiven,
        })
    }

    fn watched(duration_s: f64, yaw_deg: impl Fn(f64) -> f64) -> Watch {
        let mut watch = Watch::default();
        for index in 0..(duration_s * 40.0) as u32 {
            let time_s = f64::from(index) / 40.0;
            watch.take(arrived(time_s, yaw_deg(time_s)));
        }
        watch
    }

    /// 30° to both sides within 9 s.
    fn sweep(time_s: f64) -> f64 {
        30.0 * (time_s * std::f64::consts::TAU / 9.0).sin()
    }

    #[test]
    fn a_check_is_due_after_a_while_and_a_turn_to_and_fro() {
        assert!(!watched(14.0, sweep).is_due());
        assert!(watched(16.0, sweep).is_due());
        assert!(!watched(60.0, |_| 10.0).is_due());
        let mut watch = watched(16.0, sweep);
        watch.checked();
        assert!(!watch.is_due());
    }

    #[test]
    fn the_window_is_bounded_in_time_and_number() {
        let mut watch = Watch::default();
        for index in 0..40_000 {
            watch.take(arrived(f64::from(index) / 1000.0, 0.0));
        }
        assert!(watch.window().len() <= 1025);
        let oldest = watch.window()[0].ping.transmit_time().as_secs_f64();
        assert!((9.9..10.1).contains(&oldest), "{oldest}");
    }

    #[test]
    fn a_step_of_the_clock_or_a_new_epoch_begins_anew() {
        let mut watch = watched(10.0, sweep);
        watch.take(arrived(5.0, 0.0));
        assert_eq!(watch.window().len(), 1);
        watch.frames.confirmed = found(FrameReading::NedFrd);
        watch.take(Arrived {
            epoch: 1,
            ..arrived(5.1, 0.0)
        });
        assert_eq!((watch.window().len(), watch.frames.confirmed), (1, None));
    }

    #[test]
    fn two_checks_running_confirm_and_two_that_find_nothing_withdraw() {
        let mut belief = Belief::default();
        belief.take(found(FrameReading::NedPosition));
        assert_eq!(belief.confirmed, None);
        belief.take(found(FrameReading::MountYaw(90)));
        assert_eq!(belief.confirmed, None, "another reason is none");
        belief.take(None);
        belief.take(found(FrameReading::MountYaw(90)));
        assert_eq!(belief.confirmed, found(FrameReading::MountYaw(90)));
        belief.take(found(FrameReading::AsGiven));
        assert!(belief.confirmed.is_some() && !belief.is_settled);
        belief.take(found(FrameReading::AsGiven));
        assert!(belief.confirmed.is_none() && belief.is_settled);
    }

    #[test]
    fn one_check_beyond_doubt_is_believed() {
        let mut belief = Belief::default();
        let sure = found(FrameReading::QuaternionWFirst).map(|verdict| FrameVerdict {
            error_nats_per_bin: 0.005,
            ..verdict
        });
        belief.take(sure);
        assert_eq!(belief.confirmed, sure);
    }
}
