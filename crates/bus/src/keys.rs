//! The keys of one vehicle.

use crate::BusError;
use crate::delta::TileName;

const ALLOWED: &str = "a name without / * $ ? # or blanks, at most 64 bytes";

/// Every key of `<prefix>/<node>`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Keys {
    base: String,
}

impl Keys {
    /// # Errors
    /// If a name cannot stand in a key. The prefix may have several parts.
    pub fn new(prefix: &str, node: &str) -> Result<Self, BusError> {
        let refused = |key, found: &str| BusError::Config {
            key,
            found: format!("{found:?}"),
            allowed: ALLOWED,
        };
        if !prefix.split('/').all(is_name) {
            return Err(refused("prefix", prefix));
        }
        if !is_name(node) {
            return Err(refused("node", node));
        }
        Ok(Self {
            base: format!("{prefix}/{node}"),
        })
    }

    /// Poses of the vehicle.
    #[must_use]
    pub fn pose(&self) -> String {
        format!("{}/pose", self.base)
    }

    /// Raw frames of the sonar.
    #[must_use]
    pub fn ping(&self) -> String {
        format!("{}/sonar/ping", self.base)
    }

    /// What the driver hears, for a mapper elsewhere.
    #[must_use]
    pub fn tape(&self) -> String {
        format!("{}/driver/tape", self.base)
    }

    /// The driver's rates and counters, where it runs apart from the mapper.
    #[must_use]
    pub fn driver_status(&self) -> String {
        format!("{}/driver/status", self.base)
    }

    /// Changes of one tile.
    #[must_use]
    pub fn delta(&self, tile: TileName) -> String {
        format!("{}/map/delta/{tile}", self.base)
    }

    /// Changes of every tile.
    #[must_use]
    pub fn deltas(&self) -> String {
        format!("{}/map/delta/*", self.base)
    }

    /// The map, for those who ask.
    #[must_use]
    pub fn snapshot(&self) -> String {
        format!("{}/map/snapshot", self.base)
    }

    /// Rates and counters.
    #[must_use]
    pub fn status(&self) -> String {
        format!("{}/status", self.base)
    }

    /// Where the map's own frame lies in the poses', where it has one.
    #[must_use]
    pub fn static_transform(&self) -> String {
        format!("{}/tf_static", self.base)
    }

    /// The service's token.
    #[must_use]
    pub fn alive(&self) -> String {
        format!("{}/alive", self.base)
    }

    /// The token of one session in one role.
    #[must_use]
    pub fn alive_as(&self, role: &str, zenoh_id: &str) -> String {
        format!("{}/alive/{role}/{zenoh_id}", self.base)
    }

    /// The tokens of every session in every role.
    pub(crate) fn alive_in_any_role(&self) -> String {
        format!("{}/alive/*/*", self.base)
    }

    /// The tokens above, with a role or without.
    pub(crate) fn alive_anyhow(&self) -> String {
        format!("{}/alive/**", self.base)
    }
}

/// That a role can stand in a key.
pub(crate) fn check_role(role: &str) -> Result<(), BusError> {
    match is_name(role) {
        true => Ok(()),
        false => Err(BusError::Config {
            key: "role",
            found: format!("{role:?}"),
            allowed: ALLOWED,
        }),
    }
}

/// `@` opens a verbatim chunk in zenoh, which wildcards do not match; it is refused as well.
fn is_name(name: &str) -> bool {
    let allowed = |c: char| !c.is_whitespace() && !c.is_control() && !"/*$?#@".contains(c);
    !name.is_empty() && name.len() <= 64 && name.chars().all(allowed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::TileKey;

    #[test]
    fn keys_are_those_documented() {
        let keys = Keys::new("echosplat", "rov-1").unwrap();
        let tile = TileName(TileKey { x: 3, y: -1, z: 0 });
        assert_eq!(keys.pose(), "echosplat/rov-1/pose");
        assert_eq!(keys.ping(), "echosplat/rov-1/sonar/ping");
        assert_eq!(keys.tape(), "echosplat/rov-1/driver/tape");
        assert_eq!(keys.driver_status(), "echosplat/rov-1/driver/status");
        assert_eq!(keys.delta(tile), "echosplat/rov-1/map/delta/3_-1_0");
        assert_eq!(keys.snapshot(), "echosplat/rov-1/map/snapshot");
        assert_eq!(keys.status(), "echosplat/rov-1/status");
        assert_eq!(keys.static_transform(), "echosplat/rov-1/tf_static");
        assert_eq!(keys.alive(), "echosplat/rov-1/alive");
        let token = "echosplat/rov-1/alive/mapper/a1b2";
        assert_eq!(keys.alive_as("mapper", "a1b2"), token);
        assert!(Keys::new("sea/north", "a").is_ok());
    }

    #[test]
    fn names_that_would_be_patterns_are_refused() {
        for bad in ["", "*", "a/b", "a$", "a?b", "#", "a b", "@x", "\u{0}"] {
            assert!(Keys::new("echosplat", bad).is_err(), "{bad:?}");
        }
        for bad in ["", "/a", "a/", "a//b", "**"] {
            assert!(Keys::new(bad, "rov").is_err(), "{bad:?}");
        }
    }
}
