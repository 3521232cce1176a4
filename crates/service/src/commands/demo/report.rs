//! The demo's results as one HTML file.

use serde_json::Value;

use crate::commands::dive_report::{self, Heading};
use crate::commands::judging::Verdict;
use crate::pipeline::Outcome;

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
    pub(super) fn html(&self, outcome: &Outcome, received_count: usize) -> String {
        let text = format!(
            "echosplat demo: a simulated OmniScan 450 with {} noise, over TCP on loopback, poses over zenoh; the \
             service as it runs at sea. A subscriber in a session of its own received the same \
             {received_count} Gaussians.",
            self.noise
        );
        let heading = Heading {
            title: format!("EchoSplat demo: {}", self.title),
            settings: None,
            text,
            seed: Some(self.seed),
        };
        dive_report::html(heading, outcome, &self.verdict, &self.summary)
    }
}
