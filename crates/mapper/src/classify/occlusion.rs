//! What confident surfaces hide from a ping: covered fraction along its elevations.
//!
//! Cost: one addition for each confident Gaussian in the ping and a sum over 64 × shells.

use echosplat_measurement::PingGeometry;
use echosplat_measurement::heard::Rows;

/// Steps of elevation; grid.
/// Steps of elevation over the fan and its soft edge.
const CELLS: usize = 64;
/// Half-widths, derived: the fan's soft edge.
const REACH: f32 = 1.3;
/// Metres of a shell of range; grid.
const SHELL_M: f32 = 0.1;
/// Fraction covered; found.
/// A surface is some voxels thick, each layer covering it once, but where poses are off only some of
/// its places are certain.
const OPAQUE: f32 = 0.5;
/// Metres behind the front; found.
/// What is this near behind the front belongs to it.
const THICKNESS_M: f32 = 0.3;

/// Covered fraction per elevation and range. Reused from ping to ping.
#[derive(Debug, Default)]
pub(crate) struct Occlusion {
    cover: Vec<f32>,
    shells: usize,
    /// Range from which on a cell is hidden.
    hidden_from_m: Vec<f32>,
    lowest_rad: f32,
    cell_rad: f32,
}

impl Occlusion {
    /// Takes in rows, each with the fraction of it that is there.
    pub(crate) fn fill(
        &mut self,
        geometry: &PingGeometry,
        rows: &Rows,
        surfaces: impl Iterator<Item = (usize, f32)>,
    ) {
        let end_m = geometry.range_start_m + geometry.bin_length_m * geometry.bin_count as f32;
        self.shells = (end_m / SHELL_M) as usize + 1;
        self.cover.clear();
        self.cover.resize(CELLS * self.shells, 0.0);
        self.lowest_rad = -REACH * geometry.beam.elevation_half_width_rad();
        self.cell_rad = -2.0 * self.lowest_rad / CELLS as f32;
        let whole =
            std::f32::consts::TAU.sqrt() * geometry.beam.azimuth_sigma_rad() * self.cell_rad;
        for (row, fraction) in surfaces {
            let shell = ((rows.range_m[row] / SHELL_M) as usize).min(self.shells - 1);
            let cell = self.cell_of(rows, row);
            self.cover[cell * self.shells + shell] += fraction * rows.energy[row] / whole;
        }
        self.hidden_from_m.clear();
        for cell in self.cover.chunks_exact(self.shells) {
            let mut covered = 0.0;
            let front = cell.iter().position(|cover| {
                covered += cover;
                covered >= OPAQUE
            });
            let from_m = front.map_or(f32::INFINITY, |shell| {
                (shell + 1) as f32 * SHELL_M + THICKNESS_M
            });
            self.hidden_from_m.push(from_m);
        }
    }

    fn cell_of(&self, rows: &Rows, row: usize) -> usize {
        let cell = (rows.elevation_rad[row] - self.lowest_rad) / self.cell_rad;
        (cell.max(0.0) as usize).min(CELLS - 1)
    }

    /// Whether a surface in front hides it.
    pub(crate) fn hides(&self, rows: &Rows, row: usize) -> bool {
        rows.range_m[row] > self.hidden_from_m[self.cell_of(rows, row)]
    }
}
