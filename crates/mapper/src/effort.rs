//! What each kind of work takes: counted here, and timed by whoever has a clock.

use std::fmt;
use std::ops::{AddAssign, Index};
use std::sync::Arc;

use serde::Serialize;

/// A kind of the mapper's work; one goes on at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// Listening to pings: noise, echoes, ground, and what is no echo of anything.
    Detect,
    /// How poses drift, asked of slices of pings.
    Drift,
    /// Evidence of pings, added to voxels.
    Evidence,
    /// New Gaussians where evidence asks for them, and those gone that it speaks against.
    Spawn,
    /// The beginning of a work-out: pings and candidates gathered, pairs counted.
    Begin,
    /// Multiplicative steps of strengths.
    Strengthen,
    /// Means moved to where their echoes are.
    Localise,
    /// What pings say of each Gaussian, for its verdict.
    Assess,
    /// Verdicts, and how sure each place is.
    Judge,
    /// Changes of which Gaussians there are, and of their shapes: side lobes, refill, split, align, a draft put in place.
    Change,
    /// What pings told, summed up before they are forgotten.
    Forget,
    /// All pings listened to or summed up once more.
    Anew,
    /// Copies of the map.
    Snapshot,
    /// Maps compared, of a calibrator alone: landmarks found, and held-out pings heard.
    Compare,
}

impl Task {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 14] = [
        Self::Detect,
        Self::Drift,
        Self::Evidence,
        Self::Spawn,
        Self::Begin,
        Self::Strengthen,
        Self::Localise,
        Self::Assess,
        Self::Judge,
        Self::Change,
        Self::Forget,
        Self::Anew,
        Self::Snapshot,
        Self::Compare,
    ];

    /// As in a status.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Detect => "detect",
            Self::Drift => "drift",
            Self::Evidence => "evidence",
            Self::Spawn => "spawn",
            Self::Begin => "begin",
            Self::Strengthen => "strengthen",
            Self::Localise => "localise",
            Self::Assess => "assess",
            Self::Judge => "judge",
            Self::Change => "change",
            Self::Forget => "forget",
            Self::Anew => "anew",
            Self::Snapshot => "snapshot",
            Self::Compare => "compare",
        }
    }
}

/// How much work was done; the same at any number of threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Counted {
    /// Times that it was begun: a slice, a portion, a map.
    pub times: u64,
    /// Visits of a ping.
    #[serde(skip_serializing_if = "is_none")]
    pub visits: u64,
    /// Gaussians looked at: rows of the pings visited, or of the map.
    #[serde(skip_serializing_if = "is_none")]
    pub candidates: u64,
    /// Pairs of a Gaussian and a bin.
    #[serde(skip_serializing_if = "is_none")]
    pub pairs: u64,
    /// Observations of voxels.
    #[serde(skip_serializing_if = "is_none")]
    pub voxel_looks: u64,
}

impl Counted {
    /// Of so many visits of a ping.
    pub(crate) fn of_visits(visits: u64) -> Self {
        Self {
            visits,
            ..Self::default()
        }
    }
}

/// What a task never has is left out.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde asks")]
fn is_none(count: &u64) -> bool {
    *count == 0
}

impl AddAssign for Counted {
    fn add_assign(&mut self, other: Self) {
        self.times += other.times;
        self.visits += other.visits;
        self.candidates += other.candidates;
        self.pairs += other.pairs;
        self.voxel_looks += other.voxel_looks;
    }
}

/// Of each task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TaskCounts([Counted; Task::ALL.len()]);

impl TaskCounts {
    /// Adds what a task took.
    pub fn add(&mut self, task: Task, counted: Counted) {
        self.0[task as usize] += counted;
    }
}

impl Index<Task> for TaskCounts {
    type Output = Counted;

    fn index(&self, task: Task) -> &Counted {
        &self.0[task as usize]
    }
}

/// Called once, on the thread that the task was begun on, when it has ended; with what it took.
pub type TaskEnd = Box<dyn FnOnce(Counted)>;
type OnTask = dyn Fn(Task) -> TaskEnd + Send + Sync;

/// Counts tasks, and tells of each.
#[derive(Clone, Default)]
pub(crate) struct Tasks {
    counts: TaskCounts,
    on_task: Option<Arc<OnTask>>,
}

/// A task under way.
#[must_use]
pub(crate) struct Begun {
    task: Task,
    end: Option<TaskEnd>,
}

impl Begun {
    /// Ends it without a place to count it.
    pub(crate) fn tell(self, counted: Counted) {
        if let Some(end) = self.end {
            end(counted);
        }
    }
}

impl Tasks {
    pub(crate) fn told_to(&mut self, on_task: impl Fn(Task) -> TaskEnd + Send + Sync + 'static) {
        self.on_task = Some(Arc::new(on_task));
    }

    /// Nothing counted yet, told to the same.
    pub(crate) fn anew(&self) -> Self {
        Self {
            counts: TaskCounts::default(),
            on_task: self.on_task.clone(),
        }
    }

    pub(crate) fn begin(&self, task: Task) -> Begun {
        let end = self.on_task.as_ref().map(|on_task| on_task(task));
        Begun { task, end }
    }

    pub(crate) fn end(&mut self, begun: Begun, counted: Counted) {
        let counted = Counted {
            times: 1,
            ..counted
        };
        self.counts.add(begun.task, counted);
        begun.tell(counted);
    }

    pub(crate) fn counts(&self) -> TaskCounts {
        self.counts
    }
}

impl fmt::Debug for Tasks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Tasks").field(&self.counts).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_task_has_the_number_of_its_place_and_a_name_of_its_own() {
        for (number, task) in Task::ALL.into_iter().enumerate() {
            assert_eq!(task as usize, number);
            let same = Task::ALL.iter().filter(|other| other.name() == task.name());
            assert_eq!(same.count(), 1);
        }
    }
}
