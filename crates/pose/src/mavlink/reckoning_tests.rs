use echosplat_join::{ArrivedPose, StampClock};
use echosplat_model::Timestamp;
use echosplat_model::glam::{DQuat, DVec3};

use super::fleet::Fleet;
use super::json;
use super::message::{Message, Odometry, Sender, Station, ned_from_frd};
use super::origin::Fix;
use super::told::{Stamp, Teller, Told};
use crate::only::Only;
use crate::reckon::Axes;

const ROV: Sender = Sender {
    system: 1,
    component: 1,
};
/// As the Water Linked extension of `BlueOS` sends.
const EXTENSION: Sender = Sender {
    system: 255,
    component: 0,
};

/// Milliseconds after the vehicle booted, on the host.
fn at(boot_ms: u32) -> Timestamp {
    Timestamp::from_millis(1_700_000_000_000 + i64::from(boot_ms))
}

fn attitude(boot_ms: u32, yaw_rad: f64) -> Message {
    Message::Attitude {
        boot_ms,
        ned_from_frd: ned_from_frd(0.0, 0.0, yaw_rad),
        is_quaternion: true,
    }
}

fn global(boot_ms: u32, height_m: f64, velocity_ned_mps: DVec3) -> Message {
    Message::GlobalPosition {
        boot_ms,
        fix: Fix {
            latitude_e7: 0,
            longitude_e7: 0,
            height_mm: 0,
        },
        height_m,
        velocity_ned_mps,
    }
}

fn local(boot_ms: u32, ned_m: [f64; 3]) -> Message {
    Message::Position {
        boot_ms,
        position_ned_m: DVec3::from_array(ned_m),
        velocity_ned_mps: DVec3::ZERO,
    }
}

/// What moved in 120 ms, forward, right, down.
fn delta(moved_frd_m: DVec3, confidence: f64) -> Message {
    Message::PositionDelta {
        time_us: 0,
        delta_us: 120_000,
        moved_frd_m,
        confidence,
    }
}

/// A vehicle on a link, heading east at 0.5 m/s, 5 m deep.
struct Talk {
    fleet: Fleet,
    poses: Vec<ArrivedPose>,
}

impl Talk {
    fn new(has_dvl: bool) -> Self {
        let mut fleet = Fleet::new(StampClock::Host, Only::default(), has_dvl);
        fleet.take(ROV, Message::Heartbeat(Station::Autopilot), at(0), |_| {});
        let poses = Vec::new();
        Self { fleet, poses }
    }

    fn say(&mut self, sender: Sender, message: Message, boot_ms: u32) {
        let poses = &mut self.poses;
        self.fleet
            .take(sender, message, at(boot_ms), |pose| poses.push(pose));
    }

    /// Attitude and height from and to so many milliseconds, and what `others` say every 120.
    fn go_on(&mut self, from_ms: u32, to_ms: u32, mut others: impl FnMut(&mut Self, u32)) {
        for boot_ms in (from_ms..to_ms).step_by(20) {
            self.say(ROV, attitude(boot_ms, std::f64::consts::FRAC_PI_2), boot_ms);
            if boot_ms % 120 == 0 {
                others(self, boot_ms);
            }
        }
    }

    fn last_m(&self) -> DVec3 {
        let last = self.poses.last().unwrap();
        last.pose.world_from_vehicle.translation_m
    }

    fn epochs(&self) -> Vec<u32> {
        let mut epochs: Vec<u32> = self.poses.iter().map(|pose| pose.pose.epoch).collect();
        epochs.dedup();
        epochs
    }
}

fn by_extension(talk: &mut Talk, boot_ms: u32) {
    talk.say(EXTENSION, delta(DVec3::new(0.06, 0.0, 0.0), 80.0), boot_ms);
    talk.say(ROV, global(boot_ms, -5.0, DVec3::ZERO), boot_ms);
}

#[test]
fn attitude_what_the_dvl_extension_sends_and_depth_make_poses() {
    let mut talk = Talk::new(false);
    talk.go_on(0, 20_000, by_extension);
    let first = &talk.poses[0].pose;
    let last = &talk.poses.last().unwrap().pose;
    // None is lost while it was not clear yet whether positions come.
    assert!(first.time.seconds_since(at(0)) < 0.3);
    let passed_s = last.time.seconds_since(first.time);
    let moved_m = talk.last_m() - first.world_from_vehicle.translation_m;
    assert!(
        (moved_m - DVec3::X * 0.5 * passed_s).length() < 0.01,
        "{moved_m}"
    );
    assert!((talk.last_m().z + 5.0).abs() < 1e-9);
    assert!((last.world_from_vehicle.rotation * DVec3::X - DVec3::X).length() < 1e-9);
    assert!(last.uncertainty.is_some());
    let how = talk.fleet.reckons().unwrap();
    assert!(
        how.contains("VISION_POSITION_DELTA") && how.contains("GLOBAL_POSITION_INT"),
        "{how}"
    );
    let status = talk.fleet.status(at(20_000));
    assert_eq!(
        (status.missing, status.lacks_north, status.origin),
        (None, false, None)
    );
    assert_eq!(status.accepted, talk.poses.len() as u64);
}

#[test]
fn each_message_that_tells_a_velocity_is_read_along_its_axes() {
    let odometry = |child_frame, velocity_mps| {
        Message::Odometry(Box::new(Odometry {
            time_us: 0,
            frame: 1,
            child_frame,
            position_m: DVec3::NAN,
            frame_from_body: DQuat::IDENTITY,
            velocity_mps,
            covariance: [f64::NAN; 21],
            reset_counter: 0,
            quality: 0,
        }))
    };
    let speed = |velocity_mps| Message::Speed {
        time_us: 0,
        velocity_mps,
    };
    let companion = Sender {
        system: 1,
        component: 191,
    };
    let (body_frd, local_ned) = (12, 1);
    // 0.3 m/s east and 0.1 m/s down of a vehicle that heads east.
    let (frd, ned) = (DVec3::new(0.3, 0.0, 0.1), DVec3::new(0.0, 0.3, 0.1));
    for (sender, message) in [
        (EXTENSION, delta(frd * 0.12, 50.0)),
        (companion, delta(frd * 0.12, 50.0)),
        (companion, speed(ned)),
        (EXTENSION, speed(frd)),
        (companion, odometry(body_frd, frd)),
        (ROV, odometry(local_ned, ned)),
    ] {
        let mut talk = Talk::new(false);
        talk.go_on(0, 10_000, |talk, boot_ms| {
            talk.say(sender, message.clone(), boot_ms);
        });
        let first_m = talk.poses[0].pose.world_from_vehicle.translation_m;
        let moved_m = talk.last_m() - first_m;
        let slope = moved_m / moved_m.x;
        let expected = DVec3::new(1.0, 0.0, -1.0 / 3.0);
        assert!(
            (slope - expected).length() < 1e-6,
            "{sender} {message:?}: {moved_m}"
        );
        assert!((2.8..3.0).contains(&moved_m.x), "{moved_m}");
    }
}

#[test]
fn the_autopilots_own_velocity_is_taken_while_its_estimate_has_one() {
    let talk_of = |has_velocity| {
        let mut talk = Talk::new(false);
        talk.say(ROV, Message::EstimateStatus { has_velocity }, 0);
        talk.go_on(0, 10_000, |talk, boot_ms| {
            talk.say(
                ROV,
                global(boot_ms, -2.0, DVec3::new(0.0, 0.2, 0.0)),
                boot_ms,
            );
        });
        talk
    };
    assert!((talk_of(true).last_m() - DVec3::new(1.96, 0.0, -2.0)).length() < 0.1);
    let held = talk_of(false);
    assert!(held.poses.is_empty());
    assert!(held.fleet.status(at(10_000)).missing.is_some());
}

#[test]
fn positions_win_and_going_from_one_to_the_other_is_an_epoch() {
    let mut talk = Talk::new(false);
    // Positions come after two seconds: nothing was reckoned.
    talk.go_on(0, 2_000, by_extension);
    let both = |talk: &mut Talk, boot_ms: u32| {
        talk.say(ROV, local(boot_ms, [7.0, 8.0, 9.0]), boot_ms);
        by_extension(talk, boot_ms);
    };
    talk.go_on(2_000, 10_000, both);
    assert!(
        talk.poses
            .iter()
            .all(|pose| pose.pose.uncertainty.is_none())
    );
    assert_eq!(talk.last_m(), DVec3::new(8.0, 7.0, -9.0));
    assert_eq!((talk.epochs(), talk.fleet.reckons()), (vec![0], None));
    // They stop, and come again before it is clear that they are gone.
    talk.go_on(10_000, 30_000, by_extension);
    talk.go_on(30_000, 32_000, both);
    assert_eq!(talk.epochs(), [0]);
    talk.go_on(32_000, 80_000, by_extension);
    assert_eq!(talk.epochs(), [0, 1]);
    assert!(talk.last_m().x < 10.0 && talk.fleet.reckons().is_some());
    // The first that comes ends it.
    talk.go_on(80_000, 90_000, both);
    assert_eq!(talk.epochs(), [0, 1, 2]);
    assert_eq!(
        (talk.last_m(), talk.fleet.reckons()),
        (DVec3::new(8.0, 7.0, -9.0), None)
    );
}

#[test]
fn positions_that_come_and_go_do_not_make_maps_by_the_dozen() {
    let mut talk = Talk::new(false);
    for round in 0..20 {
        let from_ms = round * 12_000;
        talk.go_on(from_ms, from_ms + 2_000, |talk, boot_ms| {
            talk.say(ROV, local(boot_ms, [7.0, 8.0, 9.0]), boot_ms);
            by_extension(talk, boot_ms);
        });
        talk.go_on(from_ms + 2_000, from_ms + 12_000, by_extension);
    }
    assert_eq!(talk.epochs(), [0]);
}

#[test]
fn after_a_gap_that_is_too_long_a_new_epoch_begins_and_the_gap_is_told() {
    let mut talk = Talk::new(false);
    let blind = |talk: &mut Talk, boot_ms: u32| {
        // The extension sends nothing then; others may say that they saw nothing.
        talk.say(EXTENSION, delta(DVec3::ZERO, 0.0), boot_ms);
    };
    talk.go_on(0, 10_000, by_extension);
    talk.go_on(10_000, 15_000, blind);
    talk.go_on(15_000, 25_000, by_extension);
    assert_eq!(talk.epochs(), [0], "five seconds are bridged");
    talk.go_on(25_000, 40_000, blind);
    let missing = talk.fleet.status(at(40_000)).missing.unwrap();
    assert!(
        missing.contains("15 s") && missing.contains("bottom"),
        "{missing}"
    );
    talk.go_on(40_000, 50_000, by_extension);
    assert_eq!(talk.epochs(), [0, 1]);
    assert_eq!(talk.fleet.status(at(50_000)).missing, None);
}

#[test]
fn of_two_who_tell_a_velocity_the_better_is_used_until_it_is_silent() {
    let mut talk = Talk::new(false);
    let estimate = |talk: &mut Talk, boot_ms: u32| {
        talk.say(ROV, Message::EstimateStatus { has_velocity: true }, boot_ms);
        talk.say(
            ROV,
            global(boot_ms, -5.0, DVec3::new(0.0, -0.5, 0.0)),
            boot_ms,
        );
    };
    talk.go_on(0, 20_000, |talk, boot_ms| {
        estimate(talk, boot_ms);
        talk.say(EXTENSION, delta(DVec3::new(0.06, 0.0, 0.0), 80.0), boot_ms);
    });
    let east_m = talk.last_m().x;
    assert!(east_m > 9.0, "{east_m}");
    talk.go_on(20_000, 40_000, estimate);
    let how = talk.fleet.reckons().unwrap();
    assert!(how.contains("velocity of GLOBAL_POSITION_INT"), "{how}");
}

#[test]
fn a_dvl_that_the_url_names_is_used_and_nobody_else() {
    let mut talk = Talk::new(true);
    talk.go_on(0, 8_000, by_extension);
    assert!(talk.poses.is_empty());
    let missing = talk.fleet.status(at(8_000)).missing.unwrap();
    assert!(missing.contains("the DVL that pose.url names"), "{missing}");
    talk.go_on(8_000, 20_000, |talk, boot_ms| {
        by_extension(talk, boot_ms);
        let told = Told {
            teller: Teller::Dvl,
            sender: Sender::default(),
            // Its clock was switched on elsewhen; it was true 50 ms before it was sent.
            stamp: Stamp::Own(i64::from(boot_ms) * 1_000_000 + 77_000_000_000),
            before_s: 0.05,
            axes: Axes::Vehicle,
            mps: DVec3::X * 0.25,
        };
        let poses = &mut talk.poses;
        talk.fleet
            .moves(&told, at(boot_ms), |pose| poses.push(pose));
    });
    let passed_s = talk
        .poses
        .last()
        .unwrap()
        .pose
        .time
        .seconds_since(talk.poses[0].pose.time);
    let moved_m = talk.last_m() - talk.poses[0].pose.world_from_vehicle.translation_m;
    assert!((moved_m.x - 0.25 * passed_s).abs() < 0.01, "{moved_m}");
}

#[test]
fn another_vehicles_velocity_is_not_taken() {
    let mut talk = Talk::new(false);
    let other = Sender {
        system: 2,
        component: 1,
    };
    talk.say(other, Message::Heartbeat(Station::Autopilot), 0);
    let of_other = Sender {
        system: 2,
        component: 191,
    };
    talk.go_on(0, 8_000, |talk, boot_ms| {
        talk.say(of_other, delta(DVec3::new(0.06, 0.0, 0.0), 80.0), boot_ms);
    });
    assert!(talk.poses.is_empty());
}

#[test]
fn attitude_and_depth_alone_are_told_with_what_would_do() {
    let mut talk = Talk::new(false);
    talk.go_on(0, 8_000, |talk, boot_ms| {
        talk.say(ROV, Message::Height(-4.0), boot_ms);
    });
    assert!(talk.poses.is_empty());
    let missing = talk.fleet.status(at(8_000)).missing.unwrap();
    for told in ["no velocity over ground", "not mapped", "?velocity=dvl://"] {
        assert!(missing.contains(told), "{missing}");
    }
}

#[test]
fn what_is_no_velocity_is_counted_and_changes_nothing() {
    let mut talk = Talk::new(false);
    talk.go_on(0, 10_000, |talk, boot_ms| {
        by_extension(talk, boot_ms);
        talk.say(
            EXTENSION,
            delta(DVec3::new(f64::NAN, 0.0, 0.0), 80.0),
            boot_ms,
        );
        talk.say(EXTENSION, delta(DVec3::new(9.0, 0.0, 0.0), 80.0), boot_ms);
        talk.say(ROV, Message::Height(f64::INFINITY), boot_ms);
    });
    let status = talk.fleet.status(at(10_000));
    assert!(
        status.not_finite > 50 && status.malformed > 50,
        "{status:?}"
    );
    assert!(
        talk.poses
            .iter()
            .all(|pose| pose.pose.world_from_vehicle.translation_m.is_finite())
    );
    assert!((talk.last_m().x - 4.8).abs() < 0.2, "{}", talk.last_m());
}

#[test]
fn a_depth_that_is_always_nought_is_no_sensor() {
    let mut talk = Talk::new(false);
    talk.go_on(0, 10_000, |talk, boot_ms| {
        talk.say(
            EXTENSION,
            delta(DVec3::new(0.06, 0.0, 0.012), 80.0),
            boot_ms,
        );
        talk.say(ROV, global(boot_ms, 0.0, DVec3::ZERO), boot_ms);
    });
    assert!((talk.last_m().z + 0.98).abs() < 0.05, "{}", talk.last_m());
    assert!(talk.fleet.reckons().unwrap().contains("no depth sensor"));
}

#[test]
fn a_servers_json_tells_the_same() {
    let read = |text: &str| json::parse(text.as_bytes()).unwrap().unwrap().1;
    let told = read(
        r#"{"header":{"system_id":255,"component_id":0},"message":{"type":"VISION_POSITION_DELTA","time_usec":0,
        "time_delta_usec":120000,"angle_delta":[0,0,0],"position_delta":[0.5,0,0.25],"confidence":80}}"#,
    );
    assert_eq!(told, delta(DVec3::new(0.5, 0.0, 0.25), 80.0));
    let told = read(
        r#"{"message":{"type":"GLOBAL_POSITION_INT","time_boot_ms":7,"lat":0,"lon":0,"alt":0,"relative_alt":-2500,
        "vx":20,"vy":-10,"vz":0,"hdg":0}}"#,
    );
    assert_eq!(told, global(7, -2.5, DVec3::new(0.2, -0.1, 0.0)));
    assert_eq!(
        read(r#"{"message":{"type":"VFR_HUD","alt":-3.5}}"#),
        Message::Height(-3.5)
    );
    for (flags, has_velocity) in [
        ("831", true),
        (r#"{"bits":831}"#, true),
        (r#""EKF_ATTITUDE | EKF_VELOCITY_HORIZ""#, true),
        ("421", false),
        (r#""EKF_VELOCITY_HORIZ | EKF_CONST_POS_MODE""#, false),
    ] {
        let text = format!(r#"{{"message":{{"type":"EKF_STATUS_REPORT","flags":{flags}}}}}"#);
        assert_eq!(
            read(&text),
            Message::EstimateStatus { has_velocity },
            "{flags}"
        );
    }
}
