//! What is wrong with what goes out, and queues that drop.

use std::time::Instant;

use echosplat_bus::Unreached;

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
                         they wait for does not come; ask for fewer pings (session.ping_interval_ms)"
                    ),
                ));
            }
        }
        self.given_up(status, findings);
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

    /// What there is no time or no memory for.
    fn given_up(&self, status: &Status, findings: &mut Vec<Finding>) {
        let shedding = &status.report.shedding;
        let what = match (shedding.work, shedding.publishing) {
            (_, true) => "neither work on the map nor what is published",
            (true, false) => "no work on the map",
            (false, false) => "",
        };
        if !what.is_empty() {
            findings.push(warning(
                "overload",
                format!(
                    "pings come faster than this machine maps them: {what} keeps up; evidence and the \
                     recording go on, and the rest is made up for afterwards; ask for fewer pings \
                     (session.ping_interval_ms)"
                ),
            ));
        }
        if shedding.memory {
            findings.push(loss(
                "memory-full",
                format!(
                    "the service holds the {} MB of memory it may (pipeline.memory_bytes): pings are \
                     recorded and not mapped, {} so far; replay the recording where there is more",
                    status.memory_bytes / 1_000_000,
                    shedding.pings_without_memory
                ),
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
