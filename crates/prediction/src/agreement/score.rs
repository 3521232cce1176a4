//! How likely the lit and dark cells of each block of pings are by what the other blocks saw.
//!
//! Odds of a lit cell are those of its range in the blocks around, poses or not, times a factor for
//! what observations along its arc say. Both are fitted on other blocks than the one that is
//! judged, and where observations say nothing the factor is that without poses: poses that say
//! nothing gain nothing.

use super::evidence::{BLOCKS, Evidence, Said, block_of, left_out};
use super::lit::{Cell, LitPings};

/// Shares of lit observations, grid.
/// Edges between levels of the greatest share of lit observations along an arc.
const SHARE_EDGES: [f32; 7] = [0.08, 0.15, 0.25, 0.37, 0.5, 0.65, 0.8];
/// What observations say: nothing, dark, or lit at a share; layout.
/// What observations say: nothing, dark, or lit at one of the shares.
const SAID_LEVELS: usize = SHARE_EDGES.len() + 3;
/// Place of nothing said; layout.
const NOTHING_SAID: usize = 0;
/// Place of dark; layout.
const DARK_SAID: usize = 1;
/// Levels of a range's log odds; grid.
/// Levels of the logarithm of a range's odds, and the first and the distance of their middles.
const BASE_LEVELS: usize = 20;
/// Nats, the first level's middle; grid.
const BASE_FIRST: f64 = -6.0;
/// Nats between levels; grid.
const BASE_STEP: f64 = 0.5;
/// Observations at the common rate; found.
/// Observations at a range that are given to it at the rate of all ranges.
const PRIOR_OBSERVATIONS: f64 = 5.0;
/// Steps of the fit of a factor; bounds work.
/// Steps of the fit of a factor, and the most that its logarithm may be.
const FIT_STEPS: usize = 12;
/// Log of a factor, at most; bound.
const MOST_FACTOR_LN: f64 = 6.0;

/// Cells of one kind: how many, and how many of them lit.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Count {
    all: f64,
    lit: f64,
}

impl Count {
    fn times(self, weight: f64) -> Self {
        Self {
            all: self.all * weight,
            lit: self.lit * weight,
        }
    }

    fn add(&mut self, other: Self) {
        self.all += other.all;
        self.lit += other.lit;
    }
}

/// Cells by the level of their range's odds.
type ByBase = [Count; BASE_LEVELS];

/// The range's odds, and what they say alone.
#[derive(Debug)]
pub(super) struct Baseline {
    /// Level by block and cell.
    levels: Vec<Vec<u8>>,
    /// Lit cells of all.
    lit_rate: f32,
    /// Cells looked at.
    pub(super) cell_count: f64,
    /// Log likelihood by block.
    pub(super) by_block: [f64; BLOCKS],
}

impl Baseline {
    pub(super) fn of(lit: &LitPings) -> Self {
        let by_range = count_by_range(lit);
        let mut total = Count::default();
        by_range
            .iter()
            .flatten()
            .for_each(|count| total.add(*count));
        let lit_rate = total.lit / total.all.max(1.0);
        let levels = |block| range_levels(&by_range, block, lit_rate);
        let mut baseline = Self {
            levels: (0..BLOCKS).map(levels).collect(),
            lit_rate: lit_rate as f32,
            cell_count: total.all,
            by_block: [0.0; BLOCKS],
        };
        baseline.by_block = likelihood_by_block(&baseline.tables(lit, |_, _| NOTHING_SAID));
        baseline
    }

    /// Log likelihood by block with what poses make of it.
    pub(super) fn with(&self, lit: &LitPings, evidence: &Evidence) -> [f64; BLOCKS] {
        let said = |ping, cell| match evidence.said(ping, cell, self.lit_rate) {
            Said::Nothing => NOTHING_SAID,
            Said::Dark => DARK_SAID,
            Said::Lit(share) => DARK_SAID + 1 + SHARE_EDGES.partition_point(|edge| *edge < share),
        };
        likelihood_by_block(&self.tables(lit, said))
    }

    /// Cells by block, level of what is said, and level of base.
    fn tables(
        &self,
        lit: &LitPings,
        said: impl Fn(usize, usize) -> usize,
    ) -> Vec<[ByBase; SAID_LEVELS]> {
        let mut tables = vec![[ByBase::default(); SAID_LEVELS]; BLOCKS];
        for (ping, cells) in lit.cells.iter().enumerate() {
            let block = block_of(ping, lit.cells.len());
            for (cell, state) in cells.iter().enumerate() {
                if let Some(count) = count_of(*state) {
                    let base = usize::from(self.levels[block][cell]);
                    tables[block][said(ping, cell)][base].add(count);
                }
            }
        }
        tables
    }
}

fn count_of(cell: Cell) -> Option<Count> {
    let count = |lit| Some(Count { all: 1.0, lit });
    match cell {
        Cell::Unknown => None,
        Cell::Dark => count(0.0),
        Cell::Lit => count(1.0),
    }
}

/// Shape `[BLOCKS][cells]`.
fn count_by_range(lit: &LitPings) -> Vec<Vec<Count>> {
    let mut by_range = vec![vec![Count::default(); lit.cell_count]; BLOCKS];
    for (ping, cells) in lit.cells.iter().enumerate() {
        let counts = &mut by_range[block_of(ping, lit.cells.len())];
        for (count, cell) in counts.iter_mut().zip(cells) {
            count.add(count_of(*cell).unwrap_or_default());
        }
    }
    by_range
}

/// What a block counts for the ranges of another, half as much with each block in between: height
/// over a seabed changes slowly, and poses that say no more than that are to gain nothing.
fn nearness(block: usize, other: usize) -> f64 {
    (-(block.abs_diff(other) as f64)).exp2()
}

/// Level of the odds of each range, by the blocks that may tell of `block`; a cell is smoothed with
/// its neighbours.
fn range_levels(by_range: &[Vec<Count>], block: usize, lit_rate: f64) -> Vec<u8> {
    let cell_count = by_range[block].len();
    let level_of = |cell: usize| {
        let near = cell.saturating_sub(1)..=(cell + 1).min(cell_count - 1);
        let mut sum = Count {
            all: PRIOR_OBSERVATIONS,
            lit: PRIOR_OBSERVATIONS * lit_rate,
        };
        let told = by_range.iter().enumerate();
        for (other, counts) in told.filter(|(other, _)| !left_out(block).contains(other)) {
            let weight = nearness(block, other);
            counts[near.clone()]
                .iter()
                .for_each(|count| sum.add(count.times(weight)));
        }
        let level = ((odds_ln(sum.lit / sum.all) - BASE_FIRST) / BASE_STEP).round();
        level.clamp(0.0, (BASE_LEVELS - 1) as f64) as u8
    };
    (0..cell_count).map(level_of).collect()
}

/// Each block by the factors that other blocks ask for.
fn likelihood_by_block(tables: &[[ByBase; SAID_LEVELS]]) -> [f64; BLOCKS] {
    std::array::from_fn(|block| {
        let others = tables.iter().enumerate();
        let others = others.filter(|(other, _)| !left_out(block).contains(other));
        let mut told = [ByBase::default(); SAID_LEVELS];
        others.for_each(|(_, table)| add_all(told.iter_mut().zip(table)));
        let mut all = ByBase::default();
        told.iter().for_each(|level| add_all([(&mut all, level)]));
        told[NOTHING_SAID] = all;
        let levels = tables[block].iter().zip(&told);
        levels
            .map(|(level, told)| log_likelihood(level, fit_factor_ln(told)))
            .sum()
    })
}

fn add_all<'a>(pairs: impl IntoIterator<Item = (&'a mut ByBase, &'a ByBase)>) {
    for (sums, counts) in pairs {
        sums.iter_mut()
            .zip(counts)
            .for_each(|(sum, count)| sum.add(*count));
    }
}

/// The factor of odds that makes as many cells lit as are, one of them given as the range has it:
/// Newton's steps.
fn fit_factor_ln(told: &ByBase) -> f64 {
    let mut factor_ln = 0.0;
    for _ in 0..FIT_STEPS {
        // The given cell: a normal prior of one sigma of 2 about no factor.
        let (mut excess, mut slope) = (-0.25 * factor_ln, 0.25);
        for (level, count) in told.iter().enumerate() {
            let share = lit_share(level, factor_ln);
            excess += count.lit - count.all * share;
            slope += count.all * share * (1.0 - share);
        }
        let step: f64 = excess / slope;
        factor_ln = (factor_ln + step.clamp(-1.0, 1.0)).clamp(-MOST_FACTOR_LN, MOST_FACTOR_LN);
    }
    factor_ln
}

fn odds_ln(probability: f64) -> f64 {
    let probability = probability.clamp(1e-9, 1.0 - 1e-9);
    (probability / (1.0 - probability)).ln()
}

fn lit_share(base_level: usize, factor_ln: f64) -> f64 {
    let odds_ln = BASE_FIRST + BASE_STEP * base_level as f64 + factor_ln;
    1.0 / (1.0 + (-odds_ln).exp())
}

fn log_likelihood(counts: &ByBase, factor_ln: f64) -> f64 {
    let of_level = |(level, count): (usize, &Count)| {
        let share = lit_share(level, factor_ln);
        count.lit * share.ln() + (count.all - count.lit) * (-share).ln_1p()
    };
    counts.iter().enumerate().map(of_level).sum()
}
