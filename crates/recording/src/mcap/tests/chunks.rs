//! Chunks and their indexes, by which other programs find messages.

use super::*;

/// `seconds` of a dive at 58 pings/s of 600 bins and 10 poses/s.
fn dive(seconds: usize, profile: Profile) -> Vec<u8> {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "map", profile).unwrap();
    let at = |s: f64| Timestamp::from_secs_f64(1_700_000_000.0 + s);
    let settings = Record::Settings("[sonar]".to_owned());
    writer.write(at(0.0), &settings).unwrap();
    for index in 0..seconds * 58 {
        let time = at(index as f64 / 58.0);
        let bytes: Vec<u8> = (0..1_290).map(|i| (i * 7 + index) as u8).collect();
        writer.write(time, &Record::Raw(bytes.into())).unwrap();
        if index % 6 == 0 {
            writer.write(time, &Record::Pose(pose())).unwrap();
        }
    }
    let delta = Record::Delta {
        cloud: vec![1; 900].into(),
        info: Arc::from(&b"{}"[..]),
    };
    writer.write(at(seconds as f64), &delta).unwrap();
    writer.finish().unwrap().into_inner()
}

/// How many messages the indexes lead to on each topic.
fn found_by_index(bytes: &[u8]) -> Vec<(String, u64)> {
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    let mut found = std::collections::BTreeMap::new();
    for chunk in &summary.chunk_indexes {
        for (channel, entries) in summary.read_message_indexes(bytes, chunk).unwrap() {
            for entry in &entries {
                let message = summary.seek_message(bytes, chunk, entry).unwrap();
                assert_eq!(message.channel.topic, channel.topic);
                assert_eq!(message.log_time, entry.log_time);
            }
            *found.entry(channel.topic.clone()).or_default() += entries.len() as u64;
        }
    }
    found.into_iter().collect()
}

#[test]
fn an_index_leads_to_every_message() {
    let bytes = dive(5, Profile::Full);
    let found = found_by_index(&bytes);
    let expected = [
        ("/events", 1),
        ("/map/delta", 1),
        ("/map/delta_info", 1),
        ("/pose", 49),
        ("/settings", 1),
        ("/sonar/raw", 290),
    ];
    let expected = expected.map(|(topic, count)| (topic.to_owned(), count));
    assert_eq!(found, expected);
}

#[test]
fn a_chunk_ends_as_often_as_the_file_is_synced_and_costs_little() {
    let bytes = dive(20, Profile::Full);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let count = summary.chunk_indexes.len();
    assert!((39..=41).contains(&count), "{count} chunks");
    for chunk in &summary.chunk_indexes {
        assert!(chunk.message_end_time - chunk.message_start_time < 500_000_000);
    }
    let messages: usize = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap().data.len() + 31)
        .sum();
    let ratio = bytes.len() as f64 / messages as f64;
    assert!(ratio < 1.05, "{ratio} times as large as its messages");
}

#[test]
fn what_comes_at_once_makes_chunks_of_a_bounded_length() {
    let mut writer = writer();
    let piece = Record::Raw(vec![7; 100_000].into());
    for _ in 0..50 {
        writer.write(time(0), &piece).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(summary.chunk_indexes.len() >= 4);
    let longest = summary.chunk_indexes.iter().map(|chunk| chunk.chunk_length);
    assert!(longest.max().unwrap() < 1_300_000);
    assert_eq!(read_all(&bytes).0.len(), 50);
}

#[test]
fn a_killed_writer_leaves_a_file_whose_every_record_reads() {
    let mut file = Cursor::new(Vec::new());
    let mut writer = RecordingWriter::new(&mut file, "map", Profile::Full).unwrap();
    for index in 0..20 {
        writer.write(time(index), &raw(index)).unwrap();
    }
    // Nothing is written when it goes.
    drop(writer);
    let bytes = file.into_inner();
    let (all, reader) = read_all(&bytes);
    assert!((0..20).all(|i| is_raw(&all[i], i)));
    assert_eq!(reader.ending(), Some(Ending::Cut));
    assert_eq!(reader.damaged_byte_count(), 0);
}

#[test]
fn a_recording_for_ros_holds_cdr_alone() {
    let bytes = dive(3, Profile::Ros2);
    let topics: Vec<_> = found_by_index(&bytes);
    let topics: Vec<_> = topics.iter().map(|(topic, _)| &topic[..]).collect();
    assert_eq!(topics, ["/map/delta", "/pose", "/sonar/raw"]);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut encodings = summary.channels.values().map(|c| &c.message_encoding[..]);
    assert!(encodings.all(|encoding| encoding == "cdr"));
    let header = mcap::parse_record(1, &bytes[17..17 + usize::from(bytes[9])]);
    let Ok(mcap::records::Record::Header(header)) = header else {
        panic!("no header");
    };
    assert_eq!(header.profile, "ros2");
    let (all, reader) = read_all(&bytes);
    assert_eq!(all.len(), 174 + 29);
    assert_eq!(reader.undecodable_count(), 0);
    assert!(reader.losses(false).is_empty());
}
