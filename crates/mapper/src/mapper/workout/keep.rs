//! What pings told before they are forgotten.

use std::sync::Arc;

use echosplat_measurement::heard::Detail;

use super::Terms;
use crate::accumulate::history::Keyframe;
use crate::classify::assess::{Desk, Rule, VerdictThresholds, findings_of_ping};
use crate::effort::Counted;
use crate::refine::expectation::{Pass, strengths_of_ping};
use crate::refine::field::Field;
use crate::refine::inherit::{area_of, whole_area};
use crate::refine::terms::PassTerms;
use crate::spawn::gaussians::{Gaussians, Stage};
use crate::world::World;

/// Adds what pings tell of each Gaussian that was worked out to what it keeps, before they are forgotten.
///
/// Cost: that of the Gaussians of the tiles they see, however large the map.
pub(crate) fn keep(
    world: &World,
    map: &mut Gaussians,
    pings: &[Arc<Keyframe>],
    terms: Terms<'_>,
) -> Counted {
    // In the map's order, so that sums are those of the whole map.
    let slots = world.evidence.gaussians_seen_by(pings);
    let seen = &copies(map, &slots);
    let pass_terms = |is_blurred| PassTerms {
        is_blurred,
        at_work: terms.at_work,
    };
    let count = pings.len();
    let mut pass = Pass::over(pings.to_vec(), Field::of(&world.evidence, seen));
    let each = |tally: &mut _, (): &mut (), keyframe: &_, sight: &mut _| {
        strengths_of_ping(tally, keyframe, sight, terms.at_work);
    };
    let mut counted = pass.advance(pass_terms(false), count, Detail::Strength, each);
    let (sums, done) = pass.finish(seen.slot_count());
    let rule = Rule::of(
        map,
        world.evidence.voxel_m(),
        terms.at_work,
        VerdictThresholds::of(terms.config, terms.at_work),
    );
    let mut pass = Pass::over(pings.to_vec(), done.field);
    let each = |tally: &mut _, desk: &mut Desk, keyframe: &_, sight: &mut _| {
        findings_of_ping(tally, desk, keyframe, sight, seen, rule);
    };
    counted += pass.advance(pass_terms(true), count, Detail::Full, each);
    let (findings, _) = pass.finish(seen.slot_count());
    let whole = whole_area(world.evidence.voxel_m());
    for ((slot, sums), finding) in slots.into_iter().zip(&sums).zip(&findings) {
        let slot = slot as usize;
        let is_told = sums.weight().sum() > 0.0 || finding.statistics.observations > 0.0;
        if map.stage[slot] == Stage::Worked && is_told {
            let (area, child_share) = (area_of(map, slot) / whole, map.child_share[slot]);
            let kept = map.kept[slot].get_or_insert_default();
            kept.add(sums.weight(), finding, area, child_share);
        }
    }
    counted
}

fn copies(map: &Gaussians, slots: &[u32]) -> Gaussians {
    let mut copies = Gaussians::with_room(slots.len());
    for &slot in slots {
        copies.adopt(map, slot as usize, map.stage[slot as usize]);
    }
    copies
}
