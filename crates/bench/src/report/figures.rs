//! Figures of outcomes, as the report's file has them.

use echosplat_metrics::Certainty;
use echosplat_metrics::curve::Sample;
use echosplat_report::results::{
    Case, Curve, Judged, Live, Noise, Point, Results, Run, Sigma, Watched,
};
use echosplat_simulator::{DiveKind, NoiseLevel};

use super::Plan;
use super::plan::Asked;
use crate::arguments::ReportPart;
use crate::runs::{Outcome, Outcomes, Spec};
use crate::targets::{LIVE_MOMENTS, Row, Section};

/// What the outcomes do not say.
#[derive(Debug, Clone)]
pub(crate) struct Made {
    pub(crate) version: String,
    pub(crate) commit: String,
    pub(crate) processor: String,
    pub(crate) cores: usize,
    pub(crate) jobs: u64,
    pub(crate) command: String,
    /// Names of runs that are not made yet.
    pub(crate) left_out: Vec<String>,
}

/// All that the runs made so far have to say.
#[must_use]
pub(crate) fn results(plan: &Plan, outcomes: &Outcomes, made: Made) -> Results {
    let done = || outcomes.0.values().filter_map(|run| run.as_ref().ok());
    let failed = outcomes.0.iter();
    let failed = failed.filter_map(|(name, run)| Some((name.clone(), run.as_ref().err()?.clone())));
    Results {
        version: made.version,
        commit: made.commit,
        processor: made.processor,
        cores: made.cores,
        jobs: made.jobs,
        command: made.command,
        left_out: made.left_out,
        failed: failed.collect(),
        thinned: plan.thinned.clone(),
        run_s: done().map(|outcome| outcome.wall_s).sum(),
        accuracy: cases(&accuracy_specs(plan), outcomes),
        live: plan
            .asked
            .iter()
            .flat_map(|asked| live(asked, outcomes))
            .collect(),
        sigma: sigma(plan, outcomes),
        noise: noise(plan, outcomes),
        error_time: error_time(plan, outcomes),
        length: cases(&plan.length, outcomes),
        targets: match plan.is_quick {
            true => Vec::new(),
            false => plan
                .asked
                .iter()
                .flat_map(|asked| judged(asked, outcomes))
                .collect(),
        },
    }
}

/// Whole dives as users have them; poses shifted in time belong to a target alone.
fn accuracy_specs(plan: &Plan) -> Vec<Spec> {
    let parts = [ReportPart::Accuracy, ReportPart::Sigma];
    let specs = parts.iter().flat_map(|part| plan.specs(*part));
    let mut seen = std::collections::BTreeSet::new();
    let is_whole = |spec: &Spec| spec.time_offset_s == 0.0;
    specs
        .filter(|spec| is_whole(spec) && seen.insert(spec.name()))
        .collect()
}

/// Runs of one scene, dive and noise together, in the order in which they first come.
fn cases(specs: &[Spec], outcomes: &Outcomes) -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
    for spec in specs {
        let (dive, noise) = (spec.dive.to_string(), spec.noise.to_string());
        let is_same =
            |case: &&mut Case| case.scene == spec.scene && case.dive == dive && case.noise == noise;
        let run = done(spec, outcomes).map(|outcome| run(spec.seed, outcome));
        match cases.iter_mut().find(is_same) {
            Some(case) => case.runs.extend(run),
            None => cases.push(Case {
                scene: spec.scene.clone(),
                dive,
                noise,
                runs: run.into_iter().collect(),
            }),
        }
    }
    cases
}

fn done<'a>(spec: &Spec, outcomes: &'a Outcomes) -> Option<&'a Outcome> {
    outcomes.of(spec)?.as_ref().ok()
}

fn run(seed: u64, outcome: &Outcome) -> Run {
    let metrics = &outcome.metrics;
    Run {
        seed,
        cd_m: metrics.cd_m,
        p99_m: metrics.p99_m,
        hd_m: metrics.hd_m,
        false_share: metrics.confident_false_share,
        recall_share: metrics.recall_10cm,
        confident: metrics.confident_count,
        ambiguous: metrics.ambiguous_count,
        dive_s: outcome.dive_s,
        pings: outcome.pings,
        live_s: outcome.streamed.compute_s,
        total_s: outcome.total.compute_s,
        peak_bytes: outcome.peak_memory_bytes,
    }
}

fn point(sample: &Sample) -> Point {
    Point {
        dive_s: sample.dive_s,
        compute_s: sample.compute_s,
        cd_m: sample.metrics.cd_m,
        p99_m: sample.metrics.p99_m,
        false_share: sample.metrics.confident_false_share,
    }
}

fn end(outcome: &Outcome) -> Point {
    Point {
        dive_s: outcome.dive_s,
        compute_s: outcome.total.compute_s,
        cd_m: outcome.metrics.cd_m,
        p99_m: outcome.metrics.p99_m,
        false_share: outcome.metrics.confident_false_share,
    }
}

/// Every moment of the dives that are watched, and what the dive has that ends there.
fn live(asked: &Asked, outcomes: &Outcomes) -> Vec<Live> {
    if asked.case.section != Section::Live {
        return Vec::new();
    }
    let of_seed = |seed: &u64| {
        let runs = asked.case.runs(*seed);
        let (watched, cut) = runs.split_first()?;
        let outcome = done(watched, outcomes)?;
        // Fewer would not be where they are taken to be.
        let samples = Some(&outcome.samples).filter(|samples| samples.len() == LIVE_MOMENTS)?;
        let moments = watched.moment_shares().into_iter().zip(samples);
        let moment = |(share, sample): (f64, &Sample)| {
            let own = cut.iter().find(|spec| (spec.share - share).abs() < 1e-9);
            let ended = match share < 1.0 {
                true => own.and_then(|spec| done(spec, outcomes)),
                false => Some(outcome),
            };
            Live {
                scene: asked.case.scene.to_owned(),
                seed: *seed,
                share,
                live: point(sample),
                ended: ended.map(end),
            }
        };
        Some(moments.map(moment).collect::<Vec<Live>>())
    };
    asked.seeds.iter().filter_map(of_seed).flatten().collect()
}

/// All surveys of a level of noise together that assert something.
fn sigma(plan: &Plan, outcomes: &Outcomes) -> Vec<Sigma> {
    let specs = accuracy_specs(plan);
    let levels = [NoiseLevel::Nominal, NoiseLevel::Field, NoiseLevel::Harsh];
    let of_level = |noise: NoiseLevel| {
        let own = specs.iter().filter(|spec| {
            spec.noise == noise && spec.dive == DiveKind::Survey && plan.is_pooled(&spec.scene)
        });
        let own = own.filter_map(|spec| done(spec, outcomes)?.certainty.as_ref());
        let maps: Vec<&Certainty> = own.collect();
        let pooled = Certainty::pooled(&maps)?;
        let tenths = pooled.sigma_tenths.iter();
        let groups = pooled.probability_tenths.iter();
        Some(Sigma {
            noise: noise.to_string(),
            maps: maps.len(),
            within_share: pooled.within_two_sigma_share,
            tenths_m: tenths.map(|tenth| (tenth.sigma_m, tenth.error_m)).collect(),
            probability: groups
                .map(|group| (group.said, group.found, group.count))
                .collect(),
        })
    };
    levels.into_iter().filter_map(of_level).collect()
}

fn noise(plan: &Plan, outcomes: &Outcomes) -> Vec<Noise> {
    let specs = plan.specs(ReportPart::Noise);
    let levels = plan.levels.iter().zip(&specs);
    let level = |(level, spec): (&crate::noise_sweep::Level, &Spec)| {
        Some(Noise {
            pings: level.pings.to_string(),
            over_noise_db: level.over_noise_db,
            run: run(spec.seed, done(spec, outcomes)?),
        })
    };
    levels.filter_map(level).collect()
}

fn error_time(plan: &Plan, outcomes: &Outcomes) -> Vec<Watched> {
    let of_case = |case: &crate::error_time::Case| {
        let curves = case.curves(&[1], outcomes).into_iter();
        let curves = curves.filter(|curve| !curve.samples.is_empty());
        let curves = curves.map(|curve| Curve {
            method: curve.method,
            points: curve.samples.iter().map(point).collect(),
        });
        let curves: Vec<Curve> = curves.collect();
        (!curves.is_empty()).then(|| Watched {
            dive: case.name(),
            curves,
        })
    };
    plan.watched.iter().filter_map(of_case).collect()
}

fn judged(asked: &Asked, outcomes: &Outcomes) -> Vec<Judged> {
    let rows = asked.case.rows(&asked.seeds, outcomes).into_iter();
    rows.filter(|row| row.must.is_some())
        .map(|row| told(&row))
        .collect()
}

fn told(row: &Row) -> Judged {
    let times = row.must.and_then(|must| {
        let (limit, reached) = (must.value(), row.median);
        let times = match must.wants_small() {
            true => reached / limit,
            false => limit / reached,
        };
        (limit > 0.0 && reached > 0.0 && times.is_finite()).then_some(times)
    });
    Judged {
        case: row.case.clone(),
        quantity: row.quantity.to_owned(),
        asked: row.must_text(),
        median: row.show_reached(row.median),
        worst: row.show_reached(row.worst),
        seeds: row.values.len(),
        verdict: row.verdict.as_str().to_owned(),
        times,
    }
}
