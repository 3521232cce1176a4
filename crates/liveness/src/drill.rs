//! A drill: a part that panics or hangs because its operator asked for it, so that what becomes of
//! that can be tried before it happens at sea. Off unless the environment asks for one and the command
//! arms it.

use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, SystemTime};

/// The environment variable that asks for a drill: `PART:panic:FILE` or `PART:hang:FILE`.
pub const VARIABLE: &str = "ECHOSPLAT_DRILL";

/// How long a part that hangs sleeps before it hangs on.
const NAP: Duration = Duration::from_secs(3600);

/// The one that is armed.
static ARMED: OnceLock<Armed> = OnceLock::new();

/// What is to happen to which part, and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drill {
    part: String,
    fault: Fault,
    /// Only looked at.
    trigger: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    Panic,
    Hang,
}

/// What the variable says that is no drill.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DrillError {
    /// It has another form.
    Form {
        /// What it says.
        found: String,
    },
    /// There is no such part.
    Part {
        /// The one it names.
        found: String,
        /// Those there are, separated by commas.
        known: String,
    },
}

impl std::fmt::Display for DrillError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Form { found } => write!(
                f,
                "{VARIABLE}={found}: give PART:panic:FILE or PART:hang:FILE, as in \
                 mapper:hang:/tmp/now; it happens once FILE is made or touched"
            ),
            Self::Part { found, known } => {
                write!(
                    f,
                    "{VARIABLE}: no part is called `{found}`; there are {known}"
                )
            }
        }
    }
}

impl std::error::Error for DrillError {}

impl Drill {
    /// As the environment asks, of one of these parts; `None` where it asks for none.
    ///
    /// # Errors
    /// If the variable holds something else than a drill, or names no such part.
    pub fn asked_for(parts: &[&str]) -> Result<Option<Self>, DrillError> {
        let text = match std::env::var(VARIABLE) {
            Ok(text) => text,
            Err(std::env::VarError::NotPresent) => return Ok(None),
            Err(std::env::VarError::NotUnicode(found)) => found.to_string_lossy().into_owned(),
        };
        Self::parse(&text, parts).map(Some)
    }

    fn parse(text: &str, parts: &[&str]) -> Result<Self, DrillError> {
        let mut words = text.splitn(3, ':');
        let (part, fault, trigger) = (words.next(), words.next(), words.next());
        let fault = match fault {
            Some("panic") => Some(Fault::Panic),
            Some("hang") => Some(Fault::Hang),
            _ => None,
        };
        let named = |word: Option<&str>| word.filter(|word| !word.is_empty()).map(str::to_owned);
        let (Some(part), Some(fault), Some(trigger)) = (named(part), fault, named(trigger)) else {
            return Err(DrillError::Form {
                found: text.to_owned(),
            });
        };
        if !parts.contains(&part.as_str()) {
            return Err(DrillError::Part {
                found: part,
                known: parts.join(", "),
            });
        }
        Ok(Self {
            part,
            fault,
            trigger: trigger.into(),
        })
    }

    /// From now on it happens at the part's first beat after the file was made or touched, each time
    /// anew. A file that is there already is none that was made for it.
    pub fn arm(self) {
        // One at a time: the program asks once.
        let _ = ARMED.set(Armed::new(self));
    }

    /// The one that is armed.
    #[must_use]
    pub fn armed() -> Option<&'static Self> {
        ARMED.get().map(|armed| &armed.drill)
    }
}

impl std::fmt::Display for Drill {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (part, trigger) = (&self.part, self.trigger.display());
        let fault = match self.fault {
            Fault::Panic => "panics",
            Fault::Hang => "hangs",
        };
        write!(
            f,
            "the part `{part}` {fault} once {trigger} is made or touched"
        )
    }
}

#[derive(Debug)]
struct Armed {
    drill: Drill,
    seen: Mutex<Option<Stamp>>,
}

impl Armed {
    fn new(drill: Drill) -> Self {
        let seen = Mutex::new(Stamp::of(&drill.trigger));
        Self { drill, seen }
    }

    fn take_part(&self, part: &str) {
        if self.drill.part != part || !self.is_time() {
            return;
        }
        tracing::warn!("the drill begins: {}", self.drill);
        match self.drill.fault {
            Fault::Panic => panic!("a drill, asked for by {VARIABLE}"),
            Fault::Hang => loop {
                std::thread::sleep(NAP);
            },
        }
    }

    fn is_time(&self) -> bool {
        let found = Stamp::of(&self.drill.trigger);
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let before = std::mem::replace(&mut *seen, found);
        found.is_some() && found != before
    }
}

/// Tells a file from the one that was there before, and from itself before it was touched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stamp {
    modified: Option<SystemTime>,
    number: u64,
}

impl Stamp {
    /// `None` where there is no file.
    fn of(path: &Path) -> Option<Self> {
        let metadata = std::fs::metadata(path).ok()?;
        Some(Self {
            modified: metadata.modified().ok(),
            number: number(&metadata),
        })
    }
}

#[cfg(unix)]
fn number(metadata: &Metadata) -> u64 {
    std::os::unix::fs::MetadataExt::ino(metadata)
}

#[cfg(not(unix))]
fn number(_: &Metadata) -> u64 {
    0
}

/// Called at each beat of each part.
pub(crate) fn at_beat(part: &str) {
    if let Some(armed) = ARMED.get() {
        armed.take_part(part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARTS: [&str; 2] = ["mapper", "sonar"];

    fn parsed(text: &str) -> Result<Drill, String> {
        Drill::parse(text, &PARTS).map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_no_drill_is_refused_with_an_example() {
        for text in [
            "",
            "mapper",
            "mapper:hang",
            "mapper:sleep:/tmp/x",
            ":hang:/x",
        ] {
            let refused = parsed(text).unwrap_err();
            assert!(refused.contains("mapper:hang:/tmp/now"), "{refused}");
        }
        let drill = parsed("sonar:panic:/tmp/a:b").unwrap();
        assert_eq!(drill.trigger, PathBuf::from("/tmp/a:b"));
        let refused = parsed("maper:panic:/tmp/a").unwrap_err();
        assert!(
            refused.contains("`maper`") && refused.contains("mapper, sonar"),
            "{refused}"
        );
    }

    #[test]
    fn it_happens_to_its_part_alone_each_time_the_file_is_made_or_touched_and_leaves_it() {
        let folder = tempfile::tempdir().unwrap();
        let trigger = folder.path().join("now");
        std::fs::write(&trigger, "precious").unwrap();
        let armed = Armed::new(Drill {
            part: "sonar".to_owned(),
            fault: Fault::Panic,
            trigger: trigger.clone(),
        });
        let happens = || std::panic::catch_unwind(|| armed.take_part("sonar")).is_err();
        assert!(!happens(), "it was there before");
        let touched = |seconds| {
            let file = std::fs::File::options().write(true).open(&trigger).unwrap();
            let at = SystemTime::UNIX_EPOCH + Duration::from_secs(seconds);
            file.set_modified(at).unwrap();
        };
        touched(1_000);
        armed.take_part("mapper");
        assert!(happens() && !happens());
        touched(2_000);
        assert!(happens() && !happens());
        assert_eq!(std::fs::read_to_string(&trigger).unwrap(), "precious");
        std::fs::remove_file(&trigger).unwrap();
        assert!(!happens());
        std::fs::write(&trigger, "").unwrap();
        assert!(happens());
    }
}
