//! What `--record` keeps is what came, byte for byte.

use std::fs;
use std::time::Duration;

use echosplat_recording::mcap::{Ending, RecordedItem, RecordingReader, Topic};

use crate::dive::{file, replay};
use crate::harness::Program;

const LONG: Duration = Duration::from_secs(120);

#[test]
fn a_recording_holds_the_bytes_the_poses_and_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let directory = folder.path().display().to_string();
    Program::echosplat(&replay(&["--no-publish", "--record", &directory])).wait_exit_code(0, LONG);
    let files: Vec<_> = fs::read_dir(folder.path()).unwrap().flatten().collect();
    assert_eq!(files.len(), 1, "{files:?}");

    let mut reader = RecordingReader::new(fs::File::open(files[0].path()).unwrap()).unwrap();
    let (mut raw, mut poses, mut settings) = (Vec::new(), 0, String::new());
    while let Some(message) = reader.next_message().unwrap() {
        match message.item {
            RecordedItem::Pose(_) => poses += 1,
            RecordedItem::Bytes(Topic::Raw, bytes) => raw.extend(bytes),
            RecordedItem::Bytes(Topic::Settings, bytes) => {
                settings = String::from_utf8(bytes).unwrap();
            }
            RecordedItem::Bytes(..) => {}
        }
    }
    assert_eq!(reader.ending(), Some(Ending::Complete));
    assert!(raw == fs::read(file("dive.svlog")).unwrap(), "raw bytes");
    let lines = fs::read_to_string(file("dive.tum")).unwrap();
    let expected = lines.lines().filter(|line| !line.starts_with('#')).count();
    assert_eq!(poses, expected);
    assert!(settings.contains("[session]"), "{settings}");
}
