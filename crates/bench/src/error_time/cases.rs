//! Which dives, and by which methods.

use echosplat_simulator::{DiveKind, NoiseLevel};
use serde::Serialize;

use super::omission::Omission;
use crate::runs::{Method, Outcome, Outcomes, Spec, dive_name};
use echosplat_metrics::curve::{Curve, Sample};

/// Moments of a dive at which its map is judged.
const MOMENTS: usize = 12;
const QUICK_MOMENTS: usize = 8;
const QUICK_DIVE_S: f64 = 30.0;
/// A dive is cut at so many moments and ended there, each half as long as the next; the last of them is
/// the whole.
const CUTS: i32 = 6;
/// Of the finish with more passes: three times the default's, and four times the work.
const MORE_PASSES: [(&str, &str); 2] = [
    ("mapper.workout_passes", "48"),
    ("mapper.workout_pairs", "24_000_000_000"),
];

/// What is drawn as one curve over the seeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Line {
    /// Support from M views: the paper's first Gaussians.
    Support,
    /// Carving by hit ratio.
    Carving,
    /// The paper's method whole, as its epochs go by.
    Paper,
    /// The live map as the dive goes on.
    Online,
    /// The finished maps of the dive cut at some moments and ended there.
    Cut,
    /// The finished map.
    Finished,
    /// The finished map, with more passes of the finish.
    MorePasses,
}

impl Line {
    /// In the order of legends and tables.
    pub(crate) const ALL: [Self; 7] = [
        Self::Support,
        Self::Carving,
        Self::Paper,
        Self::Online,
        Self::Cut,
        Self::Finished,
        Self::MorePasses,
    ];

    /// As in reports.
    #[must_use]
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Support => "support from M views",
            Self::Carving => "hit-ratio carving",
            Self::Paper => "paper",
            Self::Online => "online",
            Self::Cut => "online, cut there and ended",
            Self::Finished => "online finished",
            Self::MorePasses => "online finished, more passes",
        }
    }

    fn method(self) -> Method {
        match self {
            Self::Support => Method::Support,
            Self::Carving => Method::Carving,
            Self::Paper => Method::Paper,
            Self::Online | Self::Cut | Self::Finished | Self::MorePasses => Method::Online,
        }
    }

    /// The moments of a run that it draws.
    fn samples(self, outcome: &Outcome) -> Vec<Sample> {
        match self {
            Self::Cut | Self::Finished | Self::MorePasses => vec![finished(outcome)],
            _ => outcome.samples.clone(),
        }
    }
}

fn finished(outcome: &Outcome) -> Sample {
    Sample {
        dive_s: outcome.dive_s,
        compute_s: outcome.total.compute_s,
        pair_count: outcome.total.pairs,
        voxel_observations: outcome.total.voxel_observations,
        ping_count: outcome.pings,
        metrics: outcome.metrics,
    }
}

/// A dive, by all methods that can take it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Case {
    /// A built-in scene.
    pub(crate) scene: &'static str,
    /// How the sonar moves.
    pub(crate) dive: DiveKind,
    /// What is wrong with pings and poses.
    pub(crate) noise: NoiseLevel,
    /// What is drawn.
    pub(crate) lines: Vec<Line>,
    duration_s: Option<f64>,
    moments: usize,
}

impl Case {
    /// Unique.
    #[must_use]
    pub(crate) fn name(&self) -> String {
        dive_name(self.scene, self.dive, self.noise, self.duration_s)
    }

    /// What is to be run with a seed, but for the dives cut short; the paper's method only with the
    /// first of all.
    #[must_use]
    pub(crate) fn specs(&self, seed: u64, first_seed: u64) -> Vec<Spec> {
        let wanted = |line: &&Line| **line != Line::Paper || seed == first_seed;
        let lines = self.lines.iter().filter(wanted);
        // The finished map belongs to the live one's run.
        let own = lines.filter(|line| !matches!(line, Line::Finished | Line::Cut));
        own.map(|line| self.spec(*line, seed)).collect()
    }

    /// The dives cut short, from the shortest on; that of the whole is the live map's run.
    #[must_use]
    pub(crate) fn cut_specs(&self, seed: u64) -> Vec<Spec> {
        let cut = |halvings: i32| Spec {
            share: 0.5_f64.powi(halvings),
            moments: 0,
            ..self.spec(Line::Cut, seed)
        };
        match self.lines.contains(&Line::Cut) {
            true => (1..CUTS).rev().map(cut).collect(),
            false => Vec::new(),
        }
    }

    fn spec(&self, line: Line, seed: u64) -> Spec {
        let spec = Spec {
            duration_s: self.duration_s,
            method: line.method(),
            moments: self.moments,
            ..Spec::new(self.scene, self.dive, self.noise, seed)
        };
        match line {
            Line::MorePasses => MORE_PASSES
                .iter()
                .fold(Spec { moments: 0, ..spec }, |spec, (key, value)| {
                    spec.with(key, value)
                }),
            _ => spec,
        }
    }

    /// What was run for a line, seed by seed, with what came out.
    pub(crate) fn results_of<'a>(
        &self,
        line: Line,
        seeds: &'a [u64],
        results: &'a Outcomes,
    ) -> impl Iterator<Item = (u64, &'a Result<Outcome, String>)> {
        let found = |seed: &u64| Some((*seed, results.of(&self.spec(line, *seed))?));
        seeds
            .iter()
            .filter_map(found)
            .collect::<Vec<_>>()
            .into_iter()
    }

    /// The curves of all lines and seeds that were run; failed runs say why.
    #[must_use]
    pub(crate) fn curves(&self, seeds: &[u64], results: &Outcomes) -> Vec<Curve> {
        let curves = self.lines.iter().flat_map(|line| match line {
            Line::Cut => self.cut_curves(seeds, results),
            _ => {
                let runs = self.results_of(*line, seeds, results);
                runs.map(|(seed, result)| curve(*line, seed, result))
                    .collect()
            }
        });
        curves.collect()
    }

    /// Of each seed whose dives were all run; moments that are missing would put the others in their
    /// places.
    fn cut_curves(&self, seeds: &[u64], results: &Outcomes) -> Vec<Curve> {
        let of_seed = |seed: &u64| {
            let whole = self.spec(Line::Cut, *seed);
            let specs = self.cut_specs(*seed).into_iter().chain([whole]);
            let runs: Option<Vec<_>> = specs.map(|spec| results.of(&spec)).collect();
            let mut all = Curve::new(Line::Cut.as_str(), *seed);
            for result in runs? {
                let one = curve(Line::Cut, *seed, result);
                all.samples.extend(one.samples);
                all.failure = all.failure.or(one.failure);
            }
            Some(all)
        };
        seeds.iter().filter_map(of_seed).collect()
    }
}

fn curve(line: Line, seed: u64, result: &Result<Outcome, String>) -> Curve {
    let mut curve = Curve::new(line.as_str(), seed);
    match result {
        Ok(outcome) => curve.samples = line.samples(outcome),
        Err(why) => curve.failure = Some(why.clone()),
    }
    curve
}

/// All that can be drawn of a dive, but for dives cut short where these take long or show nothing: they
/// cost as much as the live map again.
fn lines(scene: &str, dive: DiveKind, noise: NoiseLevel) -> Vec<Line> {
    let is_drawn = |line: &Line| match (line, dive) {
        (Line::Paper, _) => dive == DiveKind::Viewpoints && noise == NoiseLevel::None,
        (Line::Cut, DiveKind::Survey) => noise == NoiseLevel::Nominal || scene == "fence",
        (Line::Cut, DiveKind::Viewpoints) => scene == "fence",
        (Line::Cut, DiveKind::Pan | DiveKind::Level) => false,
        _ => true,
    };
    Line::ALL.into_iter().filter(is_drawn).collect()
}

/// All dives, in the order of the report.
#[must_use]
pub(crate) fn cases(quick: bool) -> Vec<Case> {
    use DiveKind::{Pan, Survey, Viewpoints};
    use NoiseLevel::{Harsh, Nominal, None as Clean};
    let own = [Line::Support, Line::Carving, Line::Online, Line::Finished];
    let case = |scene, dive, noise| Case {
        scene,
        dive,
        noise,
        lines: match quick {
            true => own.to_vec(),
            false => lines(scene, dive, noise),
        },
        duration_s: quick.then_some(QUICK_DIVE_S),
        moments: if quick { QUICK_MOMENTS } else { MOMENTS },
    };
    match quick {
        true => vec![case("fence", Survey, Nominal), case("fence", Pan, Nominal)],
        false => vec![
            case("fence", Survey, Nominal),
            case("fence", Survey, Clean),
            case("fence", Survey, Harsh),
            case("fence", Viewpoints, Clean),
            case("fence", Pan, Nominal),
            case("pier", Survey, Nominal),
            case("pier", Survey, Harsh),
            case("wall", Survey, Nominal),
            case("pipeline", Survey, Nominal),
            case("truss", Viewpoints, Clean),
        ],
    }
}

/// Dives, noises and methods that no case has.
#[must_use]
pub(crate) fn omissions(cases: &[Case], quick: bool) -> Vec<Omission> {
    let mut omissions = vec![
        Omission::new(
            "paper on survey, pan and level dives",
            "it cannot run: it takes images, and their pings are none",
        ),
        Omission::new(
            "paper with more than one seed, and on other scenes or noise",
            "its two cases as it prints them, to fit the time",
        ),
    ];
    if quick {
        let why = "--quick: short dives of one scene, one seed";
        let what = "more passes, dives cut and ended, paper, sweeps of settings";
        omissions.push(Omission::new(what, why));
    } else {
        let uncut = cases.iter().filter(|case| !case.lines.contains(&Line::Cut));
        let uncut: Vec<String> = uncut.map(Case::name).collect();
        let what = format!("dives cut and ended: {}", uncut.join("; "));
        omissions.push(Omission::new(what, "thinned, to fit the time"));
    }
    let mut scenes: Vec<&str> = cases.iter().map(|case| case.scene).collect();
    scenes.dedup();
    scenes.sort_unstable();
    scenes.dedup();
    for scene in scenes {
        let has = |dive, noise| {
            let mut own = cases.iter().filter(|case| case.scene == scene);
            own.any(|case| case.dive == dive && case.noise == noise)
        };
        let missing = DiveKind::ALL.iter().flat_map(|&dive| {
            let noises = NoiseLevel::ALL
                .into_iter()
                .filter(move |&noise| !has(dive, noise));
            noises.map(move |noise| format!("{dive} {noise}"))
        });
        let missing: Vec<String> = missing.collect();
        let what = format!("{scene}: {}", missing.join(", "));
        omissions.push(Omission::new(what, "thinned, to fit the time"));
    }
    let others: Vec<&str> = echosplat_simulator::BUILT_IN_SCENES
        .iter()
        .map(|(name, _)| *name)
        .filter(|name| !cases.iter().any(|case| case.scene == *name))
        .collect();
    let what = format!("the scenes {}", others.join(", "));
    omissions.push(Omission::new(what, "thinned, to fit the time"));
    omissions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runs::sample_outcome;

    #[test]
    fn every_run_belongs_to_a_line_and_the_paper_has_one_seed() {
        let cases = cases(false);
        let mut names: Vec<String> = cases.iter().map(Case::name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), cases.len());
        for case in &cases {
            let [first, second] = [3, 4].map(|seed| case.specs(seed, 3));
            let papers =
                |specs: &[Spec]| specs.iter().filter(|s| s.method == Method::Paper).count();
            let is_papers = case.dive == DiveKind::Viewpoints;
            assert_eq!(
                (papers(&first), papers(&second)),
                (usize::from(is_papers), 0)
            );
            let reached =
                |spec: &&Spec| case.lines.iter().any(|line| case.spec(*line, 3) == **spec);
            assert_eq!(first.iter().filter(reached).count(), first.len());
        }
    }

    #[test]
    fn a_cut_curve_has_every_moment_or_is_none() {
        let cases = cases(false);
        // More would have no colour of their own.
        assert!(cases.iter().all(|case| case.lines.len() <= 7));
        let case = &cases[0];
        let cut = case.cut_specs(1);
        let shares: Vec<u64> = cut.iter().map(|spec| spec.share.to_bits()).collect();
        let expected = [0.03125, 0.0625, 0.125, 0.25, 0.5].map(f64::to_bits);
        assert_eq!(shares, expected);
        assert!(cut.iter().all(|spec| spec.moments == 0));
        let mut results = Outcomes::default();
        for (index, spec) in cut.iter().enumerate() {
            let made = sample_outcome(1.0 / (1 + index) as f64, 100);
            results.0.insert(spec.name(), Ok(made));
        }
        let of = |results: &Outcomes| {
            let curves = case.curves(&[1], results).into_iter();
            curves
                .filter(|curve| curve.method == Line::Cut.as_str())
                .collect::<Vec<_>>()
        };
        assert!(of(&results).is_empty());
        let whole = case.spec(Line::Online, 1);
        results
            .0
            .insert(whole.name(), Ok(sample_outcome(0.01, 900)));
        let curve = &of(&results)[0];
        let cds: Vec<f64> = curve.samples.iter().map(|s| s.metrics.cd_m).collect();
        assert!(cds.len() == 6 && cds.is_sorted_by(|a, b| a > b));
        assert!(curve.failure.is_none());
        results.0.insert(cut[2].name(), Err("no room".into()));
        assert_eq!(of(&results)[0].failure.as_deref(), Some("no room"));
    }

    #[test]
    fn live_and_finished_maps_come_from_one_run_and_failures_are_shown() {
        let case = &cases(true)[0];
        let specs = case.specs(1, 1);
        assert_eq!(specs.len(), 3);
        let mut results = Outcomes::default();
        let live = echosplat_metrics::sample::run("", 1, 3.0, 4).samples;
        let outcome = Outcome {
            samples: live.clone(),
            ..sample_outcome(0.01, 900)
        };
        results.0.insert(specs[2].name(), Ok(outcome));
        results.0.insert(specs[0].name(), Err("no room".into()));
        let curves = case.curves(&[1, 2], &results);
        let of = |line: Line| curves.iter().find(|curve| curve.method == line.as_str());
        assert_eq!(of(Line::Online).unwrap().samples, live);
        let finished = of(Line::Finished).unwrap().last().unwrap();
        assert!((finished.dive_s - 30.0).abs() < 1e-9 && finished.work() == 900);
        assert_eq!(
            of(Line::Support).unwrap().failure.as_deref(),
            Some("no room")
        );
        assert!(of(Line::Carving).is_none());
    }

    #[test]
    fn what_is_thinned_is_listed() {
        let listed = omissions(&cases(false), false);
        let text: Vec<&str> = listed.iter().map(|o| o.what.as_str()).collect();
        let text = text.join("\n");
        assert!(text.contains("paper on survey") && text.contains("dolphin"));
        assert!(text.contains("wall: survey none") && !text.contains("wall: survey nominal"));
    }
}
