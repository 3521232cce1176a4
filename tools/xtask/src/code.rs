//! Rust source with what is no code blanked out, so that rules look at code only.

/// The source with comments and the insides of string and character literals blanked out. Line
/// breaks stay, so that line numbers do.
pub(crate) fn without_comments_and_literals(source: &str) -> String {
    let characters: Vec<char> = source.chars().collect();
    let mut code = String::with_capacity(source.len());
    let mut at = 0;
    while at < characters.len() {
        let rest = &characters[at..];
        let follows_word = at > 0 && is_word(characters[at - 1]);
        let length = blank_length(rest, follows_word);
        match length {
            0 => code.push(rest[0]),
            _ => rest[..length].iter().for_each(|&c| code.push(blanked(c))),
        }
        at += length.max(1);
    }
    code
}

/// The code without items marked `#[cfg(test)]`, given code from
/// [`without_comments_and_literals`].
pub(crate) fn without_tests(code: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let mut kept = String::with_capacity(code.len());
    let mut rest = code;
    while let Some(at) = rest.find(MARK) {
        let (before, item) = rest.split_at(at);
        let (item, after) = item.split_at(item_length(item));
        kept.push_str(before);
        kept.extend(item.chars().map(blanked));
        rest = after;
    }
    kept.push_str(rest);
    kept
}

/// Whether the character can be part of a name.
pub(crate) fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

fn blanked(c: char) -> char {
    if c == '\n' { c } else { ' ' }
}

/// Bytes up to the end of the item: its closing brace, or a semicolon before any brace.
fn item_length(item: &str) -> usize {
    let mut depth = 0_usize;
    for (at, c) in item.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth <= 1 => return at + 1,
            '}' => depth -= 1,
            ';' if depth == 0 => return at + 1,
            _ => {}
        }
    }
    item.len()
}

/// How many characters a comment or literal beginning here takes; 0 if none begins.
fn blank_length(rest: &[char], follows_word: bool) -> usize {
    match rest {
        ['/', '/', ..] => until(rest, |tail| tail.first() == Some(&'\n')),
        ['/', '*', ..] => block_comment_length(rest),
        ['"', ..] => quoted_length(rest, '"'),
        ['r', '"' | '#', ..] if !follows_word => raw_string_length(rest, 1),
        ['b' | 'c', 'r', '"' | '#', ..] if !follows_word => raw_string_length(rest, 2),
        ['\'', '\\', ..] | ['\'', _, '\'', ..] => quoted_length(rest, '\''),
        _ => 0,
    }
}

fn until(rest: &[char], end: impl Fn(&[char]) -> bool) -> usize {
    (0..rest.len())
        .find(|&at| end(&rest[at..]))
        .unwrap_or(rest.len())
}

fn block_comment_length(rest: &[char]) -> usize {
    let (mut depth, mut at) = (0_usize, 0);
    while at < rest.len() {
        match rest[at..] {
            ['/', '*', ..] => (depth, at) = (depth + 1, at + 2),
            ['*', '/', ..] if depth == 1 => return at + 2,
            ['*', '/', ..] => (depth, at) = (depth - 1, at + 2),
            _ => at += 1,
        }
    }
    rest.len()
}

fn quoted_length(rest: &[char], quote: char) -> usize {
    let mut at = 1;
    while at < rest.len() {
        match rest[at] {
            '\\' => at += 2,
            c if c == quote => return at + 1,
            _ => at += 1,
        }
    }
    rest.len()
}

/// `r#name` is a name, not a string: 0.
fn raw_string_length(rest: &[char], prefix: usize) -> usize {
    let hashes = until(&rest[prefix..], |tail| tail.first() != Some(&'#'));
    let open = prefix + hashes;
    if rest.get(open) != Some(&'"') {
        return 0;
    }
    let end: Vec<char> = std::iter::once('"').chain(vec!['#'; hashes]).collect();
    let inside = until(&rest[open + 1..], |tail| tail.starts_with(&end));
    (open + 1 + inside + end.len()).min(rest.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(source: &str) -> String {
        without_comments_and_literals(source)
    }

    #[test]
    fn comments_and_literals_are_blank_and_lines_stay() {
        let source = "a(\"x \\\" y\"); // z\n/* p /* q */ p */ b('x', '\\'', b\"y\");\n";
        let expected = "a(        );     \n                  b(   ,     , b   );\n";
        assert_eq!(code(source), expected);
    }

    #[test]
    fn raw_strings_end_at_their_own_hashes() {
        assert_eq!(
            code("f(r#\"a\" b\"#); g"),
            format!("f({}); g", " ".repeat(9))
        );
        assert_eq!(code("f(r\"\\\"); g"), format!("f({}); g", " ".repeat(4)));
        assert_eq!(code("r#type + for\"x\""), "r#type + for   ");
    }

    #[test]
    fn lifetimes_are_code() {
        let source = "fn f<'a>(x: &'a str) -> &'a str { x }";
        assert_eq!(code(source), source);
    }

    #[test]
    fn what_never_ends_is_blank_to_the_end() {
        for source in ["\"abc", "/* abc", "r#\"abc", "'\\"] {
            assert_eq!(code(source).trim(), "", "{source}");
        }
    }

    #[test]
    fn items_for_tests_are_left_out() {
        let source = "a;\n#[cfg(test)]\nmod tests { fn f() { g() } }\nb;\n#[cfg(test)]\nuse c;\nd;";
        let kept = without_tests(source);
        let words: Vec<&str> = kept.split_whitespace().collect();
        assert_eq!(words, ["a;", "b;", "d;"]);
        assert_eq!(kept.lines().count(), source.lines().count());
    }
}
