//! Recordings as other programs write them anew: in chunks, compressed, topic by topic.

use std::path::Path;

use mcap::records::op;

use super::*;

/// A record: its kind, its length, its body.
fn record(kind: u8, parts: &[&[u8]]) -> Vec<u8> {
    let body = parts.concat();
    [&[kind][..], &(body.len() as u64).to_le_bytes(), &body].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

fn channel(id: u16, topic: &str) -> Vec<u8> {
    let id = id.to_le_bytes();
    let encoding = text("cdr");
    record(
        op::CHANNEL,
        &[&id, &[0, 0], &text(topic), &encoding, &[0; 4]],
    )
}

/// A message of the channel with this id, as our own writer has it under another.
fn message(id: u16, message: &Message) -> Vec<u8> {
    let header = &message.header;
    record(
        op::MESSAGE,
        &[
            &id.to_le_bytes(),
            &header.sequence.to_le_bytes(),
            &header.log_time.to_le_bytes(),
            &header.publish_time.to_le_bytes(),
            &message.data,
        ],
    )
}

fn chunk(compression: &str, records: &[u8]) -> Vec<u8> {
    let stored = match compression {
        "zstd" => {
            ruzstd::encoding::compress_to_vec(records, ruzstd::encoding::CompressionLevel::Fastest)
        }
        "lz4" => {
            let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
            encoder.write_all(records).unwrap();
            encoder.finish().unwrap()
        }
        _ => records.to_vec(),
    };
    record(
        op::CHUNK,
        &[
            &[0; 16],
            &(records.len() as u64).to_le_bytes(),
            &crc32fast::hash(records).to_le_bytes(),
            &text(compression),
            &(stored.len() as u64).to_le_bytes(),
            &stored,
        ],
    )
}

/// The messages of a file, each with its topic.
fn messages_of(bytes: &[u8]) -> Vec<(String, Message)> {
    let mut messages = Messages::new(bytes).unwrap();
    let mut all = Vec::new();
    while let Some(message) = messages.next_message().unwrap() {
        let topic = messages.channel(message.header.channel_id).unwrap();
        all.push((topic.topic.clone(), message));
    }
    all
}

/// The same messages as another program writes them: its own ids, chunks of a few messages.
fn rewritten(messages: &[(String, Message)], compression: &str, per_chunk: usize) -> Vec<u8> {
    let mut topics: Vec<&str> = messages.iter().map(|(topic, _)| topic.as_str()).collect();
    topics.sort_unstable();
    topics.dedup();
    let id_of = |topic: &str| 70 + topics.iter().position(|known| *known == topic).unwrap() as u16;
    let mut file = mcap::MAGIC.to_vec();
    file.extend(record(
        op::HEADER,
        &[&text(""), &text("mcap of somebody else 1.0")],
    ));
    let mut known: Vec<&str> = Vec::new();
    for messages in messages.chunks(per_chunk) {
        let mut records = Vec::new();
        for (topic, found) in messages {
            if !known.contains(&topic.as_str()) {
                known.push(topic);
                records.extend(channel(id_of(topic), topic));
            }
            records.extend(message(id_of(topic), found));
        }
        file.extend(chunk(compression, &records));
        file.extend(record(op::MESSAGE_INDEX, &[&[70, 0, 0, 0, 0, 0]]));
    }
    file.extend(record(op::DATA_END, &[&[0; 4]]));
    file.extend(record(op::FOOTER, &[&[0; 20]]));
    file.extend(mcap::MAGIC);
    file
}

/// One of each kind, twice, with a change of epoch between.
fn original() -> Vec<u8> {
    let mut writer = writer();
    for (index, record) in all_kinds().iter().chain(&all_kinds()).enumerate() {
        let mut record = record.clone();
        if let Record::Pose(pose) = &mut record {
            pose.epoch += index as u32 / 10;
        }
        // Seconds apart, so that each has its place in time.
        let host_time = time(0).offset_by(index as f64 * 2.0);
        writer.write(host_time, &record).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn chunks_of_any_compression_hold_the_records_that_were_recorded() {
    let original = original();
    let (expected, _) = read_all(&original);
    for compression in ["", "zstd", "lz4"] {
        for per_chunk in [1, 5, 1000] {
            let mut messages = messages_of(&original);
            if per_chunk == 5 {
                // A writer that numbers messages anew.
                for (index, (_, message)) in messages.iter_mut().enumerate() {
                    message.header.sequence = 3 * index as u32;
                }
            }
            let bytes = rewritten(&messages, compression, per_chunk);
            let (found, reader) = read_all(&bytes);
            assert_eq!(found, expected, "{compression} {per_chunk}");
            assert_eq!(reader.losses(false), [""; 0]);
        }
    }
}

#[test]
fn a_cut_chunk_gives_what_stood_before_the_cut() {
    let (original, _) = recording(40);
    let messages = messages_of(&original);
    for (compression, least) in [("", 38), ("zstd", 0), ("lz4", 0)] {
        let bytes = rewritten(&messages, compression, 20);
        let end = bytes.len() - 200;
        for cut in (60..end).step_by(7) {
            let (all, reader) = read_all(&bytes[..cut]);
            let is_right = |(i, found): (usize, &Recorded)| is_raw(found, i);
            assert!(all.iter().enumerate().all(is_right), "{compression} {cut}");
            let said = reader.losses(false).join("; ");
            assert!(
                said.contains("ends in the middle"),
                "{compression} {cut}: {said}"
            );
        }
        let (all, _) = read_all(&bytes[..end]);
        assert!(all.len() >= least.max(20), "{compression}: {}", all.len());
    }
}

/// Where the first chunk ends: one byte of kind and eight of length before each body.
fn end_of_first_chunk(bytes: &[u8]) -> usize {
    let mut at = mcap::MAGIC.len();
    loop {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
        let end = at + 9 + usize::try_from(length).unwrap();
        if bytes[at] == op::CHUNK {
            return end;
        }
        at = end;
    }
}

#[test]
fn a_flipped_byte_in_a_chunk_is_told_and_costs_no_other_chunk() {
    let (original, _) = recording(40);
    let messages = messages_of(&original);
    for compression in ["", "zstd", "lz4"] {
        let bytes = rewritten(&messages, compression, 10);
        let (begin, end) = (70, bytes.len() - 60);
        let first_end = end_of_first_chunk(&bytes);
        for at in (begin..end).step_by(11) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x41;
            let (all, reader) = read_all(&damaged);
            let sound = (0..40).filter(|&i| all.iter().any(|found| is_raw(found, i)));
            // In the first chunk stands what its channel is.
            let least = if at < first_end { 0 } else { 30 };
            let (sound, losses) = (sound.count(), reader.losses(false));
            assert!(sound >= least, "{compression} {at}: {sound}");
            assert!(
                sound == 40 || !losses.is_empty(),
                "{compression} {at}: {sound}"
            );
        }
    }
}

#[test]
fn a_file_that_stands_topic_by_topic_is_read_in_the_order_of_times() {
    let original = original();
    let (expected, _) = read_all(&original);
    let mut messages = messages_of(&original);
    messages.sort_by(|a, b| a.0.cmp(&b.0));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, rewritten(&messages, "lz4", 3)).unwrap();
    let mut reader = RecordingReader::open(&[&path]).unwrap();
    let mut found = Vec::new();
    while let Some(recorded) = reader.next_message().unwrap() {
        found.push(recorded);
    }
    assert_eq!(found, expected);
    assert_eq!(reader.losses(false), [""; 0]);
}

#[test]
fn what_a_chunk_says_of_itself_is_not_allocated() {
    let mut file = mcap::MAGIC.to_vec();
    file.extend(record(op::HEADER, &[&text(""), &text("x")]));
    // 2^40 bytes of content, and a length to match.
    let content = 1_u64 << 40;
    let body = [&[0; 28][..], &text("zstd"), &content.to_le_bytes()].concat();
    file.push(op::CHUNK);
    file.extend((content + body.len() as u64).to_le_bytes());
    file.extend(body);
    let result = RecordingReader::new(&file[..]).unwrap().next_message();
    assert!(matches!(result, Err(RecordingError::ChunkTooLong { .. })));
}

#[test]
fn pieces_of_bytes_that_a_filter_left_out_are_told() {
    let (original, _) = recording(30);
    let mut messages = messages_of(&original);
    messages.drain(12..20);
    let mut bytes = rewritten(&messages, "zstd", 100);
    let (all, reader) = read_all(&bytes);
    // Who numbers them is not known.
    assert_eq!((all.len(), reader.losses(false).len()), (22, 0));
    drop(reader);
    let name = b"mcap of somebody else 1.0";
    let at = bytes.windows(name.len()).position(|w| w == name).unwrap();
    bytes[at..at + name.len()].copy_from_slice(b"go; echosplat recording 2");
    let (_, reader) = read_all(&bytes);
    let said = reader.losses(false).join("; ");
    assert!(
        said.contains("lacks 8 pieces of the sonar's bytes"),
        "{said}"
    );
}

#[test]
fn a_recording_of_a_newer_version_is_refused_with_its_name_and_both_versions() {
    let (bytes, _) = recording(3);
    let newest = echosplat_ply::version_of(&LIBRARY[LIBRARY.rfind(' ').unwrap() + 1..]).unwrap();
    let said = |version: &str| {
        let at = bytes
            .windows(LIBRARY.len())
            .position(|w| w == LIBRARY.as_bytes());
        let mut other = bytes.clone();
        let digit = at.unwrap() + LIBRARY.len() - 1;
        other[digit..=digit].copy_from_slice(version.as_bytes());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dive.mcap");
        std::fs::write(&path, other).unwrap();
        Recording::scan(&[path])
            .map(|scan| scan.counts.raw)
            .map_err(|error| error.to_string())
    };
    let error = said("9").unwrap_err();
    for words in [
        "dive.mcap: ",
        "version 9 of a recording",
        &format!("up to version {newest};"),
    ] {
        assert!(error.contains(words), "{error}");
    }
    // What was written before is read, and so is a damaged word.
    for version in ["1", "2", "s"] {
        assert_eq!(said(version), Ok(3), "{version}");
    }
}

#[test]
fn a_file_is_told_by_its_records_where_its_head_is_gone() {
    let (mut bytes, ends) = recording(30);
    let head = ends[0];
    bytes[..head].fill(0);
    let (all, reader) = read_all(&bytes);
    assert_eq!((all.len(), is_raw(&all[0], 1)), (29, true));
    assert!(reader.losses(false)[0].contains("damaged"));
    assert!(RecordingReader::new(&[0; 5000][..]).is_err());
    assert!(Messages::open(Path::new("/")).is_err());
}

#[test]
fn an_order_that_no_dive_had_is_refused_with_what_helps() {
    let (original, _) = recording(200);
    let messages = messages_of(&original);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let opened = |messages: &[(String, Message)]| {
        std::fs::write(&path, rewritten(messages, "zstd", 10)).unwrap();
        RecordingReader::open(&[&path]).map(drop)
    };
    let mut reversed = messages.clone();
    reversed.reverse();
    let swapped = [&messages[100..], &messages[..100]].concat();
    for order in [&reversed, &swapped] {
        let error = opened(order).unwrap_err().to_string();
        assert!(
            error.contains("a.mcap: its messages do not stand"),
            "{error}"
        );
    }
    opened(&messages).unwrap();
    // A clock that was set back, and a writer that numbers nothing.
    let mut set_back = messages;
    for (index, (_, message)) in set_back.iter_mut().enumerate() {
        if index > 100 {
            message.header.log_time -= 3_000_000_000;
        }
    }
    opened(&set_back).unwrap();
}
