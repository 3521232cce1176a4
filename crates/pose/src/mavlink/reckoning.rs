//! What a vehicle without positions tells of its way: whose velocities and heights are taken, and when they were true.
//!
//! Read are, the best first: the `velocity` of a DVL that the URL names; `VISION_POSITION_DELTA`, which the Water Linked
//! extension of `BlueOS` sends to the autopilot; `VISION_SPEED_ESTIMATE`; `ODOMETRY` without a position; and the velocity in
//! `GLOBAL_POSITION_INT` while `EKF_STATUS_REPORT` says that it is one. Height is `relative_alt` of `GLOBAL_POSITION_INT`, which
//! `ArduSub` takes from its depth sensor, stamps and gives in millimetres, else `alt` of `VFR_HUD`, the same without a stamp.
//! `AHRS2` tells nothing more, and `SCALED_PRESSURE2` leaves out what the surface's pressure and the water's density are.

use echosplat_model::Timestamp;
use echosplat_model::glam::DQuat;

use super::message::Sender;
use super::told::{Stamp, Teller, Told};
use crate::clock::LeastDelay;
use crate::fault::Fault;
use crate::reckon::{BRIDGED_S, Reckoned, Reckoner, Velocity};

/// Seconds; assumed.
/// Attitude and velocity have to come for so long, and no position meanwhile, before positions are reckoned.
const AWAITED_S: f64 = 5.0;
/// Seconds; assumed.
/// Where positions were used, none has to come for so long: each change begins a map of its own.
pub(super) const POSITION_LOST_S: f64 = 30.0;
/// Seconds, more than any gap that is bridged.
/// A source of velocities that is silent for so long gives way to a worse one.
const SILENT_S: f64 = 10.0;
/// Seconds; assumed.
/// Heights of `VFR_HUD` are taken where no better ones have come for so long.
const BETTER_HEIGHT_S: f64 = 3.0;
/// With attitude alone nothing can be mapped.
const NO_POSITION: &str = "the vehicle sends attitude but no position and no velocity over ground, and pings are recorded but \
                           not mapped; a DVL gives one: add ?velocity=dvl://ADDRESS to pose.url, or have the autopilot's EKF \
                           fuse it, visual SLAM or underwater GPS, with the EKF's origin set (SET_GPS_GLOBAL_ORIGIN)";
/// Nor with a DVL that tells nothing.
const NO_DVL: &str = "the vehicle sends attitude but no position, and the DVL that pose.url names tells no velocity over ground; \
                      pings are recorded but not mapped; the DVL has to see the bottom (0.05 to 50 m away), and to report \
                      time_of_validity (json_v3)";

/// Whose velocities are taken.
#[derive(Debug)]
struct Used {
    teller: Teller,
    sender: Sender,
    /// When the first and the newest of them came.
    first: Timestamp,
    newest: Timestamp,
    /// Of its own clock.
    delay: LeastDelay,
}

/// Reckons for one vehicle. Times are on its clock since boot.
#[derive(Debug)]
pub(crate) struct Reckoning {
    reckoner: Reckoner,
    /// Of the vehicle's own clock.
    delay: LeastDelay,
    used: Option<Used>,
    /// When the better of both heights came.
    height_at: Option<Timestamp>,
    /// The name of the message that height is taken from, once it was other than 0: an autopilot without a depth sensor tells 0.
    height: Option<&'static str>,
    /// Whether the autopilot's estimate has a velocity.
    has_estimate: bool,
    /// Whether nobody's velocities but a DVL's on a connection of its own are taken.
    keeps_to_dvl: bool,
}

impl Reckoning {
    /// Poses wait for so long, seconds: `LIVE_PATIENCE_S` or `LOG_PATIENCE_S`.
    pub(crate) fn new(patience_s: f64) -> Self {
        Self {
            reckoner: Reckoner::new(patience_s),
            delay: LeastDelay::default(),
            used: None,
            height_at: None,
            height: None,
            has_estimate: false,
            keeps_to_dvl: false,
        }
    }

    /// The URL names a DVL: nobody else's velocities are taken.
    pub(crate) fn keep_to_dvl(&mut self) {
        self.keeps_to_dvl = true;
    }

    /// The vehicle booted.
    pub(crate) fn forget(&mut self) {
        self.reckoner.restart();
        self.delay = LeastDelay::default();
        self.height_at = None;
    }

    /// The world begins anew.
    pub(crate) fn begin(&mut self) {
        self.reckoner.restart();
    }

    /// Takes an attitude: forward-left-up to east-north-up.
    pub(crate) fn attitude(&mut self, boot: i64, rotation: DQuat, arrived: Timestamp) {
        self.delay.observe(boot, arrived);
        self.reckoner
            .attitude(Timestamp::from_nanos(boot), rotation);
    }

    /// What `EKF_STATUS_REPORT` says.
    pub(crate) fn estimates(&mut self, has_velocity: bool) {
        self.has_estimate = has_velocity;
    }

    /// Takes a velocity, if it is of the best source that is heard.
    ///
    /// # Errors
    /// If it cannot be one.
    pub(crate) fn velocity(&mut self, told: &Told, arrived: Timestamp) -> Result<(), Fault> {
        if told.teller == Teller::Estimate && !self.has_estimate || !self.is_best(told, arrived) {
            return Ok(());
        }
        let Some(used) = &mut self.used else {
            return Ok(());
        };
        used.newest = arrived;
        let boot = match told.stamp {
            Stamp::Boot(boot) => Some(boot),
            Stamp::Arrival => of_arrival(&self.delay, arrived.nanos()),
            Stamp::Own(own) => {
                used.delay.observe(own, arrived);
                let offset = used.delay.offset_at(own).unwrap_or(0);
                of_arrival(&self.delay, own.saturating_add(offset))
            }
        };
        // Without an attitude so far it can be turned into no world.
        let Some(boot) = boot else { return Ok(()) };
        let velocity = Velocity {
            time: Timestamp::from_nanos(boot).offset_by(-told.before_s),
            axes: told.axes,
            mps: told.mps,
        };
        self.reckoner.velocity(told.teller.name(), velocity)
    }

    /// Whether nobody better is heard; who tells it is used from now on.
    fn is_best(&mut self, told: &Told, arrived: Timestamp) -> bool {
        if self.keeps_to_dvl && told.teller != Teller::Dvl {
            return false;
        }
        if let Some(used) = &self.used {
            let is_same = (used.teller, used.sender) == (told.teller, told.sender);
            let is_silent = arrived.seconds_since(used.newest).abs() > SILENT_S;
            if is_same && !is_silent {
                return true;
            }
            if !is_silent && used.teller >= told.teller {
                return false;
            }
        }
        self.used = Some(Used {
            teller: told.teller,
            sender: told.sender,
            first: arrived,
            newest: arrived,
            delay: LeastDelay::default(),
        });
        true
    }

    /// Takes a height above the surface, metres; one without a stamp only where none with one comes.
    ///
    /// # Errors
    /// If it is of no sea.
    pub(crate) fn height(
        &mut self,
        name: &'static str,
        boot: Option<i64>,
        z_m: f64,
        arrived: Timestamp,
    ) -> Result<(), Fault> {
        let is_within = |at: Timestamp| arrived.seconds_since(at).abs() <= BETTER_HEIGHT_S;
        let is_worse = boot.is_none() && self.height_at.is_some_and(is_within);
        if is_worse || self.height.is_none() && z_m == 0.0 {
            return Ok(());
        }
        if boot.is_some() {
            self.height_at = Some(arrived);
        }
        self.height = Some(name);
        match boot.or_else(|| of_arrival(&self.delay, arrived.nanos())) {
            Some(boot) => self.reckoner.height(name, Timestamp::from_nanos(boot), z_m),
            None => Ok(()),
        }
    }

    /// The poses made by now.
    pub(crate) fn take(&mut self) -> impl Iterator<Item = Reckoned> {
        self.reckoner.take()
    }

    /// Whether velocities have come for long enough to begin with, and still do.
    pub(crate) fn is_ready(&self, now: Timestamp) -> bool {
        let lasts = |used: &Used| used.newest.seconds_since(used.first) >= AWAITED_S;
        self.used.as_ref().is_some_and(lasts) && self.silent_s(now).is_some_and(|s| s <= 1.0)
    }

    /// Since when the newest velocity came, seconds; `None` if none ever did.
    pub(crate) fn silent_s(&self, now: Timestamp) -> Option<f64> {
        let used = self.used.as_ref()?;
        Some(now.seconds_since(used.newest).abs())
    }

    /// What positions are made of, in words.
    pub(crate) fn in_words(&self) -> String {
        let velocity = self.used.as_ref().map_or("", |used| used.teller.name());
        let height = match self.height {
            Some(name) => format!("height by {name}"),
            None => "no depth sensor, height by the velocity too".to_owned(),
        };
        format!("positions are reckoned from attitude and {velocity}, {height}")
    }

    /// What lacks for poses where no position comes, nor a velocity.
    pub(crate) fn lacks_all(&self) -> &'static str {
        match self.keeps_to_dvl {
            true => NO_DVL,
            false => NO_POSITION,
        }
    }

    /// What lacks for poses once they were reckoned.
    pub(crate) fn missing(&self, now: Timestamp) -> Option<String> {
        let used = self.used.as_ref()?;
        let silent_s = self
            .silent_s(now)
            .filter(|silent_s| *silent_s > BRIDGED_S)?;
        Some(format!(
            "positions are reckoned, and no velocity over ground has come for {silent_s:.0} s (from {}): the DVL has to see \
             the bottom; a new map begins once it does",
            used.teller.name()
        ))
    }
}

/// Time since boot of what was at this time on the host's clock.
fn of_arrival(delay: &LeastDelay, host: i64) -> Option<i64> {
    // The offset moves by no more than drift between the newest attitude and now.
    let near = host.saturating_sub(delay.offset_at(0)?);
    Some(host.saturating_sub(delay.offset_at(near)?))
}
