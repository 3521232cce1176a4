//! Each test of a verdict leaves its reason, and says its threshold as it is.

use echosplat_measurement::SymmetricMat3;
use echosplat_model::glam::Vec3;

use super::*;
use crate::features::{Cues, Features, MapCues, decide};

/// Clearly seen, a tenth of a metre sure.
const GOOD: ViewStatistics = ViewStatistics {
    observations: 20.0,
    hidden_observations: 0.0,
    clear_observations: 12.0,
    odds: 0.0,
    compactness: 15.0,
    explained_ratio: 18.0,
    mirror_m: Vec3::ZERO,
    mirror_m2: 0.0,
};

fn thresholds(interfered: bool) -> VerdictThresholds {
    let (at_work, _) = decide(&Features::default(), &Cues::default(), MapCues::default());
    let at_work = AtWork {
        interfered,
        ..at_work
    };
    VerdictThresholds::of(&MapperConfig::default(), at_work)
}

/// Verdict and reason of a place with these statistics and one sigma beside `others` good ones.
fn judged_beside(
    others: usize,
    statistics: ViewStatistics,
    sigma_m: f32,
    thresholds: VerdictThresholds,
) -> (Verdict, Why) {
    let mut gaussians = Gaussians::default();
    for place in 0..=others {
        let at_m = Vec3::new((place % 5) as f32, (place / 5) as f32, 0.0);
        gaussians.spawn(at_m, (0, 0), 0.5, 1.0);
    }
    let finding = |slot: usize| {
        let (statistics, sigma_m) = match slot {
            0 => (statistics, sigma_m),
            _ => (GOOD, 0.1),
        };
        Some(Finding {
            statistics,
            information: SymmetricMat3::isotropic(1.0 / sigma_m),
            ..Finding::default()
        })
    };
    judge(&mut gaussians, finding, 1.0, thresholds);
    (gaussians.verdict[0], gaussians.why[0])
}

fn judged(statistics: ViewStatistics, sigma_m: f32) -> (Verdict, Why) {
    judged_beside(24, statistics, sigma_m, thresholds(false))
}

#[test]
fn what_is_confident_says_by_which_test() {
    let (verdict, why) = judged(GOOD, 0.1);
    assert_eq!(verdict, CONFIDENT);
    assert_eq!(why, Why::of(Reason::ClearlySeen, 12.0, 0.6));
    let likely = ViewStatistics {
        clear_observations: 2.0,
        odds: 20.5,
        ..GOOD
    };
    let of_likely = (CONFIDENT, Why::of(Reason::Likely, 2.0, 22.5));
    assert_eq!(judged(likely, 0.5), of_likely);
    let nearly = ViewStatistics {
        clear_observations: 6.0,
        ..GOOD
    };
    let of_nearly = (CONFIDENT, Why::of(Reason::Linked, 6.0, 0.5));
    assert_eq!(judged(nearly, 0.5), of_nearly);
}

#[test]
fn what_is_ambiguous_says_which_test_it_failed() {
    let of = |reason, clear, measured| {
        let why = Why::of(reason, clear, measured);
        (Verdict::Published(Standing::Ambiguous), why)
    };
    let few = ViewStatistics {
        clear_observations: 3.0,
        odds: 4.0,
        ..GOOD
    };
    assert_eq!(judged(few, 0.1), of(Reason::FewClear, 3.0, 7.0));
    let rarely = ViewStatistics {
        observations: 100.0,
        compactness: 75.0,
        explained_ratio: 90.0,
        ..GOOD
    };
    assert_eq!(judged(rarely, 0.1), of(Reason::SmallClearShare, 12.0, 0.12));
    assert_eq!(judged(GOOD, 1.5), of(Reason::WidePlace, 12.0, 1.5));
    let beside = ViewStatistics {
        compactness: 5.0,
        ..GOOD
    };
    assert_eq!(judged(beside, 0.1), of(Reason::BesideSurface, 12.0, 0.25));
    let hidden = ViewStatistics {
        hidden_observations: 15.0,
        ..GOOD
    };
    assert_eq!(judged(hidden, 0.1), of(Reason::Hidden, 12.0, 0.75));
    let mirrored = ViewStatistics {
        mirror_m: Vec3::X * 20.0,
        mirror_m2: 20.0 * (1.0 + 0.125 * 0.125),
        ..GOOD
    };
    assert_eq!(judged(mirrored, 0.1), of(Reason::MirrorFits, 12.0, 0.125));
    let alone = judged_beside(3, GOOD, 0.1, thresholds(false));
    assert_eq!(alone, of(Reason::Isolated, 12.0, 4.0));
    let alone = judged_beside(0, GOOD, 0.1, thresholds(true));
    assert_eq!(alone, of(Reason::IsolatedNear, 12.0, 1.0));
}

#[test]
fn what_is_explained_away_says_what_by() {
    let of = |reason, clear, measured| (Verdict::ExplainedAway, Why::of(reason, clear, measured));
    let little = ViewStatistics {
        explained_ratio: 2.5,
        ..GOOD
    };
    assert_eq!(judged(little, 0.1), of(Reason::ExplainsLittle, 12.0, 0.125));
    let unlit = ViewStatistics::default();
    assert_eq!(judged(unlit, 0.1), of(Reason::Unlit, 0.0, 0.0));
    let mut gaussians = Gaussians::default();
    gaussians.spawn(Vec3::ZERO, (0, 0), 0.5, 0.1);
    gaussians.spawn(Vec3::X, (0, 1), 0.5, 1.0);
    let finding = Finding {
        statistics: GOOD,
        information: SymmetricMat3::isotropic(10.0),
        ..Finding::default()
    };
    judge(&mut gaussians, |_| Some(finding), 1.0, thresholds(false));
    let outshone = (gaussians.verdict[0], gaussians.why[0]);
    assert_eq!(outshone, of(Reason::Outshone, 12.0, 0.0));
}

/// Words of a reason stand in a crate that knows no threshold.
#[test]
fn words_say_the_thresholds_as_they_are() {
    let says = |reason: Reason, number: String| {
        assert!(reason.words().contains(&number), "{number} in {reason:?}");
    };
    let percent = |fraction: f32| format!("{:.0} %", 100.0 * fraction);
    for reason in [Reason::ClearlySeen, Reason::FewClear] {
        says(reason, format!("{LEAST_OBSERVATIONS} "));
        says(reason, format!("{LEAST_SMEARED_OBSERVATIONS} where poses"));
    }
    for reason in [Reason::ClearlySeen, Reason::SmallClearShare] {
        says(reason, percent(LEAST_CLEAR_SHARE));
    }
    for reason in [Reason::Likely, Reason::FewClear] {
        says(reason, format!("{ENOUGH_ODDS} are"));
    }
    let sigma_m = MapperConfig::default().confident_sigma_m;
    says(Reason::WidePlace, format!("{:.0} cm", 100.0 * sigma_m));
    says(Reason::BesideSurface, percent(LEAST_COMPACTNESS));
    says(Reason::Hidden, percent(MOST_HIDDEN_SHARE));
    says(
        Reason::MirrorFits,
        format!("{:.0} cm", 100.0 * LEAST_MIRROR_SPREAD_M),
    );
    says(Reason::IsolatedNear, format!("{LEAST_NEAR_SUPPORT} are"));
    says(
        Reason::Isolated,
        format!("{SUPPORT_VOXELS} voxels ({LEAST_SUPPORT} are"),
    );
    says(Reason::Improbable, percent(certainty::LEAST_PROBABILITY));
    says(Reason::Outshone, percent(LEAST_STRENGTH));
    says(Reason::ExplainsLittle, percent(LEAST_EXPLAINED_RATIO));
    assert_eq!(
        (
            NEAR_SUPPORT_VOXELS,
            LINK_VOXELS,
            LINK_SUPPORT,
            MUCH_STRONGER
        ),
        (6.0, 6.0, 8.0, 5.0)
    );
}
