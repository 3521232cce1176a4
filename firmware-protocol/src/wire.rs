//! Little-endian fields of a byte slice. Callers check the slice's length before they read.

use core::ops::Range;

/// Where a field lies in its frame or payload.
pub(crate) type Field = Range<usize>;

fn array_at<const N: usize>(bytes: &[u8], field: Field) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(&bytes[field]);
    array
}

pub(crate) fn u16_at(bytes: &[u8], field: Field) -> u16 {
    u16::from_le_bytes(array_at(bytes, field))
}

pub(crate) fn i16_at(bytes: &[u8], field: Field) -> i16 {
    i16::from_le_bytes(array_at(bytes, field))
}

pub(crate) fn u32_at(bytes: &[u8], field: Field) -> u32 {
    u32::from_le_bytes(array_at(bytes, field))
}

pub(crate) fn f32_at(bytes: &[u8], field: Field) -> f32 {
    f32::from_le_bytes(array_at(bytes, field))
}

/// Copies `value` (already little-endian) into `field`.
pub(crate) fn put(bytes: &mut [u8], field: Field, value: &[u8]) {
    bytes[field].copy_from_slice(value);
}
