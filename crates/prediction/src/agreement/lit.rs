//! Pings as coarse cells of range, lit or dark: all that a comparison of poses needs of them.

use std::sync::Arc;

use echosplat_mapper::MapperConfig;
use echosplat_model::Ping;

/// Share of echoes within the reach; found.
/// Echoes further off than all but this share of them are left out.
const REACH_SHARE: f64 = 0.95;
/// Ratio of range beyond those; found.
/// The reach goes so far beyond those.
const REACH_MARGIN: f64 = 1.1;
/// Ratio, physics: −ln(3/4).
/// The lower quartile of exponential noise over its mean: −ln(3/4).
const QUARTILE_OVER_MEAN: f32 = 0.287_682;
/// Noise powers, derived: once in 160,000 bins.
/// A bin this many times above the mean noise is an echo: noise is so loud once in 160,000 bins. Stricter than the
/// mapper, since a whole cell is lit by one bin.
const ECHO_OVER_NOISE: f32 = 12.0;
/// Quantile of strongest echoes; found.
/// Of the pings' strongest echoes the one that the dynamic range counts from: a glitch is no echo.
const STRONG_SHARE: f64 = 0.9;

/// What a ping says of a range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cell {
    /// Blanked, or beyond its range.
    Unknown,
    Dark,
    Lit,
}

/// All pings of a window on one division of range.
#[derive(Debug)]
pub(super) struct LitPings {
    /// Length of a cell, metres.
    pub(super) cell_m: f64,
    pub(super) cell_count: usize,
    /// Shape `[pings][cell_count]`.
    pub(super) cells: Vec<Vec<Cell>>,
}

impl LitPings {
    /// `None` if nothing is heard.
    pub(super) fn of(
        pings: &[Arc<Ping>],
        config: &MapperConfig,
        cell_count: usize,
    ) -> Option<Self> {
        let floor = floor(pings, config);
        let echoes = |ping: &Arc<Ping>| echoes_m(ping, floor, config);
        let mut ranges_m: Vec<f64> = pings.iter().flat_map(echoes).collect();
        let reach_m = REACH_MARGIN * quantile(&mut ranges_m, REACH_SHARE)?;
        let cell_m = reach_m / cell_count as f64;
        let cells = |ping: &Arc<Ping>| cells(ping, (cell_m, cell_count), floor, config);
        Some(Self {
            cell_m,
            cell_count,
            cells: pings.iter().map(cells).collect(),
        })
    }

    /// How many pings hear anything.
    pub(super) fn lit_pings(&self) -> usize {
        let is_lit = |cells: &&Vec<Cell>| cells.contains(&Cell::Lit);
        self.cells.iter().filter(is_lit).count()
    }
}

/// Power that echoes stay below by more than the dynamic range.
fn floor(pings: &[Arc<Ping>], config: &MapperConfig) -> f32 {
    let peak = |ping: &Arc<Ping>| {
        let open = &ping.intensity()[first_bin(ping, config)..];
        f64::from(open.iter().copied().fold(0.0, f32::max))
    };
    let mut peaks: Vec<f64> = pings.iter().map(peak).collect();
    let strong = quantile(&mut peaks, STRONG_SHARE).unwrap_or(0.0) as f32;
    strong * 10f32.powf(-0.1 * config.dynamic_range_db)
}

fn first_bin(ping: &Ping, config: &MapperConfig) -> usize {
    let settings = ping.settings();
    let blank_m = config.blanking_m - settings.range_start_m;
    let blank = (blank_m / settings.bin_length_m()).ceil().max(0.0) as usize;
    blank.min(settings.bin_count)
}

/// Above this a bin is an echo; infinite where all bins are blanked.
fn threshold(ping: &Ping, floor: f32, config: &MapperConfig) -> f32 {
    let open = &ping.intensity()[first_bin(ping, config)..];
    let mut powers: Vec<f64> = open.iter().map(|&power| power.into()).collect();
    match quantile(&mut powers, 0.25) {
        Some(quartile) => {
            let noise = quartile as f32 / QUARTILE_OVER_MEAN;
            (ECHO_OVER_NOISE * noise).max(floor)
        }
        None => f32::INFINITY,
    }
}

/// Ranges of the bins that are echoes.
fn echoes_m(ping: &Ping, floor: f32, config: &MapperConfig) -> Vec<f64> {
    let threshold = threshold(ping, floor, config);
    let bins = ping.intensity().iter().enumerate();
    let lit = bins
        .skip(first_bin(ping, config))
        .filter(|(_, power)| **power > threshold);
    lit.map(|(bin, _)| ping.settings().bin_center_m(bin))
        .collect()
}

fn cells(
    ping: &Ping,
    (cell_m, cell_count): (f64, usize),
    floor: f32,
    config: &MapperConfig,
) -> Vec<Cell> {
    let mut cells = vec![Cell::Unknown; cell_count];
    let threshold = threshold(ping, floor, config);
    let settings = ping.settings();
    for (bin, &power) in ping
        .intensity()
        .iter()
        .enumerate()
        .skip(first_bin(ping, config))
    {
        let cell = (settings.bin_center_m(bin) / cell_m) as usize;
        match cells.get_mut(cell) {
            Some(cell) if power > threshold => *cell = Cell::Lit,
            Some(cell) if *cell == Cell::Unknown => *cell = Cell::Dark,
            _ => {}
        }
    }
    cells
}

/// `None` of nothing.
fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let index = (share * last as f64) as usize;
    let (_, value, _) = values.select_nth_unstable_by(index, f64::total_cmp);
    Some(*value)
}
