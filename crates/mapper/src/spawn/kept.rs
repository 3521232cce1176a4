//! What forgotten pings told of a Gaussian, so that nothing is unlearnt for want of memory.

use crate::accumulate::finding::Finding;
use crate::spawn::directional_reflectivity::DirectionalReflectivity;

/// All as of a round Gaussian of one voxel, whatever its shape is now: children of one hold the
/// same.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Kept {
    /// Strength at which what they told is most likely.
    pub(crate) strength: DirectionalReflectivity,
    /// How much they weigh: the denominator of the multiplicative step, `Σ A w/Î`.
    pub(crate) weight: DirectionalReflectivity,
    /// What they count towards a verdict.
    pub(crate) finding: Finding,
}

impl Kept {
    /// Of a Gaussian that covers `area` of a whole one's and has this `child_share` of it.
    pub(crate) fn add(
        &mut self,
        mut weight: DirectionalReflectivity,
        finding: &Finding,
        area: f32,
        child_share: f32,
    ) {
        weight.scale(area.recip());
        self.weight.add(&weight);
        // Children explain their share of each echo, and information goes with its square.
        self.finding
            .add(&finding.with_information((child_share * child_share).recip()));
    }

    /// As of a child with this share.
    pub(crate) fn finding_of(&self, child_share: f32) -> Finding {
        self.finding.with_information(child_share * child_share)
    }

    /// Of the children of one Gaussian, each of which was observed by all pings.
    pub(crate) fn mean<'a>(children: impl Iterator<Item = &'a Self>) -> Option<Self> {
        let (mut sum, mut count) = (Self::default(), 0.0);
        for child in children {
            sum.strength.add(&child.strength);
            sum.weight.add(&child.weight);
            sum.finding.add(&child.finding);
            count += 1.0;
        }
        let by_count = f32::recip(count);
        sum.strength.scale(by_count);
        sum.weight.scale(by_count);
        sum.finding = sum.finding.times(by_count);
        (count > 0.0).then_some(sum)
    }
}
