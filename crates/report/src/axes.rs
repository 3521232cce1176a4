//! Axes of a drawing and its scale, in SVG.

use std::fmt::Write;

use glam::DVec2;

/// Room for the numbers of the axis up, and for those of the axis along with its name.
pub(super) const LEFT: f64 = 40.0;
pub(super) const BOTTOM: f64 = 40.0;

/// A rectangle of the drawing that stands for a range of numbers along and up.
pub(super) struct Axes {
    /// Numbers at the lower left, and at the upper right.
    pub(super) low: DVec2,
    pub(super) high: DVec2,
    /// The same corners in the drawing, whose y goes down.
    pub(super) from: DVec2,
    pub(super) to: DVec2,
}

impl Axes {
    pub(super) fn place(&self, at: DVec2) -> DVec2 {
        let size = (self.high - self.low).max(DVec2::splat(1e-9));
        self.from + (at - self.low) / size * (self.to - self.from)
    }

    /// Ticks with their numbers, and what they are.
    pub(super) fn to_svg(&self, along: &str, up: &str) -> String {
        let (DVec2 { x: left, y: bottom }, DVec2 { x: right, y: top }) = (self.from, self.to);
        let mut svg =
            format!("<path class=\"frame\" d=\"M{left:.1} {top:.1}V{bottom:.1}H{right:.1}\"/>");
        for tick in ticks(self.low.x, self.high.x, ((right - left) / 45.0).max(2.0)) {
            let x = self.place(DVec2::new(tick, self.low.y)).x;
            let (below, said) = (bottom + 15.0, number(tick));
            let _ = write!(
                svg,
                "<path class=\"frame\" d=\"M{x:.1} {bottom:.1}v4\"/><text class=\"tick\" x=\"{x:.1}\" \
                 y=\"{below:.1}\" text-anchor=\"middle\">{said}</text>"
            );
        }
        for tick in ticks(self.low.y, self.high.y, ((bottom - top) / 25.0).max(2.0)) {
            let y = self.place(DVec2::new(self.low.x, tick)).y;
            let (before, middle, said) = (left - 6.0, y + 4.0, number(tick));
            let _ = write!(
                svg,
                "<path class=\"frame\" d=\"M{left:.1} {y:.1}h-4\"/><text class=\"tick\" x=\"{before:.1}\" \
                 y=\"{middle:.1}\" text-anchor=\"end\">{said}</text>"
            );
        }
        let (middle, under) = (0.5 * (left + right), bottom + 31.0);
        let _ = write!(
            svg,
            "<text class=\"axis\" x=\"{middle:.1}\" y=\"{under:.1}\" text-anchor=\"middle\">{along}</text>\
             <text class=\"axis\" x=\"4\" y=\"12\">{up}</text>"
        );
        svg
    }
}

/// Round numbers between two, at most so many and one.
pub(super) fn ticks(low: f64, high: f64, most: f64) -> Vec<f64> {
    let span = high - low;
    if !(span.is_finite() && span > 1e-9) {
        return vec![low];
    }
    let decade = 10_f64.powf((span / most).log10().floor());
    let fits = |step: &f64| span / (step * decade) <= most;
    let step = [1.0, 2.0, 5.0].into_iter().find(fits).unwrap_or(10.0) * decade;
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).map(|index| index as f64 * step).collect()
}

/// Of an axis: no more decimals than it needs, a true minus.
pub(super) fn number(value: f64) -> String {
    crate::table::quantity(value).replace('-', "−")
}

/// A bar of a round length, at most `most` units long, with its length beside it.
pub(super) fn scale_bar(per_m: f64, most: f64, x: f64, y: f64) -> String {
    let most_m = most / per_m;
    let decade = 10_f64.powf(most_m.log10().floor());
    let digit = [5.0, 2.0, 1.0].into_iter().find(|d| d * decade <= most_m);
    let length_m = digit.unwrap_or(1.0) * decade;
    let length = length_m * per_m;
    format!(
        "<path class=\"bar\" d=\"M{x:.1} {:.1}v4h{length:.1}v-4\"/><text class=\"tick\" x=\"{:.1}\" \
         y=\"{:.1}\">{} m</text>",
        y - 4.0,
        x + length + 6.0,
        y + 3.0,
        number(length_m)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_few() {
        assert_eq!(ticks(-3.2, 3.1, 6.0), [-2.0, 0.0, 2.0]);
        assert_eq!(ticks(7.0, 7.0, 6.0), [7.0]);
        assert!(ticks(0.0, 1234.5, 6.0).len() <= 7);
        assert_eq!(number(-0.5), "−0.5");
    }

    #[test]
    fn numbers_have_their_place() {
        let axes = Axes {
            low: DVec2::new(-1.0, 0.0),
            high: DVec2::new(1.0, 10.0),
            from: DVec2::new(40.0, 200.0),
            to: DVec2::new(240.0, 0.0),
        };
        assert_eq!(axes.place(DVec2::new(0.0, 5.0)), DVec2::new(140.0, 100.0));
        let svg = axes.to_svg("east, m", "up, m");
        assert!(svg.contains("east, m") && svg.contains(">−1<") && svg.contains(">10<"));
        assert!(
            scale_bar(10.0, 80.0, 0.0, 0.0).contains("> 5 m<")
                || scale_bar(10.0, 80.0, 0.0, 0.0).contains(">5 m<")
        );
    }
}
