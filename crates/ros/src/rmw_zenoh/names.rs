//! Names that ROS takes: letters, digits and underscores between slashes, no digit first.

/// Longest name of a topic (`RMW_TOPIC_MAX_NAME_LENGTH`).
const MAX_TOPIC_BYTES: usize = 247;

/// Longest namespace, so that topics in it have room for names of their own.
const MAX_NAMESPACE_BYTES: usize = 200;

/// Why a name is none for ROS.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// A part begins with something else than a letter.
    #[error(
        "{0:?} cannot be part of a ROS name, which begins with a letter from a to z; characters \
         behind it that ROS forbids become underscores"
    )]
    Part(String),
    /// Too long in all.
    #[error("{found} bytes are too many for a ROS name; at most {limit} are taken")]
    TooLong {
        /// Bytes it has.
        found: usize,
        /// Bytes it may have.
        limit: usize,
    },
    /// No name of a topic.
    #[error(
        "{0:?} is no ROS topic: parts of letters, digits and underscores with single slashes \
         between, none beginning with a digit, as in /rov/odom"
    )]
    Topic(String),
}

/// The namespace `/<prefix>/<node>`. Characters that ROS forbids, as in `rov-1`, become underscores.
///
/// # Errors
/// If a part does not begin with a Latin letter: a digit is forbidden there, and what begins with
/// an underscore is hidden. If all is longer than 200 bytes.
pub fn namespace(prefix: &str, node: &str) -> Result<String, NameError> {
    let mut name = String::new();
    for part in prefix.split('/').chain([node]) {
        if !part.starts_with(|first: char| first.is_ascii_alphabetic()) {
            return Err(NameError::Part(part.chars().take(80).collect()));
        }
        name.push('/');
        name.extend(part.chars().map(|c| if is_allowed(c) { c } else { '_' }));
    }
    limited(name, MAX_NAMESPACE_BYTES)
}

/// The whole name of a topic, its slash first whether or not `text` has it.
///
/// # Errors
/// If ROS takes no such name.
pub fn topic_name(text: &str) -> Result<String, NameError> {
    let bare = text.strip_prefix('/').unwrap_or(text);
    let is_part = |part: &str| {
        let begins = part.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_');
        begins && part.chars().all(is_allowed)
    };
    match bare.split('/').all(is_part) {
        true => limited(format!("/{bare}"), MAX_TOPIC_BYTES),
        false => Err(NameError::Topic(text.chars().take(80).collect())),
    }
}

fn is_allowed(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

fn limited(name: String, limit: usize) -> Result<String, NameError> {
    match name.len() {
        found if found > limit => Err(NameError::TooLong { found, limit }),
        _ => Ok(name),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn forbidden_characters_become_underscores() {
        for (prefix, node, expected) in [
            ("echosplat", "vehicle", "/echosplat/vehicle"),
            ("sea/north", "rov-1", "/sea/north/rov_1"),
            ("echosplat", "Reh.über+2", "/echosplat/Reh__ber_2"),
        ] {
            assert_eq!(namespace(prefix, node).as_deref(), Ok(expected));
        }
    }

    #[test]
    fn what_would_be_hidden_or_forbidden_is_refused_by_name() {
        for bad in ["450", "_rov", "-rov", "Ёж", ""] {
            let refused = namespace("echosplat", bad).unwrap_err().to_string();
            assert!(refused.contains(&format!("{bad:?}")), "{refused}");
            assert!(namespace(bad, "rov").is_err(), "{bad}");
        }
        let long = namespace(&vec!["p".repeat(60); 4].join("/"), "rov").unwrap_err();
        assert_eq!(
            long.to_string(),
            "248 bytes are too many for a ROS name; at most 200 are taken"
        );
    }

    #[test]
    fn topics_are_made_absolute() {
        for (text, name) in [
            ("odom", "/odom"),
            ("/rov_1/odom", "/rov_1/odom"),
            ("_a/B2", "/_a/B2"),
        ] {
            assert_eq!(topic_name(text).as_deref(), Ok(name));
        }
    }

    #[test]
    fn topics_that_ros_does_not_take_are_refused() {
        let long = "a".repeat(247);
        for bad in [
            "", "/", "//odom", "odom/", "a//b", "2d", "a/2d", "ö", "a b", "~/x", "a*", &long,
        ] {
            assert!(topic_name(bad).is_err(), "{bad:?}");
        }
    }

    proptest! {
        #[test]
        fn whatever_is_made_of_a_name_is_one_that_ros_takes(prefix in ".{0,40}", node in ".{0,40}") {
            if let Ok(name) = namespace(&prefix, &node) {
                prop_assert_eq!(topic_name(&name), Ok(name));
            }
        }
    }
}
