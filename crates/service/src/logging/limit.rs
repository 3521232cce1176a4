//! Warnings of one kind are told a few times and then ever more rarely, each with how many were left out: nothing that comes
//! in from outside fills a log.

use std::collections::HashMap;
use std::fmt::{self, Debug};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use echosplat_model::{RateLimit, Timestamp};
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

use crate::clock;

/// Kinds of warnings that are told apart; whatever comes after these is of one kind.
const MOST_KINDS: usize = 512;

static LEFT_OUT: AtomicU64 = AtomicU64::new(0);

/// Warnings that the log left out so far.
pub(crate) fn warnings_left_out() -> u64 {
    LEFT_OUT.load(Ordering::Relaxed)
}

/// Formats events as `inner` does, and not all warnings.
pub(crate) struct Limited<F> {
    inner: F,
    is_json: bool,
    kinds: Kinds,
}

impl<F> Limited<F> {
    pub(crate) fn text(inner: F) -> Self {
        Self {
            inner,
            is_json: false,
            kinds: Kinds::default(),
        }
    }

    pub(crate) fn json(inner: F) -> Self {
        Self {
            is_json: true,
            ..Self::text(inner)
        }
    }

    fn with_left_out(&self, line: &str, left_out: u64) -> String {
        let line = line.trim_end_matches('\n');
        match (self.is_json, line.strip_suffix('}')) {
            (true, Some(open)) => format!("{open},\"left_out\":{left_out}}}\n"),
            _ => format!("{line} ({left_out} like it were left out)\n"),
        }
    }
}

impl<S, N, F> FormatEvent<S, N> for Limited<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        if *event.metadata().level() != Level::WARN {
            return self.inner.format_event(context, writer, event);
        }
        let mut kind = Kind::default();
        event.record(&mut kind);
        let Some(left_out) = self.kinds.admit(kind.0, clock::now()) else {
            LEFT_OUT.fetch_add(1, Ordering::Relaxed);
            return Ok(());
        };
        if left_out == 0 {
            return self.inner.format_event(context, writer, event);
        }
        let mut line = String::new();
        self.inner
            .format_event(context, Writer::new(&mut line), event)?;
        writer.write_str(&self.with_left_out(&line, left_out))
    }
}

/// What a warning says, but for its numbers.
#[derive(Default)]
struct Kind(String);

impl Visit for Kind {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if ["message", "notice"].contains(&field.name()) {
            let text = format!("{value:?} ");
            self.0.extend(text.chars().filter(|c| !is_of_number(*c)));
        }
    }
}

fn is_of_number(c: char) -> bool {
    c.is_ascii_digit() || ".-+".contains(c)
}

/// How often each kind came.
#[derive(Default)]
struct Kinds(Mutex<HashMap<String, RateLimit>>);

impl Kinds {
    /// As [`RateLimit::admit`].
    fn admit(&self, kind: String, now: Timestamp) -> Option<u64> {
        let mut kinds = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_full = kinds.len() >= MOST_KINDS && !kinds.contains_key(&kind);
        let kind = if is_full { String::new() } else { kind };
        kinds.entry(kind).or_default().admit(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_one_kind_is_told_a_few_times_and_hides_no_other() {
        let kinds = Kinds::default();
        let at = |i: i64| Timestamp::from_millis(1_700_000_000_000 + 20 * i);
        let told = (0..3_000).filter(|i| kinds.admit("a new epoch".to_owned(), at(*i)).is_some());
        assert_eq!(
            told.count(),
            5,
            "three at once, then after 10 and 30 s of a minute"
        );
        assert_eq!(
            kinds.admit("the disk is full".to_owned(), at(3_000)),
            Some(0)
        );
        for i in 0..10_000 {
            kinds.admit(format!("forged {}", "x".repeat(i % 1_000)), at(3_001));
        }
        assert!(kinds.0.lock().unwrap().len() <= MOST_KINDS + 1);
    }

    #[test]
    fn what_was_left_out_is_counted_where_the_next_is_told() {
        let text = Limited::text(()).with_left_out("WARN a new epoch\n", 7);
        assert_eq!(text, "WARN a new epoch (7 like it were left out)\n");
        let json = Limited::json(()).with_left_out("{\"level\":\"WARN\"}\n", 7);
        assert_eq!(json, "{\"level\":\"WARN\",\"left_out\":7}\n");
    }
}
