//! What a recording, or one of several read as one, gave and lacks, in words for its owner.

use std::path::PathBuf;

use echosplat_model::Timestamp;

use super::messages::Condition;

/// One recording of those that are read as one dive: a file, or what stands in a file behind the end
/// of another.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Part {
    /// The file, if it was opened by name.
    pub path: Option<PathBuf>,
    /// It stands in its file behind the end of another.
    pub is_behind_another: bool,
    /// How it was.
    pub condition: Condition,
    /// Least and greatest host time of what was taken.
    pub span: Option<(Timestamp, Timestamp)>,
    /// Records taken.
    pub taken_count: u64,
    /// Records left out because one of the parts before gave them.
    pub repeated_count: u64,
    /// Records left out because they do not go on from the parts before.
    pub left_out_count: u64,
    /// Pieces of raw bytes that were recorded and are not there.
    pub missing_count: u64,
    /// Records of the driver that were never recorded, or stand in a part that was not given.
    pub lacking_count: u64,
    /// Records whose content makes no sense.
    pub undecodable_count: u64,
    /// Another run of the service recorded it.
    pub is_of_another_run: bool,
    /// Where it was cut, a later part goes on.
    pub is_continued: bool,
}

impl Part {
    fn name(&self) -> String {
        let name = self.path.as_ref().and_then(|path| path.file_name());
        let name = name.map_or("the recording".into(), |name| name.to_string_lossy());
        match self.is_behind_another {
            true => format!("what stands in {name} behind the end of another recording"),
            false => name.into_owned(),
        }
    }

    /// What was lost or wrong, a sentence each; `goes_on` if somebody else gives what comes after
    /// its end.
    fn losses(&self, goes_on: bool) -> Vec<String> {
        let name = self.name();
        let condition = &self.condition;
        let mut losses = Vec::new();
        let mut say = |is_so: bool, words: String| losses.extend(is_so.then_some(words));
        say(
            condition.is_cut && !self.is_continued && !goes_on,
            format!("{name} ends in the middle: what came after is missing"),
        );
        let bytes = condition.damaged_byte_count;
        say(
            bytes > 0,
            format!("{name} is damaged: {bytes} bytes in it make no record"),
        );
        say(
            bytes == 0 && condition.is_checksum_wrong,
            format!(
                "{name} is damaged: its checksum is wrong, so that something in it is not what was \
                 recorded"
            ),
        );
        let count = self.undecodable_count;
        say(
            count > 0,
            format!("{name} is damaged: {count} records in it make no sense"),
        );
        let count = self.missing_count;
        say(
            count > 0,
            format!("{name} lacks {count} pieces of the sonar's bytes that were recorded"),
        );
        let count = self.lacking_count;
        say(
            count > 0,
            format!("{name} lacks {count} records of the dive before it goes on"),
        );
        let count = self.repeated_count;
        say(
            count > 0,
            format!("{name} repeats {count} records: they were taken once"),
        );
        let count = self.left_out_count;
        say(
            count > 0,
            format!(
                "{name} does not go on from what was read before it: {count} of its records are left \
                 out; if it is of another dive, replay it by itself"
            ),
        );
        say(
            self.is_of_another_run && self.left_out_count == 0,
            format!(
                "{name} is of another run of the service than what was read before it: both went into \
                 one map; if they are two dives, replay each by itself"
            ),
        );
        losses
    }
}

/// What was lost or wrong in the parts of a recording, a sentence each. `goes_on` if somebody else
/// gives what comes after the last one's end.
pub(super) fn losses(parts: &[Part], goes_on: bool) -> Vec<String> {
    let last = parts.len().saturating_sub(1);
    let parts = parts.iter().enumerate();
    parts
        .flat_map(|(index, part)| part.losses(goes_on && index == last))
        .collect()
}
