//! One row: an input, what is true, what the program makes of it, and whether that is near enough.

use serde::{Serialize, Serializer};

/// A number as a reader sees it: in JSON a number, or its name where JSON has none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Figure(pub(crate) f64);

impl Serialize for Figure {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.is_finite() {
            true => serializer.serialize_f64(self.0),
            false => serializer.serialize_str(&self.to_string()),
        }
    }
}

impl std::fmt::Display for Figure {
    /// Four digits; a power of ten where that is shorter.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let value = self.0;
        let size = value.abs();
        match size {
            _ if value.is_nan() => f.write_str("NaN"),
            _ if size.is_infinite() => f.write_str(if value > 0.0 { "∞" } else { "−∞" }),
            _ if size <= 0.0 => f.write_str("0"),
            _ if (1e-3..1e5).contains(&size) => write!(f, "{}", rounded(value)),
            _ => write!(f, "{value:.2e}"),
        }
    }
}

/// To four significant digits.
fn rounded(value: f64) -> f64 {
    let unit = 10_f64.powi(3 - value.abs().log10().floor() as i32);
    (value * unit).round() / unit
}

/// One row of the table of stiff and extreme cases.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Row {
    /// What is extreme.
    pub(crate) case: &'static str,
    /// What went in.
    pub(crate) input: String,
    /// What `truth`, `program` and `naive` are: a quantity and its unit.
    pub(crate) quantity: &'static str,
    /// In f64, by the plain twin or by arithmetic.
    pub(crate) truth: Figure,
    /// By the program.
    pub(crate) program: Figure,
    /// In single precision as one would write it down first.
    pub(crate) naive: Option<Figure>,
    /// How far the program is off, by the row's own measure.
    pub(crate) error: Figure,
    /// The same of the naive way.
    pub(crate) naive_error: Option<Figure>,
    /// Most that `error` may be.
    pub(crate) limit: f64,
    /// Whether it is. An error that is not a number is above every limit.
    pub(crate) passed: bool,
    /// Why the program's way holds.
    pub(crate) why: &'static str,
}

/// One quantity three times, and how far off two of them are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Comparison {
    pub(crate) truth: f64,
    pub(crate) program: f64,
    pub(crate) error: f64,
    /// Its value and its error.
    pub(crate) naive: Option<(f64, f64)>,
}

impl Comparison {
    /// Of single numbers; errors are relative to `scale`.
    pub(crate) fn of(truth: f64, program: f64, scale: f64) -> Self {
        Self {
            truth,
            program,
            error: (program - truth).abs() / scale,
            naive: None,
        }
    }

    /// Of many numbers that belong together, at the one where the program is furthest off; errors
    /// are relative to the largest that is true. What should be nothing at all is measured as it is.
    pub(crate) fn of_many<N: Copy + Into<f64>>(truth: &[f64], program: &[N]) -> Self {
        let at = worst_of(truth, program);
        match (truth.get(at), program.get(at)) {
            (Some(&truth_there), Some(&there)) if truth.len() == program.len() => {
                Self::of(truth_there, there.into(), scale_of(truth))
            }
            _ => Self::of(f64::NAN, f64::NAN, 1.0),
        }
    }

    /// With what the naive way makes of the same number.
    pub(crate) fn with_naive(mut self, naive: f64, scale: f64) -> Self {
        self.naive = Some((naive, (naive - self.truth).abs() / scale));
        self
    }

    /// The worse of two, each way by itself.
    pub(crate) fn worse(self, other: Self) -> Self {
        let worst = match is_worse(other.error, self.error) {
            true => other,
            false => self,
        };
        let naive = match (self.naive, other.naive) {
            (Some(a), Some(b)) => Some(if is_worse(b.1, a.1) { b } else { a }),
            (a, b) => a.or(b),
        };
        Self { naive, ..worst }
    }

    pub(crate) fn row(self, label: Label, input: impl Into<String>, limit: f64) -> Row {
        Row {
            case: label.case,
            input: input.into(),
            quantity: label.quantity,
            truth: Figure(self.truth),
            program: Figure(self.program),
            naive: self.naive.map(|naive| Figure(naive.0)),
            error: Figure(self.error),
            naive_error: self.naive.map(|naive| Figure(naive.1)),
            limit,
            passed: self.error <= limit,
            why: label.why,
        }
    }
}

/// The words that the rows of one case share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Label {
    pub(crate) case: &'static str,
    pub(crate) quantity: &'static str,
    pub(crate) why: &'static str,
}

/// What is not a number is worse than any that is.
fn is_worse(error: f64, than: f64) -> bool {
    error.is_nan() || error > than
}

fn scale_of(truth: &[f64]) -> f64 {
    let largest = truth.iter().fold(0.0, |most: f64, t| most.max(t.abs()));
    if largest > 0.0 { largest } else { 1.0 }
}

fn worst_of<N: Copy + Into<f64>>(truth: &[f64], other: &[N]) -> usize {
    let errors = truth.iter().zip(other).map(|(t, &o)| (o.into() - t).abs());
    let start = (0, f64::NEG_INFINITY);
    let (at, _) = errors
        .enumerate()
        .fold(start, |worst, (at, error)| match worst.1.is_nan() {
            false if is_worse(error, worst.1) => (at, error),
            _ => worst,
        });
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    const LABEL: Label = Label {
        case: "a case",
        quantity: "a length, m",
        why: "because",
    };

    #[test]
    fn a_wrong_value_fails_and_a_right_one_passes() {
        let row = |program: f64| Comparison::of(2.0, program, 2.0).row(LABEL, "x", 1e-3);
        assert!(row(2.001).passed);
        assert!(!row(2.1).passed);
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(!row(wrong).passed, "{wrong}");
        }
    }

    #[test]
    fn the_worst_of_many_is_shown_and_nan_is_worst() {
        let truth = [1.0, 4.0, 2.0];
        let c = Comparison::of_many(&truth, &[1.0_f32, 4.5, 2.25]);
        assert!((c.error - 0.125).abs() < 1e-12 && (c.truth - 4.0).abs() < 1e-12);
        assert!(
            Comparison::of_many(&truth, &[1.0, f32::NAN, 9.0])
                .error
                .is_nan()
        );
        assert!(Comparison::of_many(&truth, &[1.0_f32, 4.0]).error.is_nan());
        let nan = Comparison::of(1.0, f64::NAN, 1.0);
        assert!(nan.worse(c).error.is_nan() && c.worse(nan).error.is_nan());
    }

    #[test]
    fn out_of_nothing_anything_counts_as_it_is() {
        let c = Comparison::of_many(&[0.0, 0.0], &[0.0, 1e-3_f32]);
        assert!((c.error - 1e-3).abs() < 1e-9);
    }

    #[test]
    fn the_naive_way_is_judged_by_itself() {
        let truth = [1.0, 4.0];
        let c = Comparison::of_many(&truth, &[1.5_f32, 4.0]).with_naive(8.0, 4.0);
        assert_eq!(c.naive, Some((8.0, 1.75)));
        let d = Comparison::of(1.0, 1.0, 1.0).with_naive(f64::NAN, 1.0);
        assert!(c.worse(d).naive.is_some_and(|naive| naive.1.is_nan()));
        assert!((c.worse(d).error - 0.125).abs() < 1e-12);
    }

    #[test]
    fn figures_are_short_and_json_always_valid() {
        let shown = [0.0, 1.0, 0.123_456, 12_345.6, 1.5e-7, f64::NAN, -1.0 / 0.0];
        let shown = shown.map(|value| Figure(value).to_string());
        assert_eq!(shown, ["0", "1", "0.1235", "12350", "1.50e-7", "NaN", "−∞"]);
        let row = Comparison::of(0.0, f64::NAN, 1.0).row(LABEL, "x", 1.0);
        let json: serde_json::Value =
            serde_json::from_str(&serde_json::to_string(&row).unwrap()).unwrap();
        assert_eq!(json["program"], "NaN");
        assert_eq!(json["passed"], false);
    }
}
