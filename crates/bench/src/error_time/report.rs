//! Curves, fronts and tables as sections of a report, and as text.

use serde::Serialize;

use super::cases::{Case, Line};
use super::omission::Omission;
use super::sweeps::{Point, Sweep};
use crate::runs::{Ending, Outcome, Outcomes};
use echosplat_metrics::curve::Spread;
use echosplat_report::table::{metres, percent, quantity};
use echosplat_report::{FAILED, Mark, Plot, Section, Table};

const COLUMNS: [&str; 12] = [
    "method",
    "runs",
    "converged",
    "budget",
    "degenerate",
    "rejected",
    "left out",
    "CD m",
    "HD m",
    "false",
    "compute s",
    "pairs + observations",
];

const SWEEP_COLUMNS: [&str; 7] = [
    "setting",
    "value",
    "compute s",
    "pairs + observations",
    "CD m",
    "false",
    "front",
];

/// How the runs of one line of a case ended, and what their finished maps came to.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Endings {
    /// Of the case.
    pub(crate) case: String,
    /// Which of its lines.
    pub(crate) line: Line,
    /// How many runs ended so, in the order of [`Ending::ALL`].
    pub(crate) counts: [usize; 4],
    /// Runs that were left out.
    pub(crate) left_out: usize,
    /// Chamfer distance, metres.
    pub(crate) cd_m: Spread,
    /// Hausdorff distance, metres.
    pub(crate) hd_m: Spread,
    /// Share of what is asserted that is false, 0 to 1.
    pub(crate) confident_false_share: Spread,
    /// Processor seconds.
    pub(crate) compute_s: Spread,
    /// Pairs and voxel observations.
    pub(crate) work: Spread,
}

/// One for each line of a case; the live map's run is that of its finished one, and so is the last of a
/// dive that is cut.
#[must_use]
pub(crate) fn endings(case: &Case, seeds: &[u64], results: &Outcomes) -> Vec<Endings> {
    let is_own = |line: &&Line| !matches!(line, Line::Online | Line::Cut);
    let lines = case.lines.iter().filter(is_own);
    lines
        .map(|line| endings_of(case, *line, seeds, results))
        .collect()
}

fn endings_of(case: &Case, line: Line, seeds: &[u64], results: &Outcomes) -> Endings {
    let runs: Vec<_> = case.results_of(line, seeds, results).collect();
    let count = |ending| {
        let ended = runs
            .iter()
            .filter(|(_, result)| Ending::of(result) == ending);
        ended.count()
    };
    let asked = if line == Line::Paper { 1 } else { seeds.len() };
    let spread = |of: fn(&Outcome) -> f64| {
        let good = runs.iter().filter_map(|(_, result)| result.as_ref().ok());
        Spread::of(good.map(of))
    };
    Endings {
        case: case.name(),
        line,
        counts: Ending::ALL.map(count),
        left_out: asked.saturating_sub(runs.len()),
        cd_m: spread(|o| o.metrics.cd_m),
        hd_m: spread(|o| o.metrics.hd_m),
        confident_false_share: spread(|o| o.metrics.confident_false_share),
        compute_s: spread(|o| o.total.compute_s),
        work: spread(|o| o.total.counted() as f64),
    }
}

/// The curves of a case, and how its runs ended.
#[must_use]
pub(crate) fn case_section(case: &Case, seeds: &[u64], results: &Outcomes) -> Section {
    Section {
        title: case.name(),
        text:
            "Work is counted: Gaussian–bin pairs and voxel observations, arc samples for support. \
               Methods that take all pings at once are run anew on the first part of the dive \
               for each moment, and each point is what that run took by itself; so is a dive cut \
               there and ended, whose map is finished. What judging \
               takes is not counted."
                .to_owned(),
        curves: case.curves(seeds, results),
        tables: vec![endings_table(&endings(case, seeds, results))],
        ..Section::default()
    }
}

fn endings_table(endings: &[Endings]) -> Table {
    Table {
        title: "How the runs ended".to_owned(),
        columns: COLUMNS.map(str::to_owned).into(),
        rows: endings.iter().map(|e| cells(e).into()).collect(),
        note: "Converged: all passes made. Budget: a limit on the work or on memory came first. \
               Degenerate: something was seen and nothing is asserted, since the data leave open \
               where it is. Rejected: the run failed. Figures are medians over the seeds of the \
               last map."
            .to_owned(),
    }
}

fn cells(endings: &Endings) -> [String; 12] {
    let [converged, budget, degenerate, rejected] = endings.counts;
    let runs: usize = endings.counts.iter().sum();
    let counted = |value: Spread| match value.median.is_finite() {
        true => quantity(value.median),
        false => "–".to_owned(),
    };
    let of_runs = |text: String| {
        if runs > rejected {
            text
        } else {
            FAILED.to_owned()
        }
    };
    [
        endings.line.as_str().to_owned(),
        runs.to_string(),
        converged.to_string(),
        budget.to_string(),
        degenerate.to_string(),
        rejected.to_string(),
        endings.left_out.to_string(),
        match runs {
            0 => "–".to_owned(),
            _ => of_runs(metres(endings.cd_m.median)),
        },
        metres(endings.hd_m.median),
        percent(endings.confident_false_share.median),
        counted(endings.compute_s),
        counted(endings.work),
    ]
}

/// Error over cost, a point a setting.
#[must_use]
pub(crate) fn sweep_section(sweep: &Sweep, results: &Outcomes) -> Section {
    let points = sweep.points(results);
    let plot = |x_label: &str, cost: fn(&Point) -> f64| Plot {
        x_label: x_label.to_owned(),
        y_label: "CD, m".to_owned(),
        lines: lines(&points, cost),
        marks: points.iter().map(|point| mark(point, cost)).collect(),
        ..Plot::default()
    };
    Section {
        title: format!("Settings: {}, survey, nominal", sweep.scene),
        text: "Each setting alone moved from its default, one seed. The front is what no other \
               setting beats in both; its knee is the point furthest from the chord between its \
               ends, on logarithmic axes. Two threads share the work of one: their compute time \
               is the sum."
            .to_owned(),
        plots: vec![
            plot("compute time, CPU s", |point| point.compute_s),
            plot("work, pairs + voxel observations", |point| {
                point.work as f64
            }),
        ],
        tables: vec![sweep_table(&points)],
        ..Section::default()
    }
}

/// A line a knob through the defaults' place, then the front.
fn lines(points: &[Point], cost: fn(&Point) -> f64) -> Vec<(String, Vec<(f64, f64)>)> {
    let place = |point: &Point| (cost(point), point.cd_m);
    let mut knobs: Vec<&str> = points.iter().map(|point| point.knob.as_str()).collect();
    knobs.retain(|knob| !knob.is_empty());
    knobs.dedup();
    let line = |knob: &str| {
        let own = points
            .iter()
            .filter(|point| point.knob == knob || point.is_default());
        let mut places: Vec<(f64, f64)> = own.map(place).collect();
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        (knob.to_owned(), places)
    };
    knobs.into_iter().map(line).collect()
}

fn mark(point: &Point, cost: fn(&Point) -> f64) -> Mark {
    let name = point.knob.rsplit('.').next().unwrap_or_default();
    let named = match point.is_default() {
        true => "default".to_owned(),
        false => format!("{name} {}", point.value),
    };
    Mark {
        at: (cost(point), point.cd_m),
        text: match point.is_knee {
            true => format!("knee: {named}"),
            false => named,
        },
        is_ringed: point.is_knee || point.is_default(),
    }
}

fn sweep_table(points: &[Point]) -> Table {
    let row = |point: &Point| {
        let front = match (point.is_knee, point.is_on_front) {
            (true, _) => "knee",
            (false, true) => "on it",
            (false, false) => "",
        };
        vec![
            match point.is_default() {
                true => "default".to_owned(),
                false => point.knob.clone(),
            },
            point.value.clone(),
            format!("{:.2}", point.compute_s),
            quantity(point.work as f64),
            metres(point.cd_m),
            percent(point.confident_false_share),
            front.to_owned(),
        ]
    };
    Table {
        title: format!("{} settings", points.len()),
        columns: SWEEP_COLUMNS.map(str::to_owned).into(),
        rows: points.iter().map(row).collect(),
        note: String::new(),
    }
}

/// All that was left out.
#[must_use]
pub(crate) fn omissions_section(omissions: &[Omission]) -> Section {
    let row = |omission: &Omission| vec![omission.why.clone(), omission.what.clone()];
    Section {
        title: "Omissions".to_owned(),
        tables: vec![Table {
            title: format!("{} kinds of runs left out", omissions.len()),
            columns: ["why", "what"].map(str::to_owned).into(),
            rows: omissions.iter().map(row).collect(),
            note: String::new(),
        }],
        ..Section::default()
    }
}

/// The endings as lines of text.
#[must_use]
pub(crate) fn text(endings: &[Endings]) -> String {
    let mut text = String::new();
    for own in endings.chunk_by(|a, b| a.case == b.case) {
        text += &format!("{}\n", own[0].case);
        let rows: Vec<Vec<String>> = own.iter().map(|e| cells(e).into()).collect();
        text += &echosplat_report::table::aligned(&COLUMNS, &rows, 1);
    }
    text
}
