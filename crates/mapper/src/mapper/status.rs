//! What the mapper is allowed, and what it says of itself.

use echosplat_model::Reason;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use super::foretold::Foretold;
use crate::drift::PoseDrift;
use crate::effort::TaskCounts;

/// What one ping did.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct InsertReport {
    /// Whether a slice of pings was taken in with this one.
    pub slice_taken_in: bool,
    /// Gaussians spawned.
    pub added: u64,
    /// Gaussians pruned since darkness spoke against them.
    pub pruned: u64,
    /// Gaussian–bin pairs of the work done with it.
    pub pairs: u64,
    /// Whether the ping was left out since its pose or settings are not finite.
    pub rejected: bool,
}

/// How many Gaussians there are for each reason of a verdict.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ReasonCounts([u64; Reason::ALL.len()]);

impl ReasonCounts {
    pub(super) fn of(reasons: impl Iterator<Item = Reason>) -> Self {
        let mut counts = Self::default();
        reasons.for_each(|reason| counts.0[reason as usize] += 1);
        counts
    }

    /// Of one reason.
    #[must_use]
    pub fn of_reason(&self, reason: Reason) -> u64 {
        self.0[reason as usize]
    }
}

/// By the names of those that there are.
impl Serialize for ReasonCounts {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let counted = Reason::ALL.into_iter().zip(self.0);
        let counted = counted.filter(|&(_, count)| count > 0);
        let mut map = serializer.serialize_map(None)?;
        for (reason, count) in counted {
            map.serialize_entry(reason.name(), &count)?;
        }
        map.end()
    }
}

/// Where the mapper stands.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct MapperStatus {
    /// Pings taken in.
    pub pings: u64,
    /// Pings left out as not finite, or as beyond all reach.
    pub pings_rejected: u64,
    /// Pings that are evidence of nothing: a receiver at its stop, nothing beyond the
    /// blanking, a pose that leaves everything open.
    pub pings_deaf: u64,
    /// Of these, pings whose pose leaves everything open.
    pub pings_unplaced: u64,
    /// Pings left out since the one before said nearly all of it.
    pub pings_redundant: u64,
    /// Pings let go from memory to make room; what they told stays in the map.
    pub pings_forgotten: u64,
    /// Gaussians that the map asserts as surface, as of the last snapshot.
    pub confident: u64,
    /// Gaussians published as ambiguous, as of the last snapshot.
    pub ambiguous: u64,
    /// Bins of echoes taken for others heard again: at a fixed multiple of their range, at a fixed distance behind
    /// it, or by way of the water's surface.
    pub bins_doubted: u64,
    /// Bins passed over since another sonar's pulse was in them.
    pub bins_interfered: u64,
    /// Work-outs of some tiles, those under way included.
    pub workouts: u64,
    /// Tiles whose Gaussians are worked out again.
    pub tiles_at_work: u64,
    /// All Gaussians held, published or not.
    pub candidates: u64,
    /// Blocks of evidence held.
    pub evidence_blocks: u64,
    /// Edge of an evidence voxel, metres.
    pub voxel_m: f32,
    /// Nearer than this pings of some gain are heard to ring, and say nothing, metres; 0 where each ping tells it by itself.
    pub rings_until_m: f64,
    /// Where a part of the vehicle itself begins to be heard, the nearest if there are several, metres: it is passed over. `None`
    /// where none is in view.
    pub own_vehicle_m: Option<f64>,
    /// Where the newest ping ends, metres.
    pub range_end_m: f32,
    /// Half of the pings' strongest echoes come from nearer, metres; `None` before some hundred pings heard a loud one.
    pub working_range_m: Option<f32>,
    /// The furthest that the unit should be set to hear, metres: beyond, voxels are coarser than the beam resolves there.
    /// `None` as long as that is not known, and where voxels are as configured.
    pub useful_range_m: Option<f32>,
    /// Observations of voxels made so far.
    #[serde(rename = "voxel_looks")]
    pub voxel_observations: u64,
    /// Gaussian–bin pairs done so far.
    pub pairs: u64,
    /// Multiplicative steps made so far.
    pub iterations: u64,
    /// Mean power of the noise in the newest ping over the strongest echo, decibels.
    pub noise_db: f32,
    /// Log likelihood ratio, nats, of pings as ground against reverberation at a fixed range; `None` where they show neither. The
    /// map asserts ground above 4.6.
    pub ground_log_ratio: Option<f32>,
    /// Height of the water's surface in the world, metres, z up, where images in it are heard and left out.
    pub water_surface_m: Option<f64>,
    /// Gaussians published by the reason of their verdict, as of the last snapshot.
    pub reasons: ReasonCounts,
    /// How likely the map makes pings that it has not taken in yet.
    pub foretold: Foretold,
    /// How poses drift against the map.
    pub drift: PoseDrift,
    /// How much work of each kind was done; who measures its time tells both.
    #[serde(skip)]
    pub tasks: TaskCounts,
}
