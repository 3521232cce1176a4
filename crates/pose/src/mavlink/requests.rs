//! What a vehicle is told and asked: that we are here, the messages that poses need, and its time.

use echosplat_model::Timestamp;
use mavlink::MavHeader;
use mavlink::dialects::ardupilotmega as dialect;
use mavlink::dialects::ardupilotmega::{MavCmd, MavMessage};

use super::fleet::Fleet;
use super::message::Sender;

/// `MAV_COMP_ID_ONBOARD_COMPUTER3`: not the one that a companion's own programs use.
const COMPONENT: u8 = 193;
/// System of vehicles as they come, used until one was heard.
const DEFAULT_SYSTEM: u32 = 1;

const SYSTEM_TIME: u32 = 2;
const ATTITUDE: u32 = 30;
const ATTITUDE_QUATERNION: u32 = 31;
const LOCAL_POSITION_NED: u32 = 32;
const GLOBAL_POSITION_INT: u32 = 33;
const GPS_GLOBAL_ORIGIN: u32 = 49;
const EKF_STATUS_REPORT: u32 = 193;
const ODOMETRY: u32 = 331;

/// Microseconds between attitudes, positions and odometry: 50 Hz.
const POSE_INTERVAL_US: f32 = 20_000.0;
/// Microseconds between heights, and velocities of a vehicle that sends no position: 10 Hz.
const HEIGHT_INTERVAL_US: f32 = 100_000.0;
/// Microseconds between `SYSTEM_TIME`s, and between what an estimate says of itself.
const TIME_INTERVAL_US: f32 = 1_000_000.0;
/// Microseconds between origins on Earth, which an autopilot may learn in mid-dive.
const ORIGIN_INTERVAL_US: f32 = 5_000_000.0;
const RATE_HZ: u16 = 50;

/// Something that is due again after a while. A clock that was set makes it due, never overdue.
#[derive(Debug, Default)]
struct Due(Option<Timestamp>);

impl Due {
    fn every(&mut self, seconds: f64, now: Timestamp) -> bool {
        let is_due = self
            .0
            .is_none_or(|last| now.seconds_since(last).abs() >= seconds);
        if is_due {
            self.0 = Some(now);
        }
        is_due
    }
}

/// When each was last sent.
#[derive(Debug, Default)]
pub(crate) struct Requests {
    heartbeat: Due,
    time: Due,
    messages: Due,
    /// Rounds of asking for messages.
    round: u32,
    sequence: u8,
}

impl Requests {
    /// Our own header with the next sequence number.
    pub(crate) fn header(&mut self, to: Option<Sender>) -> MavHeader {
        self.sequence = self.sequence.wrapping_add(1);
        MavHeader {
            system_id: to.map_or(DEFAULT_SYSTEM, |to| to.system),
            component_id: COMPONENT,
            sequence: self.sequence,
        }
    }

    /// What is to be sent now.
    pub(crate) fn due(&mut self, fleet: &mut Fleet, now: Timestamp) -> Vec<MavMessage> {
        let mut messages = Vec::new();
        if self.heartbeat.every(1.0, now) {
            messages.push(heartbeat());
        }
        let Some(to) = fleet.to_ask() else {
            return messages;
        };
        if self.time.every(1.0, now) {
            let ts1 = fleet.ask_time(now);
            messages.push(timesync(0, ts1));
        }
        // Each second at first; a vehicle that has none of them is not asked for ever as often.
        let pause_s = if self.round < 10 { 1.0 } else { 10.0 };
        if self.messages.every(pause_s, now) {
            self.ask_for_messages(fleet, to, now, &mut messages);
        }
        messages
    }

    fn ask_for_messages(
        &mut self,
        fleet: &Fleet,
        to: Sender,
        now: Timestamp,
        messages: &mut Vec<MavMessage>,
    ) {
        let wanted = [ATTITUDE_QUATERNION, LOCAL_POSITION_NED, ODOMETRY];
        let missing = wanted.into_iter().filter(|id| !fleet.comes(*id, now));
        let missing: Vec<u32> = missing.collect();
        if self.round.is_multiple_of(10) {
            messages.push(interval(to, SYSTEM_TIME, TIME_INTERVAL_US));
            messages.push(interval(to, GPS_GLOBAL_ORIGIN, ORIGIN_INTERVAL_US));
        }
        // With odometry nothing else is needed, and without it the other two do.
        let has_poses = fleet.comes(ODOMETRY, now) || missing == [ODOMETRY];
        if !has_poses || self.round == 0 {
            let asked = missing.iter().map(|id| interval(to, *id, POSE_INTERVAL_US));
            messages.extend(asked);
        }
        if self.round >= 2 && missing.contains(&ATTITUDE_QUATERNION) && !has_poses {
            messages.push(interval(to, ATTITUDE, POSE_INTERVAL_US));
        }
        if self.round >= 3 && !has_poses {
            // What positions are reckoned from, beside what others tell the vehicle.
            messages.push(interval(to, GLOBAL_POSITION_INT, HEIGHT_INTERVAL_US));
            messages.push(interval(to, EKF_STATUS_REPORT, TIME_INTERVAL_US));
        }
        if self.round == 5 && !has_poses {
            messages.extend(streams(to));
        }
        self.round = self.round.saturating_add(1);
    }
}

/// The answer to a question of the vehicle.
pub(crate) fn timesync_answer(ts1: i64, now: Timestamp) -> MavMessage {
    timesync(now.nanos(), ts1)
}

fn timesync(tc1: i64, ts1: i64) -> MavMessage {
    MavMessage::TIMESYNC(dialect::TIMESYNC_DATA {
        tc1,
        ts1,
        ..Default::default()
    })
}

fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(dialect::HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: dialect::MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: dialect::MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: dialect::MavModeFlag::empty(),
        system_status: dialect::MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

/// `MAV_CMD_SET_MESSAGE_INTERVAL`.
fn interval(to: Sender, message_id: u32, interval_us: f32) -> MavMessage {
    MavMessage::COMMAND_LONG(dialect::COMMAND_LONG_DATA {
        command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
        param1: message_id as f32,
        param2: interval_us,
        target_system: to.system as u8,
        target_component: to.component,
        ..Default::default()
    })
}

/// `REQUEST_DATA_STREAM` of attitude and position, for autopilots that know no intervals.
#[expect(
    deprecated,
    reason = "autopilots that know no intervals know nothing newer"
)]
fn streams(to: Sender) -> impl Iterator<Item = MavMessage> {
    use dialect::MavDataStream as Stream;
    let both = [
        Stream::MAV_DATA_STREAM_EXTRA1,
        Stream::MAV_DATA_STREAM_POSITION,
    ];
    both.into_iter().map(move |stream| {
        MavMessage::REQUEST_DATA_STREAM(dialect::REQUEST_DATA_STREAM_DATA {
            req_message_rate: RATE_HZ,
            target_system: to.system as u8,
            target_component: to.component,
            req_stream_id: stream,
            start_stop: 1,
        })
    })
}
