//! What is wrong with the stamps of poses: none at all, another unit, another clock.

use std::time::Instant;

use super::{Diagnosis, loss};
use crate::config::MOST_OFFSET_S;
use crate::pipeline::Pace;
use crate::pipeline::notices::Finding;
use crate::pipeline::poses::{PoseReport, Span};

/// No link delays poses by more and is any use, seconds.
const ODD_LEAD_S: f64 = 0.5;
/// A few poses in another order are the network's; so many more are news.
const STAMPS_REPEATED: u64 = 10;
const NANOS_PER_SECOND: f64 = 1e9;
/// Units that stamps are in by mistake, and how many nanoseconds each has.
const OTHER_UNITS: [(&str, i64); 3] = [
    ("seconds", 1_000_000_000),
    ("milliseconds", 1_000_000),
    ("microseconds", 1_000),
];
/// Stamps that come this near to the pings' times in another unit are in that unit: a day.
const SAME_DAY_NS: u64 = 86_400_000_000_000;

/// That stamps say no time, and what to send instead; `None` where they do.
pub(crate) fn no_time(poses: &PoseReport) -> Option<String> {
    unstamped(poses).or_else(|| in_another_unit(poses))
}

impl Diagnosis {
    /// Stamps in another unit, which explain all else that is odd about poses.
    pub(super) fn unit(&self, poses: &PoseReport) -> Option<Finding> {
        let is_live = self.expectations.pace == Pace::Live;
        let sentence = in_another_unit(poses).filter(|_| is_live)?;
        Some(loss("pose-stamp-unit", sentence))
    }

    pub(super) fn stamps(&mut self, poses: &PoseReport, now: Instant) -> Vec<Finding> {
        let mut findings = Vec::new();
        let zero_grows = self.grows("zero stamps", poses.guard.stamps_zero, now);
        if let Some(sentence) = unstamped(poses).filter(|_| zero_grows) {
            findings.push(loss("pose-stamps-zero", sentence));
        }
        let repeats = poses.guard.out_of_order / STAMPS_REPEATED;
        let repeat_grows = self.grows("pose order", repeats, now);
        findings.extend(self.apart(poses).or_else(|| self.clock(poses)));
        if self.expectations.pace == Pace::Live && repeat_grows {
            findings.push(loss(
                "pose-stamps-repeat",
                format!(
                    "{} poses so far are stamped no later than the one before and were refused; the \
                     clock that stamps them stands still, or two sources send the same poses",
                    poses.guard.out_of_order
                ),
            ));
        }
        findings
    }

    /// Pings and poses that have no time in common.
    fn apart(&self, poses: &PoseReport) -> Option<Finding> {
        let (pings, held) = (poses.ping_times?, poses.pose_times?);
        let asked = pings.moved_by(self.pose.time_offset_s);
        let without = poses.join.pings_without_pose() + poses.waiting as u64;
        let is_apart = asked.first_ns > held.last_ns.saturating_add(2_000_000_000)
            || asked.last_ns < held.first_ns;
        if !is_apart || poses.join.pings_joined > 0 || without < 10 {
            return None;
        }
        let (offset_s, ends) = offset(poses, pings, held);
        let advice = match offset_s.abs() <= MOST_OFFSET_S {
            true => format!("--time-offset-s {offset_s:.3} would join their {ends}"),
            false => "one of the two clocks tells no time; set it".to_owned(),
        };
        Some(loss(
            "pose-times",
            format!(
                "pings and poses have no time in common: pings {}, poses {}; {advice}",
                pings.shown(),
                held.shown()
            ),
        ))
    }

    /// Poses stamped by a clock that is not the host's, beyond what is set.
    fn clock(&self, poses: &PoseReport) -> Option<Finding> {
        let lead_s = poses.guard.lead_s;
        let is_known = lead_s.abs() > 0.0 && self.expectations.pace == Pace::Live;
        let is_odd = (lead_s - self.pose.time_offset_s).abs() > ODD_LEAD_S;
        (is_known && is_odd).then(|| {
            let what = match lead_s > 0.0 {
                true => "after they arrive: the clock of whoever sends them is ahead",
                false => {
                    "before they arrive: the clock of whoever sends them is behind, or the link is that slow"
                }
            };
            let set = match self.pose.time_offset_s.abs() > 0.0 {
                true => format!(" (pose.time_offset_s is {})", self.pose.time_offset_s),
                false => String::new(),
            };
            loss(
                "pose-clock",
                format!(
                    "poses are stamped {:.2} s {what}{set}; set the clock, or --time-offset-s {lead_s:.3} \
                     if it is the clock",
                    lead_s.abs()
                ),
            )
        })
    }
}

/// What is to be added to the pings' times, and what of both it joins. What poses lead their arrival by is told apart
/// from how long they take; a file's are all there at once.
fn offset(poses: &PoseReport, pings: Span, held: Span) -> (f64, &'static str) {
    let between_s = |held: i64, ping: i64| held.saturating_sub(ping) as f64 / NANOS_PER_SECOND;
    let lead_s = poses.guard.lead_s;
    let newest = "newest, if both clocks are right otherwise";
    if lead_s.abs() > 0.0 {
        (lead_s, newest)
    } else if poses.source.age_s.is_some() {
        (between_s(held.last_ns, pings.last_ns), newest)
    } else {
        (
            between_s(held.first_ns, pings.first_ns),
            "beginnings, which is right if both began together",
        )
    }
}

fn unstamped(poses: &PoseReport) -> Option<String> {
    let (count, taken) = (poses.guard.stamps_zero, poses.join.poses_taken);
    let which = match taken {
        0 => format!("all {count} poses so far are"),
        _ => format!("{count} poses so far, beside {taken} that are not, are"),
    };
    (count > 0).then(|| {
        format!(
            "{which} stamped 0 and were refused: whoever sends them leaves their time out; each needs the Unix \
             time at which the vehicle was there (stamp_ns, or the stamp in the header of a ROS message)"
        )
    })
}

fn in_another_unit(poses: &PoseReport) -> Option<String> {
    let (pings, held) = (poses.ping_times?, poses.pose_times?);
    let is_apart = held.last_ns.abs_diff(pings.last_ns) > SAME_DAY_NS;
    let is_near = |stamp: i64, ping: i64, nanos: i64| {
        let meant = stamp.checked_mul(nanos);
        meant.is_some_and(|meant| meant.abs_diff(ping) < SAME_DAY_NS)
    };
    // Both ends: a clock that began at nothing comes past such a number, and does not stay.
    let (unit, nanos) = OTHER_UNITS.iter().find(|(_, nanos)| {
        is_near(held.first_ns, pings.first_ns, *nanos)
            && is_near(held.last_ns, pings.last_ns, *nanos)
    })?;
    if !is_apart {
        return None;
    }
    Some(format!(
        "poses are stamped {}, which is the time in {unit}, and has to be in nanoseconds: send {}, {nanos} times \
         as much",
        held.last_ns,
        held.last_ns.saturating_mul(*nanos)
    ))
}

impl Span {
    fn moved_by(self, seconds: f64) -> Self {
        let nanos = (seconds * NANOS_PER_SECOND) as i64;
        Self {
            first_ns: self.first_ns.saturating_add(nanos),
            last_ns: self.last_ns.saturating_add(nanos),
        }
    }

    fn shown(self) -> String {
        let seconds = |nanos: i64| nanos as f64 / NANOS_PER_SECOND;
        format!(
            "{:.3} to {:.3} s",
            seconds(self.first_ns),
            seconds(self.last_ns)
        )
    }
}
