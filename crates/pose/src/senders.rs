//! Who sends poses, and whose are taken.
//!
//! One sender is used at a time: the best that is known of them, and of equals the first. Poses of others are left out
//! while it speaks. Once it is silent for a while another takes its place, from where it fell silent on. It comes back to a better sender, and to the first of equals
//! once that has spoken for a while.

use std::collections::VecDeque;

use echosplat_join::ArrivedPose;
use echosplat_model::Timestamp;
use echosplat_model::glam::DVec3;

use crate::status::PoseSender;

/// Senders told apart.
const MOST: usize = 16;
/// Poses held of one that may take another's place: more than pings wait for.
const HELD_COUNT: usize = 1_024;
/// Fewer poses do not show that another sender goes on where the one used does not.
const LEAST_HELD: usize = 5;
/// One of a full table gives its place away after so long, seconds.
const FORGOTTEN_AFTER_S: f64 = 30.0;
/// A sender counts as there for so long after it spoke, seconds.
const THERE_S: f64 = 3.0;
/// The first of equals has to have spoken for so long before it is used again, seconds.
const BACK_AFTER_S: f64 = 5.0;
/// A pause longer than this begins a new run of poses, seconds.
const PAUSE_S: f64 = 1.5;

/// How good a source of poses somebody is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Rank {
    /// By its own word no vehicle.
    Other,
    /// Nothing is known of it.
    Unknown,
    /// What one takes poses from.
    Vehicle,
}

/// When a sender takes another's place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules {
    /// The one used has been silent for so long, seconds.
    pub(crate) silent_s: f64,
    /// So long after its first pose one that is not known for a vehicle is used, seconds.
    pub(crate) settled_s: f64,
    /// Whether poses of the one that takes another's place are of a new epoch: two senders share no origin for certain.
    pub(crate) new_epoch: bool,
}

/// One of those heard.
#[derive(Debug)]
pub(crate) struct Heard<Id> {
    pub(crate) id: Id,
    pub(crate) rank: Rank,
    /// Place in the order in which they were first heard.
    order: u64,
    newest: Timestamp,
    poses: u64,
    first_pose: Option<Timestamp>,
    run_since: Option<Timestamp>,
    newest_pose: Option<Timestamp>,
    place_m: DVec3,
    /// Since the one used spoke last.
    held: VecDeque<ArrivedPose>,
}

impl<Id> Heard<Id> {
    fn note_pose(&mut self, pose: &ArrivedPose) {
        let arrived = pose.arrived;
        let pauses = |before: Timestamp| arrived.seconds_since(before).abs() > PAUSE_S;
        if self.newest_pose.is_none_or(pauses) {
            self.run_since = Some(arrived);
        }
        self.first_pose.get_or_insert(arrived);
        self.newest_pose = Some(arrived);
        self.poses += 1;
        self.place_m = pose.pose.world_from_vehicle.translation_m;
    }

    fn gave_pose_within(&self, limit_s: f64, now: Timestamp) -> bool {
        let newest = self.newest_pose;
        newest.is_some_and(|newest| now.seconds_since(newest).abs() <= limit_s)
    }

    /// Whether anything came from it of late.
    pub(crate) fn is_there(&self, now: Timestamp) -> bool {
        now.seconds_since(self.newest).abs() <= THERE_S
    }

    /// Whether poses came from it of late.
    pub(crate) fn gives_poses(&self, now: Timestamp) -> bool {
        self.gave_pose_within(THERE_S, now)
    }
}

/// All that were heard.
#[derive(Debug)]
pub(crate) struct Senders<Id> {
    rules: Rules,
    heard: Vec<Heard<Id>>,
    heard_count: u64,
    used: Option<usize>,
    epochs: Epochs,
    left_out: u64,
}

impl<Id: Copy + PartialEq> Senders<Id> {
    pub(crate) fn new(rules: Rules) -> Self {
        Self {
            rules,
            heard: Vec::new(),
            heard_count: 0,
            used: None,
            epochs: Epochs::default(),
            left_out: 0,
        }
    }

    /// Notes that something came; gives the sender's place in the table, and whether it is new there. `None` if the table
    /// is full of others.
    pub(crate) fn hear(&mut self, id: Id, rank: Rank, now: Timestamp) -> Option<(usize, bool)> {
        if let Some(index) = self.heard.iter().position(|heard| heard.id == id) {
            self.heard[index].newest = now;
            return Some((index, false));
        }
        let heard = Heard {
            id,
            rank,
            order: self.heard_count,
            newest: now,
            poses: 0,
            first_pose: None,
            run_since: None,
            newest_pose: None,
            place_m: DVec3::ZERO,
            held: VecDeque::new(),
        };
        let index = self.place_for_one_more(now)?;
        self.heard_count += 1;
        match self.heard.get_mut(index) {
            Some(place) => *place = heard,
            None => self.heard.push(heard),
        }
        Some((index, true))
    }

    fn place_for_one_more(&self, now: Timestamp) -> Option<usize> {
        if self.heard.len() < MOST {
            return Some(self.heard.len());
        }
        let silent_s = |index: &usize| now.seconds_since(self.heard[*index].newest).abs();
        let others = (0..self.heard.len()).filter(|index| Some(*index) != self.used);
        let longest = others.max_by(|a, b| silent_s(a).total_cmp(&silent_s(b)));
        longest.filter(|index| silent_s(index) > FORGOTTEN_AFTER_S)
    }

    /// Learns what somebody is.
    pub(crate) fn learn(&mut self, index: usize, rank: Rank) {
        self.heard[index].rank = rank;
    }

    /// Takes a pose of one of them; `out` gets those to be used.
    pub(crate) fn pose(&mut self, index: usize, pose: ArrivedPose, out: &mut Vec<ArrivedPose>) {
        let heard = &mut self.heard[index];
        heard.note_pose(&pose);
        if self.used == Some(index) {
            // It speaks: nobody takes its place.
            self.left_out += self.let_go(|_| true);
            out.push(self.epochs.of(pose));
        } else {
            heard.held.push_back(pose);
            if heard.held.len() > HELD_COUNT {
                heard.held.pop_front();
                self.left_out += u64::from(self.used.is_some());
            }
        }
        self.settle(pose.arrived, out);
    }

    fn let_go(&mut self, which: impl Fn(usize) -> bool) -> u64 {
        let all = self.heard.iter_mut().enumerate();
        let let_go = all.filter(|(index, _)| which(*index)).map(|(_, heard)| {
            let count = heard.held.len();
            heard.held.clear();
            count as u64
        });
        let_go.sum()
    }

    /// Sees whether another is to be used by now; `out` gets what was held of it.
    pub(crate) fn settle(&mut self, now: Timestamp, out: &mut Vec<ArrivedPose>) {
        let Some(next) = self.next(now).filter(|next| Some(*next) != self.used) else {
            return;
        };
        self.epochs.is_due |= self.used.is_some() && self.rules.new_epoch;
        self.used = Some(next);
        let held = std::mem::take(&mut self.heard[next].held);
        out.extend(held.into_iter().map(|pose| self.epochs.of(pose)));
        self.left_out += self.let_go(|_| true);
    }

    fn next(&self, now: Timestamp) -> Option<usize> {
        let is_alive =
            |index: &usize| self.heard[*index].gave_pose_within(self.rules.silent_s, now);
        let place = |index: &usize| {
            let heard = &self.heard[*index];
            (heard.rank, std::cmp::Reverse(heard.order))
        };
        let alive = (0..self.heard.len()).filter(is_alive);
        let best = alive.max_by_key(place)?;
        let candidate = &self.heard[best];
        let passed = |since: Option<Timestamp>, limit_s: f64| {
            since.is_some_and(|since| now.seconds_since(since).abs() >= limit_s)
        };
        let Some(used) = self.used else {
            let is_settled = candidate.rank == Rank::Vehicle
                || passed(candidate.first_pose, self.rules.settled_s);
            return is_settled.then_some(best);
        };
        let is_due = match is_alive(&used) {
            false => candidate.held.len() >= LEAST_HELD,
            true if candidate.rank > self.heard[used].rank => true,
            true => passed(candidate.run_since, BACK_AFTER_S),
        };
        Some(if is_due { best } else { used })
    }

    pub(crate) fn used(&self) -> Option<usize> {
        self.used
    }

    pub(crate) fn heard(&self, index: usize) -> &Heard<Id> {
        &self.heard[index]
    }

    /// All but the one used, in the order they were first heard.
    pub(crate) fn others(&self) -> impl Iterator<Item = &Heard<Id>> {
        let all = self.heard.iter().enumerate();
        all.filter(|(index, _)| Some(*index) != self.used)
            .map(|(_, heard)| heard)
    }

    pub(crate) fn ids(&self) -> impl Iterator<Item = (usize, Id, Rank)> {
        let all = self.heard.iter().enumerate();
        all.map(|(index, heard)| (index, heard.id, heard.rank))
    }

    /// The one that would be used if it were not silent.
    pub(crate) fn stands_in_for(&self) -> Option<&Heard<Id>> {
        let used = &self.heard[self.used?];
        let place = |heard: &Heard<Id>| (heard.rank, std::cmp::Reverse(heard.order));
        let gave_poses = self.heard.iter().filter(|heard| heard.poses > 0);
        let first = gave_poses.max_by_key(|heard| place(heard))?;
        (place(first) > place(used)).then_some(first)
    }

    /// Metres between the newest poses of the one used and of another.
    pub(crate) fn distance_m(&self, other: &Heard<Id>) -> f64 {
        let used = self
            .used
            .map_or(other.place_m, |used| self.heard[used].place_m);
        used.distance(other.place_m)
    }

    /// Poses of others than the one used, left out.
    pub(crate) fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Of the newest pose handed on.
    pub(crate) fn epoch(&self) -> u32 {
        self.epochs.newest.unwrap_or(0)
    }

    /// All of them for the status, the one used first.
    pub(crate) fn told(
        &self,
        now: Timestamp,
        name: impl Fn(usize, &Heard<Id>) -> (String, Option<String>),
    ) -> Vec<PoseSender> {
        let all = self.heard.iter().enumerate();
        let mut told: Vec<PoseSender> = all
            .map(|(index, heard)| {
                let (name, kind) = name(index, heard);
                PoseSender {
                    name,
                    kind,
                    is_used: self.used == Some(index),
                    poses: heard.poses,
                    age_s: now.seconds_since(heard.newest),
                }
            })
            .collect();
        told.sort_by_key(|sender| !sender.is_used);
        told
    }
}

/// Epochs of poses handed on: those of the sender, moved on where another takes its place.
#[derive(Debug, Default)]
struct Epochs {
    shift: u32,
    newest: Option<u32>,
    is_due: bool,
}

impl Epochs {
    fn of(&mut self, mut arrived: ArrivedPose) -> ArrivedPose {
        let own = arrived.pose.epoch;
        if std::mem::take(&mut self.is_due)
            && let Some(newest) = self.newest
        {
            self.shift = newest.wrapping_add(1).wrapping_sub(own);
        }
        arrived.pose.epoch = own.wrapping_add(self.shift);
        self.newest = Some(arrived.pose.epoch);
        arrived
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::{Pose, StampedPose};

    const RULES: Rules = Rules {
        silent_s: 5.0,
        settled_s: 1.5,
        new_epoch: true,
    };

    /// Of sender `x` at so many milliseconds.
    fn pose(x: u32, millis: i64) -> ArrivedPose {
        let translation_m = DVec3::new(f64::from(x), 0.0, 0.0);
        ArrivedPose::at_its_stamp(StampedPose {
            time: Timestamp::from_millis(millis),
            world_from_vehicle: Pose {
                translation_m,
                ..Pose::IDENTITY
            },
            uncertainty: None,
            epoch: 7,
        })
    }

    /// Whose poses are handed on, with their epochs, of senders that speak every 20 ms from and to so many milliseconds.
    fn used(spans: &[(u32, Rank, i64, i64)], until: i64) -> Vec<(u32, u32, i64)> {
        let mut senders = Senders::new(RULES);
        let mut out = Vec::new();
        for millis in (0..until).step_by(20) {
            for (id, rank, from, to) in spans {
                if (*from..*to).contains(&millis) {
                    let now = Timestamp::from_millis(millis);
                    let (index, _) = senders.hear(*id, *rank, now).unwrap();
                    senders.pose(index, pose(*id, millis), &mut out);
                }
            }
            senders.settle(Timestamp::from_millis(millis), &mut out);
        }
        let told = |a: &ArrivedPose| {
            let x = a.pose.world_from_vehicle.translation_m.x;
            (x as u32, a.pose.epoch, a.pose.time.nanos() / 1_000_000)
        };
        out.iter().map(told).collect()
    }

    /// Runs of poses of one sender: who, epoch, first and last.
    fn runs(spans: &[(u32, Rank, i64, i64)], until: i64) -> Vec<(u32, u32, i64, i64)> {
        let mut runs: Vec<(u32, u32, i64, i64)> = Vec::new();
        for (id, epoch, millis) in used(spans, until) {
            match runs.last_mut() {
                Some(run) if (run.0, run.1) == (id, epoch) => run.3 = millis,
                _ => runs.push((id, epoch, millis, millis)),
            }
        }
        runs
    }

    #[test]
    fn a_better_sender_is_waited_for_and_nothing_is_lost_meanwhile() {
        let gimbal_first = [(1, Rank::Other, 0, 4_000), (2, Rank::Vehicle, 500, 4_000)];
        assert_eq!(runs(&gimbal_first, 4_000), [(2, 7, 500, 3_980)]);
        let alone = [(1, Rank::Unknown, 0, 4_000)];
        assert_eq!(runs(&alone, 4_000), [(1, 7, 0, 3_980)]);
        let late = [(1, Rank::Other, 0, 4_000), (2, Rank::Vehicle, 2_000, 4_000)];
        let both = [(1, 7, 0, 2_000), (2, 8, 2_000, 3_980)];
        assert_eq!(runs(&late, 4_000), both);
    }

    #[test]
    fn the_first_of_equals_is_used_another_once_it_is_silent_and_it_again_once_it_is_back() {
        let two = |from, to| {
            [
                (1, Rank::Vehicle, 0, 2_000),
                (2, Rank::Vehicle, 20, 30_000),
                (1, Rank::Vehicle, from, to),
            ]
        };
        let short = runs(&two(6_000, 30_000), 20_000);
        assert_eq!(short, [(1, 7, 0, 19_980)]);
        let long = runs(&two(12_000, 30_000), 20_000);
        assert_eq!(
            long,
            [
                (1, 7, 0, 1_980),
                (2, 8, 1_980, 17_000),
                (1, 9, 17_000, 19_980)
            ]
        );
    }

    #[test]
    fn the_table_is_bounded_and_takes_others_once_those_are_silent() {
        let mut senders = Senders::new(RULES);
        let at = Timestamp::from_millis;
        for id in 0..MOST as u32 {
            assert!(senders.hear(id, Rank::Unknown, at(0)).is_some());
        }
        assert_eq!(senders.hear(99, Rank::Unknown, at(1_000)), None);
        senders.hear(0, Rank::Unknown, at(39_000));
        let (index, is_new) = senders.hear(99, Rank::Unknown, at(40_000)).unwrap();
        assert!(is_new && index != 0);
    }
}
