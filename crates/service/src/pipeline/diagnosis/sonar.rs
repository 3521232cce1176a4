//! What is wrong with what comes from the sonar.

mod units;

use std::time::Instant;

use echosplat_driver::LinkState;

use super::{Diagnosis, PATIENCE, loss, warning};
use crate::pipeline::Pace;
use crate::pipeline::notices::Finding;
use crate::pipeline::status::Status;

pub(in crate::pipeline) use units::finding as finding_of_units;

/// A profile that repeats, or holds one value, for so long is no accident, seconds.
const SAME_S: f64 = 1.0;
/// Before so many pings it may be the link's beginning.
const SLOW_AFTER: u64 = 5;
/// Fewer than this fraction of the pings asked for are too few.
const SLOW_SHARE: f64 = 0.4;
/// Pings may fail to come for so many intervals.
const INTERVALS: f64 = 5.0;
/// The shortest range that can be set, metres.
const LEAST_LENGTH_M: f64 = 0.1;

impl Diagnosis {
    pub(super) fn sonar(&mut self, status: &Status, now: Instant, findings: &mut Vec<Finding>) {
        if self.expectations.pace == Pace::Live {
            findings.extend(self.silence(status, now).or_else(|| self.slow(status, now)));
            findings.extend(self.long_range(status));
            findings.extend(own_vehicle(status));
        }
        findings.extend(self.refused(status, now));
        findings.extend(units::finding(&status.sonar));
        let listening = status.report.listening;
        if listening.flat_s >= SAME_S {
            findings.push(loss(
                "flat-profiles",
                format!(
                    "for {:.0} s every bin of a ping has held the same value: the transducer or its \
                     receiver is dead or disconnected; nothing can be mapped from it",
                    listening.flat_s
                ),
            ));
        } else if listening.same_s >= SAME_S {
            findings.push(loss(
                "frozen-profiles",
                format!(
                    "for {:.0} s the sonar has sent the same profile under new numbers: restart it",
                    listening.same_s
                ),
            ));
        }
        let late = status.sonar.session.pings_late;
        if self.grows("late", late, now) {
            findings.push(warning(
                "late-pings",
                format!(
                    "{late} pings so far came late or out of order; they are mapped in their place"
                ),
            ));
        }
    }

    /// No pings: the first link of the chain that is broken.
    fn silence(&self, status: &Status, now: Instant) -> Option<Finding> {
        let patience_s = PATIENCE
            .as_secs_f64()
            .max(INTERVALS * self.expectations.ping_interval_s);
        let sonar = &status.sonar;
        let is_quiet = |since_s: Option<f64>| since_s.is_none_or(|since_s| since_s > patience_s);
        let has_run_s = now.saturating_duration_since(self.begin).as_secs_f64();
        if !is_quiet(sonar.since_ping_s) || has_run_s < patience_s {
            return None;
        }
        let url = &self.expectations.sonar;
        let found = match sonar.link {
            LinkState::Ended | LinkState::Stopped => return None,
            LinkState::Connecting | LinkState::Down => {
                let reason = sonar.reason.as_deref().unwrap_or("no answer");
                let sentence = format!(
                    "no pings: no link to {url} ({reason}); check power, cable and address, or let \
                     `echosplat probe` look for the unit"
                );
                loss("no-link", sentence)
            }
            LinkState::Up if is_quiet(sonar.since_profile_s) && sonar.other_product.is_some() => {
                loss(
                    "other-device",
                    format!(
                        "no pings: {url} is a {}, and no OmniScan 450, whose profiles are mapped here; give \
                     sonar.url the address of one, which `echosplat probe` looks for",
                        sonar.other_product.unwrap_or_default()
                    ),
                )
            }
            LinkState::Up if is_quiet(sonar.since_byte_s) => loss(
                "no-bytes",
                format!(
                    "no pings: {url} is connected and sends nothing; is it a sonar, and powered?"
                ),
            ),
            LinkState::Up if is_quiet(sonar.since_frame_s) => loss(
                "no-frames",
                format!(
                    "no pings: {url} sends bytes that are no Ping frames ({} skipped so far); check \
                     the baud rate and that it is a Ping device",
                    sonar.session.bytes_skipped
                ),
            ),
            LinkState::Up if is_quiet(sonar.since_profile_s) => loss(
                "no-profiles",
                format!(
                    "no pings: {url} answers, but sends no profiles ({} status messages, {} requests \
                     refused); another program may have stopped it, or the unit needs a restart",
                    sonar.session.status, sonar.session.nacks
                ),
            ),
            LinkState::Up => loss(
                "no-new-pings",
                format!(
                    "no pings: profiles come, but none is new and sound ({}); restart the unit",
                    rejections(status)
                ),
            ),
        };
        Some(found)
    }

    /// Pings come, but far fewer than asked for.
    fn slow(&self, status: &Status, now: Instant) -> Option<Finding> {
        let asked = 1.0 / self.expectations.ping_interval_s.max(1e-3);
        let heard = status.rates.pings_per_s;
        let has_begun = self.has_run_for(4 * PATIENCE, now) && status.sonar.pings_sent > SLOW_AFTER;
        (has_begun && heard < SLOW_SHARE * asked).then(|| {
            warning(
                "few-pings",
                format!(
                    "{heard:.1} pings a second come where about {asked:.1} are asked for: the link or the \
                     unit is slow, or another program has changed its settings"
                ),
            )
        })
    }

    /// The unit hears so much further than what is there that the map is coarser than it could be.
    fn long_range(&self, status: &Status) -> Option<Finding> {
        let mapper = &status.report.mapper;
        let (working_m, useful_m) = mapper.working_range_m.zip(mapper.useful_range_m)?;
        let (end_m, useful_m) = (f64::from(mapper.range_end_m), f64::from(useful_m));
        let [start_m, length_m] = self.expectations.range_m;
        // The unit counts range by another speed of sound than pings are scaled to.
        let asked_per_true = (start_m + length_m) / end_m;
        let useful_length_m = useful_m * asked_per_true - start_m;
        let advice = match useful_length_m >= LEAST_LENGTH_M {
            true => format!(
                "set session.range_length_m to {} m or less",
                at_most(useful_length_m)
            ),
            false => "set session.range_start_m nearer".to_owned(),
        };
        (end_m > useful_m).then(|| {
            warning(
                "long-range",
                format!(
                    "pings end at {end_m:.0} m, and half of the strongest echoes come from within {working_m:.1} m: the \
                     map is coarser than the beam resolves there; {advice}"
                ),
            )
        })
    }

    fn refused(&mut self, status: &Status, now: Instant) -> Option<Finding> {
        let refused = status.profiles_refused();
        if !self.grows("refused", refused, now) {
            return None;
        }
        let first = status.sonar.first_refusal.as_deref();
        let first = first.map_or(String::new(), |first| {
            format!(", the first for its {first}")
        });
        Some(loss(
            "profiles-refused",
            format!(
                "{refused} profiles so far are none that a sonar makes{first}: {}",
                rejections(status)
            ),
        ))
    }
}

/// Something of the vehicle is in the fan: the map is right, and there may be less of it.
fn own_vehicle(status: &Status) -> Option<Finding> {
    let range_m = status.report.mapper.own_vehicle_m?;
    Some(warning(
        "own-vehicle",
        format!(
            "something {range_m:.1} m away goes with the vehicle: a gripper, or a frame in the fan; it is passed over. Keep it \
             out of the fan, if it need not be there"
        ),
    ))
}

/// A length in tenths of a metre, or whole ones where that is fine enough, that is no more than this.
fn at_most(length_m: f64) -> String {
    match length_m < 10.0 {
        true => format!("{:.1}", (10.0 * length_m).floor() / 10.0),
        false => format!("{:.0}", length_m.floor()),
    }
}

/// Profiles left out, by reason, those that are none left unsaid.
fn rejections(status: &Status) -> String {
    let rejected = serde_json::to_value(status.sonar.session.profiles_rejected);
    let by_reason = rejected.ok().and_then(|value| value.as_object().cloned());
    let reasons: Vec<String> = by_reason
        .into_iter()
        .flatten()
        .filter(|(_, count)| count.as_u64() != Some(0))
        .map(|(reason, count)| format!("{count} {}", reason.replace('_', " ")))
        .collect();
    match reasons.is_empty() {
        true => "none was left out".to_owned(),
        false => format!("left out are {}", reasons.join(", ")),
    }
}
