//! How far poses are from belonging to their pings, by [agreement](crate::agreement): a clock that is off by up to a
//! minute, a mount by tens of degrees. Far beyond what any map made with such poses could show.
//!
//! What is looked for is tried over its whole range with ranges cut into a few long cells, then around the best of that
//! with shorter ones. A parabola through the top tells where it is, leaving out blocks of time how sure that is.
//!
//! Pure: no clock, no randomness. Cost for each section of 1,024 pings: 481 gains with 16 cells, 6 ms each, for a time
//! offset, and half as much again for what is looked at more closely.

mod peak;
mod setting;

use std::sync::Arc;

use echosplat_mapper::MapperConfig;
use echosplat_model::{Ping, Pose, Trajectory};
use rayon::prelude::*;

use crate::agreement::{Agreement, error_of_sum};
pub use peak::Peak;
use peak::Tried;
pub use setting::{Quantity, Setting};

/// Cells and pings; grid.
/// Cells that ranges are cut into and most pings of a section, the coarsest first: 16 cells are as long as what is 6 m
/// away moves in half a second of a sweep.
const LEVELS: [(usize, usize); 3] = [(16, 512), (32, 512), (64, SECTION_PINGS)];
/// Pings of a section, at most; bounds work.
pub const SECTION_PINGS: usize = 1024;
/// Seconds; found.
/// Length of a section, seconds: in less, next to nothing of a large structure is seen twice.
pub const SECTION_S: f64 = 300.0;
/// Maxima looked at on each level; bounds work.
/// Maxima that are looked at more closely on each level.
const MAXIMA: [usize; 3] = [16, 8, 4];
/// Pings that hear anything, at least; found.
const LEAST_LIT_PINGS: usize = 60;
/// Half steps either side of the top; found.
/// Steps from the top that its parabola is fitted through, either way, of half the last level's.
const TOP_STEPS: i32 = 4;
/// Steps uphill, derived from the level before.
/// Most steps uphill from a maximum of the level before: that was at most one of its own off.
const MOST_CLIMBS: usize = 3;

/// Pings and poses of a dive, which may be off.
#[derive(Debug)]
pub struct Alignment {
    levels: Vec<Vec<Agreement>>,
    trajectory: Trajectory,
}

impl Alignment {
    /// Of sections of pings, each in order of time and hardly longer than [`SECTION_S`]. `None` if too few pings
    /// hear anything.
    #[must_use]
    pub fn new(
        sections: &[Vec<Arc<Ping>>],
        trajectory: Trajectory,
        config: &MapperConfig,
    ) -> Option<Self> {
        let level = |&(cell_count, most): &(usize, usize)| {
            let agreements = sections
                .iter()
                .filter_map(|section| Agreement::new(thinned(section, most), config, cell_count));
            agreements.collect::<Vec<_>>()
        };
        let levels: Vec<Vec<Agreement>> = LEVELS.iter().map(level).collect();
        let lit: usize = levels[0].iter().map(Agreement::lit_pings).sum();
        (lit >= LEAST_LIT_PINGS).then_some(Self { levels, trajectory })
    }

    /// Log likelihood of what is heard with these poses above that without, by block of time.
    fn gain(&self, level: usize, setting: &Setting) -> Vec<f64> {
        let mount = setting.mount();
        let gains = self.levels[level].iter().flat_map(|agreement| {
            let pose = |ping: &Arc<Ping>| self.sensor_at(ping, setting, &mount);
            let poses: Vec<Option<Pose>> = agreement.pings().iter().map(pose).collect();
            agreement.gain(&poses)
        });
        gains.collect()
    }

    /// As the join has it, without freeing it from jitter.
    fn sensor_at(&self, ping: &Ping, setting: &Setting, mount: &Pose) -> Option<Pose> {
        let settings = ping.settings();
        let middle_m = settings.range_start_m + 0.5 * settings.range_length_m;
        let time = ping.echo_time(middle_m).offset_by(setting.time_offset_s);
        let vehicle = self.trajectory.at(time).ok()?;
        Some(vehicle.world_from_vehicle * *mount)
    }

    /// Where this quantity has the best agreement, everything else as it is in `from`. `None` if poses say nothing of
    /// any ping.
    #[must_use]
    pub fn search(&self, quantity: Quantity, from: &Setting) -> Option<Peak> {
        let at = |level: usize, shift: f64| Tried {
            shift,
            gain: self.gain(level, &from.shifted(quantity, shift)),
        };
        let (mut step, count) = (quantity.step(), quantity.steps());
        let tried = (-count..=count).into_par_iter();
        let tried: Vec<Tried> = tried.map(|i| at(0, step * f64::from(i))).collect();
        let mut tops = peak::maxima(tried, MAXIMA[0]);
        for (level, most) in MAXIMA.iter().enumerate().skip(1) {
            step *= 0.5;
            let climbed = tops
                .par_iter()
                .map(|top| climb(top.shift, step, |x| at(level, x)));
            tops = peak::distinct(climbed.collect(), step, *most);
        }
        let last = LEVELS.len() - 1;
        let best = tops.first()?;
        if !(best.sum() > 0.0) {
            return None;
        }
        let around = (-TOP_STEPS..=TOP_STEPS).into_par_iter();
        let around = around.map(|i| at(last, best.shift + 0.5 * step * f64::from(i)));
        let (shift, sigma) = peak::vertex(&around.collect::<Vec<_>>(), step);
        let is_rival = |top: &&Tried| (top.shift - best.shift).abs() > quantity.apart();
        let rivals: Vec<&Tried> = tops[1..].iter().filter(is_rival).collect();
        let over_rivals = rivals.iter().map(|rival| best.errors_over(rival));
        Some(Peak {
            shift,
            sigma,
            gain_errors: best.sum() / error_of_sum(&best.gain),
            over_given_errors: best.errors_over(&at(last, 0.0)),
            over_rivals_errors: over_rivals.fold(f64::INFINITY, f64::min),
            rivals: rivals.iter().map(|rival| rival.shift).collect(),
        })
    }
}

/// Uphill from `shift` until a step either way leads down again.
fn climb(shift: f64, step: f64, at: impl Fn(f64) -> Tried) -> Tried {
    let (mut below, mut here, mut above) = (at(shift - step), at(shift), at(shift + step));
    for _ in 0..MOST_CLIMBS {
        if below.sum() > here.sum() && below.sum() >= above.sum() {
            let further = at(below.shift - step);
            (below, here, above) = (further, below, here);
        } else if above.sum() > here.sum() {
            let further = at(above.shift + step);
            (below, here, above) = (here, above, further);
        } else {
            break;
        }
    }
    here
}

/// Evenly spread.
fn thinned(pings: &[Arc<Ping>], most: usize) -> Vec<Arc<Ping>> {
    let count = pings.len().min(most);
    let nth = |index: usize| Arc::clone(&pings[index * pings.len() / count]);
    (0..count).map(nth).collect()
}
