//! Cubic tiles of the map and their names in keys.

use std::fmt;
use std::str::FromStr;

use echosplat_model::TileKey;
use glam::Vec3;

/// The tile that holds a point of the map's frame. Far points end in the outermost tile.
#[must_use]
pub fn tile_of(mean_m: Vec3, tile_edge_m: f64) -> TileKey {
    let index = |m: f32| (f64::from(m) / tile_edge_m).floor() as i32;
    TileKey {
        x: index(mean_m.x),
        y: index(mean_m.y),
        z: index(mean_m.z),
    }
}

/// A tile as it stands in a key: `x_y_z`, e.g. `3_-1_0`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct TileName(pub TileKey);

impl fmt::Display for TileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let TileKey { x, y, z } = self.0;
        write!(f, "{x}_{y}_{z}")
    }
}

/// A text that names no tile.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("tile {0:?} is not of the form x_y_z with whole numbers, like 3_-1_0")]
pub struct TileNameError(String);

impl FromStr for TileName {
    type Err = TileNameError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || TileNameError(text.chars().take(40).collect());
        let mut parts = text.split('_').map(i32::from_str);
        let mut next = || parts.next().and_then(Result::ok).ok_or_else(error);
        let (x, y, z) = (next()?, next()?, next()?);
        match parts.next() {
            None => Ok(Self(TileKey { x, y, z })),
            Some(_) => Err(error()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_half_open_on_both_sides_of_zero() {
        let key = |x, y, z| TileKey { x, y, z };
        assert_eq!(tile_of(Vec3::new(0.0, 3.99, 4.0), 4.0), key(0, 0, 1));
        assert_eq!(tile_of(Vec3::new(-0.01, -4.0, -4.01), 4.0), key(-1, -1, -2));
        assert_eq!(tile_of(Vec3::splat(f32::MAX), 4.0).x, i32::MAX);
    }

    #[test]
    fn names_are_read_as_written_and_nothing_else_is() {
        let key = TileKey {
            x: 3,
            y: -1,
            z: i32::MIN,
        };
        let name = TileName(key);
        assert_eq!(name.to_string().parse::<TileName>(), Ok(name));
        for bad in ["", "1_2", "1_2_3_4", "a_b_c", "1_2_99999999999", "1-2-3"] {
            assert!(bad.parse::<TileName>().is_err(), "{bad}");
        }
    }
}
