//! The closed curve a survey follows, seen from above.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;

/// A rectangle with rounded corners, followed counter-clockwise at a constant speed; it starts in
/// the middle of its lower side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Track {
    pub(super) center: DVec2,
    /// Half lengths of the rectangle the curve keeps `radius` from.
    pub(super) half: DVec2,
    pub(super) radius: f64,
}

impl Track {
    pub(super) fn length(&self) -> f64 {
        4.0 * (self.half.x + self.half.y) + TAU * self.radius
    }

    /// Place after `along` metres, and the unit vector towards the rectangle.
    pub(super) fn at(&self, along: f64) -> (DVec2, DVec2) {
        let corner = FRAC_PI_2 * self.radius;
        let (x, y) = (self.half.x, self.half.y);
        // Side by side: a straight, then the corner at its end. The first side begins in its
        // middle, so its other half comes last.
        let mut rest = (along + x).rem_euclid(self.length());
        let sides = [
            (DVec2::new(-x, -y), 2.0 * x, 0.0),
            (DVec2::new(x, -y), 2.0 * y, 1.0),
            (DVec2::new(x, y), 2.0 * x, 2.0),
            (DVec2::new(-x, y), 2.0 * y, 3.0),
        ];
        for (from, straight, quarter) in sides {
            let heading = DVec2::from_angle(quarter * FRAC_PI_2);
            let outward = -heading.perp();
            if rest <= straight {
                let place = from + heading * rest + outward * self.radius;
                return (self.center + place, -outward);
            }
            rest -= straight;
            if rest <= corner {
                let outward = DVec2::from_angle(rest / self.radius.max(1e-9)).rotate(outward);
                let place = from + heading * straight + outward * self.radius;
                return (self.center + place, -outward);
            }
            rest -= corner;
        }
        let start = DVec2::new(-x, -y - self.radius);
        (self.center + start, DVec2::Y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_closed_and_walked_at_one_speed() {
        let track = Track {
            center: DVec2::new(1.0, 2.0),
            half: DVec2::new(3.0, 0.5),
            radius: 4.0,
        };
        let count = 5000;
        let step = track.length() / f64::from(count);
        for i in 0..count {
            let (here, inward) = track.at(f64::from(i) * step);
            let (next, _) = track.at(f64::from(i + 1) * step);
            assert!((here.distance(next) - step).abs() < 1e-5 * step, "{i}");
            let local = here + inward * track.radius - track.center;
            assert!(local.abs().cmple(track.half + 1e-9).all());
        }
        let (start, inward) = track.at(0.0);
        assert!(start.distance(DVec2::new(1.0, -2.5)) < 1e-12);
        assert!(inward.distance(DVec2::Y) < 1e-12);
    }
}
