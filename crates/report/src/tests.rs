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
