//! Keyframe pings: those the mapper still remembers, each with its geometry and profile. Their number is bounded.

use std::collections::VecDeque;
use std::sync::Arc;

use echosplat_measurement::{PingGeometry, PingPose};
use echosplat_model::glam::{DMat3, DQuat, DVec3, Vec3};
use echosplat_model::{PingSettings, PoseUncertainty, PosedPing, Timestamp};
use rayon::prelude::*;

use crate::MapperConfig;
use crate::accumulate::fan::{Fan, GROUP_PINGS, Reach, Sides};
use crate::detect::profile::Profile;
use crate::drift::Correction;

/// Sigmas of the beam, derived: it is at 1 %.
/// Slices are cut where the beam has fallen to 1 %.
pub(crate) const FAN_SIGMAS: f32 = 3.0;

/// Pings let go at once; bounds latency.
/// Most pings that are let go at once: with 15,000 pairs each, looked at twice, below 0.1 s.
const MOST_AT_ONCE: usize = 256;

/// One remembered ping.
#[derive(Debug, Clone)]
pub(crate) struct Keyframe {
    pub(crate) geometry: PingGeometry,
    pub(crate) fan: Fan,
    pub(crate) profile: Profile,
    /// What the pose adds to `geometry`'s variances where places are only lit or dark.
    pub(crate) blur: PoseBlur,
    /// What its pose may be off by together with those around it.
    pub(crate) pose_error: PoseBlur,
    /// What it counts against an observation that is independent of the ping before, 0 to 1.
    pub(crate) weight: f32,
    pub(crate) sequence: u64,
    pub(crate) time: Timestamp,
    /// As the ping has it.
    pub(crate) gain_index: i16,
    /// Brightness of the seabed by this ping's gain.
    pub(crate) brightness: f32,
    /// What was added to its pose.
    pub(crate) correction: Correction,
}

impl Keyframe {
    /// One sigma of an echo's range: pulse and pose.
    pub(crate) fn range_sigma_m(&self) -> f32 {
        self.blur.range_sigma_m(self.geometry.range_variance_m2)
    }

    /// The geometry with all that its pose blurs.
    pub(crate) fn blurred_geometry(&self) -> PingGeometry {
        self.blur.of(self.geometry)
    }
}

/// Pings in a row, and what is asked of all of them at once.
#[derive(Debug)]
struct Group {
    reach: Reach,
    sides: Sides,
}

/// Pings in order of arrival. When full, the oldest go: what they told stays in the map.
#[derive(Debug)]
pub(crate) struct History {
    pings: Vec<Arc<Keyframe>>,
    /// What each [`GROUP_PINGS`] can see, counted from the first ping ever; of pings let go at most those of one group
    /// are still in it.
    groups: VecDeque<Group>,
    /// Pings after those, which wait to be taken in again.
    again: VecDeque<Arc<Keyframe>>,
    capacity: usize,
    forgotten: u64,
}

impl History {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            pings: Vec::new(),
            groups: VecDeque::new(),
            again: VecDeque::new(),
            capacity,
            forgotten: 0,
        }
    }

    /// Gives each ping another correction.
    pub(crate) fn correct_anew(&mut self, correction: impl Fn(&Keyframe) -> Correction) {
        let pings = std::mem::take(&mut self.pings);
        self.groups.clear();
        for mut keyframe in pings {
            let to = correction(&keyframe);
            Arc::make_mut(&mut keyframe).correct(to);
            self.add(keyframe);
        }
    }

    /// Has all wait to be taken in again.
    pub(crate) fn begin_again(&mut self) {
        self.groups.clear();
        self.again = std::mem::take(&mut self.pings).into();
    }

    /// Takes in at most so many of those that wait, with this correction. Returns how many.
    pub(crate) fn go_on_again(&mut self, most: usize, correction: Correction) -> usize {
        let count = most.min(self.again.len());
        for _ in 0..count {
            let Some(mut keyframe) = self.again.pop_front() else {
                break;
            };
            Arc::make_mut(&mut keyframe).correct(correction);
            self.add(keyframe);
        }
        count
    }

    /// Whether any wait to be taken in again.
    pub(crate) fn is_behind(&self) -> bool {
        !self.again.is_empty()
    }

    /// The last ping that came.
    pub(crate) fn newest(&self) -> Option<&Arc<Keyframe>> {
        self.again.back().or(self.pings.last())
    }

    /// Remembers a ping, behind those that wait.
    pub(crate) fn push(&mut self, keyframe: Keyframe) {
        match self.is_behind() {
            true => self.again.push_back(Arc::new(keyframe)),
            false => self.add(Arc::new(keyframe)),
        }
    }

    fn add(&mut self, keyframe: Arc<Keyframe>) {
        let in_group = (self.first_in_group() + self.pings.len()) % GROUP_PINGS;
        if in_group == 0 || self.groups.is_empty() {
            self.groups.push_back(Group {
                reach: Reach::of([]),
                sides: Sides::default(),
            });
        }
        if let Some(group) = self.groups.back_mut() {
            group.reach.add(&keyframe.fan);
            group.sides.set(in_group, &keyframe.fan);
        }
        self.pings.push(keyframe);
    }

    /// Whether more are held than may be.
    pub(crate) fn is_overfull(&self) -> bool {
        self.pings.len() > self.capacity
    }

    /// Whether none was let go and room is left for as many again: time to work before any goes.
    pub(crate) fn is_half_empty(&self) -> bool {
        self.forgotten == 0 && 2 * self.pings.len() < self.capacity
    }

    /// Lets go of the oldest where more are held than may be; gives them. `recent` of them stay in any case.
    pub(crate) fn forget(&mut self, recent: usize) -> Vec<Arc<Keyframe>> {
        if !self.is_overfull() {
            return Vec::new();
        }
        // Some more than needed, since the rest moves up; not so many that summing up what they told is a pause.
        let spare = (self.capacity / 32).min(MOST_AT_ONCE);
        let keep = (self.capacity - spare).max(recent);
        let count = self.pings.len().saturating_sub(keep);
        let groups = (self.first_in_group() + count) / GROUP_PINGS;
        self.groups.drain(..groups.min(self.groups.len()));
        self.forgotten += count as u64;
        self.pings.drain(..count).collect()
    }

    /// Each ping, those that wait last, for changing what is made of it, by [`Arc::make_mut`]: one that is being worked with is
    /// copied first.
    pub(crate) fn pings_mut(&mut self) -> impl Iterator<Item = &mut Arc<Keyframe>> {
        self.pings.iter_mut().chain(&mut self.again)
    }

    /// The same, on all threads.
    pub(crate) fn par_pings_mut(&mut self) -> impl ParallelIterator<Item = &mut Arc<Keyframe>> {
        self.pings.par_iter_mut().chain(self.again.par_iter_mut())
    }

    pub(crate) fn pings(&self) -> &[Arc<Keyframe>] {
        &self.pings
    }

    /// Those of the first `count` pings that may see a sphere, and more, in order.
    pub(crate) fn near(
        &self,
        count: usize,
        center_m: Vec3,
        radius_m: f32,
    ) -> impl Iterator<Item = &Arc<Keyframe>> {
        let (pings, before) = (&self.pings[..count], self.first_in_group());
        let groups = self.groups.iter().enumerate();
        let near = groups.filter(move |(_, group)| group.reach.touches(center_m, radius_m));
        near.flat_map(move |(index, group)| {
            let first = index * GROUP_PINGS;
            let mut beside = group.sides.near(center_m, radius_m);
            let next = move || {
                let in_group = beside.trailing_zeros() as usize;
                // Without its lowest bit; none is left of none.
                beside &= beside.wrapping_sub(1);
                (in_group < GROUP_PINGS).then_some(first + in_group)
            };
            let of_group = std::iter::from_fn(next);
            of_group.filter_map(move |place| pings.get(place.checked_sub(before)?))
        })
    }

    /// The first `count` pings in order, without groups of them that do not reach what is asked for.
    pub(crate) fn within_reach(
        &self,
        count: usize,
        reaches: impl Fn(&Reach) -> bool,
    ) -> impl Iterator<Item = &Arc<Keyframe>> {
        let (pings, before) = (&self.pings[..count], self.first_in_group());
        let at = move |group: usize| (group * GROUP_PINGS).saturating_sub(before).min(count);
        let groups = self.groups.iter().enumerate();
        groups
            .filter(move |(_, group)| reaches(&group.reach))
            .flat_map(move |(index, _)| &pings[at(index)..at(index + 1)])
    }

    /// Where in its group the oldest ping is.
    fn first_in_group(&self) -> usize {
        (self.forgotten % GROUP_PINGS as u64) as usize
    }

    /// How many pings have been let go.
    pub(crate) fn forgotten(&self) -> u64 {
        self.forgotten
    }
}

/// Every `stride`-th ping from `offset` on; neither need be whole.
pub(crate) fn every(pings: &[Arc<Keyframe>], offset: f64, stride: f64) -> Vec<Arc<Keyframe>> {
    let index = |step: usize| (offset + step as f64 * stride) as usize;
    let at = |step: usize| pings.get(index(step)).map(Arc::clone);
    (0..).map_while(at).collect()
}

/// What an uncertain pose adds to range and azimuth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PoseBlur {
    pub(crate) range_variance_m2: f32,
    pub(crate) azimuth_variance_rad2: f32,
}

impl PoseBlur {
    /// Or what smoothing took out of the poses, where that is more: what it left in is hardly less.
    fn or(self, jitter: Option<PoseUncertainty>) -> Self {
        let Some(jitter) = jitter else { return self };
        Self {
            range_variance_m2: self.range_variance_m2.max(jitter.position_m.powi(2) as f32),
            azimuth_variance_rad2: self
                .azimuth_variance_rad2
                .max(jitter.attitude_rad.powi(2) as f32),
        }
    }

    /// One sigma of an echo's range, whose pulse has this variance.
    pub(crate) fn range_sigma_m(self, pulse_variance_m2: f32) -> f32 {
        (pulse_variance_m2 + self.range_variance_m2).sqrt()
    }

    fn of(self, geometry: PingGeometry) -> PingGeometry {
        PingGeometry {
            range_variance_m2: geometry.range_variance_m2 + self.range_variance_m2,
            azimuth_variance_rad2: geometry.azimuth_variance_rad2 + self.azimuth_variance_rad2,
            ..geometry
        }
    }
}

pub(crate) fn pose_blur(posed: &PosedPing, config: &MapperConfig) -> PoseBlur {
    let (position_sigma_m, attitude_sigma_rad) = match posed.uncertainty {
        Some(u) => (u.position_m, u.attitude_rad),
        None => (
            config.position_sigma_m,
            config.attitude_sigma_deg.to_radians(),
        ),
    };
    PoseBlur {
        range_variance_m2: position_sigma_m.powi(2) as f32,
        azimuth_variance_rad2: attitude_sigma_rad.powi(2) as f32,
    }
}

/// The echo of a sharp edge is as wide at half its height as the pulse is long.
pub(crate) fn pulse_variance_m2(settings: &PingSettings) -> f32 {
    (settings.pulse_length_m() / 2.354_82).powi(2) as f32
}

/// The geometry of a posed ping on the local coordinates of a map with this origin, as the mapper takes it in: what
/// renders a map for a ping starts from the same. What the pose blurs is left out of it: folded into every Gaussian, it
/// would pull surfaces inwards.
#[must_use]
pub fn geometry_of(posed: &PosedPing, origin_m: DVec3, config: &MapperConfig) -> PingGeometry {
    let settings = posed.ping.settings();
    let pose = &posed.world_from_sensor;
    let beam_turn = DQuat::from_rotation_z(posed.ping.beam_azimuth_rad().into());
    let rotation = pose.rotation * beam_turn;
    let twist = &posed.twist;
    let linear = beam_turn.conjugate() * twist.linear_mps;
    let angular = beam_turn.conjugate() * twist.angular_radps;
    let drift_per_m = DVec3::new(linear.y, angular.z, angular.x) / settings.speed_of_sound_mps;
    PingGeometry {
        pose: PingPose {
            position_m: (pose.translation_m - origin_m).as_vec3(),
            axes: DMat3::from_quat(rotation).as_mat3(),
            drift_per_m: drift_per_m.as_vec3(),
            reference_range_m: posed.reference_range_m as f32,
        },
        range_start_m: settings.range_start_m as f32,
        bin_length_m: settings.bin_length_m() as f32,
        bin_count: settings.bin_count as u32,
        range_variance_m2: pulse_variance_m2(settings),
        azimuth_variance_rad2: 0.0,
        beam: config.beam,
    }
}

pub(crate) fn keyframe_of(
    geometry: PingGeometry,
    blur: PoseBlur,
    profile: Profile,
    weight: f32,
    brightness: f32,
    posed: &PosedPing,
) -> Keyframe {
    Keyframe {
        fan: Fan::of(&blur.of(geometry), FAN_SIGMAS),
        blur,
        pose_error: blur.or(posed.jitter),
        geometry,
        profile,
        weight,
        sequence: posed.ping.sequence(),
        time: posed.ping.transmit_time(),
        gain_index: posed.ping.settings().gain_index,
        brightness,
        correction: Correction::default(),
    }
}

/// How much a ping says that the one before it did not, 0 to 1: neighbouring pings see the same speckle until the beam
/// has turned by its width or moved by a few centimetres, so a vehicle at rest does not grow sure of anything.
pub(crate) fn novelty(geometry: &PingGeometry, before: Option<&PingGeometry>) -> f32 {
    /// Metres, derived: speckle is another then.
    const MOVED_M: f32 = 0.05;
    /// Fraction, at least; found.
    const LEAST: f32 = 0.02;
    let Some(before) = before else { return 1.0 };
    let (now, then) = (&geometry.pose, &before.pose);
    let turned = Vec3::new(
        now.axes.x_axis.dot(then.axes.y_axis),
        now.axes.z_axis.dot(then.axes.y_axis) * geometry.beam.elevation_half_width_rad(),
        0.0,
    )
    .length();
    let moved_m = now.position_m.distance(then.position_m);
    let width = geometry.beam.azimuth_width_deg.to_radians();
    (turned / width + moved_m / MOVED_M).clamp(LEAST, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::profile::{Backdrop, Levels};
    use echosplat_model::{Ping, Pose, Twist};

    /// A ping that sees 5 m around `x_m`.
    fn keyframe(x_m: f64, sequence: u64) -> Keyframe {
        let settings = PingSettings {
            range_start_m: 0.0,
            range_length_m: 5.0,
            bin_count: 50,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 450e3,
            pulse_duration_s: 5e-5,
            gain_index: 0,
        };
        let ping = Ping::new(sequence, Timestamp::ZERO, settings, vec![1.0; 50]).unwrap();
        let place_m = DVec3::new(x_m, 0.0, 0.0);
        let posed = PosedPing {
            ping: Arc::new(ping),
            world_from_sensor: Pose::from_yaw_pitch_roll(0.0, 0.0, 0.0, place_m),
            twist: Twist::default(),
            reference_range_m: 2.5,
            uncertainty: None,
            jitter: None,
        };
        let (config, ground) = (MapperConfig::default(), Backdrop::default());
        let geometry = geometry_of(&posed, DVec3::ZERO, &config);
        let profile =
            Levels::default().profile(&posed.ping, 0.05, &ground, Box::default(), &config);
        keyframe_of(
            geometry,
            pose_blur(&posed, &config),
            profile,
            1.0,
            0.0,
            &posed,
        )
    }

    #[test]
    fn pings_that_are_elsewhere_are_passed_over_and_none_that_sees_a_place_is() {
        // 0.1 m from ping to ping, further than the fans reach in all, and let go in between.
        let mut history = History::new(450);
        for sequence in 0..1000 {
            history.push(keyframe(0.1 * sequence as f64, sequence));
            history.forget(1);
        }
        assert!(history.forgotten() > 400 && history.first_in_group() > 0);
        let (count, radius_m) = (history.pings().len() - 7, 0.3);
        let sequences =
            |near: Vec<&Arc<Keyframe>>| near.iter().map(|p| p.sequence).collect::<Vec<_>>();
        for x in 0..110 {
            let at_m = Vec3::new(x as f32, 0.0, 0.0);
            let sees = |keyframe: &&Arc<Keyframe>| keyframe.fan.touches(at_m, radius_m);
            let near = sequences(history.near(count, at_m, radius_m).collect());
            let seen = sequences(history.near(count, at_m, radius_m).filter(sees).collect());
            let all = sequences(history.pings()[..count].iter().filter(sees).collect());
            assert_eq!(seen, all, "{x} m");
            assert!(
                near.is_sorted() && near.len() <= seen.len() + 3 * GROUP_PINGS,
                "{x} m"
            );
        }
        assert_eq!(history.within_reach(count, |_| true).count(), count);
    }

    #[test]
    fn pings_are_taken_in_again_in_order_with_those_that_come_meanwhile_behind_them() {
        let mut history = History::new(1000);
        (0..200).for_each(|sequence| history.push(keyframe(0.1 * sequence as f64, sequence)));
        history.begin_again();
        assert!(history.pings().is_empty() && history.is_behind());
        let correction = Correction {
            shift_m: [0.0, 1.0, 0.0],
            turn_rad: 0.0,
        };
        let mut sequence = 200;
        while history.is_behind() {
            history.push(keyframe(0.1 * sequence as f64, sequence));
            assert_eq!(history.newest().unwrap().sequence, sequence);
            assert_eq!(history.pings_mut().count(), sequence as usize + 1);
            sequence += 1;
            assert!(history.go_on_again(3, correction) <= 3);
        }
        assert_eq!(history.go_on_again(3, correction), 0);
        let pings = history.pings();
        assert_eq!((pings.len() as u64, sequence), (sequence, 300));
        for (number, keyframe) in pings.iter().enumerate() {
            assert_eq!(keyframe.sequence, number as u64);
            let off_m =
                keyframe.geometry.pose.position_m - Vec3::new(0.1 * number as f32, 1.0, 0.0);
            assert!(off_m.length() < 1e-4 && keyframe.correction == correction);
        }
    }
}
