//! Runs, some at a time, each in a process of its own.

use std::collections::{BTreeMap, VecDeque};
use std::io::Read;
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::runs::{Outcome, run_line};
use anyhow::{Context, anyhow};
use indicatif::ProgressBar;

use super::job::Job;
use super::left::Left;
use super::store::Store;
use echosplat_service::signals::Stop;
use echosplat_service::{logging, processor};

/// How often a process is looked at.
const TICK: Duration = Duration::from_millis(50);
/// Most of what a process says that is read.
const MOST_BYTES: u64 = 1 << 20;

/// What is to be done, and how long.
pub(super) struct Queue {
    pub(super) jobs: VecDeque<Job>,
    /// With those that were done before.
    pub(super) all: usize,
    pub(super) at_once: usize,
    pub(super) deadline: Option<Instant>,
    pub(super) stop: Stop,
    pub(super) left: Left,
}

/// What the threads share.
struct Board<'a> {
    jobs: VecDeque<Job>,
    store: &'a mut Store,
    done: usize,
    left: Left,
    /// By name of the run.
    failures: BTreeMap<String, String>,
}

/// How a process ended.
enum Ended {
    Well(Box<Outcome>),
    Badly(String),
    /// By us.
    Stopped,
}

impl Queue {
    /// Until all is done or the time is over; what failed, and why.
    ///
    /// # Errors
    /// If no process can be started or nothing be kept.
    pub(super) fn run(mut self, store: &mut Store) -> anyhow::Result<BTreeMap<String, String>> {
        let jobs = std::mem::take(&mut self.jobs);
        let before = self.all - jobs.len();
        if before > 0 {
            tracing::info!("{before} of {} runs are done already", self.all);
        }
        let left = std::mem::take(&mut self.left);
        if !jobs.is_empty() {
            tracing::info!("{}", left.words(self.at_once));
        }
        let board = Mutex::new(Board {
            jobs,
            store,
            done: before,
            left,
            failures: BTreeMap::new(),
        });
        let bar =
            logging::progress_bar(self.all as u64, "{bar:40} {pos} of {len} runs · {elapsed}");
        bar.set_position(before as u64);
        std::thread::scope(|scope| {
            let worker = || scope.spawn(|| self.work(&board, &bar));
            let workers: Vec<_> = (0..self.at_once).map(|_| worker()).collect();
            workers.into_iter().try_for_each(|worker| {
                let ended = worker.join();
                ended.map_err(|_| anyhow!("a thread that waits for runs panicked"))?
            })
        })?;
        bar.finish_and_clear();
        let board = board.into_inner().unwrap_or_else(PoisonError::into_inner);
        Ok(board.failures)
    }

    fn work(&self, board: &Mutex<Board<'_>>, bar: &ProgressBar) -> anyhow::Result<()> {
        while !self.is_over() {
            let Some(job) = lock(board).jobs.pop_front() else {
                break;
            };
            let ended = self.run_job(&job)?;
            let mut board = lock(board);
            board.done += 1;
            bar.inc(1);
            let outcome = match &ended {
                Ended::Well(outcome) => Some(&**outcome),
                Ended::Badly(_) | Ended::Stopped => None,
            };
            board.left.ended(&job.spec, outcome);
            let left = board.left.words(self.at_once);
            let at = format!("[{}/{}] {}", board.done, self.all, job.spec.name());
            match ended {
                Ended::Well(outcome) => {
                    tracing::info!("{at}: {}; {left}", run_line(&outcome));
                    board.store.add(&job.spec, *outcome)?;
                }
                Ended::Badly(why) => {
                    tracing::warn!("{at}: failed: {why}");
                    board.failures.insert(job.spec.name(), why);
                }
                Ended::Stopped => tracing::warn!("{at}: left out, stopped or out of time"),
            }
        }
        Ok(())
    }

    fn is_over(&self) -> bool {
        let is_late = self.deadline.is_some_and(|end| Instant::now() >= end);
        is_late || self.stop.is_set()
    }

    fn run_job(&self, job: &Job) -> anyhow::Result<Ended> {
        let mut child = self.start(job)?;
        loop {
            if let Some(status) = child.try_wait().context("a run's process")? {
                // Both fit into their pipes.
                let said = text(child.stdout.take());
                let complaint = text(child.stderr.take());
                let outcome = serde_json::from_str(said.lines().last().unwrap_or_default());
                return Ok(match (status.success(), outcome) {
                    (true, Ok(outcome)) => Ended::Well(outcome),
                    // A signal to all of us ends it too.
                    _ if self.stop.is_set() => Ended::Stopped,
                    (true, Err(error)) => Ended::Badly(format!("its outcome: {error}")),
                    (false, _) => Ended::Badly(why(&complaint, &status.to_string())),
                });
            }
            if self.is_over() {
                // It may have ended by itself meanwhile.
                let _ = child.kill();
                child.wait().context("a run's process")?;
                return Ok(Ended::Stopped);
            }
            std::thread::sleep(TICK);
        }
    }

    fn start(&self, job: &Job) -> anyhow::Result<Child> {
        let program = std::env::current_exe().context("this program's own file")?;
        let threads = (processor::core_count() / self.at_once).max(1);
        let mut command = Command::new(&program);
        command
            .args(["bench", "run"])
            .arg(serde_json::to_string(&job.spec)?)
            .env("RUST_LOG", "error")
            .env("RAYON_NUM_THREADS", threads.to_string())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        if let Some(map) = &job.map {
            command.arg("--keep-map").arg(map);
        }
        command.spawn().with_context(|| {
            let program = program.display();
            format!("cannot start a run from {program}; it must not be built anew meanwhile")
        })
    }
}

/// The last line of a complaint without our own name, or how the process ended.
fn why(complaint: &str, status: &str) -> String {
    let last = complaint.lines().rfind(|line| !line.trim().is_empty());
    let last = last.map(|line| line.trim_start_matches("echosplat: "));
    last.map_or(status.to_owned(), |line| format!("{line} ({status})"))
}

fn text(pipe: Option<impl Read>) -> String {
    let mut bytes = Vec::new();
    if let Some(pipe) = pipe {
        // What cannot be read is no outcome.
        let _ = pipe.take(MOST_BYTES).read_to_end(&mut bytes);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn lock<'a, 'b>(board: &'a Mutex<Board<'b>>) -> MutexGuard<'a, Board<'b>> {
    board.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_dies_says_why() {
        assert_eq!(
            why("echosplat: no room\n\n", "exit status: 1"),
            "no room (exit status: 1)"
        );
        assert_eq!(why("", "signal: 9"), "signal: 9");
    }
}
