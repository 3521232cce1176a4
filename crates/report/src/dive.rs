//! The report of one dive.

use std::fmt::Write;

use crate::{
    MapView, Picture, Plot, Sheet, Table, Trajectory, escape, facts_table, highlights, page,
    page_footer, plots_html,
};

/// What of a report is for whoever ordered the dive: printed on A4, its pages stand before and behind all that is only to
/// be looked at on a screen.
#[derive(Debug, Clone, Default)]
pub struct Handout {
    /// Rows of the title block: for whom, where, when.
    pub about: Vec<(String, String)>,
    /// Figures worth reading first: name and value.
    pub highlights: Vec<(String, String)>,
    /// On the first page.
    pub tables: Vec<Table>,
    /// A page each.
    pub sheets: Vec<Sheet>,
    /// On the last page: settings, and what went wrong.
    pub last: Vec<Table>,
}

/// Names the page of the track.
const TRAJECTORY: &str = "Trajectory";

/// One dive, in the order that its reader wants it.
#[derive(Debug, Clone)]
pub struct DiveReport {
    /// Its heading.
    pub title: String,
    /// What was run, in a sentence or two.
    pub text: String,
    /// What came of it, in one sentence.
    pub verdict: String,
    /// What is printed.
    pub handout: Handout,
    /// To be turned.
    pub view: MapView,
    /// From three sides; stands for the view where a browser cannot draw that.
    pub picture: Picture,
    /// Where the sonar was.
    pub trajectory: Trajectory,
    /// The first four are drawn.
    pub plots: Vec<Plot>,
    /// Figures.
    pub tables: Vec<Table>,
    /// Words to read it by.
    pub notes: Vec<String>,
    /// The machine, versions and whatever else a reader needs to repeat it.
    pub machine: Vec<(String, String)>,
}

impl DiveReport {
    /// As one HTML document that needs nothing beside it. Its script draws the map and reaches nowhere.
    #[must_use]
    pub fn to_html(&self) -> String {
        let handout = &self.handout;
        let mut html = format!("<header><h1>{}</h1></header>\n", escape(&self.title));
        if !handout.about.is_empty() {
            html += &facts_table(&handout.about);
        }
        let _ = writeln!(html, "<p class=\"verdict\">{}</p>", escape(&self.verdict));
        if !handout.highlights.is_empty() {
            html += &highlights(&handout.highlights);
        }
        html += "<div class=\"screen\">\n";
        html += &self.view.to_html();
        html += "<div id=\"flat\">\n";
        html += &self.picture.to_html();
        html += "</div>\n</div>\n";
        for table in &handout.tables {
            html += &table.to_html();
        }
        for sheet in &handout.sheets {
            html += &sheet.to_html();
        }
        if !handout.sheets.iter().any(|sheet| sheet.title == TRAJECTORY) {
            html += &Sheet::new(TRAJECTORY)
                .html(&self.trajectory.to_html())
                .to_html();
        }
        let plots = &self.plots[..self.plots.len().min(crate::MOST_CHARTS)];
        if !plots.is_empty() {
            let _ = writeln!(
                html,
                "<section class=\"screen\"><h2>Over the dive</h2>\n{}</section>",
                plots_html(plots)
            );
        }
        if !self.tables.is_empty() {
            html += "<section class=\"screen\"><h2>Figures</h2>\n";
            for table in &self.tables {
                html += &table.to_html();
            }
            html += "</section>\n";
        }
        let _ = writeln!(
            html,
            "<section class=\"sheet\"><h2>What was run</h2>\n<p>{}</p>",
            escape(&self.text)
        );
        for table in &handout.last {
            html += &table.to_html();
        }
        html += &facts_table(&self.machine);
        html += "</section>\n";
        html += "<div class=\"screen\">\n";
        html += &page_footer(self.notes.iter().map(String::as_str), "");
        html += "</div>\n";
        let _ = writeln!(
            html,
            "<script type=\"module\">\n{}</script>",
            echosplat_page::viewer_script()
        );
        page(&self.title, &html)
    }
}
