//! What the program says: its log and its bars on standard error, its answers on standard output. Both
//! are written by threads of their own, so that a reader who stalls holds up nothing else.

mod frame;
mod limit;
mod lines;
mod output;
mod write;

use std::backtrace::{Backtrace, BacktraceStatus};
use std::ffi::OsStr;
use std::io::{self, Write};
use std::panic::PanicHookInfo;
use std::sync::LazyLock;
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::FmtSpan;

use crate::arguments::{LogFormat, LoggingArguments};
use crate::signals::{self, Attended};
use frame::Canvas;
use limit::Limited;
pub(crate) use limit::warnings_left_out;
use lines::Lines;
use output::Output;

static LINES: Lines = Lines::new();
static OUTPUT: Output = Output::new();
static BARS: LazyLock<MultiProgress> = LazyLock::new(|| {
    let target = match is_terminal() && !is_dumb() {
        true => ProgressDrawTarget::term_like_with_hz(Box::new(Canvas::default()), BARS_PER_S),
        false => ProgressDrawTarget::hidden(),
    };
    MultiProgress::with_draw_target(target)
});

/// How often bars are drawn at most.
const BARS_PER_S: u8 = 20;
/// Longest that the log is waited for before something else is said, and at the end.
const LOG_LIMIT: Duration = Duration::from_secs(3);
/// The same where the program ends at once, and where a part panics.
const AT_ONCE: Duration = Duration::from_millis(250);
/// What is said later stands below what was said before, unless that is not read for so long.
const ANSWER_FIRST: Duration = Duration::from_millis(250);
/// A command that signals only ask to end waits no longer at its end for whoever does not read.
const UNREAD: Duration = Duration::from_secs(10);
/// The same once it was asked.
const UNREAD_WHEN_ASKED: Duration = Duration::from_secs(2);

/// Starts the log. `RUST_LOG` wins over `--verbose`.
pub fn start(arguments: &LoggingArguments) {
    std::panic::set_hook(Box::new(tell_of_panic));
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
        .with_writer(Queued)
        .with_target(false);
    match arguments.log_format {
        LogFormat::Text => subscriber
            .compact()
            .with_ansi(false)
            .map_event_format(Limited::text)
            .init(),
        LogFormat::Json => subscriber.json().map_event_format(Limited::json).init(),
    }
}

/// Whether standard error is one, where figures are renewed in place.
pub(crate) fn is_terminal() -> bool {
    io::IsTerminal::is_terminal(&io::stderr())
}

fn is_colored() -> bool {
    is_terminal() && takes_color()
}

fn takes_color() -> bool {
    !refuses_color(std::env::var_os("NO_COLOR").as_deref())
}

/// As the library of the bars has it: it cannot move its cursor.
fn is_dumb() -> bool {
    std::env::var_os("TERM").is_none_or(|term| term.is_empty() || term == "dumb")
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

/// Prints to standard output, below what was logged before and above any bar. Does not wait for whoever
/// reads slowly; the end of the program does.
pub fn print(text: &str) {
    LINES.hide_frame(true);
    LINES.flush(LOG_LIMIT);
    OUTPUT.push(format!("{text}\n").into_bytes());
    OUTPUT.wait(|still| still > ANSWER_FIRST);
    LINES.hide_frame(false);
}

/// Prints one line to standard error.
pub(crate) fn complain(line: &str) {
    tell(&format!("echosplat: {line}"));
}

/// As it is, but for what could steer a terminal.
fn tell(line: &str) {
    LINES.push((one_line(line) + "\n").into_bytes());
}

/// What clap says of a command line, in its own lines and colours.
pub(crate) fn print_usage(error: &clap::Error) {
    let colored = match error.use_stderr() {
        true => is_colored(),
        false => io::IsTerminal::is_terminal(&io::stdout()) && takes_color(),
    };
    let text = error.render();
    let text = match colored {
        true => text.ansi().to_string(),
        false => text.to_string(),
    };
    match error.use_stderr() {
        true => LINES.push(text.into_bytes()),
        false => print(text.trim_end()),
    }
}

/// Lines of the log that were left out since nobody read them.
pub(crate) fn lines_dropped() -> u64 {
    LINES.dropped_count()
}

/// Waits until all that was printed is written, as long as it takes; where signals no longer end the
/// program by themselves, no longer than 10 s for a reader who takes nothing, 2 s once a signal came.
///
/// # Errors
/// Says what could not be written in full.
pub(crate) fn finish() -> anyhow::Result<()> {
    LINES.hide_frame(true);
    OUTPUT.finish(|still| match signals::attended() {
        Attended::BySystem => false,
        Attended::ByUs => still > UNREAD,
        Attended::Asked => still > UNREAD_WHEN_ASKED,
    })
}

/// Waits for the rest of the log, no longer than a second for a reader who takes nothing.
pub(crate) fn flush() {
    LINES.hide_frame(true);
    LINES.flush(LOG_LIMIT);
}

/// The same where the program ends at once.
pub(crate) fn flush_at_once() {
    LINES.flush(AT_ONCE);
}

/// Writes the rest of the log as it is dropped, so also where the main thread panics.
#[derive(Debug)]
pub struct FlushedAtEnd;

impl Drop for FlushedAtEnd {
    fn drop(&mut self) {
        flush();
    }
}

/// As the standard library tells of a panic, but never waits long for whoever reads.
fn tell_of_panic(panic: &PanicHookInfo<'_>) {
    let thread = std::thread::current();
    let name = thread.name().unwrap_or("without a name");
    // Place and words stand in lines of their own.
    let words = panic.to_string().replacen('\n', " ", 1);
    tell(&format!("the thread `{name}` {words}"));
    let backtrace = Backtrace::capture();
    if backtrace.status() == BacktraceStatus::Captured {
        backtrace.to_string().lines().for_each(tell);
    }
    LINES.flush(AT_ONCE);
}

/// Hands each event on as one line.
struct Queued;

impl<'a> MakeWriter<'a> for Queued {
    type Writer = Line;

    fn make_writer(&'a self) -> Line {
        Line(Vec::new())
    }
}

/// One event's bytes, handed on when it is complete.
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
        LINES.push(line.into_bytes());
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
