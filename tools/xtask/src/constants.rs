//! The page of constants, made from the code's own comments: `cargo xtask constants` writes it, `cargo xtask check`
//! holds it to the code.
//!
//! A constant says its unit and its source in the first sentence of its comment; that sentence is its line of the page.

mod found;

use crate::crates::crate_of_source;
use crate::sources::SourceFile;
use found::{Constant, constants_of, files_for_tests};

/// Where the page is.
pub(crate) const PAGE: &str = "docs/develop/constants.md";
/// Crates whose constants shape a map, in the order of the page.
const FOLDERS: [(&str, &str); 4] = [
    ("Mapper", "crates/mapper/src/"),
    ("Measurement", "crates/measurement/src/"),
    ("Join", "crates/join/src/"),
    ("Prediction", "crates/prediction/src/"),
];
/// One of these words in its first sentence says where a constant is from.
const SOURCES: [&str; 12] = [
    "assumed",
    "bound",
    "bounds",
    "definition",
    "derived",
    "found",
    "grid",
    LAYOUT,
    "literature",
    "measured",
    "physics",
    "theory",
];
/// Of sizes and places in memory; the page says no more of them.
const LAYOUT: &str = "layout";
/// So that the page stays one that is read.
const MOST_WORDS_OF_A_LINE: usize = 12;
const MOST_WORDS: usize = 3_000;
const HEAD: &str = "# Constants

Made by `cargo xtask constants` from the comments of the code; `cargo xtask check` holds it to them. The name says what, the
line says unit and source:

* **physics**, **derived**, **literature**, **theory**: as said, or as the [method](method.md) has it;
* **measured**: on real units, or on the dives that the comment or a [decision](../decisions/README.md) names;
* **found**: chosen by trial on dives, nothing else is known of it; **assumed**: not even that;
* **bound** on a value, **bounds** work, memory or latency; **grid** of a search; **layout** of memory and threads.

[What 30 % less and more of each does](../decisions/2026-11-24-what-constants-do.md).
";

/// Where code and page differ, and constants that do not say where they are from, one line each.
pub(crate) fn violations(files: &[SourceFile]) -> Vec<String> {
    let constants = match all(files) {
        Ok(constants) => constants,
        Err(broken) => return vec![broken],
    };
    let mut broken: Vec<String> = constants.iter().filter_map(without_source).collect();
    let page = page_of(&constants);
    let words = page.split_whitespace().count();
    if words > MOST_WORDS {
        broken.push(format!(
            "{PAGE}: {words} words, {MOST_WORDS} are allowed: say less in the first sentence of a comment"
        ));
    }
    match files.iter().find(|file| file.path == PAGE) {
        Some(file) if file.text == page => {}
        Some(_) => broken.push(format!(
            "{PAGE} is not what the code says: run `cargo xtask constants`"
        )),
        None => broken.push(format!("{PAGE} is missing: run `cargo xtask constants`")),
    }
    broken
}

/// The page as the code has it.
///
/// # Errors
/// Names the file that cannot be read as Rust.
pub(crate) fn page(files: &[SourceFile]) -> anyhow::Result<String> {
    let constants = all(files).map_err(anyhow::Error::msg)?;
    Ok(page_of(&constants))
}

/// In the order of the page.
fn all(files: &[SourceFile]) -> Result<Vec<Constant>, String> {
    let mut constants = Vec::new();
    for (title, folder) in FOLDERS {
        let of_crate = files.iter().filter(|file| is_code(&file.path, folder));
        let mut for_tests = Vec::new();
        let mut parsed = Vec::new();
        for file in of_crate {
            let wrong = |error: syn::Error| format!("{}: {error}", file.path);
            let syntax = syn::parse_file(&file.text).map_err(wrong)?;
            for_tests.extend(files_for_tests(&file.path, &syntax));
            parsed.push((file, syntax));
        }
        parsed.retain(|(file, _)| !for_tests.iter().any(|path| file.path.starts_with(path)));
        parsed.sort_by(|(one, _), (other, _)| one.path.cmp(&other.path));
        for (file, syntax) in parsed {
            let module = file.path.trim_start_matches(folder).trim_end_matches(".rs");
            let module = module.trim_end_matches("/mod").replace('/', "::");
            constants.extend(constants_of(title, &module, &syntax));
        }
    }
    Ok(constants)
}

fn is_code(path: &str, folder: &str) -> bool {
    path.starts_with(folder) && path.ends_with(".rs") && crate_of_source(path).is_some()
}

/// What is wrong with what a constant says of itself.
fn without_source(constant: &Constant) -> Option<String> {
    let Constant { module, name, .. } = constant;
    let line = constant.line();
    let is_source = |word: &str| SOURCES.contains(&word.to_lowercase().as_str());
    let mut words = line.split(|c: char| !c.is_alphanumeric());
    if !words.any(is_source) {
        return Some(format!(
            "{module}::{name}: the first sentence of its comment says no source (one of: {})",
            SOURCES.join(", ")
        ));
    }
    let count = line.split_whitespace().count();
    (count > MOST_WORDS_OF_A_LINE).then(|| {
        format!("{module}::{name}: {count} words in its first sentence, {MOST_WORDS_OF_A_LINE} are allowed")
    })
}

fn page_of(constants: &[Constant]) -> String {
    let mut page = HEAD.to_owned();
    let (mut title, mut module) = ("", "");
    for constant in constants {
        if constant.title != title {
            title = constant.title;
            page += &format!("\n## {title}\n\n|constant|value|unit and source|\n|---|---|---|\n");
            module = "";
        }
        if constant.module != module {
            module = &constant.module;
            page += &format!("|**`{module}`**|||\n");
        }
        let line = constant.line();
        let told = match line.contains(LAYOUT) {
            true => LAYOUT,
            false => line.trim_end_matches('.'),
        };
        let (name, value) = (&constant.name, &constant.value);
        page += &format!("|`{name}`|`{value}`|{told}|\n");
    }
    page
}

#[cfg(test)]
mod tests;
