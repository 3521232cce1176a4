//! Messages of other devices that speak the Ping protocol, told by their ids alone.

/// The product that sends messages of this id unasked or when asked for data, by the public
/// definitions of the protocol (`ping1d.json`, `ping360.json`, `s500.json`, `surveyor240.json`,
/// `omniscan3d.json`); `None` of ids that an `OmniScan` 450 has too, and of unknown ones.
#[must_use]
pub const fn product_of_message(message_id: u16) -> Option<&'static str> {
    match message_id {
        1223 | 1308 => Some("Sounder S500"),
        1200..=1399 => Some("Ping Sonar (Ping1D)"),
        2300..=2399 => Some("Ping360"),
        3009..=3099 => Some("Surveyor 240-16"),
        3100..=3199 => Some("OmniScan 3D"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PayloadLengths;
    use crate::id;

    #[test]
    fn other_devices_are_named_and_an_omniscan_450_is_none() {
        for (message_id, name) in [
            (1211, "Ping1D"),
            (1300, "Ping1D"),
            (1308, "S500"),
            (2300, "Ping360"),
            (2301, "Ping360"),
            (3009, "Surveyor"),
            (3012, "Surveyor"),
            (3104, "OmniScan 3D"),
        ] {
            let product = product_of_message(message_id);
            assert!(product.is_some_and(|product| product.contains(name)));
            assert!(PayloadLengths::of(message_id).allow(1_000));
        }
        for own in [
            id::DEVICE_INFORMATION,
            id::STATUS,
            id::OS_PING_PARAMS,
            id::OS_MONO_PROFILE,
            999,
        ] {
            assert_eq!(product_of_message(own), None);
        }
    }
}
