//! The log: on standard error, and never through a progress bar.

use std::ffi::OsStr;
use std::io::{self, Write};
use std::sync::LazyLock;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::FmtSpan;

use crate::arguments::{LogFormat, LoggingArguments};

static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Starts the log. `RUST_LOG` wins over `--verbose`.
pub fn start(arguments: &LoggingArguments) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| {
        EnvFilter::new(match arguments.verbose {
            // A session that finds itself while it looks for others says so as an error.
            0 => "info,zenoh=error,zenoh_transport::unicast::establishment=off",
            1 => "debug,zenoh=warn",
            _ => "trace,zenoh=info",
        })
    });
    // With -vv, how long each step of a ping's way took is told as the step ends.
    let told = match arguments.verbose {
        0 | 1 => FmtSpan::NONE,
        _ => FmtSpan::CLOSE,
    };
    let subscriber = tracing_subscriber::fmt()
        .with_span_events(told)
        .with_env_filter(filter)
        .with_writer(AroundBars)
        .with_target(false);
    match arguments.log_format {
        LogFormat::Text => subscriber.compact().with_ansi(false).init(),
        LogFormat::Json => subscriber.json().init(),
    }
}

/// Whether standard error is one, where figures are renewed in place.
pub(crate) fn is_terminal() -> bool {
    io::IsTerminal::is_terminal(&io::stderr())
}

fn is_colored() -> bool {
    is_terminal() && !refuses_color(std::env::var_os("NO_COLOR").as_deref())
}

/// As <https://no-color.org> has it: set, and not to nothing.
fn refuses_color(no_color: Option<&OsStr>) -> bool {
    no_color.is_some_and(|value| !value.is_empty())
}

/// A bar over `length` units; drawn only on a terminal.
pub fn progress_bar(length: u64, template: &str) -> ProgressBar {
    let bar = BARS.add(ProgressBar::new(length));
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar
}

/// A line of figures that is renewed in place; drawn only on a terminal.
pub(crate) fn figures_line() -> ProgressBar {
    let bar = BARS.add(ProgressBar::new_spinner());
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
        bar.set_style(style);
    }
    bar
}

/// Prints to standard output, above any bar. A closed pipe is the reader's choice, not an error.
pub fn print(text: &str) {
    BARS.suspend(|| {
        let mut out = io::stdout().lock();
        let _ = out.write_all(text.as_bytes());
        let _ = out.write_all(b"\n");
        let _ = out.flush();
    });
}

/// Prints one line to standard error, above any bar.
pub(crate) fn complain(line: &str) {
    let line = one_line(&format!("echosplat: {line}\n"));
    BARS.suspend(|| {
        let _ = io::stderr().lock().write_all(line.as_bytes());
    });
}

struct AroundBars;

impl<'a> MakeWriter<'a> for AroundBars {
    type Writer = Line;

    fn make_writer(&'a self) -> Line {
        Line(Vec::new())
    }
}

/// One event's bytes, written at once when it is complete.
struct Line(Vec<u8>);

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        let mut line = one_line(&String::from_utf8_lossy(&self.0));
        if is_colored() {
            line = with_colored_level(&line);
        }
        BARS.suspend(|| {
            let _ = io::stderr().lock().write_all(line.as_bytes());
        });
    }
}

/// One event as one line, whatever came in from outside: no field can forge a line or steer a
/// terminal. Of all control characters only the end of the line stays.
fn one_line(event: &str) -> String {
    let (text, end) = match event.strip_suffix('\n') {
        Some(text) => (text, "\n"),
        None => (event, ""),
    };
    let mut line = String::with_capacity(event.len());
    for c in text.chars() {
        match c.is_control() {
            true => line.extend(c.escape_default()),
            false => line.push(c),
        }
    }
    line + end
}

/// The level, which follows the time, in its colour. The log's library would colour more, but lets
/// colours in fields through.
fn with_colored_level(line: &str) -> String {
    const COLORS: [(&str, &str); 5] = [
        ("ERROR", "31"),
        ("WARN", "33"),
        ("INFO", "32"),
        ("DEBUG", "34"),
        ("TRACE", "35"),
    ];
    let colored = line.split_once(' ').and_then(|(time, rest)| {
        let rest = rest.trim_start();
        let (level, color) = COLORS.iter().find(|(level, _)| rest.starts_with(level))?;
        let words = &rest[level.len()..];
        Some(format!(
            "\u{1b}[2m{time}\u{1b}[0m \u{1b}[{color}m{level:>5}\u{1b}[0m{words}"
        ))
    });
    colored.unwrap_or_else(|| line.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_one_line_and_steers_no_terminal() {
        let forged = "NACK name=a\n2026 INFO all is well\r\u{1b}[2J\u{9b}31m\u{7}\tb größer\n";
        assert_eq!(
            one_line(forged),
            "NACK name=a\\n2026 INFO all is well\\r\\u{1b}[2J\\u{9b}31m\\u{7}\\tb größer\n"
        );
        assert_eq!(one_line("plain"), "plain");
    }

    #[test]
    fn only_the_level_is_colored() {
        let line = with_colored_level("2026-11-22T23:00:00Z  WARN INFO is a name\n");
        assert_eq!(
            line,
            "\u{1b}[2m2026-11-22T23:00:00Z\u{1b}[0m \u{1b}[33m WARN\u{1b}[0m INFO is a name\n"
        );
        assert_eq!(with_colored_level("something else\n"), "something else\n");
    }

    #[test]
    fn no_color_counts_where_it_is_not_empty() {
        assert!(!refuses_color(None) && !refuses_color(Some(OsStr::new(""))));
        assert!(refuses_color(Some(OsStr::new("1"))));
    }
}
