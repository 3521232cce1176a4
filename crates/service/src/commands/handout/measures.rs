//! Measures of a report: from the command line, or from a file of lines as `measure` takes them.

use std::path::Path;

use clap::Parser;
use echosplat_georeference::Georeference;
use echosplat_report::{Numbered, Plot, Sheet, Table};
use echosplat_survey::Sample;
use serde_json::Value;

use crate::arguments::AskedArguments;
use crate::exit::Usage;
use crate::measuring::{Asked, Measured, measure};

/// Most measures of a report.
const MOST: usize = 200;
/// Longest file of them that is read.
const MOST_BYTES: u64 = 256 * 1024;
/// Charts of profiles and sections on a page.
const MOST_CHARTS: usize = 8;

/// One measure.
#[derive(Debug, Clone)]
pub(in crate::commands) struct Named {
    /// In drawings, from 1.
    number: usize,
    /// As its owner calls it; empty if not at all.
    name: String,
    /// Or why there is nothing.
    found: Result<Measured, String>,
}

/// A line of a file: what `measure` takes behind the map.
#[derive(Debug, Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Line {
    #[command(flatten)]
    asked: AskedArguments,
}

/// Lines as `--pile 0.9,0.9,-2 --within 0.8  # north pile`; what stands behind `#` is its name.
///
/// # Errors
/// Names the file, the line and what is wrong with it.
pub(in crate::commands) fn of_file(path: &Path) -> anyhow::Result<Vec<(Asked, String)>> {
    let wrong = |why: String| Usage::error(format!("--measures {}: {why}", path.display()));
    echosplat_input::readable(path).map_err(wrong)?;
    let size = std::fs::metadata(path).map_or(0, |found| found.len());
    if size > MOST_BYTES {
        return Err(wrong(format!("has {size} bytes; {MOST_BYTES} are read")));
    }
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let (words, name) = line.split_once('#').unwrap_or((line, ""));
        if words.trim().is_empty() {
            continue;
        }
        let asked = of_words(words).map_err(|why| wrong(format!("line {}: {why}", index + 1)))?;
        found.push((asked, name.trim().to_owned()));
    }
    Ok(found)
}

fn of_words(words: &str) -> Result<Asked, String> {
    let parsed = Line::try_parse_from(words.split_whitespace()).map_err(|error| {
        let said = error.to_string();
        let first = said.lines().next().unwrap_or_default();
        first.trim_start_matches("error: ").to_owned()
    })?;
    parsed.asked.asked()
}

/// Each measured, numbered in their order. What is not there is told in its row.
///
/// # Errors
/// If they are too many.
pub(in crate::commands) fn measured(
    asked: Vec<(Asked, String)>,
    samples: &[Sample],
    place: Option<&Georeference>,
) -> anyhow::Result<Vec<Named>> {
    if asked.len() > MOST {
        let count = asked.len();
        return Err(Usage::error(format!(
            "{count} measures: a report has {MOST} at most"
        )));
    }
    let one = |(index, (asked, name)): (usize, (Asked, String))| Named {
        number: index + 1,
        name,
        found: measure(&asked, samples, place).map_err(|error| error.to_string()),
    };
    Ok(asked.into_iter().enumerate().map(one).collect())
}

/// For the drawings.
pub(super) fn numbered(measures: &[Named]) -> Vec<Numbered> {
    let one = |named: &Named| {
        let found = named.found.as_ref().ok()?;
        Some(Numbered {
            number: named.number,
            places_m: found.shape.clone(),
        })
    };
    measures.iter().filter_map(one).collect()
}

/// A page of them; none without any.
pub(super) fn sheet(measures: &[Named], place: Option<&Georeference>) -> Option<Sheet> {
    if measures.is_empty() {
        return None;
    }
    let mut columns = vec!["", "what", "at x, y, z, m", "found"];
    if place.is_some() {
        columns.insert(3, "latitude, longitude");
    }
    let table = Table {
        title: String::new(),
        columns: columns.into_iter().map(str::to_owned).collect(),
        rows: measures.iter().map(|named| row(named, place)).collect(),
        note: "Numbers stand in plan and elevations. Behind ± is one sigma. Places are the world's, of a line both ends."
            .to_owned(),
    };
    let plots: Vec<Plot> = measures.iter().filter_map(plot).take(MOST_CHARTS).collect();
    let sheet = Sheet::new("Measures").table(&table);
    Some(match plots.is_empty() {
        true => sheet,
        false => sheet.plots(&plots),
    })
}

fn row(named: &Named, place: Option<&Georeference>) -> Vec<String> {
    let number = named.number.to_string();
    let named_as = |what: &str| match named.name.is_empty() {
        true => what.to_owned(),
        false => format!("{} ({what})", named.name),
    };
    let (what, at, degrees, found) = match &named.found {
        Err(why) => (
            named_as("not measured"),
            String::new(),
            String::new(),
            why.clone(),
        ),
        Ok(found) => {
            let at = found
                .shape
                .iter()
                .map(|at_m| together(&format!("{:.2}, {:.2}, {:.2}", at_m.x, at_m.y, at_m.z)));
            let degrees = found.shape.iter().flat_map(|at_m| {
                let at = place?.place_of(*at_m);
                Some(together(&format!(
                    "{:.7}, {:.7}",
                    at.latitude_deg, at.longitude_deg
                )))
            });
            (
                named_as(found.name),
                at.collect::<Vec<_>>().join("\n"),
                degrees.collect::<Vec<_>>().join("\n"),
                told(found),
            )
        }
    };
    let mut cells = vec![number, what, at, found];
    if place.is_some() {
        cells.insert(3, degrees);
    }
    cells
}

/// On one line of a narrow column.
fn together(numbers: &str) -> String {
    numbers.replace(' ', "\u{a0}").replace('-', "−")
}

/// All but where it is, which has its own column.
fn told(found: &Measured) -> String {
    if found.rows.is_empty() {
        return found.lines.get(1..).unwrap_or_default().join("\n");
    }
    let heights = heights(found);
    let (low, high) = heights
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, z)| {
            (low.min(*z), high.max(*z))
        });
    match heights.is_empty() {
        true => "nothing of the map lies there".to_owned(),
        false => format!("{low:.2} to {high:.2} m; drawn below").replace('-', "−"),
    }
}

/// Along and up, metres, of a profile or a section.
fn heights(found: &Measured) -> Vec<(f64, f64)> {
    let rows = found.facts[found.name].as_array();
    let rows = rows.map(Vec::as_slice).unwrap_or_default();
    let one = |row: &Value| Some((row["along_m"].as_f64()?, row["height_m"]["value"].as_f64()?));
    rows.iter().filter_map(one).collect()
}

fn plot(named: &Named) -> Option<Plot> {
    let found = named.found.as_ref().ok()?;
    let points = heights(found);
    (!points.is_empty()).then(|| Plot {
        x_label: format!("{}: along the {}, m", named.number, found.name),
        y_label: "z, m".to_owned(),
        x_is_linear: true,
        y_is_linear: true,
        lines: vec![(format!("{} {}", named.number, found.name), points)],
        ..Plot::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measuring::What;
    use echosplat_model::glam::DVec3;

    fn read(text: &str) -> anyhow::Result<Vec<(Asked, String)>> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("measures.txt");
        std::fs::write(&path, text)?;
        of_file(&path)
    }

    #[test]
    fn lines_are_as_measure_takes_them_with_a_name_behind() {
        let found = read(
            "# of the survey\n--pile 0.9,-0.9,-2 --within 0.8  # north pile\n\n--profile -3,0,0 3,0,0 --step 0.5\n",
        )
        .unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].0.what, What::Pile(DVec3::new(0.9, -0.9, -2.0)));
        assert_eq!(
            (found[0].0.within_m, found[0].1.as_str()),
            (Some(0.8), "north pile")
        );
        assert!((found[1].0.step_m - 0.5).abs() < 1e-12 && found[1].1.is_empty());
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (text, says) in [
            ("--pile 1,2,3\n--pile 1,2\n", "line 2"),
            ("--pyle 1,2,3\n", "--pyle"),
            ("1,2,3\n", "line 1"),
        ] {
            let error = format!("{:#}", read(text).unwrap_err());
            assert!(
                error.contains("measures.txt") && error.contains(says),
                "{error}"
            );
        }
    }

    #[test]
    fn what_is_not_there_is_told_in_its_row() {
        let asked = vec![(Asked::usual(What::Pile(DVec3::ZERO)), "gone".to_owned())];
        let found = measured(asked, &[], None).unwrap();
        let cells = row(&found[0], None);
        assert_eq!(cells[1], "gone (not measured)");
        assert!(cells[3].contains("too few"), "{cells:?}");
        assert!(numbered(&found).is_empty());
    }
}
