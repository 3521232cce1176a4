//! What single maps must reach: the table of targets, row by row.

use echosplat_simulator::{DiveKind, NoiseLevel};

use super::limit::{Limit, Target, Unit};
use crate::runs::Outcome;

/// A dive and what its map must reach.
pub(super) struct Judged {
    pub(super) scene: &'static str,
    pub(super) dive: DiveKind,
    pub(super) noise: NoiseLevel,
    pub(super) targets: Vec<Target>,
}

/// Least share of normals within 20° on surfaces that are larger than the beam.
const NORMALS_SHARE: f64 = 0.8;

pub(super) fn table() -> Vec<Judged> {
    use DiveKind::{Level, Pan, Survey, Viewpoints};
    use NoiseLevel::{Harsh, Nominal, None as Clean};
    let judged = |scene, dive, noise, targets| Judged {
        scene,
        dive,
        noise,
        targets,
    };
    let harsh = |scene| {
        let targets = vec![cd(0.10, 0.06), false_share(0.01, 0.003)];
        judged(scene, Survey, Harsh, targets)
    };
    let paper_fence = errors([0.024, 0.20], [0.015, 0.12]);
    let paper_truss = errors([0.11, 1.0], [0.08, 0.5]);
    let noisy_views = errors([0.030, 0.30], [0.020, 0.20]);
    let mut truss = printed(paper_truss, [0.740, 10.181]);
    truss.push(memory(400.0, 150.0));
    vec![
        judged("empty", Survey, Nominal, vec![nothing()]),
        judged("fence", Survey, Nominal, fence_like()),
        judged(
            "fence",
            Viewpoints,
            Clean,
            printed(paper_fence, [0.129, 1.391]),
        ),
        judged("fence", Viewpoints, Nominal, noisy_views),
        judged(
            "fence-specular",
            Survey,
            Nominal,
            errors([0.045, 0.5], [0.030, 0.30]),
        ),
        judged("fence", Pan, Nominal, blind()),
        judged("fence", Level, Nominal, blind()),
        judged(
            "wall",
            Survey,
            Nominal,
            with(structure([0.025, 0.29]), &[normals()]),
        ),
        judged(
            "pier",
            Survey,
            Nominal,
            with(structure([0.035, 0.35]), &[normals(), seabed_normals()]),
        ),
        harsh("fence"),
        harsh("wall"),
        harsh("pier"),
        harsh("pipeline"),
        judged("truss", Viewpoints, Clean, truss),
    ]
}

/// Surveys as a real unit hears them.
pub(super) fn field() -> Vec<Judged> {
    let judged = |scene| Judged {
        scene,
        dive: DiveKind::Survey,
        noise: NoiseLevel::Field,
        targets: with(
            errors([0.060, 1.0], [0.030, 0.4]),
            &[false_share(0.005, 0.0)],
        ),
    };
    ["fence", "wall", "pier", "pipeline"].map(judged).into()
}

/// Scenes that no setting was chosen on, judged like the most similar row.
pub(super) fn own() -> Vec<Judged> {
    let judged = |scene, targets| Judged {
        scene,
        dive: DiveKind::Survey,
        noise: NoiseLevel::Nominal,
        targets,
    };
    vec![
        judged("lander", fence_like()),
        judged("dolphin", structure(OTHERS)),
        judged(
            "quay-corner",
            with(structure(OTHERS), &[normals(), seabed_normals()]),
        ),
    ]
}

fn fence_like() -> Vec<Target> {
    errors([0.030, 0.31], [0.020, 0.20])
}

/// CD and HD of scenes that no limit was measured for.
const OTHERS: [f64; 2] = [0.12, 1.5];

fn structure(must: [f64; 2]) -> Vec<Target> {
    with(errors(must, [0.020, 0.20]), &[false_share(0.03, 0.005)])
}

/// Dives that leave elevation open.
fn blind() -> Vec<Target> {
    let none_false = Target {
        quantity: "confident-false Gaussians",
        unit: Unit::Count,
        must: Some(Limit::AtMost(0.0)),
        aim: Some(0.0),
        ..shown(|o| first(o).metrics.confident_false_count as f64)
    };
    let covered = Target {
        quantity: "seen truth near an ambiguous Gaussian",
        unit: Unit::Share,
        must: Some(Limit::ShareAtLeast(0.9)),
        ..shown(|o| first(o).metrics.ambiguous_cover_share)
    };
    vec![none_false, covered]
}

fn nothing() -> Target {
    Target {
        quantity: "Gaussians, confident and ambiguous",
        unit: Unit::Count,
        must: Some(Limit::AtMost(0.0)),
        aim: Some(0.0),
        ..shown(|o| {
            let metrics = first(o).metrics;
            (metrics.confident_count + metrics.ambiguous_count + metrics.left_out_count) as f64
        })
    }
}

/// CD and HD.
fn errors([must_cd, must_hd]: [f64; 2], [aim_cd, aim_hd]: [f64; 2]) -> Vec<Target> {
    let hd = Target {
        quantity: "HD",
        must: Some(Limit::AtMost(must_hd)),
        aim: Some(aim_hd),
        ..shown(|o| first(o).metrics.hd_m)
    };
    vec![cd(must_cd, aim_cd), hd]
}

fn printed(errors: Vec<Target>, figures: [f64; 2]) -> Vec<Target> {
    let with_figure = |(target, figure)| Target {
        paper: Some(figure),
        ..target
    };
    errors.into_iter().zip(figures).map(with_figure).collect()
}

fn cd(must: f64, aim: f64) -> Target {
    Target {
        quantity: "CD",
        must: Some(Limit::AtMost(must)),
        aim: Some(aim),
        ..shown(|o| first(o).metrics.cd_m)
    }
}

fn false_share(must: f64, aim: f64) -> Target {
    Target {
        quantity: "confident-false",
        unit: Unit::Share,
        must: Some(Limit::AtMost(must)),
        aim: Some(aim),
        ..shown(|o| first(o).metrics.confident_false_share)
    }
}

/// Of the structure where there is a seabed.
fn normals() -> Target {
    Target {
        quantity: "normals within 20°",
        unit: Unit::Share,
        must: Some(Limit::ShareAtLeast(NORMALS_SHARE)),
        ..shown(|o| {
            let metrics = first(o).metrics;
            let own = metrics
                .seabed
                .map_or(metrics.normals, |_| metrics.structure_normals);
            own.map_or(0.0, |normals| normals.within_20deg_share)
        })
    }
}

fn seabed_normals() -> Target {
    Target {
        quantity: "seabed's normals within 20°",
        unit: Unit::Share,
        must: Some(Limit::ShareAtLeast(NORMALS_SHARE)),
        ..shown(|o| {
            let normals = first(o).metrics.seabed_normals;
            normals.map_or(0.0, |normals| normals.within_20deg_share)
        })
    }
}

fn memory(must_mb: f64, aim_mb: f64) -> Target {
    Target {
        quantity: "peak memory",
        unit: Unit::Megabytes,
        must: Some(Limit::AtMost(must_mb)),
        aim: Some(aim_mb),
        ..shown(|o| first(o).peak_memory_bytes as f64 * 1e-6)
    }
}

/// The only run; a case without runs has no values.
fn first<'a>(outcomes: &[&'a Outcome]) -> &'a Outcome {
    outcomes[0]
}

/// In metres, without anything asked.
fn shown(value: fn(&[&Outcome]) -> f64) -> Target {
    Target {
        quantity: "",
        unit: Unit::Metres,
        paper: None,
        must: None,
        aim: None,
        value,
    }
}

fn with(mut targets: Vec<Target>, more: &[Target]) -> Vec<Target> {
    targets.extend_from_slice(more);
    targets
}
