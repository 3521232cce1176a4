//! When tiles are worked out, and how much work a ping allows.

use std::sync::Arc;

use echosplat_model::Snapshot;
use rayon::prelude::*;

use super::Mapper;
use super::intake::sources;
use crate::accumulate::evidence::{Evidence, Tile, TileIndex};
use crate::accumulate::history::History;
use crate::detect::repeats::Repeats;
use crate::effort::{Begun, Counted, Task};
use crate::features::{MapCues, decide};
use crate::mapper::schedule::{Due, Start};
use crate::mapper::workout::{Terms, Workout, keep};
use crate::progress::Progress;
use crate::seabed::Seabed;

/// Fraction, derived: a quarter more observations.
/// Tiles are due when this fraction of what they hold comes from observations that it was not worked out with: a quarter more
/// than it was.
const STALE_FRACTION: f32 = 0.2;
/// Ratio of observations; found.
/// Tiles with so many times the observations are worth working out again.
const GROWN: f32 = 1.05;
/// Ratio of observations; found.
/// Tiles with so many times the observations they had when they were last worked out anew are so again: starts from the map
/// alone would make it ever sharper.
const ANEW: f32 = 4.0;

impl Mapper {
    /// Adds the work that a ping allows.
    pub(super) fn allow_work_of_a_ping(&mut self) {
        if !self.config.live_map && self.history.is_half_empty() {
            return;
        }
        let allowed = self.config.work_pairs_per_ping;
        self.credit_pairs = self.credit_pairs.saturating_add_unsigned(allowed);
    }

    /// Does the work allowed. What finds nothing to do is not saved up: it would come as one long pause. Returns pairs
    /// done.
    pub(super) fn work(&mut self) -> u64 {
        let before = self.status.pairs;
        while self.credit_pairs > 0 {
            let pairs = if self.workout.is_some() {
                self.advance()
            } else if self.untold_pings() == 0 && self.begin_workout(due) {
                self.workout.as_ref().map_or(0, Workout::change_pairs)
            } else {
                self.credit_pairs = 0;
                break;
            };
            self.credit_pairs = self.credit_pairs.saturating_sub_unsigned(pairs);
        }
        self.status.pairs - before
    }

    /// The end of the data: takes in what waits and works out all that was observed since it last was, until nothing is left to
    /// do.
    pub fn finish(&mut self) -> Snapshot {
        if !self.waiting.is_empty() {
            self.take_in_slice();
        }
        self.catch_up();
        // What it was told is in the pings, and its tiles are due still.
        self.workout = None;
        self.sum_up(usize::MAX);
        self.smooth_poses();
        self.judge_anew();
        self.work_all_out();
        if !self.config.live_map && self.finds_surface() {
            self.judge_anew();
            self.work_all_out();
        }
        // Their pings tell of nothing where there was nothing to work out.
        self.gaussians.let_former_go();
        let snapshot = self.publish();
        self.published.forget();
        snapshot
    }

    /// Until nothing is left to do.
    pub(super) fn work_all_out(&mut self) {
        while self.workout.is_some() || self.begin_workout(due_at_end) {
            self.advance();
        }
    }

    /// Asks all remembered pings for images in the water's surface, which could not be asked for as they came: there was no map
    /// then. Whether the surface is found, and was not known.
    fn finds_surface(&mut self) -> bool {
        if self.repeats.surface_m().is_some() {
            return false;
        }
        self.repeats.set_sources(sources(&self.gaussians, |_| true));
        self.repeats.ask_for_surface_anew();
        let begun = self.tasks.begin(Task::Anew);
        for keyframe in self.history.pings() {
            self.progress.tell();
            let intensity: Vec<f32> = keyframe.profile.intensity.iter().collect();
            self.repeats.ask_for_surface(
                &keyframe.geometry,
                &intensity,
                &keyframe.profile,
                keyframe.weight,
            );
        }
        self.end_anew(begun);
        self.repeats.surface_m().is_some()
    }

    /// Judges every ping by what is now known of the seabed and of echoes heard again, and sums up all evidence anew.
    fn judge_anew(&mut self) {
        let knows_more = self.seabed.is_there() || self.repeats.are_known();
        if knows_more && self.history.forgotten() == 0 {
            self.repeats.set_sources(sources(&self.gaussians, |_| true));
            self.judge_all();
            self.sum_up_anew();
        }
    }

    /// Judges every remembered ping by what is now known of the seabed and of echoes heard again.
    pub(super) fn judge_all(&mut self) {
        let (history, seabed, repeats) = (&mut self.history, &self.seabed, &self.repeats);
        let progress = &self.progress;
        let begun = self.tasks.begin(Task::Anew);
        self.pool
            .install(|| judge_all(history, seabed, repeats, progress));
        self.end_anew(begun);
    }

    /// Ends what visited every remembered ping.
    pub(super) fn end_anew(&mut self, begun: Begun) {
        let visits = self.history.pings().len() as u64;
        self.tasks.end(begun, Counted::of_visits(visits));
    }

    /// Remembered pings that evidence was not told of yet: none but where it is summed up anew.
    fn untold_pings(&self) -> usize {
        let world = self.world.as_ref();
        world.map_or(0, |world| world.evidence.untold_pings(&self.history))
    }

    /// Sums up the evidence of pings that it was not told of yet, at most so many.
    pub(super) fn sum_up(&mut self, most: usize) {
        let Some(world) = &mut self.world else { return };
        let (history, extent) = (&self.history, self.at_work.converged);
        let evidence = &mut world.evidence;
        let visits = most.min(evidence.untold_pings(history)) as u64;
        let begun = self.tasks.begin(Task::Evidence);
        let voxel_looks = self
            .pool
            .install(|| evidence.integrate(history, most, extent));
        self.end_evidence(begun, visits, voxel_looks);
    }

    fn end_evidence(&mut self, begun: Begun, visits: u64, voxel_looks: u64) {
        self.status.voxel_observations += voxel_looks;
        let counted = Counted {
            visits,
            voxel_looks,
            ..Counted::default()
        };
        self.tasks.end(begun, counted);
    }

    /// Sums up all evidence anew, unless pings are forgotten, whose evidence cannot be.
    pub(super) fn sum_up_anew(&mut self) {
        let Some(world) = &mut self.world else { return };
        if self.history.forgotten() > 0 {
            return;
        }
        let (history, extent) = (&self.history, self.at_work.converged);
        let (evidence, progress): (&mut Evidence, _) = (&mut world.evidence, &self.progress);
        let begun = self.tasks.begin(Task::Evidence);
        let voxel_looks = self
            .pool
            .install(|| evidence.integrate_anew(history, extent, progress));
        evidence.doubt_all();
        let visits = self.history.pings().len() as u64;
        self.end_evidence(begun, visits, voxel_looks);
    }

    /// Begins to work out what is due; whether there is anything.
    pub(super) fn begin_workout(&mut self, due: fn(&Evidence) -> Option<Due>) -> bool {
        let Some(due) = self.world.as_ref().and_then(|world| due(&world.evidence)) else {
            return false;
        };
        self.decide();
        let terms = Terms {
            config: &self.config,
            at_work: self.at_work,
            unit_strength: self.unit_strength,
        };
        let Some(world) = &self.world else {
            return false;
        };
        let (map, history, left_out) = (&self.gaussians, &self.history, &mut self.left_out);
        let begin = || Workout::begin(world, map, history, due, terms, left_out);
        let begun = self.tasks.begin(Task::Begin);
        let workout = self.pool.install(begin);
        self.tasks.end(begun, of_candidates(workout.held()));
        self.workout = Some(workout);
        self.status.workouts += 1;
        true
    }

    /// Lets go of the oldest pings when there are too many; `recent` of them stay in any case. What they told stays.
    pub(super) fn forget(&mut self, recent: usize) {
        if self.history.is_overfull() {
            self.sum_up(self.untold_pings().saturating_sub(recent));
        }
        let gone = self.history.forget(recent);
        let Some(world) = &mut self.world else { return };
        if gone.is_empty() {
            return;
        }
        world.evidence.forget(&gone);
        // A work-out under way holds indices of blocks.
        if self.workout.is_none() {
            world.evidence.leave();
        }
        let terms = Terms {
            config: &self.config,
            at_work: self.at_work,
            unit_strength: self.unit_strength,
        };
        let map = &mut self.gaussians;
        let begun = self.tasks.begin(Task::Forget);
        let counted = self.pool.install(|| keep(world, map, &gone, terms));
        self.status.pairs += counted.pairs;
        self.tasks.end(begun, counted);
    }

    /// The next portion of what is under way. Returns the pairs that would take as long.
    pub(super) fn advance(&mut self) -> u64 {
        let (Some(mut workout), Some(world)) = (self.workout.take(), &mut self.world) else {
            return 0;
        };
        if workout.is_done() {
            let pairs = workout.change_pairs();
            let (begun, held) = (self.tasks.begin(Task::Change), workout.held());
            self.status.iterations += workout.put_in_place(world, &mut self.gaussians);
            self.foretold.forget_map();
            self.gaussians.let_former_go();
            self.tasks.end(begun, of_candidates(held));
            return pairs;
        }
        let seabed = &self.seabed;
        let begun = self.tasks.begin(workout.task());
        let effort = self.pool.install(|| workout.advance(world, seabed));
        self.tasks.end(begun, effort.counted);
        self.workout = Some(workout);
        self.status.pairs += effort.pairs;
        effort.pairs + effort.beside_pairs
    }

    /// Which features the dive so far asks for.
    fn decide(&mut self) {
        let map = MapCues {
            voxel_m: self.world.as_ref().map_or(0.0, |w| w.evidence.voxel_m()),
            redundant: self.status.pings_redundant,
            interfered_bins: self.status.bins_interfered as f64 / self.status.pings.max(1) as f64,
            is_ground_open: self.seabed.is_there() && !self.seabed.is_proven(),
        };
        (self.at_work, self.left_out) = decide(&self.config.parts, &self.cues, map);
    }
}

/// Work that looks at so many Gaussians and no ping.
fn of_candidates(candidates: u64) -> Counted {
    Counted {
        candidates,
        ..Counted::default()
    }
}

/// While the dive goes on: the tiles with new observations, once enough of what they hold is stale.
fn due(evidence: &Evidence) -> Option<Due> {
    let (mut tiles, mut held, mut stale) = (Vec::new(), 0.0, 0.0);
    let (mut observations, mut even_observations, mut is_remembered) = (0.0, 0.0, true);
    for (index, tile) in evidence.tiles().iter().enumerate() {
        if !(tile.observations > GROWN * tile.worked_observations) {
            continue;
        }
        let blocks = tile.blocks.iter();
        let gaussians = blocks.map(|&block| evidence.block(block).gaussians.len());
        let gaussians = gaussians.sum::<usize>() as f32;
        held += gaussians;
        stale += gaussians * (1.0 - tile.worked_observations / tile.observations);
        observations += gaussians * tile.observations;
        even_observations += gaussians * tile.even_observations;
        is_remembered &= tile.forgotten_observations <= 0.0;
        tiles.push(index as TileIndex);
    }
    let start = match is_remembered && observations > ANEW * even_observations {
        true => Start::Even,
        false => Start::Map,
    };
    let due = Due {
        tiles,
        start,
        // What forgotten pings told cannot be done in full later.
        is_live: is_remembered,
    };
    (stale > STALE_FRACTION * held).then_some(due)
}

/// At the end of the data: all that was observed since it was worked out anew, or since it was worked out where only the map
/// knows what forgotten pings told.
pub(super) fn due_at_end(evidence: &Evidence) -> Option<Due> {
    let of = |is_due: fn(&Tile) -> bool| -> Vec<TileIndex> {
        let tiles = evidence.tiles().iter().enumerate();
        let tiles = tiles.filter(|(_, tile)| is_due(tile));
        tiles.map(|(index, _)| index as TileIndex).collect()
    };
    let in_full = |tiles: Vec<TileIndex>, start: Start| Due {
        tiles,
        start,
        is_live: false,
    };
    let anew =
        of(|tile| tile.forgotten_observations <= 0.0 && tile.observations > tile.even_observations);
    if !anew.is_empty() {
        return Some(in_full(anew, Start::Even));
    }
    let more = of(|tile| {
        tile.forgotten_observations > 0.0 && tile.observations > tile.worked_observations
    });
    (!more.is_empty()).then(|| in_full(more, Start::Map))
}

fn judge_all(history: &mut History, seabed: &Seabed, repeats: &Repeats, progress: &Progress) {
    history.par_pings_mut().for_each(|keyframe| {
        progress.tell();
        let keyframe = Arc::make_mut(keyframe);
        let ground = seabed.backdrop(&keyframe.geometry, keyframe.brightness);
        let intensity: Vec<f32> = keyframe.profile.intensity.iter().collect();
        keyframe.profile.doubted = Box::default();
        keyframe.profile.judge(&intensity, &ground);
        repeats.doubt(
            &keyframe.geometry,
            &intensity,
            &ground,
            &mut keyframe.profile,
        );
    });
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use echosplat_model::glam::{DVec3, Vec3};
    use echosplat_model::{Gaussian, Pose, PosedPing, Standing};

    use super::*;
    use crate::MapperConfig;
    use crate::accumulate::evidence::SectorWidth;
    use crate::detect::posed;
    use crate::spawn::gaussians::Stage;

    /// Of a vehicle that goes by a level rod 4 m away, so much above it, metres.
    fn going_by(number: u32, above_m: f64) -> PosedPing {
        let rod = (16.0 + above_m * above_m).sqrt() / 0.02;
        let power = |bin: u32| match (f64::from(bin) - rod).abs() < 2.0 {
            true => 1000.0,
            false => -((f64::from((bin * 97 + number * 31) % 300) + 0.5) / 300.0).ln() as f32,
        };
        let pose = Pose {
            translation_m: DVec3::new(0.0, 0.01 * f64::from(number), above_m),
            ..Pose::IDENTITY
        };
        posed(number, (0..300).map(power).collect(), pose)
    }

    fn terms(mapper: &Mapper) -> Terms<'_> {
        Terms {
            config: &mapper.config,
            at_work: mapper.at_work,
            unit_strength: mapper.unit_strength,
        }
    }

    #[test]
    fn a_dive_ends_with_nothing_that_was_not_assessed() {
        let mut mapper = Mapper::new(MapperConfig::default()).unwrap();
        for number in 0..40 {
            mapper.insert(&going_by(number, 0.0));
        }
        // Where nothing speaks for a place any more although it was spawned there.
        let evidence = &mut mapper.world.as_mut().unwrap().evidence;
        let index = evidence.tiles()[0].blocks[0];
        let sums = evidence.of(evidence.block(index), SectorWidth::Eighth).0;
        let voxel = (0..sums.len()).min_by(|&a, &b| sums[a].total_cmp(&sums[b]));
        let voxel = voxel.unwrap() as u16;
        let center_m = evidence.center_m(evidence.block(index).key, voxel.into());
        let home = (index, voxel);
        let slot = mapper.gaussians.spawn(center_m, home, 0.05, 1.0);
        evidence.block_mut(index).gaussians.push((voxel, slot));
        let id = mapper.gaussians.id[slot as usize];
        let before = mapper.snapshot();
        assert!(before.gaussians.iter().any(|gaussian| gaussian.id == id));
        let after = mapper.finish();
        assert!(after.gaussians.iter().all(|gaussian| gaussian.id != id));
        assert!(after.gaussians.iter().all(|g| g.sigma_m.is_finite()));
    }

    #[test]
    fn a_long_step_says_that_it_goes_on() {
        let mut mapper = Mapper::new(MapperConfig::default()).unwrap();
        for number in 0..40 {
            mapper.insert(&going_by(number, 0.0));
        }
        let told = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&told);
        mapper.on_progress(move || {
            count.fetch_add(1, Ordering::Relaxed);
        });
        mapper.judge_all();
        let of_pings = told.swap(0, Ordering::Relaxed);
        assert!(of_pings >= 8, "{of_pings}");
        mapper.sum_up_anew();
        let of_blocks = told.load(Ordering::Relaxed) as u64;
        assert_eq!(of_blocks, mapper.status().evidence_blocks);
    }

    /// The same of pings that end at 30 m.
    fn with_long_range(number: u32, above_m: f64) -> PosedPing {
        let near = going_by(number, above_m);
        let mut power = near.ping.intensity().to_vec();
        let noise = power[250..300].to_vec();
        power.extend(noise.iter().cycle().take(1200));
        posed(number, power, near.world_from_sensor)
    }

    #[test]
    fn where_pings_end_far_beyond_what_they_hear_voxels_become_finer_and_nothing_old_stays() {
        let mut mapper = Mapper::new(MapperConfig::default()).unwrap();
        let mut insert = |numbers: std::ops::Range<u32>| {
            for number in numbers {
                let above_m = (0.1 * f64::from(number)).sin();
                mapper.insert(&with_long_range(number, above_m));
            }
            (mapper.status(), mapper.snapshot())
        };
        let (early, coarse) = insert(0..200);
        let (late, _) = insert(200..600);
        assert_eq!(early.working_range_m, None);
        assert!(
            late.working_range_m
                .is_some_and(|m| (4.0..4.3).contains(&m))
        );
        assert!((late.voxel_m / early.voxel_m - 0.5).abs() < 1e-3);
        let fine = mapper.finish();
        let is_old = |gaussian: &Gaussian| coarse.gaussians.iter().any(|old| old.id == gaussian.id);
        assert!(!fine.gaussians.iter().any(is_old));
        // As if voxels had been as fine from the beginning.
        let mut other = Mapper::new(MapperConfig {
            resolution_m: late.voxel_m.into(),
            ..MapperConfig::default()
        })
        .unwrap();
        for number in 0..600 {
            other.insert(&with_long_range(number, (0.1 * f64::from(number)).sin()));
        }
        let asserted = |snapshot: &Snapshot| {
            let all = snapshot.gaussians.iter();
            let confident = all.filter(|g| g.standing == Standing::Confident);
            confident.map(|g| g.mean_m).collect::<Vec<_>>()
        };
        let (fine, other) = (asserted(&fine), asserted(&other.finish()));
        assert!(fine.len() > 20);
        let is_near = |at_m: &Vec3| other.iter().any(|m| m.distance(*at_m) < late.voxel_m);
        let near = fine.iter().filter(|at_m| is_near(at_m)).count();
        // Which places at the rod's ends are asserted is decided by a hair.
        assert!(4 * near >= 3 * fine.len(), "{near} of {}", fine.len());
        let is_on_rod = |at_m: &&Vec3| (at_m.x - 4.0).hypot(at_m.z) < 0.15;
        let on_rod = fine.iter().filter(is_on_rod).count();
        assert!(20 * on_rod >= 19 * fine.len(), "{on_rod} of {}", fine.len());
    }

    #[test]
    fn what_was_found_with_other_voxels_is_shown_until_the_new_ones_are_worked_out() {
        let mut mapper = Mapper::new(MapperConfig {
            resolution_m: 0.07,
            ..MapperConfig::default()
        })
        .unwrap();
        let insert = |mapper: &mut Mapper, number: u32| {
            mapper.insert(&with_long_range(number, (0.1 * f64::from(number)).sin()));
        };
        (0..600).for_each(|number| insert(&mut mapper, number));
        mapper.work_all_out();
        let asserted = |mapper: &mut Mapper| {
            let mut gaussians = mapper.snapshot().gaussians.clone();
            gaussians.retain(|gaussian| gaussian.standing == Standing::Confident);
            gaussians
        };
        let before = asserted(&mut mapper);
        assert!(before.len() > 20, "{}", before.len());
        // Twice, as where nothing is worked out in between.
        mapper.divide_anew(0.09);
        mapper.divide_anew(0.08);
        assert_eq!(asserted(&mut mapper), before);
        // They are in no voxel, and evidence hears of the pings so far a few at a time.
        let is_former = |slot| mapper.gaussians.stage[slot] == Stage::Former;
        assert!(mapper.gaussians.slots().all(is_former));
        let mut slices = 0;
        for number in (600..).take_while(|&number| number < 1200) {
            let waiting = mapper.untold_pings();
            if waiting == 0 {
                break;
            }
            insert(&mut mapper, number);
            slices += u32::from(mapper.untold_pings() < waiting);
            assert!(mapper.workout.is_none());
            assert_eq!(asserted(&mut mapper), before);
        }
        assert!(mapper.untold_pings() == 0 && slices > 10, "{slices}");
        let sums = |mapper: &Mapper| {
            let evidence = &mapper.world.as_ref().unwrap().evidence;
            let blocks = evidence.tiles().iter().flat_map(|tile| &tile.blocks);
            let of = |&index| evidence.of(evidence.block(index), SectorWidth::Eighth).0;
            let observations: Vec<f32> = evidence
                .tiles()
                .iter()
                .map(|tile| tile.observations)
                .collect();
            (blocks.map(of).collect::<Vec<_>>(), observations)
        };
        let piece_by_piece = sums(&mapper);
        mapper.sum_up_anew();
        assert!(piece_by_piece == sums(&mapper));
        assert!(mapper.begin_workout(due_at_end));
        while mapper.workout.is_some() {
            assert_eq!(asserted(&mut mapper), before);
            mapper.advance();
        }
        let after = asserted(&mut mapper);
        let is_old = |gaussian: &Gaussian| before.iter().any(|old| old.id == gaussian.id);
        assert!(after.len() > 20 && !after.iter().any(is_old));
        // What nothing tells of any more is not there for ever.
        mapper.divide_anew(0.07);
        mapper.waiting.clear();
        mapper.history = History::new(1024);
        assert!(mapper.finish().gaussians.is_empty());
    }

    /// Of a vehicle that hovers nearly at one place, so that all its pings see all of the rod.
    fn at_one_place(number: u32) -> PosedPing {
        let mut posed = going_by(number, (0.1 * f64::from(number)).sin());
        posed.world_from_sensor.translation_m.y = 0.02 * (0.05 * f64::from(number)).sin();
        posed
    }

    fn hovering(pings: u32) -> Mapper {
        let mut mapper = Mapper::new(MapperConfig::default()).unwrap();
        (0..pings).for_each(|number| _ = mapper.insert(&at_one_place(number)));
        assert!(
            !mapper.status().drift.is_corrected,
            "{:?}",
            mapper.status().drift
        );
        mapper
    }

    /// A work-out of all tiles.
    fn workout_of_all(mapper: &Mapper, start: Start, is_live: bool) -> Workout {
        let world = mapper.world.as_ref().unwrap();
        let due = Due {
            tiles: (0..world.evidence.tiles().len() as TileIndex).collect(),
            start,
            is_live,
        };
        let (map, history) = (&mapper.gaussians, &mapper.history);
        let mut workout = Workout::begin(world, map, history, due, terms(mapper), &mut Vec::new());
        // Its pairs are counted.
        workout.advance(world, &mapper.seabed);
        workout
    }

    /// Of a vehicle here and there below a surface, 2 m above the rod, by way of which the rod is heard once more.
    fn below_a_surface(number: u32) -> PosedPing {
        // Not evenly, as another sonar's pulses walk.
        let above_m = f64::from(number * 37 % 101) / 50.0 - 1.0;
        let near = going_by(number, above_m);
        let (direct_m, image_m) = (4_f64.hypot(above_m), 4_f64.hypot(4.0 - above_m));
        let image = (0.5 * (direct_m + image_m) / 0.02) as usize;
        let mut power = near.ping.intensity().to_vec();
        let loudest = power.iter().copied().fold(0.0, f32::max);
        power[image - 1..=image + 1].fill(0.1 * loudest);
        let mut pose = near.world_from_sensor;
        // Each ping says something of its own.
        pose.translation_m.y = ((0.05 * f64::from(number)) % 4.0 - 2.0).abs() - 1.0;
        posed(number, power, pose)
    }

    #[test]
    fn where_nobody_looks_work_waits_for_the_end_and_the_surface_is_found_there() {
        let mut mapper = Mapper::new(MapperConfig {
            live_map: false,
            ..MapperConfig::default()
        })
        .unwrap();
        (0..1600).for_each(|number| _ = mapper.insert(&below_a_surface(number)));
        assert_eq!(mapper.status().workouts, 0);
        let map = mapper.finish();
        let surface_m = mapper.status().water_surface_m;
        let error_m = surface_m.map(|surface_m| (surface_m - 2.0).abs());
        assert!(error_m.is_some_and(|m| m < 0.1), "{surface_m:?}");
        let asserted = map.gaussians.iter();
        let asserted = asserted.filter(|gaussian| gaussian.standing == Standing::Confident);
        let places = asserted.map(|gaussian| map.origin_m + gaussian.mean_m.as_dvec3());
        let off: Vec<f64> = places.map(|at| (at.x - 4.0).hypot(at.z)).collect();
        let near = off.iter().filter(|off_m| **off_m < 0.15).count();
        assert!(
            near > 100 && 20 * near >= 19 * off.len(),
            "{near} of {}",
            off.len()
        );
    }

    #[test]
    fn where_nobody_looks_work_begins_before_pings_have_to_go() {
        let mut mapper = Mapper::new(MapperConfig {
            live_map: false,
            history_pings: 400,
            ..MapperConfig::default()
        })
        .unwrap();
        let mut number = 0;
        let mut insert = |mapper: &mut Mapper| {
            mapper.insert(&at_one_place(number));
            number += 1;
        };
        while mapper.history.is_half_empty() {
            assert_eq!(mapper.status().workouts, 0);
            insert(&mut mapper);
        }
        while mapper.status().workouts == 0 && mapper.history.forgotten() == 0 {
            insert(&mut mapper);
        }
        assert_eq!(mapper.history.forgotten(), 0);
    }

    #[test]
    fn a_map_saves_observations_for_its_strengths_and_none_for_its_verdicts() {
        let mapper = hovering(1600);
        let thinning_factors = |start| workout_of_all(&mapper, start, true).thinning_factors();
        let ((of_steps, of_verdicts), (_, of_even_verdicts)) =
            (thinning_factors(Start::Map), thinning_factors(Start::Even));
        assert!(of_steps > 1.5 * of_verdicts, "{of_steps} {of_verdicts}");
        assert!((of_verdicts - of_even_verdicts).abs() < 0.2 * of_even_verdicts);
    }

    #[test]
    fn where_few_pings_see_each_place_a_step_takes_more_of_them() {
        let thinning_factors_after =
            |pings| workout_of_all(&hovering(pings), Start::Even, false).thinning_factors();
        let [(few, few_of_verdicts), (more, _), (many, _)] =
            [100, 300, 1600].map(thinning_factors_after);
        assert!(few < more && more < 1.0, "{few} {more}");
        assert!(many >= 1.0, "{many}");
        assert!(few_of_verdicts >= 1.0);
    }

    #[test]
    fn what_is_done_without_pings_counts_as_work() {
        let mut mapper = Mapper::new(MapperConfig::default()).unwrap();
        for number in 0..300 {
            mapper.insert(&going_by(number, (0.1 * f64::from(number)).sin()));
        }
        let world = mapper.world.as_ref().unwrap();
        let mut workout = workout_of_all(&mapper, Start::Even, false);
        let (mut with_pings, mut without) = (0, Vec::new());
        while !workout.is_done() {
            let effort = workout.advance(world, &mapper.seabed);
            match effort.pairs {
                0 if effort.beside_pairs > 0 => without.push(effort.beside_pairs),
                pairs => with_pings += pairs,
            }
        }
        assert!(with_pings > 0 && workout.change_pairs() > 0);
        // Filled again, verdicts twice, and split or laid along the surface.
        assert!(without.len() >= 4, "{without:?}");
        assert_eq!(without.last(), Some(&workout.change_pairs()));
    }

    #[test]
    fn what_was_let_go_is_tried_again_at_the_end_alone_unless_something_is_beside_it() {
        let mut mapper = Mapper::new(MapperConfig::default()).unwrap();
        for number in 0..300 {
            mapper.insert(&going_by(number, (0.1 * f64::from(number)).sin()));
        }
        assert!(!mapper.finish().gaussians.is_empty());
        let candidates = |start, is_live| workout_of_all(&mapper, start, is_live).candidate_count();
        let (live, at_end) = (candidates(Start::Map, true), candidates(Start::Map, false));
        assert!(0 < live && live < at_end, "{live} of {at_end}");
        assert_eq!(candidates(Start::Even, true), at_end);
    }
}
