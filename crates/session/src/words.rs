//! Words of a device, as a person may be shown them.

/// A device's own words are cut to so many characters.
const MAX_TEXT_CHARS: usize = 200;

/// Words from outside, so that they can neither fill a line nor forge one.
pub(crate) fn printable(text: &str) -> String {
    let cut = text.chars().take(MAX_TEXT_CHARS);
    cut.flat_map(|c| match c.is_control() || is_invisible(c) {
        true => c.escape_debug().collect::<Vec<_>>(),
        false => vec![c],
    })
    .take(MAX_TEXT_CHARS)
    .collect()
}

/// Characters that turn or break a line without being control characters.
fn is_invisible(c: char) -> bool {
    matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}')
}

pub(crate) fn with_count(text: String, left_out: u64) -> String {
    match left_out {
        0 => text,
        _ => format!("{text} ({left_out} more before this)"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_words_turn_break_or_fill_a_line() {
        assert_eq!(printable("12 °C"), "12 °C");
        assert_eq!(
            printable("a\nb\u{1b}[2J\u{202e}"),
            "a\\nb\\u{1b}[2J\\u{202e}"
        );
        assert_eq!(
            printable(&"\n".repeat(9_000)).chars().count(),
            MAX_TEXT_CHARS
        );
        assert_eq!(with_count("no".to_owned(), 7), "no (7 more before this)");
    }
}
