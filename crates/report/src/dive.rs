//! The report of one dive.

use std::fmt::Write;

use crate::{
    MapView, Picture, Plot, Table, Trajectory, escape, facts_table, page, page_footer, plots_html,
};

/// One dive, in the order that its reader wants it.
#[derive(Debug, Clone)]
pub struct DiveReport {
    /// Its heading.
    pub title: String,
    /// What was run, in a sentence or two.
    pub text: String,
    /// What came of it, in one sentence.
    pub verdict: String,
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
        let mut html = format!(
            "<header><h1>{}</h1></header>\n<p class=\"verdict\">{}</p>\n",
            escape(&self.title),
            escape(&self.verdict)
        );
        html += &self.view.to_html();
        html += "<div id=\"flat\">\n";
        html += &self.picture.to_html();
        html += "</div>\n<section><h2>Trajectory</h2>\n";
        html += &self.trajectory.to_html();
        html += "</section>\n";
        let plots = &self.plots[..self.plots.len().min(crate::MOST_CHARTS)];
        if !plots.is_empty() {
            let _ = writeln!(
                html,
                "<section><h2>Over the dive</h2>\n{}</section>",
                plots_html(plots)
            );
        }
        html += "<section><h2>Figures</h2>\n";
        for table in &self.tables {
            html += &table.to_html();
        }
        html += "</section>\n";
        let _ = writeln!(
            html,
            "<section><h2>What was run</h2>\n<p>{}</p>\n{}",
            escape(&self.text),
            facts_table(&self.machine)
        );
        html += "</section>\n";
        html += &page_footer(self.notes.iter().map(String::as_str), "");
        let _ = writeln!(
            html,
            "<script type=\"module\">\n{}</script>",
            echosplat_page::viewer_script()
        );
        page(&self.title, &html)
    }
}
