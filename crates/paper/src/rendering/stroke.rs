//! What one splat does to the pixels of a band, there and back.
//!
//! Transmittance is kept as T itself with the residue of its last rounding, and each splat takes
//! `α f T` from the pair. Products of a hundred thousand factors stay exact to some rounding errors
//! that way, with opacities of 10⁻⁸ too, and neither logarithm nor exponential is needed.

use fearless_simd::prelude::*;
use fearless_simd::u32x8;

use super::LEAST_TRANSMITTANCE;
use super::kernel::{Pen, Strip};
use super::projection::{Splat, V};
use echosplat_measurement::lanes::{LANES, only};

/// Sums over the pixels of a splat: e, ez, ez², ed, edz, ed², and dL/d ln ρ.
pub(super) const MOMENTS: usize = 7;
pub(super) type Moments = [f32; MOMENTS];

/// One splat over one band, with its strips.
pub(super) struct Stroke<'a, S: Simd> {
    pub(super) simd: S,
    pub(super) place: u32,
    pub(super) splat: &'a Splat,
    pub(super) pen: Pen<S>,
    pub(super) strips: &'a [Strip],
}

#[inline(always)]
fn load<S: Simd>(simd: S, buffer: &[f32], at: usize) -> V<S> {
    V::from_slice(simd, &buffer[at..at + LANES])
}

#[inline(always)]
fn store<S: Simd>(value: V<S>, buffer: &mut [f32], at: usize) {
    value.store_slice(&mut buffer[at..at + LANES]);
}

/// The buffers of the way there, all of one length.
pub(super) struct Sheet<'a> {
    pub(super) image: &'a mut [f32],
    pub(super) left: &'a mut [f32],
    pub(super) residue: &'a mut [f32],
    pub(super) done_after: &'a mut [u32],
}

/// The buffers of the way back, all of one length.
pub(super) struct BackSheet<'a> {
    pub(super) d_image: &'a [f32],
    pub(super) left: &'a mut [f32],
    pub(super) residue: &'a mut [f32],
    pub(super) behind: &'a mut [f32],
    pub(super) done_after: &'a [u32],
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
    pub(super) fn add(&mut self, e: V<S>, z: V<S>, d: f32) {
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
    pub(super) fn add(&self, strength: f32, image: &mut [f32]) {
        for strip in self.strips {
            let f = self.pen.draw(strip).f;
            let at = strip.at();
            store(f.mul_add(strength, load(self.simd, image, at)), image, at);
        }
    }

    /// The same with a kernel that was drawn before.
    #[inline(always)]
    pub(super) fn add_drawn(&self, strength: f32, kernel: &[[f32; LANES]], image: &mut [f32]) {
        for (strip, f) in self.strips.iter().zip(kernel) {
            let f = V::load_array_ref(self.simd, f);
            let at = strip.at();
            store(f.mul_add(strength, load(self.simd, image, at)), image, at);
        }
    }

    /// (26), (27): takes from T and returns ΣT; `kernel` gets f. With `ADD` (28) instead of both.
    #[inline(always)]
    pub(super) fn shade<const ADD: bool>(
        &self,
        sheet: &mut Sheet<'_>,
        kernel: &mut [[f32; LANES]],
    ) -> f32 {
        let simd = self.simd;
        let zero = V::splat(simd, 0.0);
        let mut sum = zero;
        for (strip, kernel) in self.strips.iter().zip(kernel) {
            let at = strip.at();
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
        sum.reduce_sum()
    }

    /// Σ f dL/dI; `kernel` gets f.
    #[inline(always)]
    pub(super) fn energy(&self, d_image: &[f32], kernel: &mut [[f32; LANES]]) -> f32 {
        let mut sum = V::splat(self.simd, 0.0);
        for (strip, kernel) in self.strips.iter().zip(kernel) {
            let f = self.pen.draw(strip).f;
            sum = f.mul_add(load(self.simd, d_image, strip.at()), sum);
            f.store_array(kernel);
        }
        sum.reduce_sum()
    }

    #[inline(always)]
    pub(super) fn moments(&self, strength: f32, d_image: &[f32]) -> Moments {
        let mut sums = Sums::new(self.simd);
        for strip in self.strips {
            let lit = self.pen.draw(strip);
            let e = lit.f * load(self.simd, d_image, strip.at()) * strength;
            sums.add(e, lit.z, strip.d());
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
        let at = strip.at();
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
    pub(super) fn moments_exact(&self, sheet: &mut BackSheet<'_>) -> Moments {
        let simd = self.simd;
        let mut sums = Sums::new(simd);
        let mut echoes = V::splat(simd, 0.0);
        for strip in self.strips {
            let at = strip.at();
            let lit = self.pen.draw(strip);
            let [left, stopped, inverse] = self.unshade(sheet, strip, lit.f);
            let d = load(simd, sheet.d_image, at);
            let behind = load(simd, sheet.behind, at);
            let echo = d * left * stopped * self.splat.reflectivity;
            echoes += echo;
            sums.add(echo - stopped * inverse * behind, lit.z, strip.d());
            store(behind + echo, sheet.behind, at);
        }
        sums.moments(echoes.reduce_sum())
    }

    /// Moments of (30), with `weight` = dL/dT of each covered pixel by (29).
    #[inline(always)]
    pub(super) fn moments_averaged(
        &self,
        sheet: &mut BackSheet<'_>,
        kernel: &[[f32; LANES]],
        strength: f32,
        weight: f32,
    ) -> Moments {
        let simd = self.simd;
        let mut sums = Sums::new(simd);
        for (strip, f) in self.strips.iter().zip(kernel) {
            let at = strip.at();
            let f = V::load_array_ref(simd, f);
            let [left, stopped, inverse] = self.unshade(sheet, strip, f);
            let d = load(simd, sheet.d_image, at);
            let behind = load(simd, sheet.behind, at);
            let e = (f * d).mul_add(V::splat(simd, strength), -(stopped * inverse * behind));
            sums.add(e, self.pen.z(strip), strip.d());
            let covered = only(self.pen.inside(strip), left);
            store(covered.mul_add(weight, behind), sheet.behind, at);
        }
        sums.moments(0.0)
    }
}
