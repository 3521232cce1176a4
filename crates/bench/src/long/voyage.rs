//! The dive: surveys of places in a row, and transits between them.
//!
//! Each place is a built-in scene with a survey of its own, moved to where what its sonar can hear ends
//! where its neighbour's begins. While the vehicle is at a place its own scene is heard, in transit that
//! of the nearest place; what is in a scene, a seabed too, is nowhere else. The decibel scale is the
//! first place's everywhere.

use std::sync::Arc;

use echosplat_model::{Ping, PingSettings, Pose, StampedPose, Timestamp};
use echosplat_simulator::{
    Dive, DiveError, DiveKind, DiveOptions, NoiseLevel, Scene, SceneError, SimulatedSonar,
    seen_surface,
};
use glam::DVec3;

use echosplat_metrics::{MapPoints, Truth};

/// In the order in which they are visited; then the first again. Each kind twice, so that places alike
/// are seen early and late.
const SCENES: [&str; 6] = ["fence", "wall", "pier", "fence", "wall", "pier"];
const QUICK_PLACES: usize = 2;
/// Each is turned by so much more than the one before, so that no two lie alike on the map's voxels.
const TURN_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// What a vehicle does that is on its way.
const TRANSIT_MPS: f64 = 1.0;
/// Transits go straight up, across and down again, this far above everything: a straight line alone
/// would go through what it leaves.
const ABOVE_M: f64 = 3.0;
/// Less is no visit: a sweep of the heading takes 9 s, a lap four minutes.
const LEAST_STAY_S: f64 = 60.0;
/// What the device needs beside the two-way time of a ping.
const PING_OVERHEAD_S: f64 = 0.0035;
const NOISE: NoiseLevel = NoiseLevel::Nominal;

/// What is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct VoyagePlan {
    /// In all.
    pub(crate) duration_s: f64,
    /// Rounded to whole milliseconds between pings, and lowered where the range needs longer.
    pub(crate) pings_per_s: f64,
    /// Two places only.
    pub(crate) is_quick: bool,
    /// Of everything random.
    pub(crate) seed: u64,
}

/// Why there is no such dive.
#[derive(Debug, thiserror::Error)]
pub(crate) enum VoyageError {
    /// A scene that is built in is none.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A place cannot be surveyed.
    #[error(transparent)]
    Dive(#[from] DiveError),
    /// Transits leave too little.
    #[error("{places} places take at least {least_s:.0} s; the dive is to last {asked_s:.0} s")]
    TooShort {
        /// That are to be visited, the first twice.
        places: usize,
        /// Transits and shortest stays.
        least_s: f64,
        /// As asked.
        asked_s: f64,
    },
}

/// A structure somewhere in the world, and the survey of it.
struct Place {
    sonar: SimulatedSonar,
    world_from_place: Pose,
}

impl Place {
    fn dive(&self) -> &Dive {
        self.sonar.dive()
    }

    fn settings(&self) -> PingSettings {
        self.dive().settings()
    }
}

/// A stay at a place, and the way to the next.
struct Leg {
    place: usize,
    begin_s: f64,
    /// How far its survey is at the begin: the second stay goes on where the first one stopped.
    survey_s: f64,
    stay_s: f64,
    transit: Option<Transit>,
}

/// Straight from corner to corner at one speed, turning evenly.
struct Transit {
    duration_s: f64,
    corners: [DVec3; 4],
    from: Pose,
    to: Pose,
}

impl Transit {
    fn new(from: Pose, to: Pose, height_m: f64, duration_s: f64) -> Self {
        let above = |place: DVec3| DVec3::new(place.x, place.y, height_m);
        let (begin, end) = (from.translation_m, to.translation_m);
        Self {
            duration_s,
            corners: [begin, above(begin), above(end), end],
            from,
            to,
        }
    }

    fn pose_after(&self, time_s: f64) -> Pose {
        let progress = (time_s / self.duration_s).clamp(0.0, 1.0);
        let legs = self.corners.windows(2).map(|ends| (ends[0], ends[1]));
        let length_m: f64 = legs.clone().map(|(a, b)| a.distance(b)).sum();
        let (mut rest_m, mut place) = (progress * length_m, self.corners[0]);
        for (begin, end) in legs {
            let own_m = begin.distance(end);
            place = begin.lerp(end, (rest_m / own_m.max(1e-9)).min(1.0));
            if rest_m <= own_m {
                break;
            }
            rest_m -= own_m;
        }
        Pose {
            translation_m: place,
            ..self.from.interpolate(&self.to, progress)
        }
    }
}

/// A dive past several places, planned: every ping and every pose is a function of the plan and its
/// own number.
pub(crate) struct Voyage {
    places: Vec<Place>,
    legs: Vec<Leg>,
    interval_s: f64,
    duration_s: f64,
    seed: u64,
}

impl Voyage {
    /// # Errors
    /// If the dive is too short for its places, or longer than a survey may be.
    pub(crate) fn new(plan: &VoyagePlan) -> Result<Self, VoyageError> {
        let count = if plan.is_quick {
            QUICK_PLACES
        } else {
            SCENES.len()
        };
        let scenes: Vec<Arc<Scene>> = SCENES[..count]
            .iter()
            .map(|name| Ok(Arc::new(Scene::named(name)?)))
            .collect::<Result<_, SceneError>>()?;
        let seed_of = |place: usize| plan.seed.wrapping_add(place as u64);
        let survey = |place: usize, duration_s: f64| {
            let options = DiveOptions {
                duration_s,
                ..DiveOptions::default()
            };
            let seed = seed_of(place);
            Dive::plan_with(DiveKind::Survey, &scenes[place], NOISE, seed, &options)
        };
        // The survey is the same for any length, so a short one says how far it reaches.
        let reaches_m = (0..count)
            .map(|place| Ok(reach_m(&survey(place, DiveOptions::default().duration_s)?)))
            .collect::<Result<Vec<f64>, DiveError>>()?;
        let world_from_place = row(&reaches_m);
        let tops_m = scenes.iter().filter_map(|scene| Some(scene.bounds()?.1.z));
        let height_m = ABOVE_M + tops_m.fold(0.0, f64::max);
        let transits_s = transits(&world_from_place, height_m);
        let stays_s = stays(plan.duration_s, &transits_s)?;

        let mut places: Vec<Place> = Vec::with_capacity(count);
        for (place, scene) in scenes.iter().enumerate() {
            let last = if place == 0 { stays_s[count] } else { 0.0 };
            let dive = Arc::new(survey(place, stays_s[place] + transits_s[place] + last)?);
            let sonar = SimulatedSonar::new(Arc::clone(scene), dive, NOISE, seed_of(place));
            places.push(Place {
                sonar: match places.first() {
                    Some(first) => sonar.on_scale_of(&first.sonar),
                    None => sonar,
                },
                world_from_place: world_from_place[place],
            });
        }
        let interval_s = interval_s(plan.pings_per_s, &places);
        let mut voyage = Self {
            legs: legs(&stays_s, &transits_s),
            duration_s: plan.duration_s,
            seed: plan.seed,
            places,
            interval_s,
        };
        voyage.lay_transits(&transits_s, height_m);
        Ok(voyage)
    }

    fn lay_transits(&mut self, transits_s: &[f64], height_m: f64) {
        for (leg, &duration_s) in transits_s.iter().enumerate() {
            let from = self.surveyed(leg, self.legs[leg].stay_s);
            let to = self.surveyed(leg + 1, 0.0);
            self.legs[leg].transit = Some(Transit::new(from, to, height_m, duration_s));
        }
    }

    /// Number of pings.
    #[must_use]
    pub(crate) fn pings(&self) -> usize {
        (self.duration_s / self.interval_s) as usize
    }

    /// Time between pings, whole milliseconds.
    #[must_use]
    pub(crate) fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// From the first ping to the end.
    #[must_use]
    pub(crate) fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Begin and end of each stay at a place, seconds; the first and the last are at the same.
    #[must_use]
    pub(crate) fn stays_s(&self) -> Vec<(f64, f64)> {
        let stay = |leg: &Leg| (leg.begin_s, leg.begin_s + leg.stay_s);
        self.legs.iter().map(stay).collect()
    }

    /// Names of the places, in the order of the visits.
    #[must_use]
    pub(crate) fn scenes(&self) -> Vec<&str> {
        let name = |leg: &Leg| self.places[leg.place].sonar.scene().name();
        self.legs.iter().map(name).collect()
    }

    /// Ping `index`; `None` if it is none, which no setting of a planned dive makes it.
    #[must_use]
    pub(crate) fn ping(&self, index: usize) -> Option<Arc<Ping>> {
        let time_s = index as f64 * self.interval_s;
        let (number, leg) = self.leg_at(time_s);
        let (since_s, sequence) = (time_s - leg.begin_s, index as u64);
        let survey_s = leg.survey_s + since_s;
        let heard = if since_s < leg.stay_s {
            let place = &self.places[leg.place];
            place.sonar.ping_at(sequence, survey_s, &place.settings())
        } else {
            let here = self.pose_of_leg(number, since_s).translation_m;
            let place = &self.places[self.nearest(here)];
            let place_from_world = place.world_from_place.inverse();
            let pose_after =
                |later_s: f64| place_from_world * self.pose_of_leg(number, since_s + later_s);
            let settings = place.settings();
            place
                .sonar
                .ping_along(sequence, survey_s, &settings, pose_after)
        };
        let ping = heard.to_ping().ok()?;
        let time = Timestamp::from_secs_f64(time_s);
        let ping = Ping::new(sequence, time, *ping.settings(), ping.intensity().to_vec());
        ping.ok().map(Arc::new)
    }

    /// The poses that are reported, one after another: each survey's own errors, at the place and on
    /// the way from it.
    pub(crate) fn poses(self: &Arc<Self>) -> impl Iterator<Item = StampedPose> + Send + 'static {
        let voyage = Arc::clone(self);
        let of_leg = move |number: usize| {
            let voyage = Arc::clone(&voyage);
            let range = voyage.reported_in(number);
            range.map(move |index| voyage.reported(number, index))
        };
        (0..self.legs.len()).flat_map(of_leg)
    }

    /// Which of its survey's poses belong to a leg; before the first and after the last all there are.
    fn reported_in(&self, number: usize) -> std::ops::Range<usize> {
        let leg = &self.legs[number];
        let poses = self.places[leg.place].dive().reported_poses();
        let transit_s = leg
            .transit
            .as_ref()
            .map_or(0.0, |transit| transit.duration_s);
        let index_at = |time_s: f64| {
            // Poses are as far apart as 20 ms; times come a rounding early.
            poses.partition_point(|pose| pose.time.as_secs_f64() < time_s - 1e-6)
        };
        let is_last = number + 1 == self.legs.len();
        let begin = if number == 0 {
            0
        } else {
            index_at(leg.survey_s)
        };
        let end = index_at(leg.survey_s + leg.stay_s + transit_s);
        begin..if is_last { poses.len() } else { end }
    }

    fn reported(&self, number: usize, index: usize) -> StampedPose {
        let leg = &self.legs[number];
        let place = &self.places[leg.place];
        let pose = place.dive().reported_poses()[index];
        let since_s = pose.time.as_secs_f64() - leg.survey_s;
        let true_there = place.dive().truth_at(pose.time);
        let truth = self.pose_of_leg(number, since_s);
        let reported = pose.world_from_vehicle;
        StampedPose {
            time: Timestamp::from_secs_f64(leg.begin_s + since_s),
            world_from_vehicle: Pose {
                rotation: (truth.rotation * true_there.rotation.conjugate() * reported.rotation)
                    .normalize(),
                translation_m: truth.translation_m + reported.translation_m
                    - true_there.translation_m,
            },
            ..pose
        }
    }

    /// What the first stay sees of the first place, which is at the world's origin.
    ///
    /// # Errors
    /// If it cannot be surveyed.
    pub(crate) fn first_truth(&self) -> Result<Truth, VoyageError> {
        let scene = self.places[0].sonar.scene();
        let options = DiveOptions {
            duration_s: self.legs[0].stay_s,
            ..DiveOptions::default()
        };
        let dive = Dive::plan_with(DiveKind::Survey, scene, NOISE, self.seed, &options)?;
        Ok(Truth::from_scene(scene, Some(seen_surface(scene, &dive))))
    }

    /// What of a map is nearer to the first place than to any other.
    #[must_use]
    pub(crate) fn at_first(&self, mut points: MapPoints) -> MapPoints {
        points
            .confident
            .retain(|point| self.nearest(point.position) == 0);
        points.ambiguous.retain(|place| self.nearest(*place) == 0);
        points
    }

    fn leg_at(&self, time_s: f64) -> (usize, &Leg) {
        let after = self.legs.partition_point(|leg| leg.begin_s <= time_s);
        let number = after.saturating_sub(1);
        (number, &self.legs[number])
    }

    /// Where the sensor is, so long after the begin of a leg.
    fn pose_of_leg(&self, number: usize, since_s: f64) -> Pose {
        let leg = &self.legs[number];
        match &leg.transit {
            Some(transit) if since_s >= leg.stay_s => transit.pose_after(since_s - leg.stay_s),
            _ => self.surveyed(number, since_s),
        }
    }

    /// Where its survey has the sensor.
    fn surveyed(&self, number: usize, since_s: f64) -> Pose {
        let leg = &self.legs[number];
        let place = &self.places[leg.place];
        let time = Timestamp::from_secs_f64(leg.survey_s + since_s);
        place.world_from_place * place.dive().truth_at(time)
    }

    /// The place whose middle is nearest, seen from above.
    fn nearest(&self, point: DVec3) -> usize {
        let distance_m = |place: &Place| {
            let offset_m = place.world_from_place.translation_m - point;
            offset_m.truncate().length_squared()
        };
        let places = self.places.iter().enumerate();
        let nearest = places.min_by(|(_, a), (_, b)| distance_m(a).total_cmp(&distance_m(b)));
        nearest.map_or(0, |(index, _)| index)
    }
}

/// From its middle to the furthest that a survey hears.
fn reach_m(dive: &Dive) -> f64 {
    let poses = dive.reported_poses().iter();
    let from_middle_m = poses.map(|pose| pose.world_from_vehicle.translation_m.truncate().length());
    from_middle_m.fold(0.0, f64::max) + dive.settings().range_end_m()
}

/// Places along x, each beginning to be heard where the one before is heard no more.
fn row(reaches_m: &[f64]) -> Vec<Pose> {
    let mut x_m = -reaches_m.first().copied().unwrap_or(0.0);
    let place = |(index, reach_m): (usize, &f64)| {
        let middle_m = x_m + reach_m;
        x_m = middle_m + reach_m;
        let turn_rad = TURN_RAD * index as f64;
        Pose::from_yaw_pitch_roll(turn_rad, 0.0, 0.0, DVec3::X * middle_m)
    };
    reaches_m.iter().enumerate().map(place).collect()
}

/// How long the way takes from each place to the next, and from the last to the first; whole seconds.
fn transits(places: &[Pose], height_m: f64) -> Vec<f64> {
    let next = places.iter().cycle().skip(1);
    let way_m =
        |(from, to): (&Pose, &Pose)| from.translation_m.distance(to.translation_m) + 2.0 * height_m;
    let ways_m = places.iter().zip(next).map(way_m);
    ways_m.map(|way_m| (way_m / TRANSIT_MPS).ceil()).collect()
}

/// How long each visit lasts: all the same and whole seconds, the last with what is left over.
fn stays(duration_s: f64, transits_s: &[f64]) -> Result<Vec<f64>, VoyageError> {
    let visits = transits_s.len() + 1;
    let transit_s: f64 = transits_s.iter().sum();
    let stay_s = ((duration_s - transit_s) / visits as f64).floor();
    if !(stay_s >= LEAST_STAY_S) {
        return Err(VoyageError::TooShort {
            places: transits_s.len(),
            least_s: transit_s + LEAST_STAY_S * visits as f64,
            asked_s: duration_s,
        });
    }
    let mut stays_s = vec![stay_s; visits];
    stays_s[visits - 1] = duration_s - transit_s - stay_s * (visits - 1) as f64;
    Ok(stays_s)
}

/// The last one is at the first place, whose survey went on meanwhile for as long as its transit.
fn legs(stays_s: &[f64], transits_s: &[f64]) -> Vec<Leg> {
    let mut begin_s = 0.0;
    let leg = |(visit, &stay_s): (usize, &f64)| {
        let is_return = visit == transits_s.len();
        let leg = Leg {
            place: if is_return { 0 } else { visit },
            begin_s,
            survey_s: if is_return {
                stays_s[0] + transits_s[0]
            } else {
                0.0
            },
            stay_s,
            transit: None,
        };
        begin_s += stay_s + transits_s.get(visit).copied().unwrap_or(0.0);
        leg
    };
    stays_s.iter().enumerate().map(leg).collect()
}

fn interval_s(pings_per_s: f64, places: &[Place]) -> f64 {
    let least_ms = places.iter().map(|place| {
        let settings = place.settings();
        let listening_s = 2.0 * settings.range_end_m() / settings.speed_of_sound_mps;
        (1e3 * (listening_s + PING_OVERHEAD_S)).ceil()
    });
    1e-3 * least_ms.fold((1e3 / pings_per_s).round(), f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quick(duration_s: f64) -> Result<Voyage, VoyageError> {
        Voyage::new(&VoyagePlan {
            duration_s,
            pings_per_s: 58.0,
            is_quick: true,
            seed: 1,
        })
    }

    #[test]
    fn the_dive_lasts_as_long_as_asked_and_comes_back_to_the_first_place() {
        let voyage = quick(600.0).unwrap();
        let stays_s = voyage.stays_s();
        assert_eq!(voyage.scenes(), ["fence", "wall", "fence"]);
        assert!(stays_s[0].0.abs() < 1e-9 && (stays_s[2].1 - 600.0).abs() < 1e-9);
        assert!(
            stays_s
                .iter()
                .all(|(begin, end)| end - begin >= LEAST_STAY_S)
        );
        assert!((voyage.interval_s() - 0.017).abs() < 1e-12);
        assert_eq!(voyage.pings(), 35_294);
        assert!(matches!(quick(200.0), Err(VoyageError::TooShort { .. })));
    }

    #[test]
    fn poses_come_in_order_without_gaps_or_jumps() {
        let voyage = Arc::new(quick(600.0).unwrap());
        let poses: Vec<StampedPose> = voyage.poses().collect();
        assert!(poses[0].time.as_secs_f64() < 0.0);
        assert!(poses.last().unwrap().time.as_secs_f64() > 600.0);
        for pair in poses.windows(2) {
            let step_s = pair[1].time.seconds_since(pair[0].time);
            assert!(
                (step_s - 0.02).abs() < 1e-6,
                "{step_s} s at {:?}",
                pair[0].time
            );
            let [a, b] = [0, 1].map(|i| pair[i].world_from_vehicle);
            // At 2 m/s 4 cm, and noise of 2 cm an axis at both ends.
            assert!(a.translation_m.distance(b.translation_m) < 0.25);
            assert!(a.rotation.angle_between(b.rotation) < 0.06);
        }
    }

    #[test]
    fn reported_poses_are_where_pings_are_heard() {
        let voyage = Arc::new(quick(600.0).unwrap());
        for pose in voyage.poses().step_by(500) {
            let time_s = pose.time.as_secs_f64();
            let (number, leg) = voyage.leg_at(time_s);
            let truth = voyage.pose_of_leg(number, time_s - leg.begin_s);
            let off_m = truth
                .translation_m
                .distance(pose.world_from_vehicle.translation_m);
            assert!(off_m < 0.2, "{off_m} m off at {time_s} s");
        }
    }

    #[test]
    fn places_are_out_of_each_others_hearing_and_transits_above_everything() {
        let voyage = Voyage::new(&VoyagePlan {
            duration_s: 7200.0,
            pings_per_s: 58.0,
            is_quick: false,
            seed: 1,
        });
        let voyage = voyage.unwrap();
        assert_eq!(voyage.legs.len(), 7);
        for pair in voyage.places.windows(2) {
            let [a, b] = [0, 1].map(|i| pair[i].world_from_place.translation_m);
            let reach_m = reach_m(pair[0].dive()) + reach_m(pair[1].dive());
            assert!((a.distance(b) - reach_m).abs() < 0.2, "{a} {b}");
        }
        for leg in &voyage.legs {
            let Some(transit) = &leg.transit else {
                continue;
            };
            let middle = transit.pose_after(0.5 * transit.duration_s).translation_m;
            assert!(middle.z > 4.9, "{middle}");
            let near = &voyage.places[voyage.nearest(middle)];
            let here = near.world_from_place.inverse() * middle;
            assert!(near.sonar.scene().distance(here) > 2.0);
        }
    }

    #[test]
    fn pings_hear_the_places_and_nothing_far_from_them() {
        let voyage = quick(600.0).unwrap();
        let loudest = |time_s: f64| {
            let index = (time_s / voyage.interval_s()) as usize;
            // Beyond the ring-down, and over a sweep of the heading.
            let pings = (index..index + 530)
                .step_by(40)
                .filter_map(|i| voyage.ping(i));
            let loud = pings.map(|ping| {
                let heard = ping.intensity()[60..].iter().copied();
                heard.fold(0.0, f32::max)
            });
            loud.fold(0.0, f32::max)
        };
        let stays_s = voyage.stays_s();
        let [fence, wall] = [0, 1].map(|stay| loudest(0.5 * (stays_s[stay].0 + stays_s[stay].1)));
        let between = loudest(0.5 * (stays_s[0].1 + stays_s[1].0) - 4.5);
        assert!(
            fence > 50.0 * between && wall > 50.0 * between,
            "{fence} {wall} {between}"
        );
        let ping = voyage.ping(1000).unwrap();
        assert!((ping.transmit_time().as_secs_f64() - 17.0).abs() < 1e-6);
        assert_eq!(ping.sequence(), 1000);
    }

    #[test]
    fn a_map_is_split_by_the_nearest_place() {
        let voyage = quick(600.0).unwrap();
        let other = voyage.places[1].world_from_place.translation_m;
        let points = MapPoints::of_positions([DVec3::ZERO, 0.4 * other, 0.6 * other, other]);
        assert_eq!(
            voyage.at_first(points).positions(),
            [DVec3::ZERO, 0.4 * other]
        );
    }
}
