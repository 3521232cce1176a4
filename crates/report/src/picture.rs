//! The map beside the truth from three sides, as dots.

use std::collections::BTreeSet;
use std::fmt::Write;

use glam::{DVec2, DVec3};

use crate::axes::{Axes, BOTTOM, LEFT, scale_bar};
use echosplat_metrics::{MapPoints, Truth, distances_to_truth};

/// Width of a view in its own units; dots are thinned to one per unit square.
const VIEW_WIDTH: f64 = 300.0;
const MAX_VIEW_HEIGHT: f64 = 420.0;
const MARGIN: f64 = 14.0;
/// Room for the name of the axis up.
const TOP: f64 = 22.0;
/// Height of the scale bar's line below the axes.
const BAR_ROOM: f64 = 16.0;
/// Most dots of each kind and view; about 11 bytes each.
const MAX_DOTS: usize = 6000;
/// Upper ends of the classes of error, metres; the last has none.
const ERROR_CLASSES_M: [f64; 4] = [0.025, 0.05, 0.10, 0.25];
const ERROR_NAMES: [&str; 5] = ["to 2.5 cm", "to 5 cm", "to 10 cm", "to 25 cm", "beyond"];

/// Kinds of dots in the order they are drawn: truth, ambiguous, then by error.
const TRUTH: usize = 0;
const AMBIGUOUS: usize = 1;
/// All that is asserted, where distances are not known.
const ASSERTED: usize = 2;
const KINDS: usize = 2 + ERROR_NAMES.len();

/// The points of a picture, by kind.
#[derive(Debug, Clone, Default)]
pub struct Picture {
    kinds: [Vec<DVec3>; KINDS],
    /// Whether distances from it are known.
    has_truth: bool,
}

/// A side to look from: two unit vectors of the world that become right and up.
struct View {
    name: &'static str,
    along: &'static str,
    upward: &'static str,
    right: DVec3,
    up: DVec3,
}

const VIEWS: [View; 3] = [
    View {
        name: "from above",
        along: "east, m",
        upward: "north, m",
        right: DVec3::X,
        up: DVec3::Y,
    },
    View {
        name: "from the south",
        along: "east, m",
        upward: "up, m",
        right: DVec3::X,
        up: DVec3::Z,
    },
    View {
        name: "from the east",
        along: "north, m",
        upward: "up, m",
        right: DVec3::Y,
        up: DVec3::Z,
    },
];

impl View {
    fn flat(&self, point: DVec3) -> DVec2 {
        DVec2::new(point.dot(self.right), point.dot(self.up))
    }

    /// The scale at which a box just fits.
    fn units_per_m(&self, low: DVec3, high: DVec3) -> f64 {
        let size = (self.flat(high) - self.flat(low)).max(DVec2::splat(1e-9));
        let room = DVec2::new(VIEW_WIDTH - LEFT - MARGIN, MAX_VIEW_HEIGHT - TOP - BOTTOM);
        (room / size).min_element()
    }
}

impl Picture {
    /// Of a map and its truth; confident points are classed by their distance from the truth.
    #[must_use]
    pub fn new(points: &MapPoints, truth: &Truth) -> Self {
        let mut picture = Self {
            has_truth: true,
            ..Self::default()
        };
        picture.kinds[TRUTH] = truth.seen().iter().map(|point| point.position).collect();
        picture.kinds[AMBIGUOUS].clone_from(&points.ambiguous);
        let errors = distances_to_truth(&points.confident, truth);
        for (point, error_m) in points.confident.iter().zip(errors) {
            let class = ERROR_CLASSES_M.partition_point(|limit_m| error_m > *limit_m);
            picture.kinds[AMBIGUOUS + 1 + class].push(point.position);
        }
        picture
    }

    /// Of a map whose truth nobody knows.
    #[must_use]
    pub fn of_map(points: &MapPoints) -> Self {
        let mut picture = Self::default();
        picture.kinds[AMBIGUOUS].clone_from(&points.ambiguous);
        let asserted = points.confident.iter().map(|point| point.position);
        picture.kinds[ASSERTED] = asserted.collect();
        picture
    }

    pub(super) fn to_html(&self) -> String {
        let Some((low, high)) = self.frame() else {
            return "<p class=\"note\">No truth and no map: nothing to show.</p>\n".to_owned();
        };
        let mut html = self.legend() + "<div class=\"views\">\n";
        let mut is_thinned = false;
        // One scale for all three, so that they can be compared.
        let per_m = VIEWS.iter().map(|view| view.units_per_m(low, high));
        let per_m = per_m.fold(f64::INFINITY, f64::min);
        for view in &VIEWS {
            let (svg, thinned) = self.view_svg(view, low, high, per_m);
            is_thinned |= thinned;
            let _ = writeln!(
                html,
                "<figure>{svg}<figcaption>{}</figcaption></figure>",
                view.name
            );
        }
        html += "</div>\n";
        let outside = self.outside_count(low, high);
        if is_thinned {
            html += "<p class=\"note\">Dots are thinned to what can be told apart; figures count \
                     every point.</p>\n";
        }
        if outside > 0 {
            let _ = writeln!(
                html,
                "<p class=\"note\">{outside} points lie outside the frame (what is known \
                 and a quarter of its size around it) and are not drawn.</p>"
            );
        }
        html
    }

    /// The truth's box and some space around it, so that a phantom far away does not shrink the
    /// picture; the map's own box if there is no truth.
    fn frame(&self) -> Option<(DVec3, DVec3)> {
        let (low, high) = box_of(self.kinds[TRUTH].iter())
            .or_else(|| box_of(self.kinds[AMBIGUOUS..].iter().flatten()))?;
        let margin = (0.25 * (high - low).max_element()).max(0.1);
        let map = box_of(self.kinds[AMBIGUOUS..].iter().flatten());
        let (map_low, map_high) = map.unwrap_or((low, high));
        Some((
            low.min(map_low.max(low - margin)),
            high.max(map_high.min(high + margin)),
        ))
    }

    fn outside_count(&self, low: DVec3, high: DVec3) -> usize {
        let map = self.kinds[AMBIGUOUS..].iter().flatten();
        map.filter(|point| !inside(**point, low, high)).count()
    }

    fn legend(&self) -> String {
        let mut html = "<ul class=\"legend\">".to_owned();
        let count = |kind: usize| self.kinds[kind].len();
        if self.has_truth {
            let _ = write!(html, "<li><i class=\"p0\"></i>truth seen</li>");
            for (class, name) in ERROR_NAMES.iter().enumerate() {
                let kind = AMBIGUOUS + 1 + class;
                let count = count(kind);
                let _ = write!(
                    html,
                    "<li><i class=\"p{kind}\"></i>{name} <small>{count}</small></li>"
                );
            }
        } else {
            let count = count(ASSERTED);
            let _ = write!(
                html,
                "<li><i class=\"p{ASSERTED}\"></i>asserted <small>{count}</small></li>"
            );
        }
        let ambiguous = count(AMBIGUOUS);
        let _ = write!(
            html,
            "<li><i class=\"p1\"></i>ambiguous <small>{ambiguous}</small></li>"
        );
        html + "</ul>\n"
    }

    fn view_svg(&self, view: &View, low: DVec3, high: DVec3, per_m: f64) -> (String, bool) {
        let (low_2d, high_2d) = (view.flat(low), view.flat(high));
        let size = (high_2d - low_2d) * per_m;
        let left = LEFT + 0.5 * (VIEW_WIDTH - LEFT - MARGIN - size.x);
        let axes = Axes {
            low: low_2d,
            high: high_2d,
            from: DVec2::new(left, TOP + size.y),
            to: DVec2::new(left + size.x, TOP),
        };
        let height = TOP + size.y + BOTTOM;
        let place = |point: DVec3| axes.place(view.flat(point));
        let mut svg = format!(
            "<svg viewBox=\"0 0 {VIEW_WIDTH} {:.0}\" role=\"img\" aria-label=\"the map {}\">{}",
            height + BAR_ROOM,
            view.name,
            axes.to_svg(view.along, view.upward)
        );
        let mut is_thinned = false;
        for (kind, points) in self.kinds.iter().enumerate() {
            let shown = points.iter().filter(|point| inside(**point, low, high));
            let (dots, thinned) = dots(shown.map(|point| place(*point)));
            is_thinned |= thinned;
            if !dots.is_empty() {
                let _ = write!(svg, "<path class=\"p{kind}\" d=\"{dots}\"/>");
            }
        }
        svg += &scale_bar(per_m, 0.35 * VIEW_WIDTH, LEFT, height + 8.0);
        (svg + "</svg>", is_thinned)
    }
}

fn inside(point: DVec3, low: DVec3, high: DVec3) -> bool {
    point.cmpge(low).all() && point.cmple(high).all()
}

fn box_of<'a>(points: impl Iterator<Item = &'a DVec3>) -> Option<(DVec3, DVec3)> {
    let finite = points.filter(|point| point.is_finite()).map(|p| (*p, *p));
    finite.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// One dot per unit square, at most [`MAX_DOTS`], evenly chosen; and whether any was left out.
fn dots(places: impl Iterator<Item = DVec2>) -> (String, bool) {
    let mut seen = BTreeSet::new();
    let mut kept: Vec<DVec2> = Vec::new();
    let mut count = 0;
    for place in places {
        count += 1;
        if seen.insert((place.x.floor() as i64, place.y.floor() as i64)) {
            kept.push(place);
        }
    }
    let stride = kept.len().div_ceil(MAX_DOTS).max(1);
    let mut path = String::new();
    let mut drawn = 0;
    for place in kept.iter().step_by(stride) {
        let _ = write!(path, "M{:.1} {:.1}h0", place.x, place.y);
        drawn += 1;
    }
    (path, drawn < count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_classed_by_their_error() {
        let truth = Truth::from_points(&[DVec3::ZERO, DVec3::X]);
        let errors = [0.0, 0.03, 0.08, 0.2, 0.3, 40.0];
        let mut points = MapPoints::of_positions(errors.map(|e| DVec3::Z * -e));
        points.ambiguous.push(DVec3::Y);
        let picture = Picture::new(&points, &truth);
        let counts: Vec<usize> = picture.kinds.iter().map(Vec::len).collect();
        assert_eq!(counts, [2, 1, 1, 1, 1, 1, 2]);
        let html = picture.to_html();
        assert_eq!(html.matches("<svg").count(), 3);
        // The far phantom, the ambiguous one 1 m off, and the point 0.3 m off.
        assert!(html.contains("3 points lie outside"), "{html}");
        assert!(!html.contains("NaN") && !html.contains("inf"));
    }

    #[test]
    fn a_million_points_stay_small() {
        let grid = (0..1_000_000).map(|i| DVec2::new(f64::from(i % 1000), f64::from(i / 1000)));
        let (path, is_thinned) = dots(grid);
        assert!(is_thinned && path.len() < 100_000, "{}", path.len());
    }

    #[test]
    fn nothing_is_said_to_be_nothing() {
        let nothing = Picture::new(&MapPoints::default(), &Truth::from_points(&[]));
        assert!(nothing.to_html().contains("nothing to show"));
        let one = Picture::new(&MapPoints::default(), &Truth::from_points(&[DVec3::ONE]));
        assert!(!one.to_html().contains("NaN"));
    }
}
