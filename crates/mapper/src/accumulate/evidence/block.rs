//! A cube of voxels, and what observations from each azimuth sector say of it.

use std::sync::Arc;

use echosplat_measurement::lanes::{self, LANES};
use echosplat_measurement::simd_level;
use echosplat_model::glam::{IVec3, Vec3};
use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x8, i32x8};

use super::packed::SectorSums;
use super::sector::{STEPS, Sector, Totals};
use super::{BLOCK_EDGE, VOXELS};
use crate::accumulate::history::{History, Keyframe};
use crate::detect::bin_state::BinState;
use crate::features::Extent;

/// Azimuth sectors of a block; layout.
/// Azimuth sectors of a block that observations come from: of 45° each, from above and from below.
const SECTORS: usize = 16;

/// Nats, derived: ln(0.95/0.57).
/// Log likelihood ratio of an observation on the beam's axis: an echo is seen in 95 % of the observations of a
/// surface, and from about 57 % at a place that is only asked about because some arc of it was lit:
/// ln(0.95/0.57) and ln(0.05/0.43).
const LIT: f32 = 0.5;
/// Nats, derived: ln(0.05/0.43).
const DARK: f32 = -2.15;
/// Nats, found: it may be shadow.
/// Darkness behind an echo may be its shadow.
const SHADOWED: f32 = 0.15 * DARK;
/// Voxels, derived: spread and drift within a ping.
/// Rows further off than the beam's reach and this are passed over: a voxel's own spread, and what
/// the sensor drifts until an echo.
const ROW_MARGIN_VOXELS: f32 = 0.7;
/// Squared sigmas off the axis; found.
/// Beyond this many sigma from the axis an observation says nothing clear.
const OBSERVATION_SIGMAS_SQUARED: f32 = 1.4;
/// Ratio of variance; found.
/// Places are found although the heading is off by this factor of variance: what a surface with specular
/// returns shows but once must not be lost to one bad pose.
const POSE_DOUBT: f32 = 6.0;
/// Nats; found.
/// What an azimuth sector that saw a place dark counts at most against what others saw.
const AGAINST_EIGHTH: f32 = -0.25;
/// Nats of a sector of 90°, the same; found.
const AGAINST_QUARTER: f32 = -2.0;
/// Each sector of [`sector_of`] by itself: what lies flat is seen from above or below alone.
const EIGHTH_SECTORS: [[usize; 1]; SECTORS] = {
    let mut sectors = [[0]; SECTORS];
    let mut sector = 0;
    while sector < SECTORS {
        sectors[sector] = [sector];
        sector += 1;
    }
    sectors
};
/// Sectors of 45° that make each of 90°; layout.
/// The sectors of 45° that make up those of 90° around the axes.
const QUARTER_SECTORS: [[usize; 4]; 4] =
    [[0, 2, 8, 10], [1, 3, 9, 11], [4, 5, 12, 13], [6, 7, 14, 15]];

/// How finely azimuth sectors are told apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SectorWidth {
    /// 45°: where specular returns are expected, each sector, above or below, may have seen something of its
    /// own.
    Eighth,
    /// 90°: where echoes are smeared, darkness has to count for more.
    Quarter,
}

/// Nats, derived: eight clear observations.
/// A block whose best voxel is this deep in darkness from an azimuth sector needs no more observations from
/// there: it would take eight clear ones to bring it back to nothing.
const SETTLED_EVIDENCE: f32 = -4.0;
/// Nats of pings visited once; found.
/// The same if every ping is visited about once at most.
const SOON_SETTLED_EVIDENCE: f32 = -3.0;

/// Sums per voxel, z fastest: a fan stands upright on most vehicles, and is thin. A row of eight is then in it or not, as a
/// whole, from wherever it is seen.
pub(crate) type Sums = [f32; VOXELS];
/// 8 × 8 × 8 voxels.
#[derive(Debug, Default)]
pub(crate) struct Block {
    /// Position in units of blocks.
    pub(crate) key: IVec3,
    /// What was seen from each azimuth sector.
    sectors: [Sector; SECTORS],
    /// Those with observations since [`Self::lay_away`], a bit each.
    observed_from: u16,
    /// Slots of the Gaussians spawned here, by voxel.
    pub(crate) gaussians: Vec<(u16, u32)>,
    /// Voxels that were candidates when the block was last worked out and hold nothing, a bit each: none is
    /// spawned there until then again.
    pub(crate) suppressed: [u64; VOXELS / 64],
    /// No voxel has more evidence than this.
    pub(crate) most: f32,
    /// Evidence of observations that are not in `sectors` any more, where there are Gaussians.
    left: Vec<(u16, f32)>,
}

/// The azimuth sector an observation comes from, by the direction towards its sensor.
fn sector_of(towards_m: Vec3) -> usize {
    let (west, south, below) = (towards_m.x < 0.0, towards_m.y < 0.0, towards_m.z < 0.0);
    let is_steep = towards_m.y.abs() > towards_m.x.abs();
    let sector = usize::from(west) + 2 * usize::from(south) + 4 * usize::from(is_steep);
    sector + 8 * usize::from(below)
}

/// Of the sphere around a block.
pub(super) fn radius_m(voxel_m: f32) -> f32 {
    0.5 * 3f32.sqrt() * voxel_m * BLOCK_EDGE as f32
}

impl Block {
    pub(super) fn new(key: IVec3) -> Self {
        Self {
            key,
            ..Self::default()
        }
    }

    /// Forgets all evidence, and keeps its Gaussians.
    pub(super) fn forget(&mut self) {
        self.sectors = Default::default();
        self.left = Vec::new();
        self.most = 0.0;
    }

    /// Keeps evidence only of voxels that hold Gaussians.
    pub(super) fn leave(&mut self) {
        let sums = self.evidence(SectorWidth::Quarter);
        let mut voxels: Vec<u16> = self.gaussians.iter().map(|&(voxel, _)| voxel).collect();
        voxels.sort_unstable();
        voxels.dedup();
        let left = voxels
            .into_iter()
            .map(|voxel| (voxel, sums[usize::from(voxel)]));
        self.left = left.collect();
        self.sectors = Default::default();
        // The other voxels have none.
        self.most = self.most.max(0.0);
        self.gaussians.shrink_to_fit();
    }

    /// Holds azimuth sectors in fewer bytes that had no observation since it was asked to last.
    pub(super) fn lay_away(&mut self) {
        let observed_from = std::mem::take(&mut self.observed_from);
        for (index, sector) in self.sectors.iter_mut().enumerate() {
            if observed_from >> index & 1 == 0 {
                sector.lay_away();
            }
        }
    }

    pub(super) fn center_m(&self, voxel_m: f32) -> Vec3 {
        (self.key.as_vec3() + 0.5) * (voxel_m * BLOCK_EDGE as f32)
    }

    /// Adds the evidence of `pings` in their order, and lets go of azimuth sectors settled to the `extent` of
    /// observing on. Returns voxel observations made.
    pub(super) fn integrate<'a>(
        &mut self,
        pings: impl IntoIterator<Item = &'a Arc<Keyframe>>,
        voxel_m: f32,
        extent: Extent,
    ) -> u64 {
        let (center_m, radius_m) = (self.center_m(voxel_m), radius_m(voxel_m));
        let (mut work, mut observed_from) = (0, [false; SECTORS]);
        for keyframe in pings {
            if keyframe.fan.touches(center_m, radius_m) {
                let sector = sector_of(keyframe.geometry.pose.position_m - center_m);
                observed_from[sector] = true;
                if let Some(sums) = self.sectors[sector].sums() {
                    let glance = Glance::of(keyframe, self.key, voxel_m);
                    let (observations, most) =
                        dispatch!(simd_level::level(), simd => glance.add(simd, sums));
                    work += observations;
                    self.most += most;
                }
            }
        }
        if work > 0 {
            let below = match extent {
                Extent::All => f32::MIN,
                Extent::Useful => SETTLED_EVIDENCE,
                Extent::None => SOON_SETTLED_EVIDENCE,
            };
            for (index, sector) in self.sectors.iter_mut().enumerate() {
                if observed_from[index] {
                    if sector.settle(below) {
                        // It may have been darker than it counts from now on.
                        self.most = f32::INFINITY;
                    }
                    self.observed_from |= 1 << index;
                }
            }
        }
        work
    }

    /// Adds the evidence of the first `count` pings remembered.
    pub(super) fn integrate_all(
        &mut self,
        history: &History,
        count: usize,
        voxel_m: f32,
        extent: Extent,
    ) -> u64 {
        let (center_m, radius_m) = (self.center_m(voxel_m), radius_m(voxel_m));
        let near = history.near(count, center_m, radius_m);
        self.integrate(near, voxel_m, extent)
    }

    /// Evidence for each voxel over all azimuth sectors; what one saw dark counts only so far.
    pub(super) fn evidence(&self, width: SectorWidth) -> Sums {
        self.totals(width).map(|total| total as f32 / STEPS)
    }

    /// What azimuth sectors say together, in steps: one that saw a place dark, since the structure hides
    /// itself or has specular returns elsewhere, contradicts the others only so far.
    fn totals(&self, width: SectorWidth) -> Totals {
        let mut totals = [0; VOXELS];
        dispatch!(simd_level::level(), _simd => match width {
            SectorWidth::Eighth => self.add_sectors(&mut totals, &EIGHTH_SECTORS, AGAINST_EIGHTH),
            SectorWidth::Quarter => self.add_sectors(&mut totals, &QUARTER_SECTORS, AGAINST_QUARTER),
        });
        for &(voxel, sum) in &self.left {
            totals[usize::from(voxel)] += (STEPS * sum) as i32;
        }
        totals
    }

    #[inline(always)]
    fn add_sectors<const N: usize>(&self, totals: &mut Totals, groups: &[[usize; N]], least: f32) {
        let least = (STEPS * least) as i32;
        for group in groups {
            let is_unseen = |&sector: &usize| matches!(self.sectors[sector], Sector::Unseen);
            if group.iter().all(is_unseen) {
                continue;
            }
            let mut together = [0; VOXELS];
            for &sector in group {
                self.sectors[sector].add_to(&mut together);
            }
            for (total, together) in totals.iter_mut().zip(together) {
                *total += together.max(least);
            }
        }
    }
}

/// One ping against one block.
struct Glance<'a> {
    keyframe: &'a Keyframe,
    /// Centre of the first voxel in the beam's frame.
    first_m: Vec3,
    /// From voxel to voxel along each of the block's axes.
    steps_m: [Vec3; 3],
    voxel_m: f32,
    /// Squared tangent of elevation where the fan is half as sensitive: beyond, an observation says nothing.
    edge: f32,
    beam_variance: f32,
    /// What each state says.
    ratios: [f32; 4],
}

impl<'a> Glance<'a> {
    fn of(keyframe: &'a Keyframe, key: IVec3, voxel_m: f32) -> Self {
        let geometry = &keyframe.geometry;
        let into_beam = geometry.pose.axes.transpose();
        let first_m = ((key * BLOCK_EDGE).as_vec3() + 0.5) * voxel_m;
        let sigma = geometry.beam.azimuth_sigma_rad();
        Self {
            keyframe,
            first_m: into_beam * (first_m - geometry.pose.position_m),
            steps_m: [into_beam.x_axis, into_beam.y_axis, into_beam.z_axis].map(|a| a * voxel_m),
            voxel_m,
            edge: keyframe.fan.half_tangent() * keyframe.fan.half_tangent(),
            beam_variance: sigma * sigma
                + geometry.azimuth_variance_rad2
                + POSE_DOUBT * keyframe.blur.azimuth_variance_rad2,
            ratios: [0.0, DARK, LIT, SHADOWED].map(|ratio| ratio * keyframe.weight),
        }
    }

    /// Adds the observations of all voxels in the beam. Returns voxel observations made, and the most that was added
    /// to any voxel.
    #[inline(always)]
    fn add<S: Simd>(&self, simd: S, sums: &mut SectorSums) -> (u64, f32) {
        let geometry = &self.keyframe.geometry;
        let [along_x, along_y, step] = self.steps_m;
        let voxel_variance_m2 = self.voxel_m * self.voxel_m / 12.0;
        let (per_bin, start_m) = (1.0 / geometry.bin_length_m, geometry.range_start_m);
        let [left, turn, roll] = geometry.pose.drift_per_m.to_array();
        let numbers = lanes::lane_numbers(simd);
        let (none, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
        let [across_x, across_y, across_z] = step.to_array().map(|step| numbers * step);
        let states = &self.keyframe.profile.state;
        let bin_count = geometry.bin_count as f32;
        // Beyond this the beam's middle says nothing of a row, its drift included.
        let margin_m = 3.5 * step.y.abs() + ROW_MARGIN_VOXELS * self.voxel_m;
        let reach = (OBSERVATION_SIGMAS_SQUARED * self.beam_variance).sqrt();
        let (mut work, mut most) = (0, none);
        let mut rows = [0_u32; BLOCK_EDGE as usize];
        for (x, rows) in rows.iter_mut().enumerate() {
            let first = self.first_m + along_x * x as f32 + step * 3.5;
            let ahead_m = numbers.mul_add(along_y.x, f32x8::splat(simd, first.x));
            let aside_m = numbers.mul_add(along_y.y, f32x8::splat(simd, first.y));
            let lever_m = ahead_m.abs() + 3.5 * self.voxel_m;
            let is_in_beam = aside_m
                .abs()
                .simd_le(lever_m.mul_add(reach, none + margin_m))
                & ahead_m.simd_ge(-4.0 * self.voxel_m);
            *rows = is_in_beam.to_bitmask() as u32;
        }
        for (row, sums) in sums.chunks_exact_mut(LANES).enumerate() {
            if rows[row / 8] >> (row % 8) & 1 == 0 {
                continue;
            }
            let start = self.first_m + along_x * (row / 8) as f32 + along_y * (row % 8) as f32;
            work += LANES as u64;
            let (x, y, z) = (across_x + start.x, across_y + start.y, across_z + start.z);
            let lever2 = x.mul_add(x, y * y);
            let range_m = z.mul_add(z, lever2).sqrt();
            let late_m = range_m - geometry.pose.reference_range_m;
            let across_m = y - late_m * (x * turn - z * roll + left);
            let variance_m2 = lever2 * self.beam_variance + voxel_variance_m2;
            let off = across_m * across_m / (variance_m2 * OBSERVATION_SIGMAS_SQUARED);
            let bin = (range_m - start_m) * per_bin;
            let seen = x.simd_gt(0.0)
                & off.simd_lt(1.0)
                & (z * z).simd_lt(lever2 * self.edge)
                & bin.simd_ge(0.0);
            if seen.to_bitmask() == 0 {
                continue;
            }
            let clear = seen.select(one - off, none);
            // As whole numbers all at once: one by one that took a third of the time. Beyond the last bin
            // nothing is seen.
            let bins: i32x8<S> = bin.max(0.0).min(bin_count).to_int();
            let near = seen.select(bin, f32x8::splat(simd, bin_count)).reduce_min();
            let far = seen.select(bin, none).reduce_max().min(bin_count);
            let first = near as usize & !3;
            let ratio = match (far as usize) < first + 16 {
                // What is not seen may be of any state.
                true => {
                    let of_each = ((bins - first as i32) * 2) & 31;
                    let all = i32x8::splat(simd, states.sixteen(first / 4).cast_signed());
                    self.ratio_of((all >> of_each) & 3)
                }
                false => {
                    let mut ratio = [0.0; LANES];
                    for (ratio, bin) in ratio.iter_mut().zip(bins.to_array()) {
                        // Not a closure: those are not compiled for the wide vectors around them.
                        *ratio = self.ratios[states.at(bin as usize) as usize];
                    }
                    f32x8::simd_from(simd, ratio)
                }
            };
            let steps = (clear * ratio * STEPS).round_ties_even();
            most = most.max(steps);
            let told: i32x8<S> = steps.to_int();
            for (sum, told) in sums.iter_mut().zip(told.to_array()) {
                *sum = sum.saturating_add(told as i16);
            }
        }
        (work, most.reduce_max() / STEPS)
    }

    /// What states say, [`BinState`]s as numbers.
    #[inline(always)]
    fn ratio_of<S: Simd>(&self, states: i32x8<S>) -> f32x8<S> {
        let [blank, dark, lit, shadowed] =
            self.ratios.map(|ratio| f32x8::splat(states.simd, ratio));
        let is = |state: BinState| states.simd_eq(state as i32);
        let unlit = is(BinState::Dark).select(dark, is(BinState::Shadowed).select(shadowed, blank));
        is(BinState::Lit).select(lit, unlit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MapperConfig;
    use crate::accumulate::history::{geometry_of, keyframe_of, pose_blur};
    use crate::detect::posed;
    use crate::detect::profile::{Backdrop, Levels};
    use echosplat_model::Pose;
    use echosplat_model::glam::{DVec3, Mat3};

    #[test]
    fn what_is_left_remembers_the_places_of_its_gaussians() {
        let mut block = Block::new(IVec3::ZERO);
        block.sectors[0] = Sector::Seen(Box::new([(STEPS * 20.0) as i16; VOXELS]));
        block.gaussians = vec![(7, 0), (7, 1)];
        block.leave();
        let evidence = block.evidence(SectorWidth::Eighth);
        assert!((evidence[7] - 20.0).abs() < 1e-3 && evidence[8].abs() < 1e-6);
        block.sectors[3] = Sector::Seen(Box::new([STEPS as i16; VOXELS]));
        assert!((block.evidence(SectorWidth::Quarter)[7] - 21.0).abs() < 1e-3);
    }

    #[test]
    fn a_sector_that_sees_nothing_contradicts_the_others_only_so_far() {
        let mut block = Block::new(IVec3::ZERO);
        let seen_as = |sum: f32| Sector::Seen(Box::new([(STEPS * sum) as i16; VOXELS]));
        let first = |block: &Block| block.evidence(SectorWidth::Quarter)[0];
        block.sectors[0] = seen_as(20.0);
        block.sectors[1] = seen_as(-50.0);
        assert!((first(&block) - 18.0).abs() < 1e-6);
        let settled: Vec<usize> = (0..SECTORS)
            .filter(|&sector| block.sectors[sector].settle(SETTLED_EVIDENCE))
            .collect();
        assert_eq!(settled, [1]);
        let is_settled = |sector: &Sector| matches!(sector, Sector::Settled);
        assert!(is_settled(&block.sectors[1]) && !is_settled(&block.sectors[0]));
        assert!((first(&block) - 18.0).abs() < 1e-6);
        block.sectors[0] = seen_as(1.0);
        assert!(first(&block) < 0.0);
    }

    /// From the origin, towards 3 m where there may be an echo.
    fn keyframe(number: u32, is_lit: bool) -> Arc<Keyframe> {
        let power = |bin: u32| if is_lit && bin == 150 { 1e4 } else { 1.0 };
        let pose = Pose::from_yaw_pitch_roll(0.002 * f64::from(number), 0.0, 0.0, DVec3::ZERO);
        let posed = posed(number, (0..300).map(power).collect(), pose);
        let config = MapperConfig::default();
        let (geometry, blur) = (
            geometry_of(&posed, DVec3::ZERO, &config),
            pose_blur(&posed, &config),
        );
        let (ground, bursts) = (Backdrop::default(), Box::default());
        let profile = Levels::default().profile(&posed.ping, 0.04, &ground, bursts, &config);
        Arc::new(keyframe_of(geometry, blur, profile, 1.0, 0.0, &posed))
    }

    /// What a ping says of a voxel's centre, told one by one.
    fn said_of(keyframe: &Keyframe, center_m: Vec3, voxel_m: f32) -> f32 {
        let geometry = &keyframe.geometry;
        let (q, late) = {
            let still = geometry.pose.axes.transpose() * (center_m - geometry.pose.position_m);
            (still, still.length() - geometry.pose.reference_range_m)
        };
        let [left, turn, roll] = geometry.pose.drift_per_m.to_array();
        let across_m = q.y - late * (q.x * turn - q.z * roll + left);
        let lever2 = q.x * q.x + q.y * q.y;
        let beam = geometry.beam.azimuth_sigma_rad().powi(2)
            + geometry.azimuth_variance_rad2
            + POSE_DOUBT * keyframe.blur.azimuth_variance_rad2;
        let variance_m2 = lever2 * beam + voxel_m * voxel_m / 12.0;
        let off = across_m * across_m / (variance_m2 * OBSERVATION_SIGMAS_SQUARED);
        let half_width = geometry.beam.elevation_half_width_rad();
        let bin = (q.length() - geometry.range_start_m) / geometry.bin_length_m;
        if q.x <= 0.0 || off >= 1.0 || q.z.abs() >= lever2.sqrt() * half_width.tan() || bin < 0.0 {
            return 0.0;
        }
        let ratio = match keyframe.profile.state.at(bin as usize) {
            BinState::Blank => 0.0,
            BinState::Dark => DARK,
            BinState::Lit => LIT,
            BinState::Shadowed => SHADOWED,
        };
        (1.0 - off) * ratio * keyframe.weight
    }

    #[test]
    fn eight_voxels_at_a_time_hear_what_each_would() {
        // Far bins, and bins so short that those of eight voxels are far apart; level, and on its side.
        let (voxel_m, mut told) = (0.05, 0);
        for (shortened, roll) in [(1.0, 0.0), (0.1, 0.0), (0.1, 1.5)] {
            let mut keyframe = Keyframe::clone(&keyframe(20, true));
            keyframe.geometry.range_start_m = 3.0 - 3.0 * shortened;
            keyframe.geometry.bin_length_m *= shortened;
            keyframe.geometry.pose.axes *= Mat3::from_rotation_x(roll);
            keyframe.geometry.pose.drift_per_m = Vec3::new(1e-3, 2e-3, -1e-3);
            let keyframe = Arc::new(keyframe);
            for key in [[7, 0, 0], [7, 0, 1], [6, -1, -2], [7, 1, 0]].map(IVec3::from) {
                let mut block = Block::new(key);
                block.integrate([&keyframe], voxel_m, Extent::All);
                let sums = block.evidence(SectorWidth::Eighth);
                for (voxel, sum) in sums.into_iter().enumerate() {
                    let [x, y, z] = [voxel / 64, voxel / 8 % 8, voxel % 8].map(|v| v as f32 + 0.5);
                    let center_m = (key * BLOCK_EDGE).as_vec3() + Vec3::new(x, y, z);
                    let said = said_of(&keyframe, center_m * voxel_m, voxel_m);
                    // What one sector says against is cut off.
                    let said = said.max(AGAINST_EIGHTH);
                    assert!(
                        (sum - said).abs() < 2.0 / STEPS,
                        "{key} {voxel}: {sum} {said}"
                    );
                    told += usize::from(said > 0.1);
                }
            }
        }
        assert!(told > 20, "{told}");
    }

    #[test]
    fn no_voxel_has_more_evidence_than_a_block_may_have() {
        let (voxel_m, mut counts) = (0.05, [0; 2]);
        let mut blocks = [6, 7, 8].map(|x| Block::new(IVec3::new(x, 0, 0)));
        for number in 0..120 {
            let keyframe = keyframe(number, number % 40 < 10);
            for block in &mut blocks {
                let before = block.most;
                block.integrate([&keyframe], voxel_m, Extent::Useful);
                let evidence = block.evidence(SectorWidth::Quarter).into_iter();
                let most = evidence.fold(f32::MIN, f32::max);
                assert!(block.most >= most, "{} {most}", block.most);
                // One observation adds no more than that of a voxel on the beam's axis.
                let is_settled = block.most == f32::INFINITY;
                assert!(is_settled || block.most <= before + LIT, "{}", block.most);
                counts[usize::from(is_settled)] += 1;
                block.most = most;
            }
        }
        assert!(counts.iter().all(|&count| count > 0), "{counts:?}");
    }

    #[test]
    fn what_is_laid_away_says_the_same_and_is_taken_up_again() {
        let mut block = Block::new(IVec3::ZERO);
        let sums = |factor: i16| std::array::from_fn(|voxel| factor * (voxel as i16 % 100 - 60));
        for (index, factor) in [(0, 3), (4, -50), (9, 7)] {
            block.sectors[index] = Sector::Seen(Box::new(sums(factor)));
        }
        block.observed_from = 1 << 4;
        let said =
            |block: &Block| [SectorWidth::Eighth, SectorWidth::Quarter].map(|h| block.totals(h));
        let before = said(&block);
        let packed = |block: &Block| {
            block
                .sectors
                .iter()
                .filter(|s| matches!(s, Sector::Packed(_)))
                .count()
        };
        block.lay_away();
        assert_eq!((packed(&block), said(&block)), (2, before));
        block.lay_away();
        assert_eq!((packed(&block), said(&block)), (3, before));
        assert_eq!(block.sectors[4].sums(), Some(&mut sums(-50)));
        assert_eq!((packed(&block), said(&block)), (2, before));
    }

    #[test]
    fn observations_count_in_the_sector_their_sensor_is_in() {
        let towards = |sector: i32| {
            let bearing_rad = f64::from(sector % 8) * std::f64::consts::FRAC_PI_4 + 0.1;
            sector_of(Vec3::new(
                bearing_rad.cos() as f32,
                bearing_rad.sin() as f32,
                if sector < 8 { 0.2 } else { -0.2 },
            ))
        };
        let mut sectors: Vec<usize> = (0..SECTORS as i32).map(towards).collect();
        sectors.sort_unstable();
        assert!(sectors.into_iter().eq(0..SECTORS));
        // Groups leave out none and count none twice.
        let mut grouped: Vec<usize> = QUARTER_SECTORS.into_iter().flatten().collect();
        grouped.sort_unstable();
        assert!(grouped.into_iter().eq(0..SECTORS));
    }
}
