//! A band of beams: its pixels' buffers, and what is done over the splats that touch it.

use fearless_simd::prelude::*;

use super::kernel::{Layout, Pen, Strip, cover};
use super::projection::Splat;
use super::stroke::{BackSheet, MOMENTS, Moments, Sheet, Stroke};
use super::{PaperView, Transmittance};
use echosplat_measurement::lanes::LANES;

/// Larger slopes count as not finite.
const D_IMAGE_MAX: f32 = 1e30;
/// Strips of one batch of splats, a megabyte: most images need one batch only.
const BATCH_STRIPS: usize = 1 << 16;

/// Splats added up in one part: so many roundings one way may add up too.
const PART_SPLATS: usize = 1024;

/// What is known of a splat's pixels, in a band or in all.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Found {
    /// Pixels covered: `|N_i|`.
    pub(super) pixels: u32,
    /// (29) before division.
    pub(super) seen: f32,
    /// Σ f dL/dI.
    pub(super) energy: f32,
}

/// The strips of some splats that follow one another. How often the loops over them run is then
/// known long before they begin, and the processor need not guess.
#[derive(Debug, Default)]
struct Batch {
    strips: Vec<Strip>,
    spans: Vec<Span>,
}

/// The strips of one splat.
#[derive(Debug, Clone, Copy)]
struct Span {
    /// Place among the band's splats, and among all.
    entry: u32,
    place: u32,
    start: u32,
    end: u32,
    pixels: u32,
    /// Whether the splat touches no other band.
    whole: bool,
}

impl Batch {
    /// The batch of the entries from `first` on, as many as there is room for; returns one beyond
    /// the last. Does nothing if it holds that batch already.
    #[inline(always)]
    fn fill<S: Simd>(
        &mut self,
        simd: S,
        layout: &Layout,
        splats: &[Splat],
        places: &[u32],
        first: usize,
    ) -> usize {
        if self
            .spans
            .first()
            .is_some_and(|span| span.entry as usize == first)
        {
            return first + self.spans.len();
        }
        self.spans.clear();
        let mut start = 0;
        let mut next = first;
        while start < BATCH_STRIPS && next < places.len() {
            self.make_room(start + layout.strips_max());
            let splat = &splats[places[next] as usize];
            let (count, pixels) = cover(simd, splat, layout, &mut self.strips[start..]);
            let end = start + count;
            self.spans.push(Span {
                entry: next as u32,
                place: places[next],
                start: start as u32,
                end: end as u32,
                pixels,
                whole: splat.beams[0] >= layout.beams[0] && splat.beams[1] <= layout.beams[1],
            });
            start = end;
            next += 1;
        }
        next
    }

    #[inline(always)]
    fn make_room(&mut self, len: usize) {
        if self.strips.len() < len {
            self.strips.resize(2 * len, Strip::default());
        }
    }

    #[inline(always)]
    fn stroke<'a, S: Simd>(&'a self, simd: S, span: &Span, splats: &'a [Splat]) -> Stroke<'a, S> {
        let splat = &splats[span.place as usize];
        Stroke {
            simd,
            place: span.place,
            splat,
            pen: Pen::new(simd, splat),
            strips: &self.strips[span.start as usize..span.end as usize],
        }
    }
}

/// Buffers of a band, rows of beams with padding; kept from image to image.
#[derive(Debug, Default)]
pub(super) struct Band {
    layout: Layout,
    /// Places of the splats that touch this band, in their order.
    pub(super) places: Vec<u32>,
    /// Of each of them.
    pub(super) found: Vec<Found>,
    /// Of each of them, filled by the way back.
    pub(super) moments: Vec<Moments>,
    image: Vec<f32>,
    /// Sum of the images of earlier parts of a crowd.
    earlier: Vec<f32>,
    d_image: Vec<f32>,
    /// T and what rounding took from it.
    left: Vec<f32>,
    residue: Vec<f32>,
    /// Last splat that a pixel was not done before.
    done_after: Vec<u32>,
    /// On the way back: what the loss owes to ln T, over −1, of all splats behind.
    behind: Vec<f32>,
    batch: Batch,
    /// Where each batch of the forward pass ended: the way back takes them in reverse.
    batch_ends: Vec<usize>,
    /// (25) over the strips of one splat.
    kernel: Vec<[f32; LANES]>,
}

fn reset<T: Copy>(buffer: &mut Vec<T>, len: usize, value: T) {
    buffer.clear();
    buffer.resize(len, value);
}

/// Moves a part's sum to that of all.
fn fold(part: &mut [f32], all: &mut [f32]) {
    for (all, part) in all.iter_mut().zip(part) {
        *all += *part;
        *part = 0.0;
    }
}

impl Band {
    /// Beams `beams[0]..beams[1]` of a view, dark and without splats.
    pub(super) fn start(&mut self, view: &PaperView, beams: [u32; 2]) {
        self.layout = Layout {
            beams,
            range_bins: view.range_bins,
            stride: view.range_bins.next_multiple_of(LANES as u32) + LANES as u32,
        };
        self.places.clear();
        let strips = self.layout.strips_max();
        self.batch.spans.clear();
        self.kernel.resize(strips, [0.0; LANES]);
    }

    /// One beyond the last beam.
    pub(super) fn end_beam(&self) -> u32 {
        self.layout.beams[1]
    }

    /// Renders what can be rendered without the other bands: all of [`Transmittance::None`] and
    /// [`Transmittance::Exact`], and of [`Transmittance::Averaged`] the splats within this band.
    #[inline(always)]
    pub(super) fn forward<S: Simd>(&mut self, simd: S, kind: Transmittance, splats: &[Splat]) {
        let len = self.layout.len();
        reset(&mut self.image, len, 0.0);
        reset(&mut self.earlier, len, 0.0);
        reset(&mut self.found, self.places.len(), Found::default());
        if kind != Transmittance::None {
            reset(&mut self.left, len, 1.0);
            reset(&mut self.residue, len, 0.0);
            reset(&mut self.done_after, len, u32::MAX);
        }
        self.batch_ends.clear();
        let mut next = 0;
        while next < self.places.len() {
            next = self
                .batch
                .fill(simd, &self.layout, splats, &self.places, next);
            self.batch_ends.push(next);
            for span in &self.batch.spans {
                let stroke = self.batch.stroke(simd, span, splats);
                let strength = stroke.splat.opacity * stroke.splat.reflectivity;
                if span.entry as usize % PART_SPLATS == PART_SPLATS - 1 {
                    fold(&mut self.image, &mut self.earlier);
                }
                let found = &mut self.found[span.entry as usize];
                found.pixels = span.pixels;
                if kind == Transmittance::None {
                    stroke.add(strength, &mut self.image);
                    continue;
                }
                let mut sheet = Sheet {
                    image: &mut self.image,
                    left: &mut self.left,
                    residue: &mut self.residue,
                    done_after: &mut self.done_after,
                };
                if kind == Transmittance::Exact {
                    stroke.shade::<true>(&mut sheet, &mut self.kernel);
                    continue;
                }
                found.seen = stroke.shade::<false>(&mut sheet, &mut self.kernel);
                if span.whole {
                    let mean = found.seen / span.pixels.max(1) as f32;
                    stroke.add_drawn(mean * strength, &self.kernel, &mut self.image);
                }
            }
        }
    }

    /// (30) for the splats that lie in other bands too, once their (29) is known.
    #[inline(always)]
    pub(super) fn forward_shared<S: Simd>(&mut self, simd: S, splats: &[Splat], means: &[f32]) {
        let mut next = 0;
        while next < self.places.len() {
            next = self
                .batch
                .fill(simd, &self.layout, splats, &self.places, next);
            for span in self.batch.spans.iter().filter(|span| !span.whole) {
                let stroke = self.batch.stroke(simd, span, splats);
                let strength = stroke.splat.opacity * stroke.splat.reflectivity;
                stroke.add(means[span.place as usize] * strength, &mut self.image);
            }
        }
    }

    /// Pairs of splat and pixel.
    pub(super) fn pair_count(&self) -> u64 {
        self.found.iter().map(|found| u64::from(found.pixels)).sum()
    }

    /// Copies the pixels to `image`, shape `[beams][range_bins]` of the whole view.
    pub(super) fn copy_to(&self, image: &mut [f32]) {
        let bins = self.layout.range_bins as usize;
        let rows = image
            .chunks_exact_mut(bins)
            .skip(self.layout.beams[0] as usize);
        let stride = self.layout.stride as usize;
        let padded = self
            .image
            .chunks_exact(stride)
            .zip(self.earlier.chunks_exact(stride));
        for (row, (part, earlier)) in rows.zip(padded) {
            for ((pixel, part), earlier) in row.iter_mut().zip(part).zip(earlier) {
                *pixel = earlier + part;
            }
        }
    }

    /// Takes dL/dI of this band out of the whole view's; missing and non-finite ones are 0.
    pub(super) fn start_back(&mut self, d_image: &[f32]) {
        reset(&mut self.d_image, self.layout.len(), 0.0);
        let bins = self.layout.range_bins as usize;
        let rows = d_image.chunks(bins).skip(self.layout.beams[0] as usize);
        let padded = self.d_image.chunks_exact_mut(self.layout.stride as usize);
        for (row, padded) in rows.zip(padded) {
            for (to, &from) in padded.iter_mut().zip(row) {
                *to = if from.abs() <= D_IMAGE_MAX { from } else { 0.0 };
            }
        }
    }

    /// Σ f dL/dI of the splats that lie in other bands too.
    #[inline(always)]
    pub(super) fn energies<S: Simd>(&mut self, simd: S, splats: &[Splat]) {
        let mut next = 0;
        while next < self.places.len() {
            next = self
                .batch
                .fill(simd, &self.layout, splats, &self.places, next);
            for span in self.batch.spans.iter().filter(|span| !span.whole) {
                let stroke = self.batch.stroke(simd, span, splats);
                self.found[span.entry as usize].energy =
                    stroke.energy(&self.d_image, &mut self.kernel);
            }
        }
    }

    /// Back to front: the moments of every splat here. `all` is what the bands found together.
    /// Undoes the shading.
    #[inline(always)]
    pub(super) fn backward<S: Simd>(
        &mut self,
        simd: S,
        kind: Transmittance,
        splats: &[Splat],
        all: &[Found],
    ) {
        reset(&mut self.moments, self.places.len(), [0.0; MOMENTS]);
        reset(&mut self.behind, self.layout.len(), 0.0);
        for batch in (0..self.batch_ends.len()).rev() {
            let first = if batch == 0 {
                0
            } else {
                self.batch_ends[batch - 1]
            };
            self.batch
                .fill(simd, &self.layout, splats, &self.places, first);
            for span in self.batch.spans.iter().rev() {
                let stroke = self.batch.stroke(simd, span, splats);
                let mut sheet = BackSheet {
                    d_image: &self.d_image,
                    left: &mut self.left,
                    residue: &mut self.residue,
                    behind: &mut self.behind,
                    done_after: &self.done_after,
                };
                let strength = stroke.splat.opacity * stroke.splat.reflectivity;
                self.moments[span.entry as usize] = match kind {
                    Transmittance::None => stroke.moments(strength, sheet.d_image),
                    Transmittance::Exact => stroke.moments_exact(&mut sheet),
                    Transmittance::Averaged => {
                        let energy = stroke.energy(sheet.d_image, &mut self.kernel);
                        let mut found = all[span.place as usize];
                        if span.whole {
                            found.energy = energy;
                        }
                        let per_pixel = 1.0 / found.pixels.max(1) as f32;
                        let mean = found.seen * per_pixel;
                        let weight = strength * found.energy * per_pixel;
                        let kernel = &self.kernel;
                        let mut moments =
                            stroke.moments_averaged(&mut sheet, kernel, mean * strength, weight);
                        moments[6] = mean * strength * energy;
                        moments
                    }
                };
            }
        }
    }
}
