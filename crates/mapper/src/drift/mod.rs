//! How poses drift against the map, and what is added to them.
//!
//! A filter follows every dive. Poses are corrected from the moment on at which they are further off than a map draws them that
//! has not seen all aspects, and corrected ones foretell pings so much better that it is no chance; those remembered are then
//! taken in again, each corrected by the map of those before it. When the data ends, all are smoothed by the map of the whole
//! dive.
//!
//! Cost: of every fourth ping three visits in full detail, with eight convolutions each, and two in brief; of every second once
//! poses are corrected. At the end of a dive whose poses were, three visits to every second ping.

mod corrections;
mod filter;

use std::sync::Arc;

use echosplat_measurement::PingGeometry;
use echosplat_measurement::heard::PoseScore;
use echosplat_model::glam::{DQuat, DVec2, DVec3, Mat3, Vec3};
use echosplat_model::{Pose, PosedPing, Switch, Timestamp};
use serde::Serialize;

use crate::accumulate::fan::Fan;
use crate::accumulate::history::{FAN_SIGMAS, Keyframe};
use crate::progress::Progress;
use crate::refine::field::Field;
use crate::refine::terms::PassTerms;
use crate::refine::visibility::Sight;
use corrections::Track;
pub use corrections::{CorrectedPose, PoseCorrections, PoseSigma};
pub(crate) use filter::Correction;
use filter::{Against, Filter, Found, Known, Transition, Trial, smoothed};

/// Pings, found: fewer know nothing across the beam.
/// Pings of a slice.
const SLICE: usize = 32;
/// Pings; bounds work.
/// One ping in so many is asked once poses are corrected: those beside it would say nearly the same.
const EVERY: usize = 2;
/// Pings; bounds work.
/// The same before.
const EVERY_BEFORE: usize = 4;
/// Slices; found.
/// Gains are remembered for so many slices.
const REMEMBERED: f64 = 50.0;
/// Standard errors; assumed.
/// Gains of so many standard errors are no chance.
const NO_CHANCE: f64 = 3.0;
/// Fraction, measured: 0.38 without drift, 0.5 with.
/// Poses as they come are refuted where they lack this fraction of what corrected ones explain. Aspects that the map has not
/// seen, and poses that are a little off, leave a third of it.
const LEAST_GAIN: f64 = 0.45;
/// Fraction, measured: 0.1 at most in nominal noise.
/// From this fraction on it is told that poses may drift, although nothing is done about it.
const SUSPECT_GAIN: f64 = 0.2;
/// Metres, measured: twice what unseen aspects draw by.
/// Poses that are not corrected are believed to be off from this level distance on.
const LEAST_SHIFT_M: f64 = 0.15;
/// Seconds; bounds what is believed of the clock.
/// Between two slices no more time counts.
const LONGEST_S: f64 = 60.0;
/// Seconds; bounds input.
/// Slices at the same time are so much apart where a speed is told from them.
const LEAST_S: f64 = 1e-3;

/// What was found of the drift of poses.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct PoseDrift {
    /// Whether pings were foretold better with other poses than those in use, more than a map without drift has them.
    pub is_suspected: bool,
    /// Whether poses are corrected by it.
    pub is_corrected: bool,
    /// What is added to the newest position, metres, world axes; 0 where poses are not corrected.
    pub shift_m: [f64; 3],
    /// And to the newest heading, degrees, from the world's x to y.
    pub turn_deg: f64,
    /// The longest shift so far, metres.
    pub longest_shift_m: f64,
    /// One sigma of the newest shift, along the worse of two level axes, metres, and of the turn, degrees, with the error that
    /// all places of the map share.
    pub shift_sigma_m: f64,
    /// See `shift_sigma_m`.
    pub turn_sigma_deg: f64,
}

/// Follows the poses of a dive.
#[derive(Debug)]
pub(crate) struct Drift {
    switch: Switch,
    filter: Filter,
    /// Pings since the last slice.
    slice: Vec<Arc<Keyframe>>,
    /// When and where the last slice ended, by poses as they came.
    last: Option<(Timestamp, Vec3)>,
    gains: Gains,
    is_suspected: bool,
    is_corrected: bool,
    longest_shift_m: f64,
    /// What was added to poses so far.
    track: Track,
    sight: Sight,
}

/// What corrected poses gained over those in use, forgotten slowly.
#[derive(Debug, Default)]
struct Gains {
    gained: f64,
    squared: f64,
    explained: f64,
}

impl Gains {
    /// Adds the log likelihoods of a slice above that of noise, with poses corrected and as they are, nats. Poses that lead away
    /// from the map explain nothing, which is no gain however wrong it foretells.
    fn add(&mut self, corrected: f64, as_they_are: f64) {
        let [corrected, as_they_are] = [corrected, as_they_are].map(|nats| nats.max(0.0));
        let keep = 1.0 - REMEMBERED.recip();
        let gained = corrected - as_they_are;
        self.gained = keep * self.gained + gained;
        self.squared = keep * self.squared + gained * gained;
        self.explained = keep * self.explained + corrected.max(as_they_are);
    }

    /// Whether they are at least this fraction of what is explained, and no chance.
    fn are(&self, fraction: f64) -> bool {
        self.gained > NO_CHANCE * self.squared.sqrt() && self.gained > fraction * self.explained
    }
}

impl Drift {
    pub(crate) fn new(switch: Switch) -> Self {
        Self {
            switch,
            filter: Filter::of(Against::Growing),
            slice: Vec::new(),
            last: None,
            gains: Gains::default(),
            is_suspected: false,
            is_corrected: switch == Switch::On,
            longest_shift_m: 0.0,
            track: Track::default(),
            sight: Sight::default(),
        }
    }

    /// What is added to poses now.
    pub(crate) fn correction(&self) -> Correction {
        match self.is_corrected {
            true => self.filter.correction(),
            false => Correction::default(),
        }
    }

    /// A ping on the map's axes, corrected.
    pub(crate) fn correct(&self, mut posed: PosedPing) -> PosedPing {
        let Correction { shift_m, turn_rad } = self.correction();
        if self.is_corrected {
            let pose = &posed.world_from_sensor;
            posed.world_from_sensor = Pose {
                translation_m: pose.translation_m + DVec3::from_array(shift_m),
                rotation: (DQuat::from_rotation_z(turn_rad) * pose.rotation).normalize(),
            };
        }
        posed
    }

    /// Gathers a ping that the map was not told of yet; whether its slice is complete.
    pub(crate) fn gather(&mut self, keyframe: &Arc<Keyframe>) -> bool {
        if self.switch == Switch::Off {
            return false;
        }
        self.slice.push(Arc::clone(keyframe));
        self.slice.len() >= SLICE
    }

    /// Follows the slice that is complete, against the map as it is. Whether poses are corrected from now on and were not
    /// before: then all pings remembered are to be taken in again. Also how many pings it asked.
    pub(crate) fn follow(&mut self, field: &Field, terms: PassTerms) -> (bool, u64) {
        let slice = std::mem::take(&mut self.slice);
        let Some(newest) = slice.last() else {
            return (false, 0);
        };
        let (seconds, _) = self.go_on(newest);
        let every = match self.is_corrected {
            true => EVERY,
            false => EVERY_BEFORE,
        };
        let mut asked = 0;
        if !field.slots().is_empty() {
            let Self { filter, sight, .. } = self;
            if !self.is_corrected {
                // Before it is taken in.
                let [corrected, as_they_are] = [filter.correction(), newest.correction]
                    .map(|to| gain_of(&slice, every, to, (sight, terms, field)));
                self.gains.add(corrected, as_they_are);
            }
            filter.update(seconds, level_m(newest), |trial| {
                score_of(&slice, every, trial, (sight, terms, field))
            });
            asked = slice.len().div_ceil(every) as u64;
        }
        let is_far = self.filter.level_shift_m() > LEAST_SHIFT_M;
        self.is_suspected |= is_far && self.gains.are(SUSPECT_GAIN);
        let opens = !self.is_corrected && is_far && self.gains.are(LEAST_GAIN);
        self.is_corrected |= opens;
        if opens {
            // Poses before are as they came, unless they are taken in again.
            self.track.push(newest.time, Found::default());
        }
        if self.is_corrected {
            self.track.push(newest.time, self.filter.found());
        }
        if self.is_corrected && !opens {
            let shift_m = DVec3::from_array(self.filter.correction().shift_m).length();
            self.longest_shift_m = self.longest_shift_m.max(shift_m);
        }
        (opens, asked)
    }

    /// Whether poses are corrected.
    pub(crate) fn is_corrected(&self) -> bool {
        self.is_corrected
    }

    /// Begins with the first ping again, poses corrected.
    pub(crate) fn begin_again(&mut self) {
        self.filter = Filter::of(Against::Growing);
        self.slice.clear();
        self.last = None;
        self.track = Track::default();
    }

    /// Follows all pings of a dive against the map that was made of them, there and back. What it found is told by
    /// [`Self::found_at`].
    pub(crate) fn smooth(
        &mut self,
        pings: &[Arc<Keyframe>],
        field: &Field,
        terms: PassTerms,
        progress: &Progress,
    ) {
        self.begin_again();
        self.filter = Filter::of(Against::Finished);
        let (mut times, mut known) = (Vec::new(), Vec::new());
        for slice in pings.chunks(SLICE) {
            let Some(newest) = slice.last() else { continue };
            progress.tell();
            let (seconds, step) = self.go_on(newest);
            let Self { filter, sight, .. } = self;
            let before = filter.clone();
            filter.update(seconds, level_m(newest), |trial| {
                score_of(slice, EVERY, trial, (sight, terms, field))
            });
            times.push(newest.time);
            known.push(Known {
                step,
                before,
                after: filter.clone(),
            });
        }
        let found = times.into_iter().zip(smoothed(&known));
        found.for_each(|(time, found)| self.track.push(time, found));
    }

    /// What was found for this time.
    pub(crate) fn found_at(&self, time: Timestamp) -> Found {
        self.track.at(time)
    }

    /// What was added to poses so far; `world_from_map` turns it.
    pub(crate) fn corrections(&self, world_from_map: DQuat) -> PoseCorrections {
        PoseCorrections::new(self.track.clone(), world_from_map)
    }

    /// Predicts until this ping. Returns the seconds since the slice before, and what made the filter's state of that before.
    fn go_on(&mut self, newest: &Keyframe) -> (f64, Transition) {
        let added_m = DVec3::from_array(newest.correction.shift_m).as_vec3();
        let at_m = newest.geometry.pose.position_m - added_m;
        let before = self.last.replace((newest.time, at_m));
        let (time, before_m) = before.unwrap_or((newest.time, at_m));
        let seconds = newest.time.seconds_since(time).clamp(0.0, LONGEST_S);
        // Depth is measured: reckoning is off by a part of the level way.
        let way_m = at_m.truncate().distance(before_m.truncate());
        let speed_mps = f64::from(way_m) / seconds.max(LEAST_S);
        (seconds, self.filter.predict(seconds, speed_mps))
    }

    /// `world_from_map` turns what was found along the map's axes.
    pub(crate) fn told(&self, world_from_map: DQuat) -> PoseDrift {
        let Correction { shift_m, turn_rad } = self.correction();
        let Found {
            sigma_m: [x_m, y_m, _],
            turn_sigma_rad,
            ..
        } = self.filter.found();
        PoseDrift {
            is_suspected: self.is_suspected,
            is_corrected: self.is_corrected,
            shift_m: (world_from_map * DVec3::from_array(shift_m)).to_array(),
            turn_deg: turn_rad.to_degrees(),
            longest_shift_m: self.longest_shift_m,
            shift_sigma_m: x_m.max(y_m),
            turn_sigma_deg: turn_sigma_rad.to_degrees(),
        }
    }
}

/// A level place.
fn level_m(keyframe: &Keyframe) -> DVec2 {
    keyframe.geometry.pose.position_m.truncate().as_dvec2()
}

/// What some pings say of their poses, each asked standing for `every`.
fn score_of(
    slice: &[Arc<Keyframe>],
    every: usize,
    trial: Trial,
    (sight, terms, field): (&mut Sight, PassTerms, &Field),
) -> PoseScore {
    let mut sum = PoseScore::default();
    for keyframe in slice.iter().step_by(every) {
        let geometry = tried(keyframe, trial);
        sum.add(&sight.score_pose(keyframe, &geometry, trial.louder_ln, terms, field));
    }
    sum.times(every as f64)
}

/// Log likelihood of some pings with this correction above that of noise, nats.
fn gain_of(
    slice: &[Arc<Keyframe>],
    every: usize,
    correction: Correction,
    (sight, terms, field): (&mut Sight, PassTerms, &Field),
) -> f64 {
    let asked = slice.iter().step_by(every);
    let of_ping = |keyframe: &Arc<Keyframe>| {
        let geometry = tried(keyframe, Trial::sharp(correction));
        sight.gain_of_pose(keyframe, &geometry, terms, field)
    };
    asked.map(of_ping).sum()
}

/// Where a ping would have been heard from with another correction, and how blurred.
fn tried(keyframe: &Keyframe, trial: Trial) -> PingGeometry {
    let mut geometry = keyframe.corrected(trial.correction);
    let middle_m = f64::from(geometry.pose.reference_range_m.max(geometry.bin_length_m));
    let blur_rad = trial.blur_rad.hypot(trial.blur_m / middle_m);
    geometry.range_start_m += trial.nearer_m as f32;
    geometry.range_variance_m2 += trial.blur_m.powi(2) as f32;
    geometry.azimuth_variance_rad2 += blur_rad.powi(2) as f32;
    geometry
}

impl Keyframe {
    /// Its geometry with another correction than it was given.
    pub(crate) fn corrected(&self, to: Correction) -> PingGeometry {
        let given = self.correction;
        let shift: [f64; 3] = std::array::from_fn(|i| to.shift_m[i] - given.shift_m[i]);
        let turn = Mat3::from_rotation_z((to.turn_rad - given.turn_rad) as f32);
        let mut geometry = self.geometry;
        geometry.pose.position_m += DVec3::from_array(shift).as_vec3();
        geometry.pose.axes = turn * geometry.pose.axes;
        geometry
    }

    /// Gives it another correction.
    pub(crate) fn correct(&mut self, to: Correction) {
        self.geometry = self.corrected(to);
        self.correction = to;
        self.fan = Fan::of(&self.blurred_geometry(), FAN_SIGMAS);
    }
}

#[cfg(test)]
mod tests {
    use echosplat_model::{Snapshot, Standing};

    use crate::detect::posed;
    use crate::{Mapper, MapperConfig, PoseDrift};

    use super::*;

    const PINGS: u32 = 3000;

    /// Ranges at which a vehicle at a place hears three upright posts some 4 m ahead, at its own height.
    fn ranges_m(at_m: DVec3, yaw_rad: f64) -> Vec<f64> {
        let posts = [(4.0, -0.6), (4.5, 0.1), (3.7, 0.7)];
        let into = DQuat::from_rotation_z(-yaw_rad);
        let heard = posts.iter().filter_map(|&(x, y)| {
            let q = into * (DVec3::new(x, y, at_m.z) - at_m);
            (q.y.abs() < 0.03 * q.x).then(|| q.x.hypot(q.y))
        });
        heard.collect()
    }

    /// Of a vehicle that goes to and fro, up and down, and looks about; its poses are off by so much a second along y.
    fn sweeping(number: u32, drift_mps: f64) -> PosedPing {
        let time_s = 0.05 * f64::from(number);
        let at_m = DVec3::new(
            0.4 * (0.4 * time_s).sin(),
            (0.25 * time_s).sin(),
            0.6 * (0.31 * time_s).sin(),
        );
        let yaw_rad = 0.35 * (0.9 * time_s).sin();
        let ranges = ranges_m(at_m, yaw_rad);
        let power = |bin: u32| {
            let range_m = (f64::from(bin) + 0.5) * 0.02;
            let echo = |m: &f64| 60.0 * (-0.5 * ((m - range_m) / 0.025).powi(2)).exp();
            let speckle = -((f64::from((bin * 97 + number * 31) % 300) + 0.5) / 300.0).ln();
            (speckle * (1.0 + ranges.iter().map(echo).sum::<f64>())) as f32
        };
        let told = Pose {
            translation_m: at_m + DVec3::Y * drift_mps * time_s,
            rotation: DQuat::from_rotation_z(yaw_rad),
        };
        posed(number, (0..300).map(power).collect(), told)
    }

    fn mapper_of(switch: Switch) -> Mapper {
        let mut config = MapperConfig::default();
        config.parts.drift = switch;
        Mapper::new(config).unwrap()
    }

    /// How many Gaussians a map asserts, and how far they lie from the posts, metres, the mean.
    fn asserted_of(map: &Snapshot) -> (usize, f64) {
        let asserted = map.gaussians.iter();
        let asserted = asserted.filter(|gaussian| gaussian.standing == Standing::Confident);
        let off_m = |at: Vec3| {
            let posts = [(4.0, -0.6), (4.5, 0.1), (3.7, 0.7)];
            let off = posts.map(|(x, y)| (at.x - x).hypot(at.y - y));
            off.into_iter().fold(f32::INFINITY, f32::min)
        };
        let off: Vec<f32> = asserted.map(|gaussian| off_m(gaussian.mean_m)).collect();
        let mean_m = f64::from(off.iter().sum::<f32>()) / off.len() as f64;
        (off.len(), mean_m)
    }

    /// What is found of such a dive, and [`asserted_of`] its map.
    fn dive(drift_mps: f64, switch: Switch) -> (PoseDrift, usize, f64) {
        let (drift, count, mean_m, _) = dive_and_way(drift_mps, switch);
        (drift, count, mean_m)
    }

    /// Also, of its corrected poses, how far off they are and how far off they are told to be, metres, root mean squares.
    fn dive_and_way(drift_mps: f64, switch: Switch) -> (PoseDrift, usize, f64, Option<(f64, f64)>) {
        let mut mapper = mapper_of(switch);
        (0..PINGS).for_each(|number| _ = mapper.insert(&sweeping(number, drift_mps)));
        let (count, mean_m) = asserted_of(&mapper.finish());
        let corrections = mapper.pose_corrections();
        let (mut off_m2, mut told_m2, mut poses) = (0.0, 0.0, 0.0);
        for number in (0..PINGS).step_by(50) {
            let [told, truth] = [drift_mps, 0.0].map(|mps| sweeping(number, mps));
            let time = told.ping.transmit_time();
            let found = corrections.corrected(time, told.world_from_sensor);
            let off = found.pose.translation_m - truth.world_from_sensor.translation_m;
            let Some(sigma) = found.sigma else { continue };
            let told_m = DVec3::from_array(sigma.place_m).length();
            off_m2 += off.length_squared();
            told_m2 += told_m.powi(2);
            poses += 1.0;
        }
        let way = (poses > 0.0).then(|| ((off_m2 / poses).sqrt(), (told_m2 / poses).sqrt()));
        (mapper.status().drift, count, mean_m, way)
    }

    #[test]
    fn a_dive_that_ends_as_soon_as_poses_are_corrected_is_mapped_whole() {
        let mut mapper = mapper_of(Switch::Auto);
        let mut number = 0;
        while !mapper.status().drift.is_corrected {
            assert!(number < PINGS);
            mapper.insert(&sweeping(number, 5e-3));
            number += 1;
        }
        let map = mapper.finish();
        let (count, near_m) = asserted_of(&map);
        assert!(count > 200 && near_m < 0.2, "{count} {near_m}");
        let behind = u64::from(number) - map.through_ping;
        assert!(behind <= 4, "{behind}");
    }

    #[test]
    fn what_leads_away_from_a_map_that_foretells_wrong_is_no_gain() {
        let gains_of = |corrected: f64, as_they_are: f64| {
            let mut gains = Gains::default();
            (0..100).for_each(|_| gains.add(corrected, as_they_are));
            gains.are(LEAST_GAIN)
        };
        assert!(!gains_of(0.0, -100.0) && !gains_of(-1.0, -100.0));
        assert!(gains_of(100.0, -100.0) && gains_of(100.0, 50.0) && !gains_of(100.0, 60.0));
    }

    #[test]
    fn poses_that_drift_are_corrected_and_those_that_do_not_are_left_alone() {
        let (still, count, near_m) = dive(0.0, Switch::Auto);
        assert!(
            !still.is_suspected
                && !still.is_corrected
                && DVec3::from_array(still.shift_m) == DVec3::ZERO,
            "{still:?}"
        );
        assert!(count > 500 && near_m < 0.1, "{count} {near_m}");
        let (off, without, _) = dive(5e-3, Switch::Off);
        assert!(!off.is_corrected);
        let (drift, count, near_m, way) = dive_and_way(5e-3, Switch::Auto);
        assert!(drift.is_corrected, "{drift:?}");
        // By its end the way is 0.75 m off as it came.
        let (off_m, told_m) = way.unwrap();
        assert!(off_m < 0.15, "{off_m}");
        assert!((0.2..1.5).contains(&(off_m / told_m)), "{off_m} {told_m}");
        assert!((drift.shift_m[1] + 0.75).abs() < 0.2, "{drift:?}");
        assert!(count > 200 && near_m < 0.2, "{count} {near_m}");
        assert!(10 * without < count, "{without} {count}");
    }
}
