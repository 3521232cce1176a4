//! Clock, mount, compass and sound by the dive so far: maps of it as it is and as it would be with other ones.

use std::sync::Arc;

use echosplat_acoustics::heard::Detail;
use echosplat_model::Switch;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::{Mapper, SPAWN_STRENGTH};
use crate::accumulate::history::{History, Keyframe};
use crate::calibrate::sound::{self, Blocks};
use crate::calibrate::{
    Calibration, Compass, Difference, Estimate, Landmarks, Moving, RANGE, Verdict, corrected,
    moving,
};
use crate::features::Features;
use crate::refine::field::Field;
use crate::refine::scene::Scene;
use crate::refine::visibility::Sight;
use crate::spawn::from_evidence;
use crate::world::World;
use crate::{ConfigError, MapperConfig};

/// Pings of such a map; bounds work.
/// Pings that such a map is made of, and its work.
const MAP_PINGS: usize = 2048;
/// Pairs of such a map; bounds work.
const MAP_PAIRS: u64 = 300_000_000;
/// Fraction of pings, found: the rest compares maps.
/// Most of the pings that go into it; the rest is for comparing maps on.
const MAP_FRACTION: f64 = 0.75;
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

/// What a dive so far tells of its clock, its mount and the speed of sound; apart from the mapper it came from, so
/// that it may be asked on another thread.
#[derive(Debug)]
pub struct Calibrator {
    pings: Vec<Arc<Keyframe>>,
    blank: Mapper,
}

impl Mapper {
    /// What is remembered of the dive, without a copy of its pings. `None` before the first.
    #[must_use]
    pub fn calibrator(&self) -> Option<Calibrator> {
        Some(Calibrator {
            pings: self.history.pings().to_vec(),
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

    fn scene<'a>(&'a self, world: &'a World) -> Scene<'a> {
        Scene {
            evidence: &world.evidence,
            gaussians: &self.gaussians,
            is_blurred: false,
            at_work: self.at_work,
        }
    }
}

impl Calibrator {
    /// What is wrong, one thing after the other, the surest first, and then the speed of sound; `None` if the dive does
    /// not tell. On one thread, which has the priority of the calling one.
    ///
    /// Cost: four maps of at most 2,048 pings where nothing is off, one more for each value tried.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn run(mut self) -> Result<Option<Calibration>, ConfigError> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(1)
            .thread_name(|_| "calibrator".to_owned())
            .build()
            .map_err(|error| ConfigError::Threads(error.to_string()))?;
        self.blank.pool = Arc::new(pool);
        let pool = Arc::clone(&self.blank.pool);
        Ok(pool.install(|| self.estimate()))
    }

    fn estimate(&self) -> Option<Calibration> {
        let told = moving(&self.pings);
        let mut best = Trial::of(&self.blank, told.clone())?;
        let mut verdict = Verdict::default();
        // Where poses smear echoes their own errors go with the heading by chance, and likelihoods are not those of echoes.
        let is_asked = !self.blank.at_work.smeared;
        for _ in 0..TRIALS {
            let compass = match is_asked && best.deviating.is_compass_off(&verdict) {
                true => Compass::Deviates,
                false => Compass::True,
            };
            let Some(step) = best.difference(compass).most_off(&verdict, compass) else {
                break;
            };
            let trial = Trial::of(&self.blank, corrected(&told, &verdict.after(&step)))?;
            let gain = trial.mapped.more_likely(&best.mapped);
            let (before, after) = (best.difference(compass), trial.difference(compass));
            if verdict.judge(&step, before, after, gain) {
                best = trial;
            }
        }
        // Without its map: maps for sound need the room.
        let (mut as_told, mut deviating) = best.differences();
        let sound = self.sound(&told, &verdict);
        if let Some(sound) = sound.filter(|sound| sound.is_believed) {
            verdict.values[RANGE] = sound.value;
            let corrected = corrected(&told, &verdict.values);
            (as_told, deviating) = Trial::of(&self.blank, corrected)?.differences();
        }
        let compass = deviating.compass(&verdict, self.axis_rad());
        let sound = sound.unwrap_or(sound::ANY_WATER);
        Some(as_told.told(&verdict, sound, compass))
    }

    /// Heading of the map's x axis.
    fn axis_rad(&self) -> f64 {
        let world = self.blank.world.as_ref();
        world.map_or(0.0, World::axis_rad)
    }

    /// The most likely speed of sound with what else was believed. A map of few pings may be better than another by chance, so
    /// that what would be believed is asked once more of maps of other pings.
    fn sound(&self, told: &[Moving], verdict: &Verdict) -> Option<Estimate> {
        let range_m = mean_range_m(told)?;
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

/// A map of the dive with some poses and ranges.
struct Mapped {
    map: Mapper,
    moving: Vec<Moving>,
}

/// Such a map, and what it leaves to see.
struct Trial {
    mapped: Mapped,
    /// With headings as told.
    as_told: Difference,
    /// With a compass that deviates.
    deviating: Difference,
}

impl Trial {
    fn of(blank: &Mapper, moving: Vec<Moving>) -> Option<Self> {
        let mapped = Mapped::of(blank, Purpose::Landmarks, moving)?;
        let Mapped { map, moving } = &mapped;
        let scene = map.scene(map.world.as_ref()?);
        let heard = Landmarks::find(moving, scene, false);
        let predicted = Landmarks::find(moving, scene, true);
        let difference = |compass: Compass| {
            let predicted = predicted.estimate(compass)?;
            Some(Difference::of(&heard.estimate(compass)?, &predicted))
        };
        Some(Self {
            as_told: difference(Compass::True)?,
            deviating: difference(Compass::Deviates)?,
            mapped,
        })
    }

    /// As told and with a compass that deviates, without the map.
    fn differences(self) -> (Difference, Difference) {
        (self.as_told, self.deviating)
    }

    fn difference(&self, compass: Compass) -> &Difference {
        match compass {
            Compass::True => &self.as_told,
            Compass::Deviates => &self.deviating,
        }
    }
}

impl Mapped {
    fn of(blank: &Mapper, purpose: Purpose, moving: Vec<Moving>) -> Option<Self> {
        let map = mapped(blank, purpose, &moving)?;
        Some(Self { map, moving })
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
        let scene = self.map.scene(world);
        let field = Field::of(&world.evidence, &self.map.gaussians);
        let (_, held) = split(&self.moving);
        let of_ping = |sight: &mut Sight, moving: &Moving| {
            sight.observe(&moving.keyframe, scene, &field, Detail::Strength);
            (moving.block, sight.log_likelihood())
        };
        let likelihoods: Vec<(u32, f64)> = held
            .par_iter()
            .map_init(Sight::default, |sight, moving| of_ping(sight, moving))
            .collect();
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
    if purpose == Purpose::Ranges && blank.at_work.specular_returns {
        map.config.parts.glints = Switch::On;
    }
    let (used, _) = split(moving);
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
    let evidence = &mut map.world.as_mut()?.evidence;
    map.status.voxel_observations = evidence.integrate_anew(&map.history, extent, &map.progress);
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
fn split(moving: &[Moving]) -> (Vec<&Moving>, Vec<&Moving>) {
    let fraction = (MAP_PINGS as f64 / moving.len() as f64).min(MAP_FRACTION);
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
