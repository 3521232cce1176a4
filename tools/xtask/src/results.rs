//! The page of results, its charts and the README's table against the file that they are made of.

use std::hash::Hasher;

use fnv::FnvHasher;

use crate::sources::SourceFile;

const FILE: &str = "docs/results.json";
const PAGE: &str = "docs/results.md";
const CHARTS: &str = "docs/results/";
const README: &str = "README.md";
/// Begins the page's last line, as `echosplat bench report --write-page` writes it.
const MADE_FROM: &str = "\n<!-- made from results.json ";
/// Stands before and after the table that page and README share.
const ACCURACY_MARK: &str = "<!-- accuracy table -->";
const AGAIN: &str =
    "echosplat bench report --write-page docs/results.md --from docs/results.json makes it anew";

/// Where they differ, one line each.
pub(crate) fn violations(files: &[SourceFile]) -> Vec<String> {
    let text = |path: &str| {
        let found = files.iter().find(|file| file.path == path);
        found.map(|file| file.text.as_str())
    };
    let page = text(PAGE).unwrap_or_default();
    let mut broken = match (text(FILE), page.rsplit_once(MADE_FROM)) {
        // A page by hand, as it was before there was a file.
        (None, None) => return Vec::new(),
        (Some(_), None) => vec![format!("{PAGE} is not made of {FILE}: {AGAIN}")],
        (None, Some(_)) => vec![format!("{FILE} is missing, of which {PAGE} was made")],
        (Some(json), Some((body, mark))) => differences(json, body, mark, files),
    };
    let table = |text: &str| Some(text.split(ACCURACY_MARK).nth(1)?.trim().to_owned());
    let readme = text(README).and_then(table);
    if readme.is_some_and(|readme| Some(readme) != table(page)) {
        broken.push(format!(
            "{README}: the table of accuracy is not that of {PAGE}: {AGAIN}"
        ));
    }
    broken
}

/// Whose bits are no longer those that the page's last line names.
fn differences(json: &str, body: &str, mark: &str, files: &[SourceFile]) -> Vec<String> {
    let mut charts: Vec<(&str, &str)> = Vec::new();
    for file in files {
        if let Some(name) = file.path.strip_prefix(CHARTS) {
            charts.push((name, &file.text));
        }
    }
    charts.sort_unstable();
    let drawn: Vec<&str> = charts
        .iter()
        .flat_map(|(name, svg)| [*name, *svg])
        .collect();
    let parts = [(FILE, vec![json]), (PAGE, vec![body]), (CHARTS, drawn)];
    let named = mark.trim_end().trim_end_matches(" -->").split(", ");
    let named = named.map(|part| part.rsplit(' ').next().unwrap_or_default());
    let differ = parts.into_iter().zip(named.chain(std::iter::repeat("")));
    let differ = differ.filter(|((_, text), name)| bits(text) != *name);
    differ
        .map(|((what, _), _)| format!("{what} is not as it was when {PAGE} was made: {AGAIN}"))
        .collect()
}

fn bits(parts: &[&str]) -> String {
    let mut bits = FnvHasher::default();
    for part in parts {
        bits.write(part.as_bytes());
    }
    format!("{:016x}", bits.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(path: &str, text: &str) -> SourceFile {
        SourceFile {
            path: path.to_owned(),
            text: text.to_owned(),
        }
    }

    /// A file, a page of it, a chart and a README.
    fn sound() -> Vec<SourceFile> {
        let (json, chart) = ("{}\n", "<svg/>\n");
        let table = format!("{ACCURACY_MARK}\n| 0.02 m |\n{ACCURACY_MARK}\n");
        let body = format!("# Results\n\n{table}");
        let mark = format!(
            "{}, page {}, charts {} -->\n",
            bits(&[json]),
            bits(&[&body]),
            bits(&["a.svg", chart])
        );
        vec![
            file(FILE, json),
            file(PAGE, &format!("{body}{MADE_FROM}{mark}")),
            file("docs/results/a.svg", chart),
            file(README, &format!("# Name\n\n{table}\nmore\n")),
        ]
    }

    fn with(index: usize, from: &str, to: &str) -> Vec<String> {
        let mut files = sound();
        assert!(files[index].text.contains(from));
        files[index].text = files[index].text.replace(from, to);
        violations(&files)
    }

    #[test]
    fn what_was_made_together_agrees() {
        assert!(
            violations(&sound()).is_empty(),
            "{:?}",
            violations(&sound())
        );
        assert!(violations(&[file(PAGE, "# by hand\n")]).is_empty());
    }

    #[test]
    fn a_change_by_hand_is_found_wherever_it_is() {
        for (index, from, to, what) in [
            (0, "{}", "{ }", FILE),
            (1, "# Results", "# Result", PAGE),
            (2, "<svg/>", "<svg />", CHARTS),
            (3, "0.02", "0.01", README),
        ] {
            let broken = with(index, from, to);
            assert_eq!(broken.len(), 1, "{broken:?}");
            assert!(broken[0].starts_with(what), "{broken:?}");
        }
        // The page's table is both the page's and not the README's any more.
        assert_eq!(with(1, "0.02", "0.01").len(), 2);
    }

    #[test]
    fn a_page_without_its_file_and_a_file_without_its_page_are_found() {
        let all = sound();
        assert_eq!(violations(&all[1..]).len(), 1);
        let unmade = [file(FILE, "{}"), file(PAGE, "# by hand\n")];
        assert!(violations(&unmade)[0].contains("not made of"));
        let chart_gone: Vec<SourceFile> = sound()
            .into_iter()
            .filter(|file| !file.path.ends_with(".svg"))
            .collect();
        assert!(violations(&chart_gone)[0].starts_with(CHARTS));
    }
}
