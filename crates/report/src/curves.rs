//! Curves as charts, at most four at once and of at most seven lines each, with what they cannot show.

use std::fmt::Write;

use echosplat_metrics::curve::{Band, Curve, Spread};

use crate::chart::{self, Axis, Chart, Line};
use crate::{MOST_CHARTS, Plot, escape, table};

/// Curves that are not errors over cost; the lines of one name have one colour, and a chart with more lines than colours
/// becomes several.
pub(crate) fn plots_html(plots: &[Plot]) -> String {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in plots.iter().flat_map(|plot| &plot.lines) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    if names.is_empty() {
        return String::new();
    }
    let (mut figures, mut legends) = (Vec::new(), String::new());
    for names in names.chunks(chart::COLOR_COUNT) {
        legends += "<ul class=\"legend\">";
        for (color, name) in names.iter().enumerate() {
            let _ = write!(
                legends,
                "<li><i class=\"s{color}\"></i>{}</li>",
                escape(name)
            );
        }
        legends += "</ul>\n";
        let own = |plot: &&Plot| {
            plot.lines
                .iter()
                .any(|line| names.contains(&line.0.as_str()))
        };
        for plot in plots.iter().filter(own) {
            figures.push(plot.to_svg(names));
        }
    }
    legends + &charts_html(&figures)
}

/// At most four at once; the others can be opened.
fn charts_html(figures: &[String]) -> String {
    let (first, others) = figures.split_at(figures.len().min(MOST_CHARTS));
    let charts = |figures: &[String]| {
        let mut html = "<div class=\"charts\">\n".to_owned();
        for figure in figures {
            let _ = writeln!(html, "<figure>{figure}</figure>");
        }
        html + "</div>\n"
    };
    match others.len() {
        0 => charts(first),
        count => {
            let (first, others) = (charts(first), charts(others));
            format!("{first}<details><summary>{count} more</summary>\n{others}</details>\n")
        }
    }
}

impl Plot {
    /// Its lines of these names.
    pub(crate) fn to_svg(&self, names: &[&str]) -> String {
        let chart = Chart {
            x_label: &self.x_label,
            y_label: &self.y_label,
            x_is_linear: self.x_is_linear,
            y_is_linear: self.y_is_linear,
            lines: names.iter().map(|name| self.line(name)).collect(),
            marks: &self.marks,
        };
        chart.to_svg()
    }

    /// The line of this name, empty if there is none.
    fn line(&self, name: &str) -> Line {
        let own = self.lines.iter().filter(|line| line.0 == name);
        let points = own.flat_map(|line| &line.1);
        Line {
            name: name.to_owned(),
            points: points.map(|&(x, y)| (x, Spread::of([y]))).collect(),
        }
    }
}

/// Errors over compute time and dive time and, where it was counted, work.
pub(crate) fn curves_html(bands: &[Band]) -> String {
    if bands.is_empty() {
        return String::new();
    }
    let counted = bands.iter().flat_map(|b| &b.points).any(|p| p.work > 0.0);
    let third = match counted {
        true => (Axis::Work, Axis::Chamfer),
        false => (Axis::Compute, Axis::Hausdorff),
    };
    let axes = [
        (Axis::Compute, Axis::Chamfer),
        (Axis::Dive, Axis::Chamfer),
        third,
        (Axis::Compute, Axis::False),
    ];
    let (mut figures, mut legends) = (Vec::new(), String::new());
    for bands in bands.chunks(chart::COLOR_COUNT) {
        legends += &legend(bands);
        for (x, y) in axes {
            let chart = Chart {
                x_label: x.label(),
                y_label: y.label(),
                x_is_linear: false,
                y_is_linear: false,
                lines: lines(bands, x, y),
                marks: &[],
            };
            figures.push(chart.to_svg());
        }
    }
    legends + &charts_html(&figures) + &not_drawn(bands)
}

fn lines(bands: &[Band], x: Axis, y: Axis) -> Vec<Line> {
    let line = |band: &Band| Line {
        name: band.method.clone(),
        points: band
            .points
            .iter()
            .map(|point| (x.of(point), y.spread_of(point)))
            .collect(),
    };
    bands.iter().map(line).collect()
}

fn legend(bands: &[Band]) -> String {
    let mut html = "<ul class=\"legend\">".to_owned();
    for (index, band) in bands.iter().enumerate() {
        let (method, count) = (escape(&band.method), band.seeds.len());
        let runs = if count == 1 {
            "one run".to_owned()
        } else {
            format!("{count} seeds")
        };
        let _ = write!(
            html,
            "<li><i class=\"s{}\"></i>{method} <small>{runs}</small></li>",
            index % chart::COLOR_COUNT
        );
    }
    let many = bands.iter().any(|band| band.seeds.len() > 1);
    let explained = if many {
        "<li><small>line: median; band: least to most</small></li>"
    } else {
        ""
    };
    html + explained + "</ul>\n"
}

/// What the curves cannot show: empty maps and failed runs.
fn not_drawn(bands: &[Band]) -> String {
    let mut html = String::new();
    for band in bands {
        let empty = band.points.iter().filter(|p| !p.cd_m.median.is_finite());
        let count = empty.clone().count();
        if count > 0 {
            let until_s = empty.map(|p| p.dive_s).fold(0.0, f64::max);
            let _ = writeln!(
                html,
                "<p class=\"note\">{}: {count} of {} samples (up to {until_s:.0} s of the dive) have \
                 an empty map, infinite error, not drawn.</p>",
                escape(&band.method),
                band.points.len()
            );
        }
        for (seed, reason) in &band.failures {
            let (method, reason) = (escape(&band.method), escape(reason));
            let _ = writeln!(
                html,
                "<p class=\"note failed\">{method}, seed {seed}: failed: {reason}</p>"
            );
        }
    }
    html
}

/// The samples of each run as a table to be opened.
pub(crate) fn samples_html(curves: &[Curve]) -> String {
    let mut html = String::new();
    for curve in curves.iter().filter(|curve| !curve.samples.is_empty()) {
        let (method, seed) = (escape(&curve.method), curve.seed);
        let text = escape(&table::curve(curve));
        let _ = writeln!(
            html,
            "<details><summary>{method}, seed {seed}: samples</summary><pre>{text}</pre></details>"
        );
    }
    html
}
