//! `echosplat bench stability`.

use crate::stability::{self, Row};
use anyhow::ensure;
use echosplat_report::{Plot, Report};
use serde_json::{Map, json};

use super::Findings;
use crate::arguments::BenchOptions;
use echosplat_service::logging;
use echosplat_service::signals::Stop;

/// # Errors
/// If it is stopped, or the rows cannot be put into JSON.
pub(super) fn run(options: &BenchOptions) -> anyhow::Result<Findings> {
    let cases = stability::cases();
    let bar = logging::progress_bar(cases.len() as u64, "{bar:40} {pos:>2} of {len} · {msg}");
    let stop = Stop::on_signals()?;
    let mut rows = Vec::new();
    for case in &cases {
        ensure!(!stop.is_set(), "stopped before the case {}", case.name);
        bar.set_message(case.name);
        rows.extend(case.rows(options.seed, options.quick));
        bar.inc(1);
    }
    bar.finish_and_clear();
    ensure!(!stop.is_set(), "stopped before the curves");
    // They take as long as the rows.
    let plots = match options.quick {
        true => Vec::new(),
        false => stability::plots(options.seed),
    };
    results(&rows, plots)
}

fn results(rows: &[Row], plots: Vec<Plot>) -> anyhow::Result<Findings> {
    let failed: Vec<&Row> = rows.iter().filter(|row| !row.passed).collect();
    let said = |row: &&Row| {
        let limit = row.limit;
        format!(
            "{}, {}: error {} above {limit:e}",
            row.case, row.input, row.error
        )
    };
    let passed = rows.iter().filter(|row| row.passed).count();
    let summary = format!("{passed} of {} rows pass", rows.len());
    let mut fields = Map::new();
    fields.insert("row_count".to_owned(), json!(rows.len()));
    fields.insert("failed_count".to_owned(), json!(failed.len()));
    fields.insert("rows".to_owned(), serde_json::to_value(rows)?);
    Ok(Findings {
        name: "stability",
        fields,
        report: Report {
            title: "Stiff and extreme cases".to_owned(),
            highlights: vec![
                ("rows".to_owned(), rows.len().to_string()),
                ("failed".to_owned(), failed.len().to_string()),
            ],
            sections: vec![stability::section(rows, plots)],
            ..Report::default()
        },
        text: format!("{}{summary}", stability::text(rows)),
        failures: failed.iter().map(said).collect(),
    })
}
