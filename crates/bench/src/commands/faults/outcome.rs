//! What a case came to, and the table of all.

use std::collections::BTreeMap;

use echosplat_report::{FAILED, Section, Table};
use serde::Serialize;

const COLUMNS: [&str; 6] = [
    "case",
    "verdict",
    "told",
    "after",
    "maps again after",
    "figures",
];

/// What one case came to.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Outcome {
    pub(super) family: &'static str,
    pub(super) case: String,
    /// Whether all that must hold did.
    pub(super) held: bool,
    /// What did not.
    pub(super) broken: Vec<String>,
    /// The code of the first notice.
    pub(super) told: Option<String>,
    /// From the beginning of the fault to that notice, seconds.
    pub(super) told_after_s: Option<f64>,
    /// From its end to the next ping in the map, seconds.
    pub(super) back_after_s: Option<f64>,
    /// Whatever else was counted, by name with its unit.
    pub(super) figures: BTreeMap<&'static str, f64>,
}

impl Outcome {
    pub(super) fn new(family: &'static str, case: impl Into<String>) -> Self {
        Self {
            family,
            case: case.into(),
            held: true,
            ..Self::default()
        }
    }

    /// Notes that `what` had to hold.
    pub(super) fn expect(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.held = false;
            self.broken.push(what());
        }
    }

    pub(super) fn figure(&mut self, name: &'static str, value: f64) {
        self.figures.insert(name, value);
    }

    /// For the terminal.
    pub(super) fn line(&self) -> String {
        let verdict = if self.held { "ok    " } else { "FAILED" };
        let told = match (&self.told, self.told_after_s) {
            (Some(code), Some(after_s)) => format!(", told `{code}` after {after_s:.1} s"),
            _ => String::new(),
        };
        let back = self.back_after_s;
        let back = back.map_or(String::new(), |s| format!(", maps again after {s:.2} s"));
        let broken = match self.broken.is_empty() {
            true => String::new(),
            false => format!(": {}", self.broken.join("; ")),
        };
        let figures = self.figures();
        let comma = if figures.is_empty() { "" } else { ", " };
        let (family, case) = (self.family, &self.case);
        format!("{verdict} {family}, {case}{told}{back}{comma}{figures}{broken}")
    }

    fn figures(&self) -> String {
        let pairs = self.figures.iter();
        let pairs = pairs.map(|(name, value)| format!("{name} {}", rounded(*value)));
        pairs.collect::<Vec<_>>().join(", ")
    }

    fn cells(&self) -> Vec<String> {
        let seconds = |value: Option<f64>| value.map_or("–".to_owned(), |s| format!("{s:.2} s"));
        let verdict = if self.held { "passed" } else { FAILED };
        let mut words = self.broken.clone();
        words.push(self.figures());
        vec![
            self.case.clone(),
            verdict.to_owned(),
            self.told.clone().unwrap_or_else(|| "–".to_owned()),
            seconds(self.told_after_s),
            seconds(self.back_after_s),
            words.join("; "),
        ]
    }
}

fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

/// One table a family.
pub(super) fn section(outcomes: &[Outcome]) -> Section {
    let table = |outcomes: &[Outcome]| Table {
        title: outcomes.first().map_or("", |one| one.family).to_owned(),
        columns: COLUMNS.map(str::to_owned).into(),
        rows: outcomes.iter().map(Outcome::cells).collect(),
        note: String::new(),
    };
    let families = outcomes.chunk_by(|a, b| a.family == b.family);
    Section {
        title: "Faults".to_owned(),
        text:
            "Each case is a run of the program itself, with a simulated sonar behind a real socket \
               or pseudo-terminal and poses on a real bus."
                .to_owned(),
        tables: families.map(table).collect(),
        ..Section::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_did_not_hold_is_said() {
        let mut outcome = Outcome::new("grid", "poses off");
        outcome.expect(true, || "never said".to_owned());
        assert!(outcome.held && outcome.line().starts_with("ok"));
        outcome.expect(false, || "nothing was told".to_owned());
        outcome.figure("lost pings", 2.0);
        assert!(!outcome.held);
        assert_eq!(
            outcome.line(),
            "FAILED grid, poses off, lost pings 2: nothing was told"
        );
        assert_eq!(section(&[outcome]).tables[0].rows[0][1], FAILED);
    }
}
