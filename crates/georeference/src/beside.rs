//! The origin of a world of poses, from fixes of an antenna on the vehicle beside the poses that it had.
//!
//! A single fix is metres off, so the place is the median of many, one a second: half of the fixes may be wild. Fixes of one
//! epoch of the poses place that epoch's world and no other. What is found first stays.

use std::collections::VecDeque;

use echosplat_model::glam::DVec3;
use echosplat_model::{
    Pose, PoseLookupError, StampedPose, Timestamp, Trajectory, TrajectoryLimits,
};

use crate::fix::{Fix, Heard};
use crate::{Datum, Georeference, Place};

/// So many fixes find an origin; half a minute, over which a receiver's error is about one and the same.
const ENOUGH: usize = 30;
/// At the end of poses so many do.
const LEAST: usize = 3;
/// Seconds between fixes that count: nearer ones have the same error.
const APART_S: f64 = 0.9;
/// Poses held, for fixes that come late; 40 s at 50 Hz.
const POSES: usize = 2_048;
/// What was heard and waits for poses.
const WAITING: usize = 1_024;
/// Metres; if half of the fixes lie farther from where poses have them, the antenna is elsewhere, or poses drift.
const MOST_SCATTER_M: f64 = 10.0;
/// Degrees, one sigma; headings that scatter more against those of poses are of something else.
const MOST_HEADING_SCATTER_DEG: f64 = 5.0;
/// Of a vehicle that points up or down more steeply than this cosine no heading is taken.
const LEAST_LEVEL: f64 = 0.5;
/// Degrees; x of a world that is called ENU points east.
const EAST_DEG: f64 = 90.0;
/// Metres; nearer than this and three sigma, a later origin is the same.
const MOVED_M: f64 = 1.0;

/// What is known of world and vehicle beside fixes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BesideRule {
    /// Heading of the world's x axis by its owner's word, degrees from true north.
    pub x_heading_deg: Option<f64>,
    /// Whether x of the world points east as far as the poses' source knows; of a dead reckoning from where it began it does not.
    pub is_enu: bool,
    /// The antenna in the vehicle, metres forward, left and up.
    pub antenna_m: DVec3,
    /// Longest time between two poses that is interpolated across, seconds.
    pub max_pose_gap_s: f64,
}

/// An origin that fixes found.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundOrigin {
    /// Of the poses.
    pub epoch: u32,
    /// Of that epoch's world.
    pub georeference: Georeference,
    /// How many.
    pub fixes: usize,
    /// Half of them lie within so many metres, level, of where poses have them.
    pub scatter_m: f64,
    /// Height of the geoid over the ellipsoid as the receiver has it, metres.
    pub separation_m: Option<f64>,
    /// One sigma of a fix, metres, as told or as it shows.
    sigma_m: f64,
}

impl FoundOrigin {
    /// How far another origin lies, if that is more than a metre and three sigma.
    fn moved_m(&self, other: &Self) -> Option<f64> {
        let sigma_m = self.sigma_m.hypot(other.sigma_m);
        let apart_m = self.apart_m(&other.georeference);
        (apart_m > MOVED_M + 3.0 * sigma_m).then_some(apart_m)
    }

    /// Level metres from where another georeference has the origin.
    #[must_use]
    pub fn apart_m(&self, other: &Georeference) -> f64 {
        let own = self.georeference.place_of(DVec3::ZERO);
        own.enu_of(&other.place_of(DVec3::ZERO)).truncate().length()
    }

    /// Whether another georeference has the origin elsewhere, by more than a metre and three sigma.
    #[must_use]
    pub fn contradicts(&self, other: &Georeference) -> bool {
        self.apart_m(other) > MOVED_M + 3.0 * self.sigma_m
    }
}

/// How many were heard, and what became of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BesideCounters {
    /// Fixes that came.
    pub fixes: u64,
    /// Of these, those beside a pose.
    pub beside_poses: u64,
    /// Headings that came.
    pub headings: u64,
}

/// A fix beside the antenna's place in the world.
#[derive(Debug, Clone, Copy)]
struct Pair {
    fix: Fix,
    world_m: DVec3,
}

/// Fixes and poses in, origins out; no clock.
#[derive(Debug)]
pub struct OriginFinder {
    rule: BesideRule,
    poses: Trajectory,
    epoch: Option<u32>,
    waiting: VecDeque<Heard>,
    /// Of the epoch at hand, since the newest origin was found.
    pairs: Vec<Pair>,
    /// Headings of the world's x axis, degrees, the newest last.
    headings_deg: VecDeque<f64>,
    newest_fix: Option<Timestamp>,
    newest_heading: Option<Timestamp>,
    found: Vec<FoundOrigin>,
    counters: BesideCounters,
    trouble: Option<String>,
    moved_m: f64,
}

impl OriginFinder {
    /// That has heard nothing.
    #[must_use]
    pub fn new(rule: BesideRule) -> Self {
        Self {
            rule,
            poses: Trajectory::new(TrajectoryLimits {
                capacity: POSES,
                max_pose_gap_s: rule.max_pose_gap_s,
            }),
            epoch: None,
            waiting: VecDeque::new(),
            pairs: Vec::new(),
            headings_deg: VecDeque::new(),
            newest_fix: None,
            newest_heading: None,
            found: Vec::new(),
            counters: BesideCounters::default(),
            trouble: None,
            moved_m: 0.0,
        }
    }

    /// Whether x of the world points east, once the source of poses knows.
    pub fn is_enu(&mut self, is_enu: bool) {
        self.rule.is_enu = is_enu;
    }

    /// The next pose, in order of time.
    pub fn pose(&mut self, pose: &StampedPose) {
        if self.epoch.replace(pose.epoch) != Some(pose.epoch) {
            self.end_epoch(pose.epoch);
        }
        // What is not newer, or not finite, is left out of the map too.
        if self.poses.push(*pose).is_ok() {
            self.pair();
        }
    }

    /// What the receiver told next.
    pub fn heard(&mut self, heard: Heard) {
        match heard {
            Heard::Fix(_) => self.counters.fixes += 1,
            Heard::Heading { .. } => self.counters.headings += 1,
        }
        if self.waiting.len() == WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(heard);
        self.pair();
    }

    /// No more poses will come of this clock: a few fixes are enough.
    pub fn finish(&mut self) {
        if let Some(epoch) = self.epoch {
            self.end_epoch(epoch);
        }
    }

    /// One for each epoch that has one.
    #[must_use]
    pub fn found(&self) -> &[FoundOrigin] {
        &self.found
    }

    /// What became of what was heard.
    #[must_use]
    pub fn counters(&self) -> BesideCounters {
        self.counters
    }

    /// Why the newest fixes found no origin.
    #[must_use]
    pub fn trouble(&self) -> Option<&str> {
        self.trouble.as_deref()
    }

    /// How far a later origin was from that found first, at most; 0 if none was more than a metre and three sigma.
    #[must_use]
    pub fn moved_m(&self) -> f64 {
        self.moved_m
    }

    /// Another world begins; what was heard for it may wait already.
    fn end_epoch(&mut self, next: u32) {
        let ended = self.poses.span().is_some();
        if ended && !self.pairs.is_empty() {
            self.settle_at_the_end();
        }
        self.epoch = Some(next);
        self.pairs.clear();
        self.headings_deg.clear();
        self.newest_fix = None;
        self.newest_heading = None;
        self.poses = Trajectory::new(TrajectoryLimits {
            capacity: POSES,
            max_pose_gap_s: self.rule.max_pose_gap_s,
        });
    }

    fn settle_at_the_end(&mut self) {
        let Some(epoch) = self.pairs_epoch() else {
            return;
        };
        if self.found.iter().any(|found| found.epoch == epoch) {
            return;
        }
        match self.pairs.len() {
            few if few < LEAST => {
                self.trouble = Some(format!(
                    "only {few} fixes came beside poses: {LEAST} are needed, a second apart, as one may be metres off"
                ));
            }
            _ => self.settle(epoch),
        }
    }

    fn pairs_epoch(&self) -> Option<u32> {
        let (first, _) = self.poses.span()?;
        self.poses.at(first).ok().map(|pose| pose.epoch)
    }

    /// Pairs what waits with poses as far as they go.
    fn pair(&mut self) {
        while let Some(heard) = self.waiting.front().copied() {
            match self.poses.at(heard.time()) {
                Err(PoseLookupError::NotYet) => return,
                Err(PoseLookupError::TooEarly | PoseLookupError::Gap) => {}
                Ok(pose) => self.is_beside(heard, &pose.world_from_vehicle),
            }
            self.waiting.pop_front();
        }
    }

    fn is_beside(&mut self, heard: Heard, world_from_vehicle: &Pose) {
        let newest = match heard {
            Heard::Fix(_) => &mut self.newest_fix,
            Heard::Heading { .. } => &mut self.newest_heading,
        };
        self.counters.beside_poses += u64::from(matches!(heard, Heard::Fix(_)));
        let time = heard.time();
        if newest.is_some_and(|newest| time.seconds_since(newest) < APART_S) {
            return;
        }
        *newest = Some(time);
        match heard {
            Heard::Heading { heading_deg, .. } => {
                let bow = world_from_vehicle.rotation * DVec3::X;
                if bow.truncate().length() < LEAST_LEVEL {
                    return;
                }
                if self.headings_deg.len() == ENOUGH {
                    self.headings_deg.pop_front();
                }
                // Anticlockwise from the world's x to the bow.
                let yaw_deg = bow.y.atan2(bow.x).to_degrees();
                self.headings_deg.push_back(heading_deg + yaw_deg);
            }
            Heard::Fix(fix) => {
                let world_m = *world_from_vehicle * self.rule.antenna_m;
                self.pairs.push(Pair { fix, world_m });
                if self.pairs.len() >= ENOUGH
                    && let Some(epoch) = self.epoch
                {
                    self.settle(epoch);
                }
            }
        }
    }

    /// Takes what the pairs say; the first of an epoch stays.
    fn settle(&mut self, epoch: u32) {
        let pairs = std::mem::take(&mut self.pairs);
        let origin = match self.origin(&pairs, epoch) {
            Ok(origin) => origin,
            Err(trouble) => return self.trouble = Some(trouble),
        };
        match self.found.iter().find(|found| found.epoch == epoch) {
            None => {
                self.trouble = None;
                self.found.push(origin);
            }
            Some(first) => {
                if let Some(apart_m) = first.moved_m(&origin) {
                    self.moved_m = self.moved_m.max(apart_m);
                }
            }
        }
    }

    fn x_heading(&self) -> Result<(f64, &'static str), String> {
        if let Some(given_deg) = self.rule.x_heading_deg {
            return Ok((given_deg, "x heading given"));
        }
        let measured = measured_heading(&self.headings_deg);
        match measured {
            Some((heading_deg, scatter_deg)) if scatter_deg <= MOST_HEADING_SCATTER_DEG => {
                Ok((heading_deg, "HDT"))
            }
            _ if self.rule.is_enu => Ok((EAST_DEG, "ENU")),
            Some((_, scatter_deg)) => Err(format!(
                "headings of the receiver (HDT) and of poses scatter by {scatter_deg:.0} degrees against each other: are they \
                 the vehicle's? Else give georeference.x_heading_deg"
            )),
            None => Err(
                "fixes tell a place and no heading, and the poses' world has no north: give georeference.x_heading_deg, or have \
                 the receiver send HDT"
                    .to_owned(),
            ),
        }
    }

    fn origin(&self, pairs: &[Pair], epoch: u32) -> Result<FoundOrigin, String> {
        let (x_heading_deg, heading_of) = self.x_heading()?;
        let blank = Georeference {
            x_heading_deg,
            ..Georeference::at_origin(pairs[0].fix.place, Datum::Surface, "")
        };
        let turn = blank.enu_from_world();
        // With satellites in sight the antenna is at the surface, which is the height of a fix that tells none.
        let datum = pairs.iter().find_map(|pair| pair.fix.datum);
        let origin_of = |pair: &Pair| pair.fix.place.origin_beside(turn * pair.world_m);
        let base = origin_of(&pairs[0]);
        let offsets_m: Vec<DVec3> = pairs
            .iter()
            .map(|pair| base.enu_of(&origin_of(pair)))
            .collect();
        let weights: Vec<f64> = pairs.iter().map(|pair| pair.fix.sigma_m.powi(-2)).collect();
        let median = |value: &dyn Fn(usize) -> Option<f64>| {
            let values = (0..pairs.len()).filter_map(|i| Some((value(i)?, weights[i])));
            weighted_median(values.collect())
        };
        let tells_height = |i: usize| pairs[i].fix.datum == datum;
        let middle_m = DVec3::new(
            median(&|i| Some(offsets_m[i].x)),
            median(&|i| Some(offsets_m[i].y)),
            median(&|i| tells_height(i).then(|| offsets_m[i].z)),
        );
        let off_m = |i: usize| (offsets_m[i] - middle_m).truncate().length();
        let scatter_m = median(&|i| Some(off_m(i)));
        if !(scatter_m <= MOST_SCATTER_M) {
            return Err(format!(
                "half of {} fixes lie more than {scatter_m:.1} m from where poses have them: the antenna is not on the vehicle, or \
                 poses drift, have another heading (georeference.x_heading_deg) or another clock",
                pairs.len()
            ));
        }
        let has_separation = pairs.iter().any(|pair| pair.fix.separation_m.is_some());
        let sigma_m = median(&|i| Some(pairs[i].fix.sigma_m));
        let source = format!(
            "{} GNSS fixes beside poses, half within {scatter_m:.1} m, {heading_of}",
            pairs.len()
        );
        Ok(FoundOrigin {
            epoch,
            georeference: Georeference {
                place: base.moved(middle_m),
                datum: datum.unwrap_or(Datum::Surface),
                source,
                ..blank
            },
            fixes: pairs.len(),
            scatter_m,
            separation_m: has_separation.then(|| median(&|i| pairs[i].fix.separation_m)),
            sigma_m: sigma_m.max(scatter_m),
        })
    }
}

/// Mean direction of the world's x, degrees, and its scatter, one sigma in degrees; `None` of too few.
fn measured_heading(headings_deg: &VecDeque<f64>) -> Option<(f64, f64)> {
    if headings_deg.len() < LEAST {
        return None;
    }
    let (sin, cos) = headings_deg.iter().fold((0.0, 0.0), |(sin, cos), deg| {
        let (s, c) = deg.to_radians().sin_cos();
        (sin + s, cos + c)
    });
    let length = f64::hypot(sin, cos) / headings_deg.len() as f64;
    // Of a wrapped normal distribution; rounding may give lengths above 1.
    let scatter = (-2.0 * length.min(1.0).ln()).max(0.0).sqrt();
    Some((
        sin.atan2(cos).to_degrees().rem_euclid(360.0),
        scatter.to_degrees(),
    ))
}

/// The value with half of the weight on each side; 0 of none.
fn weighted_median(mut values: Vec<(f64, f64)>) -> f64 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut below = 0.0;
    for (index, (value, weight)) in values.iter().enumerate() {
        below += weight;
        if below > half {
            return *value;
        }
        if below >= half {
            let next = values.get(index + 1).map_or(*value, |(next, _)| *next);
            return 0.5 * (value + next);
        }
    }
    0.0
}

impl Place {
    /// The place that this one is so many metres east, north and up of, by the axes there.
    #[must_use]
    pub fn origin_beside(&self, enu_m: DVec3) -> Self {
        let rough = self.moved(-enu_m);
        // East and up there are not quite those here.
        rough.moved(rough.enu_of(self) - enu_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::DQuat;

    fn place() -> Place {
        Place::new(60.17, 24.94, 3.0).unwrap()
    }

    fn rule() -> BesideRule {
        BesideRule {
            x_heading_deg: None,
            is_enu: true,
            antenna_m: DVec3::ZERO,
            max_pose_gap_s: 0.5,
        }
    }

    fn second(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    /// On a circle, bow along it.
    fn pose(seconds: f64, epoch: u32) -> StampedPose {
        let angle = 0.05 * seconds;
        let (sin, cos) = angle.sin_cos();
        StampedPose {
            time: second(seconds),
            world_from_vehicle: Pose {
                rotation: DQuat::from_rotation_z(angle + std::f64::consts::FRAC_PI_2),
                translation_m: DVec3::new(40.0 * cos, 40.0 * sin, -0.3),
            },
            uncertainty: None,
            epoch,
        }
    }

    /// Of an antenna with this place in the vehicle, in a world that lies like this, off by so much.
    fn fix(world: &Georeference, antenna_m: DVec3, seconds: f64, off_m: DVec3) -> Heard {
        let there = pose(seconds, 0).world_from_vehicle * antenna_m;
        Heard::Fix(Fix {
            time: second(seconds),
            place: world.place_of(there).moved(off_m),
            datum: Some(Datum::MeanSea),
            separation_m: Some(17.0),
            sigma_m: 2.0,
        })
    }

    /// Errors of metres with a few wild ones, the same at each run.
    fn noise(i: u32) -> DVec3 {
        let unit = |salt: u32| {
            let bits = (i + 1)
                .wrapping_mul(2_654_435_761)
                .wrapping_add(salt)
                .wrapping_mul(2_246_822_519);
            f64::from(bits >> 8) / f64::from(1 << 24) - 0.5
        };
        let noise = DVec3::new(unit(1), unit(77), unit(1234)) * 4.0;
        if i % 7 == 3 {
            noise + DVec3::new(400.0, -300.0, 50.0)
        } else {
            noise
        }
    }

    fn poses(finder: &mut OriginFinder, from_s: f64, to_s: f64, epoch: u32) {
        let count = ((to_s - from_s) / 0.1) as u32;
        for i in 0..count {
            finder.pose(&pose(from_s + 0.1 * f64::from(i), epoch));
        }
    }

    #[test]
    fn many_noisy_fixes_place_a_world_however_it_is_turned() {
        let antenna_m = DVec3::new(0.4, 0.0, 0.3);
        for (x_heading_deg, given, hdt) in [
            (90.0, None, false),
            (37.0, Some(37.0), false),
            (212.0, None, true),
        ] {
            let world = Georeference {
                x_heading_deg,
                ..Georeference::at_origin(place(), Datum::MeanSea, "truth")
            };
            let mut finder = OriginFinder::new(BesideRule {
                x_heading_deg: given,
                is_enu: !hdt,
                antenna_m,
                ..rule()
            });
            for i in 0..31_u32 {
                let at = 5.03 + f64::from(i);
                if hdt {
                    let yaw_deg = (0.05 * at).to_degrees() + 90.0;
                    let heading_deg = (x_heading_deg - yaw_deg).rem_euclid(360.0);
                    finder.heard(Heard::Heading {
                        time: second(at),
                        heading_deg,
                    });
                }
                finder.heard(fix(&world, antenna_m, at, noise(i)));
            }
            assert!(finder.found().is_empty());
            poses(&mut finder, 0.0, 40.0, 0);
            let [found] = finder.found() else {
                panic!("{:?}", finder.trouble())
            };
            let off_m = found.georeference.place.enu_of(&place());
            // Off by up to 3 m each, and every seventh by 500 m.
            assert!(off_m.length() < 2.0, "{off_m}");
            let turn_deg = (found.georeference.x_heading_deg - x_heading_deg + 180.0)
                .rem_euclid(360.0)
                - 180.0;
            assert!(turn_deg.abs() < 0.3, "{found:?}");
            assert!(found.scatter_m < 3.0 && found.fixes == ENOUGH);
            assert_eq!(
                (found.georeference.datum, found.separation_m),
                (Datum::MeanSea, Some(17.0))
            );
            assert!(found.georeference.line().len() < 256);
        }
    }

    #[test]
    fn the_order_in_which_fixes_and_poses_come_does_not_matter() {
        let world = Georeference::at_origin(place(), Datum::MeanSea, "truth");
        let fixes: Vec<Heard> = (0..40)
            .map(|i| fix(&world, DVec3::ZERO, 0.55 + f64::from(i), noise(i)))
            .collect();
        let mut first = OriginFinder::new(rule());
        fixes.iter().for_each(|fix| first.heard(*fix));
        poses(&mut first, 0.0, 41.0, 0);
        let mut late = OriginFinder::new(rule());
        let mut rest = fixes.iter();
        for i in 0..500 {
            late.pose(&pose(0.1 * f64::from(i), 0));
            // Four seconds late.
            if i % 10 == 0 && i >= 40 {
                rest.next().iter().for_each(|fix| late.heard(**fix));
            }
        }
        assert_eq!(first.found().len(), 1);
        assert_eq!(first.found(), late.found());
    }

    #[test]
    fn without_a_heading_nothing_is_turned_and_that_is_said() {
        let world = Georeference::at_origin(place(), Datum::MeanSea, "truth");
        let mut finder = OriginFinder::new(BesideRule {
            is_enu: false,
            ..rule()
        });
        (0..30).for_each(|i| finder.heard(fix(&world, DVec3::ZERO, f64::from(i), DVec3::ZERO)));
        poses(&mut finder, 0.0, 31.0, 0);
        assert!(finder.found().is_empty());
        assert!(finder.trouble().unwrap().contains("x_heading_deg"));
    }

    #[test]
    fn an_antenna_elsewhere_places_nothing() {
        let mut finder = OriginFinder::new(rule());
        for i in 0..90 {
            // Of a ship at anchor.
            finder.heard(Heard::Fix(Fix {
                time: second(f64::from(i)),
                place: place(),
                datum: None,
                separation_m: None,
                sigma_m: 3.0,
            }));
        }
        poses(&mut finder, 0.0, 91.0, 0);
        assert!(finder.found().is_empty());
        assert!(finder.trouble().unwrap().contains("not on the vehicle"));
    }

    #[test]
    fn few_fixes_do_at_the_end_and_one_does_not() {
        let world = Georeference::at_origin(place(), Datum::MeanSea, "truth");
        for (count, found) in [(1, 0), (2, 0), (3, 1)] {
            let mut finder = OriginFinder::new(rule());
            (0..count).for_each(|i| {
                finder.heard(fix(&world, DVec3::ZERO, 1.0 + f64::from(i), DVec3::ZERO));
            });
            poses(&mut finder, 0.0, 10.0, 0);
            assert!(finder.found().is_empty());
            finder.finish();
            assert_eq!(finder.found().len(), found);
            assert_eq!(finder.trouble().is_some(), found == 0);
        }
        let mut finder = OriginFinder::new(rule());
        // Ten in one second are one.
        (0..10).for_each(|i| {
            finder.heard(fix(
                &world,
                DVec3::ZERO,
                1.0 + 0.08 * f64::from(i),
                DVec3::ZERO,
            ));
        });
        poses(&mut finder, 0.0, 10.0, 0);
        finder.finish();
        assert!(finder.found().is_empty() && finder.trouble().unwrap().contains("only 1"));
    }

    #[test]
    fn without_heights_the_antenna_is_at_the_surface() {
        let world = Georeference::at_origin(place(), Datum::MeanSea, "truth");
        let mut finder = OriginFinder::new(rule());
        for i in 0..30 {
            let Heard::Fix(fix) = fix(&world, DVec3::ZERO, f64::from(i), DVec3::ZERO) else {
                unreachable!()
            };
            let place = Place {
                height_m: 0.0,
                ..fix.place
            };
            finder.heard(Heard::Fix(Fix {
                place,
                datum: None,
                separation_m: None,
                ..fix
            }));
        }
        poses(&mut finder, 0.0, 31.0, 0);
        let found = &finder.found()[0];
        assert_eq!(found.georeference.datum, Datum::Surface);
        // Poses are 0.3 m below the world's origin.
        assert!(
            (found.georeference.place.height_m - 0.3).abs() < 1e-3,
            "{found:?}"
        );
        assert_eq!(found.separation_m, None);
    }

    #[test]
    fn each_epoch_is_placed_by_its_own_fixes_alone() {
        let first = Georeference::at_origin(place(), Datum::MeanSea, "truth");
        let second_place = place().moved(DVec3::new(500.0, 0.0, 0.0));
        let second = Georeference::at_origin(second_place, Datum::MeanSea, "truth");
        let mut finder = OriginFinder::new(rule());
        (0..35).for_each(|i| finder.heard(fix(&first, DVec3::ZERO, f64::from(i), DVec3::ZERO)));
        poses(&mut finder, 0.0, 40.0, 0);
        poses(&mut finder, 41.0, 60.0, 1);
        assert_eq!(finder.found().len(), 1, "the second world has no place yet");
        (61..66).for_each(|i| finder.heard(fix(&second, DVec3::ZERO, f64::from(i), DVec3::ZERO)));
        poses(&mut finder, 60.0, 70.0, 1);
        finder.finish();
        let [a, b] = finder.found() else {
            panic!("{:?}", finder.trouble())
        };
        assert_eq!((a.epoch, b.epoch), (0, 1));
        assert!(a.georeference.place.enu_of(&place()).length() < 0.01);
        assert!(b.georeference.place.enu_of(&second_place).length() < 0.01);
        assert!(finder.moved_m() < 1e-9);
    }

    #[test]
    fn what_is_found_first_stays_and_a_later_one_far_off_is_told() {
        let first = Georeference::at_origin(place(), Datum::MeanSea, "truth");
        let moved = Georeference::at_origin(
            place().moved(DVec3::new(60.0, 0.0, 0.0)),
            Datum::MeanSea,
            "",
        );
        let mut finder = OriginFinder::new(rule());
        for i in 0..100 {
            let world = if i < 65 { &first } else { &moved };
            finder.heard(fix(world, DVec3::ZERO, f64::from(i), noise(2)));
        }
        poses(&mut finder, 0.0, 101.0, 0);
        let [found] = finder.found() else {
            panic!("{:?}", finder.trouble())
        };
        assert!(found.georeference.place.enu_of(&place()).length() < 4.0);
        assert!(
            (finder.moved_m() - 60.0).abs() < 1.0,
            "{}",
            finder.moved_m()
        );
        assert!(found.contradicts(&moved) && !found.contradicts(&first));
    }
}
