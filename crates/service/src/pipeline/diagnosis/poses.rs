//! What is wrong with the poses.

use std::time::Instant;

use super::{Diagnosis, PATIENCE, loss, warning};
use crate::pipeline::Pace;
use crate::pipeline::notices::Finding;
use crate::pipeline::poses::{PoseReport, Span};
use crate::pipeline::status::Status;

/// A live source that was heard and then is silent for so long has stopped, seconds.
const STOPPED_S: f64 = 1.5;
/// Poses that stay the same to the last bit for so long, while the view changes, are frozen, seconds.
const FROZEN_S: f64 = 1.0;
/// No link delays poses by more and is any use, seconds.
const ODD_LEAD_S: f64 = 0.5;
/// A few poses in another order are the network's; so many more are news.
const STAMPS_REPEATED: u64 = 10;
const NANOS_PER_SECOND: f64 = 1e9;

/// Poses that cannot be what they are read as.
pub(crate) fn frames(status: &Status) -> Option<Finding> {
    let verdict = status.report.frames.as_ref();
    let verdict = verdict.filter(|verdict| verdict.is_telling)?;
    Some(loss("pose-frame", verdict.best.sentence().to_owned()))
}

/// Clock, mount or speed of sound, where the dive shows that they are not as configured.
pub(crate) fn calibration(status: &Status) -> Vec<Finding> {
    let found = status.report.calibration.iter();
    let advice = found.flat_map(|found| &found.advice);
    advice
        .map(|advice| warning(advice.code, advice.sentence.clone()))
        .collect()
}

impl Diagnosis {
    pub(super) fn poses(&mut self, status: &Status, now: Instant, findings: &mut Vec<Finding>) {
        let poses = &status.report.poses;
        findings.extend(self.malformed(poses, now));
        if self.expectations.pace == Pace::Live && self.has_run_for(PATIENCE, now) {
            findings.extend(missing(poses, status.pings_received));
        }
        findings.extend(apart(poses));
        if self.expectations.pace == Pace::Live {
            findings.extend(self.untimely(poses, now));
        }
        findings.extend(self.guarded(poses, now));
        let is_frozen = poses.guard.still_s > FROZEN_S && status.report.listening.view_changes;
        if is_frozen {
            findings.push(loss(
                "poses-frozen",
                format!(
                    "poses have not changed for {:.0} s while what the sonar sees does: the estimator \
                     has stopped; the map is wrong from there on",
                    poses.guard.still_s
                ),
            ));
        }
        findings.extend(frames(status));
        findings.extend(calibration(status));
    }

    fn malformed(&mut self, poses: &PoseReport, now: Instant) -> Option<Finding> {
        let source = &poses.source;
        let bad = source.malformed + source.not_finite + source.bad_quaternion;
        if !self.grows("malformed poses", bad, now) {
            return None;
        }
        let first = source.first_fault.as_deref().unwrap_or("of unknown form");
        Some(loss(
            "poses-malformed",
            format!("{bad} poses so far cannot be used; the first: {first}"),
        ))
    }

    /// Poses that come too rarely, too late, or with stamps that cannot be theirs.
    fn untimely(&mut self, poses: &PoseReport, now: Instant) -> Vec<Finding> {
        let (join, guard) = (&poses.join, &poses.guard);
        let mut findings = Vec::new();
        if self.grows("pings in gaps", join.pings_in_gap, now) {
            findings.push(loss(
                "poses-rare",
                format!(
                    "{} pings so far lie between poses that are too far apart (pose.max_pose_gap_s); \
                     poses come {:.1} times a second: ask for more",
                    join.pings_in_gap, poses.source.rate_hz
                ),
            ));
        }
        let is_late = self.grows("poses too late", join.pings_pose_never_came, now);
        if is_late && poses.source.age_s.is_some_and(|age_s| age_s < STOPPED_S) {
            findings.push(loss(
                "poses-late",
                format!(
                    "{} pings so far were given up before their poses came (pose.max_wait_s); poses \
                     are late, or stamped by another clock",
                    join.pings_pose_never_came
                ),
            ));
        }
        if guard.lead_s.abs() > ODD_LEAD_S {
            findings.push(loss(
                "pose-clock",
                format!(
                    "poses are stamped {:.2} s {} they arrive: the clock of whoever sends them is \
                     wrong, or the link is that slow; set the clock, or --time-offset-s",
                    guard.lead_s.abs(),
                    if guard.lead_s > 0.0 {
                        "after"
                    } else {
                        "before"
                    },
                ),
            ));
        }
        if self.grows("pose order", guard.out_of_order / STAMPS_REPEATED, now) {
            findings.push(loss(
                "pose-stamps-repeat",
                format!(
                    "{} poses so far are stamped no later than the one before and were refused; the \
                     clock that stamps them stands still, or two sources send the same poses",
                    guard.out_of_order
                ),
            ));
        }
        findings
    }

    fn guarded(&mut self, poses: &PoseReport, now: Instant) -> Vec<Finding> {
        let guard = &poses.guard;
        let mut findings = Vec::new();
        if guard.has_second_source() && self.grows("off track", guard.off_track, now) {
            findings.push(loss(
                "second-pose-source",
                format!(
                    "a second source sends poses {:.1} m from the first; {} were refused: end one of \
                     the two, or give each vehicle a --node of its own",
                    guard.off_track_m, guard.off_track
                ),
            ));
        }
        if self.grows("far stamps", guard.stamps_far, now) {
            findings.push(warning(
                "pose-stamps-far",
                format!(
                    "{} poses so far were refused since their stamps are far from the clock; check \
                     the clock of whoever sends them",
                    guard.stamps_far
                ),
            ));
        }
        if self.grows("epochs", guard.epoch.into(), now) {
            let reason = guard
                .epoch_reason
                .as_deref()
                .unwrap_or("the poses began anew");
            findings.push(warning(
                "pose-epoch",
                format!("{reason}: a new map begins, the one before is kept apart"),
            ));
        }
        findings
    }
}

/// No poses at all, no position among them, or no more of them.
fn missing(poses: &PoseReport, pings: u64) -> Option<Finding> {
    let source = &poses.source;
    if let Some(missing) = &source.missing {
        return Some(loss("no-position", missing.clone()));
    }
    let link = source.link.as_deref();
    let link = link.map_or(String::new(), |link| format!(" ({link})"));
    match source.age_s {
        None if source.accepted == 0 && pings > 0 => Some(loss(
            "no-poses",
            format!(
                "no poses from {}{link}, and without them nothing can be mapped; check that something \
                 sends them there, or set pose.url",
                source.source
            ),
        )),
        Some(age_s) if age_s > STOPPED_S => Some(loss(
            "poses-stopped",
            format!(
                "no pose from {} for {age_s:.1} s{link}; pings meanwhile are left out",
                source.source
            ),
        )),
        _ => None,
    }
}

/// Pings and poses that have no time in common.
fn apart(poses: &PoseReport) -> Option<Finding> {
    let (pings, held) = (poses.ping_times?, poses.pose_times?);
    let without = poses.join.pings_without_pose() + poses.waiting as u64;
    let is_apart = pings.first_ns > held.last_ns.saturating_add(2_000_000_000)
        || pings.last_ns < held.first_ns;
    if !is_apart || poses.join.pings_joined > 0 || without < 10 {
        return None;
    }
    let offset_s = held.last_ns.saturating_sub(pings.last_ns) as f64 / NANOS_PER_SECOND;
    Some(loss(
        "pose-times",
        format!(
            "pings and poses have no time in common: pings {}, poses {}; --time-offset-s {offset_s:.3} \
             would join their newest, if both clocks are right otherwise",
            shown(pings),
            shown(held)
        ),
    ))
}

fn shown(span: Span) -> String {
    let seconds = |nanos: i64| nanos as f64 / NANOS_PER_SECOND;
    format!(
        "{:.3} to {:.3} s",
        seconds(span.first_ns),
        seconds(span.last_ns)
    )
}
