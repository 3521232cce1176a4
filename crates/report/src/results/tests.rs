use super::*;

/// A run whose map is `cd_m` off.
fn run(seed: u64, cd_m: f64) -> Run {
    Run {
        seed,
        cd_m,
        p99_m: 3.0 * cd_m,
        hd_m: 10.0 * cd_m,
        confident: 1000,
        dive_s: 240.0,
        pings: 9600,
        live_s: 24.0,
        total_s: 48.0,
        peak_bytes: 100_000_000,
        ..Run::default()
    }
}

fn case(scene: &str, noise: &str, cds_m: &[f64]) -> Case {
    let runs = cds_m.iter().enumerate();
    Case {
        scene: scene.to_owned(),
        dive: "survey".to_owned(),
        noise: noise.to_owned(),
        runs: runs
            .map(|(index, cd_m)| run(index as u64 + 1, *cd_m))
            .collect(),
    }
}

fn point(compute_s: f64, cd_m: f64) -> Point {
    Point {
        compute_s,
        cd_m,
        p99_m: cd_m,
        ..Point::default()
    }
}

fn watched(dive: &str) -> Watched {
    let curve = |method: &str| Curve {
        method: method.to_owned(),
        points: vec![point(1.0, f64::INFINITY), point(2.0, 0.1), point(9.0, 0.02)],
    };
    Watched {
        dive: dive.to_owned(),
        curves: vec![curve("paper"), curve("online")],
    }
}

fn sample() -> Results {
    let live = |share: f64, ended: Option<Point>| Live {
        scene: "fence".to_owned(),
        seed: 1,
        share,
        live: point(5.0, 0.04),
        ended,
    };
    Results {
        version: "0.1.0".to_owned(),
        commit: "0123abc".to_owned(),
        jobs: 2,
        command: "echosplat bench report --out docs/results.json".to_owned(),
        thinned: vec!["Seeds 4 and 5.".to_owned()],
        accuracy: vec![
            case("fence", "nominal", &[0.021, 0.023, 0.022]),
            case("fence", "harsh", &[0.05]),
            case("empty", "nominal", &[]),
        ],
        live: vec![live(0.3, Some(point(4.0, 0.03))), live(0.4, None)],
        sigma: vec![Sigma {
            noise: "nominal".to_owned(),
            maps: 4,
            within_share: 0.95,
            tenths_m: vec![(0.02, 0.01), (0.03, 0.045)],
            probability: vec![(0.5, 0.45, 400), (0.9, 0.1, 2)],
        }],
        noise: vec![Noise {
            pings: "field".to_owned(),
            over_noise_db: 14.0,
            run: run(1, 0.03),
        }],
        error_time: vec![watched("fence, survey, nominal")],
        length: vec![case("fence", "nominal", &[0.02, 0.021])],
        targets: vec![
            judged("CD", "failed", Some(1.5)),
            judged("HD", "passed", None),
        ],
        ..Results::default()
    }
}

fn judged(quantity: &str, verdict: &str, times: Option<f64>) -> Judged {
    Judged {
        case: "fence, survey, nominal".to_owned(),
        quantity: quantity.to_owned(),
        asked: "≤ 0.030".to_owned(),
        median: "0.045".to_owned(),
        worst: "0.050".to_owned(),
        seeds: 3,
        verdict: verdict.to_owned(),
        times,
    }
}

fn page(results: &Results) -> Result<Page, PageError> {
    Page::of(&serde_json::to_string(results).unwrap(), "results")
}

#[test]
fn a_file_survives_itself_and_infinite_errors_with_it() {
    let results = sample();
    let json = serde_json::to_string(&results).unwrap();
    assert_eq!(serde_json::from_str::<Results>(&json).unwrap(), results);
    assert!(json.contains("\"cd_m\":null"));
}

#[test]
fn the_page_shows_medians_what_is_missed_and_what_was_thinned() {
    let Page { text, charts } = page(&sample()).unwrap();
    // The median of three seeds, and the worst.
    assert!(
        text.contains("|fence, survey, nominal|3|0.022 m|0.023 m|0.066 m|0.220 m|"),
        "{text}"
    );
    assert!(text.contains("Of 2 targets 1 are met, 1 are missed and 0 have runs"));
    assert!(text.contains("|≤ 0.030|0.045|0.050|1.50 times|"));
    assert!(!text.contains("|HD|≤"), "what is met is not listed");
    assert!(text.contains("* Seeds 4 and 5.\n"));
    // A tenth of 300 Gaussians and more counts, two do not.
    assert!(text.contains("0.50 to 1.50|5.0 points"));
    assert!(text.contains("|fence, nominal|0.10 s|0.20 s|200|0.3|"));
    assert!(text.contains("|pings|14 dB|") && text.contains("|field, CD m|0.030|"));
    let names: Vec<&str> = charts.iter().map(|chart| chart.0.as_str()).collect();
    let expected = [
        "live.svg",
        "sigma.svg",
        "probability.svg",
        "noise.svg",
        "error-fence-survey-nominal.svg",
        "memory.svg",
    ];
    assert_eq!(names, expected);
    assert!(
        names
            .iter()
            .all(|name| text.contains(&format!("(results/{name})")))
    );
}

#[test]
fn parts_that_were_not_run_say_so_and_have_no_chart() {
    let Page { text, charts } = page(&Results::default()).unwrap();
    assert!(charts.is_empty());
    assert_eq!(text.matches("Not run yet.").count(), 7, "{text}");
    assert!(text.contains("figure_readme.py"));
}

#[test]
fn a_page_that_is_too_long_is_refused() {
    let mut many = sample();
    many.thinned = vec!["Once more. ".repeat(MOST_WORDS)];
    assert!(matches!(page(&many), Err(PageError::Words(_))));
    let mut drawn = sample();
    drawn.error_time = (0..4)
        .map(|index| watched(&format!("fence, {index}")))
        .collect();
    assert!(matches!(page(&drawn), Err(PageError::Charts(9))));
    assert!(matches!(Page::of("{}", "results"), Err(PageError::Json(_))));
}

#[test]
fn the_last_line_changes_with_file_page_and_charts() {
    let mark = |results: &Results| {
        let page = page(results).unwrap();
        let (_, mark) = page.text.rsplit_once("<!-- made from").unwrap();
        let parts: Vec<String> = mark.split([',', ' ']).map(str::to_owned).collect();
        parts
    };
    let (one, mut other) = (mark(&sample()), sample());
    other.error_time[0].curves[0].points[1].cd_m = 0.11;
    let other = mark(&other);
    assert_eq!(one.len(), other.len());
    let changed = one.iter().zip(&other).filter(|(a, b)| a != b).count();
    // Nothing of the page is this point's, but the best error is not either.
    assert_eq!(changed, 2, "{one:?} {other:?}");
    assert_eq!(one, mark(&sample()));
}

#[test]
fn the_readme_has_the_pages_table_between_its_marks() {
    let readme = format!("# A\n\n{ACCURACY_MARK}\nold\n{ACCURACY_MARK}\n\nmore\n");
    let text = with_accuracy(&readme, &sample()).unwrap();
    assert!(text.starts_with("# A\n") && text.ends_with("\n\nmore\n") && !text.contains("old"));
    let between = |text: &str| text.split(ACCURACY_MARK).nth(1).unwrap().to_owned();
    assert_eq!(between(&text), between(&page(&sample()).unwrap().text));
    assert!(between(&text).contains("(`harsh`)|0.050 m|–|–|–|"));
    assert_eq!(with_accuracy(&text, &sample()).unwrap(), text);
    assert!(with_accuracy("# without\n", &sample()).is_none());
    assert!(with_accuracy(ACCURACY_MARK, &sample()).is_none());
}
