//! A long dive as a section of a report, and as text.

use super::found::{Asked, Found, Tenth};
use echosplat_report::table;
use echosplat_report::{Plot, Section, Table};

const TENTH_COLUMNS: [&str; 9] = [
    "tenth",
    "until s",
    "at structures",
    "pings",
    "CPU ms/ping",
    "resident MB",
    "map MB",
    "less the map MB",
    "Gaussians",
];
const ASKED_COLUMNS: [&str; 4] = ["what", "must", "reached", "verdict"];
const ERROR_COLUMNS: [&str; 2] = ["first structure at", "CD"];

/// Tables and curves.
#[must_use]
pub(crate) fn section(found: &Found, about: String) -> Section {
    let line = |name: &str, of: fn(&Tenth) -> f64| {
        let points = found.tenths.iter().map(|tenth| (tenth.end_s, of(tenth)));
        (name.to_owned(), points.collect())
    };
    let plot = |y_label: &str, lines| Plot {
        x_label: "dive time, s".to_owned(),
        y_label: y_label.to_owned(),
        lines,
        ..Plot::default()
    };
    Section {
        title: "A long dive".to_owned(),
        text: about,
        plots: vec![
            plot(
                "memory, MB",
                vec![
                    line("resident", |tenth| megabytes(tenth.resident_bytes)),
                    line("less the map", |tenth| megabytes(tenth.rest_bytes)),
                    line("map", |tenth| megabytes(tenth.map_bytes)),
                ],
            ),
            plot(
                "processor time per ping, ms",
                vec![line("processor time", |tenth| {
                    1e3 * tenth.compute_per_ping_s
                })],
            ),
        ],
        tables: vec![
            asked_table(&found.asked()),
            error_table(found),
            tenth_table(found),
        ],
        ..Section::default()
    }
}

fn asked_table(asked: &[Asked]) -> Table {
    let met = asked.iter().filter(|asked| asked.is_met == Some(true));
    Table {
        title: format!("{} of {} met", met.count(), asked.len()),
        columns: ASKED_COLUMNS.map(str::to_owned).into(),
        rows: asked.iter().map(asked_cells).collect(),
        note: "Tenths count as spent at structures where 90 % of them were.".to_owned(),
    }
}

fn error_table(found: &Found) -> Table {
    Table {
        title: "The first structure".to_owned(),
        columns: ERROR_COLUMNS.map(str::to_owned).into(),
        rows: error_rows(found),
        note: "What of the map is nearer to it than to another, against what its first visit sees \
               of it."
            .to_owned(),
    }
}

fn tenth_table(found: &Found) -> Table {
    Table {
        title: "Every tenth of the dive".to_owned(),
        columns: TENTH_COLUMNS.map(str::to_owned).into(),
        rows: tenth_rows(found),
        note: format!(
            "Processor time is that of the mapper's threads in this tenth. Resident is what the \
             process holds at its end; less the map is without the maps held to be published and \
             without the {:.0} MB that scenes and surveys took before the first ping.",
            megabytes(found.before_bytes)
        ),
    }
}

fn megabytes(bytes: u64) -> f64 {
    bytes as f64 * 1e-6
}

fn asked_cells(asked: &Asked) -> Vec<String> {
    vec![
        asked.quantity.to_owned(),
        asked.must.clone(),
        asked.reached.clone(),
        asked.verdict().to_owned(),
    ]
}

fn error_rows(found: &Found) -> Vec<Vec<String>> {
    let row = |(moment, cd_m): (&str, f64)| vec![moment.to_owned(), table::metres_unit(cd_m)];
    found.errors.named().map(row).into()
}

fn tenth_rows(found: &Found) -> Vec<Vec<String>> {
    let row = |(index, tenth): (usize, &Tenth)| {
        vec![
            (index + 1).to_string(),
            format!("{:.0}", tenth.end_s),
            table::percent(tenth.structure_share),
            tenth.pings.to_string(),
            format!("{:.3}", 1e3 * tenth.compute_per_ping_s),
            format!("{:.1}", megabytes(tenth.resident_bytes)),
            format!("{:.2}", megabytes(tenth.map_bytes)),
            format!("{:.1}", megabytes(tenth.rest_bytes)),
            tenth.gaussians.to_string(),
        ]
    };
    found.tenths.iter().enumerate().map(row).collect()
}

/// The same as lines of text, in columns.
#[must_use]
pub(crate) fn text(found: &Found) -> String {
    let asked: Vec<Vec<String>> = found.asked().iter().map(asked_cells).collect();
    [
        table::aligned(&TENTH_COLUMNS, &tenth_rows(found), 1),
        table::aligned(&ERROR_COLUMNS, &error_rows(found), 1),
        table::aligned(&ASKED_COLUMNS, &asked, 1),
    ]
    .join("\n")
}
