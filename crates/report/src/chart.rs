//! Curves with bands on logarithmic axes, or even ones where they are asked for, as SVG.

use std::fmt::Write;

use crate::Mark;
use crate::axes::number;
use echosplat_metrics::curve::{BandPoint, Spread};

/// Colours in the style sheet; further lines start over.
pub(super) const COLOR_COUNT: usize = 7;

const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 54.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 44.0;

/// What an axis shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Axis {
    Compute,
    Dive,
    Work,
    Chamfer,
    Hausdorff,
    False,
}

/// A share of 0 is drawn here: it has no logarithm.
const LEAST_SHARE: f64 = 1e-4;

impl Axis {
    pub(super) fn label(self) -> &'static str {
        match self {
            Self::Compute => "compute time, CPU s",
            Self::Dive => "dive time, s",
            Self::Work => "work, pairs + voxel observations (M: million, G: billion)",
            Self::Chamfer => "CD, m",
            Self::Hausdorff => "HD, m",
            Self::False => "confident but false, share",
        }
    }

    pub(super) fn of(self, point: &BandPoint) -> f64 {
        match self {
            Self::Compute => point.compute_s,
            Self::Dive => point.dive_s,
            Self::Work => point.work,
            Self::Chamfer => point.cd_m.median,
            Self::Hausdorff => point.hd_m.median,
            Self::False => point.false_share.median,
        }
    }

    /// Of the three errors.
    pub(super) fn spread_of(self, point: &BandPoint) -> Spread {
        match self {
            Self::Hausdorff => point.hd_m,
            Self::False => point.false_share.at_least(LEAST_SHARE),
            _ => point.cd_m,
        }
    }
}

/// One method.
pub(super) struct Line {
    pub(super) name: String,
    pub(super) points: Vec<(f64, Spread)>,
}

/// One error over one cost.
pub(super) struct Chart<'a> {
    pub(super) x_label: &'a str,
    pub(super) y_label: &'a str,
    pub(super) x_is_linear: bool,
    pub(super) y_is_linear: bool,
    pub(super) lines: Vec<Line>,
    pub(super) marks: &'a [Mark],
}

impl Chart<'_> {
    pub(super) fn to_svg(&self) -> String {
        let (x_label, y_label) = (super::escape(self.x_label), super::escape(self.y_label));
        let mut svg = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" \
             aria-label=\"{y_label} over {x_label}\">"
        );
        let drawn: Vec<Vec<(f64, Spread)>> = {
            let lines = self.lines.iter();
            lines
                .map(|line| drawable(line, self.x_is_linear, self.y_is_linear))
                .collect()
        };
        let points = || drawn.iter().flatten();
        let along = points().map(|p| p.0);
        let x = match self.x_is_linear {
            true => Scale::evenly_over(along, LEFT, WIDTH - RIGHT),
            false => Scale::over(along, LEFT, WIDTH - RIGHT),
        };
        let errors = points().flat_map(|p| [p.1.min, p.1.median, p.1.max]);
        let y = match self.y_is_linear {
            true => Scale::evenly_over(errors.chain([0.0]), HEIGHT - BOTTOM, TOP),
            false => Scale::over(errors, HEIGHT - BOTTOM, TOP),
        };
        let _ = write!(
            svg,
            "<text class=\"axis\" x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{x_label}</text>\
             <text class=\"title\" x=\"4\" y=\"16\">{y_label}</text>",
            0.5 * (LEFT + WIDTH - RIGHT),
            HEIGHT - 6.0,
        );
        let (Some(x), Some(y)) = (x, y) else {
            return svg
                + "<text class=\"axis\" x=\"240\" y=\"160\" text-anchor=\"middle\">nothing to \
                   draw</text></svg>";
        };
        svg += &grid(&x, &y);
        for (index, points) in drawn.iter().enumerate() {
            svg += &line_svg(index % COLOR_COUNT, &self.lines[index].name, points, &x, &y);
        }
        for mark in self.marks {
            svg += &mark_svg(mark, &x, &y);
        }
        svg + "</svg>"
    }
}

/// What is finite and, on a logarithmic axis, has a logarithm.
fn drawable(line: &Line, x_is_linear: bool, y_is_linear: bool) -> Vec<(f64, Spread)> {
    let shows = |v: f64, is_linear: bool| v.is_finite() && (is_linear || v > 0.0);
    let points = line.points.iter().copied();
    points
        .filter(|(x, y)| {
            shows(*x, x_is_linear) && [y.median, y.min].iter().all(|v| shows(*v, y_is_linear))
        })
        .collect()
}

/// An axis from data to the drawing.
struct Scale {
    /// Not logarithmic.
    is_linear: bool,
    low: f64,
    high: f64,
    start: f64,
    end: f64,
}

impl Scale {
    /// Over all finite values, widened a little; `None` without any.
    fn over(values: impl Iterator<Item = f64>, start: f64, end: f64) -> Option<Self> {
        let (low, high) = ends(values.filter(|v| *v > 0.0));
        // At least a factor of three, so that a flat curve looks flat.
        let widen = (3.0 / (high / low)).sqrt().max(1.08);
        (high > 0.0).then(|| Self {
            is_linear: false,
            low: (low / widen).max(f64::MIN_POSITIVE),
            high: high * widen,
            start,
            end,
        })
    }

    /// The same on an even axis.
    fn evenly_over(values: impl Iterator<Item = f64>, start: f64, end: f64) -> Option<Self> {
        let (low, high) = ends(values);
        let widen = match high > low {
            true => 0.04 * (high - low),
            false => 0.5,
        };
        // An axis of counts begins at 0, not below it.
        let lowest = if low >= 0.0 { 0.0 } else { f64::NEG_INFINITY };
        (high >= low).then_some(Self {
            is_linear: true,
            low: (low - widen).max(lowest),
            high: high + widen,
            start,
            end,
        })
    }

    fn at(&self, value: f64) -> f64 {
        let value = value.clamp(self.low, self.high);
        let share = match self.is_linear {
            true => (value - self.low) / (self.high - self.low),
            false => (value / self.low).ln() / (self.high / self.low).ln(),
        };
        self.start + share * (self.end - self.start)
    }

    /// Decades, or 1-2-5 where there are few; on an even axis four to ten round numbers.
    fn ticks(&self) -> Vec<f64> {
        if self.is_linear {
            return crate::axes::ticks(self.low, self.high, 10.0);
        }
        let decades = (self.high / self.low).log10();
        let steps: &[f64] = match decades {
            d if d < 2.2 => &[1.0, 2.0, 5.0],
            _ => &[1.0],
        };
        let every = (decades / 7.0).ceil().max(1.0) as i32;
        let (first, last) = (
            self.low.log10().floor() as i32,
            self.high.log10().ceil() as i32,
        );
        (first..=last)
            .filter(|power| power.rem_euclid(every) == 0)
            .flat_map(|power| steps.iter().map(move |step| step * 10_f64.powi(power)))
            .filter(|tick| *tick >= self.low && *tick <= self.high)
            .collect()
    }
}

/// Least and most of those that are finite; the least above the most if there are none.
fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let finite = values.filter(|v| v.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    })
}

fn grid(x: &Scale, y: &Scale) -> String {
    let (bottom, right) = (HEIGHT - BOTTOM, WIDTH - RIGHT);
    let mut svg = String::new();
    for tick in x.ticks() {
        let (at, below) = (x.at(tick), bottom + 16.0);
        let _ = write!(
            svg,
            "<path class=\"grid\" d=\"M{at:.1} {TOP}V{bottom}\"/><text class=\"tick\" x=\"{at:.1}\" \
             y=\"{below}\" text-anchor=\"middle\">{}</text>",
            number(tick)
        );
    }
    for tick in y.ticks() {
        let (at, before) = (y.at(tick), LEFT - 6.0);
        let _ = write!(
            svg,
            "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{right}\"/><text class=\"tick\" x=\"{before}\" \
             y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            at + 4.0,
            number(tick)
        );
    }
    svg + &format!("<path class=\"frame\" d=\"M{LEFT} {TOP}V{bottom}H{right}\"/>")
}

fn line_svg(color: usize, name: &str, points: &[(f64, Spread)], x: &Scale, y: &Scale) -> String {
    let name = super::escape(name);
    let path = |of: &dyn Fn(&Spread) -> f64| -> Vec<String> {
        let place =
            |(at, error): &(f64, Spread)| format!("{:.1} {:.1}", x.at(*at), y.at(of(error)));
        points.iter().map(place).collect()
    };
    let mut svg = format!("<g class=\"s{color}\"><title>{name}</title>");
    if points.iter().any(|(_, error)| error.max > error.min) {
        let (upper, mut lower) = (path(&|e| e.max), path(&|e| e.min));
        lower.reverse();
        let outline = [upper, lower].concat().join("L");
        let _ = write!(svg, "<path class=\"band\" d=\"M{outline}Z\"/>");
    }
    let middle = path(&|e| e.median);
    if !middle.is_empty() {
        let _ = write!(svg, "<path class=\"line\" d=\"M{}\"/>", middle.join("L"));
        let dots: Vec<String> = middle.iter().map(|place| format!("M{place}h0")).collect();
        let _ = write!(svg, "<path class=\"dots\" d=\"{}\"/>", dots.concat());
    }
    svg + "</g>"
}

/// Words beside a place, to its left in the right part of the chart.
fn mark_svg(mark: &Mark, x: &Scale, y: &Scale) -> String {
    let is_shown = |value: f64| value > 0.0 && value.is_finite();
    if !is_shown(mark.at.0) || !is_shown(mark.at.1) {
        return String::new();
    }
    let (along, up) = (x.at(mark.at.0), y.at(mark.at.1));
    let (shift, anchor) = match along > 0.75 * WIDTH {
        true => (-7.0, "end"),
        false => (7.0, "start"),
    };
    let ring = match mark.is_ringed {
        true => format!("<circle class=\"ring\" cx=\"{along:.1}\" cy=\"{up:.1}\" r=\"6\"/>"),
        false => String::new(),
    };
    format!(
        "{ring}<text class=\"mark\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}</text>",
        along + shift,
        up - 4.0,
        super::escape(&mark.text)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_is_logarithmic_and_has_round_ticks() {
        let scale = Scale::over(
            [0.01, 1.0, f64::INFINITY, 0.0, f64::NAN].into_iter(),
            0.0,
            100.0,
        );
        let scale = scale.unwrap();
        assert!((scale.at(0.1) - 50.0).abs() < 1e-9);
        let ticks: Vec<String> = scale.ticks().into_iter().map(number).collect();
        assert_eq!(ticks, ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1"]);
        assert!(Scale::over([f64::INFINITY].into_iter(), 0.0, 1.0).is_none());
        let wide = Scale::over([1.0, 1e20].into_iter(), 0.0, 1.0)
            .unwrap()
            .ticks();
        assert!(wide.len() <= 8, "{wide:?}");
    }

    #[test]
    fn an_even_axis_has_even_ticks() {
        let scale = Scale::evenly_over([6.0, 40.0, f64::INFINITY].into_iter(), 0.0, 100.0);
        let scale = scale.unwrap();
        assert!((scale.at(23.0) - 50.0).abs() < 1e-9);
        let ticks: Vec<String> = scale.ticks().into_iter().map(number).collect();
        assert_eq!(ticks, ["5", "10", "15", "20", "25", "30", "35", "40"]);
        assert!(Scale::evenly_over(std::iter::empty(), 0.0, 1.0).is_none());
        assert!(
            !Scale::evenly_over([7.0].into_iter(), 0.0, 1.0)
                .unwrap()
                .ticks()
                .is_empty()
        );
    }

    #[test]
    fn what_cannot_be_drawn_is_left_out_and_nothing_is_not_a_number() {
        let spread = |v| Spread::of([v]);
        let points = vec![
            (0.0, spread(1.0)),
            (1.0, spread(f64::INFINITY)),
            (2.0, spread(0.5)),
            (4.0, spread(0.5)),
        ];
        let chart = |points| Chart {
            x_label: Axis::Dive.label(),
            y_label: Axis::Chamfer.label(),
            x_is_linear: false,
            y_is_linear: false,
            lines: vec![Line {
                name: "a<b".into(),
                points,
            }],
            marks: &[],
        };
        let svg = chart(points).to_svg();
        assert_eq!(svg.matches("h0").count(), 2);
        assert!(svg.contains("a&lt;b") && !svg.contains("NaN") && !svg.contains("inf"));
        assert!(chart(vec![]).to_svg().contains("nothing to draw"));
    }

    #[test]
    fn marks_are_words_beside_places_that_can_be_drawn() {
        let mark = |at, is_ringed| Mark {
            at,
            text: "8 < 9".into(),
            is_ringed,
        };
        let marks = [mark((1.0, 1.0), true), mark((2.0, f64::INFINITY), true)];
        let chart = Chart {
            x_label: "a",
            y_label: "b",
            x_is_linear: false,
            y_is_linear: false,
            lines: vec![Line {
                name: "c".into(),
                points: vec![(1.0, Spread::of([1.0])), (2.0, Spread::of([2.0]))],
            }],
            marks: &marks,
        };
        let svg = chart.to_svg();
        assert_eq!(svg.matches("class=\"ring\"").count(), 1);
        assert_eq!(svg.matches("8 &lt; 9").count(), 1);
    }
}
