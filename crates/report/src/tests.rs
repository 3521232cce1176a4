use glam::DVec3;

use super::*;
use echosplat_metrics::sample::run;
use echosplat_metrics::{MapPoints, Truth, evaluate};

fn report() -> Report {
    let ring = |radius: f64, count: usize| -> Vec<DVec3> {
        let angle = |i: usize| i as f64 / count as f64 * std::f64::consts::TAU;
        let place = |i| DVec3::new(angle(i).cos(), angle(i).sin(), 0.3 * angle(i)) * radius;
        (0..count).map(place).collect()
    };
    let truth = Truth::from_points(&ring(3.0, 50_000));
    let points = MapPoints::of_positions(ring(3.06, 20_000));
    let mut failed = run("carving <M of N>", 2, 1.0, 6);
    failed.failure = Some("out of memory".into());
    let section = Section {
        title: "fence & survey".into(),
        text: "A dive.".into(),
        curves: vec![
            run("online", 1, 3.0, 12),
            run("online", 2, 2.0, 12),
            run("carving <M of N>", 1, 5.0, 6),
            failed,
        ],
        metrics: Some(evaluate(&points, &truth)),
        picture: Some(Picture::new(&points, &truth)),
        plots: vec![Plot {
            x_label: "epoch".into(),
            y_label: "loss".into(),
            lines: vec![(
                "L1 <loss>".into(),
                vec![(0.0, 1.0), (1.0, 0.5), (2.0, f64::NAN)],
            )],
            ..Plot::default()
        }],
        tables: vec![Table {
            title: "Ablation".into(),
            columns: vec!["part".into(), "CD m".into(), "verdict".into()],
            rows: vec![vec!["occlusion".into(), "0.03".into(), FAILED.into()]],
            note: "n = 5".into(),
        }],
    };
    Report {
        title: "EchoSplat".into(),
        subtitle: "echosplat demo".into(),
        highlights: vec![("CD".into(), "0.030 m".into())],
        machine: vec![("CPU".into(), "two cores".into())],
        seeds: vec![1, 2],
        notes: vec!["`paper` ran with one seed.".into()],
        sections: vec![section],
    }
}

#[test]
fn the_report_is_whole_self_contained_and_small() {
    let html = report().to_html();
    assert!(html.len() < 2_000_000, "{} bytes", html.len());
    for foreign in [
        "http:", "https:", "src=", "href=", "url(", "@import", "<script",
    ] {
        assert!(!html.contains(foreign), "{foreign}");
    }
    for wrong in ["NaN", "inf\"", "<M of N>"] {
        assert!(!html.contains(wrong), "{wrong}");
    }
    for part in [
        "fence &amp; survey",
        "seed 2: failed: out of memory",
        "1 of 12 samples",
        "Ablation",
        "class=\"failed\"",
        "L1 &lt;loss&gt;",
        "two cores",
        "1, 2",
        "raw",
        "paper's protocol",
        "prefers-color-scheme: dark",
    ] {
        assert!(html.contains(part), "{part}");
    }
    assert_closed(&html);
}

fn assert_closed(html: &str) {
    for tag in [
        "section", "svg", "table", "ul", "figure", "details", "div", "g",
    ] {
        let opened =
            html.matches(&format!("<{tag}>")).count() + html.matches(&format!("<{tag} ")).count();
        assert_eq!(opened, html.matches(&format!("</{tag}>")).count(), "{tag}");
    }
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    assert_eq!(report().to_html(), report().to_html());
}

#[test]
fn text_cannot_become_markup() {
    assert_eq!(
        escape("<a b=\"c\">&\u{7}"),
        "&lt;a b=&quot;c&quot;&gt;&amp; "
    );
}

/// A number in scientific notation, or a power of ten raised.
fn has_exponent(html: &str) -> bool {
    let bytes = html.as_bytes();
    let is_exponent = |at: usize| {
        let (before, after) = (bytes[at - 1], &bytes[at + 1..]);
        let signed = after.strip_prefix(b"-").or(after.strip_prefix(b"+"));
        let digit = signed.unwrap_or(after).first();
        before.is_ascii_digit() && digit.is_some_and(u8::is_ascii_digit)
    };
    let found = html
        .match_indices(['e', 'E'])
        .any(|(at, _)| at > 0 && is_exponent(at));
    found || html.contains("10⁻") || html.contains("·10")
}

/// Without scripts, styles and packed numbers.
fn read_by_people(html: &str) -> String {
    let mut rest = html;
    let mut text = String::new();
    while let Some((before, after)) = rest.split_once("<script") {
        text += before;
        rest = after.split_once("</script>").unwrap().1;
    }
    text += rest;
    let (head, body) = text.split_once("<style>").unwrap();
    head.to_owned() + body.split_once("</style>").unwrap().1
}

fn dive() -> DiveReport {
    let plot = |index: usize| Plot {
        x_label: "dive time, s".into(),
        y_label: format!("number {index}"),
        x_is_linear: true,
        y_is_linear: true,
        lines: vec![("one".into(), vec![(0.0, 0.0), (1e7, 3e-5)])],
        ..Plot::default()
    };
    let section = report().sections.remove(0);
    let gaussian = echosplat_model::Gaussian {
        id: 1,
        mean_m: glam::Vec3::ONE,
        rotation: glam::Quat::IDENTITY,
        scale_m: glam::Vec3::splat(0.03),
        opacity: 0.5,
        reflectivity: 0.1,
        sigma_m: 0.02,
        position_covariance_m2: echosplat_model::Gaussian::known_alike_m2(0.02),
        probability: 0.9,
        standing: echosplat_model::Standing::Confident,
        why: echosplat_model::Why::default(),
    };
    let way = [DVec3::ZERO, DVec3::X, DVec3::ONE];
    DiveReport {
        title: "a <dive>".into(),
        text: "echosplat replay".into(),
        verdict: "A map of 1 Gaussian; nothing went wrong.".into(),
        handout: Handout::default(),
        view: MapView::new(&[gaussian], Some(&[0.01]), &way),
        picture: section.picture.unwrap(),
        trajectory: Trajectory(
            (0..3)
                .zip(way)
                .map(|(at, place)| (f64::from(at), place))
                .collect(),
        ),
        plots: (0..6).map(plot).collect(),
        tables: vec![Table {
            title: "The run".into(),
            columns: vec!["what".into(), "value".into()],
            rows: vec![vec!["pairs".into(), table::quantity(2.37e9)]],
            note: String::new(),
        }],
        notes: vec!["a note".into()],
        machine: vec![("CPU".into(), "two cores".into())],
    }
}

#[test]
fn a_dive_is_told_in_its_order_and_reaches_nowhere() {
    let html = dive().to_html();
    let at = |text: &str| html.find(text).unwrap_or_else(|| panic!("{text}"));
    let order = [
        "<h1>a &lt;dive&gt;</h1>",
        "class=\"verdict\"",
        "id=\"viewer\"",
        "id=\"flat\"",
        "<h2>Trajectory</h2>",
        "<h2>Over the dive</h2>",
        "<h2>Figures</h2>",
        "<h2>What was run</h2>",
    ];
    assert!(order.map(at).is_sorted());
    for foreign in ["://", "src=", "url(", "@import", "fetch(", "new WebSocket"] {
        assert!(!html.contains(foreign), "{foreign}");
    }
    let pictures = html.matches("href=\"data:image/png;base64,").count();
    assert_eq!(html.matches("href=").count(), pictures);
    assert!(html.len() < 250_000, "{} bytes", html.len());
    assert_closed(&read_by_people(&html));
}

#[test]
fn at_most_four_charts_are_drawn_and_no_figure_has_an_exponent() {
    let html = dive().to_html();
    let (_, charts) = html.split_once("<h2>Over the dive</h2>").unwrap();
    let (charts, _) = charts.split_once("</section>").unwrap();
    assert_eq!(charts.matches("<svg").count(), MOST_CHARTS);
    for html in [html, report().to_html()] {
        let text = read_by_people(&html);
        assert!(!has_exponent(&text), "{text}");
    }
    assert!(has_exponent("2.37e9") && has_exponent("1e-4") && !has_exponent("stroke 1 e"));
}

#[test]
fn every_picture_has_axes_and_every_map_a_scale() {
    let html = dive().to_html();
    let pictures = html
        .split("<svg")
        .skip(1)
        .map(|rest| rest.split("</svg>").next().unwrap());
    for picture in pictures {
        assert!(
            picture.contains("class=\"axis\"") && picture.contains("class=\"tick\""),
            "{picture}"
        );
        let is_map = picture.contains("the map from") || picture.contains("north, m over east, m");
        assert_eq!(picture.contains("class=\"bar\""), is_map, "{picture}");
    }
}

#[test]
fn a_chart_has_at_most_seven_lines_and_no_line_is_lost() {
    let line = |index: usize| (format!("line {index}"), vec![(1.0, 1.0), (2.0, 2.0)]);
    let plot = Plot {
        lines: (0..16).map(line).collect(),
        ..Plot::default()
    };
    let html = plots_html(&[plot.clone(), plot]);
    let charts: Vec<usize> = html
        .split("<svg")
        .skip(1)
        .map(|svg| svg.matches("class=\"line\"").count())
        .collect();
    assert_eq!(charts, [7, 7, 7, 7, 2, 2]);
    assert_eq!(html.matches("<details><summary>2 more").count(), 1);
}
