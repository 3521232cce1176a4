//! What a session tells.

use std::sync::Arc;

use bytes::Bytes;
use echosplat_firmware_protocol::DeviceInformation;
use echosplat_model::Ping;

/// What happened.
#[derive(Debug, Clone, PartialEq)]
pub enum SessionEvent {
    /// The device said what it is.
    Identified(DeviceInformation),
    /// Profiles show the settings asked for.
    Configured,
    /// One ping.
    Ping {
        /// Checked, on the clock asked for.
        ping: Arc<Ping>,
        /// The whole Ping frame it was made of.
        frame: Bytes,
    },
    /// The device was restarted: its numbers and its clock begin anew, sequence and time go on.
    Rebooted,
    /// The clock that pings are on stepped by more than a second: those that follow are on another
    /// time than those before.
    ClockStepped,
    /// The device refused a request. Of many only some are told; the counters have them all.
    Nack {
        /// Message id of the request.
        id: u16,
        /// The device's words, at most 200 characters, with control characters escaped.
        text: String,
    },
    /// Something a person should know, said once, or the device's own words, said rarely.
    Warning(String),
}
