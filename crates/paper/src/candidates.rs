//! (11) and (12): where echoes may come from, and which of those places several views agree on.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use crate::Choices;
use crate::grid::Grid;
use crate::images::{Image, Images};
use crate::tags::ViewTags;

/// Most candidates taken: bounds memory. What comes later finds no cell and is counted.
const CANDIDATES_MAX: usize = 1 << 22;
/// Candidates looked at together by one thread.
const CHUNK: usize = 4096;

/// Places that initialise the Gaussians.
#[derive(Debug, Clone)]
pub(crate) struct Candidates {
    /// Relative to the images' origin.
    pub(crate) position_m: Vec<Vec3>,
    /// Mean value of the pixels each comes from, 0 to 1.
    pub(crate) value: Vec<f32>,
    /// Views that support each.
    pub(crate) tags: ViewTags,
}

/// How many there were.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct CandidateCounts {
    /// Pixels at or above the threshold, over all images.
    pub active_pixels: usize,
    /// Samples of their arcs (11).
    pub arc_samples: usize,
    /// Candidate points: the samples of one cell are one.
    pub candidates: usize,
    /// Samples that found no room for another candidate.
    pub dropped_samples: usize,
    /// `M` of (12).
    pub views_needed: u32,
    /// Candidates with that many views (12).
    pub kept: usize,
}

/// The length by which everything in space is measured: the spacing of beams at the middle range of
/// all active pixels.
pub(crate) fn beam_width_m(images: &Images, choices: &Choices) -> f32 {
    let ranges = |image: &Image| -> Vec<f32> {
        let g = image.geometry;
        let range_m = move |(_, bin): (usize, usize)| g.range_min_m + bin as f32 * g.range_step_m;
        active_pixels(image, choices).map(range_m).collect()
    };
    let ranges_m: Vec<f32> = images.images.par_iter().flat_map_iter(ranges).collect();
    let step_rad = images
        .images
        .first()
        .map_or(0.01, |image| image.geometry.azimuth_step_rad());
    width_at_middle_m(ranges_m, step_rad)
}

/// The spacing of beams at the middle of these ranges, at least a millimetre.
pub(crate) fn width_at_middle_m(mut ranges_m: Vec<f32>, step_rad: f32) -> f32 {
    ranges_m.sort_unstable_by(f32::total_cmp);
    let middle_m = ranges_m.get(ranges_m.len() / 2).copied().unwrap_or(1.0);
    (middle_m * step_rad).max(1e-3)
}

/// Pixels at or above the threshold, as beam and bin.
fn active_pixels<'a>(
    image: &'a Image,
    choices: &Choices,
) -> impl Iterator<Item = (usize, usize)> + use<'a> {
    let bins = image.geometry.range_bins as usize;
    let threshold = choices.active_value;
    let pixels = image.value.iter().enumerate();
    pixels.filter_map(move |(at, value)| (*value >= threshold).then_some((at / bins, at % bins)))
}

/// (11): points on the elevation arc of one pixel, relative to the images' origin, evenly spaced in
/// elevation and both ends included.
fn arc(
    image: &Image,
    beam: usize,
    bin: usize,
    choices: &Choices,
) -> impl Iterator<Item = Vec3> + use<> {
    let g = image.geometry;
    let ray = Ray {
        position_m: g.position_m,
        axes: g.axes,
        azimuth_rad: beam as f32 * g.azimuth_step_rad() - 0.5 * g.fov_rad,
    };
    let range_m = g.range_min_m + bin as f32 * g.range_step_m;
    ray.arc(range_m, g.azimuth_step_rad(), choices)
}

/// One beam: where it starts and goes, relative to the images' origin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    pub(crate) position_m: Vec3,
    /// World from sensor.
    pub(crate) axes: Mat3,
    pub(crate) azimuth_rad: f32,
}

impl Ray {
    /// (11), with beams `spacing_rad` apart.
    pub(crate) fn arc(
        self,
        range_m: f32,
        spacing_rad: f32,
        choices: &Choices,
    ) -> impl Iterator<Item = Vec3> + use<> {
        let half = choices.elevation_half_width_rad;
        let step_rad = choices.elevation_step_beams * spacing_rad;
        let azimuth = self.azimuth_rad;
        let steps = (2.0 * half / step_rad).ceil().clamp(1.0, 4096.0) as usize;
        (0..=steps).map(move |step| {
            let elevation = half * (2.0 * step as f32 / steps as f32 - 1.0);
            let level = elevation.cos();
            let ray = Vec3::new(
                level * azimuth.cos(),
                level * azimuth.sin(),
                elevation.sin(),
            );
            self.position_m + self.axes * (ray * range_m)
        })
    }
}

/// (11), (12).
pub(crate) fn find(
    images: &Images,
    beam_width_m: f32,
    choices: &Choices,
) -> (Candidates, CandidateCounts) {
    let mut merged = Merged::new(choices.merge_beams * beam_width_m, images.images.len());
    for (view, image) in images.images.iter().enumerate() {
        merged.add_image(view, image, choices);
    }
    merged.supported(images.images.len(), beam_width_m, choices)
}

/// The samples of all arcs, those of one cell as one: their mean, weighted by their pixels' values.
pub(crate) struct Merged {
    cell_m: f32,
    cells: HashMap<u64, u32, BuildHasherDefault<CellHasher>>,
    sums: Vec<Sum>,
    tags: ViewTags,
    counts: CandidateCounts,
}

/// Of the samples of one cell.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    /// Positions times values.
    weighted_m: Vec3,
    value: f32,
    samples: u32,
}

impl Sum {
    fn position_m(&self) -> Vec3 {
        self.weighted_m / self.value
    }

    fn mean_value(&self) -> f32 {
        self.value / self.samples as f32
    }
}

impl Merged {
    pub(crate) fn new(cell_m: f32, view_count: usize) -> Self {
        Self {
            cell_m,
            cells: HashMap::default(),
            sums: Vec::new(),
            tags: ViewTags::new(view_count),
            counts: CandidateCounts::default(),
        }
    }

    /// (12).
    pub(crate) fn supported(
        mut self,
        view_count: usize,
        beam_width_m: f32,
        choices: &Choices,
    ) -> (Candidates, CandidateCounts) {
        let share = (view_count as f32 * choices.support_share).ceil() as u32;
        self.counts.views_needed = share.max(choices.support_views);
        let candidates = supported(&self, choices.support_beams * beam_width_m);
        let counts = CandidateCounts {
            candidates: self.sums.len(),
            kept: candidates.position_m.len(),
            ..self.counts
        };
        (candidates, counts)
    }

    fn add_image(&mut self, view: usize, image: &Image, choices: &Choices) {
        for (beam, bin) in active_pixels(image, choices) {
            let points = arc(image, beam, bin, choices);
            self.add_arc(view, points, image.at(beam, bin));
        }
    }

    /// The arc of one active pixel.
    pub(crate) fn add_arc(&mut self, view: usize, points: impl Iterator<Item = Vec3>, value: f32) {
        self.counts.active_pixels += 1;
        for point in points {
            self.counts.arc_samples += 1;
            self.add(view, point, value);
        }
    }

    fn add(&mut self, view: usize, point: Vec3, value: f32) {
        let Some(at) = self.cell_of(point) else {
            self.counts.dropped_samples += 1;
            return;
        };
        let sum = &mut self.sums[at];
        sum.weighted_m += point * value;
        sum.value += value;
        sum.samples += 1;
        self.tags.set(at, view);
    }

    /// The candidate of the cell that holds `point`, a new one if there is room.
    fn cell_of(&mut self, point: Vec3) -> Option<usize> {
        let cell = (point / self.cell_m).floor().to_array();
        // 21 bits per axis: two million cells each way.
        let key = cell
            .iter()
            .fold(0, |key, &c| (key << 21) | (c as i64 as u64 & 0x1f_ffff));
        let next = self.sums.len();
        if let Some(at) = self.cells.get(&key) {
            return Some(*at as usize);
        }
        if next >= CANDIDATES_MAX {
            return None;
        }
        self.cells.insert(key, next as u32);
        self.sums.push(Sum::default());
        Some(self.tags.push_empty())
    }
}

/// (12): candidates with enough views within `radius_m` of them, tagged with all of those.
fn supported(merged: &Merged, radius_m: f32) -> Candidates {
    let positions_m: Vec<Vec3> = merged.sums.iter().map(Sum::position_m).collect();
    let grid = Grid::new(&positions_m, radius_m);
    let gather = |position_m: Vec3, row: &mut [u64]| {
        row.fill(0);
        grid.for_each_within(&positions_m, position_m, radius_m, |near| {
            let theirs = merged.tags.row(near as usize);
            row.iter_mut()
                .zip(theirs)
                .for_each(|(mine, word)| *mine |= word);
        });
        row.iter().map(|word| word.count_ones()).sum::<u32>() >= merged.counts.views_needed
    };
    let chunks: Vec<Candidates> = positions_m
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, positions_m)| {
            let mut kept = Candidates::none_like(&merged.tags);
            let mut row = vec![0; merged.tags.words_per_row()];
            for (place, position_m) in (chunk * CHUNK..).zip(positions_m) {
                if gather(*position_m, &mut row) {
                    kept.push(*position_m, merged.sums[place].mean_value(), &row);
                }
            }
            kept
        })
        .collect();
    let mut all = Candidates::none_like(&merged.tags);
    for chunk in &chunks {
        for place in 0..chunk.value.len() {
            all.push(
                chunk.position_m[place],
                chunk.value[place],
                chunk.tags.row(place),
            );
        }
    }
    all
}

impl Candidates {
    fn none_like(tags: &ViewTags) -> Self {
        Self {
            position_m: Vec::new(),
            value: Vec::new(),
            tags: ViewTags::new(64 * tags.words_per_row()),
        }
    }

    fn push(&mut self, position_m: Vec3, value: f32, row: &[u64]) {
        self.position_m.push(position_m);
        self.value.push(value);
        self.tags.push_row(row);
    }
}

/// For keys whose bits one multiplication mixes well enough.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u64(u64::from(*byte));
        }
    }

    fn write_u64(&mut self, value: u64) {
        self.0 = (self.0 ^ value).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    #[test]
    fn candidates_of_a_pixel_lie_on_its_arc() {
        let image = sample::image(0, |beam, bin| (beam, bin) == (5, 40));
        let choices = Choices::default();
        let g = image.geometry;
        let points: Vec<Vec3> = arc(&image, 5, 40, &choices).collect();
        assert!(points.len() > 20);
        let mut last_elevation = f32::NEG_INFINITY;
        for point in &points {
            let q = g.axes.transpose() * (*point - g.position_m);
            assert!((q.length() - (g.range_min_m + 40.0 * g.range_step_m)).abs() < 1e-4);
            let azimuth = 5.0 * g.azimuth_step_rad() - 0.5 * g.fov_rad;
            assert!((q.y.atan2(q.x) - azimuth).abs() < 1e-5);
            let elevation = q.z.atan2(q.truncate().length());
            assert!(elevation > last_elevation && elevation.abs() < 25.01f32.to_radians());
            last_elevation = elevation;
        }
        assert!(last_elevation > 24.99f32.to_radians());
    }

    #[test]
    fn support_counts_views_and_not_pings_or_pixels() {
        // Two views see the place, one of them with many pixels around it; three are asked for.
        let few = sample::images(vec![
            sample::image(0, |beam, bin| {
                (4..7).contains(&beam) && (39..42).contains(&bin)
            }),
            sample::image(1, |beam, bin| (beam, bin) == (5, 40)),
        ]);
        let choices = Choices {
            support_views: 3,
            support_share: 0.0,
            ..Choices::default()
        };
        let (found, counts) = find(&few, 0.1, &choices);
        assert_eq!(
            (counts.active_pixels, counts.kept, found.value.len()),
            (10, 0, 0)
        );

        let choices = Choices {
            support_views: 2,
            ..choices
        };
        let (found, counts) = find(&few, 0.1, &choices);
        assert!(counts.kept > 0 && counts.kept <= counts.candidates);
        for row in 0..found.tags.len() {
            assert_eq!(found.tags.count(row), 2);
        }
    }

    #[test]
    fn a_full_table_of_candidates_drops_and_counts() {
        let mut merged = Merged::new(0.1, 1);
        merged.sums = vec![Sum::default(); CANDIDATES_MAX];
        merged.add(0, Vec3::ONE, 1.0);
        assert_eq!(merged.counts.dropped_samples, 1);
    }
}
