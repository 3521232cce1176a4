//! How likely the map makes pings that it has not taken in yet: how good it is, where none is kept from it.

use serde::Serialize;

use super::Mapper;
use crate::effort::{Counted, Task};
use crate::refine::field::Field;
use crate::refine::terms::PassTerms;
use crate::refine::visibility::Sight;
use crate::spawn::gaussians::{Gaussians, Stage};
use crate::world::World;
use echosplat_measurement::heard::Detail;

/// Pings; bounds work.
/// One ping in so many is foretold: those beside it would say nearly the same.
const EVERY: u64 = 8;

/// What pings said of the map as it was before they came, all of the dive so far.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Foretold {
    /// Pings that were foretold.
    pub pings: u64,
    /// Their bins that count.
    pub bins: u64,
    /// Mean log likelihood of a bin, above that of noise and ground alone, nats: above 0 the map says something.
    pub gain_nats_per_bin: f64,
}

/// The map as it was last worked out, and what it foretold.
#[derive(Debug, Default)]
pub(super) struct Foretelling {
    /// None where the map has changed since.
    field: Option<Field>,
    sight: Sight,
    pings: u64,
    bins: u64,
    gain_nats: f64,
}

impl Foretelling {
    /// The map is another one now.
    pub(super) fn forget_map(&mut self) {
        self.field = None;
    }

    pub(super) fn told(&self) -> Foretold {
        Foretold {
            pings: self.pings,
            bins: self.bins,
            gain_nats_per_bin: match self.bins {
                0 => 0.0,
                bins => self.gain_nats / bins as f64,
            },
        }
    }
}

/// The map as it was last worked out.
pub(super) fn field_of(world: &World, gaussians: &Gaussians) -> Field {
    let is_worked = |&slot: &usize| gaussians.stage[slot] == Stage::Worked;
    let worked = gaussians.slots().filter(is_worked);
    Field::of_these(&world.evidence, gaussians, worked)
}

impl Mapper {
    /// With what pings are compared with the map.
    pub(super) fn terms(&self) -> PassTerms {
        PassTerms {
            is_blurred: false,
            at_work: self.at_work,
        }
    }

    /// Asks the newest `fresh` pings, of which the map was told nothing yet. Whether poses are corrected from now on, and were not
    /// before.
    ///
    /// Cost: one visit for every eighth ping and what [`crate::drift`] takes, and a copy of the map after each work-out.
    pub(super) fn foretell(&mut self, fresh: usize) -> bool {
        let Some(world) = &self.world else {
            return false;
        };
        let pings = self.history.pings();
        let terms = self.terms();
        let mut opens = false;
        for keyframe in &pings[pings.len() - fresh..] {
            let (is_asked, is_complete) =
                (keyframe.sequence % EVERY == 0, self.drift.gather(keyframe));
            if !(is_asked || is_complete) {
                continue;
            }
            let gaussians = &self.gaussians;
            let told = &mut self.foretold;
            let field = told.field.get_or_insert_with(|| field_of(world, gaussians));
            if is_complete {
                let begun = self.tasks.begin(Task::Drift);
                let (is_opened, visits) = self.drift.follow(field, terms);
                self.tasks.end(begun, Counted::of_visits(visits));
                opens |= is_opened;
            }
            if !is_asked || field.slots().is_empty() {
                continue;
            }
            told.sight.observe(keyframe, terms, field, Detail::Strength);
            let (gain_nats, bins) = told.sight.gain_over_noise(keyframe);
            told.pings += 1;
            told.bins += bins;
            told.gain_nats += gain_nats;
        }
        opens
    }
}

#[cfg(test)]
mod tests {
    use echosplat_model::Pose;
    use echosplat_model::glam::DVec3;

    use super::*;
    use crate::MapperConfig;
    use crate::detect::posed;

    /// Of a vehicle that goes up and down and to and fro beside a level rod, which it hears so many bins later than it is.
    fn beside_a_rod(number: u32, later_bins: u32) -> echosplat_model::PosedPing {
        let above_m = (0.1 * f64::from(number)).sin();
        let rod = (16.0 + above_m * above_m).sqrt() / 0.02 + f64::from(later_bins);
        let power = |bin: u32| match (f64::from(bin) - rod).abs() < 2.0 {
            true => 1000.0,
            false => -((f64::from((bin * 97 + number * 31) % 300) + 0.5) / 300.0).ln() as f32,
        };
        let pose = Pose {
            translation_m: DVec3::new(0.0, 0.3 * (0.05 * f64::from(number)).sin(), above_m),
            ..Pose::IDENTITY
        };
        posed(number, (0..300).map(power).collect(), pose)
    }

    #[test]
    fn a_map_foretells_what_it_holds_and_is_told_where_it_is_wrong() {
        let mut mapper = Mapper::new(MapperConfig::default()).unwrap();
        let none = mapper.status().foretold;
        assert_eq!((none.pings, none.bins), (0, 0));
        (0..400).for_each(|number| _ = mapper.insert(&beside_a_rod(number, 0)));
        mapper.work_all_out();
        let gain_of = |mapper: &mut Mapper, numbers: std::ops::Range<u32>, later_bins: u32| {
            let before = mapper.status().foretold;
            numbers.for_each(|number| _ = mapper.insert(&beside_a_rod(number, later_bins)));
            let after = mapper.status().foretold;
            let nats = |told: &Foretold| told.gain_nats_per_bin * told.bins as f64;
            assert!(after.pings > before.pings);
            (nats(&after) - nats(&before)) / (after.bins - before.bins) as f64
        };
        let right = gain_of(&mut mapper, 400..432, 0);
        let wrong = gain_of(&mut mapper, 432..464, 40);
        assert!(right > 0.02, "{right}");
        assert!(wrong < 0.5 * right, "{wrong} {right}");
    }
}
