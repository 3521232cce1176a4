//! Stiff and extreme cases: what the program makes of them, beside f64 and beside naive f32.
//!
//! Each [`Case`] gives rows; each row holds the program to a limit. The naive versions are what one
//! would write down first, in single precision; they are here to show why the program's way is
//! not theirs.

mod draw;
mod pings;
mod report;
mod row;

pub use report::{section, text};
pub use row::{Figure, Row};

/// Some rows that belong together.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    /// What is extreme.
    pub name: &'static str,
    make: fn(seed: u64, quick: bool) -> Vec<Row>,
}

impl Case {
    /// Computes them; `quick` takes fewer and smaller inputs. The same seed gives the same rows.
    #[must_use]
    pub fn rows(&self, seed: u64, quick: bool) -> Vec<Row> {
        (self.make)(seed, quick)
    }
}

/// All of them, in the order of the report.
#[must_use]
pub fn cases() -> Vec<Case> {
    vec![Case {
        name: "degenerate pings",
        make: pings::rows,
    }]
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
