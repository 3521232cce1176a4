//! What measurements look like: tables for a terminal, and one HTML file that says how a run went, with
//! curves, tables, and the map beside the truth.
//!
//! Self-contained: no font, no picture and no address of another host, so that it can be mailed and
//! opened at sea; the one script, of a dive's report, draws the map. A section has at most four charts of at most seven
//! lines before the reader asks for more. What a client is handed prints on A4. Deliberately absent: files, and what figures mean or must reach.

mod axes;
mod changes;
mod chart;
mod curves;
mod dive;
mod map_view;
mod picture;
pub mod results;
mod sheet;
mod sonar_image;
mod svg_file;
pub mod table;
mod trajectory;

use std::fmt::Write;

pub use changes::{CHANGES, ChangeColor, ChangeReport};
pub use dive::{DiveReport, Handout};
pub use map_view::{MAX_GAUSSIANS, MapView};
pub use picture::Picture;
pub use sheet::{Bearings, Drawn, Numbered, Sheet, Shown, Side};
pub use sonar_image::{Column, Panel, SonarImage};
pub use trajectory::Trajectory;

use curves::{curves_html, plots_html, samples_html};
use echosplat_metrics::Metrics;
use echosplat_metrics::curve::{Curve, bands};

const STYLE: &str = include_str!("style.css");

/// Rows of named values.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    /// What it shows; may be empty.
    pub title: String,
    /// Names of the columns; without any, rows are a name and its value.
    pub columns: Vec<String>,
    /// Cells; the first of a row names it.
    pub rows: Vec<Vec<String>>,
    /// Said below it.
    pub note: String,
}

/// A cell that says this is drawn as what went wrong.
pub const FAILED: &str = "failed";

/// Charts of a section before the reader asks for more.
const MOST_CHARTS: usize = 4;

/// A cell longer than this is read as words rather than compared as a value.
const WORDS_BYTES: usize = 48;

/// Numbers over a number, on logarithmic axes unless said otherwise; what has no logarithm is left out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Plot {
    /// What is along, with its unit.
    pub x_label: String,
    /// What is up, with its unit.
    pub y_label: String,
    /// Whether what is along has an even axis, as decibels have.
    pub x_is_linear: bool,
    /// Whether what is up has an even axis, as counts have.
    pub y_is_linear: bool,
    /// Name and points of each line.
    pub lines: Vec<(String, Vec<(f64, f64)>)>,
    /// Places with words beside them.
    pub marks: Vec<Mark>,
}

/// A place in a plot that is named.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mark {
    /// Along and up.
    pub at: (f64, f64),
    /// Beside it.
    pub text: String,
    /// Whether a ring is drawn around it.
    pub is_ringed: bool,
}

/// One scene, or one question.
#[derive(Debug, Clone, Default)]
pub struct Section {
    /// Its heading.
    pub title: String,
    /// What was done, in a sentence or two.
    pub text: String,
    /// Runs whose error is drawn over time; those of one method become a band over their seeds.
    pub curves: Vec<Curve>,
    /// The final map's figures.
    pub metrics: Option<Metrics>,
    /// The map beside the truth.
    pub picture: Option<Picture>,
    /// Whatever else is worth a curve; their lines share one legend, by name.
    pub plots: Vec<Plot>,
    /// More tables.
    pub tables: Vec<Table>,
}

/// The whole report.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// Its heading.
    pub title: String,
    /// What was run: the command, or a sentence.
    pub subtitle: String,
    /// Figures worth reading first: name and value.
    pub highlights: Vec<(String, String)>,
    /// The machine, versions and whatever else a reader needs to repeat it.
    pub machine: Vec<(String, String)>,
    /// Seeds of all runs.
    pub seeds: Vec<u64>,
    /// What was left out, and other words of caution.
    pub notes: Vec<String>,
    /// The rest.
    pub sections: Vec<Section>,
}

impl Report {
    /// As one HTML document.
    #[must_use]
    pub fn to_html(&self) -> String {
        let mut html = format!(
            "<header><h1>{}</h1><p>{}</p></header>\n",
            escape(&self.title),
            escape(&self.subtitle)
        );
        html += &highlights(&self.highlights);
        for section in &self.sections {
            html += &section.to_html();
        }
        html += &self.footer();
        page(&self.title, &html)
    }

    fn footer(&self) -> String {
        let judges_maps = |section: &Section| {
            section.metrics.is_some() || !section.curves.is_empty() || section.picture.is_some()
        };
        let own: &[&str] = match self.sections.iter().any(judges_maps) {
            true => &OF_MAPS,
            false => &[],
        };
        let mut machine = self.machine.clone();
        if !self.seeds.is_empty() {
            let seeds: Vec<String> = self.seeds.iter().map(u64::to_string).collect();
            machine.push(("seeds".into(), seeds.join(", ")));
        }
        let notes = self.notes.iter().map(String::as_str);
        page_footer(own.iter().copied().chain(notes), &facts_table(&machine))
    }
}

/// What figures of maps are.
pub const OF_MAPS: [&str; 4] = [
    "CD is half of accuracy (mean distance map → truth) plus completeness (mean distance \
     seen truth → map), HD the larger of the two directed maxima. Both are raw: nothing \
     aligned, nothing cropped, no threshold of the evaluator's.",
    "An empty map has infinite error, which no logarithmic axis can show: it is said below \
     the curve, not drawn.",
    "Compute time is CPU time of the mapper on the machine below and compares within this \
     report only; counted work (Gaussian–bin pairs and voxel observations) compares across machines.",
    "Confident but false is the share of what is asserted that is further than 0.25 m from \
     all truth; none at all is drawn at 0.01 %.",
];

/// Of every page.
const OF_NUMBERS: &str =
    "k, M, G and T behind a number are thousands, millions, billions and trillions.";

fn page_footer<'a>(notes: impl Iterator<Item = &'a str>, below: &str) -> String {
    let mut html = "<section><h2>How to read this</h2>\n<ul>\n".to_owned();
    for note in notes.chain([OF_NUMBERS]) {
        let _ = writeln!(html, "<li>{}</li>", escape(note));
    }
    html + "</ul>\n" + below + "</section>\n"
}

/// The whole document around what it shows.
fn page(title: &str, main: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta name=\"color-scheme\" content=\"light dark\">\
         <title>{}</title>\n<style>{STYLE}</style></head>\n<body><main>\n{main}</main></body></html>\n",
        escape(title)
    )
}

impl Section {
    fn to_html(&self) -> String {
        let mut html = format!("<section><h2>{}</h2>\n", escape(&self.title));
        if !self.text.is_empty() {
            let _ = writeln!(html, "<p>{}</p>", escape(&self.text));
        }
        html += &curves_html(&bands(&self.curves));
        html += &plots_html(&self.plots);
        if let Some(picture) = &self.picture {
            html += &picture.to_html();
        }
        if let Some(metrics) = &self.metrics {
            html += &facts_table(&table::facts(metrics));
        }
        html += &samples_html(&self.curves);
        for table in &self.tables {
            html += &table.to_html();
        }
        html + "</section>\n"
    }
}

impl Table {
    fn to_html(&self) -> String {
        let mut html = String::new();
        if !self.title.is_empty() {
            let _ = writeln!(html, "<h3>{}</h3>", escape(&self.title));
        }
        html += "<div class=\"wide\">";
        html += match self.columns.is_empty() {
            true => "<table class=\"facts\">",
            false => "<table><thead><tr>",
        };
        for column in &self.columns {
            let _ = write!(html, "<th>{}</th>", escape(column));
        }
        if !self.columns.is_empty() {
            html += "</tr></thead>";
        }
        html += "<tbody>\n";
        for row in &self.rows {
            html += "<tr>";
            for (index, cell) in row.iter().enumerate() {
                let tag = if index == 0 { "th" } else { "td" };
                let class = match cell.as_str() {
                    FAILED => " class=\"failed\"",
                    long if long.len() > WORDS_BYTES => " class=\"words\"",
                    _ => "",
                };
                let _ = write!(html, "<{tag}{class}>{}</{tag}>", escape(cell));
            }
            html += "</tr>\n";
        }
        html += "</tbody></table></div>\n";
        if !self.note.is_empty() {
            let _ = writeln!(html, "<p class=\"note\">{}</p>", escape(&self.note));
        }
        html
    }
}

fn highlights(highlights: &[(String, String)]) -> String {
    let mut html = "<dl class=\"highlights\">".to_owned();
    for (name, value) in highlights {
        let (name, value) = (escape(name), escape(value));
        let _ = write!(html, "<div><dt>{name}</dt><dd>{value}</dd></div>");
    }
    html + "</dl>\n"
}

fn facts_table(facts: &[(String, String)]) -> String {
    let mut html = "<div class=\"wide\"><table class=\"facts\"><tbody>\n".to_owned();
    for (name, value) in facts {
        let (name, value) = (escape(name), escape(value));
        let _ = writeln!(html, "<tr><th>{name}</th><td>{value}</td></tr>");
    }
    html + "</tbody></table></div>\n"
}

pub(crate) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            '"' => escaped += "&quot;",
            c if c.is_control() && c != '\n' => escaped.push(' '),
            c => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests;
