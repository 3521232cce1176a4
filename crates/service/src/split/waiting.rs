//! Before a driver is met: what is said, and what is in the way.

use std::time::{Duration, Instant};

use echosplat_bus::{Heard, TapeFollower, TapeTrouble};
use serde_json::Value;

use super::begin::Begin;
use super::tape::LOOK;
use crate::signals::Stop;

/// How often it is said that the driver is waited for.
const WAITING_SAID_EVERY: Duration = Duration::from_secs(10);
/// Other trouble than before is said no more often than this.
const NEWS_SAID_EVERY: Duration = Duration::from_secs(3);

/// Until a driver says how the sonar is asked; `None` if it was asked to stop before.
///
/// # Errors
/// If the bus is closed.
pub(super) fn wait_for_driver(
    follower: &mut TapeFollower,
    stop: &Stop,
) -> anyhow::Result<Option<(Begin, Heard)>> {
    let mut waiting = Waiting::default();
    while !stop.is_set() {
        waiting.tell(follower.trouble(), Instant::now());
        let Some(heard) = follower.hear(LOOK)? else {
            continue;
        };
        let told = heard.begin.clone().unwrap_or_default();
        let Some(begin) = Begin::read(&told) else {
            follower.refuse(not_a_driver(&told));
            continue;
        };
        tracing::info!(sonar = %begin.sonar, "the driver is there");
        return Ok(Some((begin, heard)));
    }
    Ok(None)
}

/// What is said while no driver is there.
#[derive(Default)]
struct Waiting {
    /// When, and of what trouble.
    said: Option<(Instant, Option<TapeTrouble>)>,
}

impl Waiting {
    /// Says now and then what is waited for, and what is in the way as soon as something is.
    fn tell(&mut self, trouble: Option<&TapeTrouble>, now: Instant) {
        let is_due = self.said.as_ref().is_none_or(|(at, before)| {
            let since = now.saturating_duration_since(*at);
            let is_news = trouble.is_some() && trouble != before.as_ref();
            since >= WAITING_SAID_EVERY
                || (is_news && since >= NEWS_SAID_EVERY)
                || (is_news && before.is_none())
        });
        if !is_due {
            return;
        }
        self.said = Some((now, trouble.cloned()));
        match trouble {
            Some(trouble) => tracing::warn!("no driver that can be followed yet: {trouble}"),
            None => tracing::info!(
                "waiting for the driver of this node (--role driver): is it started, under the \
                 same --prefix and --node, and is zenoh reached?"
            ),
        }
    }
}

/// What is wrong with what told this.
pub(super) fn not_a_driver(told: &Value) -> String {
    let told: String = told.to_string().chars().take(200).collect();
    format!("it begins with {told}, which no driver of this version does")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How often something is said in so many looks of 50 ms.
    fn said(looks: u64, trouble: impl Fn(u64) -> Option<TapeTrouble>) -> usize {
        let (begin, mut waiting, mut count) = (Instant::now(), Waiting::default(), 0);
        for look in 0..looks {
            let now = begin + Duration::from_millis(50 * look);
            waiting.tell(trouble(look).as_ref(), now);
            count += usize::from(waiting.said.as_ref().is_some_and(|(at, _)| *at == now));
        }
        count
    }

    #[test]
    fn what_is_in_the_way_is_said_at_once_and_fills_no_log() {
        let unreadable = |why: u64| Some(TapeTrouble::Unreadable(why.to_string()));
        assert_eq!(said(400, |_| None), 2);
        assert_eq!(said(400, |_| unreadable(1)), 2);
        assert_eq!(
            said(20, |look| (look > 3).then(|| unreadable(1)).flatten()),
            2
        );
        assert!(said(400, unreadable) <= 8);
    }
}
