//! What a case came to, as JSON, tables, curves and text.

use echosplat_metrics::Metrics;
use echosplat_paper::{Choice, Choices};
use echosplat_report::table;
use echosplat_report::{Plot, Section, Table};
use serde_json::{Value, json};

use super::{Epoch, Outcome};

impl Outcome {
    fn time_s(&self) -> (f64, f64) {
        let last = self.epochs.last();
        last.map_or((self.start_s, 0.0), |epoch| (epoch.wall_s, epoch.compute_s))
    }

    pub(super) fn json(&self) -> anyhow::Result<Value> {
        let (wall_s, compute_s) = self.time_s();
        let at =
            |(opacity, metrics): &(f32, Metrics)| json!({"opacity": opacity, "metrics": metrics});
        Ok(json!({
            "case": self.printed.scene,
            "printed": self.printed,
            "views": self.views,
            "candidates": self.counts,
            "beam_width_m": self.beam_width_m,
            "start_s": self.start_s,
            "wall_s": wall_s,
            "compute_s": compute_s,
            "pairs": self.pairs,
            "peak_memory_bytes": self.peak_memory_bytes,
            "metrics": self.metrics,
            "at_opacity": self.at_opacity.iter().map(at).collect::<Vec<_>>(),
            "epochs": serde_json::to_value(&self.epochs)?,
        }))
    }

    /// By the paper's protocol; infinite for an empty map.
    pub(super) fn its_way(metrics: &Metrics) -> (f64, f64) {
        let paper = metrics.paper;
        paper.map_or((f64::INFINITY, f64::INFINITY), |paper| {
            (paper.cd_m, paper.hd_m)
        })
    }

    fn beside(&self) -> Table {
        let (printed, metrics) = (&self.printed, &self.metrics);
        let (cd_m, hd_m) = Self::its_way(metrics);
        let (wall_s, compute_s) = self.time_s();
        let row = |what: &str, ours: String, theirs: String| vec![what.to_owned(), ours, theirs];
        let none = || "–".to_owned();
        let whole = |value: usize| value.to_string();
        Table {
            title: "Beside the printed figures".to_owned(),
            columns: ["what", "here", "paper"].map(str::to_owned).into(),
            rows: vec![
                row("views", whole(self.views), whole(printed.views)),
                row(
                    "candidates",
                    whole(self.counts.candidates),
                    whole(printed.candidates),
                ),
                row(
                    "kept by several views",
                    whole(self.counts.kept),
                    whole(printed.kept),
                ),
                row(
                    "asserted at the end",
                    whole(metrics.confident_count),
                    none(),
                ),
                row(
                    "CD aligned and cropped, m",
                    table::metres(cd_m),
                    table::metres(printed.cd_m),
                ),
                row(
                    "HD aligned and cropped, m",
                    table::metres(hd_m),
                    table::metres(printed.hd_m),
                ),
                row("CD raw, m", table::metres(metrics.cd_m), none()),
                row("HD raw, m", table::metres(metrics.hd_m), none()),
                row("seconds by the clock", format!("{wall_s:.1}"), none()),
                row("processor seconds", format!("{compute_s:.1}"), none()),
                row(
                    "Gaussian–pixel pairs",
                    table::quantity(self.pairs as f64),
                    none(),
                ),
                row(
                    "peak memory, MB",
                    whole(self.peak_memory_bytes as usize / 1_000_000),
                    none(),
                ),
            ],
            note: "CD is the half-sum. The printed figures are for the paper's own simulation of \
                   the same structure."
                .to_owned(),
        }
    }

    fn thresholds(&self) -> Table {
        let row = |(opacity, metrics): &(f32, Metrics)| {
            let (cd_m, hd_m) = Self::its_way(metrics);
            let metres = [metrics.cd_m, metrics.hd_m, cd_m, hd_m].map(table::metres);
            let mut row = vec![opacity.to_string(), metrics.confident_count.to_string()];
            row.extend(metres);
            row
        };
        let columns = [
            "opacity above",
            "points",
            "CD raw, m",
            "HD raw, m",
            "CD its way, m",
            "HD its way, m",
        ];
        Table {
            title: "What is shown of it".to_owned(),
            columns: columns.map(str::to_owned).into(),
            rows: self.at_opacity.iter().map(row).collect(),
            note: format!(
                "The paper's figures of this case show opacity above {}.",
                self.printed.opacity
            ),
        }
    }

    fn plots(&self) -> Vec<Plot> {
        let line = |name: &str, x: fn(&Epoch) -> f64, y: fn(&Epoch) -> Option<f64>| {
            let points = self
                .epochs
                .iter()
                .filter_map(|epoch| Some((x(epoch), y(epoch)?)));
            (name.to_owned(), points.collect::<Vec<_>>())
        };
        let epoch = |epoch: &Epoch| f64::from(epoch.report.epoch);
        let compute = |epoch: &Epoch| epoch.compute_s;
        let loss = |epoch: &Epoch| Some(epoch.report.loss / epoch.report.loss_of_nothing);
        let plot = |x: &str, y: &str, lines| Plot {
            x_label: x.to_owned(),
            y_label: y.to_owned(),
            lines,
            ..Plot::default()
        };
        vec![
            plot(
                "epoch",
                "loss over that of an empty map",
                vec![line("L1", epoch, loss)],
            ),
            plot(
                "epoch",
                "raw error, m",
                vec![line("CD", epoch, |e| e.cd_m), line("HD", epoch, |e| e.hd_m)],
            ),
            plot(
                "compute time, CPU s",
                "raw error, m",
                vec![
                    line("CD", compute, |e| e.cd_m),
                    line("HD", compute, |e| e.hd_m),
                ],
            ),
        ]
    }

    pub(super) fn section(&self) -> Section {
        Section {
            title: format!("The paper's case: {}", self.printed.scene),
            text: format!(
                "{} still images of 64 beams over 60°, no noise, {} epochs.",
                self.views,
                self.epochs.len()
            ),
            metrics: Some(self.metrics),
            picture: Some(self.picture.clone()),
            plots: self.plots(),
            tables: vec![self.beside(), self.thresholds()],
            ..Section::default()
        }
    }

    pub(super) fn text(&self) -> String {
        let mut text = format!("{}\n", self.printed.scene);
        for row in self.beside().rows {
            text += &format!("  {:<28} {:>12} {:>12}\n", row[0], row[1], row[2]);
        }
        text
    }
}

/// The table of what was chosen.
pub(super) fn choices_section(choices: &Choices) -> Section {
    let rows = choices.rows();
    let row = |choice: &Choice| {
        vec![
            choice.name.to_owned(),
            choice.value.clone(),
            choice.why.to_owned(),
        ]
    };
    Section {
        title: "What the paper leaves open".to_owned(),
        text: "Chosen once for both cases.".to_owned(),
        tables: vec![Table {
            title: "Choices".to_owned(),
            columns: ["choice", "value", "why"].map(str::to_owned).into(),
            rows: rows.iter().map(row).collect(),
            note: String::new(),
        }],
        ..Section::default()
    }
}
