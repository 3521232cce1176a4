//! Which axis of a file points up.

use echosplat_model::glam::{DVec3, Quat, Vec3};
use echosplat_surface::Surface;

use crate::ply::MapFile;

/// The axis of a file that points up. Maps have z; programs of computer graphics have y, and viewers of
/// 3DGS files take −y.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Up {
    /// As the world of maps (ENU).
    #[default]
    Z,
    /// x stays, z becomes y.
    Y,
    /// x stays, z becomes −y.
    NegativeY,
}

impl Up {
    /// As it is written in a header.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Z => "z",
            Self::Y => "y",
            Self::NegativeY => "-y",
        }
    }

    /// The axis of this name.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        [Self::Z, Self::Y, Self::NegativeY]
            .into_iter()
            .find(|up| up.name() == name)
    }

    /// The map turned so that its z points there. Its header says so, and reading it turns it back.
    #[must_use]
    pub fn turned(self, mut map: MapFile) -> MapFile {
        if self == Self::Z {
            return map;
        }
        let turn = self.turn();
        for gaussian in &mut map.gaussians {
            gaussian.mean_m = self.place(gaussian.mean_m);
            gaussian.rotation = turn * gaussian.rotation;
            gaussian.position_covariance_m2 = self.covariance(gaussian.position_covariance_m2);
        }
        map.origin_m = self.origin(map.origin_m);
        map.notes.up = self;
        map
    }

    /// What [`Up::turned`] made of a map, turned back.
    #[must_use]
    pub(crate) fn upright(map: MapFile) -> MapFile {
        let back = match map.notes.up {
            Self::Z => Self::Z,
            Self::Y => Self::NegativeY,
            Self::NegativeY => Self::Y,
        };
        let mut map = back.turned(map);
        map.notes.up = Self::Z;
        map
    }

    /// The surface, and the origin that it counts from, turned so that its z points there.
    #[must_use]
    pub fn turned_surface(self, mut surface: Surface, origin_m: DVec3) -> (Surface, DVec3) {
        for vertex in &mut surface.vertices {
            vertex.position_m = self.place(vertex.position_m);
            vertex.normal = self.place(vertex.normal);
        }
        (surface, self.origin(origin_m))
    }

    fn turn(self) -> Quat {
        let quarter = std::f32::consts::FRAC_PI_2;
        match self {
            Self::Z => Quat::IDENTITY,
            Self::Y => Quat::from_rotation_x(-quarter),
            Self::NegativeY => Quat::from_rotation_x(quarter),
        }
    }

    /// Exact, as the quaternion is not.
    fn place(self, v: Vec3) -> Vec3 {
        match self {
            Self::Z => v,
            Self::Y => Vec3::new(v.x, v.z, -v.y),
            Self::NegativeY => Vec3::new(v.x, -v.z, v.y),
        }
    }

    fn origin(self, v: DVec3) -> DVec3 {
        match self {
            Self::Z => v,
            Self::Y => DVec3::new(v.x, v.z, -v.y),
            Self::NegativeY => DVec3::new(v.x, -v.z, v.y),
        }
    }

    /// `xx xy xz yy yz zz`, as a map has it; infinite variances stay what they are.
    fn covariance(self, [xx, xy, xz, yy, yz, zz]: [f32; 6]) -> [f32; 6] {
        match self {
            Self::Z => [xx, xy, xz, yy, yz, zz],
            Self::Y => [xx, xz, -xy, zz, -yz, yy],
            Self::NegativeY => [xx, -xz, xy, zz, -yz, yy],
        }
    }
}

#[cfg(test)]
mod tests {
    use echosplat_model::glam::Mat3;

    use super::*;
    use crate::export::tests::map;

    #[test]
    fn up_in_the_map_is_up_in_the_file() {
        for (up, axis) in [
            (Up::Z, Vec3::Z),
            (Up::Y, Vec3::Y),
            (Up::NegativeY, Vec3::NEG_Y),
        ] {
            assert_eq!(up.place(Vec3::Z), axis);
            assert_eq!(up.origin(DVec3::Z), axis.as_dvec3());
            assert!((up.turn() * Vec3::Z).abs_diff_eq(axis, 1e-6));
            assert!((up.turn() * Vec3::X).abs_diff_eq(up.place(Vec3::X), 1e-6));
            assert_eq!(Up::of(up.name()), Some(up));
        }
        assert_eq!(Up::of("up"), None);
    }

    #[test]
    fn a_covariance_turns_with_its_place() {
        let own = [1.0, 0.1, 0.2, 4.0, 0.3, 9.0];
        let matrix = |[xx, xy, xz, yy, yz, zz]: [f32; 6]| {
            Mat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
        };
        for up in [Up::Z, Up::Y, Up::NegativeY] {
            let turn = Mat3::from_quat(up.turn());
            let expected = turn * matrix(own) * turn.transpose();
            assert!(matrix(up.covariance(own)).abs_diff_eq(expected, 1e-5));
        }
    }

    #[test]
    fn turned_and_upright_is_the_same() {
        for up in [Up::Z, Up::Y, Up::NegativeY] {
            let turned = up.turned(map());
            assert_eq!(turned.notes.up, up);
            let back = Up::upright(turned);
            assert_eq!(back.origin_m, map().origin_m);
            assert_eq!(back.gaussians[0].mean_m, map().gaussians[0].mean_m);
            let rotation = back.gaussians[0].rotation;
            assert!(rotation.abs_diff_eq(map().gaussians[0].rotation, 1e-6));
        }
    }
}
