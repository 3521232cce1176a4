//! What a running service publishes of itself, and whether every number in it is one.

use std::collections::BTreeSet;
use std::time::Instant;

use echosplat_bus::StatusSubscription;
use serde_json::Value;

/// The statuses of one run.
pub(super) struct Statuses {
    source: StatusSubscription,
    newest: Option<Heard>,
    /// Where there were numbers in a status of a sound run.
    numbers: BTreeSet<String>,
    /// Where one of these was none later: JSON writes NaN and infinities as `null`.
    lost_numbers: BTreeSet<String>,
}

/// A status and when it came.
#[derive(Debug, Clone)]
pub(super) struct Heard {
    pub(super) at: Instant,
    pub(super) status: Value,
}

impl Heard {
    /// A counter, 0 if there is none.
    pub(super) fn count(&self, pointer: &str) -> u64 {
        let value = self.status.pointer(pointer);
        value.and_then(Value::as_u64).unwrap_or(0)
    }

    pub(super) fn mapped(&self) -> u64 {
        self.count("/pings_mapped")
    }
}

impl Statuses {
    pub(super) fn new(source: StatusSubscription) -> Self {
        Self {
            source,
            newest: None,
            numbers: BTreeSet::new(),
            lost_numbers: BTreeSet::new(),
        }
    }

    /// Takes what came; says whether anything did.
    pub(super) fn poll(&mut self) -> bool {
        let Some(status) = self.source.take_newest() else {
            return false;
        };
        visit(&status, &mut String::new(), &mut |path, value| {
            if value.is_null() && self.numbers.contains(path) {
                self.lost_numbers.insert(path.to_owned());
            }
        });
        let at = Instant::now();
        self.newest = Some(Heard { at, status });
        true
    }

    /// From now on, what is a number in the newest status has to stay one.
    pub(super) fn is_sound_now(&mut self) {
        let Some(newest) = &self.newest else { return };
        visit(&newest.status, &mut String::new(), &mut |path, value| {
            if value.is_number() {
                self.numbers.insert(path.to_owned());
            }
        });
    }

    pub(super) fn newest(&self) -> Option<&Heard> {
        self.newest.as_ref()
    }

    pub(super) fn mapped(&self) -> u64 {
        self.newest.as_ref().map_or(0, Heard::mapped)
    }

    /// Names of the figures that were not finite at some time.
    pub(super) fn not_finite(&self) -> &BTreeSet<String> {
        &self.lost_numbers
    }
}

/// Calls `see` with the path and value of each leaf.
fn visit(value: &Value, path: &mut String, see: &mut dyn FnMut(&str, &Value)) {
    let length = path.len();
    match value {
        Value::Object(members) => {
            for (name, member) in members {
                path.push('/');
                path.push_str(name);
                visit(member, path, see);
                path.truncate(length);
            }
        }
        // Lists come and go: their members have no names.
        Value::Array(_) => {}
        leaf => see(path, leaf),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_leaf_is_visited_by_its_path() {
        let mut seen = Vec::new();
        let status = json!({"a": {"b": 1.0, "c": null}, "d": [1]});
        visit(&status, &mut String::new(), &mut |path, value| {
            seen.push((path.to_owned(), value.is_number()));
        });
        assert_eq!(
            seen,
            [("/a/b".to_owned(), true), ("/a/c".to_owned(), false)]
        );
    }
}
