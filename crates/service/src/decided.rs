//! What a dive decided under its load, as its recording tells it and a replay obeys.

use std::collections::{BTreeMap, HashMap};

use echosplat_model::Timestamp;
use serde_json::{Value, json};

/// Pings that found no room.
const PING_SHED: &str = "ping_shed";
/// A ping that was not waited for any longer.
const PING_LET_GO: &str = "ping_let_go";
/// Whether work on the map was put off, from a ping on.
const WORK_SHED: &str = "work_shed";
/// The same of maps and pings to look at; no map depends on it.
const PUBLISHING_SHED: &str = "publishing_shed";

/// What a recorded dive decided.
#[derive(Debug, Default)]
pub(crate) struct Decided {
    /// Pings it left out.
    shed: Runs,
    /// Whether work was put off, from each of these pings on.
    work: HashMap<u64, bool>,
    /// Pings it did not wait for, each with the newest pose there was.
    pub(crate) let_go: HashMap<u64, Timestamp>,
}

impl Decided {
    /// Takes an event of the recording; others say nothing here.
    pub(crate) fn take(&mut self, event: &Value) {
        let (Some(name), Some(ping)) = (event["event"].as_str(), event["ping"].as_u64()) else {
            return;
        };
        match name {
            PING_SHED => self
                .shed
                .add(ping, event["through"].as_u64().unwrap_or(ping)),
            WORK_SHED => {
                let is_shed = event["is_shed"].as_bool();
                self.work.extend(is_shed.map(|is_shed| (ping, is_shed)));
            }
            PING_LET_GO => {
                let newest = event["newest_pose_ns"].as_i64().map(Timestamp::from_nanos);
                self.let_go.extend(newest.map(|newest| (ping, newest)));
            }
            _ => {}
        }
    }

    /// Whether it left this ping out.
    pub(crate) fn leaves_out(&self, ping: u64) -> bool {
        self.shed.contains(ping)
    }

    /// Whether work is put off from this ping on, if that changed there.
    pub(crate) fn work_at(&self, ping: u64) -> Option<bool> {
        self.work.get(&ping).copied()
    }
}

/// Pings from `first` to `last` found no room.
pub(crate) fn pings_shed(first: u64, last: u64) -> Value {
    json!({ "event": PING_SHED, "ping": first, "through": last })
}

pub(crate) fn ping_let_go(ping: u64, newest_pose: Timestamp) -> Value {
    json!({ "event": PING_LET_GO, "ping": ping, "newest_pose_ns": newest_pose.nanos() })
}

pub(crate) fn work_shed(ping: u64, is_shed: bool) -> Value {
    json!({ "event": WORK_SHED, "ping": ping, "is_shed": is_shed })
}

pub(crate) fn publishing_shed(ping: u64, is_shed: bool) -> Value {
    json!({ "event": PUBLISHING_SHED, "ping": ping, "is_shed": is_shed })
}

/// Runs of numbers, the last of each by its first.
#[derive(Debug, Default)]
struct Runs(BTreeMap<u64, u64>);

impl Runs {
    fn add(&mut self, first: u64, last: u64) {
        let known = self.0.entry(first).or_insert(last);
        *known = last.max(*known);
    }

    fn contains(&self, number: u64) -> bool {
        let before = self.0.range(..=number).next_back();
        before.is_some_and(|(_, &last)| number <= last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_dive_wrote_is_what_its_replay_obeys() {
        let mut decided = Decided::default();
        let newest = Timestamp::from_nanos(17);
        for event in [
            pings_shed(3, 5),
            pings_shed(9, 9),
            work_shed(6, true),
            work_shed(11, false),
            publishing_shed(7, true),
            ping_let_go(8, newest),
            // Of recordings that name each ping.
            json!({ "event": "ping_shed", "ping": 20 }),
            json!({ "event": "begin" }),
        ] {
            decided.take(&event);
        }
        let left_out: Vec<u64> = (0..30).filter(|&ping| decided.leaves_out(ping)).collect();
        assert_eq!(left_out, [3, 4, 5, 9, 20]);
        let work: Vec<_> = (0..30).filter_map(|ping| decided.work_at(ping)).collect();
        assert_eq!(work, [true, false]);
        assert_eq!(decided.let_go, HashMap::from([(8, newest)]));
    }
}
