//! A cube of voxels, and what looks from each side say of it.

use std::sync::Arc;

use echosplat_acoustics::lanes::{self, LANES};
use echosplat_model::glam::{IVec3, Vec3};
use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, i32x8};

use super::packed::SideSums;
use super::side::{STEPS, Side, Totals};
use super::{BLOCK_EDGE, VOXELS};
use crate::accumulate::history::{History, Past};
use crate::detect::bin_state::BinState;
use crate::parts::Extent;

/// Sides of a block that looks come from: eighths of the horizon, each from above and from below.
const SIDES: usize = 16;

/// Log likelihood ratio of a look on the beam's axis: an echo is seen from 95 % of looks at a
/// surface, and from about 57 % at a place that is only asked about because some arc of it was
/// lit: ln(0.95/0.57) and ln(0.05/0.43).
const LIT: f32 = 0.5;
const DARK: f32 = -2.15;
/// Darkness behind an echo may be its shadow.
const SHADOWED: f32 = 0.15 * DARK;
/// Rows further off than the beam's reach and this are passed over: a voxel's own spread, and what
/// the sensor drifts until an echo.
const ROW_MARGIN_VOXELS: f32 = 0.7;
/// Beyond this many sigma from the axis a look says nothing clear.
const LOOK_SIGMAS_SQUARED: f32 = 1.4;
/// Of the fan's half-width, beyond which a look says nothing.
const FAN_SHARE: f32 = 1.0;
/// Places are found although the heading is off by this factor of variance: what a surface that
/// glints shows but once must not be lost to one bad pose.
const POSE_DOUBT: f32 = 6.0;
/// What a side that saw a place dark counts at most against what others saw.
const AGAINST_EIGHTH: f32 = -0.25;
const AGAINST_QUARTER: f32 = -2.0;
/// Each side of [`side_of`] by itself: what lies flat is seen from above or below alone.
const EIGHTHS: [[usize; 1]; SIDES] = {
    let mut eighths = [[0]; SIDES];
    let mut side = 0;
    while side < SIDES {
        eighths[side] = [side];
        side += 1;
    }
    eighths
};
/// The sides that make up quarters around the axes.
const QUARTERS: [[usize; 4]; 4] = [[0, 2, 8, 10], [1, 3, 9, 11], [4, 5, 12, 13], [6, 7, 14, 15]];

/// How finely sides are told apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Horizon {
    /// Where structures glint, each eighth of the horizon, above or below, may have seen something of its own.
    Eighths,
    /// Where echoes are smeared, darkness has to count for more.
    Quarters,
}

/// A block whose best voxel is this deep in darkness from a side needs no more looks from there: it
/// would take eight clear ones to bring it back to nothing.
const SETTLED_EVIDENCE: f32 = -4.0;
/// The same if every ping is looked at about once at most.
const SOON_SETTLED_EVIDENCE: f32 = -3.0;

/// Sums per voxel, z fastest: a fan stands upright on most vehicles, and is thin. A row of eight is then in it or not, as a
/// whole, from wherever it is seen.
pub(crate) type Sums = [f32; VOXELS];
/// 8 × 8 × 8 voxels.
#[derive(Debug, Default)]
pub(crate) struct Block {
    /// Position in units of blocks.
    pub(crate) key: IVec3,
    /// What was seen from each side.
    sides: [Side; SIDES],
    /// Those that were looked from since [`Self::lay_away`], a bit each.
    looked_from: u16,
    /// Slots of the Gaussians born here, by voxel.
    pub(crate) gaussians: Vec<(u16, u32)>,
    /// Voxels that were candidates when the block was last worked out and hold nothing, a bit each: none is
    /// born there until then again.
    pub(crate) barred: [u64; VOXELS / 64],
    /// No voxel has more evidence than this.
    pub(crate) most: f32,
    /// Evidence of looks that are not in `sides` any more, where there are Gaussians.
    left: Vec<(u16, f32)>,
}

/// The side a look comes from, by the direction towards its sensor.
fn side_of(towards_m: Vec3) -> usize {
    let (west, south, below) = (towards_m.x < 0.0, towards_m.y < 0.0, towards_m.z < 0.0);
    let is_steep = towards_m.y.abs() > towards_m.x.abs();
    let eighth = usize::from(west) + 2 * usize::from(south) + 4 * usize::from(is_steep);
    eighth + 8 * usize::from(below)
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
        self.sides = Default::default();
        self.left = Vec::new();
        self.most = 0.0;
    }

    /// Keeps evidence only of voxels that hold Gaussians.
    pub(super) fn leave(&mut self) {
        let sums = self.evidence(Horizon::Quarters);
        let mut voxels: Vec<u16> = self.gaussians.iter().map(|&(voxel, _)| voxel).collect();
        voxels.sort_unstable();
        voxels.dedup();
        let left = voxels
            .into_iter()
            .map(|voxel| (voxel, sums[usize::from(voxel)]));
        self.left = left.collect();
        self.sides = Default::default();
        // The other voxels have none.
        self.most = self.most.max(0.0);
        self.gaussians.shrink_to_fit();
    }

    /// Holds sides in fewer bytes that nobody looked from since it was asked to last.
    pub(super) fn lay_away(&mut self) {
        let looked_from = std::mem::take(&mut self.looked_from);
        for (index, side) in self.sides.iter_mut().enumerate() {
            if looked_from >> index & 1 == 0 {
                side.lay_away();
            }
        }
    }

    pub(super) fn center_m(&self, voxel_m: f32) -> Vec3 {
        (self.key.as_vec3() + 0.5) * (voxel_m * BLOCK_EDGE as f32)
    }

    /// Adds the evidence of `pings` in their order, and lets go of sides settled to the `extent` of
    /// looking on. Returns voxel looks done.
    pub(super) fn integrate<'a>(
        &mut self,
        pings: impl IntoIterator<Item = &'a Arc<Past>>,
        voxel_m: f32,
        extent: Extent,
    ) -> u64 {
        let (center_m, radius_m) = (self.center_m(voxel_m), radius_m(voxel_m));
        let (mut work, mut looked_from) = (0, [false; SIDES]);
        for past in pings {
            if past.fan.touches(center_m, radius_m) {
                let side = side_of(past.look.pose.position_m - center_m);
                looked_from[side] = true;
                if let Some(sums) = self.sides[side].sums() {
                    let glance = Glance::of(past, self.key, voxel_m);
                    let (looks, most) = dispatch!(Level::new(), simd => glance.add(simd, sums));
                    work += looks;
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
            for (index, side) in self.sides.iter_mut().enumerate() {
                if looked_from[index] {
                    if side.settle(below) {
                        // It may have been darker than it counts from now on.
                        self.most = f32::INFINITY;
                    }
                    self.looked_from |= 1 << index;
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

    /// Evidence for each voxel over all sides; what one saw dark counts only so far.
    pub(super) fn evidence(&self, sides: Horizon) -> Sums {
        self.totals(sides).map(|total| total as f32 / STEPS)
    }

    /// What sides say together, in steps: one that saw a place dark, since the structure hides itself
    /// or glints elsewhere, contradicts the others only so far.
    fn totals(&self, sides: Horizon) -> Totals {
        let mut totals = [0; VOXELS];
        dispatch!(Level::new(), _simd => match sides {
            Horizon::Eighths => self.add_sides(&mut totals, &EIGHTHS, AGAINST_EIGHTH),
            Horizon::Quarters => self.add_sides(&mut totals, &QUARTERS, AGAINST_QUARTER),
        });
        for &(voxel, sum) in &self.left {
            totals[usize::from(voxel)] += (STEPS * sum) as i32;
        }
        totals
    }

    #[inline(always)]
    fn add_sides<const N: usize>(&self, totals: &mut Totals, groups: &[[usize; N]], least: f32) {
        let least = (STEPS * least) as i32;
        for group in groups {
            let is_unseen = |&side: &usize| matches!(self.sides[side], Side::Unseen);
            if group.iter().all(is_unseen) {
                continue;
            }
            let mut together = [0; VOXELS];
            for &side in group {
                self.sides[side].add_to(&mut together);
            }
            for (total, together) in totals.iter_mut().zip(together) {
                *total += together.max(least);
            }
        }
    }
}

/// One ping against one block.
struct Glance<'a> {
    past: &'a Past,
    /// Centre of the first voxel in the beam's frame.
    first_m: Vec3,
    /// From voxel to voxel along each of the block's axes.
    steps_m: [Vec3; 3],
    voxel_m: f32,
    /// Squared tangent of elevation at [`FAN_SHARE`].
    edge: f32,
    beam_variance: f32,
    /// What each state says.
    ratios: [f32; 4],
}

impl<'a> Glance<'a> {
    fn of(past: &'a Past, key: IVec3, voxel_m: f32) -> Self {
        let look = &past.look;
        let into_beam = look.pose.axes.transpose();
        let first_m = ((key * BLOCK_EDGE).as_vec3() + 0.5) * voxel_m;
        let sigma = look.beam.azimuth_sigma_rad();
        Self {
            past,
            first_m: into_beam * (first_m - look.pose.position_m),
            steps_m: [into_beam.x_axis, into_beam.y_axis, into_beam.z_axis].map(|a| a * voxel_m),
            voxel_m,
            edge: (FAN_SHARE * look.beam.elevation_half_width_rad())
                .tan()
                .powi(2),
            beam_variance: sigma * sigma
                + look.azimuth_variance_rad2
                + POSE_DOUBT * past.blur.azimuth_variance_rad2,
            ratios: [0.0, DARK, LIT, SHADOWED].map(|ratio| ratio * past.weight),
        }
    }

    /// Adds the look to every voxel in its beam. Returns voxel looks done, and the most that was added to any.
    #[inline(always)]
    fn add<S: Simd>(&self, simd: S, sums: &mut SideSums) -> (u64, f32) {
        let look = &self.past.look;
        let [along_x, along_y, step] = self.steps_m;
        let voxel_variance_m2 = self.voxel_m * self.voxel_m / 12.0;
        let (per_bin, start_m) = (1.0 / look.bin_length_m, look.range_start_m);
        let [left, turn, roll] = look.pose.drift_per_m.to_array();
        let numbers = lanes::lane_numbers(simd);
        let (none, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
        let [across_x, across_y, across_z] = step.to_array().map(|step| numbers * step);
        let states = &self.past.profile.state;
        let bin_count = look.bin_count as f32;
        // Beyond this the beam's middle says nothing of a row, its drift included.
        let margin_m = 3.5 * step.y.abs() + ROW_MARGIN_VOXELS * self.voxel_m;
        let reach = (LOOK_SIGMAS_SQUARED * self.beam_variance).sqrt();
        let (mut work, mut most) = (0, none);
        for (row, sums) in sums.chunks_exact_mut(LANES).enumerate() {
            let start = self.first_m + along_x * (row / 8) as f32 + along_y * (row % 8) as f32;
            let middle = start + step * 3.5;
            let lever_m = middle.x.abs() + 3.5 * self.voxel_m;
            if middle.y.abs() > margin_m + reach * lever_m || middle.x < -4.0 * self.voxel_m {
                continue;
            }
            work += LANES as u64;
            let (x, y, z) = (across_x + start.x, across_y + start.y, across_z + start.z);
            let lever2 = x.mul_add(x, y * y);
            let range_m = z.mul_add(z, lever2).sqrt();
            let late_m = range_m - look.pose.reference_range_m;
            let across_m = y - late_m * (x * turn - z * roll + left);
            let variance_m2 = lever2 * self.beam_variance + voxel_variance_m2;
            let off = across_m * across_m / (variance_m2 * LOOK_SIGMAS_SQUARED);
            let bin = (range_m - start_m) * per_bin;
            let seen = x.simd_gt(0.0)
                & off.simd_lt(1.0)
                & (z * z).simd_lt(lever2 * self.edge)
                & bin.simd_ge(0.0);
            if seen.to_bitmask() == 0 {
                continue;
            }
            let clear = seen.select(one - off, none);
            // As whole numbers all at once: one by one that took a third of the look. Beyond the last
            // bin nothing is seen.
            let bins: i32x8<S> = bin.max(0.0).min(bin_count).to_int();
            let near = seen.select(bin, f32x8::splat(simd, bin_count)).reduce_min();
            let far = seen.select(bin, none).reduce_max().min(bin_count);
            let first = near as usize & !3;
            let ratio = match (far as usize) < first + 16 {
                // What is not seen may be of any state.
                true => {
                    let of_each = (bins - first as i32) * 2 & 31;
                    let all = i32x8::splat(simd, states.sixteen(first / 4).cast_signed());
                    self.ratio_of(all >> of_each & 3)
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
    use crate::accumulate::history::{look_of, past_of, pose_blur};
    use crate::detect::posed;
    use crate::detect::profile::{Backdrop, Levels};
    use echosplat_model::Pose;
    use echosplat_model::glam::{DVec3, Mat3};

    #[test]
    fn what_is_left_remembers_the_places_of_its_gaussians() {
        let mut block = Block::new(IVec3::ZERO);
        block.sides[0] = Side::Seen(Box::new([(STEPS * 20.0) as i16; VOXELS]));
        block.gaussians = vec![(7, 0), (7, 1)];
        block.leave();
        let evidence = block.evidence(Horizon::Eighths);
        assert!((evidence[7] - 20.0).abs() < 1e-3 && evidence[8].abs() < 1e-6);
        block.sides[3] = Side::Seen(Box::new([STEPS as i16; VOXELS]));
        assert!((block.evidence(Horizon::Quarters)[7] - 21.0).abs() < 1e-3);
    }

    #[test]
    fn a_side_that_sees_nothing_contradicts_the_others_only_so_far() {
        let mut block = Block::new(IVec3::ZERO);
        let seen_as = |sum: f32| Side::Seen(Box::new([(STEPS * sum) as i16; VOXELS]));
        let first = |block: &Block| block.evidence(Horizon::Quarters)[0];
        block.sides[0] = seen_as(20.0);
        block.sides[1] = seen_as(-50.0);
        assert!((first(&block) - 18.0).abs() < 1e-6);
        let settled: Vec<usize> = (0..SIDES)
            .filter(|&side| block.sides[side].settle(SETTLED_EVIDENCE))
            .collect();
        assert_eq!(settled, [1]);
        let is_settled = |side: &Side| matches!(side, Side::Settled);
        assert!(is_settled(&block.sides[1]) && !is_settled(&block.sides[0]));
        assert!((first(&block) - 18.0).abs() < 1e-6);
        block.sides[0] = seen_as(1.0);
        assert!(first(&block) < 0.0);
    }

    /// From the origin, towards 3 m where there may be an echo.
    fn past(number: u32, is_lit: bool) -> Arc<Past> {
        let power = |bin: u32| if is_lit && bin == 150 { 1e4 } else { 1.0 };
        let pose = Pose::from_yaw_pitch_roll(0.002 * f64::from(number), 0.0, 0.0, DVec3::ZERO);
        let posed = posed(number, (0..300).map(power).collect(), pose);
        let config = MapperConfig::default();
        let (look, blur) = (
            look_of(&posed, DVec3::ZERO, &config),
            pose_blur(&posed, &config),
        );
        let (ground, bursts) = (Backdrop::default(), Box::default());
        let profile = Levels::default().profile(&posed.ping, 0.04, &ground, bursts, &config);
        Arc::new(past_of(look, blur, profile, 1.0, 0.0, &posed))
    }

    /// What a ping says of a voxel's centre, told one by one.
    fn said_of(past: &Past, center_m: Vec3, voxel_m: f32) -> f32 {
        let look = &past.look;
        let (q, late) = {
            let still = look.pose.axes.transpose() * (center_m - look.pose.position_m);
            (still, still.length() - look.pose.reference_range_m)
        };
        let [left, turn, roll] = look.pose.drift_per_m.to_array();
        let across_m = q.y - late * (q.x * turn - q.z * roll + left);
        let lever2 = q.x * q.x + q.y * q.y;
        let beam = look.beam.azimuth_sigma_rad().powi(2)
            + look.azimuth_variance_rad2
            + POSE_DOUBT * past.blur.azimuth_variance_rad2;
        let variance_m2 = lever2 * beam + voxel_m * voxel_m / 12.0;
        let off = across_m * across_m / (variance_m2 * LOOK_SIGMAS_SQUARED);
        let half_width = FAN_SHARE * look.beam.elevation_half_width_rad();
        let bin = (q.length() - look.range_start_m) / look.bin_length_m;
        if q.x <= 0.0 || off >= 1.0 || q.z.abs() >= lever2.sqrt() * half_width.tan() || bin < 0.0 {
            return 0.0;
        }
        let ratio = match past.profile.state.at(bin as usize) {
            BinState::Blank => 0.0,
            BinState::Dark => DARK,
            BinState::Lit => LIT,
            BinState::Shadowed => SHADOWED,
        };
        (1.0 - off) * ratio * past.weight
    }

    #[test]
    fn eight_voxels_at_a_time_hear_what_each_would() {
        // Far bins, and bins so short that those of eight voxels are far apart; level, and on its side.
        let (voxel_m, mut told) = (0.05, 0);
        for (shortened, roll) in [(1.0, 0.0), (0.1, 0.0), (0.1, 1.5)] {
            let mut past = Past::clone(&past(20, true));
            past.look.range_start_m = 3.0 - 3.0 * shortened;
            past.look.bin_length_m *= shortened;
            past.look.pose.axes *= Mat3::from_rotation_x(roll);
            past.look.pose.drift_per_m = Vec3::new(1e-3, 2e-3, -1e-3);
            let past = Arc::new(past);
            for key in [[7, 0, 0], [7, 0, 1], [6, -1, -2], [7, 1, 0]].map(IVec3::from) {
                let mut block = Block::new(key);
                block.integrate([&past], voxel_m, Extent::All);
                let sums = block.evidence(Horizon::Eighths);
                for (voxel, sum) in sums.into_iter().enumerate() {
                    let [x, y, z] = [voxel / 64, voxel / 8 % 8, voxel % 8].map(|v| v as f32 + 0.5);
                    let center_m = (key * BLOCK_EDGE).as_vec3() + Vec3::new(x, y, z);
                    let said = said_of(&past, center_m * voxel_m, voxel_m);
                    // What one side says against is cut off.
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
            let past = past(number, number % 40 < 10);
            for block in &mut blocks {
                let before = block.most;
                block.integrate([&past], voxel_m, Extent::Useful);
                let evidence = block.evidence(Horizon::Quarters).into_iter();
                let most = evidence.fold(f32::MIN, f32::max);
                assert!(block.most >= most, "{} {most}", block.most);
                // One look adds no more than that of a voxel on the beam's axis.
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
            block.sides[index] = Side::Seen(Box::new(sums(factor)));
        }
        block.looked_from = 1 << 4;
        let said = |block: &Block| [Horizon::Eighths, Horizon::Quarters].map(|h| block.totals(h));
        let before = said(&block);
        let packed = |block: &Block| {
            block
                .sides
                .iter()
                .filter(|s| matches!(s, Side::Packed(_)))
                .count()
        };
        block.lay_away();
        assert_eq!((packed(&block), said(&block)), (2, before));
        block.lay_away();
        assert_eq!((packed(&block), said(&block)), (3, before));
        assert_eq!(block.sides[4].sums(), Some(&mut sums(-50)));
        assert_eq!((packed(&block), said(&block)), (2, before));
    }

    #[test]
    fn looks_come_from_the_side_their_sensor_is_on() {
        let towards = |side: i32| {
            let bearing_rad = f64::from(side % 8) * std::f64::consts::FRAC_PI_4 + 0.1;
            side_of(Vec3::new(
                bearing_rad.cos() as f32,
                bearing_rad.sin() as f32,
                if side < 8 { 0.2 } else { -0.2 },
            ))
        };
        let mut sides: Vec<usize> = (0..SIDES as i32).map(towards).collect();
        sides.sort_unstable();
        assert!(sides.into_iter().eq(0..SIDES));
        // Groups leave out none and count none twice.
        let mut grouped: Vec<usize> = QUARTERS.into_iter().flatten().collect();
        grouped.sort_unstable();
        assert!(grouped.into_iter().eq(0..SIDES));
    }
}
