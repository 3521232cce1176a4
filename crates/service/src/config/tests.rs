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

#[test]
fn the_default_file_explains_every_key() {
    let keys = keys::keys_of(DEFAULT_TOML);
    for key in &keys {
        assert!(!key.meaning.is_empty(), "{} has no comment", key.name);
    }
    let full = Config {
        output: OutputConfig {
            map: Some("a".into()),
            track: Some("a.tum".into()),
            truth: Some("a".into()),
            record: Some("a".into()),
            duration_s: Some(1.0),
            ..OutputConfig::default()
        },
        session: SessionConfig {
            channel: Some(0),
            source: Some(1),
            heading_deg: Some(90.0),
            ..SessionConfig::default()
        },
        bus: BusConfig {
            zenoh_config_file: Some("a".into()),
            ros_domain_id: Some(0),
            ..BusConfig::default()
        },
        georeference: GeoreferenceConfig {
            origin: Some("60,25,0".into()),
            gnss: Some("udp://0.0.0.0:10110".parse().unwrap()),
            x_heading_deg: Some(90.0),
            ..GeoreferenceConfig::default()
        },
        web: WebConfig {
            address: Some("a".into()),
            ..WebConfig::default()
        },
        ..Config::default()
    };
    // A secret is read and never written, and nor is what needs it.
    let mut expected = ["web.token", "web.cockpit_actions"]
        .map(str::to_owned)
        .to_vec();
    collect("", &toml::Value::try_from(full).unwrap(), &mut expected);
    let mut found: Vec<String> = keys.into_iter().map(|key| key.name).collect();
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
    assert_eq!(
        unknown,
        "my.toml:3: pose.urll: no such key; did you mean `url`?"
    );

    let kind = error("[session]\nbin_count = \"many\"\n");
    let expected =
        "my.toml:2: session.bin_count: is \"many\"; allowed is a whole number, such as 600";
    assert!(kind.starts_with(expected), "{kind}");
    assert!(kind.contains("200 to 1200"), "{kind}");

    let range = error("[mapper]\n\nblanking_m = -1.0\n");
    assert!(range.starts_with("my.toml:3: mapper.blanking_m"), "{range}");
    assert!(range.contains("0 to 100"), "{range}");

    let poses = error("[pose]\nurl = \"ros2:///odom\"\n");
    assert!(poses.starts_with("my.toml:2: pose.url: "), "{poses}");
    assert!(poses.contains("bus.ros_domain_id"), "{poses}");
    let ros = error("[bus]\nros_domain_id = 0\nnode = \"450\"\n");
    assert!(ros.starts_with("my.toml:3: bus.node: is \"450\""), "{ros}");

    let bus = error("[bus]\nnode = \"a/b\"\n");
    assert!(bus.starts_with("my.toml:2: bus.node"), "{bus}");

    let beam = error("[mapper.beam]\nelevation_width_deg = 0.0\n");
    assert!(
        beam.starts_with("my.toml:2: mapper.beam.elevation_width_deg: is 0; allowed is 1 to 120"),
        "{beam}"
    );

    for nan in [
        "[pose]\nmax_pose_gap_s = nan\n",
        "[pipeline]\nsnapshot_interval_s = nan\n",
    ] {
        assert!(error(nan).contains("allowed"), "{nan}");
    }
    assert!(error("[pose\n").starts_with("my.toml:1: "));
}

#[test]
fn all_that_is_wrong_is_told_at_once_in_the_files_order() {
    let text = "[sonar]\nurl = 3\nio_timeout_s = 0.0\nreconnect_min_s = 20.0\n\
                reconnect_max_s = 10.0\n[sesion]\nbin_count = 600\n[session]\nbin_count = 5\n\
                gain_offset_db = [1e9]\n[mapper.parts]\nglints = \"maybe\"\n[bus]\nnodes = \"a\"\n\
                pose_queue_len = 0\n[pipeline]\nhold_back_every = 1\n[output]\nmap = true\n";
    let refused = Config::parse(Path::new("my.toml"), text).unwrap_err();
    let lines = crate::exit::lines(&refused);
    let expected = [
        "my.toml:2: sonar.url: is 3; allowed is a text",
        "my.toml:3: sonar.io_timeout_s: is 0",
        "my.toml:5: sonar.reconnect_max_s: is 10; allowed is 20 to 60",
        "my.toml:6: sesion: no such table; did you mean [session]?",
        "my.toml:9: session.bin_count: is 5",
        "my.toml:10: session.gain_offset_db: is 1000000000",
        "my.toml:12: mapper.parts.glints: is \"maybe\"; allowed is a text",
        "my.toml:14: bus.nodes: no such key; did you mean `node`?",
        "my.toml:15: bus.pose_queue_len: is 0; allowed is 1 to 1048576",
        "my.toml:17: pipeline.hold_back_every: is 1",
        "my.toml:19: output.map: is true; allowed is a text",
    ];
    for (line, start) in lines.iter().zip(expected) {
        assert!(line.starts_with(start), "{line}\nexpected {start}");
    }
    assert_eq!(lines.len(), expected.len(), "{lines:#?}");
}

#[test]
fn a_file_full_of_faults_is_told_shortly() {
    let text: String = (0..5_000).map(|i| format!("key_{i} = 1\n")).collect();
    let refused = Config::parse(Path::new("my.toml"), &text).unwrap_err();
    let lines = crate::exit::lines(&refused);
    assert!(lines.len() < 30, "{}", lines.len());
    assert!(lines.last().is_some_and(|line| line.contains("and more")));
    for open in ["[", "{ a = ", "[[", "\"", "x."] {
        let text = format!("a = {}", open.repeat(100_000));
        let refused = Config::parse(Path::new("my.toml"), &text).unwrap_err();
        assert!(crate::exit::lines(&refused).len() < 30, "{open}");
    }
}

#[test]
fn the_basic_file_is_valid_and_holds_what_owners_set() {
    let parsed = Config::parse(Path::new("basic.toml"), BASIC_TOML).unwrap();
    assert_eq!(parsed, Config::default());
    let keys = keys::keys_of(BASIC_TOML);
    assert!((12..=15).contains(&keys.len()), "{}", keys.len());
    for key in keys {
        assert!(!key.meaning.is_empty(), "{} has no comment", key.name);
        let full = keys::find(&key.name);
        let full = full.unwrap_or_else(|| panic!("{} is no key", key.name));
        assert_eq!(key.example, full.example, "{}", key.name);
    }
    // Those that are commented out can be set as they stand there.
    let all = BASIC_TOML
        .replace("# map", "map")
        .replace("# record", "record");
    let parsed = Config::parse(Path::new("basic.toml"), &all).unwrap();
    assert_eq!(parsed.output.map, Some("map.ply".into()));
    assert_eq!(parsed.output.record, Some("recordings".into()));
}

mod mutated;
