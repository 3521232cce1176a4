use super::*;

const CODE: &str = "
    /// Fraction, found: const COMMENT: f32 = 1.0. Of what is heard.
    const SHARE: f32 = 0.7;
    /// Metres; derived.
    pub(crate) const PAIRS: [(f32, f32); 2] = [
        (0.12, 4.0), // wide
        (0.06, 2.5),
    ];
    const SURE: Verdict = Verdict::Published;
    fn g<const N: usize>(at: [f32; N]) { let x = N; }
    const fn f(at: *const f32) -> usize {
        /// Numbers; layout of a block.
        const INNER: usize = 2 * N;
        INNER
    }
    impl Real for f32 { const ONE: Self = 1.0; }
    #[cfg(test)]
    mod tests { const TESTED: f32 = 2.0; }
";
const SETTINGS_CODE: &str = "
    pub struct MapperConfig {
        pub beam: Beam,
        /// Steps; found.
        pub passes: usize,
    }
    impl Default for MapperConfig {
        fn default() -> Self { Self { beam: Beam::default(), passes: 16 } }
    }
";

fn file(path: &str, text: &str) -> SourceFile {
    SourceFile {
        path: path.to_owned(),
        text: text.to_owned(),
    }
}

fn sources(code: &str) -> Vec<SourceFile> {
    vec![
        file("crates/mapper/src/detect/copies.rs", code),
        file("crates/mapper/src/detect/tests.rs", "const X: f32 = 1.0;"),
        file(
            "crates/mapper/src/detect/mod.rs",
            "#[cfg(test)]\nmod heard;\n",
        ),
        file("crates/mapper/src/detect/heard.rs", "const X: f32 = 1.0;"),
        file("crates/mapper/src/config.rs", SETTINGS_CODE),
        file("crates/simulator/src/lib.rs", "const X: f32 = 1.0;"),
    ]
}

/// What is said of the code beside the page made of `of`.
fn broken(code: &str, of: &str) -> Vec<String> {
    let page = page(&sources(of)).unwrap();
    let mut files = sources(code);
    files.push(file(PAGE, &page));
    violations(&files)
}

#[test]
fn the_page_has_a_line_for_each_constant_and_none_of_tests() {
    let page = page(&sources(CODE)).unwrap();
    let lines: Vec<&str> = page.lines().filter(|line| line.contains('`')).collect();
    let of_page = &lines[lines.len() - 6..];
    assert_eq!(
        of_page,
        [
            "|**`config`**|||",
            "|`passes`|`16`|Steps; found|",
            "|**`detect::copies`**|||",
            "|`SHARE`|`0.7`|Fraction, found: const COMMENT: f32 = 1.0|",
            "|`PAIRS`|`[(0.12,4.0),(0.06,2.5)]`|Metres; derived|",
            "|`INNER`|`2*N`|layout|",
        ]
    );
    assert_eq!(broken(CODE, CODE), Vec::<String>::new());
}

#[test]
fn a_page_that_is_stale_or_missing_is_told() {
    let stale = [format!(
        "{PAGE} is not what the code says: run `cargo xtask constants`"
    )];
    let other_value = CODE.replace("0.7", "0.8");
    assert_eq!(broken(&other_value, CODE), stale);
    let other_source = CODE.replace("Metres; derived", "Metres; found");
    assert_eq!(broken(&other_source, CODE), stale);
    let missing = violations(&sources(CODE));
    assert_eq!(
        missing,
        [format!("{PAGE} is missing: run `cargo xtask constants`")]
    );
}

#[test]
fn a_constant_that_gives_no_source_is_told() {
    let bare = CODE.replace("/// Metres; derived.", "");
    let told = broken(&bare, &bare);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(
        told[0].starts_with("detect::copies::PAIRS: the first sentence"),
        "{told:?}"
    );
    let wordy = CODE.replace(
        "Metres; derived",
        "Metres; derived from this and that and much else as told at length",
    );
    let told = broken(&wordy, &wordy);
    assert!(told[0].contains("words in its first sentence"), "{told:?}");
}
