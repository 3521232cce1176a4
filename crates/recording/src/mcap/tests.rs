use std::cell::Cell;
use std::io::{self, Cursor, Read, Seek, SeekFrom, Write};
use std::rc::Rc;

use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, PoseUncertainty, StampedPose, Timestamp};
use proptest::prelude::*;

use super::*;

fn time(index: usize) -> Timestamp {
    Timestamp::from_nanos(1_700_000_000_000_000_000 + index as i64 * 17_000_001)
}

fn raw(index: usize) -> Vec<u8> {
    (0..40 + index).map(|i| (i * 7 + index) as u8).collect()
}

fn pose() -> StampedPose {
    StampedPose {
        time: time(0),
        world_from_vehicle: Pose {
            rotation: DQuat::from_rotation_z(0.1) * DQuat::from_rotation_x(1.0 / 3.0),
            translation_m: DVec3::new(1.0 / 3.0, 1e6 + 0.1, f64::MIN_POSITIVE),
        },
        uncertainty: Some(PoseUncertainty {
            position_m: 0.1,
            attitude_rad: 0.2,
        }),
        epoch: 3,
    }
}

/// A recording of `count` raw messages; with the offset at which each was complete.
fn recording(count: usize) -> (Vec<u8>, Vec<usize>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut file = RecordingFile::create(&path).unwrap();
    let mut ends = Vec::new();
    for index in 0..count {
        file.writer().write_raw(time(index), &raw(index)).unwrap();
        ends.push(std::fs::metadata(&path).unwrap().len() as usize);
    }
    file.sync().unwrap();
    file.finish().unwrap();
    (std::fs::read(&path).unwrap(), ends)
}

fn read_all(bytes: &[u8]) -> (Vec<Recorded>, RecordingReader<&[u8]>) {
    let mut reader = RecordingReader::new(bytes).unwrap();
    let mut all = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        all.push(message);
    }
    (all, reader)
}

fn is_raw(message: &Recorded, index: usize) -> bool {
    let item = RecordedItem::Bytes(Topic::Raw, raw(index));
    message.time == time(index) && message.item == item
}

#[test]
fn everything_comes_back_in_order_and_to_the_last_bit() {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new())).unwrap();
    writer.write_pose(time(0), &pose()).unwrap();
    writer.write_raw(time(1), &raw(1)).unwrap();
    writer.write(Topic::Event, time(2), b"{}").unwrap();
    writer.write(Topic::Settings, time(3), b"").unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    let (all, reader) = read_all(&bytes);
    assert_eq!(all.len(), 4);
    assert_eq!(all[0].item, RecordedItem::Pose(pose()));
    assert!(is_raw(&all[1], 1));
    assert_eq!(all[3].item, RecordedItem::Bytes(Topic::Settings, vec![]));
    assert_eq!(reader.ending(), Some(Ending::Complete));
    assert_eq!(reader.damaged_byte_count(), 0);
}

#[test]
fn the_librarys_own_reader_finds_a_sound_file() {
    let (bytes, _) = recording(5);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 5);
    let topics: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap().channel.topic.clone())
        .collect();
    assert_eq!(topics, ["sonar/raw"; 5]);
}

#[test]
fn a_message_is_with_the_operating_system_when_its_call_returns() {
    let (bytes, ends) = recording(5);
    for (index, &end) in ends.iter().enumerate() {
        let (all, reader) = read_all(&bytes[..end]);
        assert_eq!(all.len(), index + 1);
        assert_eq!(reader.ending(), Some(Ending::Cut));
    }
}

#[test]
fn cut_at_any_byte_it_reads_up_to_the_cut() {
    let (bytes, ends) = recording(6);
    for cut in 0..=bytes.len() {
        let (all, reader) = read_all(&bytes[..cut]);
        let whole = ends.iter().filter(|&&end| end <= cut).count();
        assert_eq!(all.len(), whole, "cut at {cut}");
        assert!(all.iter().enumerate().all(|(i, m)| is_raw(m, i)));
        assert!(reader.ending().is_some());
    }
}

/// Gives a few bytes at a time.
struct Drip<'a>(&'a [u8]);

impl Read for Drip<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let few = bytes.len().min(7);
        self.0.read(&mut bytes[..few])
    }
}

#[test]
fn any_flipped_byte_costs_at_most_one_message() {
    let (bytes, _) = recording(6);
    for at in 0..bytes.len() {
        for flip in [0x01, 0x03, 0x80, 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] ^= flip;
            let Ok(mut reader) = RecordingReader::new(Drip(&damaged)) else {
                panic!("refused for byte {at}");
            };
            let mut sound = 0;
            while let Some(message) = reader.next_message().unwrap() {
                sound += usize::from((0..6).any(|i| is_raw(&message, i)));
            }
            assert!(sound >= 5, "byte {at} ^ {flip:02x}: {sound} of 6");
        }
    }
}

#[test]
fn other_files_are_named() {
    let error = |bytes: &[u8]| RecordingReader::new(bytes).err().unwrap().to_string();
    assert!(error(b"# a trajectory").contains("starts with `# a traj`"));
    assert!(error(b"BR\x02\x00\x06\x00\x00\x00").contains("42 52 02"));
    let chunked = {
        let mut writer = mcap::WriteOptions::new()
            .compression(None)
            .create(Cursor::new(Vec::new()))
            .unwrap();
        let channel = writer
            .add_channel(0, "a", "b", &Default::default())
            .unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time: 0,
            publish_time: 0,
        };
        writer.write_to_known_channel(&header, b"x").unwrap();
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    };
    let result = RecordingReader::new(&chunked[..]).unwrap().next_message();
    assert!(matches!(result, Err(RecordingError::Chunked)));
}

#[test]
fn long_bytes_are_split_and_long_messages_refused() {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new())).unwrap();
    let long = vec![7; MAX_MESSAGE_BYTES + 5];
    writer.write_raw(time(0), &long).unwrap();
    assert!(writer.write(Topic::Delta, time(0), &long).is_err());
    assert_eq!(writer.lost_message_count(), 1);
    let bytes = writer.finish().unwrap().into_inner();
    let (all, _) = read_all(&bytes);
    let lengths: Vec<_> = all
        .iter()
        .map(|message| match &message.item {
            RecordedItem::Bytes(_, bytes) => bytes.len(),
            RecordedItem::Pose(_) => 0,
        })
        .collect();
    assert_eq!(lengths, [MAX_MESSAGE_BYTES, 5]);
}

/// A disk with so many bytes left.
struct SmallDisk {
    bytes: Cursor<Vec<u8>>,
    free: Rc<Cell<usize>>,
}

impl Write for SmallDisk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = bytes.len().min(self.free.get());
        if count == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.free.set(self.free.get() - count);
        self.bytes.write(&bytes[..count])
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for SmallDisk {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.bytes.seek(position)
    }
}

#[test]
fn a_full_disk_costs_only_what_came_while_it_was_full() {
    let free = Rc::new(Cell::new(1000));
    let disk = SmallDisk {
        bytes: Cursor::new(Vec::new()),
        free: free.clone(),
    };
    let mut writer = RecordingWriter::new(disk).unwrap();
    let refused = (0..30).filter(|&i| writer.write_raw(time(i), &raw(i)).is_err());
    let refused = refused.count() as u64;
    assert!(refused > 5);
    // The first one refused waits in the buffer.
    assert_eq!(writer.lost_message_count(), refused - 1);
    free.set(usize::MAX);
    writer.write_raw(time(99), &raw(99)).unwrap();
    let bytes = writer.finish().unwrap().bytes.into_inner();
    let (all, reader) = read_all(&bytes);
    assert_eq!(all.len() as u64, 31 - (refused - 1));
    assert!(is_raw(all.last().unwrap(), 99));
    assert_eq!(reader.damaged_byte_count(), 0);
}

#[test]
fn a_recording_is_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    RecordingFile::create(&path).unwrap().finish().unwrap();
    assert!(RecordingFile::create(&path).is_err());
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(junk in proptest::collection::vec(any::<u8>(), 0..400)) {
        for start in [&b""[..], mcap::MAGIC] {
            let bytes = [start, &junk].concat();
            if let Ok(mut reader) = RecordingReader::new(&bytes[..]) {
                while let Ok(Some(_)) = reader.next_message() {}
            }
        }
    }
}
