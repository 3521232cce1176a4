//! Whether what the mapper chooses by itself is worth it.

use serde::Serialize;

use super::cases::{Case, Feature, Variant};
use crate::runs::{Outcome, Outcomes};
use echosplat_metrics::curve::Spread;
use echosplat_metrics::nullable;

/// What is less by this share is less.
const LESS_ERROR: f64 = 0.05;
const LESS_WORK: f64 = 0.15;
/// Against everything switched on: most work, most error, and scenes where both hold.
const WORK_SHARE: f64 = 2.0 / 3.0;
const MORE_ERROR: f64 = 0.02;
const LEAST_SCENES: usize = 3;

/// Error and work of a variant, medians over seeds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Standard {
    /// Chamfer distance, metres; where no truth was seen, the number of asserted Gaussians.
    #[serde(with = "nullable")]
    pub(crate) error: f64,
    /// Gaussian–bin pairs and voxel observations.
    pub(crate) work: f64,
}

impl Standard {
    /// `None` of none.
    fn of(outcomes: &[&Outcome]) -> Option<Self> {
        let median = |of: fn(&Outcome) -> f64| Spread::of(outcomes.iter().map(|o| of(o))).median;
        (!outcomes.is_empty()).then(|| Self {
            error: median(error),
            work: median(|outcome| outcome.total.counted() as f64),
        })
    }

    /// A variant and what the mapper chooses by itself, over the seeds that both have mapped.
    #[must_use]
    pub(crate) fn of_both(
        case: &Case,
        features: &[Feature],
        [variant, auto]: [&Variant; 2],
        seeds: &[u64],
        results: &Outcomes,
    ) -> Option<[Self; 2]> {
        let outcome = |variant: &Variant, seed: u64| {
            let result = results.of(&case.spec(features, variant, seed))?;
            result.as_ref().ok()
        };
        let both = |seed: &u64| Some((outcome(variant, *seed)?, outcome(auto, *seed)?));
        let (fixed, chosen): (Vec<_>, Vec<_>) = seeds.iter().filter_map(both).unzip();
        Some([Self::of(&fixed)?, Self::of(&chosen)?])
    }

    /// Whether it has both clearly less error and clearly less work.
    fn beats(&self, other: &Self) -> bool {
        let less_error = self.error < (1.0 - LESS_ERROR) * other.error;
        less_error && self.work < (1.0 - LESS_WORK) * other.work
    }

    fn saves_against(&self, everything: &Self) -> bool {
        let as_good = self.error <= (1.0 + MORE_ERROR) * everything.error;
        as_good && self.work <= WORK_SHARE * everything.work
    }
}

/// An empty map of something has infinite error.
fn error(outcome: &Outcome) -> f64 {
    match outcome.metrics.truth_sample_count {
        0 => outcome.metrics.confident_count as f64,
        _ => outcome.metrics.cd_m,
    }
}

/// What holds and what does not.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub(crate) struct Check {
    /// Case and fixed setting that has both less error and less work than what the mapper chooses.
    pub(crate) beaten_by: Vec<(String, String)>,
    /// Cases where the mapper's choice does at most two thirds of the work of everything switched on,
    /// at an error no more than 2 % higher.
    pub(crate) saves_on: Vec<String>,
    /// Cases where everything on or off has no figures beside the mapper's choice, so that no savings are
    /// claimed or missed. Features alone do not matter to it.
    pub(crate) incomplete: Vec<String>,
    /// Whether there is anything to choose.
    #[serde(rename = "has_parts")]
    pub(crate) has_features: bool,
}

impl Check {
    /// One line for each thing that does not hold.
    #[must_use]
    pub(crate) fn failures(&self) -> Vec<String> {
        let mut failures: Vec<String> = self
            .beaten_by
            .iter()
            .map(|(case, fixed)| {
                format!("{case}: {fixed} has less error and less work than everything auto")
            })
            .collect();
        let could_save = self.saves_on.len() + self.incomplete.len();
        if self.has_features && could_save < LEAST_SCENES {
            failures.push(format!(
                "everything auto does at most two thirds of the work of everything on, as well, \
                 on {} scenes; it must on {LEAST_SCENES}",
                self.saves_on.len()
            ));
        }
        failures
    }
}

/// Holds what the mapper chooses against everything fixed.
#[must_use]
pub(crate) fn check(
    cases: &[Case],
    features: &[Feature],
    variants: &[Variant],
    seeds: &[u64],
    results: &Outcomes,
) -> Check {
    let mut check = Check {
        has_features: !features.is_empty(),
        ..Check::default()
    };
    let Some(auto) = variants.iter().find(|variant| variant.is_auto()) else {
        return check;
    };
    for case in cases {
        let fixed = || variants.iter().filter(|variant| !variant.is_auto());
        let mut compared_whole = 0;
        for variant in fixed() {
            let both = Standard::of_both(case, features, [variant, auto], seeds, results);
            let Some([standard, auto]) = both else {
                continue;
            };
            compared_whole += usize::from(variant.is_whole());
            if standard.beats(&auto) {
                check.beaten_by.push((case.name(), variant.name.clone()));
            }
            if variant.name == "everything on" && auto.saves_against(&standard) {
                check.saves_on.push(case.name());
            }
        }
        if compared_whole < fixed().filter(|variant| variant.is_whole()).count() {
            check.incomplete.push(case.name());
        }
    }
    check
}

#[cfg(test)]
mod tests {
    use super::super::cases::{cases, variants};
    use super::*;
    use crate::runs::sample_outcome;

    /// Everything on, everything off and what the mapper chooses, on the first cases.
    fn checked(figures: &[[(f64, u64); 3]]) -> Check {
        let features = [Feature::named("occlusion")];
        let variants = variants(&features, true);
        let cases = &cases(false)[..figures.len()];
        let mut results = Outcomes::default();
        for (case, figures) in cases.iter().zip(figures) {
            // In the order of the variants: auto, on, off.
            for (variant, (cd_m, work)) in variants.iter().zip(figures) {
                let spec = case.spec(&features, variant, 1);
                results
                    .0
                    .insert(spec.name(), Ok(sample_outcome(*cd_m, *work)));
            }
        }
        check(cases, &features, &variants, &[1], &results)
    }

    #[test]
    fn a_fixed_setting_must_have_less_of_both_to_beat_the_choice() {
        let as_it_should = [(0.03, 600), (0.03, 1000), (0.05, 300)];
        let check = checked(&[as_it_should; 3]);
        assert_eq!(check.failures(), Vec::<String>::new());
        assert_eq!(check.saves_on.len(), 3);
        let beaten = [(0.03, 600), (0.0301, 1000), (0.028, 500)];
        let check = checked(&[as_it_should, as_it_should, as_it_should, beaten]);
        assert_eq!(check.failures().len(), 1);
        assert_eq!(check.beaten_by[0].1, "everything off");
    }

    #[test]
    fn savings_are_wanted_on_three_scenes_and_no_error_counts_as_saved() {
        let costly = [(0.03, 900), (0.03, 1000), (0.05, 300)];
        let worse = [(0.04, 500), (0.03, 1000), (0.05, 300)];
        let check = checked(&[costly, worse, costly]);
        assert!(check.saves_on.is_empty() && check.failures().len() == 1);
    }

    #[test]
    fn features_alone_that_were_not_run_hide_no_missed_savings() {
        let features = [Feature::named("occlusion"), Feature::named("specular")];
        let variants = variants(&features, false);
        let cases = cases(false);
        let mut results = Outcomes::default();
        for case in &cases {
            for (variant, work) in variants.iter().take(3).zip([900, 1000, 300]) {
                let spec = case.spec(&features, variant, 1);
                let outcome = sample_outcome(0.03, work);
                results.0.insert(spec.name(), Ok(outcome));
            }
        }
        let check = check(&cases, &features, &variants, &[1], &results);
        assert!(check.incomplete.is_empty() && check.saves_on.is_empty());
        assert_eq!(check.failures().len(), 1);
    }

    #[test]
    fn what_was_not_run_claims_nothing() {
        let features = [Feature::named("occlusion")];
        let variants = variants(&features, true);
        let check = check(
            &cases(false),
            &features,
            &variants,
            &[1],
            &Outcomes::default(),
        );
        assert_eq!(check.incomplete.len(), 6);
        assert!(check.failures().is_empty());
    }
}
