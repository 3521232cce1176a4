//! What is wrong with what goes out, and queues that drop.

use std::time::Instant;

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
        let unpublished = status.pings_not_published;
        if self.grows("raw pings", unpublished, now) {
            findings.push(warning(
                "pings-not-published",
                format!("{unpublished} raw pings so far were not published: the network is too slow for them"),
            ));
        }
    }
}
