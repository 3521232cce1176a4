//! Whether one DVL reports on a connection, or two whose reports a relay has merged.
//!
//! Nothing in a report says which device sent it. But each goes on from its own report before, in its clock and in its
//! place; where two such tracks take turns again and again, there are two devices. A reset, a clock that is set and a
//! device that boots begin a new track once, and the old one does not come back.

use echosplat_model::Timestamp;
use echosplat_model::glam::DVec3;

/// Tracks followed.
const MOST: usize = 4;
/// A track without a report for so long has ended, seconds.
const ENDED_AFTER_S: f64 = 3.0;
/// Both tracks have to come back so often, the other having spoken meanwhile.
const RETURNS: u32 = 3;
/// Time on the device's clock and time of arrival may differ by so much between two reports, seconds.
const UNEVEN_S: f64 = 1.0;
/// Farther than this no vehicle gets between two reports: metres, and metres a second.
const NEAR_M: f64 = 0.3;
const FASTEST_MPS: f64 = 2.0;

/// Reports of one device, as far as they go on from one another.
#[derive(Debug, Clone, Copy)]
struct Device {
    id: u64,
    stamp_s: f64,
    position_m: DVec3,
    arrived: Timestamp,
    returns: u32,
}

impl Device {
    /// How far off the place is at which it would go on; `None` if it does not.
    fn goes_on(&self, stamp_s: f64, position_m: DVec3, arrived: Timestamp) -> Option<f64> {
        let passed_s = arrived.seconds_since(self.arrived).max(0.0);
        let advance_s = stamp_s - self.stamp_s;
        let off_m = self.position_m.distance(position_m);
        let goes_on = (advance_s - passed_s).abs() <= UNEVEN_S
            && off_m <= NEAR_M + FASTEST_MPS * passed_s.max(advance_s.abs());
        goes_on.then_some(off_m)
    }
}

/// What becomes of a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Judged {
    /// It is used.
    Used,
    /// It is used, and nothing of what came before it is its device's for certain.
    First,
    /// Another device's.
    LeftOut,
}

/// The devices of one connection.
#[derive(Debug, Default)]
pub(super) struct Devices {
    /// The oldest first: that one is used.
    devices: Vec<Device>,
    /// Of the newest report.
    last: Option<u64>,
    /// The one used, while there are two.
    used: Option<u64>,
    /// Another is used from its next report on.
    begins: bool,
    count: u64,
    left_out: u64,
}

impl Devices {
    /// Judges a position report.
    pub(super) fn position(
        &mut self,
        stamp_s: f64,
        position_m: DVec3,
        arrived: Timestamp,
    ) -> Judged {
        let has_ended =
            |device: &Device| arrived.seconds_since(device.arrived).abs() > ENDED_AFTER_S;
        self.devices.retain(|device| !has_ended(device));
        let speaker = self.speaker(stamp_s, position_m, arrived);
        let first = self.devices.first().map(|device| device.id);
        let used = first.filter(|_| self.take_turns());
        let before = std::mem::replace(&mut self.used, used);
        self.begins |= match (before, used) {
            (before, Some(_)) => before != used,
            (Some(before), None) => before != speaker,
            (None, None) => false,
        };
        if used.is_some_and(|used| used != speaker) {
            self.left_out += 1;
            return Judged::LeftOut;
        }
        match std::mem::take(&mut self.begins) {
            true => Judged::First,
            false => Judged::Used,
        }
    }

    /// The device that goes on with this report; it is a new one if none does.
    fn speaker(&mut self, stamp_s: f64, position_m: DVec3, arrived: Timestamp) -> u64 {
        let all = self.devices.iter().enumerate();
        let going_on = all.filter_map(|(index, device)| {
            Some((index, device.goes_on(stamp_s, position_m, arrived)?))
        });
        let nearest = going_on.min_by(|a, b| a.1.total_cmp(&b.1));
        let mut device = Device {
            id: self.count,
            stamp_s,
            position_m,
            arrived,
            returns: 0,
        };
        if let Some((index, _)) = nearest {
            let place = &mut self.devices[index];
            let returns = u32::from(self.last != Some(place.id));
            (device.id, device.returns) = (place.id, place.returns + returns);
            *place = device;
        } else {
            self.count += 1;
            self.devices.truncate(MOST - 1);
            self.devices.push(device);
        }
        self.last = Some(device.id);
        device.id
    }

    fn take_turns(&self) -> bool {
        let returning = self
            .devices
            .iter()
            .filter(|device| device.returns >= RETURNS);
        returning.count() > 1
    }

    /// Whether a velocity may be used: with two devices nothing says whose it is.
    pub(super) fn uses_velocities(&self) -> bool {
        self.used.is_none()
    }

    /// Reports of other devices, left out.
    pub(super) fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Whose reports are used and whose not, if there are two: what tells the devices apart.
    pub(super) fn names(&self) -> Vec<String> {
        let name = |device: &Device| {
            let [x, y, z] = device.position_m.to_array();
            format!(
                "DVL whose clock is at {:.1} s and position at {x:.1}, {y:.1}, {z:.1} m",
                device.stamp_s
            )
        };
        let all = self.devices.iter().filter(|_| self.used.is_some());
        all.map(name).collect()
    }

    /// What to do about two, in a sentence.
    pub(super) fn advice(&self) -> Option<String> {
        let [used, other] = self.devices.get(..2).filter(|_| self.used.is_some())? else {
            return None;
        };
        Some(format!(
            "two DVLs report on the same connection, {:.1} m apart; the one whose clock is at {:.1} s is used, {} reports of \
             the other are left out: connect to the DVL that is on the sonar's vehicle, dvl://ADDRESS, and not to what \
             merges the two",
            used.position_m.distance(other.position_m),
            used.stamp_s,
            self.left_out
        ))
    }
}
