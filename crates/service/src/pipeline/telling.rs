//! What a run tells of itself: findings, and the status on the log, the page, the bus and into the
//! recording.

use std::time::Instant;

use echosplat_bus::MAPPER_ROLE;
use echosplat_recording::mcap::Record;

use super::album::AlbumWriter;
use super::keeper::Keeper;
use super::notices::Finding;
use super::run::Run;
use super::shared::Phase;
use super::status::{Status, other_service};
use crate::clock;
use crate::recorder::Recorder;

impl Run {
    /// Finds what is wrong, and tells what is new of it.
    pub(super) fn diagnose(&mut self) {
        if self.shared.phase() != Phase::Running {
            return;
        }
        let status = self.status(false);
        let now = Instant::now();
        let mut findings = self.diagnosis.findings(&status, now);
        findings.extend(self.known.clone());
        self.note(findings, now);
        self.notices.end_old(now);
    }

    /// Tells and records what is new of what was found.
    pub(super) fn note(&mut self, findings: Vec<Finding>, now: Instant) {
        for finding in &findings {
            self.record_notice(finding);
        }
        self.notices.add(findings, now);
    }

    fn record_notice(&self, finding: &Finding) {
        if let Some(recorder) = &self.recorder
            && !self.notices.stands(&finding.code)
        {
            let event = serde_json::json!({
                "event": "notice", "code": finding.code, "sentence": finding.sentence
            });
            recorder.record(clock::now(), Record::Event(event));
        }
    }

    /// Shows, records and publishes the status.
    pub(super) fn tell(&mut self, is_final: bool) -> anyhow::Result<()> {
        let status = self.status(is_final);
        tracing::debug!(
            pings_received = status.pings_received,
            pings_mapped = status.report.pings_mapped,
            link = ?status.link.state,
            phase = ?status.phase,
            "status"
        );
        self.systemd.status(&line(&status));
        if let Some(on_status) = &mut self.hooks.on_status {
            on_status(&status);
        }
        let status = serde_json::to_value(&status)?;
        if let Some(page) = &self.hooks.page {
            page.status(status.clone());
        }
        // A bus that fails is no reason to stop mapping.
        if let Some(bus) = &self.bus
            && let Err(error) = bus.publish_status(&status)
        {
            tracing::debug!(%error, "status not published");
        }
        if let Some(recorder) = &self.recorder {
            recorder.record(clock::now(), Record::Status(status));
        }
        Ok(())
    }

    pub(super) fn status(&mut self, is_final: bool) -> Status {
        // In this order, so that what was taken is never more than what was sent.
        let report = self.shared.report();
        let sonar = self.drivers.status();
        let others = self.bus.as_ref().map(|bus| bus.others_alive(MAPPER_ROLE));
        let mut status = Status {
            phase: self.shared.phase(),
            is_final,
            wall_s: self.begin.elapsed().as_secs_f64(),
            link: self.shared.link(self.drivers.asks_a_sonar()),
            publisher: self.published.map.as_ref().map(|map| map.counters()),
            ros: self.published.ros.as_ref().map(|ros| ros.counters()),
            pings_not_published: self.bus.as_ref().map_or(0, |bus| bus.pings_dropped()),
            recording: self.recorder.as_ref().and_then(Recorder::counters),
            recording_fault: self.recorder.as_ref().and_then(Recorder::fault),
            map_fault: self
                .keeper
                .as_ref()
                .and_then(Keeper::fault)
                .map(str::to_owned)
                .or_else(|| self.album.as_ref().and_then(AlbumWriter::fault)),
            other_service: other_service(&others.unwrap_or_default()),
            bus_unreached: self
                .bus
                .as_ref()
                .map(|bus| bus.unreached())
                .unwrap_or_default(),
            replay_is_held: self.drivers.is_held(),
            parts: self.supervisor.reports(),
            notices: self.notices.all(),
            newest_notice: self.notices.newest_standing().map(str::to_owned),
            input_share: self.drivers.share_read(),
            tape: self.part.tape(),
            input_losses: self.losses.clone(),
            ..Status::of(report, sonar)
        };
        let counters = [
            status.pings_received,
            status.report.pings_mapped,
            status.sonar.session.bytes_received,
        ];
        self.rates.measure(Instant::now(), counters);
        status.rates = self.rates.rates();
        self.publishing.tell(&mut status.report.effort);
        status
    }
}

/// The status in a line: what is wrong, or how far the map is.
fn line(status: &Status) -> String {
    let wrong = status.newest_notice.as_deref();
    let mapped = status.report.pings_mapped;
    let received = status.pings_received;
    wrong.map_or_else(
        || format!("{mapped} of {received} pings in the map"),
        str::to_owned,
    )
}
