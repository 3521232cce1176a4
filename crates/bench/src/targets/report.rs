//! Rows and runs as sections of a report, and as text.

use super::limit::{Row, Verdict};
use super::sections::Section;
use crate::runs::{Outcome, Outcomes};
use echosplat_report::table::{self, metres, percent, quantity};
use echosplat_report::{FAILED, Section as Chapter, Table};

const ROW_COLUMNS: [&str; 9] = [
    "case",
    "what",
    "paper",
    "must",
    "aim",
    "median",
    "worst",
    "each seed",
    "verdict",
];

const RUN_COLUMNS: [&str; 13] = [
    "run",
    "CD m",
    "HD m",
    "false",
    "live CD m",
    "compute s",
    "finish s",
    "pairs",
    "voxel observations",
    "Gaussians",
    "normals 20°",
    "held-out gain",
    "MB",
];

/// A chapter a section, and one with all runs.
#[must_use]
pub(crate) fn sections(rows: &[Row], results: &Outcomes) -> Vec<Chapter> {
    let chapter = |section: Section| {
        let own: Vec<&Row> = of(section, rows).collect();
        (!own.is_empty()).then(|| Chapter {
            title: section.title().to_owned(),
            text: section.about().to_owned(),
            tables: vec![row_table(&own)],
            ..Chapter::default()
        })
    };
    let chapters = Section::ALL.into_iter().filter_map(chapter);
    chapters.chain([runs_chapter(results)]).collect()
}

fn of(section: Section, rows: &[Row]) -> impl Iterator<Item = &Row> {
    rows.iter()
        .filter(move |row| row.section == section.as_str())
}

fn row_table(rows: &[&Row]) -> Table {
    let passed = rows.iter().filter(|row| row.verdict == Verdict::Passed);
    let asked = rows.iter().filter(|row| row.must.is_some());
    Table {
        title: format!("{} of {} passed", passed.count(), asked.count()),
        columns: ROW_COLUMNS.map(str::to_owned).into(),
        rows: rows.iter().map(|row| row_cells(row).into()).collect(),
        note: "The median over the seeds must meet it, the worst seed within 1.5 times of it (of \
               what is missing, for shares; within twice what is above 1, for ratios to what is to \
               be as good). A run that failed counts as infinitely bad; a row \
               whose seeds were not all run claims nothing."
            .to_owned(),
    }
}

fn row_cells(row: &Row) -> [String; 9] {
    let each = row.values.iter().map(|value| row.unit.show(*value));
    let failed = (0..row.failed_count).map(|_| FAILED.to_owned());
    [
        row.case.clone(),
        row.quantity.to_owned(),
        row.show(row.paper),
        row.must_text(),
        row.show(row.aim),
        row.show_reached(row.median),
        row.show_reached(row.worst),
        each.chain(failed).collect::<Vec<_>>().join(" · "),
        row.verdict.as_str().to_owned(),
    ]
}

fn runs_chapter(results: &Outcomes) -> Chapter {
    let row = |(name, result): (&String, &Result<Outcome, String>)| match result {
        Ok(outcome) => run_cells(name, outcome).into(),
        Err(why) => vec![name.clone(), FAILED.to_owned(), why.clone()],
    };
    Chapter {
        title: "Every run".to_owned(),
        text: "Live CD is that of the map in the middle of the dive, against what the whole dive \
               sees. Compute is processor seconds of the mapper's threads, the finish among them. \
               Held-back gain is the log likelihood per bin of pings that the map has not seen, \
               over that of a constant."
            .to_owned(),
        tables: vec![Table {
            title: format!("{} runs", results.0.len()),
            columns: RUN_COLUMNS.map(str::to_owned).into(),
            rows: results.0.iter().map(row).collect(),
            note: String::new(),
        }],
        ..Chapter::default()
    }
}

fn run_cells(name: &str, outcome: &Outcome) -> [String; 13] {
    let metrics = &outcome.metrics;
    let work = outcome.total;
    let none = || "–".to_owned();
    let normals = |normals: echosplat_metrics::Normals| percent(normals.within_20deg_share);
    let gain = |held: echosplat_prediction::held_out::HeldOut| format!("{:+.3}", held.gain_per_bin);
    [
        name.to_owned(),
        metres(metrics.cd_m),
        metres(metrics.hd_m),
        percent(metrics.confident_false_share),
        metres(outcome.mid_dive_cd_m),
        format!("{:.1}", work.compute_s),
        format!("{:.1}", work.compute_s - outcome.streamed.compute_s),
        quantity(work.pairs as f64),
        quantity(work.voxel_observations as f64),
        format!("{} + {}", metrics.confident_count, metrics.ambiguous_count),
        metrics.normals.map_or_else(none, normals),
        outcome.held_out.map_or_else(none, gain),
        format!("{:.0}", outcome.peak_memory_bytes as f64 * 1e-6),
    ]
}

/// The rows as lines of text, in columns.
#[must_use]
pub(crate) fn text(rows: &[Row]) -> String {
    let mut text = String::new();
    for section in Section::ALL {
        let own = of(section, rows).map(|row| without_seeds(row_cells(row).into()));
        let own: Vec<Vec<String>> = own.collect();
        if own.is_empty() {
            continue;
        }
        let header = without_seeds(ROW_COLUMNS.map(str::to_owned).into());
        text += &format!("{}\n{}", section.title(), table::aligned(&header, &own, 2));
    }
    text
}

/// Without the column of all seeds, which is as wide as the rest.
fn without_seeds(mut cells: Vec<String>) -> Vec<String> {
    const EACH_SEED: usize = 7;
    cells.remove(EACH_SEED);
    cells
}
