use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicU64;
use std::time::Instant;

use echosplat_driver::{DriverConfig, DriverEvent, ServeOptions, serve, spawn};
use echosplat_recording::mcap::{Recorded, RecordingError, RecordingReader};
use echosplat_simulator::{Dive, DiveKind, NoiseLevel, Scene, SimulatedDevice, SimulatedSonar};

use super::storage::{Sink, Storage};
use super::*;

const SOON: Duration = Duration::from_secs(20);

fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < SOON, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn time(index: i64) -> Timestamp {
    Timestamp::from_nanos(1_700_000_000_000_000_000 + index)
}

fn raw(index: i64) -> Record {
    Record::Raw(bytes_of(index))
}

fn bytes_of(index: i64) -> Bytes {
    Bytes::copy_from_slice(&index.to_le_bytes())
}

fn begun(directory: &Path, config: RecorderConfig, settings: String) -> anyhow::Result<Recorder> {
    let recorder = Recorder::idle(directory, config, settings, None);
    recorder.begin().map(|()| recorder)
}

fn recorder_in(directory: &Path, rotate_bytes: u64) -> Recorder {
    let config = RecorderConfig {
        rotate_bytes,
        format: RecordFormat::Mcap,
        log_clock: LogClock::Host,
    };
    let settings = "[bus]\nframe_id = \"sea\"\n".to_owned();
    begun(directory, config, settings).unwrap()
}

fn files_in(directory: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = fs::read_dir(directory)
        .map(|found| found.flatten().map(|entry| entry.path()).collect())
        .unwrap_or_default();
    files.sort();
    files
}

fn read(files: &[PathBuf]) -> Vec<Recorded> {
    let mut reader = RecordingReader::open(files).unwrap();
    let mut all = Vec::new();
    while let Some(recorded) = reader.next_message().unwrap() {
        all.push(recorded);
    }
    all
}

/// The numbers in the raw records.
fn numbers(all: &[Recorded]) -> Vec<i64> {
    let number = |found: &Recorded| match &found.record {
        Record::Raw(bytes) => Some(i64::from_le_bytes(bytes[..].try_into().unwrap())),
        _ => None,
    };
    all.iter().filter_map(number).collect()
}

#[test]
fn records_come_back_in_order_behind_the_settings() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = recorder_in(folder.path(), u64::MAX);
    let mut tap = recorder.raw_tap();
    tap(time(0), Tapped::Bytes(&bytes_of(0)));
    (1..1000).for_each(|index| recorder.record(time(index), raw(index)));
    recorder.finish();
    let all = read(&files_in(folder.path()));
    assert!(matches!(&all[0].record, Record::Settings(toml) if toml.contains("sea")));
    assert_eq!(numbers(&all), (0..1000).collect::<Vec<_>>());
    let counters = recorder.counters().unwrap();
    assert_eq!((counters.messages, counters.lost_messages), (1000, 0));
    assert_eq!((counters.queued_bytes, counters.failing), (0, false));
    recorder.record(time(0), raw(0));
    assert_eq!(
        recorder.counters().unwrap().lost_messages,
        1,
        "after its end"
    );
}

#[test]
fn large_files_are_followed_by_others_that_read_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = recorder_in(folder.path(), 40_000);
    recorder.record(time(0), Record::StaticTransform(b"tf"[..].into()));
    (0..4000).for_each(|index| recorder.record(time(index), raw(index)));
    recorder.finish();
    let files = files_in(folder.path());
    assert!(files.len() > 3, "{files:?}");
    assert_eq!(recorder.counters().unwrap().files, files.len() as u64);
    assert_eq!(numbers(&read(&files)), (0..4000).collect::<Vec<_>>());
    for file in &files {
        let all = read(std::slice::from_ref(file));
        let kinds: Vec<_> = all.iter().map(|found| &found.record).collect();
        assert!(matches!(kinds[0], Record::Settings(_)));
        assert!(matches!(kinds[1], Record::StaticTransform(_)));
    }
}

#[test]
fn two_services_in_one_folder_do_not_meet() {
    let folder = tempfile::tempdir().unwrap();
    let recorders = [0, 1, 2].map(|_| recorder_in(folder.path(), u64::MAX));
    for (index, recorder) in (0..).zip(&recorders) {
        recorder.record(time(index), raw(index));
        recorder.finish();
    }
    let files = files_in(folder.path());
    assert_eq!(files.len(), 3, "{files:?}");
    let mut found: Vec<_> = files
        .iter()
        .flat_map(|file| numbers(&read(std::slice::from_ref(file))))
        .collect();
    found.sort_unstable();
    assert_eq!(found, [0, 1, 2]);
}

#[test]
fn a_vanished_folder_is_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let directory = folder.path().join("recordings");
    let recorder = recorder_in(&directory, u64::MAX);
    recorder.record(time(0), raw(0));
    wait_until("written", || recorder.counters().unwrap().messages == 1);
    fs::remove_dir_all(&directory).unwrap();
    wait_until("a new file", || !files_in(&directory).is_empty());
    wait_until("no fault", || recorder.fault().is_none());
    recorder.record(time(1), raw(1));
    recorder.finish();
    assert_eq!(numbers(&read(&files_in(&directory))), [1]);
    assert_eq!(recorder.counters().unwrap().files, 2);
}

#[test]
fn a_folder_that_cannot_be_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, b"").unwrap();
    let config = RecorderConfig {
        rotate_bytes: 1 << 30,
        format: RecordFormat::Both,
        log_clock: LogClock::Host,
    };
    let error = begun(&file, config, String::new()).err().unwrap();
    assert!(error.to_string().starts_with("--record"), "{error}");
}

/// A disk whose state the test sets, and what reached it.
#[derive(Clone, Default)]
struct Disk(Arc<Mutex<DiskState>>);

#[derive(Default)]
struct DiskState {
    refuses: Option<ErrorKind>,
    written: Vec<Record>,
    files: u32,
}

struct DiskFile {
    disk: Disk,
    number: u32,
    pending: Option<Record>,
}

impl Disk {
    fn set(&self, refuses: Option<ErrorKind>) {
        self.0.lock().unwrap().refuses = refuses;
    }

    fn recorder(&self) -> Recorder {
        self.recorder_beside(room::look)
    }

    /// One that finds so much room.
    fn recorder_beside(&self, look: room::Look) -> Recorder {
        let config = RecorderConfig {
            rotate_bytes: u64::MAX,
            format: RecordFormat::Mcap,
            log_clock: LogClock::Host,
        };
        let recorder = Recorder::idle(Path::new(""), config, String::new(), None);
        let storage = Box::new(self.clone());
        let room = Watch::new(recorder.plan.room.clone(), look);
        let running = Running::start(storage, u64::MAX, String::new(), room).unwrap();
        *recorder.running.write().unwrap() = Some(running);
        recorder
    }

    fn numbers(&self) -> Vec<i64> {
        let written = self.0.lock().unwrap().written.clone();
        let all = written.into_iter().map(|record| Recorded {
            host_time: time(0),
            record,
        });
        numbers(&all.collect::<Vec<_>>())
    }
}

impl Storage for Disk {
    fn begin(&mut self) -> Result<Vec<Box<dyn Sink>>, RecordingError> {
        let mut state = self.0.lock().unwrap();
        if let Some(ErrorKind::StorageFull) = state.refuses {
            return Err(std::io::Error::from(ErrorKind::StorageFull).into());
        }
        // Any other failure is of one file; the next one can be written.
        state.refuses = None;
        state.files += 1;
        Ok(vec![Box::new(DiskFile {
            disk: self.clone(),
            number: state.files,
            pending: None,
        })])
    }
}

impl Sink for DiskFile {
    fn write(&mut self, _: Timestamp, record: &Record) -> Result<(), RecordingError> {
        self.pending = Some(record.clone());
        self.catch_up()
    }

    fn catch_up(&mut self) -> Result<(), RecordingError> {
        let mut state = self.disk.0.lock().unwrap();
        if let Some(kind) = state.refuses {
            return Err(std::io::Error::from(kind).into());
        }
        assert_eq!(self.number, state.files, "an abandoned file is not written");
        state.written.extend(self.pending.take());
        Ok(())
    }

    fn byte_count(&mut self) -> u64 {
        0
    }

    fn path(&self) -> &Path {
        Path::new("disk/a.mcap")
    }

    fn handle(&self) -> std::io::Result<Option<File>> {
        Ok(None)
    }

    fn close(mut self: Box<Self>) -> Result<(), RecordingError> {
        self.catch_up()
    }
}

#[test]
fn a_disk_full_for_a_while_loses_nothing_and_is_told() {
    let disk = Disk::default();
    let recorder = disk.recorder();
    recorder.record(time(0), raw(0));
    wait_until("written", || recorder.counters().unwrap().messages == 1);
    disk.set(Some(ErrorKind::StorageFull));
    (1..100).for_each(|index| recorder.record(time(index), raw(index)));
    wait_until("a fault", || recorder.fault().is_some());
    let fault = recorder.fault().unwrap();
    assert!(
        fault.starts_with("disk full") && fault.contains("disk/a.mcap"),
        "{fault}"
    );
    assert!(recorder.counters().unwrap().failing && recorder.counters().unwrap().queued_bytes > 0);
    disk.set(None);
    wait_until("all written", || {
        recorder.counters().unwrap().messages == 100
    });
    wait_until("no fault", || recorder.fault().is_none());
    recorder.finish();
    assert_eq!(disk.numbers(), (0..100).collect::<Vec<_>>());
    assert_eq!(recorder.counters().unwrap().lost_messages, 0);
}

#[test]
fn a_disk_that_is_nearly_full_is_left_to_the_map() {
    static FREE_BYTES: AtomicU64 = AtomicU64::new(1 << 30);
    let disk = Disk::default();
    let recorder = disk.recorder_beside(|_| {
        Some(room::Disk {
            device: 1,
            size_bytes: 1 << 30,
            free_bytes: FREE_BYTES.load(Ordering::Relaxed),
        })
    });
    recorder.keep_room(Path::new("map.ply"), 50_000_000);
    let count = |recorder: &Recorder| recorder.counters().unwrap().messages;
    recorder.record(time(0), raw(0));
    wait_until("written", || count(&recorder) == 1);
    FREE_BYTES.store(90_000_000, Ordering::Relaxed);
    // It is looked again how much is free.
    let mut index = 0;
    wait_until("a fault", || {
        index += 1;
        recorder.record(time(index), raw(index));
        recorder.fault().is_some()
    });
    let fault = recorder.fault().unwrap();
    for words in ["nearly full", "90.0 MB", "100.0 MB", "disk/a.mcap"] {
        assert!(fault.contains(words), "{fault}");
    }
    let written = count(&recorder);
    // The one before may be at hand, and wait outside the queue.
    recorder.record(time(index + 1), raw(index + 1));
    assert!(recorder.counters().unwrap().queued_bytes > 0);
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(count(&recorder), written, "the map's room is not taken");
    // Either there is room again, or the map is written.
    recorder.release_room();
    recorder.finish();
    assert_eq!(disk.numbers(), (0..=index + 1).collect::<Vec<_>>());
    assert_eq!(recorder.counters().unwrap().lost_messages, 0);
    assert_eq!(recorder.fault(), None);
}

#[test]
fn a_file_that_cannot_be_written_any_more_is_followed_by_another() {
    let disk = Disk::default();
    let recorder = disk.recorder();
    disk.set(Some(ErrorKind::FileTooLarge));
    (0..10).for_each(|index| recorder.record(time(index), raw(index)));
    wait_until("all written", || {
        recorder.counters().unwrap().messages == 10
    });
    recorder.finish();
    assert_eq!(disk.numbers(), (0..10).collect::<Vec<_>>());
    assert_eq!(recorder.counters().unwrap().files, 2);
}

#[test]
fn what_the_driver_shows_is_written_without_a_copy() {
    let disk = Disk::default();
    let recorder = disk.recorder();
    let shown = Bytes::from(vec![7; MAX_RAW_BYTES + 100]);
    recorder.raw_tap()(time(0), Tapped::Bytes(&shown));
    recorder.finish();
    let written = disk.0.lock().unwrap().written.clone();
    let places: Vec<_> = written.iter().filter_map(place_of).collect();
    let (first, rest) = shown.split_at(MAX_RAW_BYTES);
    let expected = [first, rest].map(|piece| (piece.as_ptr(), piece.len()));
    assert_eq!(places, expected);
}

#[test]
fn what_a_link_reads_is_recorded_where_it_was_read() {
    let scene = Arc::new(Scene::named("fence").unwrap());
    let noise = NoiseLevel::None;
    let dive = Arc::new(Dive::plan(DiveKind::Survey, &scene, noise, 1).unwrap());
    let sonar = Arc::new(SimulatedSonar::new(scene, dive, noise, 1));
    let device = Box::new(SimulatedDevice::new(sonar));
    let listen = "tcp://127.0.0.1:0".parse().unwrap();
    let server = serve(&listen, device, ServeOptions::default()).unwrap();
    let disk = Disk::default();
    let recorder = disk.recorder();
    // What the tap is shown is what the decoder is given next.
    let shown = Arc::new(Mutex::new(Vec::new()));
    let (mut records, given) = (recorder.raw_tap(), Arc::clone(&shown));
    let tap = Box::new(move |at: Timestamp, tapped: Tapped<'_>| {
        if let Tapped::Bytes(bytes) = tapped {
            // Kept, so that no other bytes can come to lie there.
            given.lock().unwrap().push(bytes.clone());
        }
        records(at, tapped);
    });
    let (sender, events) = crossbeam_channel::bounded(64);
    let config = DriverConfig::new(server.url().parse().unwrap());
    let runtime = crate::runtime::handle().unwrap();
    let driver = spawn(&runtime, config, Some(tap), sender).unwrap();
    let pings = std::iter::from_fn(|| events.recv_timeout(SOON).ok())
        .filter(|event| matches!(event, DriverEvent::Ping { .. }));
    assert_eq!(pings.take(20).count(), 20);
    let _ = driver.stop();
    recorder.finish();
    let written = disk.0.lock().unwrap().written.clone();
    let places: Vec<_> = written.iter().filter_map(place_of).collect();
    let shown = shown.lock().unwrap();
    let expected: Vec<_> = shown.iter().map(|b| (b.as_ptr(), b.len())).collect();
    // How many reads 20 pings take is the system's choice.
    let bytes: usize = shown.iter().map(Bytes::len).sum();
    assert!(bytes >= 20 * 1_200, "{bytes}");
    assert_eq!(places, expected);
    let _ = server.stop();
}

/// Where the raw bytes of a record lie.
fn place_of(record: &Record) -> Option<(*const u8, usize)> {
    match record {
        Record::Raw(bytes) => Some((bytes.as_ptr(), bytes.len())),
        _ => None,
    }
}

#[test]
fn what_finds_no_room_is_counted_and_the_end_is_bounded() {
    let disk = Disk::default();
    let recorder = disk.recorder();
    disk.set(Some(ErrorKind::StorageFull));
    let bytes = Bytes::from(vec![0; 1 << 19]);
    let began = Instant::now();
    for index in 0..200 {
        recorder.record(time(index), Record::Raw(bytes.clone()));
    }
    let counters = recorder.counters().unwrap();
    assert!(counters.queued_bytes <= queue::MAX_QUEUED_BYTES as u64);
    assert!((70..=74).contains(&counters.lost_messages), "{counters:?}");
    recorder.finish();
    assert!(began.elapsed() < SOON);
    assert_eq!(recorder.counters().unwrap().lost_messages, 200);
    assert_eq!(recorder.counters().unwrap().queued_bytes, 0);
}

/// Records until it is killed, if the test below says where; else there is nothing to do.
#[test]
fn records_for_ever() {
    let Ok(directory) = std::env::var("RECORDER_TEST_DIRECTORY") else {
        return;
    };
    let recorder = recorder_in(Path::new(&directory), 200_000);
    for index in 0.. {
        recorder.record(time(index), raw(index));
        if index % 64 == 0 {
            std::thread::sleep(Duration::from_micros(200));
        }
    }
}

#[test]
fn a_killed_process_leaves_all_it_had_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut most = 0;
    for kill in 0_u64..10 {
        let directory = folder.path().join(kill.to_string());
        let mut child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "recorder::tests::records_for_ever"])
            .env("RECORDER_TEST_DIRECTORY", &directory)
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        wait_until("a file", || !files_in(&directory).is_empty());
        std::thread::sleep(Duration::from_millis(3 + kill * 7919 % 60));
        child.kill().unwrap();
        child.wait().unwrap();
        let mut files = files_in(&directory);
        // One that was begun and has not even its head is a recording of nothing.
        files.retain(|file| fs::metadata(file).is_ok_and(|found| found.len() > 0));
        let found = numbers(&read(&files));
        most = most.max(found.len());
        assert_eq!(
            found,
            (0..found.len() as i64).collect::<Vec<_>>(),
            "kill {kill}"
        );
    }
    assert!(most > 100, "{most} records before a kill");
}

#[test]
fn a_recording_begun_in_mid_dive_says_that_the_link_is_up() {
    let folder = tempfile::tempdir().unwrap();
    let config = RecorderConfig {
        rotate_bytes: u64::MAX,
        format: RecordFormat::Mcap,
        log_clock: LogClock::Host,
    };
    let recorder = Recorder::idle(folder.path(), config, String::new(), None);
    let mut tap = recorder.raw_tap();
    tap(time(0), Tapped::LinkUp);
    tap(time(1), Tapped::Bytes(&bytes_of(7)));
    assert!(!recorder.end() && files_in(folder.path()).is_empty());
    recorder.begin().unwrap();
    assert!(recorder.begin().is_err(), "one goes on");
    tap(time(2), Tapped::Bytes(&bytes_of(8)));
    assert!(recorder.end() && !recorder.is_running());
    tap(time(3), Tapped::Bytes(&bytes_of(9)));
    recorder.begin().unwrap();
    recorder.finish();

    let files = files_in(folder.path());
    assert_eq!(files.len(), 2, "{files:?}");
    let first = read(&files[..1]);
    assert_eq!(numbers(&first), [8]);
    let is_up = |found: &Recorded| matches!(found.record, Record::LinkUp);
    assert!(first.iter().any(is_up));
}
