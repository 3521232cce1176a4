//! Which Gaussians a ping can see, without asking each of them.
//!
//! Gaussians are sorted by size class and along a Morton curve; a binary tree over that order holds
//! the sphere around the means below each node and the largest extent among them. A tree per size
//! class keeps a few wide Gaussians from widening the nodes of many small ones.

use echosplat_model::glam::{DVec3, Vec3};

use crate::online::constants::{BEAM_REACH_SIGMAS, RANGE_REACH_SIGMAS};
use crate::{GaussianArrays, PingGeometry};

/// Gaussians below a leaf; layout.
const LEAF_LEN: usize = 8;
/// Log ratio of sizes, grid: ln 4.
/// Each class holds sizes up to this many times the one below.
const CLASS_LOG_STEP: f32 = 1.386_294_4;
/// Sigmas, derived: what is projected, and rounding.
/// What `PingGeometry::project` lets through off the beam; a bit more for rounding.
const ACROSS_SIGMAS: f32 = BEAM_REACH_SIGMAS + 0.01;
/// Half-widths, derived: the weight is 10⁻³.
/// The fan's weight falls to 10⁻³ at `9.966^(1/8)` = 1.333 half-widths.
const FAN_HALF_WIDTHS: f32 = 1.335;
/// Sigmas, derived: 10⁻⁹ of the energy is left.
/// How far before its mean a Gaussian is heard: sigmas of its own, and 6.5 by which the beam
/// may shift r′ before less than 10⁻⁹ of its energy is left.
const ALONG_SIGMAS: f32 = RANGE_REACH_SIGMAS + 6.5;
/// Sigmas of pulse and position, derived.
/// What pulse and position blur, in sigmas.
const BLUR_SIGMAS: f32 = RANGE_REACH_SIGMAS;
/// Fraction, derived: f32 over some twenty operations.
const ROUNDING: f32 = 1e-5;
/// Bits of a cell along an axis; layout.
/// Cells of the Morton curve along an axis, as bits.
const MORTON_BITS: u32 = 21;

/// A tree over Gaussians, for one state of them; indices are those of the arrays.
#[derive(Debug, Clone, Default)]
pub struct SpatialIndex {
    nodes: Vec<Node>,
    /// In the tree's order.
    members: Vec<Member>,
}

/// In depth-first order: an inner node's first child follows it.
#[derive(Debug, Clone, Copy)]
struct Node {
    sphere: Member,
    radius_m: f32,
    /// The node after everything below this one.
    next: u32,
    /// Of a leaf, its members; empty otherwise.
    first: u32,
    len: u32,
}

/// One Gaussian, or the middle and largest extent of several.
#[derive(Debug, Clone, Copy)]
struct Member {
    mean_m: Vec3,
    /// Root of the covariance's trace.
    extent_m: f32,
    index: u32,
}

impl SpatialIndex {
    /// Of all Gaussians whose mean and scales are finite; the others are never visible.
    #[must_use]
    pub fn new(gaussians: &GaussianArrays) -> Self {
        let finite = (0..gaussians.len()).filter_map(|i| {
            let at = |columns: &[Vec<f32>; 3]| Vec3::from_array([0, 1, 2].map(|k| columns[k][i]));
            let (mean_m, log_scale) = (at(&gaussians.mean_m), at(&gaussians.log_scale));
            (mean_m.is_finite() && log_scale.is_finite()).then(|| Member {
                mean_m,
                extent_m: log_scale.exp().length(),
                index: i as u32,
            })
        });
        Self::of(finite.collect())
    }

    fn of(mut members: Vec<Member>) -> Self {
        sort_along_curve(&mut members);
        let mut index = Self {
            nodes: Vec::with_capacity(members.len() / (LEAF_LEN / 4) + 8),
            members,
        };
        let mut start = 0;
        while start < index.members.len() {
            let class = index.members[start].class();
            let rest = &index.members[start..];
            let end = start + rest.partition_point(|member| member.class() <= class);
            index.grow(start, end);
            start = end;
        }
        index
    }

    /// Appends the tree over `members[start..end]`; depth is the logarithm of their number.
    fn grow(&mut self, start: usize, end: usize) {
        let place = self.nodes.len();
        let (sphere, radius_m) = around(&self.members[start..end]);
        let is_leaf = end - start <= LEAF_LEN;
        self.nodes.push(Node {
            sphere,
            radius_m,
            next: 0,
            first: start as u32,
            len: if is_leaf { (end - start) as u32 } else { 0 },
        });
        if !is_leaf {
            let middle = start.midpoint(end);
            self.grow(start, middle);
            self.grow(middle, end);
        }
        self.nodes[place].next = self.nodes.len() as u32;
    }

    /// Replaces `visible` by every Gaussian that [`PingGeometry::project`] lets through and that reaches a
    /// bin, or hides what does, with more than 10⁻⁹ of its energy, and by few others; in ascending
    /// order. Returns how many nodes and Gaussians were tested.
    pub fn visible(&self, geometry: &PingGeometry, visible: &mut Vec<u32>) -> u64 {
        visible.clear();
        let slice = Slice::of(geometry);
        let (mut at, mut tested) = (0, 0);
        while let Some(node) = self.nodes.get(at) {
            tested += 1;
            if !slice.may_see(&node.sphere, node.radius_m) {
                at = node.next as usize;
                continue;
            }
            at += 1;
            let (first, len) = (node.first as usize, node.len as usize);
            tested += u64::from(node.len);
            let seen = self.members[first..first + len].iter();
            let seen = seen.filter(|member| slice.may_see(member, 0.0));
            visible.extend(seen.map(|member| member.index));
        }
        visible.sort_unstable();
        tested
    }
}

impl Member {
    fn class(&self) -> i32 {
        // A scale of 0 gives −∞, which the cast saturates.
        (self.extent_m.ln() / CLASS_LOG_STEP).floor() as i32
    }
}

/// By size class, and within one along a Morton curve; ties by index.
fn sort_along_curve(members: &mut [Member]) {
    let means = || members.iter().map(|member| member.mean_m.as_dvec3());
    let low = means().reduce(DVec3::min).unwrap_or_default();
    let high = means().reduce(DVec3::max).unwrap_or_default();
    let size_m = (high - low).max_element().max(1e-30);
    let cells = f64::from((1u32 << MORTON_BITS) - 1);
    let key = |member: &Member| {
        let cell = (member.mean_m.as_dvec3() - low) * (cells / size_m);
        let [x, y, z] = cell.to_array().map(|c| spread_bits(c as u64));
        (member.class(), x | (y << 1) | (z << 2), member.index)
    };
    members.sort_by_cached_key(key);
}

/// Two zero bits between neighbouring bits of the lowest 21.
fn spread_bits(value: u64) -> u64 {
    let mut v = value & 0x1f_ffff;
    v = (v | (v << 32)) & 0x001f_0000_0000_ffff;
    v = (v | (v << 16)) & 0x001f_0000_ff00_00ff;
    v = (v | (v << 8)) & 0x100f_00f0_0f00_f00f;
    v = (v | (v << 4)) & 0x10c3_0c30_c30c_30c3;
    (v | (v << 2)) & 0x1249_2492_4924_9249
}

/// A sphere around all means, with the largest extent; `members` is not empty.
fn around(members: &[Member]) -> (Member, f32) {
    let low = members.iter().map(|m| m.mean_m).fold(Vec3::MAX, Vec3::min);
    let high = members.iter().map(|m| m.mean_m).fold(Vec3::MIN, Vec3::max);
    let mean_m = 0.5 * low + 0.5 * high;
    let farthest_m = members.iter().map(|m| m.mean_m.distance(mean_m));
    let extents = members.iter().map(|m| m.extent_m);
    let sphere = Member {
        mean_m,
        extent_m: extents.fold(0.0, f32::max),
        index: 0,
    };
    (sphere, farthest_m.fold(0.0, f32::max))
}

/// What one ping can see of space, as bounds. All tests err towards yes, on NaN too.
struct Slice {
    geometry: PingGeometry,
    pattern_sigma: f32,
    /// Farthest mean, but for the Gaussian's own extent.
    end_m: f32,
    elevation_cos: f32,
    elevation_sin: f32,
}

impl Slice {
    fn of(geometry: &PingGeometry) -> Self {
        let sigma_b = geometry.beam.azimuth_sigma_rad();
        let elevation = (FAN_HALF_WIDTHS * geometry.beam.elevation_half_width_rad()).min(1.57);
        let end_m = geometry.range_start_m + geometry.bin_length_m * geometry.bin_count as f32;
        Self {
            geometry: *geometry,
            pattern_sigma: (sigma_b * sigma_b + geometry.azimuth_variance_rad2).sqrt(),
            end_m: end_m + BLUR_SIGMAS * geometry.range_variance_m2.sqrt(),
            elevation_cos: elevation.cos(),
            elevation_sin: elevation.sin(),
        }
    }

    /// Whether any Gaussian with its mean within `radius_m` of the member's, and no larger, may be
    /// seen: the conditions of [`PingGeometry::project`] with every distance widened by what the mean may
    /// be off, and by how far the sensor may drift until the echo.
    fn may_see(&self, member: &Member, radius_m: f32) -> bool {
        let pose = &self.geometry.pose;
        let q = pose.axes.transpose() * (member.mean_m - pose.position_m);
        let distance_m = q.length();
        let reach_m = distance_m + radius_m;
        let drift = pose.drift_per_m;
        let late_m = reach_m.max(pose.reference_range_m);
        let drifted_m = late_m * (drift.x.abs() + (drift.y.abs() + drift.z.abs()) * reach_m);
        let slack_m = radius_m + drifted_m + ROUNDING * (reach_m + pose.position_m.length());

        let too_far = distance_m - slack_m > self.end_m + ALONG_SIGMAS * member.extent_m;
        let behind = q.x + slack_m < 0.25 * (distance_m - slack_m);
        let across_m = self.pattern_sigma * (reach_m + drifted_m) + member.extent_m;
        let beside = q.y.abs() > slack_m + ACROSS_SIGMAS * across_m;
        let lever_m = q.x.hypot(q.y);
        let above = q.z.abs() * self.elevation_cos - lever_m * self.elevation_sin > slack_m;
        !(too_far || behind || beside || above)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Beam, Parameters, PingPose};
    use echosplat_model::glam::{EulerRot, Mat3, Quat};

    /// Reproducible numbers in 0 to 1.
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> f32 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (self.0 >> 40) as f32 / (1u64 << 24) as f32
        }

        fn within(&mut self, low: f32, high: f32) -> f32 {
            low + (high - low) * self.next()
        }

        fn vec(&mut self, half_m: f32) -> Vec3 {
            Vec3::from_array([(); 3].map(|()| self.within(-half_m, half_m)))
        }

        fn rotation(&mut self) -> Quat {
            let [a, b, c] = [(); 3].map(|()| self.within(-3.1, 3.1));
            Quat::from_euler(EulerRot::ZYX, a, b, c)
        }

        fn gaussian(&mut self, half_m: f32, log_scale: (f32, f32)) -> Parameters {
            let scale = [(); 3].map(|()| self.within(log_scale.0, log_scale.1));
            Parameters {
                mean_m: self.vec(half_m),
                rotation: self.rotation(),
                log_scale: Vec3::from_array(scale),
                opacity_logit: 0.0,
                reflectivity_log: 0.0,
            }
        }

        fn geometry(&mut self, half_m: f32) -> PingGeometry {
            PingGeometry {
                pose: PingPose {
                    position_m: self.vec(half_m),
                    axes: Mat3::from_quat(self.rotation()),
                    drift_per_m: self.vec(4e-4),
                    reference_range_m: 5.0,
                },
                range_start_m: self.within(0.0, 2.0),
                bin_length_m: self.within(0.005, 0.1),
                bin_count: 600,
                range_variance_m2: 5e-4,
                azimuth_variance_rad2: 1e-5,
                beam: Beam::default(),
            }
        }
    }

    fn arrays(all: impl IntoIterator<Item = Parameters>) -> GaussianArrays {
        let mut arrays = GaussianArrays::new();
        all.into_iter().for_each(|one| arrays.push(one));
        arrays
    }

    /// By asking every Gaussian.
    fn heard(geometry: &PingGeometry, gaussians: &GaussianArrays) -> Vec<u32> {
        let is_heard = |i: &u32| {
            let one = gaussians.get(*i as usize);
            let Some(splat) = geometry.project(one.mean_m, &one.covariance_m2()) else {
                return false;
            };
            let off = splat.azimuth_rad * splat.azimuth_rad / splat.azimuth_variance_rad2;
            off < 41.0 && geometry.bins_of(&splat).start < geometry.bin_count as usize
        };
        (0..gaussians.len() as u32).filter(is_heard).collect()
    }

    #[test]
    fn nothing_heard_is_missed_from_a_millimetre_to_a_hundred_metres() {
        let mut numbers = Numbers(7);
        let mut heard_count = 0;
        for scene in 0..32 {
            let half_m = [0.3, 3.0, 30.0, 300.0][scene % 4];
            let sizes = [(-7.0, -4.0), (-4.0, 0.0), (-7.0, 4.6), (2.0, 4.6)][scene / 4 % 4];
            let gaussians = arrays((0..500).map(|_| numbers.gaussian(half_m, sizes)));
            let index = SpatialIndex::new(&gaussians);
            let mut visible = Vec::new();
            for _ in 0..40 {
                let geometry = numbers.geometry(half_m);
                index.visible(&geometry, &mut visible);
                assert!(visible.is_sorted_by(|a, b| a < b));
                for i in heard(&geometry, &gaussians) {
                    heard_count += 1;
                    let found = visible.binary_search(&i).is_ok();
                    assert!(
                        found,
                        "scene {scene}: {i} of {:?}",
                        gaussians.get(i as usize)
                    );
                }
            }
        }
        assert!(heard_count > 10_000, "{heard_count}");
    }

    #[test]
    fn a_ping_tests_its_surroundings_and_not_the_map() {
        let mut numbers = Numbers(3);
        let mut tested_per_visible = |half_m: f32, count: usize| {
            // Small ones as in a map, and a few giants far away from all pings.
            let mut gaussians = arrays((0..count).map(|_| numbers.gaussian(half_m, (-4.0, -3.0))));
            let mut giant = numbers.gaussian(1.0, (4.6, 4.61));
            giant.mean_m = Vec3::splat(1e5);
            gaussians.push(giant);
            let index = SpatialIndex::new(&gaussians);
            let (mut tested, mut seen, mut visible) = (0, 0, Vec::new());
            for _ in 0..50 {
                let mut geometry = numbers.geometry(0.2 * half_m);
                geometry.bin_length_m = 0.02;
                tested += index.visible(&geometry, &mut visible);
                seen += heard(&geometry, &gaussians).len() as u64;
            }
            assert!(seen > 500, "{seen}");
            (tested / 50, tested / seen)
        };
        let (near, ratio) = tested_per_visible(10.0, 10_000);
        assert!(ratio < 60, "{ratio} tests for each Gaussian heard");
        // The same density over 27 times the volume.
        let (far, _) = tested_per_visible(30.0, 270_000);
        assert!(
            far < 3 * near,
            "{near} tests in the small map, {far} in the large"
        );
    }

    #[test]
    fn what_is_not_finite_is_left_out() {
        let mut numbers = Numbers(1);
        let mut bad = numbers.gaussian(1.0, (-3.0, -2.0));
        bad.mean_m.y = f32::NAN;
        let mut endless = numbers.gaussian(1.0, (-3.0, -2.0));
        endless.log_scale.x = f32::INFINITY;
        let mut good = numbers.gaussian(1.0, (-3.0, -2.0));
        good.mean_m = Vec3::ZERO;
        let index = SpatialIndex::new(&arrays([bad, good, endless]));
        let mut geometry = numbers.geometry(0.0);
        geometry.pose.position_m = geometry.pose.axes * Vec3::new(-5.0, 0.0, 0.0);
        let mut visible = vec![9];
        index.visible(&geometry, &mut visible);
        assert_eq!(visible, [1]);
        SpatialIndex::new(&GaussianArrays::new()).visible(&geometry, &mut visible);
        assert!(visible.is_empty());
    }

    #[test]
    fn many_at_one_place_make_a_tree_of_bounded_depth() {
        let mut numbers = Numbers(5);
        let one = numbers.gaussian(0.0, (-3.0, -2.0));
        let index = SpatialIndex::new(&arrays((0..10_000).map(|_| one)));
        let mut geometry = numbers.geometry(0.0);
        geometry.pose.position_m = geometry.pose.axes * Vec3::new(-5.0, 0.0, 0.0);
        geometry.pose.drift_per_m = Vec3::ZERO;
        let mut visible = Vec::new();
        index.visible(&geometry, &mut visible);
        assert_eq!(visible.len(), 10_000);
    }
}
