//! Which runs, and what was thinned so that they fit their time.

use echosplat_simulator::{DiveKind, NoiseLevel};

use crate::arguments::ReportPart;
use crate::error_time::{self, Line};
use crate::noise_sweep::{self, Level};
use crate::runs::Spec;
use crate::targets::{self, Case, FEW_TENTHS, Section};

/// Of surveys of the four scenes; all else has the first.
const SEEDS: [u64; 3] = [1, 2, 3];
/// Scenes that everything was tried on, at three levels of noise.
const SCENES: [&str; 4] = ["fence", "wall", "pier", "pipeline"];
/// Dives whose map is watched by all methods.
const WATCHED: [&str; 3] = [
    "fence, survey, nominal",
    "fence, viewpoints, none",
    "pier, survey, nominal",
];
const LONGER_SCENES: [&str; 2] = ["fence", "pier"];
/// One, two and four times a survey; the first is the default's.
const LENGTHS_S: [Option<f64>; 3] = [None, Some(480.0), Some(960.0)];
const QUICK_S: f64 = 20.0;

/// A case of the targets and its seeds.
#[derive(Debug, Clone)]
pub(crate) struct Asked {
    pub(super) part: ReportPart,
    pub(super) case: Case,
    pub(super) seeds: Vec<u64>,
}

impl Asked {
    fn new(part: ReportPart, case: Case) -> Self {
        let is_survey = case
            .runs(1)
            .iter()
            .all(|spec| spec.dive == DiveKind::Survey);
        let has_seeds = part != ReportPart::Live
            && case.section != Section::Shift
            && is_survey
            && SCENES.contains(&case.scene);
        Self {
            part,
            case,
            seeds: if has_seeds {
                SEEDS.into()
            } else {
                vec![SEEDS[0]]
            },
        }
    }
}

/// All runs.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    pub(super) asked: Vec<Asked>,
    pub(super) levels: Vec<Level>,
    pub(super) watched: Vec<error_time::Case>,
    pub(super) length: Vec<Spec>,
    /// In sentences.
    pub(super) thinned: Vec<String>,
    /// Short dives, of which nothing is asked.
    pub(super) is_quick: bool,
}

impl Plan {
    /// The whole, or a little of each part.
    #[must_use]
    pub(crate) fn new(quick: bool) -> Self {
        if quick { Self::quick() } else { Self::whole() }
    }

    fn whole() -> Self {
        let asked = targets::cases().into_iter().filter_map(|case| {
            let part = match case.section {
                Section::Accuracy | Section::Field | Section::Own | Section::Shift => {
                    ReportPart::Accuracy
                }
                Section::Certainty => ReportPart::Sigma,
                _ => return None,
            };
            Some(Asked::new(part, case))
        });
        let live = ["fence", "wall", "pier"];
        let live = live.map(|scene| targets::live_case(scene, &FEW_TENTHS));
        let live = live.map(|case| Asked::new(ReportPart::Live, case));
        let watched = error_time::cases(false).into_iter();
        let watched = watched.filter(|case| WATCHED.contains(&case.name().as_str()));
        let longer = LONGER_SCENES
            .iter()
            .flat_map(|scene| LENGTHS_S.map(|duration_s| survey(scene, duration_s)));
        Self {
            asked: asked.chain(live).collect(),
            levels: noise_sweep::levels(false),
            watched: watched.map(few_lines).collect(),
            length: longer.collect(),
            thinned: thinned(),
            is_quick: false,
        }
    }

    fn quick() -> Self {
        let short = Some(QUICK_S);
        let fence = targets::cases()
            .into_iter()
            .find(|case| case.section == Section::Accuracy && case.name == WATCHED[0]);
        let live = targets::live_case("fence", &FEW_TENTHS);
        let asked = fence.map(|case| Asked {
            seeds: vec![SEEDS[0]],
            ..Asked::new(ReportPart::Accuracy, case.lasting(short))
        });
        let live = Asked::new(ReportPart::Live, live.lasting(short));
        let levels = noise_sweep::levels(true).into_iter().take(1);
        Self {
            asked: asked.into_iter().chain([live]).collect(),
            levels: levels.collect(),
            watched: error_time::cases(true).into_iter().take(1).collect(),
            length: [1.0, 2.0]
                .map(|times| survey("fence", Some(QUICK_S * times)))
                .into(),
            thinned: vec![
                "--quick: short dives of one scene; no figure of it is the version's.".to_owned(),
            ],
            is_quick: true,
        }
    }

    /// Whether maps of this scene say how sure maps are.
    #[must_use]
    pub(super) fn is_pooled(&self, scene: &str) -> bool {
        SCENES.contains(&scene)
    }

    /// Those of a part, some of which others have as well.
    #[must_use]
    pub(crate) fn specs(&self, part: ReportPart) -> Vec<Spec> {
        let seed = SEEDS[0];
        match part {
            ReportPart::Accuracy | ReportPart::Sigma | ReportPart::Live => {
                let own = self.asked.iter().filter(|asked| asked.part == part);
                let of = |asked: &Asked| -> Vec<Spec> {
                    let seeds = asked.seeds.iter();
                    seeds.flat_map(|seed| asked.case.runs(*seed)).collect()
                };
                own.flat_map(of).collect()
            }
            ReportPart::Noise => self.levels.iter().map(|level| level.spec(seed)).collect(),
            ReportPart::ErrorTime => {
                let cases = self.watched.iter();
                cases.flat_map(|case| case.specs(seed, seed)).collect()
            }
            ReportPart::Length => self.length.clone(),
        }
    }
}

fn survey(scene: &str, duration_s: Option<f64>) -> Spec {
    Spec {
        duration_s,
        ..Spec::new(scene, DiveKind::Survey, NoiseLevel::Nominal, SEEDS[0])
    }
}

/// Without dives cut short, which the live part has, and without more passes.
fn few_lines(mut case: error_time::Case) -> error_time::Case {
    case.lines
        .retain(|line| !matches!(line, Line::Cut | Line::MorePasses));
    case
}

fn thinned() -> Vec<String> {
    [
        "Surveys of fence, wall, pier and pipeline have seeds 1 to 3, all else seed 1; five are asked for.",
        "Live maps are held against dives cut at 30, 50 and 70 %, of three scenes at nominal noise.",
        "Error against time is of three dives; the paper's method is of the fence without noise, and not of the truss.",
        "Single features, settings, numbers of threads, frames, more pings and more work have benches of their own: \
         `bench ablation`, `error-time`, `targets`; two hours have `bench long`.",
        "Latency, decoding and the whole service's speed are not measured here, and neither are dives of another \
         simulator.",
    ]
    .map(str::to_owned)
    .into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;

    fn all(plan: &Plan) -> Vec<Spec> {
        let parts = ReportPart::value_variants().iter();
        let mut specs: Vec<Spec> = parts.flat_map(|part| plan.specs(*part)).collect();
        let mut seen = std::collections::BTreeSet::new();
        specs.retain(|spec| seen.insert(spec.name()));
        specs
    }

    #[test]
    fn every_part_has_runs_and_all_of_them_fit_ninety_minutes_on_two_cores() {
        for quick in [false, true] {
            let plan = Plan::new(quick);
            for part in ReportPart::value_variants() {
                let is_there = !plan.specs(*part).is_empty();
                assert!(
                    is_there || (quick && *part == ReportPart::Sigma),
                    "{part:?}"
                );
            }
        }
        let expected_s: f64 = all(&Plan::new(false)).iter().map(Spec::expected_s).sum();
        // Some of it is for what takes longer than expected.
        assert!(expected_s < 0.95 * 2.0 * 90.0 * 60.0, "{expected_s}");
        let quick_s: f64 = all(&Plan::new(true)).iter().map(Spec::expected_s).sum();
        assert!(quick_s < 300.0, "{quick_s}");
    }

    #[test]
    fn surveys_of_the_four_scenes_have_three_seeds_at_each_noise() {
        let specs = all(&Plan::new(false));
        for scene in SCENES {
            for noise in [NoiseLevel::Nominal, NoiseLevel::Field, NoiseLevel::Harsh] {
                for seed in SEEDS {
                    let wanted = Spec::new(scene, DiveKind::Survey, noise, seed);
                    assert!(specs.contains(&wanted), "{}", wanted.name());
                }
            }
        }
        let of_truss = specs.iter().filter(|spec| spec.scene == "truss");
        assert_eq!(of_truss.count(), 1);
    }
}
