//! Runs for any bench, each in a process of its own, so that its memory and processor time are its
//! own and one that dies is a row that failed. What is done is kept in a file of JSON lines beside
//! the reports: the same program asked again goes on from there.

mod batch;
mod clock;
mod held_out;
mod job;
mod left;
mod one;
mod online;
mod queue;
mod store;

use std::time::{Duration, Instant};

use crate::error_time::Omission;
use crate::runs::{Outcomes, Spec};
use serde_json::{Value, json};

use crate::arguments::{BenchOptions, QueueOptions};
pub(super) use clock::Clock;
use echosplat_service::signals::Stop;
pub(super) use job::Job;
use left::Left;
pub(super) use one::{run_one, sonar};
use queue::Queue;
pub(super) use store::Store;

/// Makes the jobs that are not done yet, as far as the time allows; what is not in the results
/// was left out.
///
/// # Errors
/// If the runs cannot be kept or started.
pub(super) fn make(
    jobs: &[Job],
    store: &mut Store,
    options: &QueueOptions,
) -> anyhow::Result<Outcomes> {
    let (done, to_do): (Vec<&Job>, Vec<&Job>) = jobs.iter().partition(|job| store.has(job));
    let mut left = Left::of(to_do.iter().map(|job| &job.spec));
    for job in &done {
        if let Some(outcome) = store.outcome(&job.spec) {
            left.was_done(&job.spec, outcome);
        }
    }
    let budget_s = options.budget.map(|minutes| 60.0 * minutes);
    let queue = Queue {
        jobs: to_do.into_iter().cloned().collect(),
        all: jobs.len(),
        at_once: options.jobs as usize,
        deadline: budget_s.map(|seconds| Instant::now() + Duration::from_secs_f64(seconds)),
        stop: Stop::on_signals()?,
        left,
    };
    let failures = queue.run(store)?;
    let wanted: Vec<Spec> = jobs.iter().map(|job| job.spec.clone()).collect();
    let mut results = store.outcomes(&wanted);
    let failed = failures.into_iter().map(|(name, why)| (name, Err(why)));
    results.0.extend(failed);
    Ok(results)
}

/// Each once, in the order in which they first come.
pub(super) fn once(mut specs: Vec<Spec>) -> Vec<Spec> {
    let mut seen = std::collections::BTreeSet::new();
    specs.retain(|spec| seen.insert(spec.name()));
    specs
}

/// Makes what `specs` describe, keeping no maps. What the time did not allow is an omission.
///
/// # Errors
/// As [`make`], or if the runs cannot be kept.
pub(super) fn make_or_omit(
    specs: &[Spec],
    options: &BenchOptions,
    queue: &QueueOptions,
) -> anyhow::Result<(Outcomes, Vec<Omission>)> {
    let job = |spec: &Spec| Job {
        spec: spec.clone(),
        map: None,
    };
    let jobs: Vec<Job> = specs.iter().map(job).collect();
    let results = make(&jobs, &mut Store::open(&options.out)?, queue)?;
    let left_out = left_out(specs, &results).into_iter();
    let omissions = left_out.map(|name| Omission::new(name, "the time was over"));
    Ok((results, omissions.collect()))
}

/// Names of those without a result.
pub(super) fn left_out<'a>(
    specs: impl IntoIterator<Item = &'a Spec>,
    results: &Outcomes,
) -> Vec<String> {
    let missing = specs.into_iter().filter(|spec| results.of(spec).is_none());
    missing.map(Spec::name).collect()
}

/// Every run with its outcome, or why it failed.
///
/// # Errors
/// If an outcome cannot be put into JSON.
pub(super) fn to_json(results: &Outcomes) -> anyhow::Result<Value> {
    let run = |(name, result): (&String, &Result<_, String>)| {
        Ok(match result {
            Ok(outcome) => json!({"run": name, "outcome": serde_json::to_value(outcome)?}),
            Err(why) => json!({"run": name, "failed": why}),
        })
    };
    results.0.iter().map(run).collect()
}
