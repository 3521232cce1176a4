//! Gaussians as `sensor_msgs/msg/PointCloud2`, and back without the loss of a bit.
//!
//! One point per Gaussian, 92 bytes, little-endian, in the map's frame (add `origin_m` of the
//! message's attachment to get the world's coordinates):
//!
//! | offset | field | type | unit | what |
//! |---|---|---|---|---|
//! | 0 | `x` | f32 | m | centre, east of the map's origin |
//! | 4 | `y` | f32 | m | centre, north |
//! | 8 | `z` | f32 | m | centre, up |
//! | 12 | `intensity` | f32 | 1 | `opacity · reflectivity`, for viewers; ignored when read |
//! | 16 | `id` | u32 | | stable name within the epoch |
//! | 20 | `opacity` | f32 | 1 | fraction stopped, 0 to 1 (not the logit) |
//! | 24 | `scale_0` | f32 | m | one sigma along its first axis (not the logarithm) |
//! | 28 | `scale_1` | f32 | m | second axis |
//! | 32 | `scale_2` | f32 | m | third axis |
//! | 36 | `rot_0` | f32 | 1 | w of the unit quaternion world from its own axes; of another length than 1 it is normalised when read |
//! | 40 | `rot_1` | f32 | 1 | x |
//! | 44 | `rot_2` | f32 | 1 | y |
//! | 48 | `rot_3` | f32 | 1 | z |
//! | 52 | `reflectivity` | f32 | 1 | what of the stopped sound comes back, linear power |
//! | 56 | `sigma` | f32 | m | one sigma of its position along the least known direction; may be +∞ |
//! | 60 to 80 | `cov_xx`, `cov_xy`, `cov_xz`, `cov_yy`, `cov_yz`, `cov_zz` | f32 | m² | covariance of its position, map's axes; may be +∞ on the diagonal |
//! | 84 | `probability` | f32 | 1 | that there is surface within 0.10 m of it, 0 to 1 |
//! | 88 | `confident` | u32 | | 1 asserted as surface, 0 ambiguous |
//!
//! Which test gave it its verdict is in the attachment ([`crate::map_message`]).
//!
//! A point beyond what a Gaussian can be ([`Gaussian::check`]) is not written, and left out when read.
//!
//! In numpy, with `data` the message's bytes field:
//!
//! ```python
//! numpy.frombuffer(data, dtype=[
//!     ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("id", "<u4"),
//!     ("opacity", "<f4"), ("scale", "<f4", 3), ("rot", "<f4", 4),
//!     ("reflectivity", "<f4"), ("sigma", "<f4"), ("cov", "<f4", 6), ("probability", "<f4"),
//!     ("confident", "<u4")])
//! ```

use echosplat_model::{Gaussian, GaussianId, Standing, Timestamp, Unsound, Why};
use echosplat_ros::point_cloud2::{self, FLOAT32, UINT32};
use glam::{Quat, Vec3};

use crate::cdr::{CdrError, CdrReader};
use crate::ros::Header;

/// Encoding of the payload on the bus.
pub const ENCODING: &str = "application/cdr;sensor_msgs/msg/PointCloud2";

/// Bytes of one point as written.
pub const POINT_BYTES: usize = 4 * FIELDS.len();

/// Name and type of each field, in the order and places of the table above.
const FIELDS: [(&str, u8); 23] = [
    ("x", FLOAT32),
    ("y", FLOAT32),
    ("z", FLOAT32),
    ("intensity", FLOAT32),
    ("id", UINT32),
    ("opacity", FLOAT32),
    ("scale_0", FLOAT32),
    ("scale_1", FLOAT32),
    ("scale_2", FLOAT32),
    ("rot_0", FLOAT32),
    ("rot_1", FLOAT32),
    ("rot_2", FLOAT32),
    ("rot_3", FLOAT32),
    ("reflectivity", FLOAT32),
    ("sigma", FLOAT32),
    ("cov_xx", FLOAT32),
    ("cov_xy", FLOAT32),
    ("cov_xz", FLOAT32),
    ("cov_yy", FLOAT32),
    ("cov_yz", FLOAT32),
    ("cov_zz", FLOAT32),
    ("probability", FLOAT32),
    ("confident", UINT32),
];

/// More fields than any cloud this reads may have, its own and others' additions.
const MAX_FIELD_COUNT: usize = 64;
const MAX_FIELD_NAME_BYTES: usize = 63;
const MAX_POINT_BYTES: usize = 1024;

/// A point as it is let in, or which one is left out and why.
type Admitted = Result<Gaussian, (GaussianId, Unsound)>;

/// Where in a point each field of [`FIELDS`] lies.
type Offsets = [usize; FIELDS.len()];

#[cfg(test)]
pub(crate) fn field_names() -> impl Iterator<Item = &'static str> {
    FIELDS.into_iter().map(|(name, _)| name)
}

/// What a message holds.
#[derive(Debug, Clone, PartialEq)]
pub struct PointCloud {
    /// Time of the newest ping in it; whole until 2038.
    pub stamp: Timestamp,
    /// Name of the map's frame.
    pub frame_id: String,
    /// In the order of the message.
    pub gaussians: Vec<Gaussian>,
    /// Points left out, and why.
    pub unsound: Vec<(GaussianId, Unsound)>,
}

/// Why bytes are no cloud of Gaussians.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PointCloudError {
    /// Not the bytes of a `PointCloud2`.
    #[error("no PointCloud2: {0}")]
    Cdr(#[from] CdrError),
    /// A field is missing or of another type.
    #[error(
        "point cloud has no usable field {field}: wanted one 32-bit value of type {datatype} inside the point"
    )]
    Field {
        /// Its name.
        field: &'static str,
        /// 6 for u32, 7 for f32.
        datatype: u8,
    },
    /// Sizes that contradict one another.
    #[error(
        "point cloud of {width} × {height} points of {point_step} bytes, rows of {row_step}, holds {data_bytes} bytes"
    )]
    Size {
        /// Points in a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes of a point.
        point_step: u32,
        /// Bytes of a row.
        row_step: u32,
        /// Bytes there are.
        data_bytes: usize,
    },
    /// Big-endian points.
    #[error("point cloud is big-endian; only little-endian is read")]
    BigEndian,
}

/// The message of these Gaussians. `frame_id` names the map's frame.
#[must_use]
pub fn encode(gaussians: &[Gaussian], stamp: Timestamp, frame_id: &str) -> Vec<u8> {
    let header = Header { stamp, frame_id };
    point_cloud2::encode(&header, &FIELDS, gaussians.iter().map(point_of))
}

/// The bytes of one Gaussian.
fn point_of(gaussian: &Gaussian) -> [u8; POINT_BYTES] {
    let [x, y, z] = gaussian.mean_m.to_array();
    let [s0, s1, s2] = gaussian.scale_m.to_array();
    let q = gaussian.rotation;
    let [xx, xy, xz, yy, yz, zz] = gaussian.position_covariance_m2.map(f32::to_bits);
    let words = [
        x.to_bits(),
        y.to_bits(),
        z.to_bits(),
        (gaussian.opacity * gaussian.reflectivity).to_bits(),
        gaussian.id,
        gaussian.opacity.to_bits(),
        s0.to_bits(),
        s1.to_bits(),
        s2.to_bits(),
        q.w.to_bits(),
        q.x.to_bits(),
        q.y.to_bits(),
        q.z.to_bits(),
        gaussian.reflectivity.to_bits(),
        gaussian.sigma_m.to_bits(),
        xx,
        xy,
        xz,
        yy,
        yz,
        zz,
        gaussian.probability.to_bits(),
        u32::from(gaussian.standing == Standing::Confident),
    ];
    let mut bytes = [0; POINT_BYTES];
    for (slot, word) in bytes.chunks_exact_mut(4).zip(words) {
        slot.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// Reads a message of any size its bytes really have; fields may lie in any order and be more
/// than ours.
///
/// # Errors
/// If the bytes are no such message. Points that are unsound are counted and left out.
pub fn decode(bytes: &[u8]) -> Result<PointCloud, PointCloudError> {
    decode_with(bytes, |_| Why::default())
}

/// The same, with the reason that each point's number, from 0, has.
pub(crate) fn decode_with(
    bytes: &[u8],
    why_of: impl Fn(usize) -> Why,
) -> Result<PointCloud, PointCloudError> {
    let mut reader = CdrReader::new(bytes)?;
    let header = Header::read(&mut reader)?;
    let height = reader.u32("height")?;
    let width = reader.u32("width")?;
    let offsets = read_fields(&mut reader)?;
    if reader.u8("is_bigendian")? != 0 {
        return Err(PointCloudError::BigEndian);
    }
    let point_step = reader.u32("point_step")?;
    let row_step = reader.u32("row_step")?;
    let data_bytes = reader.count("data", bytes.len())?;
    let data = reader.bytes("data", data_bytes)?;
    reader.u8("is_dense")?;
    reader.finish()?;

    let point_bytes = u64::from(point_step);
    let row_bytes = u64::from(width) * point_bytes;
    let usable = row_bytes == u64::from(row_step)
        && row_bytes.checked_mul(u64::from(height)) == Some(data_bytes as u64)
        && (1..=MAX_POINT_BYTES as u64).contains(&point_bytes);
    if !usable {
        return Err(PointCloudError::Size {
            width,
            height,
            point_step,
            row_step,
            data_bytes,
        });
    }
    let points = data.chunks_exact(point_step as usize);
    let mut cloud = PointCloud {
        stamp: header.stamp,
        frame_id: header.frame_id.to_owned(),
        gaussians: Vec::with_capacity(points.len()),
        unsound: Vec::new(),
    };
    for (number, point) in points.enumerate() {
        match gaussian_of(point, &offsets)? {
            Ok(gaussian) => cloud.gaussians.push(Gaussian {
                why: why_of(number),
                ..gaussian
            }),
            Err(unsound) => cloud.unsound.push(unsound),
        }
    }
    Ok(cloud)
}

/// Finds the table's fields among those described; unknown ones are passed over.
fn read_fields(reader: &mut CdrReader<'_>) -> Result<Offsets, PointCloudError> {
    let mut found = [None; FIELDS.len()];
    for _ in 0..reader.count("fields", MAX_FIELD_COUNT)? {
        let name = reader.string("fields.name", MAX_FIELD_NAME_BYTES)?;
        let offset = reader.u32("fields.offset")?;
        let datatype = reader.u8("fields.datatype")?;
        let count = reader.u32("fields.count")?;
        let ours = FIELDS.iter().position(|&field| field == (name, datatype));
        if let (Some(index), 1) = (ours, count) {
            found[index] = usize::try_from(offset).ok();
        }
    }
    let mut offsets = [0; FIELDS.len()];
    for ((slot, found), (field, datatype)) in offsets.iter_mut().zip(found).zip(FIELDS) {
        *slot = found.ok_or(PointCloudError::Field { field, datatype })?;
    }
    Ok(offsets)
}

/// One point, or why it is left out.
fn gaussian_of(point: &[u8], offsets: &Offsets) -> Result<Admitted, PointCloudError> {
    let mut words = [0_u32; FIELDS.len()];
    for ((word, &offset), (field, datatype)) in words.iter_mut().zip(offsets).zip(FIELDS) {
        let bytes = point.get(offset..).and_then(|rest| rest.first_chunk());
        let bytes = bytes.ok_or(PointCloudError::Field { field, datatype })?;
        *word = u32::from_le_bytes(*bytes);
    }
    let value = |index: usize| f32::from_bits(words[index]);
    let id = words[4];
    let standing = match words[22] {
        0 => Standing::Ambiguous,
        1 => Standing::Confident,
        _ => return Ok(Err((id, Unsound::Standing))),
    };
    let gaussian = Gaussian {
        id,
        mean_m: Vec3::new(value(0), value(1), value(2)),
        rotation: Quat::from_xyzw(value(10), value(11), value(12), value(9)),
        scale_m: Vec3::new(value(6), value(7), value(8)),
        opacity: value(5),
        reflectivity: value(13),
        sigma_m: value(14),
        position_covariance_m2: std::array::from_fn(|i| value(15 + i)),
        probability: value(21),
        standing,
        why: Why::default(),
    };
    Ok(gaussian.admitted().map_err(|why| (id, why)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{bits, gaussian};
    use echosplat_model::MAX_PLACE_M;
    use proptest::prelude::*;

    fn stamp() -> Timestamp {
        Timestamp::from_nanos(1_700_000_000_000_000_001)
    }

    #[test]
    fn the_bytes_are_those_worked_out_by_hand() {
        let bytes = encode(&[gaussian(258)], stamp(), "map");
        // Header: 4 + 4 + (4 + 4); then height at 16 and width at 20, counted behind the four
        // bytes of encapsulation.
        assert_eq!(bytes[..4], [0, 1, 0, 0]);
        assert_eq!(bytes[4..8], 1_700_000_000_i32.to_le_bytes());
        assert_eq!(bytes[8..12], 1_u32.to_le_bytes());
        assert_eq!(bytes[12..20], [4, 0, 0, 0, b'm', b'a', b'p', 0]);
        assert_eq!(bytes[20..24], [1, 0, 0, 0]);
        assert_eq!(bytes[24..28], [1, 0, 0, 0]);
        // 23 fields at 24; of the first: length of the name at 28, offset aligned to 36, datatype
        // at 40, count aligned to 44.
        assert_eq!(bytes[28..32], [23, 0, 0, 0]);
        assert_eq!(bytes[32..40], [2, 0, 0, 0, b'x', 0, 0, 0]);
        assert_eq!(bytes[40..44], [0, 0, 0, 0]);
        assert_eq!(bytes[44..48], [7, 0, 0, 0]);
        assert_eq!(bytes[48..52], [1, 0, 0, 0]);
        // The last byte is is_dense; before it the 92 bytes of the point.
        let end = bytes.len() - 1;
        assert_eq!(bytes[end], 1);
        let point = &bytes[end - 92..end];
        assert_eq!(point[16..20], [2, 1, 0, 0]);
        assert_eq!(point[88..92], [1, 0, 0, 0]);
        assert_eq!(bytes[end - 96..end - 92], [92, 0, 0, 0]);
    }

    #[test]
    fn intensity_is_what_comes_back() {
        let g = gaussian(1);
        let point = point_of(&g);
        let intensity = f32::from_le_bytes([point[12], point[13], point[14], point[15]]);
        assert_eq!(intensity.to_bits(), (g.opacity * g.reflectivity).to_bits());
    }

    #[test]
    fn rotation_is_written_w_first() {
        let mut g = gaussian(1);
        g.rotation = Quat::from_xyzw(0.1, 0.2, 0.3, 0.9);
        assert_eq!(point_of(&g)[36..40], 0.9_f32.to_le_bytes());
        assert_eq!(point_of(&g)[48..52], 0.3_f32.to_le_bytes());
    }

    #[test]
    fn every_bit_of_every_field_comes_back() {
        let mut odd = gaussian(u32::MAX);
        odd.mean_m = Vec3::new(-0.0, f32::MIN_POSITIVE / 2.0, MAX_PLACE_M);
        odd.sigma_m = f32::INFINITY;
        odd.standing = Standing::Ambiguous;
        let sent = [gaussian(0), odd, gaussian(7)];
        let payload = encode(&sent, stamp(), "sea/map");
        let cloud = decode_with(&payload, |number| sent[number].why).unwrap();
        assert_eq!(cloud.stamp, stamp());
        assert_eq!(cloud.frame_id, "sea/map");
        assert_eq!(cloud.unsound, []);
        assert!(cloud.gaussians.iter().map(bits).eq(sent.iter().map(bits)));
    }

    #[test]
    fn what_is_not_sound_is_named_and_left_out() {
        let mut nan = gaussian(1);
        nan.mean_m.y = f32::NAN;
        let mut flat = gaussian(2);
        flat.scale_m.z = 0.0;
        let mut turned_by_nothing = gaussian(4);
        turned_by_nothing.rotation = Quat::from_xyzw(0.0, 0.0, 0.0, 0.0);
        let sent = [nan, gaussian(3), flat, turned_by_nothing];
        let payload = encode(&sent, stamp(), "");
        let cloud = decode_with(&payload, |number| sent[number].why).unwrap();
        let unsound = [
            (1, Unsound::Place),
            (2, Unsound::Scale),
            (4, Unsound::Rotation),
        ];
        assert_eq!(cloud.unsound, unsound);
        assert_eq!(cloud.gaussians, [gaussian(3)]);
    }

    #[test]
    fn sizes_that_contradict_one_another_are_refused() {
        let good = encode(&[gaussian(1)], stamp(), "map");
        for (at, value) in [(20, 2_u32), (24, u32::MAX), (24, 0), (20, u32::MAX)] {
            let mut bad = good.clone();
            bad[at..at + 4].copy_from_slice(&value.to_le_bytes());
            assert!(matches!(decode(&bad), Err(PointCloudError::Size { .. })));
        }
        let mut many_fields = good.clone();
        many_fields[28..32].copy_from_slice(&u32::MAX.to_le_bytes());
        let refused = decode(&many_fields);
        assert!(matches!(
            refused,
            Err(PointCloudError::Cdr(CdrError::TooLong { .. }))
        ));
        let mut renamed = good;
        renamed[36] = b'q';
        let refused = decode(&renamed);
        assert!(matches!(
            refused,
            Err(PointCloudError::Field { field: "x", .. })
        ));
    }

    #[test]
    fn every_cut_is_refused() {
        let good = encode(&[gaussian(1), gaussian(2)], stamp(), "map");
        for end in 0..good.len() {
            assert!(decode(&good[..end]).is_err(), "cut at {end}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_upset_it(bytes in proptest::collection::vec(any::<u8>(), 0..2048)) {
            let _ = decode(&bytes);
        }

        #[test]
        fn no_damage_upsets_it(flips in proptest::collection::vec((0_usize..720, any::<u8>()), 1..8)) {
            let mut bytes = encode(&[gaussian(1), gaussian(2)], stamp(), "map");
            for (at, value) in flips {
                let at = at % bytes.len();
                bytes[at] = value;
            }
            if let Ok(cloud) = decode(&bytes) {
                prop_assert!(cloud.gaussians.len() + cloud.unsound.len() <= bytes.len());
                prop_assert!(cloud.gaussians.iter().all(Gaussian::is_sound));
            }
        }
    }
}
