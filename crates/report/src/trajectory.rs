//! The way of the sonar: from above, and how high it was when.

use std::fmt::Write;

use glam::{DVec2, DVec3};

use crate::axes::{Axes, BOTTOM, LEFT, scale_bar};

const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 320.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 24.0;
/// Most corners of a line that is drawn.
const MAX_CORNERS: usize = 1500;

/// Seconds of the dive, and the place of the sonar in the frame of the poses: east, north, up, metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trajectory(pub Vec<(f64, DVec3)>);

impl Trajectory {
    /// Of the way, metres; steps below 5 cm are taken for jitter and added up first.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        let mut length_m = 0.0;
        let mut last = self.0.first().map(|first| first.1);
        for (_, place) in &self.0 {
            let step_m = last.map_or(0.0, |last| place.distance(last));
            if step_m > 0.05 {
                length_m += step_m;
                last = Some(*place);
            }
        }
        length_m
    }

    fn finite(&self) -> Vec<(f64, DVec3)> {
        let all = self.0.iter();
        let finite = all.filter(|(at, place)| at.is_finite() && place.is_finite());
        finite.copied().collect()
    }

    /// How high it was when.
    pub(super) fn height_html(&self) -> String {
        let height: Vec<DVec2> = self
            .finite()
            .iter()
            .map(|(at, place)| DVec2::new(*at, place.z))
            .collect();
        if height.len() < 2 {
            return String::new();
        }
        format!(
            "<figure class=\"half\">{}<figcaption>Height of the sonar over the dive, in the frame of the poses.</figcaption></figure>\n",
            drawing(&height, false, "dive time, s", "z, m")
        )
    }

    pub(super) fn to_html(&self) -> String {
        let way = self.finite();
        if way.len() < 2 {
            return "<p class=\"note\">No pose was joined with a ping: there is no way to draw.</p>\n".to_owned();
        }
        let above: Vec<DVec2> = way.iter().map(|(_, place)| place.truncate()).collect();
        let height: Vec<DVec2> = way
            .iter()
            .map(|(at, place)| DVec2::new(*at, place.z))
            .collect();
        format!(
            "<div class=\"charts\">\n<figure>{}<figcaption>from above, in the frame of the poses</figcaption></figure>\n\
             <figure>{}<figcaption>height over the dive</figcaption></figure>\n</div>\n",
            drawing(&above, true, "east, m", "north, m"),
            drawing(&height, false, "dive time, s", "up, m"),
        )
    }
}

fn drawing(line: &[DVec2], is_map: bool, along: &str, up: &str) -> String {
    let axes = axes_over(line, is_map);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {:.0}\" role=\"img\" aria-label=\"{up} over {along}\">",
        axes.from.y + BOTTOM + if is_map { 14.0 } else { 0.0 }
    );
    svg += &axes.to_svg(along, up);
    let every = line.len().div_ceil(MAX_CORNERS).max(1);
    let mut path = String::new();
    for (index, corner) in line.iter().step_by(every).enumerate() {
        let (at, first) = (axes.place(*corner), if index == 0 { 'M' } else { 'L' });
        let _ = write!(path, "{first}{:.1} {:.1}", at.x, at.y);
    }
    let _ = write!(
        svg,
        "<g class=\"s0\"><path class=\"way\" d=\"{path}\"/></g>"
    );
    if is_map {
        for (place, name) in [(line[0], "begin"), (line[line.len() - 1], "end")] {
            let at = axes.place(place);
            let _ = write!(
                svg,
                "<circle class=\"ring\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"/><text class=\"mark\" x=\"{:.1}\" \
                 y=\"{:.1}\">{name}</text>",
                at.x + 7.0,
                if name == "end" {
                    at.y + 12.0
                } else {
                    at.y - 4.0
                },
                x = at.x,
                y = at.y,
            );
        }
        let per_m = (axes.to.x - axes.from.x) / (axes.high.x - axes.low.x);
        svg += &scale_bar(per_m, 0.3 * WIDTH, LEFT, axes.from.y + BOTTOM + 4.0);
    }
    svg + "</svg>"
}

/// Around all of it; a map has one scale for both ways.
fn axes_over(line: &[DVec2], is_map: bool) -> Axes {
    let ends = line.iter().map(|p| (*p, *p));
    let (low, high) = ends
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
        .unwrap_or_default();
    let margin = match is_map {
        true => DVec2::splat((0.06 * (high - low).max_element()).max(0.5)),
        false => DVec2::new(0.0, (0.1 * (high.y - low.y)).max(0.25)),
    };
    let (mut low, mut high) = (low - margin, high + margin);
    let room = DVec2::new(WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM);
    if is_map {
        let per_m = (room / (high - low)).min_element();
        let spare = (room / per_m - (high - low)) * 0.5;
        (low, high) = (low - spare, high + spare);
    }
    Axes {
        low,
        high,
        from: DVec2::new(LEFT, HEIGHT - BOTTOM),
        to: DVec2::new(WIDTH - RIGHT, TOP),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring() -> Trajectory {
        let place = |i: u32| {
            let angle = f64::from(i) / 1000.0 * std::f64::consts::TAU;
            (
                f64::from(i),
                10.0 * DVec3::new(angle.cos(), angle.sin(), -0.3),
            )
        };
        Trajectory((0..=1000).map(place).collect())
    }

    #[test]
    fn the_way_has_its_length_axes_and_a_scale() {
        let ring = ring();
        assert!((ring.length_m() - 62.8).abs() < 0.1, "{}", ring.length_m());
        let html = ring.to_html();
        for part in [
            "east, m",
            "north, m",
            "up, m",
            "dive time, s",
            "class=\"bar\"",
            ">begin<",
            ">end<",
        ] {
            assert!(html.contains(part), "{part}");
        }
        assert!(!html.contains("NaN") && !html.contains("inf"));
    }

    #[test]
    fn without_a_way_it_is_said() {
        assert!(Trajectory::default().to_html().contains("no way to draw"));
        let still = Trajectory(vec![(0.0, DVec3::ONE), (1.0, DVec3::ONE)]);
        assert!(!still.to_html().contains("NaN"));
        let jitter = (0..100).map(|i| (f64::from(i), DVec3::X * 0.01 * f64::from(i % 2)));
        assert!(Trajectory(jitter.collect()).length_m() < 1e-9);
    }
}
