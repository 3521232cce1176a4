use super::*;

fn error(text: &str) -> String {
    let refused = Config::parse(Path::new("my.toml"), text).unwrap_err();
    crate::exit::one_line(&refused)
}

#[test]
fn the_default_file_equals_the_defaults_in_code() {
    let parsed = Config::parse(Path::new("default.toml"), DEFAULT_TOML).unwrap();
    let lines = |config: &Config| -> Vec<String> {
        let text = toml::to_string(config).unwrap();
        text.lines().map(str::to_owned).collect()
    };
    let (file, code) = (lines(&parsed), lines(&Config::default()));
    let differing: Vec<_> = code.iter().filter(|line| !file.contains(line)).collect();
    assert!(
        differing.is_empty(),
        "in code, not in the file: {differing:?}"
    );
    assert_eq!(parsed, Config::default());
}

#[test]
fn the_file_for_the_real_unit_is_valid() {
    let text = include_str!("../../../../config/omniscan450-fs.toml");
    let parsed = Config::parse(Path::new("omniscan450-fs.toml"), text).unwrap();
    assert_eq!(parsed.sonar.url, "tcp://192.168.2.92:51200");
}

/// The keys of a TOML file, dotted, with those that are commented out.
fn keys_of(text: &str) -> Vec<(String, bool)> {
    let mut table = String::new();
    let mut keys = Vec::new();
    let mut explained = false;
    for line in text.lines() {
        if let Some(header) = line.strip_prefix('[').and_then(|l| l.split(']').next()) {
            table = format!("{header}.");
            continue;
        }
        let bare = line.trim_start_matches("# ");
        let name = bare.split_once(" = ").map(|(name, _)| name);
        let is_key = |name: &&str| !name.contains(' ') && !name.is_empty();
        match name.filter(is_key) {
            Some(name) => {
                keys.push((format!("{table}{name}"), explained));
                explained = false;
            }
            None => explained = line.starts_with('#'),
        }
    }
    keys
}

#[test]
fn the_default_file_explains_every_key() {
    let keys = keys_of(DEFAULT_TOML);
    for (key, explained) in &keys {
        assert!(explained, "{key} has no comment");
    }
    let full = Config {
        output: OutputConfig {
            map: Some("a".into()),
            truth: Some("a".into()),
            record: Some("a".into()),
            duration_s: Some(1.0),
            ..OutputConfig::default()
        },
        session: SessionConfig {
            channel: Some(0),
            ..SessionConfig::default()
        },
        bus: BusConfig {
            zenoh_config_file: Some("a".into()),
            ..BusConfig::default()
        },
        ..Config::default()
    };
    let mut expected = Vec::new();
    collect("", &toml::Value::try_from(full).unwrap(), &mut expected);
    let mut found: Vec<String> = keys.into_iter().map(|(key, _)| key).collect();
    expected.sort();
    found.sort();
    let missing: Vec<_> = expected.iter().filter(|key| !found.contains(key)).collect();
    assert!(missing.is_empty(), "not in the file: {missing:?}");
    assert_eq!(found, expected);
}

fn collect(prefix: &str, value: &toml::Value, keys: &mut Vec<String>) {
    match value {
        toml::Value::Table(table) => {
            for (name, value) in table {
                let dot = if prefix.is_empty() { "" } else { "." };
                collect(&format!("{prefix}{dot}{name}"), value, keys);
            }
        }
        _ => keys.push(prefix.to_owned()),
    }
}

#[test]
fn what_is_wrong_is_named_with_line_key_and_what_is_allowed() {
    let unknown = error("[pose]\nurl = \"zenoh://\"\nurll = 1\n");
    assert!(unknown.starts_with("my.toml:3: "), "{unknown}");
    assert!(
        unknown.contains("`urll`") && unknown.contains("`max_pose_gap_s`"),
        "{unknown}"
    );

    let kind = error("[session]\nbin_count = \"many\"\n");
    assert!(
        kind.starts_with("my.toml:2: ") && kind.contains("bin_count"),
        "{kind}"
    );

    let range = error("[mapper]\n\nblanking_m = -1.0\n");
    assert!(range.starts_with("my.toml:3: mapper.blanking_m"), "{range}");
    assert!(range.contains("0 to 100"), "{range}");

    let bus = error("[bus]\nnode = \"a/b\"\n");
    assert!(bus.starts_with("my.toml:2: bus.node"), "{bus}");

    for nan in [
        "[pose]\nmax_pose_gap_s = nan\n",
        "[pipeline]\nsnapshot_interval_s = nan\n",
    ] {
        assert!(error(nan).contains("allowed"), "{nan}");
    }
    assert!(error("[pose\n").starts_with("my.toml:1: "));
}
