//! What the map asserts: a Gaussian is surface only if its surroundings explain most of its echoes and the observations
//! fix its position; else it is ambiguous, or explained away by others.

use std::f32::consts::PI;
use std::ops::Range;

use echosplat_measurement::heard::Rows;
use echosplat_measurement::simd_level;
use echosplat_model::glam::IVec3;
use echosplat_model::{Reason, Standing, Why};
use fearless_simd::dispatch;
use foldhash::{HashMap, HashMapExt};
use rayon::prelude::*;

use crate::MapperConfig;
use crate::accumulate::common_error::Faded;
use crate::accumulate::finding::{Finding, ViewStatistics};
use crate::accumulate::history::Keyframe;
use crate::classify::certainty;
use crate::classify::occlusion::Occlusion;
use crate::features::AtWork;
use crate::refine::expectation::{Explained, Score, Sum};
use crate::refine::shape::least_eigenvalue;
use crate::refine::tally::Tally;
use crate::refine::visibility::Sight;
use crate::spawn::gaussians::{Gaussians, Verdict};
use crate::spawn::neighbours::Neighbours;
use crate::spawn::split::CHILD_SHARE;

/// Bins, found: half explain under 0.005.
/// A Gaussian is let go if what it explains of all pings together is less than this fraction of one bin: others explain
/// the echoes that it was spawned from.
const LEAST_EXPLAINED: f32 = 0.1;
/// Voxels, found.
/// Surroundings reach this many voxels: places the sonar cannot tell apart are one explanation.
const SURROUNDINGS_VOXELS: f32 = 5.0;
/// Clear observations; found.
/// Least number of clear observations. At the rim of what a dive saw, a handful agree by chance.
const LEAST_OBSERVATIONS: f32 = 8.0;
/// Clear observations where smeared; found.
/// Where poses smear echoes over voxels, more do.
const LEAST_SMEARED_OBSERVATIONS: f32 = 10.0;
/// Nats; found.
/// Log likelihood ratio at which a place is sure although few observations, or a small fraction of them, are clear:
/// weak echoes are dark in most pings. A clear observation counts as one more.
const ENOUGH_ODDS: f32 = 15.0;
/// Fraction; found.
/// Such a place explains at least half of what the best place on its arcs does.
const LEAST_LIKELY_EXPLAINED_RATIO: f32 = 0.5;
/// Steps either side; found.
/// Steps of an arc on either side that are a place's surroundings, and those of them that are its middle.
const AROUND_STEPS: usize = 2;
/// Steps either side; found.
const MIDDLE_STEPS: usize = 1;
/// Fraction, found: most of it.
/// Least fraction of what its surroundings send back that comes from their middle: with less, the surface is beside the
/// place. An even spread has three fifths.
const LEAST_COMPACTNESS: f32 = 0.5;
/// Fraction; found.
/// Least fraction of its lit observations that are clear: a place beside others is seen alone now and then.
const LEAST_CLEAR_SHARE: f32 = 0.15;
/// Fraction; found.
/// Greatest fraction of its lit observations that pass through another surface: what is behind an opaque one is its
/// ghost, but a frame of bars is seen through.
const MOST_HIDDEN_SHARE: f32 = 0.7;
/// Fraction; found.
/// Hysteresis linking: beside a surface this fraction of the clear observations is enough, and a place may be this much
/// less certain. Chance leaves isolated points, not surfaces, and along a surface places are hard to tell apart.
const OBSERVATIONS_TO_LINK: f32 = 0.6;
/// Ratio of sigma that may link; found.
const SIGMAS_TO_LINK: f32 = 4.0;
/// Gaussians; found.
/// Whole confident Gaussians within so many voxels that make a surface to link to, none of them this much stronger:
/// what is beside them and far weaker is a side lobe.
const LINK_SUPPORT: f32 = 8.0;
/// Voxels around; found.
const LINK_VOXELS: f32 = 6.0;
/// Ratio of strength; found.
const MUCH_STRONGER: f32 = 5.0;
/// Metres, derived: where probability speaks of surface.
/// A mirror image this near is the same place; farther ones have to scatter by this much.
const HARMLESS_MIRROR_M: f32 = certainty::NEAR_M;
/// Metres of scatter; found.
const LEAST_MIRROR_SPREAD_M: f32 = 0.3;
/// Fraction; found.
/// With a smaller explained-energy ratio, what it explains over what the best place on its arcs does, a Gaussian is
/// explained away. Where all places explain alike nothing is: they are ambiguous together.
const LEAST_EXPLAINED_RATIO: f32 = 0.15;
/// Fraction of the strongest around; found.
/// Below this fraction of the strongest strength around it, it is a side lobe of a neighbour.
const LEAST_STRENGTH: f32 = 0.12;
/// Voxels around; found.
/// How far around.
const PEAK_VOXELS: f32 = 2.5;

/// Bins at a time; layout.
const TOGETHER: usize = 32;
/// Half-widths, derived: the fan's edge.
/// Arcs go on beyond the fan's edges by this factor; what lies further out counts as their ends.
const FAN_REACH: f32 = 1.3;

/// Gaussians, found: a rod has 12, random pulses 1.4.
/// Minimum support where another sonar is heard: least number of whole confident Gaussians within so many voxels,
/// itself included. Each child of a split one counts by its share. A rod one voxel thick has six times as many.
const LEAST_NEAR_SUPPORT: f32 = 2.0;
/// Voxels around; found.
const NEAR_SUPPORT_VOXELS: f32 = 6.0;
/// Gaussians; found.
/// The same further around, on every dive: a rod with specular returns shows here and there along its whole length.
const LEAST_SUPPORT: f32 = 12.0;
/// Voxels around; found.
const SUPPORT_VOXELS: f32 = 16.0;

const CONFIDENT: Verdict = Verdict::Published(Standing::Confident);

impl ViewStatistics {
    /// Whether the observations tell the place from its mirror image: it is too near to matter, or each observation has
    /// it elsewhere.
    fn tells_from_mirror(&self) -> bool {
        let mean_m = self.mirror_m / self.observations;
        mean_m.length() < HARMLESS_MIRROR_M
            || self.mirror_spread_m2() > LEAST_MIRROR_SPREAD_M.powi(2)
    }

    /// Variance of where its mirror image is.
    fn mirror_spread_m2(&self) -> f32 {
        let mean_m = self.mirror_m / self.observations;
        self.mirror_m2 / self.observations - mean_m.length_squared()
    }

    /// Whether its observations fix a place, one sigma of which is given: by which test if they do, else the first that they
    /// fail.
    fn fixes(&self, sigma_m: f32, thresholds: VerdictThresholds) -> Result<Why, Why> {
        let why = |reason, measured| Why::of(reason, self.clear_observations, measured);
        let fraction = |of: f32| of / self.observations;
        let by_clear = self.told_clearly(sigma_m, thresholds);
        let is_likely = self.odds + self.clear_observations >= thresholds.odds
            && self.explained_ratio >= LEAST_LIKELY_EXPLAINED_RATIO * self.observations
            && sigma_m <= thresholds.likely_sigma_m;
        if by_clear.is_err() && !is_likely {
            return by_clear;
        }
        if !(self.compactness >= LEAST_COMPACTNESS * self.observations) {
            return Err(why(Reason::BesideSurface, fraction(self.compactness)));
        }
        if !(self.hidden_observations <= MOST_HIDDEN_SHARE * self.observations) {
            return Err(why(Reason::Hidden, fraction(self.hidden_observations)));
        }
        if !self.tells_from_mirror() {
            let spread_m = self.mirror_spread_m2().max(0.0).sqrt();
            return Err(why(Reason::MirrorFits, spread_m));
        }
        let likely = why(Reason::Likely, self.odds + self.clear_observations);
        by_clear.or(Ok(likely))
    }

    /// Whether enough of its observations are clear, and fix the place.
    fn told_clearly(&self, sigma_m: f32, thresholds: VerdictThresholds) -> Result<Why, Why> {
        let why = |reason, measured| Why::of(reason, self.clear_observations, measured);
        let share = self.clear_observations / self.observations;
        if !(self.clear_observations >= thresholds.observations) {
            let odds = self.odds + self.clear_observations;
            return Err(why(Reason::FewClear, odds));
        }
        if !(self.clear_observations >= LEAST_CLEAR_SHARE * self.observations) {
            return Err(why(Reason::SmallClearShare, share));
        }
        if !(sigma_m <= thresholds.sigma_m) {
            return Err(why(Reason::WidePlace, sigma_m));
        }
        Ok(why(Reason::ClearlySeen, share))
    }
}

/// A verdict, and what gave it.
struct Judged {
    slot: usize,
    verdict: Verdict,
    why: Why,
    /// What would, were it confident by a surface beside it; `None` where it may not be.
    may_link: Option<Why>,
}

impl Judged {
    /// Of its findings and one sigma of its place.
    fn of(
        slot: usize,
        statistics: &ViewStatistics,
        (sigma_m, is_outshone): (f32, bool),
        thresholds: VerdictThresholds,
    ) -> Self {
        let judged = |verdict, why| Self {
            slot,
            verdict,
            why,
            may_link: None,
        };
        let clear = statistics.clear_observations;
        let explained_ratio = statistics.explained_ratio / statistics.observations;
        if is_outshone {
            return judged(
                Verdict::ExplainedAway,
                Why::of(Reason::Outshone, clear, 0.0),
            );
        }
        if !(explained_ratio > LEAST_EXPLAINED_RATIO) {
            let reason = match statistics.observations > 0.0 {
                true => Reason::ExplainsLittle,
                false => Reason::Unlit,
            };
            return judged(
                Verdict::ExplainedAway,
                Why::of(reason, clear, explained_ratio),
            );
        }
        match statistics.fixes(sigma_m, thresholds) {
            Ok(why) => judged(CONFIDENT, why),
            Err(why) => {
                let may_link = statistics.fixes(sigma_m, thresholds.to_link());
                let linked = |_| Why::of(Reason::Linked, clear, sigma_m);
                Self {
                    may_link: may_link.ok().map(linked),
                    ..judged(Verdict::Published(Standing::Ambiguous), why)
                }
            }
        }
    }
}

/// Thresholds that a confident Gaussian has to reach.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VerdictThresholds {
    /// Least number of clear observations.
    observations: f32,
    /// Most one-sigma uncertainty.
    sigma_m: f32,
    /// Log likelihood ratio that does in place of clear observations, and the uncertainty it may have then.
    odds: f32,
    likely_sigma_m: f32,
    /// Least share of an echo that makes an observation clear.
    clear_share: f32,
    /// Minimum support: least number of whole confident Gaussians beside one, itself included; `None` where no other
    /// sonar is heard.
    near_support: Option<f32>,
    /// What a Gaussian that was not split counts among them, where others were.
    unsplit: f32,
    /// Time constant of the error that poses have in common.
    pose_error_time_s: f64,
}

impl VerdictThresholds {
    pub(crate) fn of(config: &MapperConfig, at_work: AtWork) -> Self {
        Self {
            observations: match at_work.smeared {
                true => LEAST_SMEARED_OBSERVATIONS,
                false => LEAST_OBSERVATIONS,
            },
            sigma_m: config.confident_sigma_m,
            // Where poses smear echoes the likelihood is not that of the echoes.
            odds: match at_work.smeared {
                true => f32::INFINITY,
                false => ENOUGH_ODDS,
            },
            likely_sigma_m: SIGMAS_TO_LINK * config.confident_sigma_m,
            clear_share: config.confident_share,
            // Pulses at random leave small clusters; without them a surface may be heard in small pieces only.
            near_support: at_work.interfered.then_some(LEAST_NEAR_SUPPORT),
            // It was not confident when the others were split, so that it counts no more than a child.
            unsplit: CHILD_SHARE,
            pose_error_time_s: config.pose_error_time_s,
        }
    }

    /// For a work-out with so few steps before the split that many places are confident only after it.
    pub(crate) fn in_haste(self) -> Self {
        Self {
            unsplit: 1.0,
            ..self
        }
    }

    /// The lower thresholds of one that may be linked to a surface.
    fn to_link(self) -> Self {
        Self {
            observations: OBSERVATIONS_TO_LINK * self.observations,
            sigma_m: SIGMAS_TO_LINK * self.sigma_m,
            ..self
        }
    }
}

impl Sum for Finding {
    /// Pings whose findings one thread sums; layout.
    /// A ping's findings take long.
    const CHUNK: usize = 16;

    fn join(&mut self, other: &Self) {
        self.add(other);
    }
}

/// Adds what a ping says of each Gaussian.
pub(crate) fn findings_of_ping(
    tally: &mut Tally<Finding>,
    desk: &mut Desk,
    keyframe: &Keyframe,
    sight: &mut Sight,
    gaussians: &Gaussians,
    rule: Rule,
) {
    sight.find_moments();
    desk.enter(tally, keyframe, sight, gaussians, rule);
    let at = keyframe.time.as_secs_f64() / rule.pose_error_time_s;
    let rows = sight.rows();
    let mut faded = Faded::default();
    for run in sight.runs() {
        let findings = tally.of(run.block, run.count);
        for row in sight.heard_of(run) {
            let mut score = Score::default();
            score.add(rows, row, &sight.moments(row), keyframe.weight);
            let pose_m2 = certainty::of_pose(rows, row, keyframe.pose_error);
            let finding = &mut findings[run.within(rows.place[row])];
            finding.add_observation(&score, pose_m2, at, &mut faded);
        }
    }
}

/// Sets the verdict of every Gaussian that there is a finding for: what all pings would say of it. The others keep theirs.
pub(crate) fn judge(
    gaussians: &mut Gaussians,
    finding_of: impl Fn(usize) -> Option<Finding> + Sync,
    voxel_m: f32,
    thresholds: VerdictThresholds,
) {
    let outshone = Neighbours::new(gaussians, PEAK_VOXELS * voxel_m, |_| true)
        .outshone(LEAST_STRENGTH, |slot| finding_of(slot).is_some());
    let of_slot = |(slot, is_outshone): (usize, bool)| {
        let Finding {
            statistics,
            information,
            ..
        } = finding_of(slot)?;
        let alone = 1.0 / least_eigenvalue(&information).max(0.0).sqrt();
        // What the children of a split Gaussian know adds up.
        let sigma_m = alone * gaussians.child_share[slot];
        let found = (sigma_m, is_outshone);
        Some(Judged::of(slot, &statistics, found, thresholds))
    };
    let verdicts: Vec<Option<Judged>> = outshone.into_par_iter().map(of_slot).collect();
    let mut may_link = vec![None; gaussians.slot_count()];
    for judged in verdicts.into_iter().flatten() {
        gaussians.verdict[judged.slot] = judged.verdict;
        gaussians.why[judged.slot] = judged.why;
        may_link[judged.slot] = judged.may_link;
    }
    link_by_hysteresis(gaussians, &may_link, voxel_m);
    if let Some(least) = thresholds.near_support {
        let counts = counts_beside(gaussians, thresholds.unsplit);
        let support = (least, NEAR_SUPPORT_VOXELS * voxel_m, Reason::IsolatedNear);
        reject_isolated(gaussians, support, counts);
    }
    let support = (LEAST_SUPPORT, SUPPORT_VOXELS * voxel_m, Reason::Isolated);
    reject_isolated(gaussians, support, |child_share| child_share);
}

/// Hysteresis linking: what reaches the lower thresholds is confident beside a surface that reaches the upper ones.
fn link_by_hysteresis(gaussians: &mut Gaussians, may_link: &[Option<Why>], voxel_m: f32) {
    let is_confident = |slot: usize| gaussians.verdict[slot] == CONFIDENT;
    let keep = |slot: usize| may_link[slot].is_some() || is_confident(slot);
    let neighbours = Neighbours::new(gaussians, LINK_VOXELS * voxel_m, keep);
    let asked = |slot: usize| may_link[slot].is_some();
    let is_linked = neighbours.map(asked, |around| {
        let strong = MUCH_STRONGER * gaussians.strongest(around.slot);
        let mut surface = 0.0;
        around.slots().any(|other| {
            if is_confident(other) && gaussians.strongest(other) < strong {
                surface += gaussians.child_share[other];
            }
            surface >= LINK_SUPPORT
        })
    });
    for (slot, _) in is_linked.into_iter().filter(|(_, is_linked)| *is_linked) {
        gaussians.verdict[slot] = CONFIDENT;
        gaussians.why[slot] = may_link[slot].unwrap_or_default();
    }
}

/// Isolated-point rejection: what has fewer than `least` whole confident Gaussians within `reach_m` is ambiguous, since
/// a surface fills more than one place, for the reason given. `counts` is what each counts, by its share of a whole one.
fn reject_isolated(
    gaussians: &mut Gaussians,
    (least, reach_m, reason): (f32, f32, Reason),
    counts: impl Fn(f32) -> f32 + Sync,
) {
    let is_confident = |slot: usize| gaussians.verdict[slot] == CONFIDENT;
    // All of a cell are within reach of each other: most need no search around.
    let cell_m = reach_m / 2.0;
    let cell_of = |slot: usize| (gaussians.mean_m[slot] / cell_m).floor().as_ivec3();
    let mut wholes_in: HashMap<IVec3, f32> = HashMap::new();
    for slot in gaussians.slots().filter(|&slot| is_confident(slot)) {
        *wholes_in.entry(cell_of(slot)).or_default() += counts(gaussians.child_share[slot]);
    }
    let asked = |slot: usize| wholes_in[&cell_of(slot)] < least;
    let neighbours = Neighbours::new(gaussians, reach_m, is_confident);
    let support = neighbours.map(asked, |around| {
        let mut wholes = 0.0;
        let is_in_surface = around.slots().any(|other| {
            wholes += counts(gaussians.child_share[other]);
            wholes >= least
        });
        (!is_in_surface).then_some(wholes)
    });
    let isolated = support
        .into_iter()
        .filter_map(|(slot, wholes)| Some((slot, wholes?)));
    let isolated: Vec<(usize, f32)> = isolated.collect();
    for (slot, wholes) in isolated {
        gaussians.verdict[slot] = Verdict::Published(Standing::Ambiguous);
        let why = &mut gaussians.why[slot];
        *why = Why {
            clear: why.clear,
            ..Why::of(reason, 0.0, wholes)
        };
    }
}

/// What a Gaussian counts beside others by its share of a whole one: that share, and where there are split ones at most
/// `unsplit`.
fn counts_beside(gaussians: &Gaussians, unsplit: f32) -> impl Fn(f32) -> f32 + Sync + use<> {
    let mut confident = gaussians
        .slots()
        .filter(|&slot| gaussians.verdict[slot] == CONFIDENT);
    let is_split = confident.any(|slot| gaussians.child_share[slot] < 1.0);
    move |child_share| {
        if is_split {
            child_share.min(unsplit)
        } else {
            child_share
        }
    }
}

/// Median strength of the confident; infinite if there are none.
fn whole_strength(gaussians: &Gaussians) -> f32 {
    let confident = gaussians
        .slots()
        .filter(|&s| gaussians.verdict[s] == CONFIDENT);
    let mut strengths: Vec<f32> = confident.map(|slot| gaussians.strongest(slot)).collect();
    if strengths.is_empty() {
        return f32::INFINITY;
    }
    let middle = strengths.len() / 2;
    *strengths.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// What is asked of every observation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rule {
    /// Surroundings of a Gaussian.
    radius_m: f32,
    /// Least share of an echo that makes an observation clear.
    clear_share: f32,
    /// Strength of what is certainly there: weaker ones are there only to a fraction.
    whole_strength: f32,
    /// Whether what surfaces hide is doubted.
    occlusion: bool,
    /// Time constant of the error that poses have in common.
    pose_error_time_s: f64,
}

impl Rule {
    /// By the verdicts so far.
    pub(crate) fn of(
        gaussians: &Gaussians,
        voxel_m: f32,
        at_work: AtWork,
        thresholds: VerdictThresholds,
    ) -> Self {
        Self {
            radius_m: SURROUNDINGS_VOXELS * voxel_m,
            clear_share: thresholds.clear_share,
            whole_strength: whole_strength(gaussians),
            occlusion: at_work.occlusion,
            pose_error_time_s: thresholds.pose_error_time_s,
        }
    }
}

/// Room to work in.
#[derive(Debug, Default)]
pub(crate) struct Desk {
    arcs: Arcs,
    occlusion: Occlusion,
}

impl Desk {
    /// For every Gaussian near the beam's axis: which fraction of the echo in its own bin comes from its surroundings.
    /// In one bin of a narrow beam a place is its position along the arc, so these are the steps of the arc next to it.
    fn enter(
        &mut self,
        tally: &mut Tally<Finding>,
        keyframe: &Keyframe,
        sight: &Sight,
        gaussians: &Gaussians,
        rule: Rule,
    ) {
        let Self { arcs, occlusion } = self;
        let (rows, geometry) = (sight.rows(), &keyframe.geometry);
        arcs.fill(sight, keyframe, rule.radius_m / AROUND_STEPS as f32);
        let solid = |row: usize| match gaussians.verdict[sight.slot(row)] {
            CONFIDENT => gaussians.layers(sight.slot(row)),
            Verdict::Published(_) => {
                (rows.echo[row] / rows.energy[row] / rule.whole_strength).min(1.0)
            }
            _ => 0.0,
        };
        if rule.occlusion {
            occlusion.fill(geometry, rows, sight.heard().map(|row| (row, solid(row))));
        }
        for run in sight.runs() {
            let findings = tally.of(run.block, run.count);
            for row in sight.heard_of(run) {
                let (range_m, azimuth_rad) = (rows.range_m[row], rows.azimuth_rad[row]);
                let off = azimuth_rad * azimuth_rad / rows.azimuth_variance_rad2[row];
                let range_bins = (range_m - geometry.range_start_m) / geometry.bin_length_m;
                let bin = range_bins as usize;
                if !(off < 1.5 && bin < geometry.bin_count as usize) {
                    continue;
                }
                let observations = keyframe.weight * (1.0 - off / 1.5);
                let step = arcs.step_of(rows, row);
                let near = arcs.around(bin, step);
                let finding = &mut findings[run.within(rows.place[row])];
                finding.statistics.odds += observations * sight.odds(bin, near);
                if !keyframe.profile.is_lit(bin) {
                    continue;
                }
                let below_m = 2.0 * range_m * rows.elevation_rad[row].sin();
                let mirror_m = geometry.pose.axes.z_axis * -below_m;
                let if_so = |so: bool| if so { observations } else { 0.0 };
                finding.statistics.add(&ViewStatistics {
                    observations,
                    hidden_observations: if_so(rule.occlusion && occlusion.hides(rows, row)),
                    clear_observations: if_so(near > rule.clear_share * sight.predicted[bin]),
                    odds: 0.0,
                    compactness: observations * arcs.within(bin, step, MIDDLE_STEPS)
                        / near.max(f32::MIN_POSITIVE),
                    explained_ratio: observations * near / arcs.best(bin).max(f32::MIN_POSITIVE),
                    mirror_m: mirror_m * observations,
                    mirror_m2: mirror_m.length_squared() * observations,
                });
            }
        }
    }
}

/// Predicted energy per step along the arcs and bin, as far as there is any. Reused from ping to ping.
#[derive(Debug, Default)]
struct Arcs {
    /// Shape `[steps][bins]`, of those in `bins` and `steps`.
    energy: Vec<f32>,
    bins: Range<usize>,
    steps: Range<usize>,
    /// The most energy around any step of a bin, shape `[bins]`.
    best: Vec<f32>,
    /// Steps of the arc of the farthest bin as far as the fan reaches.
    all_steps: usize,
    steps_per_m: f32,
}

impl Arcs {
    /// With steps of `step_m`.
    fn fill(&mut self, sight: &Sight, keyframe: &Keyframe, step_m: f32) {
        let geometry = &keyframe.geometry;
        let end_m = geometry.range_start_m + geometry.bin_length_m * geometry.bin_count as f32;
        self.steps_per_m = step_m.recip();
        let width_rad = 2.0 * FAN_REACH * geometry.beam.elevation_half_width_rad();
        self.all_steps =
            (width_rad.min(PI) * end_m * self.steps_per_m) as usize + 2 * AROUND_STEPS + 1;
        let rows = sight.rows();
        (self.bins, self.steps) = (geometry.bin_count as usize..0, self.all_steps..0);
        for row in sight.heard() {
            let (bins, step) = (sight.pulses().echo_of(rows, row).0, self.step_of(rows, row));
            self.bins = self.bins.start.min(bins.start)..self.bins.end.max(bins.end);
            self.steps = self.steps.start.min(step)..self.steps.end.max(step + 1);
        }
        let width = self.bins.len();
        self.energy.clear();
        self.energy.resize(self.steps.len() * width, 0.0);
        for row in sight.heard() {
            let step = self.step_of(rows, row) - self.steps.start;
            let (bins, shares) = sight.pulses().echo_of(rows, row);
            let first = step * width + bins.start - self.bins.start;
            let energies = &mut self.energy[first..first + bins.len()];
            for (energy, share) in energies.iter_mut().zip(shares) {
                *energy += rows.echo[row] * share;
            }
        }
        dispatch!(simd_level::level(), _simd => self.find_best());
    }

    /// Steps around one, counted from the first that holds energy, as far as they do.
    fn around_step(&self, step: usize, reach: usize) -> Range<usize> {
        let held = |step: usize| step.clamp(self.steps.start, self.steps.end) - self.steps.start;
        held(step.saturating_sub(reach))..held(step + reach + 1)
    }

    #[inline(always)]
    fn find_best(&mut self) {
        let width = self.bins.len();
        self.best.clear();
        self.best.resize(width, 0.0);
        for step in self.steps.clone() {
            let around = self.around_step(step, AROUND_STEPS);
            for (part, best) in self.best.chunks_mut(TOGETHER).enumerate() {
                let mut sums = [0.0; TOGETHER];
                for near in around.clone() {
                    let energies = &self.energy[near * width + part * TOGETHER..][..best.len()];
                    for (sum, energy) in sums.iter_mut().zip(energies) {
                        *sum += energy;
                    }
                }
                for (best, sum) in best.iter_mut().zip(sums) {
                    *best = best.max(sum);
                }
            }
        }
    }

    /// The most energy around any step of a bin.
    fn best(&self, bin: usize) -> f32 {
        let bin = bin.checked_sub(self.bins.start);
        bin.and_then(|bin| self.best.get(bin))
            .copied()
            .unwrap_or(0.0)
    }

    fn step_of(&self, rows: &Rows, row: usize) -> usize {
        let along_m = rows.elevation_rad[row] * rows.range_m[row];
        let step = along_m * self.steps_per_m + 0.5 * self.all_steps as f32;
        (step.max(0.0) as usize).min(self.all_steps - 1)
    }

    /// Energy in a bin from the surroundings of `step`.
    fn around(&self, bin: usize, step: usize) -> f32 {
        self.within(bin, step, AROUND_STEPS)
    }

    /// Energy in a bin from up to `reach` steps away from `step`.
    fn within(&self, bin: usize, step: usize, reach: usize) -> f32 {
        if !self.bins.contains(&bin) {
            return 0.0;
        }
        let (steps, width) = (self.around_step(step, reach), self.bins.len());
        let energies = self.energy[steps.start * width..steps.end * width].iter();
        energies.skip(bin - self.bins.start).step_by(width).sum()
    }
}

/// Slots that are nothing but a side lobe of a stronger neighbour: below `fraction` of it.
pub(crate) fn side_lobes(gaussians: &Gaussians, voxel_m: f32, fraction: f32) -> Vec<usize> {
    let neighbours = Neighbours::new(gaussians, PEAK_VOXELS * voxel_m, |_| true);
    let outshone = neighbours.outshone(fraction, |slot| gaussians.is_worked_on(slot));
    let side_lobes = outshone.into_iter().filter(|(_, is_outshone)| *is_outshone);
    side_lobes.map(|(slot, _)| slot).collect()
}

/// Slots that explain next to nothing of any echo, however strong they are beside their neighbours. What no ping of the
/// steps saw is not known to be idle. What forgotten pings told is not in `explained`, so that Gaussians they told of
/// stay.
pub(crate) fn idle(gaussians: &Gaussians, explained: &Explained) -> Vec<usize> {
    let is_idle = |&slot: &usize| {
        let is_judged = gaussians.is_worked_on(slot) && gaussians.kept[slot].is_none();
        let bins = explained.mean(slot);
        is_judged && bins.is_some_and(|bins| bins < LEAST_EXPLAINED)
    };
    gaussians.slots().filter(is_idle).collect()
}

#[cfg(test)]
mod reasons;

#[cfg(test)]
mod tests {
    use echosplat_model::glam::Vec3;

    use super::*;
    use crate::features::{Cues, Features, MapCues, decide};
    use crate::refine::expectation::StepSums;
    use crate::spawn::gaussians::Stage;

    #[test]
    fn what_explains_no_echo_is_idle_and_what_was_not_seen_or_told_of_by_forgotten_pings_is_not() {
        let mut gaussians = Gaussians::default();
        for x in 0..6 {
            gaussians.spawn(Vec3::X * f32::from(x), (0, x), 0.05, 1.0);
        }
        gaussians.stage[1] = Stage::Background;
        gaussians.kept[2] = Some(Box::default());
        // The last but one is seen in the second step alone, the last in none.
        let mut explained = Explained::default();
        for weights in [
            [1e-3, 0.0, 1e-3, 5.0, 0.0, 0.0],
            [1e-3, 0.0, 0.0, 0.0, 5.0, 0.0],
        ] {
            let sums = weights.map(StepSums::of_weight);
            explained.add(&gaussians, &sums, 2.0);
        }
        assert_eq!(explained.mean(5), None);
        assert!((explained.mean(3).unwrap() - 30.0).abs() < 1e-3);
        assert_eq!(idle(&gaussians, &explained), [0]);
        gaussians.remove(0);
        assert!(idle(&gaussians, &explained).is_empty());
    }

    #[test]
    fn few_clear_observations_do_where_all_together_are_likely_and_poses_do_not_smear_them() {
        let (at_work, _) = decide(&Features::default(), &Cues::default(), MapCues::default());
        let thresholds = VerdictThresholds::of(&MapperConfig::default(), at_work);
        let weak = ViewStatistics {
            observations: 40.0,
            clear_observations: 3.0,
            odds: 13.0,
            explained_ratio: 30.0,
            compactness: 30.0,
            ..ViewStatistics::default()
        };
        assert!(weak.fixes(0.5, thresholds).is_ok() && weak.fixes(1.5, thresholds).is_err());
        let unlikely = ViewStatistics { odds: 11.0, ..weak };
        let explains_little = ViewStatistics {
            explained_ratio: 10.0,
            ..weak
        };
        for wrong in [unlikely, explains_little] {
            assert!(wrong.fixes(0.5, thresholds).is_err());
        }
        let beside_another = ViewStatistics {
            compactness: 15.0,
            ..weak
        };
        assert!(beside_another.fixes(0.5, thresholds).is_err());
        let smeared = AtWork {
            smeared: true,
            ..at_work
        };
        let smeared = VerdictThresholds::of(&MapperConfig::default(), smeared);
        assert!(weak.fixes(0.5, smeared).is_err());
    }

    #[test]
    fn an_even_spread_is_compact_and_what_stands_beside_a_surface_is_not() {
        let arcs = |energy: &[f32]| Arcs {
            energy: energy.to_vec(),
            bins: 0..1,
            steps: 0..energy.len(),
            ..Arcs::default()
        };
        let fraction =
            |arcs: &Arcs, step| arcs.within(0, step, MIDDLE_STEPS) / arcs.around(0, step);
        let even = arcs(&[1.0; 9]);
        assert!(fraction(&even, 4) >= LEAST_COMPACTNESS);
        let surface = arcs(&[0.0, 0.1, 0.3, 1.0, 0.3, 0.1, 0.0, 0.0, 0.0]);
        assert!(
            fraction(&surface, 3) > LEAST_COMPACTNESS && fraction(&surface, 5) < LEAST_COMPACTNESS
        );
    }

    #[test]
    fn a_cluster_that_is_too_small_is_doubted_and_a_rod_with_its_ends_is_not() {
        let mut gaussians = Gaussians::default();
        let mut place = |at_m: Vec3, child_share: f32| {
            let slot = gaussians.spawn(at_m, (0, 0), 0.5, 1.0) as usize;
            gaussians.verdict[slot] = CONFIDENT;
            gaussians.child_share[slot] = child_share;
            slot
        };
        let rod: Vec<usize> = (0..160)
            .map(|i| place(Vec3::X * 0.125 * i as f32, CHILD_SHARE))
            .collect();
        // Eight that were not split, and fifteen children of split ones.
        let late: Vec<usize> = (0..8)
            .map(|i| place(Vec3::new(10.0, 10.0, 0.1 * i as f32), 1.0))
            .collect();
        let children: Vec<usize> = (0..15)
            .map(|i| place(Vec3::new(10.0, -10.0, 0.1 * i as f32), CHILD_SHARE))
            .collect();
        let support = (LEAST_SUPPORT, SUPPORT_VOXELS, Reason::Isolated);
        reject_isolated(&mut gaussians, support, |child_share| child_share);
        let is_sure = |gaussians: &Gaussians, slots: &[usize]| {
            let mut slots = slots.iter();
            slots.all(|&slot| gaussians.verdict[slot] == CONFIDENT)
        };
        for slots in [&rod, &late, &children] {
            assert!(is_sure(&gaussians, slots));
        }
        let counts = counts_beside(&gaussians, CHILD_SHARE);
        let support = (
            LEAST_NEAR_SUPPORT,
            NEAR_SUPPORT_VOXELS,
            Reason::IsolatedNear,
        );
        reject_isolated(&mut gaussians, support, counts);
        assert!(is_sure(&gaussians, &rod));
        for slot in late.into_iter().chain(children) {
            assert_ne!(gaussians.verdict[slot], CONFIDENT);
            assert_eq!(gaussians.why[slot], Why::of(Reason::IsolatedNear, 0.0, 1.0));
        }
        let in_haste = counts_beside(&gaussians, 1.0);
        assert!(
            (in_haste(1.0) - 1.0).abs() < 1e-6
                && (in_haste(CHILD_SHARE) - CHILD_SHARE).abs() < 1e-6
        );
        // It is asked for where another sonar is heard.
        let (at_work, _) = decide(&Features::default(), &Cues::default(), MapCues::default());
        let near = |interfered| {
            let at_work = AtWork {
                interfered,
                ..at_work
            };
            VerdictThresholds::of(&MapperConfig::default(), at_work).near_support
        };
        assert!(near(true).is_some() && near(false).is_none());
        // Where nothing is split each counts in full.
        for child_share in &mut gaussians.child_share {
            *child_share = 1.0;
        }
        assert!((counts_beside(&gaussians, CHILD_SHARE)(1.0) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_mirror_image_is_harmless_where_it_is_within_reach_of_the_place() {
        let statistics = |mirror_m: f32| ViewStatistics {
            observations: 4.0,
            mirror_m: 4.0 * mirror_m * Vec3::Z,
            mirror_m2: 4.0 * mirror_m * mirror_m,
            ..ViewStatistics::default()
        };
        assert!(statistics(0.08).tells_from_mirror());
        assert!(!statistics(0.19).tells_from_mirror());
    }

    #[test]
    fn what_is_linked_to_a_surface_is_trusted_and_what_is_beside_it_is_not() {
        let mut gaussians = Gaussians::default();
        let mut place = |x: f32, y: f32, strength: f32| {
            let at_m = Vec3::new(x, y, 0.0);
            let slot = gaussians.spawn(at_m, (0, 0), 0.1, strength) as usize;
            gaussians.verdict[slot] = Verdict::Published(Standing::Ambiguous);
            slot
        };
        let surface: Vec<usize> = (0..16)
            .map(|i| place((i % 4) as f32, (i / 4) as f32, 1.0))
            .collect();
        let next = place(4.0, 1.0, 0.5);
        let side_lobe = place(4.0, 2.0, 0.01);
        let far = place(30.0, 0.0, 1.0);
        let unsure = place(4.0, 3.0, 1.0);
        let linked = Some(Why::of(Reason::Linked, 5.0, 0.4));
        let mut may_link = vec![None; gaussians.slot_count()];
        for slot in [next, side_lobe, far] {
            may_link[slot] = linked;
        }
        // Nothing is trusted for the sake of what is not sure itself.
        link_by_hysteresis(&mut gaussians, &vec![linked; may_link.len()], 1.0);
        assert!(
            gaussians
                .verdict
                .iter()
                .all(|verdict| *verdict != CONFIDENT)
        );

        for slot in surface {
            gaussians.verdict[slot] = CONFIDENT;
        }
        link_by_hysteresis(&mut gaussians, &may_link, 1.0);
        assert_eq!(gaussians.verdict[next], CONFIDENT);
        assert_eq!(Some(gaussians.why[next]), linked);
        for slot in [side_lobe, far, unsure] {
            assert_ne!(gaussians.verdict[slot], CONFIDENT);
        }
    }
}
