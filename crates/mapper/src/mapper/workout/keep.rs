//! What pings told before they are forgotten.

use std::sync::Arc;

use super::Terms;
use crate::accumulate::history::Past;
use crate::classify::assess::{Demand, Desk, Rule, findings_of_ping};
use crate::refine::expectation::{Pass, strengths_of_ping};
use crate::refine::inherit::{area_of, whole_area};
use crate::refine::scene::Scene;
use crate::spawn::gaussians::{Gaussians, Stage};
use crate::world::World;

/// Adds what pings tell of each Gaussian that was worked out to what it keeps, before they are forgotten.
pub(crate) fn keep(
    world: &World,
    map: &mut Gaussians,
    pings: &[Arc<Past>],
    terms: Terms<'_>,
) -> u64 {
    let scene = |gaussians, is_blurred| Scene {
        evidence: &world.evidence,
        gaussians,
        floor: terms.floor,
        is_blurred,
        at_work: terms.at_work,
    };
    let count = pings.len();
    let mut pass = Pass::over(pings.to_vec(), &world.evidence, map);
    pass.advance(scene(map, false), count, strengths_of_ping);
    let (sums, pairs, _) = pass.finish();
    let rule = Rule::of(&scene(map, true), Demand::of(terms.config, terms.at_work));
    let mut pass = Pass::over(pings.to_vec(), &world.evidence, map);
    let each = |tally: &mut _, desk: &mut Desk, past: &_, sight: &_| {
        findings_of_ping(tally, desk, past, sight, map, rule);
    };
    pass.advance(scene(map, true), count, each);
    let (findings, more_pairs, _) = pass.finish();
    let whole = whole_area(world.evidence.voxel_m());
    for slot in 0..map.slot_count() {
        let is_told = sums[slot].weight.sum() > 0.0 || findings[slot].account.looks > 0.0;
        if map.alive[slot] && map.stage[slot] == Stage::Worked && is_told {
            let (area, part) = (area_of(map, slot) / whole, map.part[slot]);
            let kept = map.kept[slot].get_or_insert_default();
            kept.add(sums[slot].weight, &findings[slot], area, part);
        }
    }
    pairs + more_pairs
}
