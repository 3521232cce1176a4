//! The program as a child process: started, listened to, signalled, and never left behind.

use std::collections::{BTreeSet, VecDeque};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;
use echosplat_service::processor;
use serde_json::Value;

/// How often a condition is looked at again.
pub(super) const LOOK_AGAIN: Duration = Duration::from_millis(10);
/// Looks at what is open, of which the least counts.
const LOOKS: usize = 5;
/// Lines of the log that are kept.
const LINES: usize = 400;
const LONGEST_LINE_BYTES: u64 = 64 << 10;

/// A running program; killed when dropped.
pub(super) struct Program {
    child: Child,
    log: Arc<Mutex<Log>>,
    readers: Vec<JoinHandle<()>>,
}

/// A notice as the log tells it.
#[derive(Debug, Clone)]
pub(super) struct Told {
    pub(super) at: Instant,
    pub(super) code: String,
}

/// What the program has said.
#[derive(Debug, Default)]
pub(super) struct Log {
    told: Vec<Told>,
    standing: BTreeSet<String>,
    lines: VecDeque<String>,
}

impl Log {
    fn take(&mut self, line: &str, at: Instant) {
        if self.lines.len() == LINES {
            self.lines.pop_front();
        }
        self.lines.push_back(line.to_owned());
        let Ok(said) = serde_json::from_str::<Value>(line) else {
            return;
        };
        let Some(code) = said.pointer("/fields/notice").and_then(Value::as_str) else {
            return;
        };
        // A condition that is over is told as news, one that begins as a warning.
        if said["level"] == "WARN" {
            self.standing.insert(code.to_owned());
            let code = code.to_owned();
            self.told.push(Told { at, code });
        } else {
            self.standing.remove(code);
        }
    }

    /// The first notice after `begin`.
    pub(super) fn first_after(&self, begin: Instant) -> Option<&Told> {
        self.told.iter().find(|told| told.at >= begin)
    }

    /// Codes that were told after `begin`, each once, in order.
    pub(super) fn codes_after(&self, begin: Instant) -> Vec<&str> {
        let mut codes: Vec<&str> = Vec::new();
        for told in self.told.iter().filter(|told| told.at >= begin) {
            if !codes.contains(&told.code.as_str()) {
                codes.push(&told.code);
            }
        }
        codes
    }

    /// Conditions that were told and are not over.
    pub(super) fn standing(&self) -> &BTreeSet<String> {
        &self.standing
    }

    /// The newest lines.
    pub(super) fn text(&self) -> String {
        let lines: Vec<&str> = self.lines.iter().map(String::as_str).collect();
        lines.join("\n") + "\n"
    }
}

impl Program {
    /// # Errors
    /// If the system does not start it.
    pub(super) fn start(
        program: &Path,
        arguments: &[String],
        environment: &[(String, String)],
    ) -> anyhow::Result<Self> {
        let mut command = Command::new(program);
        command
            .args(["--log-format", "json"])
            .args(arguments)
            .env_remove("RUST_LOG")
            .env_remove("ZENOH_CONFIG")
            .envs(environment.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let started = command.spawn();
        let mut child = started.with_context(|| format!("cannot start {}", program.display()))?;
        let log = Arc::new(Mutex::new(Log::default()));
        let mut readers = Vec::new();
        readers.extend(child.stderr.take().map(|source| reading(source, &log)));
        readers.extend(child.stdout.take().map(|source| reading(source, &log)));
        Ok(Self {
            child,
            log,
            readers,
        })
    }

    /// What the kernel says that it holds; 0 once it has ended.
    pub(super) fn memory_bytes(&self) -> u64 {
        processor::memory_bytes_of(self.id())
    }

    /// Its open files and sockets, but for those that it opens for a moment, as to ask the kernel for
    /// its own times.
    pub(super) fn descriptor_count(&self) -> usize {
        let counts = (0..LOOKS).map(|_| {
            std::thread::sleep(LOOK_AGAIN);
            processor::descriptor_count_of(self.id())
        });
        counts.min().unwrap_or(0)
    }

    pub(super) fn id(&self) -> u32 {
        self.child.id()
    }

    /// What it has said so far.
    pub(super) fn log(&self) -> MutexGuard<'_, Log> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// `kill -9`.
    pub(super) fn kill(&mut self) {
        // It may have ended already; either way it is gone afterwards.
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.join_readers();
    }

    /// Asks it to end, as systemd does, and waits.
    pub(super) fn terminate(&mut self, limit: Duration) -> Option<ExitStatus> {
        let id = self.child.id().to_string();
        // What cannot be sent shows as a program that does not end.
        let _ = Command::new("kill").args(["-s", "TERM", &id]).status();
        self.wait(limit)
    }

    /// Waits for its end; `None` if it has not ended within `limit`.
    pub(super) fn wait(&mut self, limit: Duration) -> Option<ExitStatus> {
        let begin = Instant::now();
        loop {
            if let Ok(Some(status)) = self.child.try_wait() {
                self.join_readers();
                return Some(status);
            }
            if begin.elapsed() >= limit {
                return None;
            }
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    fn join_readers(&mut self) {
        for reader in self.readers.drain(..) {
            // A panic in it has been printed.
            let _ = reader.join();
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.kill();
    }
}

fn reading(source: impl Read + Send + 'static, log: &Arc<Mutex<Log>>) -> JoinHandle<()> {
    let log = Arc::clone(log);
    std::thread::spawn(move || {
        let mut source = BufReader::new(source);
        let mut line = Vec::new();
        loop {
            line.clear();
            let read = source
                .by_ref()
                .take(LONGEST_LINE_BYTES)
                .read_until(b'\n', &mut line);
            if !matches!(read, Ok(1..)) {
                return;
            }
            let text = String::from_utf8_lossy(&line);
            let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
            log.take(text.trim_end(), Instant::now());
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notice_stands_until_it_is_over() {
        let line = |level: &str| {
            format!(r#"{{"level":"{level}","fields":{{"message":"m","notice":"no-poses"}}}}"#)
        };
        let mut log = Log::default();
        let begin = Instant::now();
        log.take(&line("WARN"), begin);
        assert!(log.standing().contains("no-poses"));
        log.take(&line("INFO"), begin);
        log.take("no JSON", begin);
        assert!(log.standing().is_empty());
        assert_eq!(log.codes_after(begin), ["no-poses"]);
        assert!(log.first_after(begin + Duration::from_secs(1)).is_none());
        assert!(log.text().ends_with("no JSON\n"));
    }
}
