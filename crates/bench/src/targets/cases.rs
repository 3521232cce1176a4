//! All that is run and judged.

use echosplat_mapper::MapperConfig;
use echosplat_simulator::{DiveKind, NoiseLevel};
use glam::DVec3;

use super::accuracy::{self, Judged};
use super::limit::{Limit, Row, Target, Unit};
use super::live::{self, worst};
use super::sections::Section;
use crate::runs::{Method, Outcome, Outcomes, Placement, Spec};
use echosplat_metrics::Certainty;
use echosplat_prediction::held_out::HeldOut;

/// Runs of one seed that are judged together.
#[derive(Debug, Clone)]
pub(crate) struct Case {
    /// Where it belongs.
    pub(crate) section: Section,
    /// Unique within its section.
    pub(crate) name: String,
    /// Name of its scene.
    pub(crate) scene: &'static str,
    /// Whether it is worth a quick look.
    pub(crate) is_quick: bool,
    /// Whether its maps are compared with one another and so have to be kept.
    pub(crate) compares_maps: bool,
    /// The runs of a seed differ from its first seed's in nothing but the seed.
    runs: Vec<Spec>,
    targets: Vec<Target>,
}

impl Case {
    /// Its runs, in the order in which values are made of them.
    #[must_use]
    pub(crate) fn runs(&self, seed: u64) -> Vec<Spec> {
        let of_seed = |spec: &Spec| Spec {
            seed,
            ..spec.clone()
        };
        self.runs.iter().map(of_seed).collect()
    }

    /// The same of dives of another length; the default's without.
    #[must_use]
    pub(crate) fn lasting(mut self, duration_s: Option<f64>) -> Self {
        for spec in &mut self.runs {
            spec.duration_s = duration_s;
        }
        self
    }

    /// A row for each of its targets.
    #[must_use]
    pub(crate) fn rows(&self, seeds: &[u64], results: &Outcomes) -> Vec<Row> {
        let runs: Vec<Vec<Spec>> = seeds.iter().map(|seed| self.runs(*seed)).collect();
        let section = self.section.as_str();
        let row = |target| Row::judge(section, &self.name, target, &runs, results);
        self.targets.iter().map(row).collect()
    }
}

/// All cases, in the order in which they are run: those that take long come last.
#[must_use]
pub(crate) fn cases() -> Vec<Case> {
    let of_maps = |section, table: Vec<Judged>| table.into_iter().map(move |j| of_map(section, j));
    let mut cases: Vec<Case> = of_maps(Section::Accuracy, accuracy::table()).collect();
    cases.extend(of_maps(Section::Field, accuracy::field()));
    cases.extend(certainties());
    cases.push(shift());
    cases.extend(["fence", "wall", "pier"].map(more));
    cases.extend(["fence", "wall", "pier"].map(|scene| live::case(scene, &live::TENTHS)));
    cases.push(length());
    cases.push(memory());
    cases.push(threads());
    cases.extend(frames());
    cases.extend(heard_again());
    cases.extend(of_maps(Section::Own, accuracy::own()));
    cases.extend(papers());
    cases.extend(work());
    cases
}

fn of_map(section: Section, judged: Judged) -> Case {
    let Judged {
        scene,
        dive,
        noise,
        targets,
    } = judged;
    let is_quick = section == Section::Accuracy
        && noise == NoiseLevel::Nominal
        && matches!(dive, DiveKind::Survey | DiveKind::Pan)
        && matches!(scene, "empty" | "fence");
    Case {
        section,
        name: format!("{scene}, {dive}, {noise}"),
        scene,
        is_quick,
        compares_maps: false,
        runs: vec![Spec::new(scene, dive, noise, 0)],
        targets,
    }
}

pub(super) fn survey(scene: &str) -> Spec {
    Spec::new(scene, DiveKind::Survey, NoiseLevel::Nominal, 0)
}

pub(super) fn case(
    section: Section,
    scene: &'static str,
    runs: Vec<Spec>,
    targets: Vec<Target>,
) -> Case {
    Case {
        section,
        name: format!("{scene}, survey, nominal"),
        scene,
        is_quick: false,
        compares_maps: false,
        runs,
        targets,
    }
}

pub(super) fn target(quantity: &'static str, unit: Unit, value: fn(&[&Outcome]) -> f64) -> Target {
    Target {
        quantity,
        unit,
        paper: None,
        must: None,
        aim: None,
        value,
    }
}

/// Surveys at one level of noise after the other, and all of them.
fn certainties() -> Vec<Case> {
    let surveys = |noise| {
        let scenes = ["fence", "wall", "pier", "pipeline"];
        scenes.map(|scene| Spec::new(scene, DiveKind::Survey, noise, 0))
    };
    let levels = [NoiseLevel::Nominal, NoiseLevel::Field, NoiseLevel::Harsh];
    let of_sigma = |noise: NoiseLevel| Case {
        name: format!("four scenes, survey, {noise}"),
        ..case(
            Section::Certainty,
            "fence",
            surveys(noise).into(),
            sigma_targets(),
        )
    };
    let off = Target {
        must: Some(Limit::AtMost(0.05)),
        ..target("probability off, most of ten groups", Unit::Share, |o| {
            pooled(o).map_or(f64::NAN, |c| c.worst_probability_error(LEAST_GROUP))
        })
    };
    let all = Case {
        name: "four scenes, survey, all three".to_owned(),
        ..case(
            Section::Certainty,
            "fence",
            levels.iter().flat_map(|&noise| surveys(noise)).collect(),
            vec![off],
        )
    };
    levels
        .iter()
        .map(|&noise| of_sigma(noise))
        .chain([all])
        .collect()
}

/// Fewer Gaussians do not tell how often there is surface.
const LEAST_GROUP: usize = 300;

fn sigma_targets() -> Vec<Target> {
    let outside = |o: &[&Outcome]| pooled(o).map_or(f64::NAN, |c| 1.0 - c.within_two_sigma_share);
    let ratio = |o: &[&Outcome]| pooled(o).map_or(f64::NAN, |c| c.worst_sigma_ratio());
    vec![
        Target {
            must: Some(Limit::AtMost(0.10)),
            ..target("further than two sigma", Unit::Share, outside)
        },
        Target {
            must: Some(Limit::AtLeast(0.01)),
            ..target("further than two sigma, at least", Unit::Share, outside)
        },
        Target {
            must: Some(Limit::RatioAtMost(1.5)),
            ..target("error over sigma, worst tenth", Unit::Ratio, ratio)
        },
    ]
}

/// Of all these maps; `None` if one of them says nothing.
fn pooled(outcomes: &[&Outcome]) -> Option<Certainty> {
    let each: Option<Vec<&Certainty>> = outcomes.iter().map(|o| o.certainty.as_ref()).collect();
    Certainty::pooled(&each?)
}

fn shift() -> Case {
    let shifted = Spec {
        time_offset_s: 1.0,
        ..survey("fence")
    };
    let ratio = |o: &[&Outcome]| o[1].metrics.cd_m / o[0].metrics.cd_m;
    let worse = Target {
        must: Some(Limit::AtLeast(3.0)),
        ..target("times the CD, poses 1 s off", Unit::Ratio, ratio)
    };
    case(
        Section::Shift,
        "fence",
        vec![survey("fence"), shifted],
        vec![worse],
    )
}

/// Of the dive, the last of them all of it.
const SHARES: [f64; 4] = [0.25, 0.5, 0.75, 1.0];

fn more(scene: &'static str) -> Case {
    let part = |share| Spec {
        share,
        ..survey(scene)
    };
    let lost = Target {
        must: Some(Limit::AtMost(0.02)),
        aim: Some(0.0),
        ..target("precision at 10 cm lost", Unit::Share, |o| {
            most_lost(
                &o.iter()
                    .map(|o| o.metrics.precision_10cm)
                    .collect::<Vec<_>>(),
            )
        })
    };
    let precision = |quantity, value| target(quantity, Unit::Share, value);
    let targets = vec![
        lost,
        precision("precision at 10 cm, first 25 %", |o| {
            o[0].metrics.precision_10cm
        }),
        precision("precision at 10 cm, first 50 %", |o| {
            o[1].metrics.precision_10cm
        }),
        precision("precision at 10 cm, first 75 %", |o| {
            o[2].metrics.precision_10cm
        }),
        precision("precision at 10 cm, whole dive", |o| {
            o[3].metrics.precision_10cm
        }),
    ];
    case(Section::More, scene, SHARES.map(part).into(), targets)
}

/// From any value to any later one, at least 0.
fn most_lost(values: &[f64]) -> f64 {
    let mut best = f64::NEG_INFINITY;
    values.iter().fold(0.0, |lost: f64, &value| {
        best = best.max(value);
        lost.max(best - value)
    })
}

const WORK: &str = "mapper.work_pairs_per_ping";

/// Each dive with a third of the default's work, the default's, and more and more.
fn work() -> Vec<Case> {
    let default = MapperConfig::default().work_pairs_per_ping;
    let truss = Spec::new("truss", DiveKind::Viewpoints, NoiseLevel::None, 0);
    let dives = [
        ("fence", survey("fence"), "fence, survey, nominal"),
        ("pier", survey("pier"), "pier, survey, nominal"),
        ("truss", truss, "truss, viewpoints, none"),
    ];
    let with = |dive: &Spec, pairs: u64| match pairs == default {
        true => dive.clone(),
        false => dive.clone().with(WORK, &pairs.to_string()),
    };
    let budgets = [default / 3, default, 2 * default, 4 * default, 8 * default];
    let case_of = |(scene, dive, name): (&'static str, Spec, &str)| Case {
        name: name.to_owned(),
        ..case(
            Section::Work,
            scene,
            budgets.map(|pairs| with(&dive, pairs)).into(),
            work_targets(),
        )
    };
    dives.map(case_of).into()
}

fn work_targets() -> Vec<Target> {
    let never = |quantity, most, value| Target {
        must: Some(Limit::AtMost(most)),
        aim: Some(0.0),
        ..target(quantity, Unit::Share, value)
    };
    let ratio = |quantity, value| target(quantity, Unit::Ratio, value);
    vec![
        never("CD grown with more work", 0.02, |o| {
            most_grown(&of_more(o, |o| o.metrics.cd_m), |from, to| to / from - 1.0)
        }),
        never("confident-false grown with more work", 0.001, |o| {
            let shares = of_more(o, |o| o.metrics.confident_false_share);
            most_grown(&shares, |from, to| to - from)
        }),
        ratio("CD with a third of the work, over the default's", |o| {
            o[0].metrics.cd_m / o[1].metrics.cd_m
        }),
        ratio("mid-dive CD with a third, over the default's", |o| {
            o[0].mid_dive_cd_m / o[1].mid_dive_cd_m
        }),
    ]
}

/// From the default's work on.
fn of_more(outcomes: &[&Outcome], value: fn(&Outcome) -> f64) -> Vec<f64> {
    outcomes[1..].iter().map(|outcome| value(outcome)).collect()
}

/// From any value to any later one, at least 0.
fn most_grown(values: &[f64], growth: fn(f64, f64) -> f64) -> f64 {
    let later = |from: usize| {
        values[from + 1..]
            .iter()
            .map(move |to| growth(values[from], *to))
    };
    worst((0..values.len()).flat_map(later).chain([0.0]))
}

fn memory() -> Case {
    let forgetful = survey("fence").with("mapper.history_pings", "1024");
    let as_good = Target {
        must: Some(Limit::RatioAtMost(1.2)),
        aim: Some(1.0),
        ..target("CD over that with all remembered", Unit::Ratio, |o| {
            o[0].metrics.cd_m / o[1].metrics.cd_m
        })
    };
    Case {
        name: "fence, survey, nominal, 1024 pings remembered".to_owned(),
        ..case(
            Section::Length,
            "fence",
            vec![forgetful, survey("fence")],
            vec![as_good],
        )
    }
}

fn length() -> Case {
    // The default's length is left to the default, so that its run serves other cases too.
    let lengths = [Some(60.0), Some(120.0), None, Some(480.0)];
    let of_length = |duration_s| Spec {
        duration_s,
        ..survey("fence")
    };
    let flat = Target {
        must: Some(Limit::AtMost(0.1)),
        ..target("work per ping, most over least minus 1", Unit::Share, |o| {
            spread(&o.iter().map(|o| streamed(o)).collect::<Vec<_>>())
        })
    };
    let work = |quantity, value| target(quantity, Unit::Count, value);
    let seconds = |quantity, value| target(quantity, Unit::Seconds, value);
    let targets = vec![
        flat,
        work("work per ping, 60 s", |o| streamed(o[0])),
        work("work per ping, 120 s", |o| streamed(o[1])),
        work("work per ping, 240 s", |o| streamed(o[2])),
        work("work per ping, 480 s", |o| streamed(o[3])),
        work("of the finish per ping, 60 s", |o| finish(o[0])),
        work("of the finish per ping, 120 s", |o| finish(o[1])),
        work("of the finish per ping, 240 s", |o| finish(o[2])),
        work("of the finish per ping, 480 s", |o| finish(o[3])),
        seconds("compute before the finish, 480 s", |o| {
            o[3].streamed.compute_s
        }),
        seconds("compute of the finish, 480 s", |o| {
            o[3].total.compute_s - o[3].streamed.compute_s
        }),
    ];
    case(
        Section::Length,
        "fence",
        lengths.map(of_length).into(),
        targets,
    )
}

/// Counted work per ping without the finish.
fn streamed(outcome: &Outcome) -> f64 {
    let work = outcome.streamed;
    (work.voxel_observations + work.pairs) as f64 / outcome.pings as f64
}

fn finish(outcome: &Outcome) -> f64 {
    let (all, before) = (outcome.total, outcome.streamed);
    let work = all.voxel_observations + all.pairs - before.voxel_observations - before.pairs;
    work as f64 / outcome.pings as f64
}

/// Surfaces from half a metre above the dive to where their images are out of range, copies and multiples.
fn heard_again() -> [Case; 3] {
    let disturbed = |pairs: Vec<String>| Spec {
        disturbances: pairs,
        ..survey("fence")
    };
    let surfaces = (3..19).map(|halves| vec![format!("surface_m={}", 0.5 * f64::from(halves))]);
    let copies = [0.3, 0.5, 0.8, 1.3, 2.0, 3.0].into_iter().flat_map(|m| {
        [6, 13, 20].map(|db| vec![format!("copy_offset_m={m}"), format!("copy_db={db}")])
    });
    let multiples = [1.3, 1.6, 1.8, 2.0, 2.5, 3.0]
        .into_iter()
        .flat_map(|ratio| {
            [6, 15].map(|db| {
                vec![
                    format!("multiple_ratio={ratio}"),
                    format!("multiple_db={db}"),
                ]
            })
        });
    let targets = || {
        vec![
            Target {
                must: Some(Limit::AtMost(0.01)),
                aim: Some(0.0),
                ..target("confident-false, worst", Unit::Share, |o| {
                    worst(o.iter().map(|o| o.metrics.confident_false_share))
                })
            },
            target("CD, worst", Unit::Metres, |o| {
                worst(o.iter().map(|o| o.metrics.cd_m))
            }),
        ]
    };
    let sweep = |name: &str, runs: Vec<Spec>| Case {
        name: format!("fence, survey, nominal, {name}"),
        ..case(Section::Again, "fence", runs, targets())
    };
    [
        sweep("16 surfaces", surfaces.map(disturbed).collect()),
        sweep("18 copies", copies.map(disturbed).collect()),
        sweep("12 multiples", multiples.map(disturbed).collect()),
    ]
}

/// Not a number without values, or if one is not above 0.
fn spread(values: &[f64]) -> f64 {
    let most = values.iter().copied().fold(f64::NAN, f64::max);
    let least = values.iter().copied().fold(f64::NAN, f64::min);
    match least > 0.0 {
        true => most / least - 1.0,
        false => f64::NAN,
    }
}

fn threads() -> Case {
    let on_two = Spec {
        threads: 2,
        ..survey("fence")
    };
    let differ = |o: &[&Outcome]| f64::from(u8::from(o[0].fingerprint != o[1].fingerprint));
    let same = Target {
        must: Some(Limit::AtMost(0.0)),
        ..target("maps that differ, 1 and 2 threads", Unit::Count, differ)
    };
    case(
        Section::Threads,
        "fence",
        vec![survey("fence"), on_two],
        vec![same],
    )
}

fn frames() -> Vec<Case> {
    let turned = [10.0, 33.0, 77.0].map(|yaw_deg| Placement {
        yaw_deg,
        shift_m: DVec3::ZERO,
    });
    let far = Placement {
        yaw_deg: 0.0,
        shift_m: DVec3::new(1e7, -1e7, 0.0),
    };
    let apart = Target {
        must: Some(Limit::AtMost(0.005)),
        ..target("distance between the maps", Unit::Millimetres, |o| {
            o[0].from_unmoved_m.unwrap_or(f64::NAN)
        })
    };
    let frame = |(name, placement): (String, Placement)| {
        let elsewhere = Spec {
            placement,
            ..survey("fence")
        };
        let runs = vec![elsewhere, survey("fence")];
        Case {
            name: format!("fence, {name}"),
            compares_maps: true,
            ..case(Section::Frames, "fence", runs, vec![apart])
        }
    };
    let mut placements = vec![("moved by 10⁷ m in x and y".to_owned(), far)];
    placements.extend(turned.map(|turn| (format!("turned by {}°", turn.yaw_deg), turn)));
    placements.into_iter().map(frame).collect()
}

/// Moments at which it is asked whether the mapper has got as far as the paper's method.
const PAPER_MOMENTS: usize = 12;

/// The mapper's run first, then the paper's.
fn papers() -> Vec<Case> {
    let both = |scene, noise, more: &[Target]| {
        let ours = Spec {
            moments: PAPER_MOMENTS,
            held_out: true,
            ..Spec::new(scene, DiveKind::Viewpoints, noise, 0)
        };
        let papers = Spec {
            method: Method::Paper,
            moments: 0,
            ..ours.clone()
        };
        let mut targets = more.to_vec();
        targets.extend(foretold());
        Case {
            name: format!("{scene}, viewpoints, {noise}"),
            ..case(Section::Paper, scene, vec![ours, papers], targets)
        }
    };
    let sooner = Target {
        must: Some(Limit::AtLeast(50.0)),
        ..target("paper's compute over ours for its CD", Unit::Ratio, |o| {
            o[1].total.compute_s / until(o[0], o[1].metrics.cd_m)
        })
    };
    let apart = target("paper's CD over ours", Unit::Ratio, |o| {
        o[1].metrics.cd_m / o[0].metrics.cd_m
    });
    vec![
        both("fence", NoiseLevel::None, &[sooner, apart]),
        both("truss", NoiseLevel::None, &[sooner, apart]),
        both("fence", NoiseLevel::Nominal, &[]),
        both("wall", NoiseLevel::Nominal, &[]),
        both("pier", NoiseLevel::Nominal, &[]),
        both("pipeline", NoiseLevel::Nominal, &[]),
    ]
}

/// Processor seconds until a map has this CD; infinite if none ever had.
fn until(outcome: &Outcome, cd_m: f64) -> f64 {
    let live = outcome.samples.iter();
    let live = live.map(|sample| (sample.metrics.cd_m, sample.compute_s));
    let all = live.chain([(outcome.metrics.cd_m, outcome.total.compute_s)]);
    let mut reached = all.filter(|(reached_m, _)| *reached_m <= cd_m);
    reached
        .next()
        .map_or(f64::INFINITY, |(_, compute_s)| compute_s)
}

/// How likely pings are that no map was made of.
fn foretold() -> [Target; 2] {
    let above = |quantity, value| Target {
        must: Some(Limit::AtLeast(0.0)),
        ..target(quantity, Unit::Nats, value)
    };
    [
        above("likelihood per bin over the paper's map", |o| {
            likelihood(o[0], |found| found.map.log_likelihood_per_bin)
                - likelihood(o[1], |found| found.map.log_likelihood_per_bin)
        }),
        above("likelihood per bin over a constant", |o| {
            likelihood(o[0], |found| found.gain_per_bin)
        }),
    ]
}

/// Not a number where nothing was scored.
fn likelihood(outcome: &Outcome, of: fn(&HeldOut) -> f64) -> f64 {
    outcome.held_out.as_ref().map_or(f64::NAN, of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_simulator::BUILT_IN_SCENES;

    #[test]
    fn every_row_of_every_case_is_there_once() {
        let cases = cases();
        let mut names: Vec<(&str, String)> = cases
            .iter()
            .map(|case| (case.section.as_str(), case.name.clone()))
            .collect();
        names.sort();
        let count = names.len();
        names.dedup();
        assert_eq!(names.len(), count);
        for section in Section::ALL {
            assert!(cases.iter().any(|case| case.section == section));
        }
        assert!(cases.iter().all(|case| !case.targets.is_empty()));
        assert!(cases.iter().any(|case| case.is_quick));
        for case in &cases {
            let known = BUILT_IN_SCENES.iter().any(|(name, _)| *name == case.scene);
            assert!(known, "{}", case.scene);
            assert!(case.runs(7).iter().all(|spec| spec.seed == 7));
        }
    }

    #[test]
    fn without_runs_every_row_is_incomplete() {
        use crate::targets::Verdict;
        let rows = cases()
            .into_iter()
            .flat_map(|case| case.rows(&[1], &Outcomes::default()));
        let rows: Vec<Row> = rows.collect();
        assert!(rows.len() > 40);
        assert!(rows.iter().all(|row| row.verdict == Verdict::Incomplete));
    }

    #[test]
    fn a_map_that_never_gets_there_takes_for_ever() {
        let ours = Outcome {
            samples: echosplat_metrics::sample::run("", 1, 3.0, 4).samples,
            ..crate::runs::sample_outcome(0.01, 50_000_000)
        };
        let soonest = ours.samples.iter().map(|sample| sample.compute_s);
        let soonest = soonest.fold(f64::INFINITY, f64::min);
        assert!((until(&ours, f64::INFINITY) - soonest).abs() < 1e-12);
        assert!((until(&ours, 0.01) - 50.0).abs() < 1e-9);
        assert!(until(&ours, 0.009).is_infinite());
    }

    #[test]
    fn what_was_lost_on_the_way_is_not_forgotten() {
        assert!((most_lost(&[0.5, 0.9, 0.88, 0.87]) - 0.03).abs() < 1e-12);
        assert!(most_lost(&[0.1, 0.2, 0.3]).abs() < 1e-300);
    }

    #[test]
    fn growth_is_from_any_budget_to_any_greater_one() {
        let by_share = |from: f64, to: f64| to / from - 1.0;
        assert!((most_grown(&[1.0, 0.5, 0.6, 0.55], by_share) - 0.2).abs() < 1e-12);
        assert!(most_grown(&[1.0, 0.9, 0.8], by_share).abs() < 1e-300);
        assert!(most_grown(&[f64::INFINITY; 2], by_share).is_nan());
        let runs = work()[0].runs(1);
        let third = MapperConfig::default().work_pairs_per_ping / 3;
        assert!(runs[1].is_plain() && runs[0].settings[WORK] == third.to_string());
    }

    #[test]
    fn a_spread_of_nothing_is_no_number() {
        assert!((spread(&[100.0, 110.0, 105.0]) - 0.1).abs() < 1e-12);
        assert!(spread(&[]).is_nan() && spread(&[0.0, 1.0]).is_nan());
    }
}
