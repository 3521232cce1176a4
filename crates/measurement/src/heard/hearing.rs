//! One ping's hearing of blocks of Gaussians, from the first cut to rows.

use std::ops::Range;

use fearless_simd::prelude::*;

use super::footprint::{project_round, project_shaped};
use super::pose_score::Columns;
use super::pulses::Pulses;
use super::rows::{Detail, Rows};
use super::told::Gathered;
use super::view::{Members, Numbers, View, cull};

/// Which Gaussians a ping hears, where and how strongly. Reused from ping to ping.
#[derive(Debug, Default)]
pub struct Hearing {
    /// Places by size, those with shapes last.
    places: Vec<Vec<u32>>,
    runs: Vec<Run>,
    /// What is heard of each.
    pub rows: Rows,
    /// Their energies.
    pub pulses: Pulses,
    pub(super) gathered: Gathered,
    pub(super) columns: Columns,
}

/// Rows of one block.
#[derive(Debug, Clone, Copy)]
pub struct Run {
    size: usize,
    /// The block's number.
    pub block: u32,
    first_place: u32,
    /// How many Gaussians the block has.
    pub count: usize,
    first_row: usize,
    end_row: usize,
}

impl Run {
    /// Its rows.
    #[must_use]
    pub fn rows(&self) -> Range<usize> {
        self.first_row..self.end_row
    }

    /// Which of the block's Gaussians the one at this place is.
    #[inline(always)]
    #[must_use]
    pub fn within(&self, place: u32) -> usize {
        (place - self.first_place) as usize
    }
}

impl Hearing {
    /// Finds those of some blocks that a ping hears. Each comes with its number, its Gaussians, and which of the sizes they have,
    /// as many as there are where they have shapes.
    #[inline(always)]
    pub fn find<'a, S: Simd>(
        &mut self,
        simd: S,
        view: &View,
        numbers: Numbers<'_>,
        blocks: impl Iterator<Item = (u32, &'a Members, usize)>,
        detail: Detail,
    ) {
        self.places.resize_with(numbers.sizes_m.len() + 1, Vec::new);
        self.places.iter_mut().for_each(Vec::clear);
        self.runs.clear();
        for (block, members, size) in blocks {
            let places = &mut self.places[size];
            let first_row = places.len();
            cull(simd, view, numbers, members, places);
            if places.len() > first_row {
                self.runs.push(Run {
                    size,
                    block,
                    first_place: members.places.start as u32,
                    count: members.places.len(),
                    first_row,
                    end_row: places.len(),
                });
            }
        }
        let count = self.number_rows();
        self.rows.begin(count, detail);
        self.pulses.begin(view.bin_count());
        for (size, places) in self.places.iter().enumerate() {
            let into = (&mut self.rows, &mut self.pulses);
            match numbers.sizes_m.get(size) {
                Some(&sigma_m) => {
                    project_round(simd, view, numbers, (sigma_m, places), detail, into);
                }
                None => project_shaped(simd, view, numbers, places, detail, into),
            }
        }
    }

    /// Numbers the runs' rows in order of size; how many there are.
    fn number_rows(&mut self) -> usize {
        let mut first_row = 0;
        for (size, places) in self.places.iter().enumerate() {
            for run in self.runs.iter_mut().filter(|run| run.size == size) {
                run.first_row += first_row;
                run.end_row += first_row;
            }
            first_row += places.len();
        }
        first_row
    }

    /// Rows of each block that is heard.
    #[must_use]
    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// Of some rows those that the ping hears.
    pub fn heard(&self, rows: Range<usize>) -> impl Iterator<Item = usize> + '_ {
        rows.filter(|&row| self.rows.energy[row] > 0.0)
    }

    /// Adds all echoes to `predicted`, power per bin, with room for whole groups beyond the last bin.
    #[inline(always)]
    pub fn spread<S: Simd>(&mut self, simd: S, predicted: &mut [f32]) {
        let Self { pulses, rows, .. } = self;
        pulses.spread(simd, rows, &rows.echo, predicted);
    }
}
