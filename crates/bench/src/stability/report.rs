//! The table of stiff and extreme cases as a section of a report, and as text.

use super::row::Row;
use echosplat_report::{FAILED, Plot, Section, Table};

const COLUMNS: [&str; 8] = [
    "input",
    "f64 truth",
    "program",
    "error",
    "limit",
    "verdict",
    "naive",
    "its error",
];

/// One table a case, with the words why at its foot; `plots` above them.
#[must_use]
pub(crate) fn section(rows: &[Row], plots: Vec<Plot>) -> Section {
    Section {
        title: "Stiff and extreme cases".to_owned(),
        text:
            "Rows of kernels hold the program to the plain twin in f64, or to what must not matter. Rows \
             of the whole mapper hold a dive that was moved, turned, scaled or spoilt against the clean \
             one. A row passes if the program's error is at most the limit. Where there is a naive way, \
             it stands beside the program's."
                .to_owned(),
        plots,
        tables: by_case(rows).into_iter().map(table).collect(),
        ..Section::default()
    }
}

/// Rows of one case and quantity together, in the order in which they come.
fn by_case(rows: &[Row]) -> Vec<&[Row]> {
    rows.chunk_by(|a, b| a.case == b.case && a.quantity == b.quantity)
        .collect()
}

fn table(rows: &[Row]) -> Table {
    let first = rows.first();
    let case = first.map_or("", |row| row.case);
    let quantity = first.map_or("", |row| row.quantity);
    Table {
        title: format!("{case}: {quantity}"),
        columns: COLUMNS.map(str::to_owned).into(),
        rows: rows.iter().map(|row| cells(row).into()).collect(),
        note: first.map_or("", |row| row.why).to_owned(),
    }
}

fn cells(row: &Row) -> [String; 8] {
    let naive = |figure: Option<super::Figure>| figure.map_or("–".to_owned(), |f| f.to_string());
    [
        row.input.clone(),
        row.truth.to_string(),
        row.program.to_string(),
        row.error.to_string(),
        super::Figure(row.limit).to_string(),
        verdict(row).to_owned(),
        naive(row.naive),
        naive(row.naive_error),
    ]
}

fn verdict(row: &Row) -> &'static str {
    match row.passed {
        true => "passed",
        false => FAILED,
    }
}

/// The rows as lines of text.
#[must_use]
pub(crate) fn text(rows: &[Row]) -> String {
    let mut text = String::new();
    for rows in by_case(rows) {
        let table = table(rows);
        text += &format!("{}\n", table.title);
        for row in rows {
            let naive = row
                .naive_error
                .map_or(String::new(), |e| format!(", naive {e}"));
            text += &format!(
                "  {} {}: error {} of {}{naive}\n",
                match row.passed {
                    true => "ok    ",
                    false => "FAILED",
                },
                row.input,
                row.error,
                super::Figure(row.limit),
            );
        }
    }
    text
}
