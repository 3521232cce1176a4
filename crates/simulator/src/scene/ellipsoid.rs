//! A ball stretched along three axes: pebbles, plates and floats.

use glam::{DQuat, DVec3};

use super::meeting::{Closest, Crossing};
use super::tree::Bounds;

/// Steps of halving the search for the nearest place: down to the last bit of a length.
const HALVINGS: usize = 80;
/// A coordinate of exactly 0 lets the nearest place be one of two; this share of the smallest
/// semi-axis takes one of them.
const NUDGE: f64 = 1e-12;

#[derive(Debug, Clone, Copy)]
pub(crate) struct Ellipsoid {
    pub(crate) center: DVec3,
    /// Half its lengths, positive.
    pub(crate) semi_axes: DVec3,
    pub(crate) world_from_own: DQuat,
}

impl Ellipsoid {
    /// Both places where the endless line meets it.
    pub(crate) fn crossings(
        self,
        origin: DVec3,
        direction: DVec3,
    ) -> impl Iterator<Item = Crossing> {
        // Squeezed to the unit sphere, a line is a line and its parameter the same.
        let own_from_world = self.world_from_own.conjugate();
        let squeezed_origin = own_from_world * (origin - self.center) / self.semi_axes;
        let squeezed_direction = own_from_world * direction / self.semi_axes;
        let a = squeezed_direction.length_squared();
        let foot = -squeezed_origin.dot(squeezed_direction) / a;
        let miss = squeezed_origin + squeezed_direction * foot;
        let rest = 1.0 - miss.length_squared();
        let half = if rest >= 0.0 {
            (rest / a).sqrt()
        } else {
            f64::NAN
        };
        let distances = [foot - half, foot + half].into_iter();
        let met = distances.filter(|distance| distance.is_finite());
        met.map(move |distance| Crossing {
            distance,
            normal: self.at(squeezed_origin + squeezed_direction * distance).1,
        })
    }

    /// Place and outward normal where `unit` of the unit sphere is stretched to.
    pub(crate) fn at(&self, unit: DVec3) -> (DVec3, DVec3) {
        let normal = (unit / self.semi_axes).normalize_or_zero();
        let place = self.center + self.world_from_own * (unit * self.semi_axes);
        (place, self.world_from_own * normal)
    }

    /// By Eberly, Distance from a Point to an Ellipsoid: the nearest place is
    /// `e²y / (t + e²)` at the largest root t of `Σ (e y / (t + e²))² = 1`; searched for from
    /// t = −min e², so that nothing cancels close to the middle.
    pub(crate) fn closest(&self, point: DVec3) -> Closest {
        let own = self.world_from_own.conjugate() * (point - self.center);
        let e = self.semi_axes;
        let least = e.min_element();
        let y = own.abs().max(DVec3::splat(NUDGE * least));
        let beyond_least = e * e - least * least;
        let level = |from_least: f64| (e * y / (beyond_least + from_least)).length_squared() - 1.0;
        let (mut low, mut high) = (0.0, (e * y).length());
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if level(middle) > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        let nearest = e * e * y / (beyond_least + high);
        let signs = own.map(|c| if c < 0.0 { -1.0 } else { 1.0 });
        let (place, normal) = self.at(nearest * signs / e);
        let is_inside = (own / e).length_squared() < 1.0;
        let distance = point.distance(place);
        Closest {
            signed: if is_inside { -distance } else { distance },
            place,
            normal,
        }
    }

    pub(crate) fn bounds(&self) -> Bounds {
        let axis = |unit: DVec3, half: f64| self.world_from_own * unit * half;
        let e = self.semi_axes;
        let axes = [
            axis(DVec3::X, e.x),
            axis(DVec3::Y, e.y),
            axis(DVec3::Z, e.z),
        ];
        let reach = axes.iter().map(|a| a * a).sum::<DVec3>().powf(0.5);
        (self.center - reach, self.center + reach)
    }

    /// By Thomsen's formula, within 1.1 %.
    pub(crate) fn area(&self) -> f64 {
        const P: f64 = 1.6075;
        let e = self.semi_axes;
        let products = DVec3::new(e.x * e.y, e.x * e.z, e.y * e.z);
        let mean = products.powf(P).element_sum() / 3.0;
        4.0 * std::f64::consts::PI * mean.powf(1.0 / P)
    }

    /// Radius of the ball whose evenly spread places, thinned by [`Ellipsoid::sampling_share`],
    /// are evenly spread here.
    pub(crate) fn sampling_radius(&self) -> f64 {
        (self.semi_axes.element_product() / self.semi_axes.min_element()).sqrt()
    }

    /// Stretching grows an area around `unit` by `abc |unit / e|`; this over its largest.
    pub(crate) fn sampling_share(&self, unit: DVec3) -> f64 {
        (unit / self.semi_axes).length() * self.semi_axes.min_element()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plate() -> Ellipsoid {
        Ellipsoid {
            center: DVec3::new(1.0, -2.0, 0.5),
            semi_axes: DVec3::new(0.3, 0.02, 0.1),
            world_from_own: DQuat::from_rotation_z(0.7) * DQuat::from_rotation_x(-0.4),
        }
    }

    fn units() -> impl Iterator<Item = DVec3> {
        (1..200).map(|i| {
            let t = f64::from(i);
            DVec3::new(t.sin(), (1.7 * t).cos(), (0.3 * t).sin()).normalize()
        })
    }

    #[test]
    fn rays_end_on_the_surface_with_the_outward_normal() {
        let solid = plate();
        for unit in units() {
            let (place, normal) = solid.at(unit);
            let direction = -normal;
            let found = solid.crossings(place - direction * 2.0, direction);
            let nearest = found.min_by(|a, b| a.distance.total_cmp(&b.distance));
            let nearest = nearest.unwrap();
            assert!((nearest.distance - 2.0).abs() < 1e-9, "{unit}");
            assert!(nearest.normal.dot(normal) > 1.0 - 1e-9);
        }
        let past = solid.center + DVec3::Z * 1.0;
        assert_eq!(solid.crossings(past, DVec3::X).count(), 0);
    }

    #[test]
    fn the_nearest_place_of_a_place_off_the_surface_is_where_it_came_from() {
        let solid = plate();
        for unit in units() {
            let (place, normal) = solid.at(unit);
            for off_m in [1e-3, 0.4, 30.0] {
                let closest = solid.closest(place + normal * off_m);
                assert!((closest.signed - off_m).abs() < 1e-9, "{unit} {off_m}");
                assert!(closest.place.distance(place) < 1e-7, "{unit} {off_m}");
            }
            assert!(solid.closest(place - normal * 1e-4).signed < 0.0);
        }
        let middle = solid.closest(solid.center);
        assert!((middle.signed + 0.02).abs() < 1e-9, "{middle:?}");
    }

    #[test]
    fn a_ball_is_a_sphere() {
        let ball = Ellipsoid {
            center: DVec3::ZERO,
            semi_axes: DVec3::splat(0.5),
            world_from_own: DQuat::IDENTITY,
        };
        assert!((ball.area() - std::f64::consts::PI).abs() < 1e-9);
        assert!((ball.closest(DVec3::new(0.0, 3.0, 0.0)).signed - 2.5).abs() < 1e-9);
        let (low, high) = ball.bounds();
        assert!((high - low).abs_diff_eq(DVec3::ONE, 1e-12));
    }
}
