//! What is wrong with the poses.

use std::time::{Duration, Instant};

use super::{Diagnosis, NEWS, PATIENCE, loss, warning};
use crate::pipeline::Pace;
use crate::pipeline::calibration::set_mount;
use crate::pipeline::notices::Finding;
use crate::pipeline::poses::PoseReport;
use crate::pipeline::status::Status;

/// A live source that was heard and then is silent for so long has stopped, seconds.
const STOPPED_S: f64 = 1.5;
/// Poses that stay the same to the last bit for so long, while the view changes, are frozen, seconds.
const FROZEN_S: f64 = 1.0;
/// The longest that pings can be told to wait, seconds, and the most that can wait.
const MOST_WAIT_S: f64 = 3599.0;
const MOST_WAITING: f64 = 65_536.0;
/// More than one sends poses that may be meant.
const SECOND_SOURCE: &str = "second-pose-source";

/// Clock, mount or speed of sound, where the dive shows that they are not as configured.
pub(crate) fn calibration(status: &Status) -> Vec<Finding> {
    let found = status.report.calibration.iter();
    let advice = found.flat_map(|found| &found.advice);
    advice
        .map(|advice| warning(advice.code, advice.sentence.clone()))
        .collect()
}

/// Shifts of a drift below this are not worth a word, metres.
const TOLD_SHIFT_M: f64 = 0.1;

/// Poses that drift, and whether they are corrected.
fn drift(status: &Status) -> Option<Finding> {
    let drift = status.report.mapper.drift;
    let told = |sentence| Some(warning("pose-drift", sentence));
    if drift.is_corrected && drift.longest_shift_m >= TOLD_SHIFT_M {
        let [x, y, _] = drift.shift_m;
        return told(format!(
            "poses drift against what the sonar hears: the map corrects them, by {:.2} m and {:.1}° now and up to {:.2} m so far; \
             the dive is mapped again with them, and smoothed when it ends (mapper.parts.drift = \"off\" leaves poses as they come)",
            x.hypot(y),
            drift.turn_deg,
            drift.longest_shift_m,
        ));
    }
    let is_only_suspected = drift.is_suspected && !drift.is_corrected;
    is_only_suspected.then(|| {
        let sentence = "poses may drift: the sonar hears the map elsewhere than poses put it, too little or too unclearly to correct \
                        them, and the map may be smeared; aid the vehicle's position, or replay the log with \
                        mapper.parts.drift = \"on\" and compare the maps";
        warning("pose-drift", sentence.to_owned())
    })
}

/// So many fixes show whether any goes with a pose.
const TELLING_FIXES: u64 = 10;

/// A satellite receiver whose fixes do not place the map, or no longer.
fn gnss(poses: &PoseReport) -> Option<Finding> {
    let gnss = poses.gnss.as_ref()?;
    let fixes = gnss.source.fixes;
    let told = |sentence| Some(warning("gnss", sentence));
    if let Some(fault) = gnss.source.first_fault.as_ref().filter(|_| fixes == 0) {
        let refused = gnss.source.refused;
        return told(format!(
            "{refused} messages of the GNSS receiver cannot be used; the first: {fault}"
        ));
    }
    if gnss.moved_m > 0.0 {
        return told(format!(
            "later fixes of the GNSS receiver have the world's origin {:.1} m from where the first have it, which stays: poses \
             drift",
            gnss.moved_m
        ));
    }
    if let Some(trouble) = &gnss.trouble {
        return told(format!("the map has no place on Earth by GNSS: {trouble}"));
    }
    if fixes < TELLING_FIXES || gnss.beside_poses > 0 {
        return None;
    }
    told(match poses.join.poses_taken {
        0 => "fixes of a GNSS receiver come, and no poses: fixes tell where on Earth, and are no poses, as they have no \
              attitude; name a source of those in pose.url"
            .to_owned(),
        _ => format!("none of {fixes} fixes of the GNSS receiver came beside a pose: their clocks differ"),
    })
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
        let code = match verdict.best.is_tilt() {
            true => "pose-mount",
            false => "pose-frame",
        };
        Some(loss(code, sentence))
    }

    pub(super) fn poses(&mut self, status: &Status, now: Instant, findings: &mut Vec<Finding>) {
        let poses = &status.report.poses;
        findings.extend(self.malformed(poses, now));
        findings.extend(gnss(poses));
        if self.expectations.pace == Pace::Live && self.has_run_for(PATIENCE, now) {
            let missing = missing(poses, status.pings_received);
            self.without_poses = missing.as_ref().map(|_| now).or(self.without_poses);
            findings.extend(missing);
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
        findings.extend(drift(status));
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
        if is_explained || self.had_no_poses(now) {
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

    /// Whether there were none at all just now, which is told by itself: pings of that time are given up until the longest
    /// wait is over, and not since poses come rarely or late.
    fn had_no_poses(&self, now: Instant) -> bool {
        let lasts = Duration::from_secs_f64(self.pose.max_wait_s) + PATIENCE + NEWS;
        let since = |at: Instant| now.saturating_duration_since(at);
        self.without_poses.is_some_and(|at| since(at) < lasts)
    }

    /// Whether poses come often enough and are refused, which is told by itself: pings without a pose are no
    /// wonder then.
    fn is_refusing(&mut self, poses: &PoseReport, now: Instant) -> bool {
        let (source, guard) = (&poses.source, &poses.guard);
        let unusable = source.malformed + source.not_finite + source.bad_quaternion;
        let refused = guard.stamps_zero + guard.stamps_far + guard.off_track + guard.out_of_order;
        let is_unusable = self.grows("poses unusable", unusable, now);
        let is_refused = self.grows("poses refused", refused, now);
        let come_often = source.rate_hz * self.pose.max_pose_gap_s > 1.0;
        is_unusable || is_refused && come_often
    }

    fn rare(&self, poses: &PoseReport) -> Finding {
        let (gap_s, rate_hz) = (self.pose.max_pose_gap_s, poses.source.rate_hz);
        let advice = match rate_hz * gap_s > 1.0 {
            true => "as they come in bursts; have them sent evenly".to_owned(),
            false => format!(
                "have them sent at least {:.0} times a second",
                (2.0 / gap_s).ceil()
            ),
        };
        loss(
            "poses-rare",
            format!(
                "{} pings so far lie between poses more than {gap_s} s apart (pose.max_pose_gap_s); poses come \
                 {rate_hz:.1} times a second: {advice}",
                poses.join.pings_in_gap
            ),
        )
    }

    fn late(&self, status: &Status) -> Finding {
        let poses = &status.report.poses;
        let count = poses.join.pings_pose_never_came;
        let late_s = self.pose.time_offset_s - poses.guard.lead_s;
        let wait_s = (late_s + 1.0).ceil();
        let is_slow = (0.0..self.pose.max_wait_s).contains(&late_s);
        let sentence = match !is_slow && (0.0..MOST_WAIT_S).contains(&late_s) {
            true => format!(
                "{count} pings so far were given up before their poses came, which takes {late_s:.1} s: if the link \
                 is that slow, set pose.max_wait_s = {wait_s:.0}{}",
                self.room_for(wait_s * status.rates.pings_per_s)
            ),
            false => format!(
                "{count} pings so far were given up before their poses came (pose.max_wait_s is {} s); poses are \
                 late, or stamped by another clock",
                self.pose.max_wait_s
            ),
        };
        loss("poses-late", sentence)
    }

    /// What else is to be set where so many pings wait.
    fn room_for(&self, pings: f64) -> String {
        let wanted = (1.5 * pings).ceil().clamp(1.0, MOST_WAITING);
        match wanted > self.pose.waiting_pings as f64 {
            true => format!(" and pose.waiting_pings = {wanted:.0}"),
            false => String::new(),
        }
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
        if guard.has_other_epochs() && self.grows("other epochs", guard.other_epochs, now) {
            findings.push(loss(
                SECOND_SOURCE,
                format!(
                    "poses of another epoch ({}) come between those that are followed, {:.1} m from them; {} \
                     were refused: a second sender, or one that counts resets that there were not; end one of \
                     the two, or give each vehicle a --node of its own",
                    guard.other_epoch.unwrap_or_default(),
                    guard.other_epoch_m,
                    guard.other_epochs
                ),
            ));
        }
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
