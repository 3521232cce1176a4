//! What the pings of a file have in common.

use std::collections::BTreeMap;

use echosplat_model::{Ping, Timestamp};
use serde_json::{Map, Value, json};

/// Different ranges or gains named; others are counted together.
const MAX_NAMED: usize = 16;

/// Counts pings as they come.
#[derive(Debug, Default)]
pub(super) struct PingTally {
    times: Vec<Timestamp>,
    /// Near and far end in millimetres, and bins.
    ranges: BTreeMap<(i64, i64, usize), u64>,
    gains: BTreeMap<i16, u64>,
}

impl PingTally {
    pub(super) fn insert(&mut self, ping: &Ping) {
        self.times.push(ping.transmit_time());
        let settings = ping.settings();
        let millimetres = |length_m: f64| (length_m * 1e3).round() as i64;
        let range = (
            millimetres(settings.range_start_m),
            millimetres(settings.range_end_m()),
            settings.bin_count,
        );
        *self.ranges.entry(range).or_default() += 1;
        *self.gains.entry(settings.gain_index).or_default() += 1;
    }

    /// Least and greatest time.
    pub(super) fn span(&self) -> Option<(Timestamp, Timestamp)> {
        span_of(self.times.iter().copied())
    }

    /// How many lie in this span.
    pub(super) fn count_within(&self, span: Option<(Timestamp, Timestamp)>) -> usize {
        let Some((first, last)) = span else { return 0 };
        let inside = |time: &&Timestamp| (first..=last).contains(*time);
        self.times.iter().filter(inside).count()
    }

    pub(super) fn facts(&self) -> Map<String, Value> {
        let mut facts = Map::new();
        facts.insert("pings".to_owned(), self.times.len().into());
        facts.insert("ping_span".to_owned(), span_fact(self.span()));
        facts.insert("pings_per_s".to_owned(), self.rate_hz().into());
        let ranges = self.ranges.iter().take(MAX_NAMED);
        let ranges = ranges.map(|((start, end, bins), count)| {
            let metres = |millimetres: i64| millimetres as f64 * 1e-3;
            format!(
                "{} to {} m in {bins} bins: {count} pings",
                metres(*start),
                metres(*end)
            )
        });
        facts.insert("ranges".to_owned(), ranges.collect::<Vec<_>>().into());
        let gains = self.gains.iter().take(MAX_NAMED);
        let gains = gains.map(|(gain, count)| format!("{gain}: {count} pings"));
        facts.insert("gains".to_owned(), gains.collect::<Vec<_>>().into());
        facts
    }

    /// Mean over the span; `None` for fewer than two pings.
    fn rate_hz(&self) -> Option<f64> {
        let (first, last) = self.span()?;
        let span_s = last.seconds_since(first);
        (span_s > 0.0).then(|| (self.times.len() - 1) as f64 / span_s)
    }
}

pub(super) fn span_of(times: impl Iterator<Item = Timestamp>) -> Option<(Timestamp, Timestamp)> {
    times.fold(None, |span, time| match span {
        None => Some((time, time)),
        Some((first, last)) => Some((time.min(first), time.max(last))),
    })
}

/// In seconds, and as dates where they can be some.
pub(super) fn span_fact(span: Option<(Timestamp, Timestamp)>) -> Value {
    let Some((first, last)) = span else {
        return Value::Null;
    };
    json!({
        "first": shown(first),
        "last": shown(last),
        "seconds": last.seconds_since(first),
    })
}

/// Device clocks count from 0: such times are no dates.
fn shown(time: Timestamp) -> String {
    const YEAR_1990: i64 = 631_152_000_000_000_000;
    match time.nanos() > YEAR_1990 {
        true => crate::clock::iso_utc(time),
        false => format!("{:.3} s", time.as_secs_f64()),
    }
}
