use super::*;
use crate::cdr::CdrWriter;
use proptest::prelude::*;

fn pose() -> StampedPose {
    StampedPose {
        time: Timestamp::from_nanos(1_700_000_000_123_456_789),
        world_from_vehicle: Pose::from_yaw_pitch_roll(
            0.3,
            -0.1,
            0.2,
            DVec3::new(0.1, 1e6 / 3.0, -7.0),
        ),
        uncertainty: Some(PoseCovariance::alike(0.5, 0.25)),
        epoch: 3,
    }
}

/// Header, 24 bytes of padding-prone strings aside, then 7 numbers, then `more` numbers.
fn cdr(frame: &str, child: Option<&str>, numbers: &[f64]) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(0);
    let stamp = pose().time;
    Header {
        stamp,
        frame_id: frame,
    }
    .write(&mut writer);
    if let Some(child) = child {
        writer.string(child);
    }
    let mut bytes = writer.finish();
    // Doubles are aligned to 8 behind the four bytes of encapsulation.
    while !(bytes.len() - 4).is_multiple_of(8) {
        bytes.push(0);
    }
    for number in numbers {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes
}

fn numbers(covariance: f64, twist_count: usize) -> Vec<f64> {
    let mut numbers = vec![1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8];
    numbers.extend((0..36).map(|i| if i % 7 == 0 { covariance } else { 0.0 }));
    numbers.extend(vec![f64::NAN; twist_count]);
    numbers
}

#[test]
fn json_comes_back_to_the_last_bit() {
    let sent = pose();
    let json = encode_json(&sent, "map", "base_link");
    let found = decode(JSON, &json).unwrap();
    assert_eq!(found.pose, sent);
    let with_schema = decode("application/json;echosplat/Pose", &json).unwrap();
    assert_eq!(with_schema.pose, sent);
}

#[test]
fn the_documented_object_is_read() {
    let json = br#"{"stamp_ns": 5, "frame_id": "map", "child_frame_id": "base_link",
        "position": [1, 2, 3], "orientation_xyzw": [0, 0, 0, 1]}"#;
    let found = decode(JSON, json).unwrap().pose;
    assert_eq!(found.time, Timestamp::from_nanos(5));
    assert_eq!(
        found.world_from_vehicle.translation_m,
        DVec3::new(1.0, 2.0, 3.0)
    );
    assert_eq!((found.uncertainty, found.epoch), (None, 0));
}

#[test]
fn a_pose_stamped_is_read_from_bytes_worked_out_by_hand() {
    let mut bytes = vec![0, 1, 0, 0]; // encapsulation
    bytes.extend_from_slice(&7_i32.to_le_bytes()); // sec at 0
    bytes.extend_from_slice(&9_u32.to_le_bytes()); // nanosec at 4
    bytes.extend_from_slice(&[4, 0, 0, 0, b'm', b'a', b'p', 0]); // string at 8
    for number in [1.5, -2.5, 3.5, 0.0, 0.0, 0.0, -1.0_f64] {
        bytes.extend_from_slice(&number.to_le_bytes()); // from 16 on, which is aligned
    }
    let found = decode(POSE_STAMPED, &bytes).unwrap().pose;
    assert_eq!(found.time, Timestamp::from_nanos(7_000_000_009));
    assert_eq!(
        found.world_from_vehicle.translation_m,
        DVec3::new(1.5, -2.5, 3.5)
    );
    assert_eq!(
        found.world_from_vehicle.rotation,
        DQuat::from_xyzw(0.0, 0.0, 0.0, -1.0)
    );
}

#[test]
fn strings_of_any_length_leave_the_numbers_aligned() {
    for frame in ["", "m", "odom", "a_longer_frame"] {
        for child in ["", "b", "base", "base_link"] {
            let bytes = cdr(frame, Some(child), &numbers(0.25, 42));
            let found = decode(ODOMETRY, &bytes).unwrap().pose;
            assert_eq!(
                found.world_from_vehicle.translation_m,
                DVec3::new(1.0, 2.0, 3.0)
            );
            assert_eq!(
                found.world_from_vehicle.rotation,
                DQuat::from_xyzw(0.0, 0.0, 0.6, 0.8)
            );
            assert_eq!(found.uncertainty, Some(PoseCovariance::alike(0.5, 0.5)));
        }
    }
}

#[test]
fn each_axis_is_told_as_it_is() {
    let mut values = numbers(0.0, 0);
    values[7 + 1] = -1.5; // x with y
    values[7 + 7] = 4.0; // y
    values[7 + 2 * 7] = 1e6; // z, which nobody measures
    values[7 + 5 * 7] = 0.01; // about z
    let found = decode(POSE_WITH_COVARIANCE, &cdr("map", None, &values)).unwrap();
    let told = PoseCovariance {
        position_m2: [0.0, -1.5, 0.0, 4.0, 0.0, 1e6],
        attitude_rad2: [0.0, 0.0, 0.01],
    };
    assert_eq!(found.pose.uncertainty, Some(told));
}

#[test]
fn an_unknown_or_odd_covariance_leaves_the_pose() {
    let zero = decode(POSE_WITH_COVARIANCE, &cdr("map", None, &numbers(0.0, 0))).unwrap();
    assert_eq!(zero.pose.uncertainty, None);
    for odd in [f64::NAN, -1.0, f64::INFINITY] {
        let bytes = cdr("map", None, &numbers(odd, 0));
        let found = decode(POSE_WITH_COVARIANCE, &bytes).unwrap();
        let told = found.pose.uncertainty.unwrap().attitude_rad2;
        assert!(told.iter().all(|v| v.to_bits() == odd.to_bits()));
    }
}

#[test]
fn numbers_that_json_does_not_have_are_read_in_a_covariance_and_nowhere_else() {
    let json = |position: &str, covariance: &str| {
        format!(
            r#"{{"stamp_ns": 5, "frame_id": "NaN \" NaN", "position": [{position}, 2, 3],
            "orientation_xyzw": [0, 0, 0, 1], "covariance": [{covariance}]}}"#
        )
    };
    for odd in ["null", "NaN", "-Infinity", "Infinity", "1.8e308", "-nan"] {
        let mut numbers = vec!["0.0"; 36];
        (numbers[0], numbers[14], numbers[35]) = ("4e-4", odd, odd);
        let found = decode(JSON, json("1", &numbers.join(",")).as_bytes()).unwrap();
        let told = found.pose.uncertainty.unwrap();
        assert!(told.position_m2[5].is_nan() && told.attitude_rad2[2].is_nan());
        assert_eq!(told.position_m2[0].to_bits(), 4e-4_f64.to_bits());
        let error = decode(JSON, json(odd, &numbers.join(",")).as_bytes());
        assert!(matches!(error, Err(PoseMessageError::Json(_))), "{odd}");
    }
}

#[test]
fn numbers_that_are_no_pose_are_refused() {
    for index in 0..7 {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut values = numbers(0.0, 0);
            values.truncate(7);
            values[index] = bad;
            let refused = decode(POSE_STAMPED, &cdr("map", None, &values));
            assert!(matches!(refused, Err(PoseMessageError::NotFinite(_))));
        }
    }
    let far = [1e9, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let refused = decode(POSE_STAMPED, &cdr("map", None, &far));
    assert_eq!(refused, Err(PoseMessageError::TooFar));
    for w in [0.0, 1e-9, 0.9, 1.1, 1e300] {
        let values = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, w];
        let refused = decode(POSE_STAMPED, &cdr("map", None, &values));
        assert!(
            matches!(refused, Err(PoseMessageError::Quaternion(_))),
            "{w}"
        );
    }
}

#[test]
fn a_slightly_long_quaternion_is_made_a_unit() {
    let values = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.005];
    let found = decode(POSE_STAMPED, &cdr("map", None, &values)).unwrap();
    assert!((found.pose.world_from_vehicle.rotation.length() - 1.0).abs() < 1e-12);
}

#[test]
fn frames_with_z_down_are_refused() {
    for frame in ["ned", "map_ned", "odom_NED", "base_link_frd"] {
        let refused = decode(POSE_STAMPED, &cdr(frame, None, &numbers(0.0, 0)[..7]));
        assert_eq!(refused, Err(PoseMessageError::Frame(frame.to_owned())));
    }
    assert!(decode(POSE_STAMPED, &cdr("planned", None, &numbers(0.0, 0)[..7])).is_ok());
}

#[test]
fn cut_and_overlong_messages_are_refused() {
    for (encoding, good) in [
        (ODOMETRY, cdr("map", Some("base_link"), &numbers(0.1, 42))),
        (POSE_WITH_COVARIANCE, cdr("map", None, &numbers(0.1, 0))),
        (POSE_STAMPED, cdr("map", None, &numbers(0.1, 0)[..7])),
        (JSON, encode_json(&pose(), "map", "base_link")),
    ] {
        assert!(decode(encoding, &good).is_ok());
        for end in 0..good.len() {
            assert!(
                decode(encoding, &good[..end]).is_err(),
                "{encoding} cut at {end}"
            );
        }
        let mut long = good.clone();
        long.extend_from_slice(&[1; 8]);
        assert!(decode(encoding, &long).is_err(), "{encoding} too long");
        long.resize(MAX_POSE_BYTES + 1, b' ');
        let refused = decode(encoding, &long);
        assert_eq!(refused, Err(PoseMessageError::Size(MAX_POSE_BYTES + 1)));
    }
    let odd = decode("application/cdr;sensor_msgs/msg/Imu", &[]);
    assert!(matches!(odd, Err(PoseMessageError::Unknown { .. })));
}

#[test]
fn json_is_taken_whatever_its_encoding() {
    let json = encode_json(&pose(), "map", "base_link");
    let mut spaced = b" \r\n\t".to_vec();
    spaced.extend_from_slice(&json);
    for encoding in [
        "zenoh/bytes",
        "zenoh/string",
        "text/plain",
        "",
        "application/cdr",
        ODOMETRY,
    ] {
        assert_eq!(decode(encoding, &json).unwrap().pose, pose(), "{encoding}");
        assert_eq!(decode(encoding, &spaced).unwrap().pose, pose());
    }
}

#[test]
fn cdr_without_a_schema_is_told_by_its_length() {
    for encoding in [
        "application/cdr",
        "zenoh/bytes",
        "",
        "application/octet-stream",
    ] {
        for frame in ["", "m", "map", "odom", "a_longer_frame"] {
            let place = |bytes: &[u8]| decode(encoding, bytes).unwrap();
            let odometry = place(&cdr(frame, Some("base_link"), &numbers(0.25, 42)));
            assert!(odometry.pose.uncertainty.is_some());
            let with_covariance = place(&cdr(frame, None, &numbers(0.25, 0)));
            assert!(with_covariance.pose.uncertainty.is_some());
            let stamped = place(&cdr(frame, None, &numbers(0.0, 0)[..7]));
            assert_eq!(stamped.pose.uncertainty, None);
            for found in [odometry, with_covariance, stamped] {
                let at = found.pose.world_from_vehicle;
                assert_eq!(at.translation_m, DVec3::new(1.0, 2.0, 3.0));
                assert_eq!(at.rotation, DQuat::from_xyzw(0.0, 0.0, 0.6, 0.8));
            }
        }
    }
    let dds = "application/cdr;nav_msgs::msg::dds_::Odometry_";
    assert!(decode(dds, &cdr("map", Some("b"), &numbers(0.1, 42))).is_ok());
}

#[test]
fn what_is_nothing_of_these_is_named() {
    let said = |encoding, bytes: &[u8]| decode(encoding, bytes).unwrap_err().to_string();
    let text = said("zenoh/string", b"1.0 2.0 3.0");
    assert!(
        text.contains("zenoh/string") && text.contains("\"1.0 2.0 3.0\""),
        "{text}"
    );
    let short = said("application/cdr", &cdr("map", None, &[1.0; 5]));
    assert!(short.contains("nav_msgs/msg/Odometry"), "{short}");
    let big_endian = said("application/cdr", &[0, 0, 0, 0, 0, 0, 0, 1]);
    assert!(big_endian.contains("[00, 00"), "{big_endian}");
}

#[test]
fn json_of_another_shape_is_refused() {
    for json in [
        r#"{"stamp_ns": 5, "position": [1, 2], "orientation_xyzw": [0, 0, 0, 1]}"#,
        r#"{"stamp_ns": 5, "position": [1, 2, 3], "orientation_xyzw": [0, 0, 0, 1], "covariance": [1]}"#,
        r#"{"stamp_ns": 1e30, "position": [1, 2, 3], "orientation_xyzw": [0, 0, 0, 1]}"#,
        r#"{"stamp_ns": 5, "position": [1e999, 2, 3], "orientation_xyzw": [0, 0, 0, 1]}"#,
        "[]",
        "null",
    ] {
        assert!(decode(JSON, json.as_bytes()).is_err(), "{json}");
    }
}

proptest! {
    #[test]
    fn no_bytes_upset_it(bytes in proptest::collection::vec(any::<u8>(), 0..800)) {
        for encoding in [JSON, ODOMETRY, POSE_STAMPED, POSE_WITH_COVARIANCE] {
            let _ = decode(encoding, &bytes);
        }
    }

    #[test]
    fn what_is_taken_is_finite(flips in proptest::collection::vec((4_usize..400, any::<u8>()), 0..6)) {
        let mut bytes = cdr("map", None, &numbers(0.1, 0));
        for (at, value) in flips {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        if let Ok(found) = decode(POSE_WITH_COVARIANCE, &bytes) {
            prop_assert!(found.pose.world_from_vehicle.is_finite());
            prop_assert!((found.pose.world_from_vehicle.rotation.length() - 1.0).abs() < 1e-6);
        }
    }
}
