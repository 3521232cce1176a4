//! A drill: a part that panics or hangs because its operator asked for it, so that what becomes of
//! that can be tried before it happens at sea. Off unless the environment asks for one.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::LazyLock;
use std::time::Duration;

/// The environment variable that asks for a drill: `PART:panic:FILE` or `PART:hang:FILE`.
pub const VARIABLE: &str = "ECHOSPLAT_DRILL";

/// How long a part that hangs sleeps before it hangs on.
const NAP: Duration = Duration::from_secs(3600);

/// What is to happen to which part, and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drill {
    part: String,
    fault: Fault,
    /// Removed as the fault begins, so that making it again asks for another.
    trigger: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    Panic,
    Hang,
}

/// What the variable says that is no drill.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DrillError {
    found: String,
}

impl std::fmt::Display for DrillError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let found = &self.found;
        write!(
            f,
            "{VARIABLE}={found}: give PART:panic:FILE or PART:hang:FILE, as in \
             mapper:hang:/tmp/now; it happens once FILE is there"
        )
    }
}

impl std::error::Error for DrillError {}

impl Drill {
    /// As the environment asks; `None` where it asks for none.
    ///
    /// # Errors
    /// If the variable holds something else than a drill.
    pub fn asked_for() -> Result<Option<Self>, DrillError> {
        match std::env::var(VARIABLE) {
            Ok(text) => text.parse().map(Some),
            Err(std::env::VarError::NotPresent) => Ok(None),
            Err(std::env::VarError::NotUnicode(found)) => Err(DrillError {
                found: found.to_string_lossy().into_owned(),
            }),
        }
    }

    fn take_part(&self, part: &str) {
        let is_time = self.part == part && std::fs::remove_file(&self.trigger).is_ok();
        if !is_time {
            return;
        }
        match self.fault {
            Fault::Panic => panic!("a drill, asked for by {VARIABLE}"),
            Fault::Hang => loop {
                std::thread::sleep(NAP);
            },
        }
    }
}

impl std::fmt::Display for Drill {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (part, trigger) = (&self.part, self.trigger.display());
        let fault = match self.fault {
            Fault::Panic => "panics",
            Fault::Hang => "hangs",
        };
        write!(f, "the part `{part}` {fault} once {trigger} is there")
    }
}

impl FromStr for Drill {
    type Err = DrillError;

    fn from_str(text: &str) -> Result<Self, DrillError> {
        let mut words = text.splitn(3, ':');
        let (part, fault, trigger) = (words.next(), words.next(), words.next());
        let fault = match fault {
            Some("panic") => Some(Fault::Panic),
            Some("hang") => Some(Fault::Hang),
            _ => None,
        };
        let named = |word: Option<&str>| word.filter(|word| !word.is_empty()).map(str::to_owned);
        match (named(part), fault, named(trigger)) {
            (Some(part), Some(fault), Some(trigger)) => Ok(Self {
                part,
                fault,
                trigger: trigger.into(),
            }),
            _ => Err(DrillError {
                found: text.to_owned(),
            }),
        }
    }
}

/// Called at each beat of each part.
pub(crate) fn at_beat(part: &str) {
    // What cannot be read is refused where the program starts.
    static ASKED: LazyLock<Option<Drill>> = LazyLock::new(|| Drill::asked_for().ok().flatten());
    if let Some(drill) = &*ASKED {
        drill.take_part(part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_drill_is_refused_with_an_example() {
        for text in [
            "",
            "mapper",
            "mapper:hang",
            "mapper:sleep:/tmp/x",
            ":hang:/x",
        ] {
            let refused = text.parse::<Drill>().unwrap_err().to_string();
            assert!(refused.contains("mapper:hang:/tmp/now"), "{refused}");
        }
        let drill: Drill = "sonar:panic:/tmp/a:b".parse().unwrap();
        assert_eq!(drill.trigger, PathBuf::from("/tmp/a:b"));
    }

    #[test]
    fn it_happens_once_and_to_its_part_alone() {
        let folder = tempfile::tempdir().unwrap();
        let trigger = folder.path().join("now");
        let drill = Drill {
            part: "sonar".to_owned(),
            fault: Fault::Panic,
            trigger: trigger.clone(),
        };
        drill.take_part("sonar");
        std::fs::write(&trigger, "").unwrap();
        drill.take_part("mapper");
        assert!(std::panic::catch_unwind(|| drill.take_part("sonar")).is_err());
        drill.take_part("sonar");
        assert!(!trigger.exists());
    }
}
