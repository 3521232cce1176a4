use super::*;
use echosplat_firmware_protocol::{OsMonoProfile, PowerResults};
use echosplat_recording::svlog::SvlogWriter;

fn frame(message: &Packet<'_>) -> Vec<u8> {
    let mut bytes = vec![0; 4096];
    let length = message.encode(1, 0, &mut bytes).unwrap();
    bytes.truncate(length);
    bytes
}

fn profile(timestamp_ms: u32) -> Vec<u8> {
    let results = [0; 400];
    frame(&Packet::OsMonoProfile(OsMonoProfile {
        ping_number: timestamp_ms / 50,
        start_mm: 0,
        length_mm: 10_000,
        timestamp_ms,
        ping_hz: 451_127,
        gain_index: 0,
        sos_dmps: 15_000,
        channel_number: 0,
        pulse_duration_sec: 3e-5,
        analog_gain: 1.0,
        max_pwr_db: 60.0,
        min_pwr_db: -20.0,
        transducer_heading_deg: 0.0,
        vehicle_heading_deg: 0.0,
        pwr_results: PowerResults::from_bytes(&results).unwrap(),
    }))
}

fn sentence(body: &str) -> String {
    let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${body}*{sum:02X}\r\n")
}

fn nmea(text: &str) -> Vec<u8> {
    frame(&Packet::Nmea(text.into()))
}

const START_MS: i64 = 1_714_564_800_000;

fn read(frames: &[Vec<u8>]) -> GnssLog {
    let header = SessionHeader::new(
        Timestamp::from_millis(START_MS),
        3,
        "tcp://192.168.2.92:51200",
    );
    let mut writer = SvlogWriter::new(Vec::new(), &header).unwrap();
    frames
        .iter()
        .for_each(|frame| writer.write_frame(frame).unwrap());
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), writer.finish().unwrap()).unwrap();
    fixes_of_svlog(file.path()).unwrap()
}

fn gga(second: u32) -> String {
    let [h, m, s] = [second / 3600, second / 60 % 60, second % 60];
    sentence(&format!(
        "GPGGA,{h:02}{m:02}{s:02}.00,6010.2,N,02456.4,E,1,08,1.0,2.5,M,17.0,M,,"
    ))
}

#[test]
fn fixes_are_on_the_time_of_the_profiles_also_while_there_are_none() {
    let mut frames = vec![profile(70_000)];
    for i in 0..200_u32 {
        // The receiver's second changes 20 ms before a profile, but for five seconds without profiles.
        if i % 20 == 1 {
            let text = [gga(36_000 + i / 20), sentence("HEHDT,45.0,T")].concat();
            frames.push(nmea(&text));
        }
        if !(80..180).contains(&i) {
            frames.push(profile(70_000 + 50 * i));
        }
    }
    let log = read(&frames);
    assert_eq!((log.heard.len(), log.fixes(), log.refused), (20, 10, 0));
    for (second, pair) in log.heard.chunks(2).enumerate() {
        let since_ms = pair[0].time().nanos() / 1_000_000 - START_MS;
        let expected_ms = 1_000 * second as i64 + 50;
        assert!(
            (since_ms - expected_ms).abs() <= 60,
            "{since_ms} {expected_ms}"
        );
        assert_eq!(pair[0].time(), pair[1].time());
    }
}

#[test]
fn noise_and_damage_are_counted_and_told() {
    let noise: Vec<u8> = (0..900_u32)
        .map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8)
        .collect();
    let noise = frame(&Packet::Nmea(
        echosplat_firmware_protocol::Text::from_bytes(&noise),
    ));
    let wrong = gga(1).replace("6010.2", "9510.2");
    let far = sentence("GPGGA,000002,9510.2,N,02456.4,E,1,08,1.0,2.5,M,17.0,M,,");
    let frames = [
        profile(0),
        nmea(&wrong),
        nmea(&far),
        noise,
        nmea("$GPGGA,0000"),
        nmea(&sentence("GPGGA,000003,,,,,0,00,,,,,,,")),
        nmea(&sentence("HCHDG,98.3,0.0,E,12.6,W")),
        nmea(&gga(4)),
        profile(50),
    ];
    let log = read(&frames);
    assert_eq!((log.fixes(), log.no_fix, log.magnetic_headings), (1, 1, 1));
    assert!(log.refused >= 4, "{log:?}");
    assert!(log.first_fault.unwrap().contains("damaged"));
    assert_eq!(read(&[profile(0)]), GnssLog::default());
}

/// What ROS 1 wrote: the same without alignment, and a counter first.
#[test]
fn a_message_of_ros_1_is_read() {
    let mut bytes = Vec::new();
    for word in [9_u32, 5, 7, 3] {
        bytes.extend_from_slice(&word.to_le_bytes());
    }
    bytes.extend_from_slice(b"gps\x00\x01\x00");
    for number in [
        60.17, 24.94, 12.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 4.0_f64,
    ] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes.push(2);
    let fix = ros1_fix(&bytes).unwrap();
    assert_eq!((fix.status, fix.covariance_type), (0, 2));
    assert_eq!(fix.stamp, Timestamp::from_nanos(5_000_000_007));
    assert!((fix.covariance_m2[4] - 2.0).abs() < 1e-12);
    for length in 0..bytes.len() {
        assert!(ros1_fix(&bytes[..length]).is_err());
    }
}
