//! Watches over the parts of a run: which of them live, what is told of those that do not, and
//! whether the run can go on without them. Parts that can are begun again where they are made; here
//! nothing is started and nothing waited for.

mod systemd;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use echosplat_liveness::{Condition, DRILL_VARIABLE, Drill, Heartbeat};
use serde::Serialize;

use crate::exit::Usage;
use crate::pipeline::Finding;
pub(crate) use systemd::Systemd;

/// The parts that there are, of all commands together.
const PARTS: [&str; 18] = [
    "sonar",
    "poses",
    "mapper",
    "recorder",
    "recorder-sync",
    "run",
    "network",
    "frame-check",
    "prediction",
    "maps-every",
    "bus-map",
    "bus-answers",
    "bus-pings",
    "bus-reach",
    "bus-ros",
    "bus-tape",
    "web-map",
    "web-scene",
];

/// Arms the drill that the environment asks for, if it asks for one.
///
/// # Errors
/// If it asks for something else, or names no part there is.
pub(crate) fn arm_drill() -> anyhow::Result<()> {
    if let Some(drill) = Drill::asked_for(&PARTS).map_err(Usage::error)? {
        tracing::warn!(
            "a drill is armed ({DRILL_VARIABLE}): {drill}; the file itself is left as it is"
        );
        drill.arm();
    }
    Ok(())
}

/// A panic or a replacement is news for so long.
const NEWS: Duration = Duration::from_secs(3);
/// The recorder waits for a disk, and disks stall: so many times the limit of the others.
const RECORDER_PATIENCE: u32 = 4;

/// What becomes of a run without the part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Policy {
    /// A source: begun again after a panic, and replaced where it hangs. Where that is no use the
    /// run ends.
    Source,
    /// Begun again after a panic, and given more time than others. Where that is no use, or it
    /// hangs, the run ends.
    Recorder,
    /// Without it there is no map: the run ends.
    Needed,
    /// The run goes on; the part is begun again where it can be.
    Spared,
}

/// What the supervisor knows of one part, as the status shows it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct PartReport {
    pub(crate) name: &'static str,
    pub(crate) policy: Policy,
    /// `resting`, `working`, `hung`, `ended` or `failed`.
    pub(crate) state: &'static str,
    /// For how long it has hung, if it does.
    pub(crate) hung_s: Option<f64>,
    /// Panics so far.
    pub(crate) panics: u64,
    /// Tasks that hung and were replaced so far.
    pub(crate) replaced: u64,
}

/// All parts at one moment.
#[derive(Debug, Default)]
pub(crate) struct Health {
    pub(crate) findings: Vec<Finding>,
    /// Why the run cannot go on.
    pub(crate) fatal: Option<String>,
    /// Whether every part that the map or the recording needs is alive.
    pub(crate) is_alive: bool,
}

/// The parts of a run by name.
#[derive(Debug)]
pub(crate) struct Supervisor {
    /// How long a part may be silent while it works.
    limit: Duration,
    parts: BTreeMap<&'static str, Part>,
}

#[derive(Debug)]
struct Part {
    heartbeat: Heartbeat,
    policy: Policy,
    /// How long it may be silent while it works.
    limit: Duration,
    panics: Counted,
    replacements: Counted,
}

/// A count and when it grew last.
#[derive(Debug, Default)]
struct Counted {
    count: u64,
    grown: Option<Instant>,
}

impl Counted {
    /// Whether it grew of late.
    fn grows(&mut self, count: u64, now: Instant) -> bool {
        if count > self.count {
            self.count = count;
            self.grown = Some(now);
        }
        let is_news = |at: Instant| now.saturating_duration_since(at) < NEWS;
        self.grown.is_some_and(is_news)
    }
}

impl Supervisor {
    /// A part hangs once it is silent for `limit`.
    pub(crate) fn new(limit: Duration) -> Self {
        Self {
            limit,
            parts: BTreeMap::new(),
        }
    }

    /// Watches over parts that the run goes on without.
    pub(crate) fn spare<'a>(&mut self, heartbeats: impl IntoIterator<Item = &'a Heartbeat>) {
        for heartbeat in heartbeats {
            self.watch(heartbeat, Policy::Spared);
        }
    }

    /// Watches over a part from now on; one of the same name is watched no more.
    pub(crate) fn watch(&mut self, heartbeat: &Heartbeat, policy: Policy) {
        let name = heartbeat.name();
        let is_known = |part: &Part| part.heartbeat.is(heartbeat);
        if self.parts.get(name).is_some_and(is_known) {
            return;
        }
        let limit = match policy {
            Policy::Recorder => self.limit * RECORDER_PATIENCE,
            _ => self.limit,
        };
        heartbeat.set_limit(limit);
        let part = Part {
            heartbeat: heartbeat.clone(),
            policy,
            limit,
            panics: Counted::default(),
            replacements: Counted::default(),
        };
        self.parts.insert(name, part);
    }

    /// Looks at all parts.
    pub(crate) fn look(&mut self, now: Instant) -> Health {
        let mut health = Health {
            is_alive: true,
            ..Health::default()
        };
        for part in self.parts.values_mut() {
            part.look(now, &mut health);
        }
        health
    }

    /// For the status.
    pub(crate) fn reports(&self) -> Vec<PartReport> {
        self.parts.values().map(Part::report).collect()
    }
}

impl Part {
    fn look(&mut self, now: Instant, health: &mut Health) {
        let (panics, newest) = self.heartbeat.panics();
        let message = newest.unwrap_or_default();
        let condition = self.heartbeat.condition();
        if self.panics.grows(panics, now) && condition != Condition::Failed {
            let text = format!(
                "failed ({message}) and was begun again; what it was doing may be lost, and the \
                 log says where it was"
            );
            health.findings.push(self.finding("panicked", &text));
        }
        if self.replacements.grows(self.heartbeat.replacements(), now) {
            let text = "hung, and another has taken its place; what came meanwhile is lost";
            health.findings.push(self.finding("replaced", text));
        }
        match condition {
            Condition::Hung(silent) => self.hangs(silent, health),
            Condition::Failed => self.failed(&message, health),
            Condition::Resting | Condition::Working | Condition::Ended => {}
        }
    }

    fn hangs(&self, silent: Duration, health: &mut Health) {
        let text = format!("has not come back from its work for {} s", silent.as_secs());
        // Whoever started a source replaces it, unless there is no replacing it.
        let is_left = self.policy != Policy::Source || silent > 2 * self.limit;
        if self.policy != Policy::Spared && is_left {
            health.is_alive = false;
            health.fatal.get_or_insert_with(|| self.sentence(&text));
        }
        health.findings.push(self.finding("hangs", &text));
    }

    fn failed(&self, message: &str, health: &mut Health) {
        let text = format!("failed: {message}; the log says where");
        if self.policy != Policy::Spared {
            health.is_alive = false;
            health.fatal.get_or_insert_with(|| self.sentence(&text));
        }
        health.findings.push(self.finding("failed", &text));
    }

    fn finding(&self, what: &str, text: &str) -> Finding {
        Finding {
            code: format!("{}-{what}", self.heartbeat.name()).into(),
            sentence: self.sentence(text),
            is_loss: self.policy != Policy::Spared,
        }
    }

    fn sentence(&self, text: &str) -> String {
        format!("the part `{}` {text}", self.heartbeat.name())
    }

    fn report(&self) -> PartReport {
        let (state, hung_s) = match self.heartbeat.condition() {
            Condition::Resting => ("resting", None),
            Condition::Working => ("working", None),
            Condition::Hung(silent) => ("hung", Some(silent.as_secs_f64())),
            Condition::Ended => ("ended", None),
            Condition::Failed => ("failed", None),
        };
        PartReport {
            name: self.heartbeat.name(),
            policy: self.policy,
            state,
            hung_s,
            panics: self.heartbeat.panics().0,
            replaced: self.heartbeat.replacements(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A part of this policy that works and is silent.
    fn hung(policy: Policy) -> (Supervisor, Heartbeat) {
        let mut supervisor = Supervisor::new(Duration::ZERO);
        let heartbeat = Heartbeat::new("a");
        supervisor.watch(&heartbeat, policy);
        heartbeat.beat();
        std::thread::sleep(Duration::from_millis(5));
        (supervisor, heartbeat)
    }

    fn codes(health: &Health) -> Vec<&str> {
        health.findings.iter().map(|f| f.code.as_ref()).collect()
    }

    #[test]
    fn the_run_ends_where_a_needed_part_hangs_and_goes_on_where_a_spared_one_does() {
        let health = hung(Policy::Needed).0.look(Instant::now());
        assert_eq!((codes(&health), health.is_alive), (vec!["a-hangs"], false));
        assert!(health.fatal.is_some_and(|fatal| fatal.contains("`a`")));
        let health = hung(Policy::Spared).0.look(Instant::now());
        assert_eq!((codes(&health), health.is_alive), (vec!["a-hangs"], true));
        assert_eq!(health.fatal, None);
    }

    #[test]
    fn a_source_that_hangs_has_time_to_be_replaced() {
        let mut supervisor = Supervisor::new(Duration::from_millis(200));
        let heartbeat = Heartbeat::new("a");
        supervisor.watch(&heartbeat, Policy::Source);
        heartbeat.beat();
        std::thread::sleep(Duration::from_millis(250));
        let health = supervisor.look(Instant::now());
        assert_eq!((codes(&health), &health.fatal), (vec!["a-hangs"], &None));
        heartbeat.replaced();
        let health = supervisor.look(Instant::now());
        assert_eq!(
            (codes(&health), health.is_alive),
            (vec!["a-replaced"], true)
        );
        assert!(hung(Policy::Source).0.look(Instant::now()).fatal.is_some());
    }

    #[test]
    fn a_panic_is_told_while_it_is_news() {
        let mut supervisor = Supervisor::new(Duration::from_secs(60));
        let heartbeat = Heartbeat::new("a");
        supervisor.watch(&heartbeat, Policy::Source);
        assert!(heartbeat.survive(|| panic!("odd")).is_err());
        let now = Instant::now();
        let health = supervisor.look(now);
        assert_eq!(codes(&health), ["a-panicked"]);
        assert!(health.findings[0].sentence.contains("(odd)") && health.fatal.is_none());
        assert!(supervisor.look(now + NEWS).findings.is_empty());
        heartbeat.fail();
        assert!(supervisor.look(now + NEWS).fatal.is_some());
    }
}
