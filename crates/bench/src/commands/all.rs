//! `echosplat bench all`: the benches that judge maps, and that of the numerics, in turn, each within
//! its share of the time; and a small table of the quick form, held against a kept one.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, ensure};
use echosplat_report::Report;
use serde::{Deserialize, Serialize};
use serde_json::{Map, json};

use super::{Findings, Says, ablation, error_time, publish, save, stability, targets, write};
use crate::arguments::{
    AblationBenchArguments, AllBenchArguments, ErrorTimeBenchArguments, QueueOptions,
    TargetsBenchArguments,
};
use echosplat_service::exit::{Finish, Usage};
use echosplat_service::signals::Stop;

/// Shares of the time that is left for error-time, ablation and targets; stability takes seconds.
const SHARES: [f64; 3] = [0.3, 0.45, 1.0];
/// Without a budget of its own.
const QUICK_MINUTES: f64 = 2.75;
const FULL_MINUTES: f64 = 85.0;
/// Work and error of the kept table may be missed by this factor either way.
const MOST_FACTOR: f64 = 1.5;
/// Errors below this many metres are as good as each other.
const LEAST_ERROR_M: f64 = 0.01;

/// The table that is kept in the repository.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Kept {
    /// By name of the run.
    runs: BTreeMap<String, Figures>,
}

/// What a run came to, without anything of the machine it ran on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Figures {
    /// Gaussian–bin pairs and voxel observations.
    work: u64,
    /// Chamfer distance, metres; none for an empty map.
    cd_m: Option<f64>,
}

/// Runs them one after another; the reports of each are written like those of the bench alone.
///
/// # Errors
/// If it is stopped, or one of them cannot run, or is not as it must be: the first of these, after
/// all have run.
pub(super) fn run(arguments: &AllBenchArguments) -> anyhow::Result<Finish> {
    // A table that cannot be read is said before the work.
    let against = arguments.against.as_deref().map(Kept::read).transpose()?;
    let options = &arguments.options;
    let time = Time::of(arguments);
    let stop = Stop::on_signals()?;
    let go_on = || {
        ensure!(
            !stop.is_set(),
            "stopped; asked again, it goes on where it was"
        );
        Ok(())
    };
    let error_time = error_time::run(&ErrorTimeBenchArguments {
        options: options.clone(),
        queue: time.share(0),
        only: Vec::new(),
    })?;
    go_on()?;
    let ablation = ablation::run(&AblationBenchArguments {
        options: options.clone(),
        queue: time.share(1),
        only: Vec::new(),
        part: Vec::new(),
    })?;
    go_on()?;
    let stability = stability::run(options)?;
    go_on()?;
    let targets = targets::run(&TargetsBenchArguments {
        options: options.clone(),
        queue: time.share(2),
        only: Vec::new(),
    })?;
    go_on()?;
    let mut table = Kept::of(&error_time)?;
    table.runs.extend(Kept::of(&ablation)?.runs);
    if let Some(path) = &arguments.write_table {
        write(path, &(serde_json::to_string_pretty(&table)? + "\n"))?;
    }
    let differences = against.map_or(Vec::new(), |kept| kept.differences(&table));
    let parts = [error_time, ablation, stability, targets];
    let results = summary(&parts, &table, differences);
    // One object for all of them comes last.
    let says = if options.json {
        Says::Nothing
    } else {
        Says::Text
    };
    for part in parts {
        save(part, options, says)?;
    }
    publish(results, &arguments.options)
}

/// What there is of it.
struct Time {
    begin: Instant,
    minutes: f64,
    queue: QueueOptions,
}

impl Time {
    fn of(arguments: &AllBenchArguments) -> Self {
        let default = match arguments.options.quick {
            true => QUICK_MINUTES,
            false => FULL_MINUTES,
        };
        Self {
            begin: Instant::now(),
            minutes: arguments.queue.budget.unwrap_or(default),
            queue: arguments.queue.clone(),
        }
    }

    /// Of what is left, at least a second: what does not fit is listed.
    fn share(&self, index: usize) -> QueueOptions {
        let passed = self.begin.elapsed().as_secs_f64() / 60.0;
        let share = SHARES[index] * (self.minutes - passed);
        QueueOptions {
            budget: Some(share.max(1.0 / 60.0)),
            ..self.queue.clone()
        }
    }
}

fn summary(parts: &[Findings], table: &Kept, differences: Vec<String>) -> Findings {
    let mut fields = Map::new();
    for part in parts {
        fields.insert(part.name.to_owned(), json!({"failures": part.failures}));
    }
    fields.insert("table".to_owned(), json!(table.runs));
    fields.insert("differences".to_owned(), json!(differences));
    let own = |part: &Findings| -> Vec<String> {
        let named = |failure: &String| format!("{}: {failure}", part.name);
        part.failures.iter().map(named).collect()
    };
    // Whether targets are met is a figure of the report, and no failure of running all of it.
    let must_hold = parts.iter().filter(|part| part.name != "targets");
    let failures: Vec<String> = must_hold.flat_map(own).chain(differences).collect();
    let highlight = |part: &Findings| {
        let count = part.failures.len().to_string();
        (format!("{}: failures", part.name), count)
    };
    Findings {
        name: "all",
        fields,
        report: Report {
            title: "All benches".to_owned(),
            highlights: parts.iter().map(highlight).collect(),
            notes: failures.clone(),
            ..Report::default()
        },
        text: format!(
            "{} runs in the table, {} failures",
            table.runs.len(),
            failures.len()
        ),
        failures,
    }
}

impl Kept {
    /// Of a bench that lists its runs.
    fn of(results: &Findings) -> anyhow::Result<Self> {
        let mut table = Self {
            runs: BTreeMap::new(),
        };
        let runs = results.fields.get("runs").and_then(|runs| runs.as_array());
        for run in runs.into_iter().flatten() {
            let (name, total) = (&run["run"], &run["outcome"]["total"]);
            let (Some(name), Some(pairs), Some(voxel_observations)) = (
                name.as_str(),
                total["pairs"].as_u64(),
                total["voxel_looks"].as_u64(),
            ) else {
                continue;
            };
            let figures = Figures {
                work: pairs + voxel_observations,
                cd_m: run["outcome"]["metrics"]["cd_m"].as_f64(),
            };
            table.runs.insert(name.to_owned(), figures);
        }
        Ok(table)
    }

    fn read(path: &Path) -> anyhow::Result<Self> {
        let failed = || format!("cannot read {}", path.display());
        let text = std::fs::read_to_string(path).with_context(failed)?;
        serde_json::from_str(&text).map_err(|error| {
            let path = path.display();
            Usage::error(format!(
                "{path}: no table that --write-table wrote: {error}"
            ))
        })
    }

    /// One line for each run that is missing or whose figures differ too much.
    fn differences(&self, now: &Self) -> Vec<String> {
        let difference = |(name, kept): (&String, &Figures)| match now.runs.get(name) {
            None => Some(format!(
                "{name}: it was not run; --write-table keeps a new table"
            )),
            Some(now) => kept.difference(now).map(|said| format!("{name}: {said}")),
        };
        self.runs.iter().filter_map(difference).collect()
    }
}

impl Figures {
    fn difference(&self, now: &Self) -> Option<String> {
        let (before, after) = (self.work as f64, now.work as f64);
        if is_far(before.max(1.0), after.max(1.0)) {
            return Some(format!("work {before:.3e} → {after:.3e}"));
        }
        match (self.cd_m, now.cd_m) {
            (None, None) => None,
            (Some(before), Some(after)) => {
                let floor = |cd_m: f64| cd_m.max(LEAST_ERROR_M);
                let is_far = is_far(floor(before), floor(after));
                is_far.then(|| format!("CD {before:.3} → {after:.3} m"))
            }
            (None, Some(after)) => Some(format!("CD of an empty map → {after:.3} m")),
            (Some(before), None) => Some(format!("CD {before:.3} m → an empty map")),
        }
    }
}

fn is_far(before: f64, after: f64) -> bool {
    !(before / after <= MOST_FACTOR && after / before <= MOST_FACTOR)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(work: u64, cd_m: Option<f64>) -> Kept {
        Kept {
            runs: BTreeMap::from([("fence".to_owned(), Figures { work, cd_m })]),
        }
    }

    #[test]
    fn large_factors_either_way_are_differences_and_small_ones_are_not() {
        let kept = table(1000, Some(0.10));
        for (work, cd_m, count) in [
            (1400, Some(0.14), 0),
            (700, Some(0.07), 0),
            (1600, Some(0.10), 1),
            (600, Some(0.10), 1),
            (1000, Some(0.16), 1),
            (1000, None, 1),
        ] {
            assert_eq!(
                kept.differences(&table(work, cd_m)).len(),
                count,
                "{work} {cd_m:?}"
            );
        }
        assert!(table(0, None).differences(&table(0, None)).is_empty());
        assert!(
            table(1, Some(1e-4))
                .differences(&table(1, Some(5e-3)))
                .is_empty()
        );
        let nothing = Kept {
            runs: BTreeMap::new(),
        };
        assert_eq!(kept.differences(&nothing).len(), 1);
    }

    #[test]
    fn a_table_survives_its_file_and_another_file_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("quick.json");
        let kept = table(7, None);
        std::fs::write(&path, serde_json::to_string(&kept).unwrap()).unwrap();
        assert_eq!(Kept::read(&path).unwrap(), kept);
        std::fs::write(&path, "{}").unwrap();
        let error = Kept::read(&path).unwrap_err().to_string();
        assert!(error.contains("--write-table"), "{error}");
    }
}
