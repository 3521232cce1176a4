//! Damage of many kinds: nothing is lost that stands there, and nothing is lost without a word.

use super::*;

/// Of the 60 pieces of bytes, those that came back; and what was told.
fn read(bytes: &[u8]) -> (usize, Vec<String>) {
    let (all, reader) = read_all(bytes);
    let came = (0..60).filter(|&i| all.iter().any(|found| is_raw(found, i)));
    (came.count(), reader.losses(false))
}

/// Sixty pieces of bytes with poses and a large map between them.
fn dive() -> Vec<u8> {
    let mut writer = writer();
    writer
        .write(time(0), &Record::Settings("[sonar]".to_owned()))
        .unwrap();
    for index in 0..60 {
        writer.write(time(index), &raw(index)).unwrap();
        writer.write(time(index), &Record::Pose(pose())).unwrap();
        if index % 20 == 7 {
            let delta = Record::Delta {
                cloud: vec![0x55; 40_000].into(),
                info: Arc::from(&b"{}"[..]),
            };
            writer.write(time(index), &delta).unwrap();
        }
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn a_hole_of_zeros_anywhere_is_told() {
    let whole = dive();
    let data_end = data_end(&whole);
    for length in [1, 2, 16, 700, 4096, 60_000, 1 << 20] {
        for at in (0..data_end).step_by(1013) {
            let mut bytes = whole.clone();
            let end = bytes.len().min(at + length);
            bytes[at..end].fill(0);
            if bytes == whole {
                continue;
            }
            let Ok(reader) = RecordingReader::new(&bytes[..]) else {
                assert!(at == 0 && length == 1 << 20, "{at} {length}");
                continue;
            };
            drop(reader);
            let (came, losses) = read(&bytes);
            assert!(
                !losses.is_empty() || at < 8,
                "{length} zeros at {at}: {came}"
            );
            // Each piece with its pose takes a kilobyte; a map 40.
            let least = 58_usize.saturating_sub(length / 700 + length.min(1) * 2);
            assert!(came >= least, "{length} zeros at {at}: {came}");
        }
    }
}

#[test]
fn no_byte_of_the_magic_is_needed() {
    let whole = dive();
    for at in 0..8 {
        for value in [0, 0xff, b'M'] {
            for place in [at, whole.len() - 8 + at] {
                let mut bytes = whole.clone();
                bytes[place] = value;
                let (found, reader) = read_all(&bytes);
                let (expected, _) = read_all(&whole);
                assert!(found == expected, "byte {place}");
                assert_eq!(reader.losses(false), [""; 0], "byte {place}");
            }
        }
    }
    let mut bytes = whole.clone();
    bytes[..8].fill(0);
    assert_eq!(read(&bytes).0, 60);
}

#[test]
fn a_flipped_byte_that_no_record_shows_is_told_by_the_checksum() {
    let mut bytes = dive();
    let at = bytes.windows(100).position(|w| w == [0x55; 100]).unwrap();
    bytes[at] = 0x54;
    let (came, losses) = read(&bytes);
    assert_eq!(came, 60);
    assert!(losses[0].contains("checksum"), "{losses:?}");
}

#[test]
fn a_cut_is_told_once_and_as_a_cut() {
    let whole = dive();
    for cut in (1..data_end(&whole)).step_by(997) {
        let (_, losses) = read(&whole[..cut]);
        assert_eq!(losses.len(), 1, "{cut}: {losses:?}");
        assert!(
            losses[0].contains("ends in the middle"),
            "{cut}: {losses:?}"
        );
    }
}
