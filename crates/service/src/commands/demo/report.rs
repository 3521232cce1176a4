//! The demo's results as one HTML file.

use echosplat_report::Report;
use serde_json::Value;

use crate::commands::judging::Verdict;
use crate::processor;

/// What the demo came to.
pub(super) struct Results {
    pub(super) title: String,
    pub(super) noise: String,
    pub(super) seed: u64,
    pub(super) verdict: Verdict,
    /// Of the run, as `--json` has it.
    pub(super) summary: Value,
}

impl Results {
    /// `received_count` Gaussians were found the same at the subscriber's end.
    pub(super) fn html(&self, received_count: usize) -> String {
        let text = format!(
            "A simulated OmniScan 450 with {} noise, over TCP on loopback, poses over zenoh; the \
             service as it runs at sea. A subscriber in a session of its own received the same \
             {received_count} Gaussians.",
            self.noise
        );
        let section = self
            .verdict
            .section(self.title.clone(), text, &self.summary);
        let report = Report {
            title: "EchoSplat demo".to_owned(),
            subtitle: "echosplat demo".to_owned(),
            highlights: self.verdict.highlights(),
            machine: processor::description(),
            seeds: vec![self.seed],
            notes: Vec::new(),
            sections: vec![section],
        };
        report.to_html()
    }
}
