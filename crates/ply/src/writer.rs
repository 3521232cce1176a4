//! Rows after a header of [`Format::LittleEndian`](crate::Format::LittleEndian).

use std::io::{self, Write};

/// Writes one row of `float`.
///
/// # Errors
/// Of the writer.
pub fn write_floats<const N: usize>(writer: &mut impl Write, row: &[f32; N]) -> io::Result<()> {
    row.iter()
        .try_for_each(|value| writer.write_all(&value.to_le_bytes()))
}

/// Writes one row of [`Element::of_lists`](crate::Element::of_lists).
///
/// # Errors
/// Of the writer, or if there are more than 255 items or one is too large for an `int`.
pub fn write_list(writer: &mut impl Write, items: &[u32]) -> io::Result<()> {
    let too_large = |_| io::Error::new(io::ErrorKind::InvalidInput, "more than PLY has room for");
    let count = u8::try_from(items.len()).map_err(too_large)?;
    writer.write_all(&[count])?;
    items.iter().try_for_each(|&item| {
        let item = i32::try_from(item).map_err(too_large)?;
        writer.write_all(&item.to_le_bytes())
    })
}
