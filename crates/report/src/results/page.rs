//! The page: words and tables in Markdown, charts beside it, and what it was made from.

use std::hash::Hasher;

use fnv::FnvHasher;

use super::charts::{self, Chart, MOST_CHARTS};
use super::data::Results;
use super::parts;

/// Of one page, counted at white space: what is longer is not read.
pub const MOST_WORDS: usize = 1500;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// The file is none that the bench wrote.
    #[error("no results of `echosplat bench report`: {0}")]
    Json(#[from] serde_json::Error),
    /// It would have more than [`MOST_WORDS`] words.
    #[error("the page would have {0} words, at most {MOST_WORDS} are read")]
    Words(usize),
    /// It would have more than [`MOST_CHARTS`] charts.
    #[error("the page would have {0} charts, at most {MOST_CHARTS} are looked at")]
    Charts(usize),
}

/// The page and its charts.
#[derive(Debug, Clone, PartialEq)]
pub struct Page {
    /// In Markdown; its last line says what it was made from.
    pub text: String,
    /// Name and contents of each file.
    pub charts: Vec<(String, String)>,
}

impl Page {
    /// Of the file's text; `folder` is where the charts are, from the page, without a slash at its end.
    ///
    /// # Errors
    /// If it is no such file, or its page would be too long.
    pub fn of(json: &str, folder: &str) -> Result<Self, PageError> {
        let results: Results = serde_json::from_str(json)?;
        let charts = charts::all(&results);
        if charts.len() > MOST_CHARTS {
            return Err(PageError::Charts(charts.len()));
        }
        let mut text = text(&results, &charts, folder);
        let words = text.split_whitespace().count();
        if words > MOST_WORDS {
            return Err(PageError::Words(words));
        }
        let charts: Vec<(String, String)> = charts
            .into_iter()
            .map(|chart| (chart.name, chart.svg))
            .collect();
        text += &made_from(json, &text, &charts);
        Ok(Self { text, charts })
    }
}

/// The last line: names for the bits of file, page and charts, which `cargo xtask check` looks at.
fn made_from(json: &str, text: &str, charts: &[(String, String)]) -> String {
    let mut sorted: Vec<&(String, String)> = charts.iter().collect();
    sorted.sort();
    let drawn: Vec<&str> = sorted
        .iter()
        .flat_map(|(name, svg)| [name.as_str(), svg.as_str()])
        .collect();
    let (json, text, drawn) = (bits(&[json]), bits(&[text]), bits(&drawn));
    format!("\n<!-- made from results.json {json}, page {text}, charts {drawn} -->\n")
}

fn bits(parts: &[&str]) -> String {
    let mut bits = FnvHasher::default();
    for part in parts {
        bits.write(part.as_bytes());
    }
    format!("{:016x}", bits.finish())
}

fn text(results: &Results, charts: &[Chart], folder: &str) -> String {
    let of = |wanted: &[&str]| -> String {
        let own = charts
            .iter()
            .filter(|chart| wanted.iter().any(|name| chart.name.starts_with(name)));
        let lines = own.map(|chart| format!("\n![{}]({folder}/{})\n", chart.shows, chart.name));
        lines.collect()
    };
    let sections = [
        introduction(results),
        PICTURE.to_owned(),
        parts::accuracy(results),
        parts::missed(results),
        parts::live(results) + &of(&["live"]),
        parts::sigma(results) + &of(&["sigma", "probability"]),
        parts::noise(results) + &of(&["noise"]),
        parts::error_time(results) + &of(&["error"]),
        parts::length(results) + &of(&["memory"]),
        parts::speed(results),
        left_out(results),
    ];
    sections.join("\n")
}

fn introduction(results: &Results) -> String {
    let Results {
        version,
        commit,
        cores,
        processor,
        jobs,
        ..
    } = results;
    let minutes = results.run_s / 60.0 / (*jobs).max(1) as f64;
    format!(
        "# Results\n\n\
         Version {version}, commit {commit}, on {cores} × {processor}. Every figure is of [results.json](results.json), \
         which one command makes in about {minutes:.0} min; stopped, it goes on where it was:\n\n\
         ```sh\n{}\nechosplat bench report --write-page docs/results.md --from docs/results.json\n```\n\n\
         Every dive is simulated. A survey lasts 240 s and has 9,600 pings of 600 bins over 10 m; \
         [The simulator's page](../crates/simulator/README.md) describes the levels of noise. \
         *CD* is half the sum of the mean distances from map to truth and from seen truth to map, *99th percentile* and \
         *HD* the larger of the two directed 99th percentiles and maxima. *False* is the share of confident Gaussians beyond \
         0.25 m of truth. Nothing is aligned or cropped; where there is a seabed, figures are of the structure. \
         Faults have [a page of their own](../crates/bench/README.md).\n",
        results.command
    )
}

/// How the README's picture is made.
const PICTURE: &str = "## The picture in the README\n\n\
One dive at nominal noise, seed 1; the left part shows its first 90 s. The script needs matplotlib and numpy.\n\n\
```sh\n\
echosplat simulate --scene pier --dive survey --seed 1 --out pier/\n\
echosplat replay pier/dive.svlog --poses pier/dive.tum --rate 0 --map pier.ply --truth pier/\n\
python tools/python/figure_readme.py pier/ pier.ply docs/pier.webp\n\
```\n";

/// Names of runs that are listed one by one.
const MOST_NAMES: usize = 10;

fn left_out(results: &Results) -> String {
    let mut text = "## What was thinned or left out\n\n".to_owned();
    for line in &results.thinned {
        text += &format!("* {line}\n");
    }
    for (name, why) in &results.failed {
        text += &format!("* Failed: {name}: {why}\n");
    }
    let names = &results.left_out;
    if !names.is_empty() {
        let shown = names.iter().take(MOST_NAMES).map(String::as_str);
        let shown: Vec<&str> = shown.collect();
        text += &format!(
            "* {} runs are not made yet, first {}.\n",
            names.len(),
            shown.join("; ")
        );
    }
    text
}
