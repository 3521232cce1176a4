//! What a work-out does, in order.

use std::collections::VecDeque;

use crate::accumulate::evidence::TileIndex;
use crate::features::AtWork;
use crate::refine::expectation::Pace;

/// Pings, literature: OSEM; the number found.
/// A step looks at every so many-th ping.
pub(crate) const INTERLEAVE: f64 = 8.0;
/// Pings; found.
/// The last assessment looks at every so many-th ping.
const LAST_STRIDE: f64 = 3.0;
/// Steps; found.
/// Steps after which side lobes are suppressed.
const ROUND_STEPS: usize = 4;
/// Ratio of steps, found.
/// Strengths have converged after this many times as many steps as sort out candidates.
const CONVERGED: usize = 2;

/// One thing to do.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Action {
    /// A multiplicative step over every so many-th ping, shifted by the number of the step.
    Strengthen {
        step: usize,
        interleave: f64,
        pace: Pace,
    },
    SuppressSideLobes,
    /// What explains next to nothing goes.
    DropIdle,
    /// What stayed gives way to the candidates around it.
    Refill,
    /// Means are moved to where their echoes are.
    Localise,
    /// Verdicts by every so many-th ping.
    Assess {
        stride: f64,
    },
    /// What is confident is split in eight.
    Split,
    /// Shapes are laid along the surface.
    Align,
}

/// What the candidates of a work-out begin with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Start {
    /// All alike: nothing that was found before counts.
    Even,
    /// With what the map holds at their places: fewer steps do, but each start from the map makes it sharper.
    Map,
}

/// Tiles to be worked out, and how.
#[derive(Debug)]
pub(crate) struct Due {
    pub(crate) tiles: Vec<TileIndex>,
    pub(crate) start: Start,
    /// Whether the dive goes on and all its pings are there for the end: what comes late is old.
    pub(crate) is_live: bool,
}

/// Few observations sort out most candidates; the rest is worth all of them. From an even start strengths converge, on
/// few places of a surface, before the surface is filled again.
pub(crate) fn actions(passes: usize, start: Start, at_work: AtWork) -> VecDeque<Action> {
    let mut actions = VecDeque::new();
    let moves = match start {
        Start::Even => {
            rounds(&mut actions, passes, 4.0 * INTERLEAVE, Pace::Fast);
            rounds(&mut actions, CONVERGED * passes, INTERLEAVE, Pace::Fast);
            actions.push_back(Action::Refill);
            rounds(&mut actions, passes / 4, INTERLEAVE, Pace::Full);
            2
        }
        Start::Map => {
            rounds(&mut actions, passes / 4, 4.0 * INTERLEAVE, Pace::Full);
            rounds(&mut actions, passes / 2, INTERLEAVE, Pace::Full);
            1
        }
    };
    for _ in 0..moves {
        actions.push_back(Action::Localise);
        steps(&mut actions, passes / 3, INTERLEAVE, Pace::Full);
    }
    actions.push_back(Action::Assess { stride: 2.0 });
    if at_work.splitting {
        actions.push_back(Action::Split);
        steps(&mut actions, passes / 5, INTERLEAVE, Pace::Full);
        actions.push_back(Action::SuppressSideLobes);
        actions.push_back(Action::Localise);
    }
    steps(&mut actions, passes / 8, INTERLEAVE, Pace::Full);
    actions.push_back(Action::Assess {
        stride: LAST_STRIDE,
    });
    if at_work.anisotropy {
        actions.push_back(Action::Align);
    }
    actions
}

fn steps(actions: &mut VecDeque<Action>, count: usize, interleave: f64, pace: Pace) {
    actions.extend((0..count).map(|step| Action::Strengthen {
        step,
        interleave,
        pace,
    }));
}

/// Steps, with side lobes suppressed after every [`ROUND_STEPS`], and what is idle once candidates are sorted out:
/// before, each explains little.
fn rounds(actions: &mut VecDeque<Action>, count: usize, interleave: f64, pace: Pace) {
    for step in 0..count {
        actions.push_back(Action::Strengthen {
            step,
            interleave,
            pace,
        });
        if (step + 1) % ROUND_STEPS == 0 || step + 1 == count {
            if interleave <= INTERLEAVE {
                actions.push_back(Action::DropIdle);
            }
            actions.push_back(Action::SuppressSideLobes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::{Cues, Features, MapCues, decide};

    #[test]
    fn a_start_from_the_map_takes_fewer_steps_to_the_same_end() {
        let (at_work, _) = decide(&Features::default(), &Cues::default(), MapCues::default());
        let count = |start: Start| {
            let actions = actions(16, start, at_work);
            let is_step = |action: &&Action| matches!(action, Action::Strengthen { .. });
            (actions.iter().filter(is_step).count(), actions.len())
        };
        let ((even, _), (map, _)) = (count(Start::Even), count(Start::Map));
        let even_steps = 16 + 32 + 4 + 2 * 5 + 3 + 2;
        assert_eq!((even, map), (even_steps, 4 + 8 + 5 + 3 + 2));
        let refills = |start: Start| {
            let actions = actions(16, start, at_work);
            let is_refill = |action: &&Action| matches!(action, Action::Refill);
            actions.iter().filter(is_refill).count()
        };
        assert_eq!((refills(Start::Even), refills(Start::Map)), (1, 0));
        let last = actions(16, Start::Map, at_work).pop_back();
        assert!(matches!(last, Some(Action::Align | Action::Assess { .. })));
    }
}
