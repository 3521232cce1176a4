//! What observations from one azimuth sector say of a block.

use super::VOXELS;
use super::packed::{Packed, SectorSums};

/// Nats in a sector of 90°; found.
/// What a settled sector of 45° counts with the other half of its sector of 90°.
const SETTLED_COUNTS: f32 = -8.0;

/// Steps of [`SectorSums`] a nat; layout.
/// Steps of [`SectorSums`] that are 1.
pub(super) const STEPS: f32 = 64.0;
/// Of all sectors together, in steps.
pub(super) type Totals = [i32; VOXELS];

/// Evidence of observations from one azimuth sector: a structure seen from behind, where it hides
/// itself, and one with specular returns do not contradict their front.
#[derive(Debug, Default)]
pub(super) enum Sector {
    #[default]
    Unseen,
    /// Sum of log likelihood ratios per voxel.
    Seen(Box<SectorSums>),
    /// The same, laid away.
    Packed(Packed),
    /// So dark everywhere that no more observations are needed and nothing need be remembered.
    Settled,
}

impl Sector {
    /// From nothing if it was unseen; `None` if settled.
    pub(super) fn sums(&mut self) -> Option<&mut SectorSums> {
        if let Self::Unseen = self {
            *self = Self::Seen(Box::new([0; VOXELS]));
        }
        if let Self::Packed(packed) = self {
            *self = Self::Seen(Box::new(packed.unpack()));
        }
        match self {
            Self::Seen(sums) => Some(sums),
            _ => None,
        }
    }

    /// Adds its sums to `total`, in steps; what is settled is dark enough to outweigh a few
    /// observations.
    #[inline(always)]
    pub(super) fn add_to(&self, total: &mut Totals) {
        match self {
            Self::Unseen => {}
            Self::Seen(sums) => add(sums, total),
            Self::Packed(packed) => add(&packed.unpack(), total),
            Self::Settled => {
                for total in total {
                    *total += (STEPS * SETTLED_COUNTS) as i32;
                }
            }
        }
    }

    /// Holds the sums in fewer bytes.
    pub(super) fn lay_away(&mut self) {
        if let Self::Seen(sums) = self {
            *self = Self::Packed(Packed::of(sums));
        }
    }

    /// Lets go of the sums when no place is left that could be anything; whether it does.
    pub(super) fn settle(&mut self, below: f32) -> bool {
        let is_dark = |sums: &SectorSums| sums.iter().all(|&sum| sum < (STEPS * below) as i16);
        let settles = matches!(self, Self::Seen(sums) if is_dark(sums));
        if settles {
            *self = Self::Settled;
        }
        settles
    }
}

#[inline(always)]
fn add(sums: &SectorSums, total: &mut Totals) {
    for (total, sum) in total.iter_mut().zip(sums) {
        *total += i32::from(*sum);
    }
}
