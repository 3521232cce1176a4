//! A ping on its way in: whether it can be used, what it measured, and what that is evidence of.

use std::sync::Arc;

use echosplat_measurement::{PingGeometry, SymmetricMat3};
use echosplat_model::glam::{DVec3, Vec3};
use echosplat_model::{Ping, PosedPing, Standing};
use rayon::prelude::*;

use super::foretold::field_of;
use super::status::InsertReport;
use super::{Mapper, SPAWN_STRENGTH};
use crate::MapperConfig;
use crate::accumulate::history::{
    Keyframe, geometry_of, keyframe_of, novelty, pose_blur, pulse_variance_m2,
};
use crate::detect::mirror::Source;
use crate::detect::profile::{Backdrop, Levels, Profile, RING_DOWN_M, blank_bins, widen_bins};
use crate::detect::working_range::WorkingRange;
use crate::effort::{Counted, Task};
use crate::features::{Cue, Extent};
use crate::seabed::Seabed;
use crate::spawn::from_evidence;
use crate::spawn::gaussians::{Gaussians, Verdict};
use crate::world::{World, first_voxel_m, useful_range_m};

/// Pings a slice; bounds latency.
/// Evidence that is summed up anew takes in so many pings with each slice, so that pings that come meanwhile need not wait:
/// of pings that come at 58 a second, eight times as many, in about the work that they allow.
const SUMMED_UP_ANEW: usize = 32;
/// Pings a slice; bounds latency.
/// Pings that are taken in again come so many with each slice, beside work on the map: four times as many as come meanwhile.
const TAKEN_IN_AGAIN: usize = 12;
/// Seconds on the pings' clock; bounds latency.
/// On the pings' clock, a slice does not wait longer than this to be complete.
const LONGEST_SLICE_S: f64 = 0.1;
/// Fraction; found.
/// Of what an independent observation says, which a turn by the beam's width or a move of 5 cm makes.
const LEAST_NOVELTY: f32 = 0.5;
/// Metres, physics: none on Earth.
/// No place on Earth is further from any origin in use, and nothing under water as fast: metres, and
/// metres or radians a second.
const FURTHEST_M: f64 = 1e9;
/// Metres or radians a second; physics.
const FASTEST: f64 = 1e3;
/// Metres of movement; found.
/// A vehicle moves less before the map's sources of echoes are told again, metres.
const BETWEEN_SOURCES_M: f32 = 5.0;
/// Fraction of range; found.
/// A ping whose pose leaves open this fraction of its range says nothing of any place.
const UNPLACED_FRACTION: f64 = 0.25;
/// Voxels from the first ping; layout: 32 bits.
/// Voxels from the first ping that can still be counted in 32 bits.
const MOST_VOXELS: f64 = (1 << 30) as f64;

impl Mapper {
    /// Takes in one ping. With its slice complete: noise and echoes of each ping in order of time,
    /// evidence along the arcs, and Gaussians where the evidence now says so. What a slice says does
    /// not depend on the order in which its pings come. Tiles are worked out with the first ping of a
    /// slice, so that the slice before can be published as soon as it is taken in.
    pub fn insert(&mut self, posed: &PosedPing) -> InsertReport {
        if !is_usable(posed) || !self.is_within_reach(posed) {
            self.status.pings_rejected += 1;
            return InsertReport {
                rejected: true,
                ..InsertReport::default()
            };
        }
        self.status.pings += 1;
        self.status.range_end_m = posed.ping.settings().range_end_m() as f32;
        if !self.is_evidence(posed) {
            self.status.pings_deaf += 1;
            return InsertReport::default();
        }
        self.waiting.push(posed.clone());
        self.allow_work_of_a_ping();
        let is_first = self.waiting.len() == 1;
        let is_complete = self.waiting.len() >= self.config.slice_pings;
        let report = match is_complete || self.is_slice_overdue() {
            true => self.take_in_slice(),
            false => InsertReport::default(),
        };
        match is_first {
            true => InsertReport {
                pairs: self.work(),
                ..report
            },
            false => report,
        }
    }

    /// Whether the first ping that waits for a slice has waited long enough.
    fn is_slice_overdue(&self) -> bool {
        let time = |posed: &PosedPing| posed.ping.transmit_time();
        let ends = self.waiting.first().zip(self.waiting.last());
        ends.is_some_and(|(first, last)| time(last).seconds_since(time(first)) > LONGEST_SLICE_S)
    }

    /// What a ping must say that the last one taken in did not.
    fn least_novelty(&self) -> f32 {
        match self.at_work.redundant {
            Extent::All => 0.0,
            Extent::Useful => LEAST_NOVELTY,
            Extent::None => 1.0,
        }
    }

    /// Whether voxels and single precision reach as far as the ping is from the first.
    fn is_within_reach(&self, posed: &PosedPing) -> bool {
        let (origin_m, voxel_m) = self.origin_and_voxel_m(posed);
        let away_m = posed.world_from_sensor.translation_m - origin_m;
        away_m.abs().max_element() < MOST_VOXELS * f64::from(voxel_m)
    }

    /// As they are, or as they would be if the first ping that waits, or this one, began the map.
    fn origin_and_voxel_m(&self, posed: &PosedPing) -> (DVec3, f32) {
        if let Some(world) = &self.world {
            return (world.origin_m, world.evidence.voxel_m());
        }
        let first = self.waiting.first().unwrap_or(posed);
        let origin_m = first.world_from_sensor.translation_m;
        (origin_m, first_voxel_m(first, &self.config))
    }

    /// Whether a ping says anything of any place, before it waits for its slice: those that do not
    /// leave no trace.
    fn is_evidence(&mut self, posed: &PosedPing) -> bool {
        let (_, voxel_m) = self.origin_and_voxel_m(posed);
        let tolerance_m = tolerance_m(voxel_m, range_sigma_m(posed, &self.config));
        let is_placed =
            f64::from(tolerance_m) <= UNPLACED_FRACTION * posed.ping.settings().range_length_m;
        self.status.pings_unplaced += u64::from(!is_placed);
        is_placed && self.levels.hears(&posed.ping, self.config.blanking_m)
    }

    /// What the ping measured, before anything of the map.
    fn listen(&mut self, posed: &PosedPing) -> Keyframe {
        let config = &self.config;
        let begun = || World::begun_by(posed, config);
        let world = self.world.get_or_insert_with(begun);
        let posed = &self.drift.correct(world.enter(posed));
        let geometry = geometry_of(posed, DVec3::ZERO, config);
        let blur = pose_blur(posed, config);
        let range_sigma_m = range_sigma_m(posed, config);
        let tolerance_m = tolerance_m(world.evidence.voxel_m(), range_sigma_m);
        let seabed = &mut self.seabed;
        let brightness = seabed.brightness();
        let ground = seabed.backdrop(&geometry, brightness);
        let ping = &posed.ping;
        let (blank, bin_length_m) = (
            blank_bins(ping, config.blanking_m),
            ping.settings().bin_length_m(),
        );
        let widen = widen_bins(tolerance_m.into(), bin_length_m);
        let bursts = self.bursts.runs(&geometry, ping.intensity(), blank, widen);
        let settings = ping.settings();
        let of_vehicle = self.own_vehicle.runs(
            settings.range_start_m,
            settings.bin_length_m(),
            settings.bin_count,
        );
        let foreign = in_order(&[&bursts, &of_vehicle]);
        let mut profile = self
            .levels
            .profile(ping, tolerance_m.into(), &ground, foreign, config);
        let weight = match posed.ping.view() {
            Some(_) => 1.0,
            None => novelty(&geometry, self.last_geometry.as_ref()),
        };
        let (intensity, strongest) = (posed.ping.intensity(), self.levels.strongest());
        let walking = self.walkers.runs(&geometry, intensity, &profile);
        if !walking.is_empty() {
            profile.foreign = in_order(&[&profile.foreign, &walking]);
            profile.judge(intensity, &ground);
        }
        let pulses = bursts.iter().chain(&walking);
        self.status.bins_interfered += pulses
            .map(|&(start, end)| u64::from(end - start))
            .sum::<u64>();
        if self.repeats.wants_sources() {
            let reach_m =
                geometry.range_start_m + geometry.bin_length_m * geometry.bin_count as f32;
            let reach_m = reach_m + BETWEEN_SOURCES_M;
            let at_m = geometry.pose.position_m;
            let sources = sources(&self.gaussians, |mean_m| mean_m.distance(at_m) < reach_m);
            self.repeats.set_sources(sources);
        }
        self.repeats
            .listen(&geometry, intensity, &profile, strongest, weight);
        self.status.bins_doubted += self
            .repeats
            .doubt(&geometry, intensity, &ground, &mut profile);
        let seabed = &mut self.seabed;
        self.pool
            .install(|| seabed.listen(&geometry, intensity, &profile));
        self.learn_from_strongest(&geometry, intensity, &profile, weight);
        self.status.noise_db = 10.0 * (profile.noise / self.levels.strongest()).log10();
        self.cues.add(Cue {
            runs: profile.echoes.len(),
            weight,
            sector: sector_of(geometry.pose.axes.x_axis),
            blur_m: range_sigma_m,
            jitter_m: jitter_m(posed),
        });
        Keyframe {
            correction: self.drift.correction(),
            ..keyframe_of(geometry, blur, profile, weight, brightness, posed)
        }
    }

    /// The range of the ping's strongest echo, and the strength at which a Gaussian of one voxel would make it.
    fn learn_from_strongest(
        &mut self,
        geometry: &PingGeometry,
        intensity: &[f32],
        profile: &Profile,
        weight: f32,
    ) {
        let Some(world) = &self.world else { return };
        let bins = profile.echoes.iter().flat_map(|&(start, end)| start..end);
        let strongest =
            bins.max_by(|&a, &b| intensity[a as usize].total_cmp(&intensity[b as usize]));
        let Some(bin) = strongest else { return };
        let range_m = geometry.range_start_m + (bin as f32 + 0.5) * geometry.bin_length_m;
        let threshold = profile.thresholds(intensity.len())[bin as usize];
        let over_threshold = intensity[bin as usize] / threshold;
        self.working_range.hear(range_m, over_threshold, weight);
        let ahead = geometry.pose.position_m + geometry.pose.axes.x_axis * range_m;
        let round = SymmetricMat3::isotropic(0.5 * world.evidence.voxel_m());
        if let Some(splat) = geometry.project(ahead, &round) {
            let needed = intensity[bin as usize] / splat.energy;
            let before = if self.unit_strength > 0.0 {
                self.unit_strength
            } else {
                needed
            };
            self.unit_strength = before + 0.05 * (needed - before);
        }
    }

    /// Adds a ping to the history if it says something; whether it does.
    fn remember(&mut self, posed: &PosedPing) -> bool {
        let keyframe = self.listen(posed);
        if keyframe.weight < self.least_novelty() {
            self.status.pings_redundant += 1;
            return false;
        }
        self.last_geometry = Some(keyframe.geometry);
        self.history.push(keyframe);
        true
    }

    /// Makes anew what was made of pings whose noise was thought to grow by another power of range, `change` less, that
    /// were thought to ring for another time, or whose echoes of the vehicle itself were not known.
    fn refer_anew(&mut self, change: f32) {
        self.foretold.forget_map();
        let ringing = self.receiver.ringing();
        (self.levels, self.unit_strength) = (Levels::ringing(ringing.clone()), 0.0);
        self.working_range = WorkingRange::default();
        self.seabed = Seabed::new(&self.config.beam, self.config.parts.seabed);
        let (ground, config) = (Backdrop::default(), &self.config);
        for keyframe in self.history.pings_mut().map(Arc::make_mut) {
            self.progress.tell();
            let range_m = |bin: usize| {
                keyframe.geometry.range_start_m
                    + (bin as f32 + 0.5) * keyframe.geometry.bin_length_m
            };
            let bins = keyframe.profile.intensity.iter().enumerate();
            let factor = |bin: usize| range_m(bin).powf(-change);
            let referred = bins.map(|(bin, power)| Ping::nearest_power(power * factor(bin)));
            let intensity: Vec<f32> = referred.collect();
            let profile = &mut keyframe.profile;
            let rings_until_m = ringing.until_m(keyframe.gain_index);
            profile.ring_until(rings_until_m);
            let (start_m, length_m) = (
                keyframe.geometry.range_start_m,
                keyframe.geometry.bin_length_m,
            );
            let of_vehicle = self
                .own_vehicle
                .runs_in(start_m.into(), length_m.into(), &intensity);
            profile.foreign = in_order(&[&profile.foreign, &of_vehicle]);
            self.levels.renew(profile, &intensity, &ground, config);
            keyframe.brightness = 0.0;
        }
        if let Some(world) = &self.world {
            self.leave_voxels_for(world.evidence.voxel_m());
        }
    }

    /// The edge of voxels that the strongest echoes so far ask for, if it is another.
    fn better_voxel_m(&mut self, slice: &[PosedPing]) -> Option<f32> {
        let working_range_m = self.working_range.settle()?;
        self.status.working_range_m = Some(working_range_m);
        self.status.useful_range_m = useful_range_m(working_range_m, &self.config);
        let range_end_m = slice.last()?.ping.settings().range_end_m();
        let world = self.world.as_ref()?;
        world.better_voxel_m(range_end_m, working_range_m, &self.config)
    }

    /// Begins with empty voxels of this size, which hear of the pings so far slice by slice. Gaussians are spawned again where
    /// their evidence is; until they are worked out, those of before are published.
    fn leave_voxels_for(&mut self, voxel_m: f32) {
        self.workout = None;
        self.gaussians.leave_voxels();
        if let Some(world) = &mut self.world {
            world.divide_anew(voxel_m);
        }
    }

    /// Cuts space into voxels of another size, as the strongest echoes so far ask for, and makes anew what was made of all
    /// pings.
    pub(super) fn divide_anew(&mut self, voxel_m: f32) {
        let Some(world) = &self.world else { return };
        // What one sends back goes with its area.
        self.unit_strength *= (world.evidence.voxel_m() / voxel_m).powi(2);
        self.foretold.forget_map();
        let begun = self.tasks.begin(Task::Anew);
        self.leave_voxels_for(voxel_m);
        let pings = self.history.par_pings_mut();
        let tolerate = || {
            pings.map(Arc::make_mut).for_each(|keyframe| {
                let tolerance_m = tolerance_m(voxel_m, keyframe.range_sigma_m());
                keyframe.profile.tolerate(tolerance_m);
            });
        };
        self.pool.install(tolerate);
        self.end_anew(begun);
        self.judge_all();
    }

    /// Takes in all remembered pings again, each corrected against the map of those before it.
    fn begin_again(&mut self) {
        let Some(world) = &self.world else { return };
        // What forgotten pings told cannot be told again: those to come alone are corrected.
        if self.history.forgotten() > 0 {
            return;
        }
        let voxel_m = world.evidence.voxel_m();
        self.history.begin_again();
        self.drift.begin_again();
        self.divide_anew(voxel_m);
    }

    /// Of what a slice added those that are taken in now: as many of those that wait to be taken in again as there is time for,
    /// where there are any.
    fn go_on_again(&mut self, fresh: usize) -> usize {
        if !self.history.is_behind() {
            return fresh;
        }
        let most = fresh + TAKEN_IN_AGAIN;
        let count = self.history.go_on_again(most, self.drift.correction());
        (0..count.saturating_sub(fresh)).for_each(|_| self.allow_work_of_a_ping());
        count
    }

    /// Takes in all that wait to be taken in again.
    pub(super) fn catch_up(&mut self) {
        while self.history.is_behind() {
            self.progress.tell();
            let count = self.go_on_again(0);
            self.take_in_remembered(count);
            self.work();
        }
    }

    /// Gives every ping the correction that follows from the whole dive, and makes anew what was made of them.
    pub(super) fn smooth_poses(&mut self) {
        let Some(world) = &self.world else { return };
        if !self.drift.is_corrected() || self.history.forgotten() > 0 {
            return;
        }
        let (voxel_m, terms) = (world.evidence.voxel_m(), self.terms());
        let field = field_of(world, &self.gaussians);
        let pings = self.history.pings();
        let begun = self.tasks.begin(Task::Drift);
        self.drift.smooth(pings, &field, terms, &self.progress);
        self.tasks
            .end(begun, Counted::of_visits(pings.len() as u64));
        self.history
            .correct_anew(|keyframe| self.drift.found_at(keyframe.time).correction);
        self.divide_anew(voxel_m);
        self.sum_up(usize::MAX);
    }

    /// Learns what the receiver and the vehicle themselves do to pings, and refers them to one gain. Returns what is news and can
    /// be taken over of the power of range that noise grows by, 0 if only something else is.
    fn learn_of_unit(&mut self, slice: &mut [PosedPing]) -> Option<f32> {
        let blanking_m = self.config.blanking_m;
        for PosedPing { ping, .. } in &*slice {
            self.receiver.learn(ping, blank_bins(ping, blanking_m));
        }
        let can_take_over = self.history.forgotten() == 0;
        let settle = || self.receiver.settle(blanking_m + RING_DOWN_M);
        let change = can_take_over.then(settle).flatten();
        let mut has_new_part = false;
        for posed in slice {
            posed.ping = self.receiver.refer(&posed.ping);
            let (ping, at_m) = (&posed.ping, posed.world_from_sensor.translation_m);
            let blank = blank_bins(ping, blanking_m);
            has_new_part |= self
                .own_vehicle
                .learn(ping.settings(), ping.intensity(), at_m, blank);
        }
        change.or_else(|| (has_new_part && can_take_over).then_some(0.0))
    }

    pub(super) fn take_in_slice(&mut self) -> InsertReport {
        let mut slice = std::mem::take(&mut self.waiting);
        slice.sort_by_key(|posed| (posed.ping.transmit_time(), posed.ping.sequence()));
        let begun = self.tasks.begin(Task::Detect);
        let news = self.learn_of_unit(&mut slice);
        self.tasks.end(begun, Counted::default());
        // Strengths kept of pings that were let go stay as those pings said.
        if let Some(change) = news {
            let begun = self.tasks.begin(Task::Anew);
            self.refer_anew(change);
            self.end_anew(begun);
        }
        // What forgotten pings told is told of voxels as they are.
        if self.history.forgotten() == 0
            && let Some(voxel_m) = self.better_voxel_m(&slice)
        {
            self.divide_anew(voxel_m);
        }
        let begun = self.tasks.begin(Task::Detect);
        let fresh = slice.iter().filter(|posed| self.remember(posed)).count();
        self.tasks
            .end(begun, Counted::of_visits(slice.len() as u64));
        let fresh = self.go_on_again(fresh);
        self.take_in_remembered(fresh)
    }

    /// Goes on with the newest `fresh` pings of those remembered.
    fn take_in_remembered(&mut self, fresh: usize) -> InsertReport {
        if self.foretell(fresh) {
            self.begin_again();
        }
        self.forget(fresh);
        self.sum_up(fresh + SUMMED_UP_ANEW);
        let Some(world) = &mut self.world else {
            return InsertReport::default();
        };
        let evidence = &mut world.evidence;
        let strength = SPAWN_STRENGTH * self.unit_strength;
        let spawn = self.config.spawn_evidence;
        let map = &mut self.gaussians;
        let begun = self.tasks.begin(Task::Spawn);
        let (added, pruned) = self
            .pool
            .install(|| from_evidence::spawn_and_prune(evidence, map, spawn, strength));
        self.tasks.end(begun, Counted::of_visits(fresh as u64));
        InsertReport {
            slice_taken_in: true,
            added,
            pruned,
            ..InsertReport::default()
        }
    }
}

/// The confident Gaussians of the map in reach.
pub(super) fn sources(gaussians: &Gaussians, is_in_reach: impl Fn(Vec3) -> bool) -> Vec<Source> {
    let confident = Verdict::Published(Standing::Confident);
    gaussians
        .slots()
        .filter(|&slot| gaussians.verdict[slot] == confident && is_in_reach(gaussians.mean_m[slot]))
        .map(|slot| Source {
            mean_m: gaussians.mean_m[slot],
            covariance_m2: gaussians.covariance_m2[slot],
            strength: gaussians.strongest(slot),
        })
        .collect()
}

/// Whether nothing about a ping's pose could make the map not finite.
fn is_usable(posed: &PosedPing) -> bool {
    // Lengths, since the largest element of some that are none may be one.
    let pose = &posed.world_from_sensor;
    pose.rotation.is_normalized()
        && pose.translation_m.length() < FURTHEST_M
        && posed.twist.linear_mps.length() < FASTEST
        && posed.twist.angular_radps.length() < FASTEST
        && posed.reference_range_m.is_finite()
        && [posed.uncertainty, posed.jitter]
            .into_iter()
            .flatten()
            .all(|u| {
                u.position_m >= 0.0
                    && u.position_m < 1e3
                    && u.attitude_rad >= 0.0
                    && u.attitude_rad < 3.2
            })
}

/// One sigma of where its pose's jitter puts the middle of a ping's range, 0 if nobody looked.
fn jitter_m(posed: &PosedPing) -> f32 {
    let Some(jitter) = posed.jitter else {
        return 0.0;
    };
    jitter
        .position_m
        .hypot(jitter.attitude_rad * posed.reference_range_m) as f32
}

/// One sigma of an echo's range: pulse and pose.
fn range_sigma_m(posed: &PosedPing, config: &MapperConfig) -> f32 {
    pose_blur(posed, config).range_sigma_m(pulse_variance_m2(posed.ping.settings()))
}

/// Echoes light places this much nearer and farther.
fn tolerance_m(voxel_m: f32, range_sigma_m: f32) -> f32 {
    0.45 * voxel_m + 2.2 * range_sigma_m
}

/// Runs of bins by where they begin, each once.
fn in_order(runs: &[&[(u32, u32)]]) -> Box<[(u32, u32)]> {
    let mut all = runs.concat();
    all.sort_unstable();
    all.dedup();
    all.into()
}

/// Quarter of the horizon that a direction is in: ahead, behind, left or right of the first ping's heading, which is in the
/// middle of the first so that no rounding decides where it is.
fn sector_of(direction: Vec3) -> usize {
    let is_sideways = direction.y.abs() > direction.x.abs();
    let along = if is_sideways {
        direction.y
    } else {
        direction.x
    };
    usize::from(along < 0.0) + 2 * usize::from(is_sideways)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looking_ahead_with_a_swing_is_one_side_and_no_rounding_makes_it_two() {
        let towards = |degrees: f32| {
            let (sine, cosine) = degrees.to_radians().sin_cos();
            sector_of(Vec3::new(cosine, sine, 0.1))
        };
        let ahead = towards(0.0);
        assert!([-40.0, -1e-15, 1e-15, 40.0].map(towards) == [ahead; 4]);
        let others = [90.0, 180.0, -90.0].map(towards);
        assert!(others.iter().all(|&other| other != ahead && other < 4));
        assert!(others[0] != others[1] && others[1] != others[2] && others[0] != others[2]);
        assert_eq!(
            sector_of(Vec3::new(-1.0, -0.0, 0.0)),
            sector_of(Vec3::new(-1.0, 0.0, 0.0))
        );
    }
}
