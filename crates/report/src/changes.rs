//! What is different between two maps, as a page, and the colours of what became of each Gaussian.

use crate::sheet::{Drawn, Sheet, Shown, Side};
use crate::{MapView, Table, escape, facts_table, page};

/// One of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChangeColor {
    /// In legends.
    pub name: &'static str,
    /// Red, green and blue, as the viewer's ramp has it (`colors.js`).
    pub rgb: [u8; 3],
}

/// By the number that stands for it.
pub const CHANGES: [ChangeColor; 6] = [
    ChangeColor {
        name: "as before",
        rgb: [0x96, 0xa0, 0xa8],
    },
    ChangeColor {
        name: "came",
        rgb: [0x1f, 0x9e, 0x57],
    },
    ChangeColor {
        name: "went",
        rgb: [0xd6, 0x2f, 0x45],
    },
    ChangeColor {
        name: "moved from here",
        rgb: [0xf0, 0xa0, 0x40],
    },
    ChangeColor {
        name: "moved to here",
        rgb: [0x2f, 0x6f, 0xd0],
    },
    ChangeColor {
        name: "of before, not heard again nearby",
        rgb: [0xc9, 0xb2, 0x7c],
    },
];

/// A page of what is different between two maps.
#[derive(Debug, Clone, Default)]
pub struct ChangeReport {
    /// Its heading.
    pub title: String,
    /// Rows of the title block.
    pub about: Vec<(String, String)>,
    /// How the maps lie on each other, in a sentence or two.
    pub verdict: String,
    /// A row each; none if nothing changed.
    pub table: Table,
}

impl ChangeReport {
    /// As one HTML document that needs nothing beside it; `drawn` is both maps in one, with their changes.
    #[must_use]
    pub fn to_html(&self, drawn: &Drawn) -> String {
        let view = MapView::of_changes(drawn.gaussians, drawn.changes);
        let figure = |side, most_mm| drawn.figure(side, Shown::Changes, most_mm);
        let sheets = [
            Sheet::new("Plan").figure(figure(Side::Above, 190.0)),
            Sheet::new("Elevations")
                .figure(figure(Side::AlongY, 92.0))
                .figure(figure(Side::AgainstX, 92.0)),
        ];
        let mut html = format!(
            "<header><h1>{}</h1></header>\n{}<p class=\"verdict\">{}</p>\n{}",
            escape(&self.title),
            facts_table(&self.about),
            escape(&self.verdict),
            legend()
        );
        html += "<div class=\"screen\">\n";
        html += &view.to_html();
        html += "</div>\n";
        if !self.table.rows.is_empty() {
            html += &self.table.to_html();
        }
        for sheet in sheets {
            html += &sheet.to_html();
        }
        html += &format!(
            "<script type=\"module\">\n{}</script>",
            echosplat_page::viewer_script()
        );
        page(&self.title, &html)
    }
}

/// Dots with their names.
fn legend() -> String {
    let items = CHANGES.map(|change| {
        let [r, g, b] = change.rgb;
        format!(
            "<li><i style=\"color:#{r:02x}{g:02x}{b:02x}\"></i>{}</li>",
            change.name
        )
    });
    format!("<ul class=\"legend\">{}</ul>\n", items.concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_viewer_has_the_same_colors() {
        let stops = CHANGES.map(|change| {
            let [r, g, b] = change.rgb;
            format!("\"#{r:02x}{g:02x}{b:02x}\"")
        });
        let line = format!("change: [{}]", stops.join(", "));
        assert!(echosplat_page::viewer_script().contains(&line), "{line}");
    }
}
