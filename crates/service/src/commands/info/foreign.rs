//! An MCAP file of another program: who wrote it, what is in it, and how its poses are used.

use std::path::Path;

use echosplat_model::Timestamp;
use echosplat_pose::{McapSurvey, McapTopic, TopicPoses};
use serde_json::{Map, Value, json};

use super::pings::span_fact;

/// Topics named; a bag of a whole robot has hundreds.
const MAX_NAMED: usize = 64;

pub(super) fn facts(file: &Path, survey: &McapSurvey) -> Map<String, Value> {
    let mut facts = Map::new();
    let written_by = &survey.written_by;
    let or_unknown = |text: &str| match text {
        "" => Value::Null,
        text => text.into(),
    };
    facts.insert("library".to_owned(), or_unknown(&written_by.library));
    facts.insert("profile".to_owned(), or_unknown(&written_by.profile));
    let topics = survey.topics.iter().take(MAX_NAMED).map(topic);
    facts.insert("topics".to_owned(), topics.collect::<Vec<_>>().into());
    let count = survey.topics.len();
    facts.insert("topic_count".to_owned(), count.into());
    let poses = survey.poses.iter().enumerate();
    let poses = poses.map(|(index, found)| pose_topic(file, found, index == 0));
    facts.insert("pose_topics".to_owned(), poses.collect::<Vec<_>>().into());
    facts.insert("sonar".to_owned(), "none (no topic /sonar/raw)".into());
    let help = match survey.poses.is_empty() {
        true => "none of its topics gives poses".to_owned(),
        false => "echosplat replay LOG.svlog, with the option of one of its pose topics".to_owned(),
    };
    facts.insert("use_with".to_owned(), help.into());
    facts.insert("losses".to_owned(), survey.losses.clone().into());
    facts
}

fn topic(found: &McapTopic) -> Value {
    let mut said = json!({
        "topic": found.topic,
        "schema": found.schema,
        "encoding": found.encoding,
        "messages": found.message_count,
    });
    with_span(&mut said, found.logged);
    if let Some(fault) = &found.fault {
        said["fault"] = fault.as_str().into();
    }
    said
}

fn pose_topic(file: &Path, found: &TopicPoses, is_first: bool) -> Value {
    let mut said = json!({ "topic": found.topic, "poses": found.count });
    with_span(&mut said, found.span);
    if let Some(way) = &found.way {
        said["frames"] = way.as_str().into();
    }
    // The first is taken without a word.
    let topic = (!is_first).then_some(found.topic.as_str());
    said["option"] = option(file, topic).into();
    said
}

fn with_span(said: &mut Value, span: (Timestamp, Timestamp)) {
    if let (Value::Object(span), Value::Object(said)) = (span_fact(Some(span)), said) {
        said.extend(span);
    }
}

/// How poses are taken from this topic of the file.
fn option(file: &Path, topic: Option<&str>) -> String {
    let file = file.display();
    let source = match topic {
        None => file.to_string(),
        Some(topic) => format!("{file}#{topic}"),
    };
    format!("--poses {}", quoted(&source))
}

/// As a shell takes it for one word.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+:,@%".contains(c);
    match word.chars().all(is_plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_for_a_shell_stays_one() {
        assert_eq!(quoted("dives/a.mcap"), "dives/a.mcap");
        assert_eq!(quoted("a b.mcap#/odom"), "'a b.mcap#/odom'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }
}
