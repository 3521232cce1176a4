use super::*;

const CORNERS: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 2.0, 0.0],
    [0.0, 2.0, 0.0],
];

fn square() -> Vec<Triangle> {
    let [a, b, c, d] = CORNERS.map(|corner| glam::Vec3::from(corner).as_dvec3());
    vec![[a, b, c], [a, c, d]]
}

fn binary_stl() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(2u32.to_le_bytes());
    for triangle in square() {
        bytes.extend([0; 12]);
        for corner in triangle {
            bytes.extend(
                corner
                    .as_vec3()
                    .to_array()
                    .iter()
                    .flat_map(|v| v.to_le_bytes()),
            );
        }
        bytes.extend([0; 2]);
    }
    bytes
}

fn binary_ply(
    format: &str,
    number: impl Fn(f32) -> [u8; 4],
    index: impl Fn(i32) -> [u8; 4],
) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat {format} 1.0\ncomment a square\nelement vertex 4\nproperty float x\n\
         property float y\nproperty float z\nproperty uchar red\nelement face 1\n\
         property list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    for corner in CORNERS {
        bytes.extend(corner.iter().flat_map(|&value| number(value)));
        bytes.push(7);
    }
    bytes.push(4);
    bytes.extend((0..4).flat_map(index));
    bytes
}

#[test]
fn all_formats_give_the_same_square() {
    let obj = "# a square\nv 0 0 0\nv 1 0 0\nvn 0 0 1\nv 1 2 0\nv 0 2 0\nf 1//1 2//1 3//1 -1//1\n";
    let stl = "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 2 0\n\
               endloop\nendfacet\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 2 0\n\
               vertex 0 2 0\nendloop\nendfacet\nendsolid s\n";
    let ply = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\n\
               property double z\nelement face 1\nproperty list uchar uint vertex_index\n\
               end_header\n0 0 0\n1 0 0\n1 2 0\n0 2 0\n4 0 1 2 3\n";
    assert_eq!(parse(obj.as_bytes(), true).unwrap(), square());
    assert_eq!(parse(stl.as_bytes(), false).unwrap(), square());
    assert_eq!(parse(ply.as_bytes(), false).unwrap(), square());
    assert_eq!(parse(&binary_stl(), false).unwrap(), square());
    let little = binary_ply("binary_little_endian", f32::to_le_bytes, i32::to_le_bytes);
    let big = binary_ply("binary_big_endian", f32::to_be_bytes, i32::to_be_bytes);
    assert_eq!(parse(&little, false).unwrap(), square());
    assert_eq!(parse(&big, false).unwrap(), square());
}

#[test]
fn counts_are_held_against_the_bytes_there_are() {
    let mut stl = binary_stl();
    stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(
        parse(&stl, false)
            .unwrap_err()
            .contains("4294967295 facets")
    );
    let ply =
        "ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n1\n";
    assert!(
        parse(ply.as_bytes(), false)
            .unwrap_err()
            .contains("cut off")
    );
    let list = "ply\nformat ascii 1.0\nelement face 1\nproperty list uint int vertex_index\nend_header\n4000000000 1";
    assert!(
        parse(list.as_bytes(), false)
            .unwrap_err()
            .contains("list claims")
    );
}

#[test]
fn damage_is_named_and_never_panics() {
    for (obj, word) in [
        ("v 1 2\nf 1 1 1", "line 1"),
        ("v 1 2 3\nf 1 2 3", "line 2"),
        ("v 1 2 3\nf 0 1 1", "`0`"),
        ("v 1 2 nan\nf 1 1 1", "finite"),
        ("", "no triangle"),
    ] {
        let error = parse(obj.as_bytes(), true).unwrap_err();
        assert!(error.contains(word), "{obj}: {error}");
    }
    let whole = binary_ply("binary_little_endian", f32::to_le_bytes, i32::to_le_bytes);
    for end in 0..whole.len() {
        assert!(parse(&whole[..end], false).is_err(), "{end}");
    }
    for at in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[at] ^= 0xff;
        // Whatever comes of it, it comes back.
        let _ = parse(&damaged, false);
    }
}

#[test]
fn what_a_mesh_says_of_its_place_is_taken_and_a_turned_one_is_refused() {
    let text = |comment: &str| {
        let body = "0 0 0\n1 0 0\n1 2 0\n3 0 1 2\n";
        format!(
            "ply\nformat ascii 1.0\ncomment {comment}\nelement vertex 3\nproperty float x\nproperty float y\n\
             property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n{body}"
        )
    };
    let far = parse(text("origin_m 500000.125 -6e6 7").as_bytes(), false).unwrap();
    assert_eq!(far[0][1], DVec3::new(500_001.125, -6e6, 7.0));
    assert!(parse(text("up_axis z").as_bytes(), false).is_ok());
    let wrong = parse(text("up_axis -y").as_bytes(), false).unwrap_err();
    assert!(wrong.contains("its -y points up"), "{wrong}");
    assert!(parse(text("origin_m 1 2").as_bytes(), false).is_err());
    let obj = b"# up_axis y\nv 0 0 0\nv 1 0 0\nv 1 2 0\nf 1 2 3\n";
    let wrong = parse(obj, true).unwrap_err();
    assert!(wrong.contains("its y points up"), "{wrong}");
}
