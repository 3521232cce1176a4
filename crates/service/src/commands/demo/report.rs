//! The demo's results as one HTML file.

use echosplat_evaluation::Metrics;
use echosplat_evaluation::curve::Curve;
use echosplat_evaluation::report::{Picture, Report, Section, Table};
use echosplat_evaluation::table;
use serde_json::Value;

use crate::processor;

/// What the demo came to.
pub(super) struct Results {
    pub(super) title: String,
    pub(super) noise: String,
    pub(super) seed: u64,
    pub(super) picture: Picture,
    pub(super) metrics: Metrics,
    pub(super) curve: Curve,
    /// Of the run, as `--json` has it.
    pub(super) summary: Value,
}

impl Results {
    /// `received_count` Gaussians were found the same at the subscriber's end.
    pub(super) fn html(&self, received_count: usize) -> String {
        let metrics = &self.metrics;
        let figure = |name: &str, value: String| (name.to_owned(), value);
        let section = Section {
            title: self.title.clone(),
            text: format!(
                "A simulated OmniScan 450 with {} noise, over TCP on loopback, poses over zenoh; \
                 the service as it runs at sea. A subscriber in a session of its own received the \
                 same {received_count} Gaussians.",
                self.noise
            ),
            curves: vec![self.curve.clone()],
            metrics: Some(*metrics),
            picture: Some(self.picture.clone()),
            tables: vec![self.run_table()],
            ..Section::default()
        };
        let report = Report {
            title: "EchoSplat demo".to_owned(),
            subtitle: "echosplat demo".to_owned(),
            highlights: vec![
                figure("Chamfer distance", table::metres(metrics.cd_m) + " m"),
                figure("Hausdorff distance", table::metres(metrics.hd_m) + " m"),
                figure("Gaussians", metrics.confident_count.to_string()),
            ],
            machine: processor::description(),
            seeds: vec![self.seed],
            notes: Vec::new(),
            sections: vec![section],
        };
        report.to_html()
    }

    fn run_table(&self) -> Table {
        let row = |name: &str, field: &str| {
            let value = self.summary[field].as_f64().unwrap_or(0.0);
            let shown = match value.fract() == 0.0 {
                true => format!("{value:.0}"),
                false => format!("{value:.2}"),
            };
            vec![name.to_owned(), shown]
        };
        Table {
            title: "The run".to_owned(),
            columns: vec!["what".to_owned(), "value".to_owned()],
            rows: vec![
                row("pings received", "pings_received"),
                row("pings mapped", "pings_mapped"),
                row("pings without a pose", "pings_without_pose"),
                row("damaged frames", "frames_bad"),
                row("processor seconds of the mapper", "compute_s"),
                row("seconds by the clock", "wall_s"),
                row("Gaussian–bin pairs", "pairs"),
                row("most memory held, bytes", "peak_memory_bytes"),
            ],
            note: String::new(),
        }
    }
}
