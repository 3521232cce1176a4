//! Message ids.

/// Empty; a real unit sends it now and then.
pub const NOP: u16 = 0;
/// A request was carried out.
pub const ACK: u16 = 1;
/// A request was refused, and why.
pub const NACK: u16 = 2;
/// Free text.
pub const ASCII_TEXT: u16 = 3;
/// Device type, revision and firmware version.
pub const DEVICE_INFORMATION: u16 = 4;
/// Version of the Ping protocol the device speaks.
pub const PROTOCOL_VERSION: u16 = 5;
/// Asks for one message of the named id.
pub const GENERAL_REQUEST: u16 = 6;
/// Wraps a JSON text; a log begins with one.
pub const JSON: u16 = 10;
/// View configuration of the vendor's log viewer; only in logs.
pub const VIEW_CONFIGURATION: u16 = 12;
/// Sets the device's id on its bus.
pub const SET_DEVICE_ID: u16 = 100;
/// Wraps NMEA 0183 text; only in logs.
pub const NMEA: u16 = 109;
/// Sets the speed of sound. Was 1002 in older documents, which a real unit refuses.
pub const SET_SPEED_OF_SOUND: u16 = 116;
/// Wraps one `MAVLink` message as JSON; only in logs.
pub const MAVLINK: u16 = 150;
/// Which of how many synchronised units this is.
pub const SYNC_CHANNEL_NUMBER: u16 = 169;
/// Sets what [`SYNC_CHANNEL_NUMBER`] tells.
pub const SET_SYNC_CHANNEL_NUMBER: u16 = 170;
/// Undocumented, about once a second.
pub const STATUS: u16 = 2194;
/// Ping settings, and the switch that starts and stops pinging.
pub const OS_PING_PARAMS: u16 = 2197;
/// One profile: received power over range.
pub const OS_MONO_PROFILE: u16 = 2198;
