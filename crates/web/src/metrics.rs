//! The status as Prometheus reads it: every number and truth value in it, by its place.

use std::fmt::Write as _;

use serde_json::{Map, Value};

/// Deeper than any status.
const MAX_DEPTH: usize = 8;

/// Words of the status that are one of a few.
const STATES: [&str; 3] = ["phase", "link_state", "simd"];

/// The exposition text: the status's numbers, its notices, and `own` counters of the page.
pub(crate) fn text(status: Option<&Value>, age_s: Option<f64>, own: &[(&str, u64)]) -> String {
    let mut text = String::new();
    if let Some(age_s) = age_s {
        gauge(&mut text, "echosplat_status_age_seconds", age_s);
    }
    if let Some(Value::Object(status)) = status {
        object(&mut text, "", status, 0);
        notices(&mut text, status);
    }
    for (name, value) in own {
        let name = format!("echosplat_web_{name}");
        let _ = writeln!(text, "# TYPE {name} untyped\n{name} {value}");
    }
    text
}

fn object(text: &mut String, prefix: &str, fields: &Map<String, Value>, depth: usize) {
    for (key, value) in fields {
        let path = match prefix {
            "" => word_of(key),
            _ => format!("{prefix}_{}", word_of(key)),
        };
        let name = format!("echosplat_{path}");
        match value {
            Value::Number(number) => {
                if let Some(number) = number.as_f64() {
                    gauge(text, &name, number);
                }
            }
            Value::Bool(truth) => gauge(text, &name, f64::from(u8::from(*truth))),
            Value::Object(inner) if depth < MAX_DEPTH => object(text, &path, inner, depth + 1),
            Value::String(word) if STATES.contains(&path.as_str()) => {
                let word = quoted(word);
                let _ = writeln!(text, "# TYPE {name} untyped\n{name}{{is=\"{word}\"}} 1");
            }
            _ => {}
        }
    }
}

/// 1 while a notice stands, 0 once it is over.
fn notices(text: &mut String, status: &Map<String, Value>) {
    let Some(notices) = status.get("notices").and_then(Value::as_array) else {
        return;
    };
    text.push_str("# TYPE echosplat_notice untyped\n");
    for notice in notices {
        let code = notice["code"].as_str().unwrap_or_default();
        let stands = u8::from(notice["until_s"].is_null());
        let _ = writeln!(
            text,
            "echosplat_notice{{code=\"{}\"}} {stands}",
            quoted(code)
        );
    }
}

fn gauge(text: &mut String, name: &str, value: f64) {
    let _ = writeln!(text, "# TYPE {name} untyped\n{name} {value}");
}

/// What Prometheus takes in a name.
fn word_of(key: &str) -> String {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '_';
    key.chars().map(|c| if fits(c) { c } else { '_' }).collect()
}

fn quoted(text: &str) -> String {
    let mut quoted = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\\' | '"' => quoted.extend(['\\', c]),
            '\n' => quoted.push_str("\\n"),
            c => quoted.push(c),
        }
    }
    quoted
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_number_has_a_line_of_its_own() {
        let status = json!({
            "pings_received": 7,
            "final": false,
            "phase": "running",
            "simd": "avx2",
            "link": {"state": "up", "losses": 2, "device": "type 1"},
            "rates": {"pings-per.s": 39.5},
            "nothing": null,
            "notices": [
                {"code": "no_pings", "until_s": null},
                {"code": "odd\"\n", "until_s": 4.0},
            ],
        });
        let text = text(Some(&status), Some(0.25), &[("requests", 3)]);
        let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
        for wanted in [
            "echosplat_pings_received 7",
            "echosplat_final 0",
            "echosplat_phase{is=\"running\"} 1",
            "echosplat_simd{is=\"avx2\"} 1",
            "echosplat_link_state{is=\"up\"} 1",
            "echosplat_link_losses 2",
            "echosplat_rates_pings_per_s 39.5",
            "echosplat_notice{code=\"no_pings\"} 1",
            "echosplat_notice{code=\"odd\\\"\\n\"} 0",
            "echosplat_status_age_seconds 0.25",
            "echosplat_web_requests 3",
        ] {
            assert!(lines.contains(&wanted), "{wanted} in {text}");
        }
        assert_eq!(lines.len(), 11, "{text}");
    }
}
