//! What is wrong with what goes out, and queues that drop.

use std::time::Instant;

use echosplat_bus::Unreached;

use super::overload::fewer_pings;
use super::{Diagnosis, loss, warning};
use crate::pipeline::notices::Finding;
use crate::pipeline::status::Status;

impl Diagnosis {
    pub(super) fn disk_and_queues(
        &mut self,
        status: &Status,
        now: Instant,
        findings: &mut Vec<Finding>,
    ) {
        if let Some(fault) = &status.recording_fault {
            findings.push(loss("recording-fails", format!("recording fails: {fault}")));
        }
        if let Some(fault) = &status.map_fault {
            findings.push(loss(
                "map-not-written",
                format!("the map cannot be written: {fault}"),
            ));
        }
        if let Some(other) = &status.other_service {
            findings.push(loss("other-service", other.clone()));
        }
        findings.extend(unreached(&status.bus_unreached));
        let poses = &status.report.poses;
        let dropped = [
            (
                "pings",
                "between sonar and mapper",
                status.sonar.pings_dropped,
            ),
            (
                "pings",
                "waiting for their poses",
                poses.join.pings_dropped_full,
            ),
            (
                "poses",
                "on their way to the join",
                poses.source.dropped_full,
            ),
        ];
        for (name, place, count) in dropped {
            if self.grows(place, count, now) {
                findings.push(loss(
                    "queue-drops",
                    format!(
                        "{count} {name} so far were dropped {place}: the machine is too slow, or what \
                         they wait for does not come; {}",
                        fewer_pings(self.expectations.ping_interval_s)
                    ),
                ));
            }
        }
        self.given_up(status, now, findings);
        let lines = status.log_lines_dropped;
        if self.grows("log lines", lines, now) {
            findings.push(warning(
                "log-not-read",
                format!(
                    "{lines} lines of the log so far are left out: whoever reads standard error (a terminal, \
                     a pager, ssh) has stopped reading it; map and recording go on"
                ),
            ));
        }
        let unpublished = status.pings_not_published;
        if self.grows("raw pings", unpublished, now) {
            findings.push(warning(
                "pings-not-published",
                format!("{unpublished} raw pings so far were not published: the network is too slow for them"),
            ));
        }
    }
}

/// The bus leads nowhere yet.
fn unreached(endpoints: &[Unreached]) -> Option<Finding> {
    let told = endpoints
        .iter()
        .map(|Unreached { endpoint, reason }| format!("{endpoint} ({reason})"));
    let told: Vec<String> = told.collect();
    (!told.is_empty()).then(|| {
        warning(
            "bus-not-connected",
            format!(
                "zenoh reaches nobody at {}: it is tried again until somebody answers, and the dive goes on \
                 meanwhile; start the router there, or name another with connect/endpoints",
                told.join(", ")
            ),
        )
    })
}
