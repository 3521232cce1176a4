//! The table of accuracy, which the page and the README share, and where it stands.

use super::data::{Case, Results, Run};
use super::parts::{line, median, metres, percent};

/// Before and after the table.
pub const ACCURACY_MARK: &str = "<!-- accuracy table -->";

const SCENES: [&str; 4] = ["fence", "wall", "pier", "pipeline"];
/// As the README says them, which has no room for more.
const NOISES: [(&str, &str); 2] = [
    (
        "field",
        "echoes as real units were measured to give them (`field`)",
    ),
    (
        "harsh",
        "ghost echoes, dropouts, poses off by 10 cm and 1° (`harsh`)",
    ),
];

/// Medians over the seeds of surveys of the four scenes, with a line break at its end; empty if none was run.
pub(super) fn accuracy_table(results: &Results) -> String {
    let mut rows = String::new();
    for (noise, words) in NOISES {
        let cases: Vec<Option<&Case>> = SCENES.map(|scene| found(results, scene, noise)).into();
        if cases.iter().all(Option::is_none) {
            continue;
        }
        let row = |what: &str, of: fn(&Run) -> f64, show: fn(f64) -> String| {
            let cell = |case: &Option<&Case>| {
                case.map_or("–".to_owned(), |case| show(median(&case.runs, of)))
            };
            let cells = cases.iter().map(cell);
            let cells: Vec<String> = [what.to_owned()].into_iter().chain(cells).collect();
            line(&cells)
        };
        rows += &row(&format!("CD, {words}"), |run| run.cd_m, metres);
        rows += &row("false", |run| run.false_share, percent);
    }
    match rows.is_empty() {
        true => rows,
        false => format!("||{}|\n|---|---|---|---|---|\n{rows}", SCENES.join("|")),
    }
}

fn found<'a>(results: &'a Results, scene: &str, noise: &str) -> Option<&'a Case> {
    results.accuracy.iter().find(|case| {
        case.scene == scene && case.dive == "survey" && case.noise == noise && !case.runs.is_empty()
    })
}

/// `text` with the table between its two marks; `None` where there are not two of them.
#[must_use]
pub fn with_accuracy(text: &str, results: &Results) -> Option<String> {
    let (before, rest) = text.split_once(ACCURACY_MARK)?;
    let (_, after) = rest.split_once(ACCURACY_MARK)?;
    let table = accuracy_table(results);
    Some(format!(
        "{before}{ACCURACY_MARK}\n\n{table}\n{ACCURACY_MARK}{after}"
    ))
}
