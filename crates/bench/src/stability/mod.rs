//! Stiff and extreme cases: what the program makes of them, beside f64 and beside naive f32.
//!
//! Each [`Case`] gives rows; each row holds the program to a limit. The naive versions are what one
//! would write down first, in single precision; they are here to show why the program's way is
//! not theirs.

mod crowds;
mod cut;
mod dive;
mod frames;
mod images;
mod limits;
mod naive;
mod normal;
mod pings;
mod poison;
mod report;
mod row;
mod scene;
mod shadows;
mod shapes;
mod stiffness;
mod twins;
mod whole;

pub(crate) use report::{section, text};
pub(crate) use row::{Figure, Row};
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
        case("covariance condition", shapes::condition),
        case("far origins", frames::far),
        case("polar axis", shapes::polar),
        case("range to 0", shapes::near),
        case("azimuth across ±180°", frames::wrap),
        case("transmittance", shadows::transmittance),
        case("backward near α = 0.999", shadows::cap),
        case("parameters out of range", limits::rows),
        case("crowds and mixed sizes", crowds::rows),
        case("poison in one Gaussian", poison::rows),
        case("degenerate pings", pings::rows),
        case("stiffness", stiffness::rows),
        case("through the whole mapper", whole::rows),
        case("the paper's renderer", images::rows),
        case("gradients against central differences", twins::differences),
        case("online kernels against twins", twins::online),
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
