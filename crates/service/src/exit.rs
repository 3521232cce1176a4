//! How the program ends: its exit codes, and errors that know theirs.

use std::process::ExitCode;

use crate::logging;

/// How a command ended that did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finish {
    /// Done, nothing missing.
    Done,
    /// Done, but what came in was damaged, cut, or left out by more than 1 %.
    Lossy,
}

impl Finish {
    /// 0 or 3.
    #[must_use]
    pub fn code(self) -> ExitCode {
        match self {
            Self::Done => ExitCode::SUCCESS,
            Self::Lossy => ExitCode::from(3),
        }
    }
}

/// The user asked for what cannot be: exit code 2.
#[derive(Debug)]
pub struct Usage {
    /// One line each, at least one.
    faults: Vec<String>,
}

impl Usage {
    /// `message` is one line that says what was wrong, where, and what would be right.
    pub fn error(message: impl std::fmt::Display) -> anyhow::Error {
        Self::faults(vec![message.to_string()])
    }

    /// As [`Usage::error`] for several things at once, a line each.
    pub(crate) fn faults(faults: Vec<String>) -> anyhow::Error {
        anyhow::Error::new(Self { faults })
    }
}

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.faults.join("\n"))
    }
}

impl std::error::Error for Usage {}

/// The end of the program: says what stopped the command, sees that all it said is written, and gives
/// the exit code.
#[must_use]
pub fn end(done: anyhow::Result<Finish>) -> ExitCode {
    let written = logging::finish();
    // What stopped the command counts before what became of its words.
    let ended = done.and_then(|finish| written.map(|()| finish));
    let code = match ended {
        Ok(finish) => finish.code(),
        Err(error) => report(&error),
    };
    logging::flush();
    code
}

/// The same for a command line that is none, or only asks for help.
#[must_use]
pub fn end_with_usage(error: &clap::Error) -> ExitCode {
    logging::print_usage(error);
    match (error.use_stderr(), end(Ok(Finish::Done))) {
        (true, _) => ExitCode::from(2),
        (false, code) => code,
    }
}

fn report(error: &anyhow::Error) -> ExitCode {
    tracing::debug!(?error, "failed");
    for line in lines(error) {
        logging::complain(&line);
    }
    code_of(error)
}

/// 2 for what the user must change, 1 for everything else.
fn code_of(error: &anyhow::Error) -> ExitCode {
    // Whoever ended it while it waited for a pipe has nothing to change.
    let is_usage = error.downcast_ref::<Usage>().is_some() && !echosplat_input::was_ended();
    match is_usage {
        true => ExitCode::from(2),
        false => ExitCode::FAILURE,
    }
}

/// What to say of an error: one line, or one for each fault of a file.
pub(crate) fn lines(error: &anyhow::Error) -> Vec<String> {
    match error.downcast_ref::<Usage>() {
        Some(usage) if usage.faults.len() > 1 => usage.faults.clone(),
        _ => vec![one_line(error)],
    }
}

/// The whole chain of causes as one line, each said once, without the drawings that parsers put
/// between their words.
pub(crate) fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain().map(ToString::to_string) {
        let said = cause.lines().filter(|line| !is_drawing(line));
        let words = said.flat_map(str::split_whitespace);
        let cause = words.collect::<Vec<_>>().join(" ");
        if line.contains(&cause) {
            continue;
        }
        if !line.is_empty() {
            line.push_str(": ");
        }
        line.push_str(&cause);
    }
    line
}

/// `3 | radius = "big"` and the arrows below it.
fn is_drawing(line: &str) -> bool {
    let bare = line
        .trim_start()
        .trim_start_matches(|c: char| c.is_ascii_digit());
    bare.trim_start().starts_with('|')
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn a_chain_is_one_line_and_repeats_nothing() {
        let inner = std::io::Error::other("no\nsuch thing");
        let error = anyhow::Error::new(inner)
            .context("cannot read a.svlog: no such thing")
            .context("replay");
        assert_eq!(
            one_line(&error),
            "replay: cannot read a.svlog: no such thing"
        );
    }

    #[test]
    fn drawings_are_left_out() {
        let error = Usage::error("error at line 3\n  |\n3 | r = \"x\"\n  |     ^\nno number\n");
        assert_eq!(one_line(&error), "error at line 3 no number");
    }

    #[test]
    fn each_fault_of_a_file_is_a_line() {
        let faults = vec!["a.toml:1: x".to_owned(), "a.toml:2: y".to_owned()];
        let error = Usage::faults(faults.clone());
        assert_eq!(lines(&error), faults);
        assert_eq!(lines(&Usage::error("no\nsuch key")), ["no such key"]);
    }

    #[test]
    fn usage_is_found_below_context() {
        let error = Err::<(), _>(Usage::error("no such key")).context("a.toml");
        let code = code_of(&error.unwrap_err());
        assert_eq!(format!("{code:?}"), format!("{:?}", ExitCode::from(2)));
    }
}
