//! What must be reached, and whether it was.

use serde::Serialize;

use crate::runs::{Outcome, Outcomes, Spec};
use echosplat_metrics::nullable;
use echosplat_report::table;

/// The worst seed may miss by this factor.
const WORST_FACTOR: f64 = 1.5;
/// A ratio of two errors of one dive moves with both: the worst seed's may be above 1 by this factor
/// of what the median's may.
const WORST_EXCESS: f64 = 2.0;

/// What a value must keep to. Not a number keeps to nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Limit {
    /// Errors, counts, costs.
    AtMost(f64),
    /// Ratios to what is to be as good: what may be twice as large is what is above 1.
    RatioAtMost(f64),
    /// Ratios.
    AtLeast(f64),
    /// Shares of 1: what may be 1.5 times as large is what is missing from it.
    ShareAtLeast(f64),
}

impl Limit {
    fn holds(self, value: f64) -> bool {
        match self {
            Self::AtMost(most) | Self::RatioAtMost(most) => value <= most,
            Self::AtLeast(least) | Self::ShareAtLeast(least) => value >= least,
        }
    }

    /// What the worst seed must keep to.
    fn of_worst(self) -> Self {
        match self {
            Self::AtMost(most) => Self::AtMost(WORST_FACTOR * most),
            Self::RatioAtMost(most) => Self::RatioAtMost(1.0 + WORST_EXCESS * (most - 1.0)),
            Self::AtLeast(least) => Self::AtLeast(least / WORST_FACTOR),
            Self::ShareAtLeast(least) => Self::ShareAtLeast(1.0 - WORST_FACTOR * (1.0 - least)),
        }
    }

    pub(crate) fn wants_small(self) -> bool {
        matches!(self, Self::AtMost(_) | Self::RatioAtMost(_))
    }

    pub(crate) fn value(self) -> f64 {
        match self {
            Self::AtMost(value)
            | Self::RatioAtMost(value)
            | Self::AtLeast(value)
            | Self::ShareAtLeast(value) => value,
        }
    }

    /// What a run that failed has reached, and one whose value is not a number.
    fn hopeless(self) -> f64 {
        match self.wants_small() {
            true => f64::INFINITY,
            false => f64::NEG_INFINITY,
        }
    }
}

/// How a value is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Unit {
    /// Three decimals.
    Metres,
    /// Tenths of a millimetre.
    Millimetres,
    /// Of 1, shown as per cent.
    Share,
    /// A whole number.
    Count,
    /// How many times.
    Ratio,
    /// Of memory.
    Megabytes,
    /// Of processor time.
    Seconds,
    /// A natural logarithm.
    Nats,
}

impl Unit {
    /// `value` as it is written.
    #[must_use]
    pub(crate) fn show(self, value: f64) -> String {
        if !value.is_finite() {
            return if value < 0.0 { "−∞" } else { "∞" }.to_owned();
        }
        match self {
            Self::Metres => table::metres(value),
            Self::Millimetres => format!("{:.1} mm", 1e3 * value),
            Self::Share => table::percent(value),
            Self::Count => format!("{value:.0}"),
            Self::Ratio => format!("{value:.2}"),
            Self::Megabytes => format!("{value:.0} MB"),
            Self::Seconds => format!("{value:.1} s"),
            Self::Nats => format!("{value:.3}"),
        }
    }
}

/// One figure of a case: where it comes from and what it must be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Target {
    /// What is asked for.
    pub(crate) quantity: &'static str,
    /// How it is written.
    pub(crate) unit: Unit,
    /// What the paper prints.
    pub(crate) paper: Option<f64>,
    /// `None` is only shown.
    pub(crate) must: Option<Limit>,
    /// What is aimed at.
    pub(crate) aim: Option<f64>,
    /// From the outcomes of one seed, in the order of the case's runs.
    pub(crate) value: fn(&[&Outcome]) -> f64,
}

/// Whether a row is as it must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Verdict {
    /// Median and worst are.
    Passed,
    /// One of them is not.
    Failed,
    /// Some seeds were not run: nothing is claimed.
    Incomplete,
    /// Nothing was asked.
    Shown,
}

impl Verdict {
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Failed => echosplat_report::FAILED,
            Self::Incomplete => "incomplete",
            Self::Shown => "–",
        }
    }
}

/// A target and what was reached.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Row {
    /// Name of its section.
    pub(crate) section: &'static str,
    /// Name of its case.
    pub(crate) case: String,
    /// What is asked for.
    pub(crate) quantity: &'static str,
    /// How it is written.
    pub(crate) unit: Unit,
    /// What the paper prints.
    pub(crate) paper: Option<f64>,
    /// What must be.
    pub(crate) must: Option<Limit>,
    /// What is aimed at.
    pub(crate) aim: Option<f64>,
    /// One a seed that was run to its end, in order of the seeds; `null` is infinite.
    #[serde(serialize_with = "nullable_all")]
    pub(crate) values: Vec<f64>,
    /// Seeds that failed, each counted as missing by infinitely much.
    pub(crate) failed_count: usize,
    /// Seeds not run.
    pub(crate) left_out_count: usize,
    /// Over all seeds that were run.
    #[serde(with = "nullable")]
    pub(crate) median: f64,
    /// The seed that is furthest from what must be.
    #[serde(with = "nullable")]
    pub(crate) worst: f64,
    /// Of both.
    pub(crate) verdict: Verdict,
}

/// What one seed has to say to a target.
enum Reached {
    Value(f64),
    Failed,
    LeftOut,
}

impl Row {
    /// Judges `target` by the runs of each seed.
    #[must_use]
    pub(crate) fn judge(
        section: &'static str,
        case: &str,
        target: &Target,
        seeds: &[Vec<Spec>],
        results: &Outcomes,
    ) -> Self {
        let reached = seeds.iter().map(|runs| reached(target, runs, results));
        Self::of(section, case, target, reached.collect())
    }

    fn of(section: &'static str, case: &str, target: &Target, reached: Vec<Reached>) -> Self {
        let count = |is: fn(&Reached) -> bool| reached.iter().filter(|r| is(r)).count();
        let failed_count = count(|r| matches!(r, Reached::Failed));
        let left_out_count = count(|r| matches!(r, Reached::LeftOut));
        let limit = target.must.unwrap_or(Limit::AtMost(f64::INFINITY));
        let values: Vec<f64> = reached
            .into_iter()
            .filter_map(|reached| match reached {
                Reached::Value(value) if value.is_nan() => Some(limit.hopeless()),
                Reached::Value(value) => Some(value),
                Reached::Failed | Reached::LeftOut => None,
            })
            .collect();
        let mut ranked = values.clone();
        ranked.extend((0..failed_count).map(|_| limit.hopeless()));
        ranked.sort_unstable_by(f64::total_cmp);
        if !limit.wants_small() {
            ranked.reverse();
        }
        let median = median(&ranked).unwrap_or(limit.hopeless());
        let worst = ranked.last().copied().unwrap_or(limit.hopeless());
        let verdict = match target.must {
            _ if left_out_count > 0 || ranked.is_empty() => Verdict::Incomplete,
            None => Verdict::Shown,
            Some(must) if must.holds(median) && must.of_worst().holds(worst) => Verdict::Passed,
            Some(_) => Verdict::Failed,
        };
        Self {
            section,
            case: case.to_owned(),
            quantity: target.quantity,
            unit: target.unit,
            paper: target.paper,
            must: target.must,
            aim: target.aim,
            values,
            failed_count,
            left_out_count,
            median,
            worst,
            verdict,
        }
    }

    /// `≤ 0.045`, or nothing.
    pub(crate) fn must_text(&self) -> String {
        let Some(must) = self.must else {
            return "–".to_owned();
        };
        let sign = if must.wants_small() { "≤" } else { "≥" };
        format!("{sign} {}", self.unit.show(must.value()))
    }

    pub(super) fn show(&self, value: Option<f64>) -> String {
        value.map_or("–".to_owned(), |value| self.unit.show(value))
    }

    /// What is to be said of a median or worst if there is any.
    pub(crate) fn show_reached(&self, value: f64) -> String {
        self.show((self.values.len() + self.failed_count > 0).then_some(value))
    }
}

/// All runs of a seed are needed for its value.
fn reached(target: &Target, runs: &[Spec], results: &Outcomes) -> Reached {
    let mut outcomes = Vec::new();
    for spec in runs {
        match results.of(spec) {
            Some(Ok(outcome)) => outcomes.push(outcome),
            Some(Err(_)) => return Reached::Failed,
            None => {}
        }
    }
    match outcomes.len() == runs.len() {
        true => Reached::Value((target.value)(&outcomes)),
        false => Reached::LeftOut,
    }
}

/// Of an even number, the mean of the two in the middle; one that is infinite wins.
fn median(sorted: &[f64]) -> Option<f64> {
    let upper = *sorted.get(sorted.len() / 2)?;
    if sorted.len() % 2 == 1 {
        return Some(upper);
    }
    let lower = sorted[sorted.len() / 2 - 1];
    Some(0.5 * (lower + upper))
}

fn nullable_all<S: serde::Serializer>(values: &[f64], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(
        values
            .iter()
            .map(|value| value.is_finite().then_some(*value)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(must: Option<Limit>) -> Target {
        Target {
            quantity: "CD",
            unit: Unit::Metres,
            paper: None,
            must,
            aim: None,
            value: |_| 0.0,
        }
    }

    fn row(must: Limit, values: &[f64]) -> Row {
        let reached = values.iter().map(|value| Reached::Value(*value));
        Row::of("accuracy", "fence", &target(Some(must)), reached.collect())
    }

    fn verdict(must: Limit, values: &[f64]) -> Verdict {
        row(must, values).verdict
    }

    #[test]
    fn the_median_must_meet_it_and_the_worst_be_within_half_as_much_again() {
        let must = Limit::AtMost(0.04);
        assert_eq!(
            verdict(must, &[0.06, 0.03, 0.04, 0.05, 0.01]),
            Verdict::Passed
        );
        assert_eq!(
            verdict(must, &[0.061, 0.03, 0.04, 0.05, 0.01]),
            Verdict::Failed
        );
        assert_eq!(
            verdict(must, &[0.05, 0.041, 0.05, 0.01, 0.01]),
            Verdict::Failed
        );
        let ratio = Limit::AtLeast(3.0);
        assert_eq!(verdict(ratio, &[2.0, 3.0, 50.0]), Verdict::Passed);
        assert_eq!(verdict(ratio, &[1.9, 3.0, 50.0]), Verdict::Failed);
        assert_eq!(verdict(ratio, &[2.9, 2.9, 50.0]), Verdict::Failed);
        let share = Limit::ShareAtLeast(0.9);
        assert_eq!(verdict(share, &[0.86, 0.9, 1.0]), Verdict::Passed);
        assert_eq!(verdict(share, &[0.84, 0.9, 1.0]), Verdict::Failed);
        let as_good = Limit::RatioAtMost(1.15);
        assert_eq!(verdict(as_good, &[0.9, 1.15, 1.299]), Verdict::Passed);
        assert_eq!(verdict(as_good, &[0.9, 1.15, 1.301]), Verdict::Failed);
        assert_eq!(verdict(as_good, &[0.9, 1.16, 1.2]), Verdict::Failed);
        assert_eq!(verdict(as_good, &[0.9, 1.0, f64::NAN]), Verdict::Failed);
    }

    #[test]
    fn nothing_wrong_is_allowed_where_none_is() {
        let none = Limit::AtMost(0.0);
        assert_eq!(verdict(none, &[0.0; 5]), Verdict::Passed);
        assert_eq!(verdict(none, &[0.0, 0.0, 0.0, 0.0, 1.0]), Verdict::Failed);
    }

    #[test]
    fn an_empty_map_and_what_is_no_number_fail() {
        let must = Limit::AtMost(0.04);
        let one_empty = row(must, &[0.01, f64::INFINITY, 0.01]);
        assert_eq!(one_empty.verdict, Verdict::Failed);
        assert!(one_empty.worst.is_infinite() && one_empty.median < 0.02);
        let two = row(must, &[f64::INFINITY, 0.01]);
        assert!(two.median.is_infinite() && two.verdict == Verdict::Failed);
        assert_eq!(verdict(must, &[f64::NAN]), Verdict::Failed);
        assert_eq!(
            verdict(Limit::AtLeast(3.0), &[f64::NAN, 4.0, 4.0]),
            Verdict::Failed
        );
        assert_eq!(
            verdict(Limit::AtLeast(3.0), &[f64::INFINITY; 3]),
            Verdict::Passed
        );
    }

    #[test]
    fn a_failed_run_is_the_worst_there_is() {
        let must = target(Some(Limit::AtMost(0.04)));
        let reached = vec![Reached::Value(0.01), Reached::Failed, Reached::Value(0.01)];
        let row = Row::of("accuracy", "fence", &must, reached);
        assert_eq!((row.verdict, row.failed_count), (Verdict::Failed, 1));
        assert!(row.worst.is_infinite() && row.values.len() == 2);
    }

    #[test]
    fn a_row_without_all_its_seeds_claims_nothing() {
        let must = target(Some(Limit::AtMost(0.04)));
        let some = Row::of(
            "accuracy",
            "fence",
            &must,
            vec![Reached::Value(0.01), Reached::LeftOut],
        );
        assert_eq!(
            (some.verdict, some.left_out_count),
            (Verdict::Incomplete, 1)
        );
        let none = Row::of("accuracy", "fence", &must, vec![]);
        assert_eq!(none.verdict, Verdict::Incomplete);
        assert_eq!(none.show_reached(none.median), "–");
        let json = serde_json::to_value(&none).unwrap();
        assert!(json["median"].is_null() && json["verdict"] == "incomplete");
    }

    #[test]
    fn a_figure_without_a_must_is_only_shown() {
        let row = Row::of(
            "length",
            "fence",
            &target(None),
            vec![Reached::Value(f64::INFINITY)],
        );
        assert_eq!(row.verdict, Verdict::Shown);
        assert_eq!(row.must_text(), "–");
    }
}
