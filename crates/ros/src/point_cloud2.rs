//! `sensor_msgs/msg/PointCloud2` of one row of points.

use crate::{CdrWriter, Header};

/// `sensor_msgs/msg/PointField.UINT32`.
pub const UINT32: u8 = 6;
/// `sensor_msgs/msg/PointField.FLOAT32`.
pub const FLOAT32: u8 = 7;

/// Bytes of a field's value; every field here has 32 bits.
const FIELD_BYTES: usize = 4;

/// The message of these points, each `N` bytes. `fields` name what lies in a point, one behind the
/// other, each of 32 bits ([`UINT32`] or [`FLOAT32`]), little-endian.
#[must_use]
pub fn encode<const N: usize>(
    header: &Header<'_>,
    fields: &[(&str, u8)],
    points: impl ExactSizeIterator<Item = [u8; N]>,
) -> Vec<u8> {
    debug_assert_eq!(fields.len() * FIELD_BYTES, N);
    let count = points.len();
    let mut writer = CdrWriter::with_capacity(1024 + count * N);
    header.write(&mut writer);
    writer.u32(1); // height
    writer.count(count); // width
    write_fields(&mut writer, fields);
    writer.u8(0); // is_bigendian
    writer.count(N); // point_step
    writer.count(count * N); // row_step
    writer.count(count * N); // length of data
    points.for_each(|point| writer.bytes(&point));
    writer.u8(1); // is_dense
    writer.finish()
}

fn write_fields(writer: &mut CdrWriter, fields: &[(&str, u8)]) {
    writer.count(fields.len());
    for (index, (name, datatype)) in fields.iter().enumerate() {
        writer.string(name);
        writer.count(index * FIELD_BYTES); // offset
        writer.u8(*datatype);
        writer.u32(1); // count
    }
}
