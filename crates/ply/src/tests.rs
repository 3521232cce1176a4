use proptest::prelude::*;

use super::*;

const SQUARE: &str = "comment a square\nelement empty 18446744073709551615\nelement vertex 3\n\
    property double x\nproperty uchar red\nelement face 1\n\
    property list uchar int vertex_indices\nend_header\n";

/// An element's name, and the numbers of each of its rows.
type Rows = (String, Vec<Vec<f64>>);

fn rows(bytes: &[u8]) -> Result<Vec<Rows>, PlyError> {
    let mut reader = Reader::new(bytes)?;
    let mut all = Vec::new();
    loop {
        let mut rows = Vec::new();
        let found = reader.next_element(|_, number, row| {
            assert_eq!(number as usize, rows.len());
            rows.push((0..2).flat_map(|at| row.list(at).to_vec()).collect());
            Ok::<_, PlyError>(())
        })?;
        match found {
            Some(element) => all.push((element.name.clone(), rows)),
            None => return Ok(all),
        }
    }
}

fn square(format: Format) -> Vec<u8> {
    let mut bytes = format!("ply\nformat {} 1.0\n{SQUARE}", format.name()).into_bytes();
    if format == Format::Text {
        bytes.extend(b"1 255 7 not read\n\n-2.5\r\n0\r\n3e2 1\n3 0 1 2\n");
        return bytes;
    }
    let is_big = format == Format::BigEndian;
    let double = |value: f64| {
        if is_big {
            value.to_be_bytes()
        } else {
            value.to_le_bytes()
        }
    };
    let int = |value: i32| {
        if is_big {
            value.to_be_bytes()
        } else {
            value.to_le_bytes()
        }
    };
    for (x, red) in [(1.0, 255), (-2.5, 0), (300.0, 1)] {
        bytes.extend(double(x));
        bytes.push(red);
    }
    bytes.push(3);
    bytes.extend((0..3).flat_map(int));
    bytes
}

#[test]
fn every_format_gives_the_same_rows() {
    let expected = vec![
        ("empty".to_owned(), vec![]),
        (
            "vertex".to_owned(),
            vec![vec![1.0, 255.0], vec![-2.5, 0.0], vec![300.0, 1.0]],
        ),
        ("face".to_owned(), vec![vec![0.0, 1.0, 2.0]]),
    ];
    for format in [Format::Text, Format::LittleEndian, Format::BigEndian] {
        assert_eq!(rows(&square(format)).unwrap(), expected, "{format:?}");
    }
}

#[test]
fn every_cut_is_an_error_that_says_so() {
    for format in [Format::LittleEndian, Format::BigEndian] {
        let whole = square(format);
        for end in 0..whole.len() {
            assert!(rows(&whole[..end]).is_err(), "cut at {end}");
        }
        let cut = rows(&whole[..whole.len() - 1]).unwrap_err().to_string();
        assert_eq!(
            cut,
            "cut off: the header says 1 of element `face`, 0 are there"
        );
    }
}

#[test]
fn a_claimed_count_is_not_believed() {
    let claims = |count: u64| {
        format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty char x\nend_header\n\x07"
        )
    };
    let error = rows(claims(u64::MAX).as_bytes()).unwrap_err();
    assert!(matches!(error, PlyError::Cut { found: 1, .. }), "{error}");
    let list =
        "ply\nformat ascii 1.0\nelement face 1\nproperty list uint int i\nend_header\n4000000000 1";
    let error = rows(list.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("a list claims 4000000000 items"), "{error}");
}

#[test]
fn headers_and_words_have_most_bytes() {
    let long = format!("ply\nformat ascii 1.0\ncomment {}\n", "x".repeat(70_000));
    assert!(
        rows(long.as_bytes())
            .unwrap_err()
            .to_string()
            .contains("65536")
    );
    let word = format!(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n{}",
        "1".repeat(100_000)
    );
    let error = rows(word.as_bytes()).unwrap_err().to_string();
    assert!(
        error.ends_with("where a number belongs") && error.len() < 120,
        "{error}"
    );
    let many = "property float x\n".repeat(257);
    let many = format!("ply\nformat ascii 1.0\nelement vertex 1\n{many}end_header\n");
    assert!(
        rows(many.as_bytes())
            .unwrap_err()
            .to_string()
            .contains("256 properties")
    );
}

#[test]
fn errors_say_what_was_found_and_what_is_needed() {
    let error = |text: &str| rows(text.as_bytes()).unwrap_err().to_string();
    assert_eq!(error(""), "the file is empty");
    assert_eq!(error("BR"), "not a PLY: starts with `BR`, expected `ply`");
    assert!(error("ply\n").contains("ends before `end_header`"));
    assert!(error("ply\nend_header\n").contains("names no format"));
    assert!(error("ply\nformat ebcdic 1.0\nend_header\n").contains("known are ascii"));
    assert!(error("ply\nproperty float x\n").contains("line `property float x`"));
    let word = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\nfar\n";
    assert_eq!(
        error(word),
        "element `vertex`, row 0: `far` where a number belongs"
    );
}

#[test]
fn what_is_written_is_read_again() {
    let header = Header {
        format: Format::LittleEndian,
        comments: vec!["origin_m 1 2 3".to_owned()],
        elements: vec![
            Element::of_floats("vertex", 1, &["x", "sigma"]),
            Element::of_lists("face", 1, "vertex_indices"),
        ],
    };
    let mut bytes = Vec::new();
    header.write(&mut bytes).unwrap();
    write_floats(&mut bytes, &[1.5, f32::INFINITY]).unwrap();
    write_list(&mut bytes, &[0, 0, 7]).unwrap();
    assert_eq!(Reader::new(&bytes[..]).unwrap().header(), &header);
    let read = rows(&bytes).unwrap();
    assert_eq!(read[0].1, [[1.5, f64::INFINITY]]);
    assert_eq!(read[1].1, [[0.0, 0.0, 7.0]]);
    assert!(write_list(&mut bytes, &[0; 256]).is_err());
    assert!(write_list(&mut bytes, &[u32::MAX]).is_err());
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(at in 0..400usize, value in any::<u8>(), junk in proptest::collection::vec(any::<u8>(), 0..200)) {
        for format in [Format::Text, Format::LittleEndian, Format::BigEndian] {
            let mut bytes = square(format);
            if let Some(byte) = bytes.get_mut(at) {
                *byte = value;
            }
            let _ = rows(&bytes);
        }
        let _ = rows(&junk);
        let _ = rows(&[SQUARE.as_bytes(), &junk].concat());
    }
}
