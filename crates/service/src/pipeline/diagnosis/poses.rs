//! What is wrong with the poses.

use std::time::Instant;

use super::{Diagnosis, PATIENCE, loss, warning};
use crate::pipeline::Pace;
use crate::pipeline::calibration::set_mount;
use crate::pipeline::notices::Finding;
use crate::pipeline::poses::PoseReport;
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
/// More than one sends poses that may be meant.
const SECOND_SOURCE: &str = "second-pose-source";

/// Poses that cannot be what they are read as.
pub(crate) fn frames(status: &Status) -> Option<Finding> {
    let verdict = status.report.frames.as_ref();
    let verdict = verdict.filter(|verdict| verdict.is_telling)?;
    let code = match verdict.best.is_tilt() {
        true => "pose-mount",
        false => "pose-frame",
    };
    Some(loss(code, verdict.best.sentence().to_owned()))
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
    /// Poses, or a mount, that cannot be what they are read as.
    pub(crate) fn frames(&self, status: &Status) -> Option<Finding> {
        let verdict = status.report.frames.as_ref();
        let verdict = verdict.filter(|verdict| verdict.is_telling)?;
        let what = verdict.best.sentence();
        let mount = verdict
            .best
            .mount_instead(&self.pose.vehicle_from_sensor.pose());
        let sentence = mount.map_or_else(
            || what.to_owned(),
            |mount| format!("{what}: {}", set_mount(mount)),
        );
        Some(loss("pose-frame", sentence))
    }

    pub(super) fn poses(&mut self, status: &Status, now: Instant, findings: &mut Vec<Finding>) {
        let poses = &status.report.poses;
        findings.extend(self.malformed(poses, now));
        if self.expectations.pace == Pace::Live && self.has_run_for(PATIENCE, now) {
            findings.extend(missing(poses, status.pings_received));
        }
        let unit = self.unit(poses);
        if unit.is_some() {
            findings.extend(unit);
            return;
        }
        findings.extend(self.stamps(poses, now));
        if self.expectations.pace == Pace::Live {
            findings.extend(self.untimely(status, now));
        }
        match &poses.source.several {
            Some(several) => findings.push(Finding {
                code: SECOND_SOURCE.into(),
                sentence: several.sentence.clone(),
                is_loss: several.leaves_out,
            }),
            None => findings.extend(self.second_source(poses, now)),
        }
        findings.extend(self.guarded(poses, now));
        findings.extend(self.covariances(status, now));
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
        findings.extend(self.frames(status));
        findings.extend(calibration(status));
    }

    fn malformed(&mut self, poses: &PoseReport, now: Instant) -> Option<Finding> {
        let source = &poses.source;
        let bad = source.malformed + source.not_finite + source.bad_quaternion;
        if !self.grows("malformed poses", bad, now) {
            return None;
        }
        let first = source.first_fault.as_deref().unwrap_or("of unknown form");
        let sentence = format!("{bad} poses so far cannot be used; the first: {first}");
        // What a file leaves out costs only the pings beside it, which are counted.
        let is_loss = self.expectations.pace == Pace::Live;
        Some(match is_loss {
            true => loss("poses-malformed", sentence),
            false => warning("poses-malformed", sentence),
        })
    }

    /// Poses that come too rarely, or too late.
    fn untimely(&mut self, status: &Status, now: Instant) -> Vec<Finding> {
        let poses = &status.report.poses;
        let is_explained = self.is_refusing(poses, now);
        let join = &poses.join;
        let mut findings = Vec::new();
        let in_gaps = self.grows("pings in gaps", join.pings_in_gap, now);
        let late = self.grows("poses too late", join.pings_pose_never_came, now);
        if is_explained {
            return findings;
        }
        if in_gaps {
            findings.push(self.rare(poses));
        }
        if late && poses.source.age_s.is_some_and(|age_s| age_s < STOPPED_S) {
            findings.push(self.late(status));
        }
        findings
    }

    /// Poses of two tracks, of senders that nothing else tells apart.
    fn second_source(&mut self, poses: &PoseReport, now: Instant) -> Option<Finding> {
        let guard = &poses.guard;
        let is_told = guard.has_second_source() && self.grows("off track", guard.off_track, now);
        is_told.then(|| {
            loss(
                SECOND_SOURCE,
                format!(
                    "a second source sends poses {:.1} m from the first; {} were refused: end one of \
                     the two, or give each vehicle a --node of its own",
                    guard.off_track_m, guard.off_track
                ),
            )
        })
    }

    fn guarded(&mut self, poses: &PoseReport, now: Instant) -> Vec<Finding> {
        let guard = &poses.guard;
        let mut findings = Vec::new();
        if self.grows("far stamps", guard.stamps_far, now) {
            findings.push(warning(
                "pose-stamps-far",
                format!(
                    "{} poses so far were refused since their stamps are far from the clock of those around \
                     them, the newest {:+.2} s off; check the clock of whoever sends them, and that nobody else does",
                    guard.stamps_far, guard.stamp_off_s
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

/// Where covariances cost the map something.
impl Diagnosis {
    fn covariances(&mut self, status: &Status, now: Instant) -> Option<Finding> {
        let told = &status.report.poses.covariances;
        let is_used = told.given > told.ignored;
        let unplaced = status.report.mapper.pings_unplaced;
        let leaves_out = self.grows("pings unplaced", unplaced, now) && is_used;
        let smears = self.grows("pings smeared", told.pings_smeared, now);
        let costs = match (leaves_out, smears) {
            (true, _) => {
                format!("{unplaced} pings so far are left out, their place not being known")
            }
            (_, true) => format!("{} pings so far count less", told.pings_smeared),
            _ => return None,
        };
        let sentence = format!(
            "the covariance of the poses rose faster than it grows all along, by {:.2} m (one sigma) within \
             mapper.pose_error_time_s: {costs}; if the poses are better than they say, set \
             pose.covariances = \"ignore\"",
            told.newest_smear_m
        );
        Some(match leaves_out {
            true => loss("pose-covariance", sentence),
            false => warning("pose-covariance", sentence),
        })
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
