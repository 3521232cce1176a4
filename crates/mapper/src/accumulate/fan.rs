//! Which parts of space a ping can see.

use echosplat_measurement::lanes::LANES;
use echosplat_measurement::{PingGeometry, simd_level};
use echosplat_model::glam::Vec3;
use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x8};

/// The volume of one ping, a thin slice of a fan, for coarse tests against spheres.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fan {
    position_m: Vec3,
    along: Vec3,
    left: Vec3,
    up: Vec3,
    range_min_m: f32,
    range_max_m: f32,
    /// Half the slice's thickness over range.
    spread: f32,
    elevation_cos: f32,
    elevation_sin: f32,
    half_tangent: f32,
}

impl Fan {
    /// The slice within `sigmas` of the beam's axis.
    pub(crate) fn of(geometry: &PingGeometry, sigmas: f32) -> Self {
        let sigma = geometry.beam.azimuth_sigma_rad();
        let azimuth = (sigma * sigma + geometry.azimuth_variance_rad2).sqrt();
        let end_m = geometry.range_start_m + geometry.bin_length_m * geometry.bin_count as f32;
        let drift = geometry.pose.drift_per_m;
        let turned =
            (drift.y.abs() + drift.z.abs()) * (end_m - geometry.pose.reference_range_m).abs();
        // The soft edge of the fan ends by 1.3 half-widths.
        let elevation = (1.3 * geometry.beam.elevation_half_width_rad()).min(1.5);
        Self {
            position_m: geometry.pose.position_m,
            along: geometry.pose.axes.x_axis,
            left: geometry.pose.axes.y_axis,
            up: geometry.pose.axes.z_axis,
            range_min_m: geometry.range_start_m,
            range_max_m: end_m,
            spread: sigmas * azimuth + turned,
            elevation_cos: elevation.cos(),
            elevation_sin: elevation.sin(),
            half_tangent: geometry.beam.elevation_half_width_rad().tan(),
        }
    }

    /// Tangent of the elevation at which the fan is half as sensitive.
    pub(crate) fn half_tangent(&self) -> f32 {
        self.half_tangent
    }

    /// Whether a sphere may reach into the slice; errs only towards yes.
    pub(crate) fn touches(&self, center_m: Vec3, radius_m: f32) -> bool {
        let d = center_m - self.position_m;
        let y = self.left.dot(d);
        // What is in range is no farther than this. Most spheres are beside the slice and end here.
        if y.abs() > radius_m + self.spread * (self.range_max_m + radius_m) {
            return false;
        }
        let range_m = d.length();
        if !(range_m + radius_m > self.range_min_m && range_m - radius_m < self.range_max_m) {
            return false;
        }
        let (x, z) = (self.along.dot(d), self.up.dot(d));
        if x < -radius_m || y.abs() > radius_m + self.spread * range_m {
            return false;
        }
        let lever_m = (x * x + y * y).sqrt();
        let outside = z.abs() * self.elevation_cos - lever_m * self.elevation_sin;
        outside < radius_m
    }
}

/// Pings looked for together; layout.
/// Pings in a row that are looked for together, a bit each.
pub(crate) const GROUP_PINGS: usize = 64;

/// How far to the side of each of some pings a place lies, eight at a time: most lie beside most.
#[derive(Debug)]
pub(crate) struct Sides {
    /// Unit vectors to the left, and how far along them the sensors are.
    left: [[f32; GROUP_PINGS]; 3],
    offset_m: [f32; GROUP_PINGS],
    /// Half a slice's thickness where it is thickest, negative where there is no ping, and the same over range.
    half_m: [f32; GROUP_PINGS],
    spread: [f32; GROUP_PINGS],
}

impl Default for Sides {
    fn default() -> Self {
        Self {
            left: [[0.0; GROUP_PINGS]; 3],
            offset_m: [0.0; GROUP_PINGS],
            half_m: [f32::NEG_INFINITY; GROUP_PINGS],
            spread: [0.0; GROUP_PINGS],
        }
    }
}

impl Sides {
    pub(crate) fn set(&mut self, at: usize, fan: &Fan) {
        for (left, axis) in self.left.iter_mut().zip(fan.left.to_array()) {
            left[at] = axis;
        }
        self.offset_m[at] = fan.left.dot(fan.position_m);
        self.half_m[at] = fan.spread * fan.range_max_m;
        self.spread[at] = fan.spread;
    }

    /// Those into whose slice a sphere may reach, a bit each; errs only towards yes.
    pub(crate) fn near(&self, center_m: Vec3, radius_m: f32) -> u64 {
        // What single precision rounds away, wherever it is.
        let slack_m = radius_m + 1e-3 + 1e-6 * center_m.abs().max_element();
        dispatch!(simd_level::level(), simd => {
            let mut near = 0;
            for from in (0..GROUP_PINGS).step_by(LANES) {
                let eight = from..from + LANES;
                let [x, y, z] = &self.left;
                let aside_m = f32x8::from_slice(simd, &x[eight.clone()]).mul_add(
                    center_m.x,
                    f32x8::from_slice(simd, &y[eight.clone()]) * center_m.y,
                );
                let aside_m = f32x8::from_slice(simd, &z[eight.clone()])
                    .mul_add(center_m.z, aside_m)
                    - f32x8::from_slice(simd, &self.offset_m[eight.clone()]);
                let spread = f32x8::from_slice(simd, &self.spread[eight.clone()]);
                let half_m = f32x8::from_slice(simd, &self.half_m[eight]);
                let is_near = aside_m.abs().simd_le(spread.mul_add(radius_m, half_m) + slack_m);
                near |= is_near.to_bitmask() << from;
            }
            near
        })
    }
}

/// A box around all that some pings can see: one test in place of one for each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach {
    least_m: Vec3,
    most_m: Vec3,
}

impl Reach {
    pub(crate) fn of<'a>(fans: impl IntoIterator<Item = &'a Fan>) -> Self {
        let mut reach = Self {
            least_m: Vec3::INFINITY,
            most_m: Vec3::NEG_INFINITY,
        };
        fans.into_iter().for_each(|fan| reach.add(fan));
        reach
    }

    pub(crate) fn add(&mut self, fan: &Fan) {
        self.least_m = self.least_m.min(fan.position_m - fan.range_max_m);
        self.most_m = self.most_m.max(fan.position_m + fan.range_max_m);
    }

    /// Whether any of the fans may touch a sphere; errs only towards yes.
    pub(crate) fn touches(&self, center_m: Vec3, radius_m: f32) -> bool {
        // What single precision rounds away, wherever it is.
        let slack_m = 1e-3 + 1e-6 * center_m.abs().max_element();
        let away_m = center_m.distance(center_m.max(self.least_m).min(self.most_m));
        !(away_m > radius_m + slack_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_measurement::{Beam, PingPose};
    use echosplat_model::glam::Mat3;

    #[test]
    fn spheres_inside_touch_and_spheres_beside_do_not() {
        let geometry = PingGeometry {
            pose: PingPose {
                position_m: Vec3::ZERO,
                axes: Mat3::IDENTITY,
                drift_per_m: Vec3::ZERO,
                reference_range_m: 5.0,
            },
            range_start_m: 1.0,
            bin_length_m: 0.02,
            bin_count: 450,
            range_variance_m2: 0.0,
            azimuth_variance_rad2: 0.0,
            beam: Beam::default(),
        };
        let fan = Fan::of(&geometry, 3.0);
        let touches = |x, y, z| fan.touches(Vec3::new(x, y, z), 0.1);
        assert!(touches(5.0, 0.0, 0.0) && touches(5.0, 0.15, 0.0) && touches(5.0, 0.0, 2.2));
        assert!(!touches(5.0, 0.3, 0.0) && !touches(-5.0, 0.0, 0.0));
        assert!(!touches(0.8, 0.0, 0.0) && !touches(10.2, 0.0, 0.0) && !touches(3.0, 0.0, 4.0));
        // What a fan touches is in its reach, and what is far from it is not.
        let reach = Reach::of([&fan]);
        for x in -30..30 {
            for (y, z) in [(0.0, 0.0), (0.5, 2.0), (3.0, -9.9), (0.1, 10.0)] {
                let at_m = Vec3::new(0.5 * x as f32, y, z);
                assert!(
                    reach.touches(at_m, 0.1) || !fan.touches(at_m, 0.1),
                    "{at_m}"
                );
            }
        }
        // Nor does any place that it touches lie beside it, and most others do.
        let mut sides = Sides::default();
        sides.set(63, &fan);
        let mut beside = 0;
        for x in -30..30 {
            for y in -30..30 {
                let at_m = Vec3::new(0.5 * x as f32, 0.1 * y as f32, 1.0);
                let near = sides.near(at_m, 0.1);
                assert!(
                    near == 1 << 63 || near == 0 && !fan.touches(at_m, 0.1),
                    "{at_m}"
                );
                beside += u32::from(near == 0);
            }
        }
        assert!(beside > 2000, "{beside}");
        assert!(reach.touches(Vec3::X * 10.0, 0.1) && !reach.touches(Vec3::X * 10.2, 0.1));
        assert!(!Reach::of([]).touches(Vec3::ZERO, 1e6));
    }
}
