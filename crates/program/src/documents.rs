//! The documents hold: every command in them is one that the program takes, every link leads somewhere, and no page
//! is longer than it may be.
//!
//! Commands are lines of `sh` blocks, and code within a sentence, that begin with `echosplat` or `cargo run … --`. What
//! stands for something else is a word of capitals (`FILE`, `HOST:PORT`), taken as it is, or as 1 where a number is asked
//! for; or `…`, which stands for the rest of a line: then something may be missing there. Missing is also allowed in a
//! sentence.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use clap::Parser;
use clap::error::ErrorKind;
use pulldown_cmark::{CodeBlockKind, Event, Options, Tag, TagEnd};

use crate::Arguments;

/// Most words of a page; of a folder, those of all its pages but the decisions. A word has a letter or a digit: the
/// lines of tables have none.
const LIMITS: [(&str, usize); 5] = [
    ("README.md", 900),
    ("ARCHITECTURE.md", 2_500),
    ("docs/develop/method.md", 4_000),
    ("docs/results.md", 1_500),
    ("docs", 16_600),
];
const DECISIONS: &str = "docs/decisions/";

/// What a page holds.
#[derive(Default)]
struct Page {
    words: usize,
    /// Command lines, and whether something may be missing in them.
    commands: Vec<(String, bool)>,
    links: Vec<String>,
    anchors: BTreeSet<String>,
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// All pages of the tree, by their path from its root.
fn pages() -> BTreeMap<String, Page> {
    let mut found = BTreeMap::new();
    collect(&root(), "", &mut found);
    found
}

fn collect(folder: &Path, prefix: &str, found: &mut BTreeMap<String, Page>) {
    for entry in fs::read_dir(folder).expect("the tree can be read") {
        let path = entry.expect("it can be read").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_made = name.starts_with('.') || ["target", "out", "venv"].contains(&&*name);
        let relative = format!("{prefix}{name}");
        if path.is_dir() && !is_made {
            collect(&path, &format!("{relative}/"), found);
        } else if name.ends_with(".md") {
            let text = fs::read_to_string(&path).expect("a page is text");
            found.insert(relative, read(&text));
        }
    }
}

/// The page of a text in Markdown.
fn read(text: &str) -> Page {
    let mut page = Page {
        words: text.split_whitespace().filter(is_word).count(),
        ..Page::default()
    };
    let mut heading: Option<String> = None;
    let mut block: Option<String> = None;
    for event in pulldown_cmark::Parser::new_ext(text, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::End(TagEnd::Heading(_)) => {
                let anchor = anchor(&heading.take().unwrap_or_default());
                page.add_anchor(&anchor);
            }
            Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(kind))) if &*kind == "sh" => {
                block = Some(String::new());
            }
            Event::End(TagEnd::CodeBlock) => {
                let lines = block.take().unwrap_or_default().replace("\\\n", " ");
                let lines = lines.lines().map(|line| (line.to_owned(), false));
                page.commands.extend(lines);
            }
            Event::Text(text) => {
                for into in [&mut heading, &mut block].into_iter().flatten() {
                    into.push_str(&text);
                }
            }
            Event::Code(code) => {
                heading
                    .iter_mut()
                    .for_each(|heading| heading.push_str(&code));
                page.commands.push((code.replace('\n', " "), true));
            }
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                page.links.push(dest_url.into_string());
            }
            Event::Html(html) | Event::InlineHtml(html) => {
                let sources = html.split("src=\"").skip(1);
                let sources = sources.filter_map(|rest| rest.split('"').next());
                page.links.extend(sources.map(str::to_owned));
            }
            _ => {}
        }
    }
    page
}

fn is_word(token: &&str) -> bool {
    token.contains(char::is_alphanumeric)
}

impl Page {
    /// A second heading of the same words has a number behind its anchor.
    fn add_anchor(&mut self, anchor: &str) {
        let numbered = (1..).map(|number| format!("{anchor}-{number}"));
        let mut names = std::iter::once(anchor.to_owned()).chain(numbered);
        let free = names.find(|name| !self.anchors.contains(name));
        self.anchors.extend(free);
    }
}

/// How a heading is linked to.
fn anchor(heading: &str) -> String {
    let kept = |c: &char| c.is_alphanumeric() || " -_".contains(*c);
    let kept = heading
        .to_lowercase()
        .chars()
        .filter(kept)
        .collect::<String>();
    kept.replace(' ', "-")
}

/// What is wrong with a command line, if it is one of ours.
fn fault(line: &str, may_lack: bool) -> Option<String> {
    let (line, may_lack) = match line.split_once('…') {
        Some((before, _)) => (before, true),
        None => (line, may_lack),
    };
    let Some(words) = shlex::split(line) else {
        return line
            .contains("echosplat ")
            .then(|| "quotes do not end".to_owned());
    };
    let is_operator =
        |word: &String| ["|", "||", "&", "&&", ";", ">", ">>", "<", "2>"].contains(&word.as_str());
    words
        .split(is_operator)
        .filter_map(arguments)
        .find_map(|arguments| refusal(&arguments, may_lack))
}

/// What stands behind our program's name.
fn arguments(words: &[String]) -> Option<Vec<String>> {
    let is_variable = |word: &&String| {
        word.split_once('=')
            .is_some_and(|(name, _)| is_placeholder(name))
    };
    let variables = words.iter().take_while(is_variable).count();
    let words = &words[variables..];
    let text: Vec<&str> = words.iter().map(String::as_str).collect();
    match text[..] {
        ["echosplat" | "target/release/echosplat", ..] => Some(words[1..].to_vec()),
        ["cargo", "run", ..] => {
            let at = text.iter().position(|word| *word == "--")?;
            let is_ours = text[..at]
                .iter()
                .all(|word| !["--example", "--package"].contains(word));
            is_ours.then(|| words[at + 1..].to_vec())
        }
        _ => None,
    }
}

/// Capitals, digits and what joins them, as in `HOST:PORT` and `ZENOH_CONFIG`.
fn is_placeholder(word: &str) -> bool {
    let is_of_one = |c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || "_:-".contains(c);
    word.starts_with(|c: char| c.is_ascii_uppercase()) && word.chars().all(is_of_one)
}

fn refusal(arguments: &[String], may_lack: bool) -> Option<String> {
    let is_bench = arguments.first().is_some_and(|name| name == "bench");
    if is_bench && !cfg!(feature = "bench") {
        return None;
    }
    let parsed = |arguments: &[String]| {
        let words = std::iter::once("echosplat").chain(arguments.iter().map(String::as_str));
        Arguments::try_parse_from(words).err()
    };
    let with_numbers: Vec<String> = arguments
        .iter()
        .map(|word| match is_placeholder(word) {
            true => "1".to_owned(),
            false => word.clone(),
        })
        .collect();
    let error = parsed(arguments)?;
    let kinds_of_lack = [
        ErrorKind::MissingRequiredArgument,
        ErrorKind::MissingSubcommand,
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand,
    ];
    let is_fine = match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => true,
        ErrorKind::ValueValidation => parsed(&with_numbers).is_none(),
        kind => may_lack && kinds_of_lack.contains(&kind),
    };
    let words = error.to_string();
    (!is_fine).then(|| words.lines().next().unwrap_or_default().to_owned())
}

#[test]
fn every_command_in_the_documents_is_one_that_the_program_takes() {
    let pages = pages();
    let (mut faults, mut count) = (Vec::new(), 0);
    for (path, page) in &pages {
        for (line, may_lack) in &page.commands {
            count += usize::from(line.contains("echosplat ") && !may_lack);
            let found = fault(line, *may_lack);
            faults.extend(found.map(|fault| format!("{path}: `{}`: {fault}", line.trim())));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(count > 40, "{count} commands are few");
}

#[test]
fn every_link_in_the_documents_leads_somewhere() {
    let pages = pages();
    let (mut faults, mut count) = (Vec::new(), 0);
    for (path, page) in &pages {
        for link in page.links.iter().filter(|link| !link.contains("://")) {
            count += 1;
            let found = dead_end(path, link, &pages);
            faults.extend(found.map(|fault| format!("{path}: {link}: {fault}")));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(count > 60, "{count} links are few");
}

fn dead_end(from: &str, link: &str, pages: &BTreeMap<String, Page>) -> Option<&'static str> {
    let (path, anchor) = link.split_once('#').unwrap_or((link, ""));
    let target = match path.is_empty() {
        true => from.to_owned(),
        false => beside(from, path),
    };
    if !root().join(&target).exists() {
        return Some("there is no such file");
    }
    let anchors = pages.get(&target).map(|page| &page.anchors);
    let is_there = anchor.is_empty() || anchors.is_some_and(|anchors| anchors.contains(anchor));
    (!is_there).then_some("there is no such heading")
}

/// A path as seen from a page, from the root.
fn beside(page: &str, path: &str) -> String {
    let mut parts: Vec<&str> = page.split('/').collect();
    parts.pop();
    for part in path
        .split('/')
        .filter(|part| !part.is_empty() && *part != ".")
    {
        match part {
            ".." => drop(parts.pop()),
            name => parts.push(name),
        }
    }
    parts.join("/")
}

#[test]
fn no_page_has_more_words_than_it_may() {
    let pages = pages();
    for (name, limit) in LIMITS {
        let folder = format!("{name}/");
        let of_it = |path: &str| path == name || path.starts_with(&folder);
        let counted = pages
            .iter()
            .filter(|(path, _)| of_it(path) && !path.starts_with(DECISIONS));
        let words: usize = counted.map(|(_, page)| page.words).sum();
        assert!(
            words <= limit,
            "{name}: {words} words, and {limit} are allowed"
        );
    }
}

#[test]
fn what_is_wrong_is_found() {
    let text = "# A `b`, c\n## A b c\n[x](y.md#z) `echosplat swim`\n```sh\nX=1 echosplat info \\\n --jso f # c\n```\n";
    let page = read(text);
    assert_eq!(
        page.anchors.iter().collect::<Vec<_>>(),
        ["a-b-c", "a-b-c-1"]
    );
    assert_eq!(page.links, ["y.md#z"]);
    assert_eq!(page.commands.len(), 3);
    let faults = page
        .commands
        .iter()
        .filter_map(|(line, may_lack)| fault(line, *may_lack));
    assert_eq!(faults.count(), 2);
    for sound in [
        "echosplat run … --map map.ply",
        "echosplat replay FILE --rate N --map FILE.ply",
    ] {
        assert_eq!(fault(sound, false), None, "{sound}");
    }
    assert!(fault("echosplat replay", false).is_some());
    assert!(fault("cd x && cargo run --release -- demo --depth 3", false).is_some());
    assert_eq!(
        beside("docs/a.md", "../crates/bus/README.md"),
        "crates/bus/README.md"
    );
}
