//! Where the sonar has been, thinned to what a page or a report can draw.

use echosplat_model::glam::DVec3;

/// Most points kept; when they are full every other one goes.
const MAX_POINTS: usize = 4096;
/// First time between two points.
const FIRST_STEP_S: f64 = 0.1;

/// Time of the dive and place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackPoint {
    /// Seconds of the dive.
    pub dive_s: f64,
    /// In the poses' frame, metres.
    pub place_m: DVec3,
}

/// At most 4,096 points over the whole dive.
#[derive(Debug, Clone)]
pub struct Track {
    points: Vec<TrackPoint>,
    step_s: f64,
}

impl Default for Track {
    fn default() -> Self {
        Self {
            points: Vec::new(),
            step_s: FIRST_STEP_S,
        }
    }
}

impl Track {
    /// Adds a place, unless the last is of nearly the same time.
    pub fn push(&mut self, point: TrackPoint) {
        if let Some(last) = self.points.last()
            && (point.dive_s - last.dive_s).abs() < self.step_s
        {
            return;
        }
        if self.points.len() == MAX_POINTS {
            let mut index = 0;
            self.points.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.step_s *= 2.0;
        }
        self.points.push(point);
    }

    /// What is kept, in order of time.
    #[must_use]
    pub fn points(&self) -> &[TrackPoint] {
        &self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_dive_is_thinned_evenly() {
        let mut track = Track::default();
        for i in 0..100_000 {
            let dive_s = f64::from(i) * 0.025;
            let place_m = DVec3::new(dive_s, 0.0, 0.0);
            track.push(TrackPoint { dive_s, place_m });
        }
        let points = track.points();
        assert!(points.len() <= MAX_POINTS && points.len() > MAX_POINTS / 4);
        assert!(points[0].dive_s < 1e-9);
        let widest = points
            .windows(2)
            .map(|pair| pair[1].dive_s - pair[0].dive_s);
        assert!(widest.fold(0.0, f64::max) < 3.3);
    }
}
