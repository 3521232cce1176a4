//! What a driver tells: events in order, and its status at any time.

use std::sync::Arc;

use bytes::Bytes;
use echosplat_firmware_protocol::DeviceInformation;
use echosplat_model::Ping;
use echosplat_session::{SessionCounters, UnitHeard};
use serde::Serialize;

use crate::path::PingPath;

/// What happened, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum DriverEvent {
    /// One ping.
    Ping {
        /// Checked, on the clock asked for.
        ping: Arc<Ping>,
        /// The whole Ping frame it was made of.
        frame: Bytes,
    },
    /// The link is there.
    LinkUp,
    /// The link is gone; it is tried again and again.
    LinkDown {
        /// What the system said, or how long nothing came.
        reason: String,
    },
    /// The device said what it is.
    Identified(DeviceInformation),
    /// Profiles show the settings asked for.
    Configured,
    /// The device was restarted.
    Rebooted,
    /// The clock that pings are on stepped by more than a second.
    ClockStepped,
    /// The device refused a request.
    Nack {
        /// Message id of the request.
        id: u16,
        /// The device's words, cut, with control characters escaped.
        text: String,
    },
    /// Something a person should know, said once or rarely.
    Warning(String),
    /// A tape is at this mark.
    Mark(u64),
    /// A tape goes on where what was recorded of it ends.
    GoesOn,
    /// The log of a `file://` is at its end.
    Ended,
}

/// Where a link stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkState {
    /// Not yet there.
    #[default]
    Connecting,
    /// Bytes can come.
    Up,
    /// Lost; being tried again.
    Down,
    /// The log is at its end.
    Ended,
    /// Stopped as asked.
    Stopped,
}

/// A driver's state, latest value.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct DriverStatus {
    /// Where the link stands.
    pub link: LinkState,
    /// Why the link was last down.
    pub reason: Option<String>,
    /// What came and what became of it.
    pub session: SessionCounters,
    /// Links that came up.
    pub connects: u64,
    /// Links that were lost.
    pub disconnects: u64,
    /// Pings given to the events' channel.
    pub pings_sent: u64,
    /// Pings left out because the channel was full (only on the host's clock).
    pub pings_dropped: u64,
    /// Other events left out because the channel was full.
    pub events_dropped: u64,
    /// Bytes that still came while stopping; neither decoded nor shown to the tap.
    pub bytes_after_stop: u64,
    /// Whether the device was told to stop, and the link took it.
    pub stop_sent: bool,
    /// What the first profile refused says, and what is allowed, as in `speed of sound 0 m/s;
    /// allowed is 1300 to 1700 m/s`.
    pub first_refusal: Option<String>,
    /// The units whose profiles came, the one that is mapped first.
    pub units: Vec<UnitHeard>,
    /// Whether the configuration says which of several units is mapped.
    pub unit_is_chosen: bool,
    /// The product that is connected, if it is known to be no `OmniScan` 450.
    pub other_product: Option<&'static str>,
    /// Seconds since the last byte came, by the host's monotonic clock; `None` before the first.
    /// Bytes without frames are noise, or another baud rate.
    pub since_byte_s: Option<f64>,
    /// Seconds since the last good frame. Frames without profiles: the device lives, and does not
    /// ping.
    pub since_frame_s: Option<f64>,
    /// Seconds since the last profile, whether or not it became a ping.
    pub since_profile_s: Option<f64>,
    /// Seconds since the last ping.
    pub since_ping_s: Option<f64>,
    /// How long pings of a link take to the events' channel; `None` before the first, and of a log.
    pub ping_path_ms: Option<PingPath>,
}
