use std::cell::Cell;
use std::io::{self, Cursor, Read, Seek, SeekFrom, Write};
use std::rc::Rc;
use std::sync::Arc;

use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, PoseCovariance, StampedPose, Timestamp};
use proptest::prelude::*;
use serde_json::json;

use super::*;

mod chunks;
mod damage;
mod joined;
mod rewritten;

fn time(index: usize) -> Timestamp {
    Timestamp::from_nanos(1_700_000_000_000_000_000 + index as i64 * 170_000_001)
}

fn raw(index: usize) -> Record {
    Record::Raw((0..40 + index).map(|i| (i * 7 + index) as u8).collect())
}

fn writer() -> RecordingWriter<Cursor<Vec<u8>>> {
    RecordingWriter::new(Cursor::new(Vec::new()), "map", Profile::Full).unwrap()
}

/// One of each kind.
fn all_kinds() -> Vec<Record> {
    vec![
        Record::Settings("[sonar]\nurl = \"x\"".to_owned()),
        Record::StaticTransform(Arc::from(&b"\0\x01\0\0tf"[..])),
        Record::LinkUp,
        raw(1),
        Record::Pose(pose()),
        Record::HalfFrameExpired,
        Record::Event(json!({"event": "shed", "count": 3})),
        Record::Status(json!({"rate": 0.1})),
        Record::Delta {
            cloud: Arc::from(&b"\0\x01\0\0cloud"[..]),
            info: Arc::from(&b"{\"sequence\":1}"[..]),
        },
        Record::LinkDown,
    ]
}

fn pose() -> StampedPose {
    StampedPose {
        time: time(0),
        world_from_vehicle: Pose {
            rotation: DQuat::from_rotation_z(0.1) * DQuat::from_rotation_x(1.0 / 3.0),
            translation_m: DVec3::new(1.0 / 3.0, 1e6 + 0.1, f64::MIN_POSITIVE),
        },
        uncertainty: Some(PoseCovariance::alike(0.1, 0.2)),
        epoch: 3,
    }
}

/// A recording of `count` raw messages; with the offset at which each was complete.
fn recording(count: usize) -> (Vec<u8>, Vec<usize>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut file = RecordingFile::create(&path, "map", Profile::Full).unwrap();
    let mut ends = Vec::new();
    for index in 0..count {
        file.writer().write(time(index), &raw(index)).unwrap();
        ends.push(std::fs::metadata(&path).unwrap().len() as usize);
    }
    file.finish().unwrap();
    (std::fs::read(&path).unwrap(), ends)
}

fn read_all(bytes: &[u8]) -> (Vec<Recorded>, RecordingReader<'_>) {
    let mut reader = RecordingReader::new(bytes).unwrap();
    let mut all = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        all.push(message);
    }
    (all, reader)
}

/// Where the end of the data is told: what stands behind it is a summary that nobody needs.
fn data_end(bytes: &[u8]) -> usize {
    let record = [mcap::records::op::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];
    bytes.windows(9).rposition(|w| w == record).unwrap()
}

fn is_raw(message: &Recorded, index: usize) -> bool {
    message.host_time == time(index) && message.record == raw(index)
}

#[test]
fn everything_comes_back_in_order_and_to_the_last_bit() {
    let mut writer = writer();
    let records = all_kinds();
    for (index, record) in records.iter().enumerate() {
        writer.write(time(index), record).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    let (mut all, reader) = read_all(&bytes);
    // Before the first pose its epoch is said.
    let event = all.remove(4);
    let said = json!({"event": "pose_epoch", "epoch": 3});
    assert_eq!(event.record, Record::Event(said));
    let expected = records.into_iter().enumerate();
    let expected: Vec<_> = expected
        .map(|(index, record)| Recorded {
            host_time: time(index),
            record,
        })
        .collect();
    assert_eq!(all, expected);
    assert_eq!(reader.ending(), Some(Ending::Complete));
    assert_eq!(
        (reader.damaged_byte_count(), reader.undecodable_count()),
        (0, 0)
    );
}

#[test]
fn epochs_and_times_that_ros_cannot_say_come_back() {
    let mut sent = Vec::new();
    let mut writer = writer();
    for (epoch, nanos) in [
        (0, 5),
        (0, -7),
        (u32::MAX, i64::MAX),
        (2, 4_000_000_000_000_000_000),
    ] {
        let pose = StampedPose {
            time: Timestamp::from_nanos(nanos),
            epoch,
            uncertainty: None,
            ..pose()
        };
        writer.write(time(0), &Record::Pose(pose)).unwrap();
        sent.push(pose);
    }
    let bytes = writer.finish().unwrap().into_inner();
    let found = Recording::scan_of(RecordingReader::new(&bytes[..]).unwrap()).unwrap();
    let poses: Vec<_> = found.poses.iter().map(|(pose, _)| *pose).collect();
    assert_eq!(poses, sent);
    assert_eq!(found.counts.events, 3);
}

#[test]
fn the_librarys_own_reader_finds_a_sound_file() {
    let (bytes, _) = recording(5);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 5);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(summary.channels.values().all(|c| c.schema.is_some()));
    let topics: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap().channel.topic.clone())
        .collect();
    assert_eq!(topics, ["/sonar/raw"; 5]);
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
    for cut in places_in(&bytes, &ends) {
        let (all, reader) = read_all(&bytes[..cut]);
        let whole = ends.iter().filter(|&&end| end <= cut).count();
        assert_eq!(all.len(), whole, "cut at {cut}");
        assert!(all.iter().enumerate().all(|(i, m)| is_raw(m, i)));
        assert!(reader.ending().is_some());
    }
}

/// Every byte of the messages, and some of the schemas before and the summary behind them.
fn places_in(bytes: &[u8], ends: &[usize]) -> Vec<usize> {
    let messages = ends[0] - 80..ends[ends.len() - 1] + 20;
    (0..bytes.len())
        .filter(|at| *at < 100 || messages.contains(at) || at % 37 == 0)
        .collect()
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
    let (bytes, ends) = recording(6);
    for at in places_in(&bytes, &ends) {
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
}

#[test]
fn what_is_too_long_is_refused_and_counted() {
    let mut writer = writer();
    let long: Arc<[u8]> = vec![7; MAX_MESSAGE_BYTES + 5].into();
    let result = writer.write(time(0), &Record::StaticTransform(long));
    assert!(matches!(result, Err(RecordingError::TooLong { .. })));
    assert_eq!(writer.lost_message_count(), 1);
    let most = Record::Raw(vec![7; MAX_MESSAGE_BYTES - 8].into());
    writer.write(time(1), &most).unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    assert_eq!(read_all(&bytes).0[0].record, most);
}

#[test]
fn bytes_that_look_like_a_recording_are_bytes() {
    let (inner, _) = recording(3);
    let record = Record::Raw(inner.into());
    let mut writer = writer();
    for index in 0..3 {
        writer.write(time(index), &record).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    let (all, reader) = read_all(&bytes);
    assert_eq!(all.len(), 3);
    assert!(all.iter().all(|found| found.record == record));
    assert_eq!(reader.damaged_byte_count(), 0);
}

#[test]
fn files_of_a_dive_read_as_one_and_the_bad_one_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for (name, range) in [("1.mcap", 0..2), ("2.mcap", 2..5)] {
        let mut file = RecordingFile::create(&path(name), "map", Profile::Full).unwrap();
        for index in range {
            file.writer().write(time(index), &raw(index)).unwrap();
        }
        file.finish().unwrap();
    }
    let (bytes, ends) = recording(2);
    std::fs::write(path("cut.mcap"), &bytes[..ends[1]]).unwrap();
    let scan = Recording::scan(&[path("1.mcap"), path("2.mcap")]).unwrap();
    assert_eq!((scan.counts.raw, scan.is_cut), (5, false));
    assert_eq!(scan.span, Some((time(0), time(4))));
    let scan = Recording::scan(&[path("cut.mcap"), path("2.mcap")]).unwrap();
    assert_eq!((scan.counts.raw, scan.is_cut), (5, true));
    let error = Recording::scan(&[path("1.mcap"), path("none.mcap")]).unwrap_err();
    assert!(error.to_string().contains("none.mcap"), "{error}");
    let error = Recording::scan(&[folder.path()]).unwrap_err();
    assert!(error.to_string().contains("not a regular file"), "{error}");
    assert!(Recording::scan::<&str>(&[]).is_err());
}

#[test]
fn a_delta_without_its_other_half_is_counted() {
    let delta = |index: u8| Record::Delta {
        cloud: vec![index; 9].into(),
        info: format!("{{\"sequence\":{index}}}").into_bytes().into(),
    };
    let mut writer = writer();
    for index in 0..3 {
        writer.write(time(0), &delta(index)).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    // The channel of the first info becomes one that nobody knows.
    let at = bytes
        .windows(11)
        .position(|w| w == b"{\"sequence\"")
        .unwrap()
        - 22;
    let mut damaged = bytes.clone();
    damaged[at] = 200;
    let (all, _) = read_all(&damaged);
    let found: Vec<_> = all.into_iter().map(|found| found.record).collect();
    assert_eq!(found, [delta(1), delta(2)]);
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
    let free = Rc::new(Cell::new(9000));
    let disk = SmallDisk {
        bytes: Cursor::new(Vec::new()),
        free: free.clone(),
    };
    let mut writer = RecordingWriter::new(disk, "map", Profile::Full).unwrap();
    let refused = (0..100).filter(|&i| writer.write(time(i), &raw(i)).is_err());
    let refused = refused.count() as u64;
    assert!(refused > 5);
    // The first one refused waits in the buffer.
    assert_eq!(writer.lost_message_count(), refused - 1);
    free.set(usize::MAX);
    writer.write(time(99), &raw(99)).unwrap();
    let bytes = writer.finish().unwrap().bytes.into_inner();
    let (all, reader) = read_all(&bytes);
    assert_eq!(all.len() as u64, 101 - (refused - 1));
    assert!(is_raw(all.last().unwrap(), 99));
    assert_eq!(reader.damaged_byte_count(), 0);
}

#[test]
fn an_abandoned_recording_takes_nothing_more() {
    let free = Rc::new(Cell::new(usize::MAX));
    let taken = Rc::new(Cell::new(0));
    struct Counting(SmallDisk, Rc<Cell<usize>>);
    impl Write for Counting {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let count = self.0.write(bytes)?;
            self.1.set(self.1.get() + count);
            Ok(count)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    impl Seek for Counting {
        fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
            self.0.seek(position)
        }
    }
    let disk = SmallDisk {
        bytes: Cursor::new(Vec::new()),
        free: free.clone(),
    };
    let mut writer =
        RecordingWriter::new(Counting(disk, taken.clone()), "map", Profile::Full).unwrap();
    free.set(0);
    assert!(writer.write(time(0), &raw(0)).is_err());
    let before = taken.get();
    free.set(usize::MAX);
    drop(writer);
    assert_eq!(taken.get(), before);
}

#[test]
fn a_recording_is_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    RecordingFile::create(&path, "map", Profile::Full)
        .unwrap()
        .finish()
        .unwrap();
    assert!(RecordingFile::create(&path, "map", Profile::Full).is_err());
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
