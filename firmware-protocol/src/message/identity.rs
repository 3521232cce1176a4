//! 4 `device_information`, 5 `protocol_version`: what a device says it is.
//!
//! | offset | 4 | 5 |
//! |---|---|---|
//! | 0 | u8 device_type | u8 major |
//! | 1 | u8 device_revision | u8 minor |
//! | 2 | u8 firmware major | u8 patch |
//! | 3 | u8 firmware minor | reserved |
//! | 4 | u8 firmware patch | |
//! | 5 | reserved | |

/// Payload of 4.
pub(crate) const PAYLOAD_BYTES: usize = 6;
/// Payload of 5.
pub(crate) const VERSION_PAYLOAD_BYTES: usize = 4;

mod field {
    use crate::wire::Field;

    pub(super) const DEVICE_TYPE: usize = 0;
    pub(super) const DEVICE_REVISION: usize = 1;
    pub(super) const FIRMWARE: Field = 2..5;
    pub(super) const FIRMWARE_RESERVED: usize = 5;

    pub(super) const VERSION: Field = 0..3;
    pub(super) const VERSION_RESERVED: usize = 3;
}

/// What a device is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceInformation {
    /// 101 in the vendor's list, 104 on a real `OmniScan` 450 FS.
    pub device_type: u8,
    /// Hardware revision.
    pub device_revision: u8,
    /// Firmware version: major, minor, patch.
    pub firmware: [u8; 3],
}

/// Version of the Ping protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProtocolVersion {
    /// Major, minor, patch.
    pub version: [u8; 3],
}

impl DeviceInformation {
    pub(super) fn parse(payload: &[u8]) -> Self {
        Self {
            device_type: payload[field::DEVICE_TYPE],
            device_revision: payload[field::DEVICE_REVISION],
            firmware: triple(&payload[field::FIRMWARE]),
        }
    }

    pub(super) fn emit(&self, payload: &mut [u8]) {
        payload[field::DEVICE_TYPE] = self.device_type;
        payload[field::DEVICE_REVISION] = self.device_revision;
        payload[field::FIRMWARE].copy_from_slice(&self.firmware);
        payload[field::FIRMWARE_RESERVED] = 0;
    }
}

impl ProtocolVersion {
    pub(super) fn parse(payload: &[u8]) -> Self {
        Self {
            version: triple(&payload[field::VERSION]),
        }
    }

    pub(super) fn emit(&self, payload: &mut [u8]) {
        payload[field::VERSION].copy_from_slice(&self.version);
        payload[field::VERSION_RESERVED] = 0;
    }
}

fn triple(bytes: &[u8]) -> [u8; 3] {
    [bytes[0], bytes[1], bytes[2]]
}
