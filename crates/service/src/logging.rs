//! The log: on standard error, and never through a progress bar.

use std::io::{self, Write};
use std::sync::LazyLock;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

use crate::arguments::{LogFormat, LoggingArguments};

static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Starts the log. `RUST_LOG` wins over `--verbose`.
pub(crate) fn start(arguments: &LoggingArguments) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| {
        EnvFilter::new(match arguments.verbose {
            // A session that finds itself while it looks for others says so as an error.
            0 => "info,zenoh=error,zenoh_transport::unicast::establishment=off",
            1 => "debug,zenoh=warn",
            _ => "trace,zenoh=info",
        })
    });
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(AroundBars)
        .with_target(false);
    match arguments.log_format {
        LogFormat::Text => subscriber.compact().with_ansi(is_terminal()).init(),
        LogFormat::Json => subscriber.json().init(),
    }
}

fn is_terminal() -> bool {
    io::IsTerminal::is_terminal(&io::stderr())
}

/// A bar over `length` units; drawn only on a terminal.
pub(crate) fn progress_bar(length: u64, template: &str) -> ProgressBar {
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
pub(crate) fn print(text: &str) {
    BARS.suspend(|| {
        let mut out = io::stdout().lock();
        let _ = out.write_all(text.as_bytes());
        let _ = out.write_all(b"\n");
        let _ = out.flush();
    });
}

/// Prints one line to standard error, above any bar.
pub(crate) fn complain(line: &str) {
    BARS.suspend(|| {
        let _ = writeln!(io::stderr().lock(), "echosplat: {line}");
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
        BARS.suspend(|| {
            let _ = io::stderr().lock().write_all(&self.0);
        });
    }
}
