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

use core::fmt;

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
    /// Which product it is: see [`Self::product`].
    pub device_type: u8,
    /// Hardware revision.
    pub device_revision: u8,
    /// Firmware version: major, minor, patch.
    pub firmware: [u8; 3],
}

/// Products by device type, as the vendor's description of message 4 lists them
/// (docs.ceruleansonar.com, *Cerulean Ping Protocol*, `DEVICE_INFORMATION`); besides, 104 is what a
/// real `OmniScan` 450 FS says it is.
const PRODUCTS: [(u8, &str); 7] = [
    (1, "Ping Sonar (Ping1D)"),
    (2, "Ping360"),
    (101, OMNISCAN_450),
    (103, "Surveyor 240-16"),
    (104, OMNISCAN_450),
    (110, "Insight 240"),
    (112, "Sounder S500"),
];
const OMNISCAN_450: &str = "OmniScan 450";

/// Version of the Ping protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProtocolVersion {
    /// Major, minor, patch.
    pub version: [u8; 3],
}

impl DeviceInformation {
    /// The product's name; `None` of a type that no list has.
    #[must_use]
    pub fn product(&self) -> Option<&'static str> {
        let listed = PRODUCTS.iter().find(|(kind, _)| *kind == self.device_type);
        listed.map(|&(_, name)| name)
    }

    /// Whether it is an `OmniScan` 450, of whichever of its types.
    #[must_use]
    pub fn is_omniscan_450(&self) -> bool {
        self.product() == Some(OMNISCAN_450)
    }

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

/// As in `OmniScan 450 (type 104), revision 2, firmware 1.5.6`.
impl fmt::Display for DeviceInformation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.product().unwrap_or("unknown device");
        let [major, minor, patch] = self.firmware;
        write!(
            f,
            "{name} (type {}), revision {}, firmware {major}.{minor}.{patch}",
            self.device_type, self.device_revision
        )
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

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    #[test]
    fn a_device_is_called_by_its_name() {
        let of = |device_type| DeviceInformation {
            device_type,
            device_revision: 2,
            firmware: [1, 5, 6],
        };
        for device_type in [101, 104] {
            assert!(of(device_type).is_omniscan_450());
        }
        assert_eq!(
            of(104).to_string(),
            "OmniScan 450 (type 104), revision 2, firmware 1.5.6"
        );
        assert_eq!(of(103).product(), Some("Surveyor 240-16"));
        for device_type in [0, 1, 2, 103, 110, 112, 255] {
            assert!(!of(device_type).is_omniscan_450());
        }
        assert!(of(7).to_string().starts_with("unknown device (type 7)"));
    }
}
