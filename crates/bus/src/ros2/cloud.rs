//! What the map asserts, as a point cloud for ROS: smaller than the map's own messages, since the
//! whole of it goes out again and again.
//!
//! One point is one confident Gaussian, 20 bytes: `x`, `y`, `z` of its centre, `intensity`
//! (opacity · reflectivity) and `sigma` (metres, one sigma of its place along the least known
//! direction), all f32.
//!
//! Where there are more points than may go out, those stay whose ids scramble to the smallest
//! numbers. So the same map gives the same points everywhere, they are spread over it evenly, and
//! from one message to the next hardly any point goes or comes but with its Gaussian.

use echosplat_model::{Gaussian, Snapshot, Standing};
use echosplat_ros::point_cloud2::{self, FLOAT32};

use crate::ros::Header;

/// Most points of a message.
pub(super) const MAX_POINTS: usize = 50_000;

/// Bytes of a point.
pub(super) const POINT_BYTES: usize = 20;

const FIELDS: [(&str, u8); POINT_BYTES / 4] = [
    ("x", FLOAT32),
    ("y", FLOAT32),
    ("z", FLOAT32),
    ("intensity", FLOAT32),
    ("sigma", FLOAT32),
];

/// A message.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Cloud {
    pub(super) bytes: Vec<u8>,
    /// Confident Gaussians that are not in it.
    pub(super) left_out: usize,
}

/// The cloud of a map, at most `limit` points of it. What is not sound is no surface.
pub(super) fn encode(map: &Snapshot, frame_id: &str, limit: usize) -> Cloud {
    let is_asserted =
        |gaussian: &&Gaussian| gaussian.standing == Standing::Confident && gaussian.is_sound();
    let mut asserted: Vec<&Gaussian> = map.gaussians.iter().filter(is_asserted).collect();
    let left_out = asserted.len().saturating_sub(limit);
    if left_out > 0 {
        asserted.select_nth_unstable_by_key(limit, |gaussian| scrambled(gaussian.id));
        asserted.truncate(limit);
        asserted.sort_unstable_by_key(|gaussian| gaussian.id);
    }
    let header = Header {
        stamp: map.time,
        frame_id,
    };
    let points = asserted.iter().map(|gaussian| point_of(gaussian));
    Cloud {
        bytes: point_cloud2::encode(&header, &FIELDS, points),
        left_out,
    }
}

fn point_of(gaussian: &Gaussian) -> [u8; POINT_BYTES] {
    let [x, y, z] = gaussian.mean_m.to_array();
    let intensity = gaussian.opacity * gaussian.reflectivity;
    let mut bytes = [0; POINT_BYTES];
    for (slot, value) in bytes
        .chunks_exact_mut(4)
        .zip([x, y, z, intensity, gaussian.sigma_m])
    {
        slot.copy_from_slice(&value.to_le_bytes());
    }
    bytes
}

/// Another number for each id, without order: the finaliser of `MurmurHash3`, which no two ids share.
fn scrambled(id: u32) -> u32 {
    let id = (id ^ (id >> 16)).wrapping_mul(0x85EB_CA6B);
    let id = (id ^ (id >> 13)).wrapping_mul(0xC2B2_AE35);
    id ^ (id >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cdr::CdrReader;
    use crate::test_support::{gaussian, snapshot};
    use std::collections::BTreeSet;

    /// Fields' names, and the points.
    fn read(bytes: &[u8]) -> (Vec<String>, Vec<[f32; 5]>) {
        let mut reader = CdrReader::new(bytes).unwrap();
        let header = Header::read(&mut reader).unwrap();
        assert_eq!(header.frame_id, "map");
        assert_eq!(reader.u32("height"), Ok(1));
        let width = reader.u32("width").unwrap() as usize;
        let names = (0..reader.u32("fields").unwrap()).map(|index| {
            let name = reader.string("name", 63).unwrap().to_owned();
            assert_eq!(reader.u32("offset"), Ok(index * 4));
            assert_eq!(reader.u8("datatype"), Ok(FLOAT32));
            assert_eq!(reader.u32("count"), Ok(1));
            name
        });
        let names = names.collect();
        assert_eq!(reader.u8("is_bigendian"), Ok(0));
        assert_eq!(reader.u32("point_step"), Ok(POINT_BYTES as u32));
        assert_eq!(reader.u32("row_step"), Ok((width * POINT_BYTES) as u32));
        let data_bytes = reader.count("data", width * POINT_BYTES).unwrap();
        let data = reader.bytes("data", data_bytes).unwrap();
        assert_eq!(reader.u8("is_dense"), Ok(1));
        reader.finish().unwrap();
        let value = |word: &[u8]| f32::from_le_bytes(word.try_into().unwrap());
        let point = |bytes: &[u8]| std::array::from_fn(|i| value(&bytes[i * 4..i * 4 + 4]));
        (names, data.chunks_exact(POINT_BYTES).map(point).collect())
    }

    fn confident(ids: impl Iterator<Item = u32>) -> Vec<Gaussian> {
        let all = ids.map(gaussian);
        all.filter(|g| g.standing == Standing::Confident).collect()
    }

    /// Centres tell the Gaussians of the tests apart.
    fn places(cloud: &Cloud) -> BTreeSet<[u32; 3]> {
        let (_, points) = read(&cloud.bytes);
        let place = |point: &[f32; 5]| [point[0], point[1], point[2]].map(f32::to_bits);
        points.iter().map(place).collect()
    }

    #[test]
    fn what_is_asserted_is_there_with_its_sigma_and_nothing_else() {
        let mut gaussians: Vec<Gaussian> = (0..40).map(gaussian).collect();
        gaussians[5].mean_m.x = f32::NAN;
        let map = snapshot(1, 1, gaussians);
        let cloud = encode(&map, "map", 1000);
        let (names, points) = read(&cloud.bytes);
        assert_eq!(names, ["x", "y", "z", "intensity", "sigma"]);
        let expected = confident((0..40).filter(|id| *id != 5));
        let expected: Vec<[f32; 5]> = expected
            .iter()
            .map(|g| {
                let [x, y, z] = g.mean_m.to_array();
                [x, y, z, g.opacity * g.reflectivity, g.sigma_m]
            })
            .collect();
        assert_eq!((points, cloud.left_out), (expected, 0));
    }

    #[test]
    fn a_map_that_asserts_nothing_is_an_empty_cloud() {
        let cloud = encode(&snapshot(1, 1, vec![gaussian(1)]), "map", 10);
        assert_eq!(read(&cloud.bytes).1, Vec::<[f32; 5]>::new());
        assert_eq!(
            read(&encode(&snapshot(1, 1, Vec::new()), "map", 0).bytes)
                .1
                .len(),
            0
        );
    }

    #[test]
    fn too_many_points_are_thinned_evenly_and_the_same_way_each_time() {
        let all = confident(0..9000);
        let map = snapshot(1, 1, all.clone());
        let cloud = encode(&map, "map", 600);
        assert_eq!(cloud.left_out, all.len() - 600);
        assert_eq!(read(&cloud.bytes).1.len(), 600);
        let mut turned = all.clone();
        turned.reverse();
        assert_eq!(encode(&snapshot(1, 1, turned), "map", 600), cloud);
        // Born one after another, Gaussians of a stretch of the dive have ids in a row.
        let kept = places(&cloud);
        for stretch in all.chunks(1000) {
            let place = |g: &Gaussian| g.mean_m.to_array().map(f32::to_bits);
            let count = stretch.iter().filter(|g| kept.contains(&place(g))).count();
            assert!(
                (70..=130).contains(&count),
                "{count} of 1000 kept, 100 expected"
            );
        }
    }

    #[test]
    fn a_map_that_grows_a_little_shows_nearly_the_same_points() {
        let before = places(&encode(&snapshot(1, 1, confident(0..9000)), "map", 600));
        let after = places(&encode(&snapshot(1, 2, confident(0..9090)), "map", 600));
        let stayed = before.intersection(&after).count();
        assert!(stayed > 580, "{stayed} of 600 stayed");
    }

    #[test]
    fn no_two_ids_scramble_to_one_number() {
        let numbers: BTreeSet<u32> = (0..100_000).map(scrambled).collect();
        assert_eq!(numbers.len(), 100_000);
    }
}
