//! Clock, mount, compass and sound by the dive so far: by what its own map leaves to see, and, of what that finds off and of
//! sound, by maps of it as it is and as it would be with other ones.

use std::sync::Arc;

use echosplat_measurement::heard::Detail;
use echosplat_model::Switch;
use echosplat_model::glam::Vec3;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::{Mapper, SPAWN_STRENGTH};
use crate::accumulate::history::{History, Keyframe};
use crate::calibrate::sound::{self, Blocks};
use crate::calibrate::{
    Calibration, Compass, Difference, Estimate, Landmarks, Moving, RANGE, Step, Verdict, corrected,
    evenly, moving, places,
};
use crate::effort::{Counted, Task, TaskEnd};
use crate::features::Features;
use crate::refine::field::Field;
use crate::refine::terms::PassTerms;
use crate::refine::visibility::Sight;
use crate::spawn::from_evidence;
use crate::spawn::gaussians::Stage;
use crate::world::World;
use crate::{ConfigError, MapperConfig};

/// Pings of a map for landmarks; bounds work.
/// Pings that such a map is made of, and its work.
const MAP_PINGS: usize = 2048;
/// Pings of a map for ranges; found.
/// With half as many pings as for landmarks, they still leave less of the speed of sound open than the thickness of what is
/// heard does.
const RANGES_MAP_PINGS: usize = 1024;
/// Pairs of such a map; bounds work.
const MAP_PAIRS: u64 = 300_000_000;
/// Fraction of pings, found: the rest compares maps.
/// Most of the pings that go into it; the rest is for comparing maps on.
const MAP_FRACTION: f64 = 0.75;
/// Pings held out; bounds work.
/// Most pings that maps are compared on.
const MOST_HELD_OUT: usize = 2048;
/// Values tried, a map each; bounds work.
/// Most values that are tried, each with a map of its own.
const TRIALS: usize = 4;

/// What a map is made for. Maps of one kind alone are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Purpose {
    /// To see its landmarks. Places that few observations lit would take up some of what poses have wrong.
    Landmarks,
    /// To see how long ranges are, with places that few observations lit where the dive expects specular returns: a body's sides
    /// are seen by few, and by near sides alone ranges look short.
    Ranges,
}

impl Purpose {
    fn most_pings(self) -> usize {
        match self {
            Self::Landmarks => MAP_PINGS,
            Self::Ranges => RANGES_MAP_PINGS,
        }
    }
}

/// How closely a dive is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Questions {
    /// Maps of their own are made where its own map shows more off than it does of dives with nothing off; of the speed of sound
    /// none.
    InPassing,
    /// The same, of the speed of sound too.
    AtEnd,
    /// Maps are made where its own map shows anything off, and of the speed of sound in any case.
    InFull,
}

/// What a dive so far tells of its clock, its mount and the speed of sound; apart from the mapper it came from, so
/// that it may be asked on another thread.
#[derive(Debug)]
pub struct Calibrator {
    pings: Vec<Arc<Keyframe>>,
    own: OwnMap,
    blank: Mapper,
}

impl Mapper {
    /// What is remembered of the dive, without a copy of its pings. `None` before the first.
    #[must_use]
    pub fn calibrator(&self) -> Option<Calibrator> {
        Some(Calibrator {
            pings: self.history.pings().to_vec(),
            own: self.own_map(self.world.as_ref()?),
            blank: self.emptied(Arc::clone(&self.pool))?,
        })
    }

    /// The same without anything that pings told of places. Its maps are for comparing: finer Gaussians would tell no more
    /// of what is off.
    fn emptied(&self, pool: Arc<ThreadPool>) -> Option<Self> {
        let mut config = MapperConfig {
            workout_pairs: self.config.workout_pairs.min(MAP_PAIRS),
            ..self.config.clone()
        };
        config.parts = Features {
            splitting: Switch::Off,
            ..self.config.parts.for_comparison()
        };
        let mut empty = Self::with_threads(config, pool);
        empty.world = Some(self.world.as_ref()?.emptied());
        empty.levels = self.levels.clone();
        empty.cues = self.cues.clone();
        empty.at_work = self.at_work;
        empty.unit_strength = self.unit_strength;
        Some(empty)
    }

    /// What it holds that was worked out, ready for pings.
    fn own_map(&self, world: &World) -> OwnMap {
        let is_worked = |&slot: &usize| self.gaussians.stage[slot] == Stage::Worked;
        let worked = self.gaussians.slots().filter(is_worked);
        OwnMap {
            field: Field::of_these(&world.evidence, &self.gaussians, worked),
            places_m: places(&self.gaussians),
        }
    }
}

impl Calibrator {
    /// As [`Mapper::on_task`], of the tasks of its maps, on the thread that makes them.
    pub fn on_task(&mut self, begin: impl Fn(Task) -> TaskEnd + Send + Sync + 'static) {
        self.blank.tasks.told_to(begin);
    }

    /// What is wrong, one thing after the other, the surest first, and then the speed of sound if it is asked; `None` if
    /// the dive does not tell. On one thread, which has the priority of the calling one.
    ///
    /// Cost: where the own map shows nothing off, a visit to at most 8,192 pings; else a map of at most 2,048 pings, and one
    /// more for each value tried. Where the speed of sound is asked, three maps of 1,024 pings, or more if it is far off.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn run(mut self, questions: Questions) -> Result<Option<Calibration>, ConfigError> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(1)
            .thread_name(|_| "calibrator".to_owned())
            .build()
            .map_err(|error| ConfigError::Threads(error.to_string()))?;
        self.blank.pool = Arc::new(pool);
        let pool = Arc::clone(&self.blank.pool);
        Ok(pool.install(|| self.estimate(questions)))
    }

    fn estimate(&self, questions: Questions) -> Option<Calibration> {
        let told = moving(&self.pings);
        let (mut seen, mut verdict) = (self.own.seen(&told, &self.blank)?, Verdict::default());
        if questions != Questions::InFull {
            seen = seen.of_own_map();
        }
        let range_m = mean_range_m(&told)?;
        let shown = seen.as_told.sound();
        if self.step(&seen, &verdict).is_some() {
            (seen, verdict) = self.tried(&told)?;
        }
        let sound = match questions {
            Questions::InPassing => None,
            Questions::AtEnd if !sound::is_worth_asking(shown, range_m) => None,
            Questions::AtEnd | Questions::InFull => self.sound(&told, range_m, &verdict),
        };
        if let Some(sound) = sound.filter(|sound| sound.is_believed) {
            verdict.values[RANGE] = sound.value;
            let corrected = corrected(&told, &verdict.values);
            seen = Trial::of(&self.blank, corrected)?.seen;
        }
        let compass = seen.deviating.compass(&verdict, self.axis_rad());
        let sound = sound.unwrap_or_else(|| sound::by_own_map(shown));
        Some(seen.as_told.told(&verdict, sound, compass))
    }

    /// What to try next, if anything seems to be off, and whether the compass is taken for true beside it.
    fn step(&self, seen: &Seen, verdict: &Verdict) -> Option<(Step, Compass)> {
        // Where poses smear echoes their own errors go with the heading by chance, and likelihoods are not those of echoes.
        let is_asked = !self.blank.at_work.smeared;
        let compass = match is_asked && seen.deviating.is_compass_off(verdict) {
            true => Compass::Deviates,
            false => Compass::True,
        };
        let step = seen.difference(compass).most_off(verdict, compass)?;
        Some((step, compass))
    }

    /// What a map of its own leaves to see once all that is off was tried, and what was believed of it.
    fn tried(&self, told: &[Moving]) -> Option<(Seen, Verdict)> {
        let (mut best, mut verdict) = (Trial::of(&self.blank, told.to_vec())?, Verdict::default());
        for _ in 0..TRIALS {
            let Some((step, compass)) = self.step(&best.seen, &verdict) else {
                break;
            };
            let trial = Trial::of(&self.blank, corrected(told, &verdict.after(&step)))?;
            let gain = trial.mapped.more_likely(&best.mapped);
            let (before, after) = (
                best.seen.difference(compass),
                trial.seen.difference(compass),
            );
            if verdict.judge(&step, before, after, gain) {
                best = trial;
            }
        }
        Some((best.seen, verdict))
    }

    /// Heading of the map's x axis.
    fn axis_rad(&self) -> f64 {
        let world = self.blank.world.as_ref();
        world.map_or(0.0, World::axis_rad)
    }

    /// The most likely speed of sound with what else was believed. A map of few pings may be better than another by chance, so
    /// that what would be believed is asked once more of maps of other pings.
    fn sound(&self, told: &[Moving], range_m: f64, verdict: &Verdict) -> Option<Estimate> {
        let blocks = |told: &[Moving], fraction: f64| {
            let mut values = verdict.values;
            values[RANGE] = fraction;
            let moving = corrected(told, &values);
            Some(Mapped::of(&self.blank, Purpose::Ranges, moving)?.blocks())
        };
        let first = sound::most_likely(range_m, |fraction| blocks(told, fraction))?;
        // Where poses smear echoes the likelihood is not that of the echoes.
        let is_likelihood = !self.blank.at_work.smeared;
        if !(is_likelihood && first.is_off()) {
            return Some(first.told(is_likelihood));
        }
        // Those that the first maps were made of are held out now, and most of the others were.
        let others = told.get(1..)?;
        let second = sound::most_likely(range_m, |fraction| blocks(others, fraction))?;
        Some(first.and(second).told(true))
    }
}

/// Of all bins that hold echoes; `None` if there are none.
fn mean_range_m(moving: &[Moving]) -> Option<f64> {
    let (mut sum_m, mut count) = (0.0, 0.0);
    for moving in moving {
        let geometry = &moving.keyframe.geometry;
        for &(start, end) in &moving.keyframe.profile.echoes {
            let (bins, middle) = (f64::from(end - start), 0.5 * f64::from(start + end));
            sum_m += bins
                * (f64::from(geometry.range_start_m) + middle * f64::from(geometry.bin_length_m));
            count += bins;
        }
    }
    (sum_m > 0.0).then(|| sum_m / count)
}

/// A map that pings are held against.
#[derive(Debug)]
struct OwnMap {
    field: Field,
    places_m: Vec<Vec3>,
}

/// What a map leaves to see.
#[derive(Debug, Clone, Copy)]
struct Seen {
    /// With headings as told.
    as_told: Difference,
    /// With a compass that deviates.
    deviating: Difference,
}

impl Seen {
    /// With what any dive's own map shows off although nothing is.
    fn of_own_map(self) -> Self {
        Self {
            as_told: self.as_told.of_own_map(),
            deviating: self.deviating.of_own_map(),
        }
    }

    fn difference(&self, compass: Compass) -> &Difference {
        match compass {
            Compass::True => &self.as_told,
            Compass::Deviates => &self.deviating,
        }
    }
}

impl OwnMap {
    /// What it leaves to see of these pings.
    fn seen(&self, moving: &[Moving], mapper: &Mapper) -> Option<Seen> {
        let begun = mapper.tasks.begin(Task::Compare);
        let map = Some((&self.field, mapper.at_work));
        let heard = Landmarks::find(moving, &self.places_m, None);
        let predicted = Landmarks::find(moving, &self.places_m, map);
        begun.tell(Counted {
            times: 1,
            visits: 2 * moving.len() as u64,
            ..Counted::default()
        });
        let difference = |compass: Compass| {
            let predicted = predicted.estimate(compass)?;
            Some(Difference::of(&heard.estimate(compass)?, &predicted))
        };
        Some(Seen {
            as_told: difference(Compass::True)?,
            deviating: difference(Compass::Deviates)?,
        })
    }
}

/// A map of the dive with some poses and ranges.
struct Mapped {
    map: Mapper,
    purpose: Purpose,
    moving: Vec<Moving>,
}

/// Such a map, and what it leaves to see.
struct Trial {
    mapped: Mapped,
    seen: Seen,
}

impl Trial {
    fn of(blank: &Mapper, moving: Vec<Moving>) -> Option<Self> {
        let mapped = Mapped::of(blank, Purpose::Landmarks, moving)?;
        let own = mapped.map.own_map(mapped.map.world.as_ref()?);
        let seen = own.seen(&mapped.moving, &mapped.map)?;
        Some(Self { mapped, seen })
    }
}

impl Mapped {
    fn of(blank: &Mapper, purpose: Purpose, moving: Vec<Moving>) -> Option<Self> {
        let map = mapped(blank, purpose, &moving)?;
        Some(Self {
            map,
            purpose,
            moving,
        })
    }

    /// Likelihood gain over another on held-out pings, in standard errors over blocks of time.
    fn more_likely(&self, other: &Self) -> f64 {
        let theirs = other.blocks();
        let gains = self.blocks().into_iter();
        let gains: Vec<f64> = gains
            .map(|(block, mine)| mine - theirs.get(&block).copied().unwrap_or(0.0))
            .collect();
        let count = gains.len() as f64;
        let mean = gains.iter().sum::<f64>() / count;
        let square = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>();
        mean / (square / (count * (count - 1.0))).sqrt()
    }

    /// Log likelihood of the held-out pings.
    fn blocks(&self) -> Blocks {
        let Some(world) = &self.map.world else {
            return Blocks::new();
        };
        let terms = PassTerms {
            is_blurred: false,
            at_work: self.map.at_work,
        };
        let field = Field::of(&world.evidence, &self.map.gaussians);
        let (_, held) = split(self.purpose, &self.moving);
        let held: Vec<&Moving> = evenly(&held, MOST_HELD_OUT).copied().collect();
        let begun = self.map.tasks.begin(Task::Compare);
        let of_ping = |sight: &mut Sight, moving: &Moving| {
            sight.observe(&moving.keyframe, terms, &field, Detail::Strength);
            (moving.block, sight.log_likelihood())
        };
        let likelihoods: Vec<(u32, f64)> = held
            .par_iter()
            .map_init(Sight::default, |sight, moving| of_ping(sight, moving))
            .collect();
        begun.tell(Counted {
            times: 1,
            visits: held.len() as u64,
            ..Counted::default()
        });
        let mut blocks = Blocks::new();
        for (block, likelihood) in likelihoods {
            *blocks.entry(block).or_default() += likelihood;
        }
        blocks
    }
}

/// The map of some of the pings that are not held out.
fn mapped(blank: &Mapper, purpose: Purpose, moving: &[Moving]) -> Option<Mapper> {
    let mut map = blank.emptied(Arc::clone(&blank.pool))?;
    map.tasks = blank.tasks.anew();
    if purpose == Purpose::Ranges && blank.at_work.specular_returns {
        map.config.parts.glints = Switch::On;
    }
    let (used, _) = split(purpose, moving);
    let (count, stride) = (used.len(), moving.len() as f32 / used.len().max(1) as f32);
    map.history = History::new(count.max(1));
    for moving in used {
        let keyframe = &moving.keyframe;
        // Those left out in between said some of it.
        let weight = (keyframe.weight * stride).min(1.0);
        map.history.push(Keyframe {
            weight,
            ..Keyframe::clone(keyframe)
        });
    }
    let extent = map.at_work.converged;
    let begun = map.tasks.begin(Task::Evidence);
    let evidence = &mut map.world.as_mut()?.evidence;
    map.status.voxel_observations = evidence.integrate_anew(&map.history, extent, &map.progress);
    let counted = Counted {
        visits: count as u64,
        voxel_looks: map.status.voxel_observations,
        ..Counted::default()
    };
    map.tasks.end(begun, counted);
    let (spawn, strength) = (
        map.config.spawn_evidence,
        SPAWN_STRENGTH * map.unit_strength,
    );
    from_evidence::spawn_and_prune(evidence, &mut map.gaussians, spawn, strength);
    map.work_all_out();
    // Two such maps are held while they are compared, and only their Gaussians are.
    map.world.as_mut()?.evidence.forget_observations();
    Some(map)
}

/// Those that maps are made of, and those that they are compared on.
fn split(purpose: Purpose, moving: &[Moving]) -> (Vec<&Moving>, Vec<&Moving>) {
    let fraction = (purpose.most_pings() as f64 / moving.len() as f64).min(MAP_FRACTION);
    let is_used = |index: usize| {
        ((index + 1) as f64 * fraction) as usize > (index as f64 * fraction) as usize
    };
    let (used, held): (Vec<_>, Vec<_>) = moving
        .iter()
        .enumerate()
        .partition(|&(index, _)| is_used(index));
    let of = |chosen: Vec<(usize, _)>| chosen.into_iter().map(|(_, moving)| moving).collect();
    (of(used), of(held))
}

#[cfg(test)]
mod tests {
    use echosplat_model::Pose;
    use echosplat_model::glam::DVec3;

    use super::*;
    use crate::detect::posed;

    #[test]
    fn all_maps_of_a_kind_expect_specular_returns_or_none_does() {
        let mut mapper = Mapper::new(MapperConfig::default()).unwrap();
        for number in 0..200 {
            let power = |bin: u32| match bin.abs_diff(200) < 2 {
                true => 1000.0,
                false => 1.0 + ((bin * 97 + number * 31) % 7) as f32,
            };
            let pose = Pose {
                translation_m: DVec3::new(0.0, 0.01 * f64::from(number), 0.0),
                ..Pose::IDENTITY
            };
            mapper.insert(&posed(number, (0..300).map(power).collect(), pose));
        }
        mapper.finish();
        assert!(mapper.at_work.specular_returns && mapper.config.parts.glints == Switch::Auto);
        let calibrator = mapper.calibrator().unwrap();
        let told = moving(&calibrator.pings);
        let of = |purpose: Purpose| {
            let map = mapped(&calibrator.blank, purpose, &told).unwrap();
            (map.config.parts.glints, map.at_work.specular_returns)
        };
        assert_eq!(of(Purpose::Landmarks), (Switch::Off, false));
        assert_eq!(of(Purpose::Ranges), (Switch::On, true));
    }
}
