//! The table of the mapper's constants against its code: each with the value it has, and no other.

use std::collections::BTreeMap;

use crate::code::{is_word, without_comments_and_literals, without_tests};
use crate::crates::{MAPPER, crate_of_source};
use crate::sources::SourceFile;

const TABLE: &str = "docs/constants.md";
const FOLDER: &str = "crates/mapper/src/";
/// The settings' defaults are constants as well.
const SETTINGS: &str = "crates/mapper/src/config.rs";

/// Value by name, modules first: `detect::copies::LEAST_SHARE`.
type Values = BTreeMap<String, String>;

/// Where table and code differ, one line each.
pub(crate) fn violations(files: &[SourceFile]) -> Vec<String> {
    let Some(table) = files.iter().find(|file| file.path == TABLE) else {
        return vec![format!("{TABLE} is missing")];
    };
    let (listed, mut broken) = listed(&table.text);
    let of_mapper = files.iter().filter(|file| is_code(&file.path));
    let for_tests: Vec<String> = of_mapper.clone().flat_map(modules_for_tests).collect();
    let built = of_mapper.filter(|file| !for_tests.contains(&file.path));
    let coded: Values = built.flat_map(constants_of).collect();
    for (name, value) in &coded {
        match listed.get(name) {
            Some(told) if told == value => {}
            Some(told) => broken.push(format!("{TABLE}: {name} is {value}, not {told}")),
            None => broken.push(format!("{TABLE}: {name} ({value}) is missing")),
        }
    }
    let gone = listed.keys().filter(|name| !coded.contains_key(*name));
    broken.extend(gone.map(|name| format!("{TABLE}: {name} is no constant of {MAPPER}")));
    broken
}

fn is_code(path: &str) -> bool {
    path.starts_with(FOLDER) && path.ends_with(".rs") && crate_of_source(path).is_some()
}

/// Paths of the files that a `mod.rs` brings in for tests alone.
fn modules_for_tests(file: &SourceFile) -> Vec<String> {
    const MARK: &str = "#[cfg(test)]\nmod ";
    let folder = file.path.trim_end_matches("mod.rs");
    let modules = file.text.split(MARK).skip(1);
    let named = modules.filter_map(|rest| rest.split_once(';'));
    named
        .map(|(name, _)| format!("{folder}{name}.rs"))
        .collect()
}

/// Rows of the tables whose first cell is a name in backticks and whose second is its value; and what stands
/// there twice.
fn listed(table: &str) -> (Values, Vec<String>) {
    let (mut values, mut twice) = (Values::new(), Vec::new());
    for line in table.lines() {
        let mut cells = line.split('|').skip(1).map(str::trim);
        let (Some(name), Some(value)) = (cells.next(), cells.next()) else {
            continue;
        };
        let Some(name) = quoted(name).filter(|name| name.contains("::")) else {
            continue;
        };
        let value = normalised(quoted(value).unwrap_or(value));
        if values.insert(name.to_owned(), value).is_some() {
            twice.push(format!("{TABLE}: {name} stands there twice"));
        }
    }
    (values, twice)
}

fn quoted(cell: &str) -> Option<&str> {
    cell.strip_prefix('`')?.strip_suffix('`')
}

fn constants_of(file: &SourceFile) -> Vec<(String, String)> {
    let code = without_tests(&without_comments_and_literals(&file.text));
    let module = file.path.trim_start_matches(FOLDER);
    let module = module.trim_end_matches(".rs").trim_end_matches("/mod");
    let module = module.replace('/', "::");
    let mut found = constants_in(&code);
    if file.path == SETTINGS {
        found.extend(defaults_in(&code));
    }
    let named = found
        .into_iter()
        .map(|(name, value)| (format!("{module}::{name}"), value));
    named.collect()
}

/// Name and value of every `const NAME: TYPE = VALUE;` that is made of numbers.
fn constants_in(code: &str) -> Vec<(String, String)> {
    const KEYWORD: &str = "const ";
    let starts = code.match_indices(KEYWORD).map(|(at, _)| at);
    let starts = starts.filter(|&at| !code[..at].ends_with(|c| is_word(c) || c == '*'));
    let found = starts.filter_map(|at| {
        let (name, rest) = code[at + KEYWORD.len()..].split_once(':')?;
        let name = name.trim();
        let (kind, rest) = rest.split_once('=')?;
        let is_name = !name.is_empty() && name.chars().all(is_word) && *name == name.to_uppercase();
        // Else it is a parameter: `<const N: usize>`.
        let is_name = is_name && !kind.contains('>');
        let value = normalised(&rest[..end_of_value(rest)?]);
        (is_name && is_of_numbers(kind.trim(), &value)).then(|| (name.to_owned(), value))
    });
    found.collect()
}

/// Position of the semicolon that ends an expression: none within brackets.
fn end_of_value(rest: &str) -> Option<usize> {
    let mut depth = 0_i32;
    let mut characters = rest.char_indices();
    let end = characters.find(|&(_, c)| {
        depth += i32::from("([{".contains(c)) - i32::from(")]}".contains(c));
        c == ';' && depth == 0
    });
    end.map(|(at, _)| at)
}

fn is_of_numbers(kind: &str, value: &str) -> bool {
    const NUMBERS: [&str; 8] = ["f32", "f64", "u8", "u16", "u32", "u64", "i32", "usize"];
    let has_figures = value.contains(|c: char| c.is_ascii_digit());
    NUMBERS.contains(&kind) || has_figures && !value.contains('{')
}

/// The fields that `fn default` sets to a figure.
fn defaults_in(code: &str) -> Vec<(String, String)> {
    let Some((_, body)) = code.split_once("fn default()") else {
        return Vec::new();
    };
    let body = body.split("\n    }").next().unwrap_or(body);
    let fields = body.lines().filter_map(|line| {
        let (name, value) = line.trim().trim_end_matches(',').split_once(": ")?;
        let is_figure = value.starts_with(|c: char| c.is_ascii_digit());
        is_figure.then(|| (name.to_owned(), normalised(value)))
    });
    fields.collect()
}

/// Without white space and without the comma that ends a list.
fn normalised(value: &str) -> String {
    let value: String = value.split_whitespace().collect();
    value.replace(",]", "]").replace(",)", ")")
}

#[cfg(test)]
mod tests {
    use super::*;

    const CODE: &str = "
        /// const COMMENT: f32 = 1.0;
        const SHARE: f32 = 0.7;
        pub(crate) const PAIRS: [(f32, f32); 2] = [
            (0.12, 4.0), // wide
            (0.06, 2.5),
        ];
        const SOME: [f64; 4] = [0.0; 4];
        const SURE: Verdict = Verdict::Published;
        fn g<const N: usize>(at: [f32; N]) { let x = N; }
        const fn f(at: *const f32) -> usize { const INNER: usize = 2 * N; INNER }
        #[cfg(test)]
        mod tests { const TESTED: f32 = 2.0; }
    ";
    const SETTINGS_CODE: &str = "
impl Default for MapperConfig {
    fn default() -> Self {
        Self {
            beam: Beam::default(),
            passes: 16,
        }
    }
}
";
    const ROWS: &str = "
| constant | value | unit |
|---|---|---|
| `detect::copies::SHARE` | `0.7` | 1 |
| `detect::copies::PAIRS` | `[(0.12, 4.0), (0.06, 2.5)]` | m |
| `detect::copies::SOME` | `[0.0; 4]` | m |
| `detect::copies::INNER` | `2 * N` | 1 |
| `config::passes` | `16` | steps |
";

    fn broken(code: &str, table: &str) -> Vec<String> {
        let file = |path: &str, text: &str| SourceFile {
            path: path.to_owned(),
            text: text.to_owned(),
        };
        violations(&[
            file("crates/mapper/src/detect/copies.rs", code),
            file("crates/mapper/src/detect/tests.rs", "const X: f32 = 1.0;"),
            file(
                "crates/mapper/src/detect/mod.rs",
                "#[cfg(test)]\nmod heard;\n",
            ),
            file("crates/mapper/src/detect/heard.rs", "const X: f32 = 1.0;"),
            file(SETTINGS, SETTINGS_CODE),
            file(TABLE, table),
        ])
    }

    #[test]
    fn a_table_that_says_what_the_code_does_is_right() {
        assert_eq!(broken(CODE, ROWS), Vec::<String>::new());
    }

    #[test]
    fn another_value_a_missing_row_and_one_too_many_are_told() {
        let told = broken(&CODE.replace("0.7", "0.8"), ROWS);
        assert_eq!(
            told,
            ["docs/constants.md: detect::copies::SHARE is 0.8, not 0.7"]
        );
        let told = broken(CODE, &ROWS.replace("`16`", "`12`"));
        assert_eq!(told, ["docs/constants.md: config::passes is 16, not 12"]);
        let told = broken(CODE, &ROWS.replace("::INNER", "::OUTER"));
        assert_eq!(
            told,
            [
                "docs/constants.md: detect::copies::INNER (2*N) is missing",
                "docs/constants.md: detect::copies::OUTER is no constant of echosplat-mapper",
            ]
        );
        let twice = format!("{ROWS}| `config::passes` | `16` | steps |\n");
        assert_eq!(
            broken(CODE, &twice),
            ["docs/constants.md: config::passes stands there twice"]
        );
    }

    #[test]
    fn a_checkout_without_the_table_is_told() {
        assert_eq!(violations(&[]), ["docs/constants.md is missing"]);
    }
}
