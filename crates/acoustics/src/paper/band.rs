//! A band of beams: its pixels' buffers, and what is done over the splats that touch it.
//!
//! Transmittance is kept as T itself with the residue of its last rounding, and each splat takes
//! `α f T` from the pair. Products of a hundred thousand factors stay exact to some rounding errors
//! that way, with opacities of 10⁻⁸ too, and neither logarithm nor exponential is needed.

use fearless_simd::prelude::*;
use fearless_simd::u32x8;

use super::kernel::{Layout, Pen, Strip, cover};
use super::projection::{Splat, V};
use super::{LEAST_TRANSMITTANCE, PaperView, Transmittance};
use crate::lanes::{LANES, only};

/// Sums over the pixels of a splat: e, ez, ez², ed, edz, ed², and dL/d ln ρ.
pub(super) const MOMENTS: usize = 7;
pub(super) type Moments = [f32; MOMENTS];

/// A splat that touches a band.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Entry {
    /// Place in the order of splats.
    pub(super) splat: u32,
    /// Whether no other band is touched.
    whole: bool,
    /// Pixels covered here: `|N_i|`.
    pub(super) pixels: u32,
    /// (29) before division.
    pub(super) seen: f32,
    /// Σ f dL/dI.
    pub(super) energy: f32,
}

/// Buffers of a band, rows of beams with padding; kept from image to image.
#[derive(Debug, Default)]
pub(super) struct Band {
    layout: Layout,
    pub(super) entries: Vec<Entry>,
    /// Of each entry, filled by the way back.
    pub(super) moments: Vec<Moments>,
    image: Vec<f32>,
    d_image: Vec<f32>,
    /// T and what rounding took from it.
    left: Vec<f32>,
    residue: Vec<f32>,
    /// Last splat that a pixel was not done before.
    done_after: Vec<u32>,
    /// On the way back: what the loss owes to ln T, over −1, of all splats behind.
    behind: Vec<f32>,
    strips: Vec<Strip>,
    kernel: Vec<[f32; LANES]>,
}

/// One splat over one band, with its strips.
struct Stroke<'a, S: Simd> {
    simd: S,
    place: u32,
    splat: &'a Splat,
    pen: Pen<S>,
    strips: &'a [Strip],
}

#[inline(always)]
fn load<S: Simd>(simd: S, buffer: &[f32], at: usize) -> V<S> {
    V::from_slice(simd, &buffer[at..at + LANES])
}

#[inline(always)]
fn store<S: Simd>(value: V<S>, buffer: &mut [f32], at: usize) {
    value.store_slice(&mut buffer[at..at + LANES]);
}

fn reset<T: Copy>(buffer: &mut Vec<T>, len: usize, value: T) {
    buffer.clear();
    buffer.resize(len, value);
}

impl Band {
    /// Beams `beams[0]..beams[1]` of a view, dark.
    pub(super) fn start(&mut self, view: &PaperView, beams: [u32; 2]) {
        self.layout = Layout {
            beams,
            range_bins: view.range_bins,
            stride: view.range_bins.next_multiple_of(LANES as u32) + LANES as u32,
        };
        reset(&mut self.image, self.layout.len(), 0.0);
        let strips = self.layout.strips_max();
        self.strips.resize(strips, Strip::default());
        self.kernel.resize(strips, [0.0; LANES]);
    }

    /// Takes note of the splats that touch this band, in their order.
    pub(super) fn list(&mut self, splats: &[Splat]) {
        let [first, end] = self.layout.beams;
        self.entries.clear();
        self.entries.resize(splats.len() + 1, Entry::default());
        let mut len = 0;
        for (place, splat) in splats.iter().enumerate() {
            self.entries[len] = Entry {
                splat: place as u32,
                whole: splat.beams[0] >= first && splat.beams[1] <= end,
                ..Entry::default()
            };
            // Without a branch: half of them would be missed.
            len += usize::from(splat.beams[0] < end && splat.beams[1] > first);
        }
        self.entries.truncate(len);
    }

    /// Clear water before the first splat.
    fn clear(&mut self) {
        let len = self.layout.len();
        reset(&mut self.left, len, 1.0);
        reset(&mut self.residue, len, 0.0);
        reset(&mut self.done_after, len, u32::MAX);
    }

    /// Renders what can be rendered without the other bands: all of [`Transmittance::None`] and
    /// [`Transmittance::Exact`], and of [`Transmittance::Averaged`] the splats within this band.
    #[inline(always)]
    pub(super) fn forward<S: Simd>(&mut self, simd: S, kind: Transmittance, splats: &[Splat]) {
        if kind != Transmittance::None {
            self.clear();
        }
        for i in 0..self.entries.len() {
            let entry = self.entries[i];
            let splat = &splats[entry.splat as usize];
            let (count, pixels) = cover(simd, splat, &self.layout, &mut self.strips);
            let mut sheet = Sheet::of(
                &mut self.image,
                &mut self.left,
                &mut self.residue,
                &mut self.done_after,
            );
            let stroke = Stroke {
                simd,
                place: entry.splat,
                splat,
                pen: Pen::new(simd, splat),
                strips: &self.strips[..count],
            };
            let strength = splat.opacity * splat.reflectivity;
            let kernel = &mut self.kernel[..count];
            let mut seen = 0.0;
            match kind {
                Transmittance::None => stroke.add(strength, sheet.image),
                Transmittance::Exact => stroke.shade::<true>(&mut sheet, kernel, &mut seen),
                Transmittance::Averaged => {
                    stroke.shade::<false>(&mut sheet, kernel, &mut seen);
                    if entry.whole && pixels > 0 {
                        let strength = seen / pixels as f32 * strength;
                        stroke.add_drawn(strength, kernel, sheet.image);
                    }
                }
            }
            let entry = &mut self.entries[i];
            (entry.pixels, entry.seen) = (pixels, seen);
        }
    }

    /// (30) for the splats that lie in other bands too, once their (29) is known.
    #[inline(always)]
    pub(super) fn forward_shared<S: Simd>(&mut self, simd: S, splats: &[Splat], means: &[f32]) {
        for entry in self.entries.iter().filter(|entry| !entry.whole) {
            let splat = &splats[entry.splat as usize];
            let (count, _) = cover(simd, splat, &self.layout, &mut self.strips);
            let stroke = Stroke {
                simd,
                place: entry.splat,
                splat,
                pen: Pen::new(simd, splat),
                strips: &self.strips[..count],
            };
            let strength = means[entry.splat as usize] * splat.opacity * splat.reflectivity;
            stroke.add(strength, &mut self.image);
        }
    }

    /// Pairs of splat and pixel.
    pub(super) fn pair_count(&self) -> u64 {
        self.entries
            .iter()
            .map(|entry| u64::from(entry.pixels))
            .sum()
    }

    /// Copies the pixels to `image`, shape `[beams][range_bins]` of the whole view.
    pub(super) fn copy_to(&self, image: &mut [f32]) {
        let bins = self.layout.range_bins as usize;
        let rows = image
            .chunks_exact_mut(bins)
            .skip(self.layout.beams[0] as usize);
        let padded = self.image.chunks_exact(self.layout.stride as usize);
        for (row, padded) in rows.zip(padded) {
            row.copy_from_slice(&padded[..bins]);
        }
    }

    /// Takes dL/dI of this band out of the whole view's; missing and non-finite ones are 0.
    pub(super) fn start_back(&mut self, d_image: &[f32]) {
        let len = self.layout.len();
        reset(&mut self.behind, len, 0.0);
        reset(&mut self.d_image, len, 0.0);
        reset(&mut self.moments, self.entries.len(), [0.0; MOMENTS]);
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
        for entry in self.entries.iter_mut().filter(|entry| !entry.whole) {
            let splat = &splats[entry.splat as usize];
            let (count, _) = cover(simd, splat, &self.layout, &mut self.strips);
            let stroke = Stroke {
                simd,
                place: entry.splat,
                splat,
                pen: Pen::new(simd, splat),
                strips: &self.strips[..count],
            };
            entry.energy = stroke.energy(&self.d_image, &mut self.kernel);
        }
    }

    /// Back to front: the moments of every entry. Undoes the shading.
    #[inline(always)]
    pub(super) fn backward<S: Simd>(
        &mut self,
        simd: S,
        kind: Transmittance,
        splats: &[Splat],
        means: &[f32],
        shared: &[Shared],
    ) {
        for i in (0..self.entries.len()).rev() {
            let entry = self.entries[i];
            let place = entry.splat as usize;
            let splat = &splats[place];
            let (count, _) = cover(simd, splat, &self.layout, &mut self.strips);
            let stroke = Stroke {
                simd,
                place: entry.splat,
                splat,
                pen: Pen::new(simd, splat),
                strips: &self.strips[..count],
            };
            let kernel = &mut self.kernel[..count];
            let mut sheet = BackSheet::of(
                &self.d_image,
                &mut self.left,
                &mut self.residue,
                &mut self.behind,
                &self.done_after,
            );
            let strength = splat.opacity * splat.reflectivity;
            self.moments[i] = match kind {
                Transmittance::None => stroke.moments(strength, sheet.d_image),
                Transmittance::Exact => stroke.moments_exact(&mut sheet),
                Transmittance::Averaged => {
                    let energy = stroke.energy(sheet.d_image, kernel);
                    let (whole, pixels) = if entry.whole {
                        (energy, entry.pixels)
                    } else {
                        (shared[place].energy, shared[place].pixels)
                    };
                    let weight = strength * whole / pixels.max(1) as f32;
                    let strength = means[place] * strength;
                    let mut moments = stroke.moments_averaged(&mut sheet, kernel, strength, weight);
                    moments[6] = strength * energy;
                    moments
                }
            };
        }
    }
}

/// Larger slopes count as not finite.
const D_IMAGE_MAX: f32 = 1e30;

/// What the bands together know of a splat.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Shared {
    pub(super) pixels: u32,
    pub(super) seen: f32,
    pub(super) energy: f32,
}

/// The buffers of the way there, all of one length.
struct Sheet<'a> {
    image: &'a mut [f32],
    left: &'a mut [f32],
    residue: &'a mut [f32],
    done_after: &'a mut [u32],
}

impl<'a> Sheet<'a> {
    #[inline(always)]
    fn of(
        image: &'a mut [f32],
        left: &'a mut [f32],
        residue: &'a mut [f32],
        done_after: &'a mut [u32],
    ) -> Self {
        Self {
            image,
            left,
            residue,
            done_after,
        }
    }
}

/// The buffers of the way back, all of one length.
struct BackSheet<'a> {
    d_image: &'a [f32],
    left: &'a mut [f32],
    residue: &'a mut [f32],
    behind: &'a mut [f32],
    done_after: &'a [u32],
}

impl<'a> BackSheet<'a> {
    #[inline(always)]
    fn of(
        d_image: &'a [f32],
        left: &'a mut [f32],
        residue: &'a mut [f32],
        behind: &'a mut [f32],
        done_after: &'a [u32],
    ) -> Self {
        Self {
            d_image,
            left,
            residue,
            behind,
            done_after,
        }
    }
}

/// Six running sums, eight lanes each.
#[derive(Clone, Copy)]
struct Sums<S: Simd>([V<S>; 6]);

impl<S: Simd> Sums<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        Self([V::splat(simd, 0.0); 6])
    }

    #[inline(always)]
    fn add(&mut self, e: V<S>, z: V<S>, d: f32) {
        let [e0, ez, ezz, ed, edz, edd] = &mut self.0;
        let by_z = e * z;
        let by_d = e * d;
        *e0 += e;
        *ez += by_z;
        *ezz = by_z.mul_add(z, *ezz);
        *ed += by_d;
        *edz = by_z.mul_add(d, *edz);
        *edd = by_d.mul_add(d, *edd);
    }

    #[inline(always)]
    fn moments(self, reflectivity_log: f32) -> Moments {
        let [a, b, c, d, e, f] = self.0;
        [
            a.reduce_sum(),
            b.reduce_sum(),
            c.reduce_sum(),
            d.reduce_sum(),
            e.reduce_sum(),
            f.reduce_sum(),
            reflectivity_log,
        ]
    }
}

impl<S: Simd> Stroke<'_, S> {
    /// `I += strength · f`.
    #[inline(always)]
    fn add(&self, strength: f32, image: &mut [f32]) {
        for strip in self.strips {
            let f = self.pen.draw(strip).f;
            let at = strip.at as usize;
            store(f.mul_add(strength, load(self.simd, image, at)), image, at);
        }
    }

    /// The same with a kernel that was drawn before.
    #[inline(always)]
    fn add_drawn(&self, strength: f32, kernel: &[[f32; LANES]], image: &mut [f32]) {
        for (strip, f) in self.strips.iter().zip(kernel) {
            let f = V::load_array_ref(self.simd, f);
            let at = strip.at as usize;
            store(f.mul_add(strength, load(self.simd, image, at)), image, at);
        }
    }

    /// (26), (27): takes from T; `seen` gets ΣT, `kernel` f. With `ADD` also (28).
    #[inline(always)]
    fn shade<const ADD: bool>(
        &self,
        sheet: &mut Sheet<'_>,
        kernel: &mut [[f32; LANES]],
        seen: &mut f32,
    ) {
        let simd = self.simd;
        let zero = V::splat(simd, 0.0);
        let mut sum = zero;
        for (strip, kernel) in self.strips.iter().zip(kernel) {
            let at = strip.at as usize;
            let lit = self.pen.draw(strip);
            let left = load(simd, sheet.left, at);
            let live = left.simd_ge(LEAST_TRANSMITTANCE) & lit.inside;
            let stopped = only(live, lit.f * self.splat.opacity);
            let taken = left.mul_add(-stopped, load(simd, sheet.residue, at));
            let after = left + taken;
            store(taken - (after - left), sheet.residue, at);
            store(after, sheet.left, at);
            if ADD {
                let echo = left * stopped * self.splat.reflectivity;
                store(load(simd, sheet.image, at) + echo, sheet.image, at);
            } else {
                sum += only(live, left);
                lit.f.store_array(kernel);
            }
            let done = live & after.simd_lt(LEAST_TRANSMITTANCE);
            if done.any_true() {
                let places = &mut sheet.done_after[at..at + LANES];
                let before = u32x8::from_slice(simd, places);
                done.select(u32x8::splat(simd, self.place), before)
                    .store_slice(places);
            }
        }
        *seen = sum.reduce_sum();
    }

    /// Σ f dL/dI; `kernel` gets f.
    #[inline(always)]
    fn energy(&self, d_image: &[f32], kernel: &mut [[f32; LANES]]) -> f32 {
        let mut sum = V::splat(self.simd, 0.0);
        for (strip, kernel) in self.strips.iter().zip(kernel) {
            let f = self.pen.draw(strip).f;
            sum = f.mul_add(load(self.simd, d_image, strip.at as usize), sum);
            f.store_array(kernel);
        }
        sum.reduce_sum()
    }

    #[inline(always)]
    fn moments(&self, strength: f32, d_image: &[f32]) -> Moments {
        let mut sums = Sums::new(self.simd);
        for strip in self.strips {
            let lit = self.pen.draw(strip);
            let e = lit.f * load(self.simd, d_image, strip.at as usize) * strength;
            sums.add(e, lit.z, strip.d);
        }
        let mut moments = sums.moments(0.0);
        moments[6] = moments[0];
        moments
    }

    /// T before this splat, put back in its place, where the pixel was not done; and α f and
    /// 1/(1 − α f) there.
    #[inline(always)]
    fn unshade(&self, sheet: &mut BackSheet<'_>, strip: &Strip, f: V<S>) -> [V<S>; 3] {
        let simd = self.simd;
        let at = strip.at as usize;
        let last = u32x8::from_slice(simd, &sheet.done_after[at..at + LANES]);
        let live = last.simd_ge(self.place);
        let stopped = only(live, f * self.splat.opacity);
        let inverse = V::splat(simd, 1.0) / (1.0 - stopped);
        let after = load(simd, sheet.left, at);
        let given = after.mul_add(stopped * inverse, load(simd, sheet.residue, at));
        let before = after + given;
        store(given - (before - after), sheet.residue, at);
        store(before, sheet.left, at);
        [only(live, before), stopped, inverse]
    }

    /// Moments of (28): what this splat sends back, less what it keeps from those behind.
    #[inline(always)]
    fn moments_exact(&self, sheet: &mut BackSheet<'_>) -> Moments {
        let simd = self.simd;
        let mut sums = Sums::new(simd);
        let mut echoes = V::splat(simd, 0.0);
        for strip in self.strips {
            let at = strip.at as usize;
            let lit = self.pen.draw(strip);
            let [left, stopped, inverse] = self.unshade(sheet, strip, lit.f);
            let d = load(simd, sheet.d_image, at);
            let behind = load(simd, sheet.behind, at);
            let echo = d * left * stopped * self.splat.reflectivity;
            echoes += echo;
            sums.add(echo - stopped * inverse * behind, lit.z, strip.d);
            store(behind + echo, sheet.behind, at);
        }
        sums.moments(echoes.reduce_sum())
    }

    /// Moments of (30), with `weight` = dL/dT of each covered pixel by (29).
    #[inline(always)]
    fn moments_averaged(
        &self,
        sheet: &mut BackSheet<'_>,
        kernel: &[[f32; LANES]],
        strength: f32,
        weight: f32,
    ) -> Moments {
        let simd = self.simd;
        let mut sums = Sums::new(simd);
        for (strip, f) in self.strips.iter().zip(kernel) {
            let at = strip.at as usize;
            let f = V::load_array_ref(simd, f);
            let [left, stopped, inverse] = self.unshade(sheet, strip, f);
            let d = load(simd, sheet.d_image, at);
            let behind = load(simd, sheet.behind, at);
            let e = (f * d).mul_add(V::splat(simd, strength), -(stopped * inverse * behind));
            sums.add(e, self.pen.z(strip), strip.d);
            let covered = only(self.pen.inside(strip), left);
            store(covered.mul_add(weight, behind), sheet.behind, at);
        }
        sums.moments(0.0)
    }
}
