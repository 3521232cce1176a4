//! A chart as a file of its own: style and legend inside, so that any page can show it.

use std::fmt::Write;

use crate::chart::COLOR_COUNT;
use crate::{Plot, escape};

/// As wide and as high as a chart without its legend.
const WIDTH: usize = 480;
const HEIGHT: usize = 320;
/// Of a line of the legend.
const LINE: usize = 20;
/// Colours of the light page: a picture does not know what is around it.
const STYLE: &str = "text{fill:#5b6670;font:13px system-ui,sans-serif}.title{fill:#1d2329;font-weight:600;font-size:14px}\
.grid{stroke:#dfe4e8;fill:none}.frame{stroke:#5b6670;fill:none;stroke-width:1.2}\
.line{stroke:currentColor;fill:none;stroke-width:2;stroke-linejoin:round}\
.dots{stroke:currentColor;fill:none;stroke-width:5;stroke-linecap:round}.mark{font-size:9px}\
.ring{stroke:#1d2329;fill:none;stroke-width:1.6}.band{fill:currentColor;opacity:.16}\
.s0{color:#0072b2}.s1{color:#d55e00}.s2{color:#009e73}.s3{color:#b8588f}.s4{color:#b58900}.s5{color:#4aa3df}.s6{color:#7a7a7a}";

impl Plot {
    /// As one SVG document. Lines beyond the seventh are not drawn: there is no colour left.
    #[must_use]
    pub fn to_svg_file(&self) -> String {
        let names: Vec<&str> = self.lines.iter().map(|line| line.0.as_str()).collect();
        let names = &names[..names.len().min(COLOR_COUNT)];
        let height = HEIGHT + LINE * names.len().div_ceil(2) + 8;
        let size = format!("<svg width=\"{WIDTH}\" height=\"{HEIGHT}\" ");
        let chart = self.to_svg(names).replacen("<svg ", &size, 1);
        let mut legend = String::new();
        for (index, name) in names.iter().enumerate() {
            let (x, y) = (60 + (index % 2) * 210, HEIGHT + LINE * (index / 2) + 12);
            let _ = write!(
                legend,
                "<g class=\"s{index}\"><path class=\"line\" d=\"M{} {y}h16\"/></g>\
                 <text x=\"{x}\" y=\"{}\">{}</text>",
                x - 22,
                y + 4,
                escape(name)
            );
        }
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\"><style>{STYLE}</style>\
             <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"#fff\"/>{chart}{legend}</svg>\n"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_its_style_and_a_legend_of_what_is_drawn() {
        let line = |name: &str| (name.to_owned(), vec![(1.0, 2.0), (2.0, 1.0)]);
        let plot = Plot {
            x_label: "s".to_owned(),
            y_label: "CD, m".to_owned(),
            lines: vec![line("a < b"), line("c")],
            ..Plot::default()
        };
        let svg = plot.to_svg_file();
        assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"));
        assert_eq!(svg.matches("a &lt; b</text>").count(), 1);
        assert_eq!(svg.matches("<svg ").count(), 2);
        assert!(!svg.contains("var(") && svg.len() < 6000, "{}", svg.len());
        let many = Plot {
            lines: (0..9).map(|index| line(&index.to_string())).collect(),
            ..plot
        };
        assert!(!many.to_svg_file().contains(">7</text>"));
    }
}
