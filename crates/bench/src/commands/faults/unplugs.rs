//! The link taken away and brought back, again and again, while one service runs.

use std::time::Duration;

use super::outcome::Outcome;
use super::trial::{Link, Plan, Setup, Trial};
use crate::draw::Draw;

/// Mapping goes on within so long after the link is back.
const BACK_WITHIN_S: f64 = 1.0;
/// Waited for at most, to say how long it took.
const LIMIT: Duration = Duration::from_secs(5);
/// How long it is away and there, seconds.
const AWAY_S: (f64, f64) = (0.05, 0.5);
const THERE_S: (f64, f64) = (0.1, 0.4);

/// `count` times on a service of its own.
pub(super) fn many(setup: &Setup, link: Link, count: usize) -> Outcome {
    let mut outcome = Outcome::new("unplugs", format!("{link:?}, {count} times"));
    if let Err(error) = unplugged(setup, link, count, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn unplugged(setup: &Setup, link: Link, count: usize, outcome: &mut Outcome) -> anyhow::Result<()> {
    let plan = Plan::new(format!("unplugs-{link:?}").to_lowercase(), link);
    let mut trial = Trial::start(setup, &plan)?;
    let map = trial.bus.subscribe_map()?;
    let begins = trial.wait_mapping();
    outcome.expect(begins, || "the service does not begin to map".to_owned());
    let descriptors = trial.descriptor_count();
    let mut draw = Draw::new(setup.seed, 10);
    let (mut longest_s, mut sum_s, mut late) = (0.0_f64, 0.0, 0);
    for _ in 0..count {
        trial.unplug();
        let mut lasts = |(low, high)| Duration::from_secs_f64(draw.finely_between(low, high));
        let (away, there) = (lasts(AWAY_S), lasts(THERE_S));
        trial.pass(away);
        trial.plug_in()?;
        let Some(after_s) = trial.maps_again(LIMIT, Some(&map)) else {
            outcome.expect(false, || {
                format!("nothing was mapped for {LIMIT:?} after the link was back")
            });
            break;
        };
        tracing::debug!(?link, after_s, "maps again");
        late += u32::from(!(after_s <= BACK_WITHIN_S));
        longest_s = longest_s.max(after_s);
        sum_s += after_s;
        trial.pass(there);
    }
    outcome.back_after_s = Some(longest_s);
    outcome.figure("mean s until mapping", sum_s / count.max(1) as f64);
    outcome.figure("longer than 1 s", f64::from(late));
    outcome.expect(late == 0, || {
        format!("{late} times it took longer than {BACK_WITHIN_S} s until mapping")
    });
    trial.pass(Duration::from_secs(1));
    let left = trial.descriptor_count();
    outcome.figure("descriptors before", descriptors as f64);
    outcome.figure("descriptors after", left as f64);
    let is_alive = left > 0 && trial.program.is_running();
    outcome.expect(is_alive, || "the service ended".to_owned());
    outcome.expect(left <= descriptors, || {
        format!("{left} descriptors are open where {descriptors} were")
    });
    trial.leave(outcome);
    Ok(())
}
