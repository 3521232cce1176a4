//! Stiff and extreme cases: what the program makes of them, beside f64.
//!
//! Each [`Case`] gives rows; each row holds the program to a limit.

mod cut;
mod dive;
mod edges;
mod images;
mod kernels;
mod pings;
mod report;
mod row;
mod scene;
mod stiffness;
mod twins;
mod whole;

pub(crate) use report::{section, text};
pub(crate) use row::{Figure, Row};
pub(crate) use scene::{NOISE, Trial};
pub(crate) use stiffness::plots;

/// Some rows that belong together.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Case {
    /// What is extreme.
    pub(crate) name: &'static str,
    make: fn(seed: u64, quick: bool) -> Vec<Row>,
}

impl Case {
    /// Computes them; `quick` takes fewer and smaller inputs. The same seed gives the same rows.
    #[must_use]
    pub(crate) fn rows(&self, seed: u64, quick: bool) -> Vec<Row> {
        (self.make)(seed, quick)
    }
}

/// All of them, in the order of the report.
#[must_use]
pub(crate) fn cases() -> Vec<Case> {
    let case = |name, make: fn(u64, bool) -> Vec<Row>| Case { name, make };
    vec![
        case("kernels against the twin", kernels::against_twin),
        case("strengths over twelve decades", kernels::decades),
        case("a crowd in one bin", kernels::crowds),
        case("small pings", kernels::small),
        case("silence and saturation", kernels::loudness),
        case("singular places and edges", edges::places),
        case("needles and discs", edges::shapes),
        case("far coordinates", edges::far),
        case("poison in one Gaussian", edges::poison),
        case("instructions of the processor", edges::levels),
        case("degenerate pings", pings::rows),
        case("stiffness", stiffness::rows),
        case("through the whole mapper", whole::rows),
        case("the paper's renderer", images::rows),
        case("paper's kernels against twins", twins::paper),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_passes() {
        let rows: Vec<Row> = cases().iter().flat_map(|case| case.rows(1, true)).collect();
        println!("{}", text(&rows));
        assert!(rows.iter().all(|row| row.passed));
    }
}
