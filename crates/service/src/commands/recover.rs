//! `echosplat recover FILE`: a clean file of a cut or damaged recording or log.

use std::ffi::OsStr;
use std::fs::{File, OpenOptions};
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use echosplat_firmware_protocol::{Decoder, Event, id};
use echosplat_recording::mcap::{Ending, Profile, Record, RecordingReader, RecordingWriter};
use echosplat_recording::svlog::SvlogReader;

use crate::arguments::RecoverArguments;
use crate::exit::{Finish, Usage};
use crate::kind::Kind;
use crate::logging;

/// # Errors
/// If the file is neither, or the clean one is there already or cannot be written.
pub(crate) fn run(arguments: &RecoverArguments) -> anyhow::Result<Finish> {
    let file = &arguments.file;
    let kind = Kind::of(file)?;
    let salvage: Salvager = match kind {
        Kind::Recording if arguments.ros => |file, out| recording(file, out, Profile::Ros2),
        Kind::Recording => |file, out| recording(file, out, Profile::Full),
        Kind::Log if arguments.ros => {
            return Err(Usage::error(format!(
                "--ros: {} is a log of the sonar's frames, and ROS knows none of them; `replay {} --poses F.tum \
                 --record DIR --record-format ros` makes a recording with poses and map",
                file.display(),
                file.display()
            )));
        }
        Kind::Log => log,
        Kind::Map | Kind::Trajectory => {
            return Err(Usage::error(format!(
                "{}: neither a recording (.mcap) nor a log (.svlog)",
                file.display()
            )));
        }
    };
    let out = arguments.out.clone();
    let out = out.unwrap_or_else(|| beside(file, kind, arguments.ros));
    refuse_other_ending(file, kind, &out)?;
    let created = OpenOptions::new().write(true).create_new(true).open(&out);
    let created = created.map_err(|error| {
        Usage::error(format!("{}: {error}; --out names another", out.display()))
    })?;
    let found = salvage(file, created).inspect_err(|_| {
        // Half a salvage would look like a whole one.
        let _ = std::fs::remove_file(&out);
    })?;
    logging::print(&format!("{}: {}", out.display(), found.words()));
    for loss in &found.losses {
        tracing::warn!("{loss}");
    }
    Ok(match found.is_whole() {
        true => Finish::Done,
        false => Finish::Lossy,
    })
}

/// `a.recovered.mcap` of a recording `a.mcap`, whatever it is called, or `a.ros.mcap`.
fn beside(file: &Path, kind: Kind, ros: bool) -> PathBuf {
    let what = if ros { "ros" } else { "recovered" };
    file.with_extension(format!("{what}.{}", kind.ending()))
}

/// A log under the name of a recording would be read by nobody.
fn refuse_other_ending(file: &Path, kind: Kind, out: &Path) -> anyhow::Result<()> {
    let ending = out.extension().map(OsStr::to_ascii_lowercase);
    let other = [Kind::Recording, Kind::Log, Kind::Trajectory, Kind::Map];
    let mut other = other.into_iter().filter(|other| *other != kind);
    match other.any(|other| ending.as_deref() == Some(other.ending().as_ref())) {
        false => Ok(()),
        true => Err(Usage::error(format!(
            "--out {}: {} is a {}, and so is what can be recovered of it; give a name that ends in .{}",
            out.display(),
            file.display(),
            kind.name(),
            kind.ending()
        ))),
    }
}

/// Makes a clean file of another.
type Salvager = fn(&Path, File) -> anyhow::Result<Salvage>;

/// What was kept and what was lost.
#[derive(Debug, Default, PartialEq, Eq)]
struct Salvage {
    kept: u64,
    lost_bytes: u64,
    lost_records: u64,
    is_cut: bool,
    /// What the recording lacks, a sentence each.
    losses: Vec<String>,
}

impl Salvage {
    /// A file that merely has no end has lost nothing that can be told.
    fn is_whole(&self) -> bool {
        let is_only_cut = self.is_cut && self.losses.len() == 1;
        self.lost_bytes + self.lost_records == 0 && (is_only_cut || self.losses.is_empty())
    }

    fn words(&self) -> String {
        let end = match self.is_cut {
            true => "the end was cut off",
            false => "the end is there",
        };
        format!(
            "{} records kept; lost: {} bytes that made none and {} that made no sense; {end}",
            self.kept, self.lost_bytes, self.lost_records
        )
    }
}

fn recording(file: &Path, out: File, profile: Profile) -> anyhow::Result<Salvage> {
    let refused = |error: &dyn std::fmt::Display| Usage::error(error);
    let mut reader = RecordingReader::open(&[file]).map_err(|error| refused(&error))?;
    let mut first = reader.next_message().map_err(|error| refused(&error))?;
    let frame_id = match first.as_ref().map(|recorded| &recorded.record) {
        Some(Record::Settings(toml)) => frame_id_of(toml),
        _ => None,
    };
    let handle = out.try_clone()?;
    let mut writer = RecordingWriter::new(out, frame_id.as_deref().unwrap_or("map"), profile)?;
    let mut found = Salvage::default();
    loop {
        let next = match first.take() {
            Some(first) => Some(first),
            None => reader.next_message().map_err(|error| refused(&error))?,
        };
        let Some(recorded) = next else { break };
        // The writer says the epochs itself.
        if is_epoch_event(&recorded.record) || !profile.keeps(&recorded.record) {
            continue;
        }
        writer.write(recorded.host_time, &recorded.record)?;
        found.kept += 1;
    }
    writer.finish()?;
    handle.sync_all()?;
    found.lost_bytes = reader.damaged_byte_count();
    found.lost_records = reader.undecodable_count();
    found.is_cut = reader.ending() == Some(Ending::Cut);
    found.losses = reader.losses(false);
    Ok(found)
}

fn frame_id_of(toml: &str) -> Option<String> {
    let settings: toml::Table = toml::from_str(toml).ok()?;
    let frame_id = settings.get("bus")?.get("frame_id")?;
    frame_id.as_str().map(str::to_owned)
}

fn is_epoch_event(record: &Record) -> bool {
    matches!(record, Record::Event(event) if event["event"] == "pose_epoch")
}

/// Intact frames of any id, as they were.
fn log(file: &Path, out: File) -> anyhow::Result<Salvage> {
    let refused =
        |error: &dyn std::fmt::Display| Usage::error(format!("{}: {error}", file.display()));
    let opened = File::open(file).map_err(|error| refused(&error))?;
    let mut reader = SvlogReader::new(BufReader::new(opened)).map_err(|error| refused(&error))?;
    let mut writer = BufWriter::new(out);
    let mut decoder = Box::new(Decoder::new());
    let mut found = Salvage::default();
    let mut has_session = false;
    let mut failed = Ok(());
    let mut take = |event: Event<'_>| match event {
        Event::Frame(frame) => {
            found.kept += 1;
            has_session |= frame.message_id() == id::JSON;
            if failed.is_ok() {
                failed = writer.write_all(frame.bytes());
            }
        }
        Event::Skipped(skipped) => found.lost_bytes += skipped.byte_count as u64,
    };
    while let Some(piece) = reader.next_piece().map_err(|error| refused(&error))? {
        decoder.feed(piece, &mut take);
    }
    let pending = decoder.pending_byte_count() > 0;
    decoder.finish(&mut take);
    failed.context("the clean log cannot be written")?;
    found.is_cut = pending;
    writer.flush()?;
    writer.get_ref().sync_all()?;
    if !has_session {
        tracing::warn!("no session packet is left: its profiles have no time of day");
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::Timestamp;

    fn raw(index: u8) -> Record {
        Record::Raw(vec![index; 100].into())
    }

    /// A recording of ten raw records without its end.
    fn cut_recording(folder: &Path) -> PathBuf {
        let file = folder.join("a.mcap");
        let mut writer =
            RecordingWriter::new(File::create(&file).unwrap(), "map", Profile::Full).unwrap();
        for index in 0..10 {
            writer.write(Timestamp::ZERO, &raw(index)).unwrap();
        }
        std::fs::write(folder.join("cut.mcap"), std::fs::read(&file).unwrap()).unwrap();
        folder.join("cut.mcap")
    }

    #[test]
    fn a_cut_recording_becomes_a_whole_one_and_is_never_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let file = cut_recording(folder.path());
        let arguments = RecoverArguments {
            file,
            out: None,
            ros: false,
        };
        assert_eq!(run(&arguments).unwrap(), Finish::Done);
        let out = folder.path().join("cut.recovered.mcap");
        let mut reader = RecordingReader::open(&[&out]).unwrap();
        let mut count = 0;
        while let Some(found) = reader.next_message().unwrap() {
            assert_eq!(found.record, raw(count));
            count += 1;
        }
        assert_eq!((count, reader.ending()), (10, Some(Ending::Complete)));
        assert!(run(&arguments).unwrap_err().to_string().contains("--out"));
    }

    #[test]
    fn for_ros_what_ros_knows_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let arguments = RecoverArguments {
            file: cut_recording(folder.path()),
            out: None,
            ros: true,
        };
        assert_eq!(run(&arguments).unwrap(), Finish::Done);
        let out = std::fs::read(folder.path().join("cut.ros.mcap")).unwrap();
        // Its profile stands in the first record, behind its length.
        assert_eq!(out[21..25], *b"ros2");
        let log = folder.path().join("a.svlog");
        std::fs::write(&log, b"BR\x02\x00").unwrap();
        let arguments = RecoverArguments {
            file: log,
            ..arguments
        };
        let refused = run(&arguments).unwrap_err().to_string();
        assert!(refused.contains("--record-format ros"), "{refused}");
    }

    #[test]
    fn damage_is_counted_and_another_kind_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = cut_recording(folder.path());
        let mut bytes = std::fs::read(&file).unwrap();
        let at = bytes.len() - 300;
        bytes[at..at + 40].fill(0xAA);
        std::fs::write(&file, bytes).unwrap();
        let arguments = RecoverArguments {
            file,
            out: None,
            ros: false,
        };
        assert_eq!(run(&arguments).unwrap(), Finish::Lossy);
        let text = folder.path().join("a.tum");
        std::fs::write(&text, "1 0 0 0 0 0 0 1").unwrap();
        let arguments = RecoverArguments {
            file: text,
            out: None,
            ros: false,
        };
        assert!(run(&arguments).unwrap_err().to_string().contains("neither"));
    }
}
