//! Which pings a recording holds.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use echosplat_firmware_protocol::{Decoder, Event, Message};
use echosplat_recording::mcap::{Record, RecordingReader};

/// The recordings in a folder, in the order in which they were made.
///
/// # Errors
/// If there is none.
pub(super) fn files(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = folder
        .read_dir()
        .with_context(|| format!("no recordings in {}", folder.display()))?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut files: Vec<PathBuf> = paths
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "mcap")
        })
        .collect();
    ensure!(!files.is_empty(), "no recording in {}", folder.display());
    files.sort();
    Ok(files)
}

/// Numbers of the pings in the recordings of a folder, of one run of the device.
///
/// # Errors
/// If one of them cannot be read.
pub(super) fn recorded_pings(folder: &Path) -> anyhow::Result<HashSet<u32>> {
    let mut numbers = HashSet::new();
    let mut decoder = Box::new(Decoder::new());
    let mut reader = RecordingReader::open(&files(folder)?)?;
    while let Some(recorded) = reader.next_message()? {
        let Record::Raw(bytes) = recorded.record else {
            continue;
        };
        decoder.feed(&bytes, &mut |event| {
            let Event::Frame(frame) = event else { return };
            if let Ok(Message::OsMonoProfile(profile)) = Message::parse(&frame) {
                numbers.insert(profile.ping_number);
            }
        });
    }
    Ok(numbers)
}
