//! A run of poses of one vehicle on one clock, and what does not continue it.

use std::collections::VecDeque;

use echosplat_model::Timestamp;

use crate::{ArrivedPose, StampClock};

/// Seconds, assumed: no link varies so.
/// A stamp further ahead than what has passed since the one before, or further back, seconds, is of
/// another clock: no link delays poses of one vehicle so differently.
const FAR_S: f64 = 2.0;
/// Seconds, assumed: delays only take from the lead.
/// A stamp that leads its arrival by so much more than those before it, seconds, is not explained by a link: delays only
/// ever take from the lead. Where arrival says nothing, one that is further ahead than this and than so many usual intervals.
pub(super) const EARLY_S: f64 = 0.1;
/// Usual intervals; found.
const EARLY_INTERVALS: f64 = 10.0;
/// Metres a second, physics of vehicles.
/// No vehicle that maps moves faster, metres a second.
const FASTEST_MPS: f64 = 5.0;
/// Radians a second, physics of vehicles.
/// Nor turns faster, radians a second.
const FASTEST_RADPS: f64 = std::f64::consts::PI;
/// Metres corrected without a reset; assumed.
/// What an estimator may correct at once without having been reset, metres and radians.
const CORRECTION_M: f64 = 0.5;
/// Radians, the same; assumed.
const CORRECTION_RAD: f64 = 0.5;
/// Usual steps; found.
/// Steps are judged by so many times the usual one, so that a noisy source is not taken for two.
const NOISE_STEPS: f64 = 8.0;
/// Weight of the newest step; found.
const NEWEST_WEIGHT: f64 = 0.05;
/// Seconds; found.
/// Leads of stamps over arrival are remembered for so long, seconds, and at least so many.
const LEADS_S: f64 = 0.5;
/// Leads remembered at least; found.
const LEAST_LEADS: usize = 5;
/// Seconds, derived: delays say no more.
/// Shifts are found to this, seconds: what delays of single poses say beyond it means nothing.
const SHIFT_STEP_S: f64 = 1e-3;
/// Seconds; assumed.
/// A stamp that leads or lags its arrival by no more than this is on the host's clock, seconds.
const ON_HOST_CLOCK_S: f64 = 2.0;
/// Poses held; bounds memory.
/// Poses held of a track that is not believed yet.
const MOST_HELD: usize = 64;

/// Why a pose does not continue a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Break {
    /// As old as the newest, or a little older.
    Order,
    /// A little further ahead than a link explains.
    Early,
    /// Of another epoch of its source.
    Epoch,
    /// Stamped later than time has passed.
    Ahead,
    /// Stamped long before the newest.
    Behind,
    /// Farther away than any vehicle gets.
    Jump {
        /// How far.
        metres: f64,
    },
}

impl Break {
    /// In words, as the reason of a new epoch; `shift_s` is what stamps are moved by from now on.
    pub(super) fn reason(self, shift_s: f64) -> String {
        match self {
            Self::Jump { metres } => {
                format!("poses jumped by {metres:.1} m, farther than the vehicle moves")
            }
            Self::Epoch => "the estimator was reset".to_owned(),
            _ if shift_s == 0.0 => "the clock of the poses stepped".to_owned(),
            _ => format!(
                "the clock of the poses stepped by {:.3} s, which is undone",
                -shift_s
            ),
        }
    }
}

/// The newest of the poses taken, and how they usually come.
#[derive(Debug)]
pub(super) struct Track {
    newest: ArrivedPose,
    /// Poses so far.
    count: usize,
    interval_s: f64,
    step_m: f64,
    step_rad: f64,
    /// For how long poses have been the same to the last bit, seconds.
    still_s: f64,
    /// When the newest poses arrived, and stamp minus arrival, seconds.
    leads: VecDeque<(Timestamp, f64)>,
}

impl Track {
    pub(super) fn new(first: &ArrivedPose) -> Self {
        let mut track = Self {
            newest: *first,
            count: 1,
            interval_s: 0.0,
            step_m: 0.0,
            step_rad: 0.0,
            still_s: 0.0,
            leads: VecDeque::new(),
        };
        track.remember_lead(first);
        track
    }

    pub(super) fn newest(&self) -> &ArrivedPose {
        &self.newest
    }

    /// Poses so far.
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// Usual time from pose to pose, seconds.
    pub(super) fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// For how long poses have been the same to the last bit, seconds.
    pub(super) fn still_s(&self) -> f64 {
        self.still_s
    }

    /// How far stamps lead their arrival, seconds, at the least delay of late.
    pub(super) fn lead_s(&self) -> f64 {
        let leads = self.leads.iter().map(|&(_, lead_s)| lead_s);
        leads.fold(f64::NEG_INFINITY, f64::max)
    }

    /// `None` if the pose goes on from the newest.
    pub(super) fn break_of(&self, next: &ArrivedPose, clock: StampClock) -> Option<Break> {
        let advance_s = next.pose.time.seconds_since(self.newest.pose.time);
        let passed_s = next.arrived.seconds_since(self.newest.arrived);
        if next.pose.epoch != self.newest.pose.epoch {
            return Some(Break::Epoch);
        }
        if clock == StampClock::Host && advance_s > passed_s.max(0.0) + FAR_S {
            return Some(Break::Ahead);
        }
        if !(advance_s > -FAR_S) {
            return Some(Break::Behind);
        }
        let (metres, radians) = between(&self.newest, next);
        // An estimator that stood still may catch up on what it missed.
        let moved_s = advance_s.abs() + self.still_s;
        let is_near = metres <= CORRECTION_M + FASTEST_MPS * moved_s + NOISE_STEPS * self.step_m
            && radians <= CORRECTION_RAD + FASTEST_RADPS * moved_s + NOISE_STEPS * self.step_rad;
        match (is_near, advance_s > 0.0) {
            (true, true) => self
                .is_early(next, advance_s, clock)
                .then_some(Break::Early),
            (true, false) => Some(Break::Order),
            (false, _) => Some(Break::Jump { metres }),
        }
    }

    fn is_early(&self, next: &ArrivedPose, advance_s: f64, clock: StampClock) -> bool {
        match clock {
            StampClock::Host => lead_s(next) > self.lead_s() + EARLY_S,
            StampClock::Data => {
                let usual_s = EARLY_INTERVALS * self.interval_s;
                self.interval_s > 0.0 && advance_s > usual_s.max(EARLY_S)
            }
        }
    }

    pub(super) fn extend(&mut self, next: &ArrivedPose) {
        let (metres, radians) = between(&self.newest, next);
        let interval_s = next.pose.time.seconds_since(self.newest.pose.time);
        let is_same = self.newest.pose.world_from_vehicle == next.pose.world_from_vehicle;
        self.still_s = if is_same {
            self.still_s + interval_s
        } else {
            0.0
        };
        match self.interval_s > 0.0 {
            true => approach(&mut self.interval_s, interval_s.min(1.0)),
            false => self.interval_s = interval_s.min(1.0),
        }
        approach(&mut self.step_m, metres);
        approach(&mut self.step_rad, radians);
        self.newest = *next;
        self.count += 1;
        self.remember_lead(next);
    }

    fn remember_lead(&mut self, pose: &ArrivedPose) {
        self.leads.push_back((pose.arrived, lead_s(pose)));
        let is_old = |&(at, _): &(Timestamp, f64)| pose.arrived.seconds_since(at) > LEADS_S;
        while self.leads.len() > LEAST_LEADS && self.leads.front().is_some_and(is_old) {
            self.leads.pop_front();
        }
    }

    /// What lays the stamps of a clock that stepped onto the time that the old ones were on: the
    /// least delay of both is taken to be the same. 0 if the new stamps are on the host's clock.
    pub(super) fn shift_for(&self, poses: &[ArrivedPose]) -> f64 {
        let new_s = poses.iter().map(lead_s).fold(f64::NEG_INFINITY, f64::max);
        let old_s = self.lead_s();
        let is_on_host_clock = new_s.abs() <= ON_HOST_CLOCK_S;
        match is_on_host_clock {
            true => 0.0,
            false => ((old_s - new_s) / SHIFT_STEP_S).round() * SHIFT_STEP_S,
        }
    }
}

/// Whether a pose continues a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum GoesOn {
    Yes,
    /// It is of the run, and stamped no later than what came before.
    AsBefore,
    No,
}

/// A run that does not continue the track; the track itself, if it stays silent.
#[derive(Debug)]
pub(super) struct Rival {
    found: Break,
    track: Track,
    /// The newest of its poses.
    poses: VecDeque<ArrivedPose>,
}

impl Rival {
    pub(super) fn new(first: ArrivedPose, found: Break) -> Self {
        Self {
            found,
            track: Track::new(&first),
            poses: VecDeque::from([first]),
        }
    }

    /// Takes the pose if it goes on from the newest held.
    pub(super) fn go_on(&mut self, next: &ArrivedPose, clock: StampClock) -> GoesOn {
        match self.track.break_of(next, clock) {
            None => {
                self.track.extend(next);
                if self.poses.len() >= MOST_HELD {
                    self.poses.pop_front();
                }
                self.poses.push_back(*next);
                GoesOn::Yes
            }
            Some(Break::Order) => GoesOn::AsBefore,
            Some(_) => GoesOn::No,
        }
    }

    pub(super) fn newest(&self) -> &ArrivedPose {
        self.track.newest()
    }

    pub(super) fn found(&self) -> Break {
        self.found
    }

    pub(super) fn len(&self) -> usize {
        self.track.len()
    }

    /// From the first held to the newest, seconds.
    pub(super) fn span_s(&self, clock: StampClock) -> f64 {
        let (Some(first), Some(last)) = (self.poses.front(), self.poses.back()) else {
            return 0.0;
        };
        match clock {
            StampClock::Host => last.arrived.seconds_since(first.arrived),
            StampClock::Data => last.pose.time.seconds_since(first.pose.time),
        }
    }

    pub(super) fn into_poses(self) -> Vec<ArrivedPose> {
        self.poses.into()
    }
}

/// Distance and angle.
pub(super) fn between(a: &ArrivedPose, b: &ArrivedPose) -> (f64, f64) {
    let (a, b) = (&a.pose.world_from_vehicle, &b.pose.world_from_vehicle);
    let metres = a.translation_m.distance(b.translation_m);
    let dot = a.rotation.dot(b.rotation).abs().min(1.0);
    (metres, 2.0 * dot.acos())
}

/// How far the stamp leads the arrival, seconds.
pub(super) fn lead_s(pose: &ArrivedPose) -> f64 {
    pose.pose.time.seconds_since(pose.arrived)
}

fn approach(usual: &mut f64, newest: f64) {
    *usual += NEWEST_WEIGHT * (newest - *usual);
}
