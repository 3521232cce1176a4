//! Runs that are done, as JSON lines that survive an interruption.

use std::fs::{File, OpenOptions};
use std::hash::Hasher;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use crate::runs::{Outcome, Outcomes, Spec};
use anyhow::Context;
use echosplat_service::arguments::COMMIT;
use serde::{Deserialize, Serialize};

use super::job::Job;
use crate::fingerprint::Fingerprint;

const RUNS_FILE: &str = "runs.jsonl";
const MAPS_FOLDER: &str = "runs-maps";

/// One line. Figures of another program are no figures of this one.
#[derive(Debug, Serialize, Deserialize)]
struct Line {
    program: String,
    spec: Spec,
    outcome: Outcome,
}

/// What this very program has done so far.
pub(in crate::commands) struct Store {
    folder: PathBuf,
    file: File,
    program: String,
    done: Outcomes,
}

impl Store {
    /// # Errors
    /// If the folder cannot be written to.
    pub(in crate::commands) fn open(folder: &Path) -> anyhow::Result<Self> {
        Self::of_program(folder, program()?)
    }

    fn of_program(folder: &Path, program: String) -> anyhow::Result<Self> {
        let path = folder.join(RUNS_FILE);
        let failed = || format!("cannot write {}", path.display());
        std::fs::create_dir_all(folder.join(MAPS_FOLDER)).with_context(failed)?;
        let mut options = OpenOptions::new();
        let mut file = options
            .read(true)
            .append(true)
            .create(true)
            .open(&path)
            .with_context(failed)?;
        let mut text = String::new();
        file.read_to_string(&mut text).with_context(failed)?;
        if !text.is_empty() && !text.ends_with('\n') {
            // The line that an interruption cut stays alone.
            file.write_all(b"\n").with_context(failed)?;
        }
        let lines = text
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok());
        let mut done = Outcomes::default();
        for line in lines.filter(|line: &Line| line.program == program) {
            done.0.insert(line.spec.name(), Ok(line.outcome));
        }
        Ok(Self {
            folder: folder.to_owned(),
            file,
            program,
            done,
        })
    }

    /// Whether a job need not be done again.
    pub(super) fn has(&self, job: &Job) -> bool {
        let map_is_there = job.map.as_ref().is_none_or(|map| map.is_file());
        map_is_there && self.done.of(&job.spec).is_some()
    }

    /// # Errors
    /// If it cannot be written.
    pub(super) fn add(&mut self, spec: &Spec, outcome: Outcome) -> anyhow::Result<()> {
        let line = Line {
            program: self.program.clone(),
            spec: spec.clone(),
            outcome,
        };
        let text = serde_json::to_string(&line)? + "\n";
        let written = self.file.write_all(text.as_bytes());
        written.with_context(|| format!("cannot write {RUNS_FILE}"))?;
        self.done.0.insert(spec.name(), Ok(line.outcome));
        Ok(())
    }

    /// Where the map of a run is kept if it is: of this program, so that no other's is taken for it.
    pub(in crate::commands) fn map_of(&self, spec: &Spec) -> PathBuf {
        let mut name = Fingerprint::default();
        name.write(self.program.as_bytes());
        name.write(spec.name().as_bytes());
        self.folder.join(MAPS_FOLDER).join(format!("{name}.ply"))
    }

    /// Of a run that is done.
    pub(super) fn outcome(&self, spec: &Spec) -> Option<&Outcome> {
        self.done.of(spec)?.as_ref().ok()
    }

    /// Of these runs, those that are done.
    pub(in crate::commands) fn outcomes(&self, wanted: &[Spec]) -> Outcomes {
        let one = |spec: &Spec| Some((spec.name(), self.done.of(spec)?.clone()));
        Outcomes(wanted.iter().filter_map(one).collect())
    }
}

/// Names the bits of the running program.
fn program() -> anyhow::Result<String> {
    let path = std::env::current_exe().context("this program's own file")?;
    let bytes = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut bits = Fingerprint::default();
    bits.write(&bytes);
    Ok(format!("{COMMIT}-{bits}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runs::Work;
    use echosplat_metrics::{MapPoints, Truth, evaluate_raw};
    use echosplat_simulator::{DiveKind, NoiseLevel};

    fn outcome(pings: u64) -> Outcome {
        Outcome {
            metrics: evaluate_raw(&MapPoints::default(), &Truth::from_points(&[])),
            certainty: None,
            mid_dive_cd_m: f64::INFINITY,
            pings,
            dive_s: 0.0,
            streamed: Work::default(),
            total: Work::default(),
            held_out: None,
            peak_memory_bytes: 0,
            wall_s: 0.0,
            fingerprint: String::new(),
            samples: Vec::new(),
            met_budget: false,
            left_out: Vec::new(),
            from_unmoved_m: None,
        }
    }

    fn job(seed: u64, map: Option<PathBuf>) -> Job {
        let spec = Spec::new("empty", DiveKind::Survey, NoiseLevel::Nominal, seed);
        Job { spec, map }
    }

    #[test]
    fn what_was_done_is_found_again_behind_a_line_that_was_cut() {
        let folder = tempfile::tempdir().unwrap();
        let open = |program: &str| Store::of_program(folder.path(), program.to_owned()).unwrap();
        open("a").add(&job(1, None).spec, outcome(7)).unwrap();
        let path = folder.path().join(RUNS_FILE);
        let mut text = std::fs::read_to_string(&path).unwrap();
        text += "{\"program\": \"a\", \"sp";
        std::fs::write(&path, text).unwrap();
        open("a").add(&job(2, None).spec, outcome(8)).unwrap();
        let store = open("a");
        assert!(store.has(&job(1, None)) && store.has(&job(2, None)));
        assert!(!store.has(&job(3, None)));
        let wanted = [2, 3].map(|seed| job(seed, None).spec);
        let outcomes = store.outcomes(&wanted).0;
        assert_eq!(outcomes.len(), 1);
        let found = outcomes[&wanted[0].name()].as_ref().unwrap();
        assert!(found.pings == 8 && found.metrics.cd_m.is_infinite());
    }

    #[test]
    fn figures_of_another_program_and_runs_without_their_map_do_not_count() {
        let folder = tempfile::tempdir().unwrap();
        let open = |program: &str| Store::of_program(folder.path(), program.to_owned()).unwrap();
        let mut store = open("a");
        store.add(&job(1, None).spec, outcome(7)).unwrap();
        assert!(!open("b").has(&job(1, None)));
        let map = store.map_of(&job(1, None).spec);
        assert!(map != open("b").map_of(&job(1, None).spec));
        assert!(!store.has(&job(1, Some(map.clone()))));
        std::fs::write(&map, "").unwrap();
        assert!(store.has(&job(1, Some(map))));
    }
}
