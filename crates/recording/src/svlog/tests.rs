use std::io::Cursor;

use echosplat_firmware_protocol::{Decoder, Event, Message};
use echosplat_model::Timestamp;
use proptest::prelude::*;

use super::*;

fn header() -> SessionHeader {
    let time = Timestamp::from_nanos(1_714_564_800_123_456_789);
    SessionHeader::new(time, 3, "tcp://192.168.2.92:51200")
}

fn frame(text: &str) -> Vec<u8> {
    let mut bytes = vec![0; 100];
    let length = Message::AsciiText(text.into())
        .encode(3, 0, &mut bytes)
        .unwrap();
    bytes.truncate(length);
    bytes
}

fn log(frame_count: usize) -> Vec<u8> {
    let mut writer = SvlogWriter::new(Vec::new(), &header()).unwrap();
    for index in 0..frame_count {
        writer
            .write_frame(&frame(&format!("frame {index}")))
            .unwrap();
    }
    writer.finish().unwrap()
}

fn read_all(bytes: &[u8]) -> Result<(Vec<u8>, Option<Tail>, u64), SvlogError> {
    let mut reader = SvlogReader::new(Cursor::new(bytes))?;
    let mut all = Vec::new();
    while let Some(piece) = reader.next_piece()? {
        assert!(piece.len() <= 64 << 10);
        all.extend_from_slice(piece);
    }
    Ok((all, reader.tail(), reader.frame_count()))
}

#[test]
fn the_first_packet_is_the_session() {
    let bytes = log(1);
    let mut json = Vec::new();
    Decoder::new().feed(&bytes, &mut |event| {
        if let Event::Frame(frame) = event
            && frame.message_id() == 10
        {
            assert_eq!((frame.src_device_id(), frame.dst_device_id()), (0, 255));
            json = frame.payload().to_vec();
        }
    });
    assert_eq!(SessionHeader::parse(&json).unwrap(), header());
    let value: serde_json::Value = serde_json::from_slice(&json).unwrap();
    assert_eq!(value["timestamp"], "2024-05-01T12:00:00.123456789Z");
    assert_eq!(value["session_devices"][0]["product_id"], "os450");
    for key in [
        "session_id",
        "session_uptime",
        "session_platform",
        "os_uptime",
        "process_uptime",
    ] {
        assert!(value.get(key).is_some(), "{key}");
    }
}

#[test]
fn session_packets_of_owners_files_are_understood() {
    let parse = |json: &str| SessionHeader::parse(json.as_bytes());
    let whole = parse(
        r#"{"session_id": 12, "session_uptime": 3.5, "os_uptime": null,
            "session_devices": {"a": {"url": "x", "product_id": "os450", "device_id": 1, "options": {}}},
            "session_platform": null, "timestamp": "2024-05-01T14:00:00.000+02:00"}"#,
    );
    let whole = whole.unwrap();
    assert_eq!(whole.timestamp.nanos(), 1_714_564_800_000_000_000);
    assert_eq!(whole.devices[0].device_id, 1);
    let bare = parse(r#"{"timestamp": "2024-05-01T12:00:00.000"}"#).unwrap();
    assert_eq!(bare.timestamp, whole.timestamp);
    let error = parse(r#"{"timestamp": "yesterday"}"#).unwrap_err();
    assert!(error.to_string().contains("`yesterday`"));
    assert!(parse("{}").is_err() && parse("[").is_err());
}

#[test]
fn a_packet_of_the_time_of_opening_is_told_by_its_fields() {
    let is_from_opening = |more: &str| {
        let json = format!(r#"{{"timestamp": "2024-05-01T12:00:00.000123+00:00", {more}}}"#);
        SessionHeader::parse(json.as_bytes())
            .unwrap()
            .is_from_opening
    };
    for client in [
        r#""sonarlink_version": "", "os_uptime": null, "process_path": "/usr/bin/python3", "process_version": "v3.11.2""#,
        r#""sonarlink_version": "", "os_uptime": null, "process_path": "/opt/recorder""#,
        r#""sonarlink_version": "", "recorder": "of somebody""#,
        r#""os_uptime": null, "process_path": "C:\\Python312\\python.exe""#,
        r#""session_uptime": 0.0, "process_version": "v3.9.2""#,
    ] {
        assert!(is_from_opening(client), "{client}");
    }
    for other in [
        r#""sonarlink_version": "1.15.3", "os_uptime": 3600.5, "process_path": "/app/node""#,
        r#""sonarlink_version": "1.15.3", "os_uptime": null"#,
        r#""sonarlink_version": "", "os_uptime": 12.5"#,
        r#""process_version": "v18.17.0", "process_path": "/usr/bin/node""#,
    ] {
        assert!(!is_from_opening(other), "{other}");
    }
    assert!(
        !SessionHeader::parse(header().to_json().as_bytes())
            .unwrap()
            .is_from_opening
    );
}

#[test]
fn a_packet_of_few_fields_is_told_by_how_python_writes_times() {
    let is_from_opening = |time: &str, more: &str| {
        let json = format!(
            r#"{{"session_id": 1, "session_uptime": 0.0, "session_devices": [], "timestamp": "{time}"{more}}}"#
        );
        SessionHeader::parse(json.as_bytes())
            .unwrap()
            .is_from_opening
    };
    assert!(is_from_opening("2024-05-01T12:00:00.123456+00:00", ""));
    assert!(is_from_opening("2024-05-01T12:00:00.123456", ""));
    for time in [
        "2024-05-01T12:00:00.123Z",
        "2024-05-01T12:00:00Z",
        "2024-05-01T12:00:00.123456789Z",
    ] {
        assert!(!is_from_opening(time, ""), "{time}");
    }
    let named = r#", "sonarlink_version": "1.15.3""#;
    assert!(!is_from_opening("2024-05-01T12:00:00.123456+00:00", named));
    assert!(!is_from_opening(
        "2024-05-01T12:00:00.123456+00:00",
        r#", "os_uptime": 81.5"#
    ));
}

#[test]
fn whole_milliseconds_are_written_as_the_vendor_does() {
    for (nanos, text) in [
        (0, "1970-01-01T00:00:00.000Z"),
        (1_714_564_800_120_000_000, "2024-05-01T12:00:00.120Z"),
        (i64::MIN, "1677-09-21T00:12:43.145224192Z"),
    ] {
        let mut header = header();
        header.timestamp = Timestamp::from_nanos(nanos);
        assert!(header.to_json().contains(text), "{}", header.to_json());
        assert_eq!(
            SessionHeader::parse(header.to_json().as_bytes()).unwrap(),
            header
        );
    }
}

#[test]
fn every_byte_comes_through_in_order() {
    let bytes = log(10_000);
    let (all, tail, frame_count) = read_all(&bytes).unwrap();
    assert_eq!(all, bytes);
    assert_eq!(tail, Some(Tail::Whole));
    assert_eq!(frame_count, 10_001);
}

#[test]
fn a_cut_tail_is_told() {
    let whole = log(2);
    let last = frame("frame 1").len();
    for cut in 1..last {
        let (all, tail, _) = read_all(&whole[..whole.len() - cut]).unwrap();
        let byte_count = last - cut;
        assert_eq!(tail, Some(Tail::Cut { byte_count }), "cut by {cut}");
        assert_eq!(all.len(), whole.len() - cut);
    }
}

#[test]
fn damage_at_the_start_is_passed_over() {
    let bytes = [vec![0xab; 100_000], log(3)].concat();
    let (all, tail, frame_count) = read_all(&bytes).unwrap();
    assert_eq!((all, tail, frame_count), (bytes, Some(Tail::Whole), 4));
}

#[test]
fn what_is_no_log_is_refused_by_its_name() {
    let error = |bytes: &[u8]| read_all(bytes).unwrap_err().to_string();
    assert!(error(b"").starts_with("the file is empty"));
    assert!(
        error(b"# timestamp tx ty\n1 2 3")
            .contains("text file, starting with `# timestamp tx ty 1 2 3`")
    );
    assert!(error(b"\x89MCAP0\r\n...").contains("an MCAP file"));
    assert!(error(&[0; 3_000_000]).contains("no intact Ping frame"));
    assert!(error(&log(0)[..20]).contains("starting with 42 52"));
}

#[test]
fn only_whole_frames_are_written() {
    let mut writer = SvlogWriter::new(Vec::new(), &header()).unwrap();
    let mut damaged = frame("x");
    damaged[8] ^= 1;
    assert!(matches!(
        writer.write_frame(&damaged),
        Err(SvlogError::NotAFrame(_))
    ));
    assert!(writer.write_frame(&frame("x")[..5]).is_err());
    assert_eq!(writer.finish().unwrap(), log(0));
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(junk in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = read_all(&junk);
        let _ = SessionHeader::parse(&junk);
    }
}
