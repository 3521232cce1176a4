//! The table of features as sections of a report, and as text.

use serde::Serialize;

use super::cases::{Case, Feature, Variant};
use super::check::Check;
use crate::runs::{LeftOut, Outcome, Outcomes};
use echosplat_metrics::curve::Spread;
use echosplat_report::table::{aligned, metres, percent, quantity};
use echosplat_report::{FAILED, Plot, Section, Table};

const COLUMNS: [&str; 10] = [
    "variant",
    "runs",
    "CD m",
    "false",
    "held-out gain",
    "pairs",
    "voxel observations",
    "compute s",
    "finish s",
    "left out by itself",
];

/// What a variant came to on a dive, over the seeds.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Row {
    /// Name of the dive.
    pub(crate) case: String,
    /// Name of the variant.
    pub(crate) variant: String,
    /// Seeds that were mapped.
    pub(crate) run_count: usize,
    /// Seeds that failed.
    pub(crate) failed_count: usize,
    /// Chamfer distance, metres.
    pub(crate) cd_m: Spread,
    /// Share of what is asserted that is false, 0 to 1.
    pub(crate) confident_false_share: Spread,
    /// Log likelihood per bin of pings that the map has not seen, over that of a constant.
    #[serde(rename = "held_back_gain")]
    pub(crate) held_out_gain: Option<Spread>,
    /// Gaussian–bin pairs.
    pub(crate) pairs: Spread,
    /// Voxel observations.
    #[serde(rename = "voxel_looks")]
    pub(crate) voxel_observations: Spread,
    /// Processor seconds.
    pub(crate) compute_s: Spread,
    /// Processor seconds of the finish.
    pub(crate) finish_s: Spread,
    /// What the mapper left out by itself in the first seed.
    pub(crate) left_out: Vec<LeftOut>,
}

/// A row for each variant.
#[must_use]
pub(crate) fn rows(
    case: &Case,
    features: &[Feature],
    variants: &[Variant],
    seeds: &[u64],
    results: &Outcomes,
) -> Vec<Row> {
    let row = |variant: &Variant| {
        let result = |seed: &u64| results.of(&case.spec(features, variant, *seed));
        let found: Vec<_> = seeds.iter().filter_map(result).collect();
        let good: Vec<&Outcome> = found.iter().filter_map(|run| run.as_ref().ok()).collect();
        let spread = |of: fn(&Outcome) -> f64| Spread::of(good.iter().map(|o| of(o)));
        let gains = good.iter().filter_map(|o| Some(o.held_out?.gain_per_bin));
        let gains: Vec<f64> = gains.collect();
        Row {
            case: case.name(),
            variant: variant.name.clone(),
            run_count: good.len(),
            failed_count: found.len() - good.len(),
            cd_m: spread(|o| o.metrics.cd_m),
            confident_false_share: spread(|o| o.metrics.confident_false_share),
            held_out_gain: (!gains.is_empty()).then(|| Spread::of(gains)),
            pairs: spread(|o| o.total.pairs as f64),
            voxel_observations: spread(|o| o.total.voxel_observations as f64),
            compute_s: spread(|o| o.total.compute_s),
            finish_s: spread(|o| o.total.compute_s - o.streamed.compute_s),
            left_out: good.first().map_or(Vec::new(), |o| o.left_out.clone()),
        }
    };
    variants.iter().map(row).collect()
}

fn cells(row: &Row) -> [String; 10] {
    let left_out: Vec<String> = row
        .left_out
        .iter()
        .map(|left| format!("{}: {}", left.feature, left.why))
        .collect();
    let runs = match row.failed_count {
        0 => row.run_count.to_string(),
        _ => FAILED.to_owned(),
    };
    let shown = |text: String| {
        if row.run_count > 0 {
            text
        } else {
            "–".to_owned()
        }
    };
    [
        row.variant.clone(),
        runs,
        shown(metres(row.cd_m.median)),
        shown(percent(row.confident_false_share.median)),
        row.held_out_gain
            .map_or("–".to_owned(), |gain| format!("{:+.3}", gain.median)),
        shown(quantity(row.pairs.median)),
        shown(quantity(row.voxel_observations.median)),
        shown(format!("{:.2}", row.compute_s.median)),
        shown(format!("{:.2}", row.finish_s.median)),
        match left_out.is_empty() {
            true => "–".to_owned(),
            false => left_out.join("; "),
        },
    ]
}

/// One dive's table, and its variants as places of error over work.
#[must_use]
pub(crate) fn case_section(rows: &[Row]) -> Section {
    let place = |row: &Row| {
        let work = row.pairs.median + row.voxel_observations.median;
        (row.variant.clone(), vec![(work, row.cd_m.median)])
    };
    let title = rows.first().map_or(String::new(), |row| row.case.clone());
    Section {
        title: title.clone(),
        plots: vec![Plot {
            x_label: "work, pairs + voxel observations".to_owned(),
            y_label: "CD, m".to_owned(),
            lines: rows.iter().map(place).collect(),
            ..Plot::default()
        }],
        tables: vec![Table {
            title: "On, off and auto".to_owned(),
            columns: COLUMNS.map(str::to_owned).into(),
            rows: rows.iter().map(|row| cells(row).into()).collect(),
            note:
                "Medians over the seeds. A feature alone on or off leaves the others to the mapper; \
                   its auto is everything auto. Held-back gain is the log likelihood per bin of \
                   pings that the map has not seen, over that of a constant."
                    .to_owned(),
        }],
        ..Section::default()
    }
}

/// What holds of the mapper's own choice.
#[must_use]
pub(crate) fn check_section(check: &Check) -> Section {
    let beaten: Vec<String> = check
        .beaten_by
        .iter()
        .map(|(case, fixed)| format!("{case}: {fixed}"))
        .collect();
    let said = |names: &[String]| match names.is_empty() {
        true => "none".to_owned(),
        false => names.join("; "),
    };
    let row = |what: &str, names: &[String]| vec![what.to_owned(), said(names)];
    Section {
        title: "What the mapper chooses".to_owned(),
        tables: vec![Table {
            title: "Everything auto against everything fixed".to_owned(),
            columns: ["what", "where"].map(str::to_owned).into(),
            rows: vec![
                row(
                    "a fixed setting has over 5 % less error and over 15 % less work",
                    &beaten,
                ),
                row(
                    "at most two thirds of the work of everything on, at most 2 % more error",
                    &check.saves_on,
                ),
                row(
                    "not all variants were run: nothing is claimed",
                    &check.incomplete,
                ),
            ],
            note: "The first must be nowhere, the second on at least three scenes.".to_owned(),
        }],
        ..Section::default()
    }
}

/// The rows as lines of text.
#[must_use]
pub(crate) fn text(rows: &[Row]) -> String {
    let mut text = String::new();
    for own in rows.chunk_by(|a, b| a.case == b.case) {
        let lines: Vec<Vec<String>> = own.iter().map(|row| cells(row).into()).collect();
        text += &format!("{}\n{}", own[0].case, aligned(&COLUMNS, &lines, 1));
    }
    text
}
