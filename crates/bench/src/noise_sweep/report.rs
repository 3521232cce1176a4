//! Rows, charts and text.

use echosplat_simulator::NoiseLevel;
use serde::Serialize;

use super::levels::Level;
use crate::runs::{Outcome, Outcomes};
use echosplat_metrics::curve::Spread;
use echosplat_report::table::{self, metres, percent};
use echosplat_report::{FAILED, Plot, Section, Table};

/// Most CD, metres, down to so many dB.
pub(crate) const CD_LIMIT: (f64, f64) = (0.05, 14.0);
/// Most of what is asserted that may be false, 0 to 1, at any noise.
pub(crate) const FALSE_LIMIT: f64 = 0.005;
/// A share of 0 is drawn here: it has no logarithm.
const LEAST_SHARE: f64 = 1e-4;

const COLUMNS: [&str; 10] = [
    "pings",
    "echo over noise",
    "CD m",
    "HD m",
    "false",
    "worst false",
    "recall 10 cm",
    "ambiguous near truth",
    "Gaussians",
    "limits",
];

/// What one level came to, over the seeds.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Row {
    /// Which.
    pub(crate) level: Level,
    /// Seeds that were run to their end.
    pub(crate) run_count: usize,
    /// Seeds that failed.
    pub(crate) failed_count: usize,
    /// Chamfer distance, metres.
    pub(crate) cd_m: Spread,
    /// Hausdorff distance, metres.
    pub(crate) hd_m: Spread,
    /// Share of what is asserted that is false, 0 to 1.
    pub(crate) confident_false_share: Spread,
    /// Share of what was seen that is within 10 cm of the map.
    pub(crate) recall_10cm: Spread,
    /// Share of what was seen that is within 0.25 m of an ambiguous Gaussian.
    pub(crate) ambiguous_cover_share: Spread,
    /// Confident Gaussians.
    pub(crate) confident_count: Spread,
    /// Ambiguous Gaussians.
    pub(crate) ambiguous_count: Spread,
    /// By the medians.
    pub(crate) verdict: Verdict,
}

/// Whether a level keeps to the limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Verdict {
    /// It does.
    Met,
    /// It does not.
    Missed,
    /// Nothing is asked of short dives.
    Shown,
    /// No run of it was made to its end.
    Incomplete,
}

impl Verdict {
    fn as_str(self) -> &'static str {
        match self {
            Self::Met => "met",
            Self::Missed => FAILED,
            Self::Shown => "–",
            Self::Incomplete => "incomplete",
        }
    }
}

/// One for each level.
#[must_use]
pub(crate) fn rows(levels: &[Level], seeds: &[u64], results: &Outcomes) -> Vec<Row> {
    let row = |level: &Level| row(*level, seeds, results);
    levels.iter().map(row).collect()
}

fn row(level: Level, seeds: &[u64], results: &Outcomes) -> Row {
    let specs = seeds.iter().map(|seed| level.spec(*seed));
    let runs: Vec<_> = specs.filter_map(|spec| results.of(&spec)).collect();
    let good: Vec<&Outcome> = runs.iter().filter_map(|run| run.as_ref().ok()).collect();
    let spread = |of: fn(&Outcome) -> f64| Spread::of(good.iter().map(|outcome| of(outcome)));
    let cd_m = spread(|o| o.metrics.cd_m);
    let confident_false_share = spread(|o| o.metrics.confident_false_share);
    let (most_cd_m, least_db) = CD_LIMIT;
    let is_near = level.over_noise_db < least_db || cd_m.median <= most_cd_m;
    let is_true = confident_false_share.median <= FALSE_LIMIT;
    Row {
        level,
        run_count: good.len(),
        failed_count: runs.len() - good.len(),
        cd_m,
        hd_m: spread(|o| o.metrics.hd_m),
        confident_false_share,
        recall_10cm: spread(|o| o.metrics.recall_10cm),
        ambiguous_cover_share: spread(|o| o.metrics.ambiguous_cover_share),
        confident_count: spread(|o| o.metrics.confident_count as f64),
        ambiguous_count: spread(|o| o.metrics.ambiguous_count as f64),
        verdict: match (good.is_empty(), level.duration_s) {
            (true, _) => Verdict::Incomplete,
            (false, Some(_)) => Verdict::Shown,
            (false, None) if is_near && is_true => Verdict::Met,
            (false, None) => Verdict::Missed,
        },
    }
}

/// A line for each level that keeps to a limit no longer.
#[must_use]
pub(crate) fn failures(rows: &[Row]) -> Vec<String> {
    let missed = rows.iter().filter(|row| row.verdict == Verdict::Missed);
    let said = |row: &Row| {
        format!(
            "{} pings, {} dB: CD {} m, {} false",
            row.level.pings,
            row.level.over_noise_db,
            metres(row.cd_m.median),
            percent(row.confident_false_share.median)
        )
    };
    missed.map(said).collect()
}

/// Charts and table.
#[must_use]
pub(crate) fn section(rows: &[Row]) -> Section {
    let (most_cd_m, least_db) = CD_LIMIT;
    Section {
        title: "Fence, survey, poses of nominal noise".to_owned(),
        text: format!(
            "One survey, 240 s, its noise chosen so that the strongest echo of a ping, before speckle, \
             stands as many decibels above the mean noise as is drawn along: the median over the \
             pings. Field pings are as a real unit hears them: one look, echoes that fall with range, \
             automatic gain. Nominal pings have four looks and no loss over range. Limits: CD at most \
             {most_cd_m} m down to {least_db} dB, at most {} of what is asserted false at any noise.",
            percent(FALSE_LIMIT)
        ),
        plots: vec![
            plot(
                rows,
                "CD, m",
                |row| row.cd_m.median,
                (most_cd_m, Some(least_db)),
            ),
            plot(
                rows,
                "confident but false, share",
                |row| row.confident_false_share.median.max(LEAST_SHARE),
                (FALSE_LIMIT, None),
            ),
            plot(
                rows,
                "seen truth further than 10 cm from the map, share",
                |row| (1.0 - row.recall_10cm.median).max(LEAST_SHARE),
                (f64::INFINITY, None),
            ),
        ],
        tables: vec![table(rows)],
        ..Section::default()
    }
}

/// A line for each kind of pings, and one for the limit, which holds from so many decibels on. An
/// empty map asserts nothing and is left out.
fn plot(rows: &[Row], y: &str, value: fn(&Row) -> f64, limit: (f64, Option<f64>)) -> Plot {
    let drawn = |row: &&Row| row.run_count > 0 && row.confident_count.median > 0.0;
    let line = |pings: NoiseLevel| {
        let own = rows
            .iter()
            .filter(drawn)
            .filter(|row| row.level.pings == pings);
        let mut points: Vec<(f64, f64)> = own
            .map(|row| (row.level.over_noise_db, value(row)))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        (format!("{pings} pings"), points)
    };
    let along = rows.iter().map(|row| row.level.over_noise_db);
    let (low, high) = along.fold((f64::INFINITY, 0.0_f64), |(low, high), db| {
        (low.min(db), high.max(db))
    });
    let (at, from_db) = limit;
    let ends = [from_db.unwrap_or(low), high].map(|db| (db, at));
    Plot {
        x_label: "strongest echo over mean noise, dB".to_owned(),
        y_label: y.to_owned(),
        x_is_linear: true,
        y_is_linear: false,
        lines: vec![
            line(NoiseLevel::Field),
            line(NoiseLevel::Nominal),
            ("limit".to_owned(), ends.into()),
        ],
        marks: Vec::new(),
    }
}

fn table(rows: &[Row]) -> Table {
    let asked = rows.iter().filter(|row| row.verdict != Verdict::Shown);
    let met = rows.iter().filter(|row| row.verdict == Verdict::Met);
    Table {
        title: format!("{} of {} levels within the limits", met.count(), asked.count()),
        columns: COLUMNS.map(str::to_owned).into(),
        rows: rows.iter().map(|row| cells(row).into()).collect(),
        note: "Medians over the seeds. Recall is the share of what was seen that is within 10 cm of a \
               confident Gaussian; ambiguous near truth the share within 0.25 m of an ambiguous one. \
               Gaussians: confident + ambiguous. CD is judged down to 14 dB; that of an empty map is \
               infinite and not drawn."
            .to_owned(),
    }
}

fn cells(row: &Row) -> [String; 10] {
    let (pings, over_noise) = (
        row.level.pings.to_string(),
        format!("{} dB", row.level.over_noise_db),
    );
    let of_runs = |text: String| match (row.run_count, row.failed_count) {
        (0, 0) => "–".to_owned(),
        (0, _) => FAILED.to_owned(),
        _ => text,
    };
    [
        pings,
        over_noise,
        of_runs(metres(row.cd_m.median)),
        of_runs(metres(row.hd_m.median)),
        of_runs(percent(row.confident_false_share.median)),
        of_runs(percent(row.confident_false_share.max)),
        of_runs(percent(row.recall_10cm.median)),
        of_runs(percent(row.ambiguous_cover_share.median)),
        of_runs(format!(
            "{:.0} + {:.0}",
            row.confident_count.median, row.ambiguous_count.median
        )),
        row.verdict.as_str().to_owned(),
    ]
}

/// The rows as lines of text, in columns.
#[must_use]
pub(crate) fn text(rows: &[Row]) -> String {
    let rows: Vec<Vec<String>> = rows.iter().map(|row| cells(row).into()).collect();
    table::aligned(&COLUMNS, &rows, 1)
}

#[cfg(test)]
mod tests {
    use super::super::levels;
    use super::*;
    use crate::runs::sample_outcome;

    /// Every level with the same CD and so many false, seed 1.
    fn results(levels: &[Level], cd_m: f64, false_share: f64) -> Outcomes {
        let mut results = Outcomes::default();
        for level in levels {
            let mut outcome = sample_outcome(cd_m, 100);
            outcome.metrics.confident_false_share = false_share;
            results.0.insert(level.spec(1).name(), Ok(outcome));
        }
        results
    }

    fn count(rows: &[Row], verdict: Verdict) -> usize {
        rows.iter().filter(|row| row.verdict == verdict).count()
    }

    #[test]
    fn far_maps_fail_down_to_14_db_and_false_ones_at_any_noise() {
        let levels = levels(false);
        let judged = |cd_m, share| rows(&levels, &[1], &results(&levels, cd_m, share));
        assert_eq!(count(&judged(0.05, 0.005), Verdict::Met), 18);
        // 40 to 14 dB are six of nine.
        assert_eq!(count(&judged(0.051, 0.0), Verdict::Missed), 12);
        let rows = judged(0.01, 0.006);
        assert_eq!(count(&rows, Verdict::Missed), 18);
        assert!(failures(&rows)[0].contains("field pings, 40 dB"));
        assert!(failures(&judged(0.05, 0.005)).is_empty());
    }

    #[test]
    fn short_dives_are_shown_and_what_was_not_run_is_told() {
        let quick = levels(true);
        let shown = rows(&quick, &[1], &results(&quick, 9.0, 0.5));
        assert_eq!(count(&shown, Verdict::Shown), quick.len());
        let levels = levels(false);
        let mut some = results(&levels[..1], 0.01, 0.0);
        some.0
            .insert(levels[1].spec(1).name(), Err("no room".into()));
        let rows = rows(&levels, &[1], &some);
        assert_eq!(count(&rows, Verdict::Incomplete), 17);
        let table = table(&rows);
        assert_eq!(table.rows[1][2], FAILED);
        assert_eq!(table.rows[2][2], "–");
        assert!(table.title.starts_with("1 of 18"));
    }

    #[test]
    fn charts_show_each_kind_of_pings_and_the_limit() {
        let levels = levels(false);
        let section = section(&rows(&levels, &[1], &results(&levels, 0.02, 0.0)));
        let cd = &section.plots[0];
        assert_eq!(cd.lines.len(), 3);
        assert!(cd.lines[0].1.len() == 9 && cd.lines[0].1[0].0 < 7.0);
        assert_eq!(cd.lines[2].1, [(14.0, 0.05), (40.0, 0.05)]);
        // A share of nothing has no logarithm and is drawn all the same.
        assert!(
            section.plots[1].lines[0]
                .1
                .iter()
                .all(|(_, share)| *share > 0.0)
        );
    }
}
