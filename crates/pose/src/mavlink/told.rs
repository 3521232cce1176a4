//! Velocities as messages tell them: who does, when, and along which axes.

use echosplat_model::glam::DVec3;
use echosplat_model::{enu_from_ned, flu_from_frd};

use super::message::{Message, Sender};
use super::odometry::velocity_of_odometry;
use crate::fault::Fault;
use crate::reckon::Axes;

/// The Water Linked extension of `BlueOS` sends as this, and its `VISION_SPEED_ESTIMATE` along the vehicle's axes, where `MAVLink`
/// means the world's.
const DVL_EXTENSION: Sender = Sender {
    system: 255,
    component: 0,
};

/// Seconds; assumed.
/// What moved over a longer time says little of the velocity in its middle.
const LONGEST_DELTA_S: f64 = 1.0;

/// Who tells a velocity, the worst first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Teller {
    /// `GLOBAL_POSITION_INT`, of the autopilot's estimate.
    Estimate,
    /// `ODOMETRY` without a position.
    Odometry,
    /// `VISION_SPEED_ESTIMATE`.
    Speed,
    /// `VISION_POSITION_DELTA`.
    Delta,
    /// A DVL on a connection of its own.
    Dvl,
}

impl Teller {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Estimate => "the velocity of GLOBAL_POSITION_INT",
            Self::Odometry => "the velocity of ODOMETRY",
            Self::Speed => "VISION_SPEED_ESTIMATE",
            Self::Delta => "VISION_POSITION_DELTA",
            Self::Dvl => "the velocity of the DVL",
        }
    }
}

/// When something was true, as it came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stamp {
    /// Nanoseconds since the vehicle booted.
    Boot(i64),
    /// Nanoseconds on some other clock.
    Own(i64),
    /// None: when it arrived.
    Arrival,
}

/// A velocity as a message tells it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Told {
    pub(crate) teller: Teller,
    /// Who sent the message; of the DVL the default.
    pub(crate) sender: Sender,
    pub(crate) stamp: Stamp,
    /// How long before its stamp it was true, seconds.
    pub(crate) before_s: f64,
    pub(crate) axes: Axes,
    /// Metres a second, with z up.
    pub(crate) mps: DVec3,
}

impl Told {
    /// From what moved during so many microseconds until `time_us`, which is 0 where the sender keeps no clock; metres, forward,
    /// left, up. `None` where nothing was seen, by its confidence in per cent, or over too long or no time.
    pub(crate) fn of_delta(
        sender: Sender,
        (time_us, delta_us): (u64, u64),
        moved_m: DVec3,
        confidence: f64,
    ) -> Option<Self> {
        let delta_s = delta_us as f64 * 1e-6;
        let is_seen = confidence > 0.0 && delta_us > 0 && delta_s <= LONGEST_DELTA_S;
        is_seen.then(|| Self {
            teller: Teller::Delta,
            sender,
            stamp: Stamp::of_us(time_us),
            before_s: 0.5 * delta_s,
            axes: Axes::Vehicle,
            mps: moved_m / delta_s,
        })
    }
}

impl Stamp {
    /// Of a clock of its own; 0 is none.
    pub(crate) fn of_us(time_us: u64) -> Self {
        match i64::try_from(time_us) {
            Ok(0) | Err(_) => Self::Arrival,
            Ok(us) => Self::Own(us.saturating_mul(1_000)),
        }
    }
}

/// The velocity that a message for the autopilot tells, if it does.
///
/// # Errors
/// If its frame is unknown.
pub(super) fn told_of(sender: Sender, message: &Message) -> Result<Option<Told>, Fault> {
    let told = |teller, time_us, axes, mps| Told {
        teller,
        sender,
        stamp: Stamp::of_us(time_us),
        before_s: 0.0,
        axes,
        mps,
    };
    Ok(match message {
        Message::PositionDelta {
            time_us,
            delta_us,
            moved_frd_m,
            confidence,
        } => {
            let moved_m = flu_from_frd(*moved_frd_m);
            Told::of_delta(sender, (*time_us, *delta_us), moved_m, *confidence)
        }
        Message::Speed {
            time_us,
            velocity_mps,
        } if sender == DVL_EXTENSION => {
            let mps = flu_from_frd(*velocity_mps);
            Some(told(Teller::Speed, *time_us, Axes::Vehicle, mps))
        }
        Message::Speed {
            time_us,
            velocity_mps,
        } => {
            let mps = enu_from_ned(*velocity_mps);
            Some(told(Teller::Speed, *time_us, Axes::World, mps))
        }
        Message::Odometry(odometry) => {
            let (axes, mps) = velocity_of_odometry(odometry)?;
            Some(told(Teller::Odometry, odometry.time_us, axes, mps))
        }
        _ => None,
    })
}
