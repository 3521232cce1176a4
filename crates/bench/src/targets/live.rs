//! Live maps, held against those of the same dive cut there and ended.

use super::cases::{self, Case, survey, target};
use super::limit::{Limit, Target, Unit};
use super::sections::Section;
use crate::runs::{Outcome, Spacing, Spec};
use echosplat_metrics::Metrics;

/// Tenths of a dive: live maps are judged at each.
pub(crate) const LIVE_MOMENTS: usize = 10;
/// At these it is cut and ended; the first few only show how a map begins.
pub(super) const TENTHS: [usize; 7] = [3, 4, 5, 6, 7, 8, 9];
/// Where there is less time.
pub(crate) const FEW_TENTHS: [usize; 3] = [3, 5, 7];

/// The dive watched, then the dives cut at these tenths; that of the whole dive is the watched one's own
/// finished map, on which looking leaves no trace.
pub(crate) fn case(scene: &'static str, tenths: &[usize]) -> Case {
    let watched = Spec {
        moments: LIVE_MOMENTS,
        spacing: Spacing::Even,
        ..survey(scene)
    };
    let shares = watched.moment_shares();
    let cut = tenths.iter().map(|tenth| Spec {
        share: shares[tenth - 1],
        ..survey(scene)
    });
    let runs = [watched].into_iter().chain(cut).collect();
    cases::case(Section::Live, scene, runs, targets())
}

fn targets() -> Vec<Target> {
    let as_good = |quantity, most, value| Target {
        must: Some(Limit::RatioAtMost(most)),
        aim: Some(1.0),
        ..target(quantity, Unit::Ratio, value)
    };
    let never_false = Target {
        must: Some(Limit::AtMost(0.005)),
        aim: Some(0.0),
        ..target("live confident-false, most", Unit::Share, |o| {
            worst(live_and_cut(o).map(|[live, _]| live.confident_false_share))
        })
    };
    let metres = |quantity, value| target(quantity, Unit::Metres, value);
    vec![
        as_good("live CD over cut CD, worst", 1.15, |o| {
            worst(live_and_cut(o).map(|[live, cut]| live.cd_m / cut.cd_m))
        }),
        as_good("live 99th percentile over cut, worst", 1.3, |o| {
            worst(live_and_cut(o).map(|[live, cut]| live.p99_m / cut.p99_m))
        }),
        never_false,
        metres("live CD, 30 %", |o| cd_at(o, 3, 0)),
        metres("cut CD, 30 %", |o| cd_at(o, 3, 1)),
        metres("live CD, 50 %", |o| cd_at(o, 5, 0)),
        metres("cut CD, 50 %", |o| cd_at(o, 5, 1)),
        metres("live CD, 70 %", |o| cd_at(o, 7, 0)),
        metres("cut CD, 70 %", |o| cd_at(o, 7, 1)),
    ]
}

/// At which tenths the dives were cut that stand behind the watched one.
fn tenths(outcomes: &[&Outcome]) -> &'static [usize] {
    match outcomes.len() - 1 {
        count if count == TENTHS.len() => &TENTHS,
        count if count == FEW_TENTHS.len() => &FEW_TENTHS,
        _ => &[],
    }
}

/// Of each tenth at which the dive was cut, and of its end, the live map and that of the dive cut there;
/// nothing if some moment had no map of its own.
fn live_and_cut<'a>(outcomes: &[&'a Outcome]) -> impl Iterator<Item = [&'a Metrics; 2]> {
    let watched = outcomes[0];
    let tenths = match watched.samples.len() {
        LIVE_MOMENTS => tenths(outcomes),
        _ => &[],
    };
    let end = (!tenths.is_empty()).then_some((LIVE_MOMENTS, watched));
    let cut = tenths.iter().copied().zip(outcomes[1..].iter().copied());
    let pair =
        |(tenth, cut): (usize, &'a Outcome)| [&watched.samples[tenth - 1].metrics, &cut.metrics];
    cut.chain(end).map(pair).collect::<Vec<_>>().into_iter()
}

/// Of the live map (0) or the cut dive's (1) after so many tenths.
fn cd_at(outcomes: &[&Outcome], tenth: usize, which: usize) -> f64 {
    let index = tenths(outcomes).iter().position(|cut| *cut == tenth);
    let pair = index.and_then(|index| live_and_cut(outcomes).nth(index));
    pair.map_or(f64::NAN, |pair| pair[which].cd_m)
}

/// Not a number if there are none, or one of them is not.
pub(super) fn worst(values: impl Iterator<Item = f64>) -> f64 {
    let worse = |a: f64, b: f64| if b > a || b.is_nan() { b } else { a };
    values.reduce(worse).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dive watched whose live maps are `live_cd_m` off, and as many cut as there are.
    fn watched(live_cd_m: [f64; LIVE_MOMENTS]) -> Vec<Outcome> {
        let sample = |cd_m: f64| echosplat_metrics::curve::Sample {
            dive_s: 0.0,
            compute_s: 0.0,
            pair_count: 0,
            voxel_observations: 0,
            ping_count: 0,
            metrics: crate::runs::sample_outcome(cd_m, 1).metrics,
        };
        let whole = Outcome {
            samples: live_cd_m.map(sample).into(),
            ..crate::runs::sample_outcome(0.01, 1)
        };
        let cut = case("fence", &TENTHS).runs(1).len() - 1;
        let cut = (0..cut).map(|index| crate::runs::sample_outcome(0.08 - 0.01 * index as f64, 1));
        [whole].into_iter().chain(cut).collect()
    }

    #[test]
    fn a_live_map_is_held_against_the_dive_cut_at_its_moment() {
        // Twice as far off at 60 %, and far off before 30 %, which does not count.
        let far = 9.0;
        let live_cd_m = [far, far, 0.08, 0.07, 0.06, 0.1, 0.04, 0.03, 0.02, 0.01];
        let outcomes = watched(live_cd_m);
        let outcomes: Vec<&Outcome> = outcomes.iter().collect();
        let ratios = || live_and_cut(&outcomes).map(|[live, cut]| live.cd_m / cut.cd_m);
        assert_eq!(ratios().count(), 8);
        assert!((worst(ratios()) - 2.0).abs() < 1e-9);
        assert!((cd_at(&outcomes, 3, 0) - 0.08).abs() < 1e-12);
        assert!((cd_at(&outcomes, 7, 1) - 0.04).abs() < 1e-12);
    }

    #[test]
    fn a_moment_without_a_map_is_no_number() {
        let mut outcomes = watched([0.1; LIVE_MOMENTS]);
        outcomes[0].samples.pop();
        let outcomes: Vec<&Outcome> = outcomes.iter().collect();
        assert!(worst(live_and_cut(&outcomes).map(|[live, _]| live.cd_m)).is_nan());
        assert!(cd_at(&outcomes, 5, 0).is_nan());
        assert!(worst([1.0, f64::NAN, 2.0].into_iter()).is_nan());
    }

    #[test]
    fn fewer_cuts_are_held_against_their_own_moments() {
        let outcomes = watched([9.0, 9.0, 0.08, 9.0, 0.06, 9.0, 0.12, 9.0, 9.0, 0.01]);
        // Of the seven cut dives those at 30, 50 and 70 %: 0.08, 0.06 and 0.04 m.
        let few = [0, 1, 3, 5].map(|index| &outcomes[index]);
        let ratios = || live_and_cut(&few).map(|[live, cut]| live.cd_m / cut.cd_m);
        assert_eq!(ratios().count(), 4);
        assert!((worst(ratios()) - 3.0).abs() < 1e-9);
        assert!((cd_at(&few, 7, 1) - 0.04).abs() < 1e-12 && cd_at(&few, 6, 1).is_nan());
        let shares = case("fence", &FEW_TENTHS).runs(1);
        let shares: Vec<f64> = shares.iter().map(|spec| spec.share).collect();
        assert_eq!(shares.len(), 4);
        assert!(shares[1] < 0.31 && shares[3] > 0.69);
    }
}
