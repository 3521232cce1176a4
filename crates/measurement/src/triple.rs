//! Vectors of eight Gaussians, and how kernels read them from arrays of one number each.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use crate::lanes::LANES;

/// Three numbers of eight Gaussians.
pub(crate) type Triple<S> = [f32x8<S>; 3];

#[inline(always)]
pub(crate) fn dot<S: Simd>(a: Triple<S>, b: Triple<S>) -> f32x8<S> {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

#[inline(always)]
pub(crate) fn cross<S: Simd>(a: Triple<S>, b: Triple<S>) -> Triple<S> {
    [
        a[1].mul_sub(b[2], a[2] * b[1]),
        a[2].mul_sub(b[0], a[0] * b[2]),
        a[0].mul_sub(b[1], a[1] * b[0]),
    ]
}

/// [`dot`] with one vector for all lanes.
#[inline(always)]
pub(crate) fn weighted<S: Simd>(v: Triple<S>, [x, y, z]: [f32; 3]) -> f32x8<S> {
    v[0].mul_add(x, v[1].mul_add(y, v[2] * z))
}

/// The numbers of `field` at `indices`, which all must exist and ascend; the last may be repeated.
#[inline(always)]
pub(crate) fn gathered<S: Simd>(simd: S, field: &[f32], indices: [u32; LANES]) -> f32x8<S> {
    let (first, last) = (indices[0] as usize, indices[LANES - 1] as usize);
    // Ascending, and each once if the last is: then eight in a row if the ends say so.
    let is_repeated = indices[LANES - 2] == indices[LANES - 1];
    if !is_repeated && last.wrapping_sub(first) == LANES - 1 {
        return f32x8::from_slice(simd, &field[first..=last]);
    }
    let mut values = [0.0; LANES];
    for (value, index) in values.iter_mut().zip(indices) {
        *value = field[index as usize];
    }
    f32x8::simd_from(simd, values)
}
