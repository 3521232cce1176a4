use echosplat_georeference::Place;
use echosplat_model::glam::{Quat, Vec3};
use serde_json::json;

use super::*;

fn gaussian(mean_m: Vec3, standing: Standing) -> Gaussian {
    Gaussian {
        id: 0,
        mean_m,
        rotation: Quat::IDENTITY,
        scale_m: Vec3::splat(0.05),
        opacity: 0.5,
        reflectivity: 0.1,
        sigma_m: 0.05,
        position_covariance_m2: Gaussian::known_alike_m2(0.05),
        probability: 0.9,
        standing,
        why: echosplat_model::Why::default(),
    }
}

fn with<T>(place: Option<&Georeference>, run: &Value, look: impl FnOnce(&Subject) -> T) -> T {
    let gaussians = [
        gaussian(Vec3::new(0.0, 0.0, -3.0), Standing::Confident),
        gaussian(Vec3::new(4.0, 2.0, -5.0), Standing::Confident),
        gaussian(Vec3::new(2.0, 1.0, -4.0), Standing::Ambiguous),
    ];
    let way = Trajectory(
        (0..10)
            .map(|i| (f64::from(i), DVec3::X * f64::from(i)))
            .collect(),
    );
    look(&Subject {
        about: vec![("Client".to_owned(), "Harbour Ltd".to_owned())],
        origin_m: DVec3::ZERO,
        gaussians: &gaussians,
        place,
        way: &way,
        began: None,
        run,
        settings: None,
        measures: &[],
    })
}

fn placed(datum: Datum) -> Georeference {
    let place = Place::new(60.17, 24.94, 1.5).unwrap();
    Georeference::at_origin(place, datum, "a chart")
}

#[test]
fn depth_is_counted_from_the_water_and_heights_from_what_they_are_over() {
    let told = |datum| {
        with(Some(&placed(datum)), &Value::Null, |subject| {
            let handout = of(subject);
            let all: Vec<String> = handout
                .highlights
                .iter()
                .map(|(n, v)| format!("{n}: {v}"))
                .collect();
            all.join("; ")
        })
    };
    let surface = told(Datum::Surface);
    assert!(surface.contains("depth: 1.5 to 3.5 m"), "{surface}");
    let msl = told(Datum::MeanSea);
    assert!(msl.contains("height: −3.5 to −1.5 m"), "{msl}");
}

#[test]
fn a_place_on_earth_is_told_to_a_centimetre_or_said_to_be_unknown() {
    let table = with(Some(&placed(Datum::Surface)), &Value::Null, |subject| {
        of(subject).tables.remove(0)
    });
    assert_eq!(table.rows[0][2..4], ["60.1700000° N", "24.9400000° E"]);
    // As PROJ 9.5.1 has it.
    assert_eq!(table.rows.len(), 4);
    let east: f64 = table.rows[0][4].parse().unwrap();
    assert!((300_000.0..700_000.0).contains(&east), "{east}");
    assert!(
        table.note.contains("EPSG:32635") && table.note.contains("a chart"),
        "{}",
        table.note
    );
    let unknown = with(None, &Value::Null, |subject| of(subject).tables.remove(0));
    assert!(unknown.rows[0][1].contains("not told"));
}

#[test]
fn how_pings_scored_is_told_where_it_is_known() {
    let run = json!({
        "dive_s": 75.0, "pings_received": 100, "pings_mapped": 98,
        "mapper": { "foretold": { "pings": 12, "bins": 999, "gain_nats_per_bin": -0.0123 } },
        "prediction": { "pings": 5, "gain_per_bin": 0.5 },
        "notices": [{ "code": "pose-drift", "since_s": 1.0, "until_s": null, "sentence": "poses drift", "is_loss": false, "count": 1 }],
    });
    let rows = |run: &Value| {
        with(None, run, |subject| {
            of(subject).tables[1].rows.concat().join("; ")
        })
    };
    let told = rows(&run);
    assert!(
        told.contains("−0.0123 nats a bin above noise, 12 pings"),
        "{told}"
    );
    assert!(
        told.contains("+0.5000 nats a bin above a constant, 5 pings"),
        "{told}"
    );
    assert!(told.contains("one thing, on the last page"), "{told}");
    let unknown = rows(&Value::Null);
    assert!(
        !unknown.contains("nats") && !unknown.contains("wrong"),
        "{unknown}"
    );
    let last = with(None, &run, |subject| of(subject).last);
    assert!(
        last.iter()
            .any(|table| table.rows.concat().contains(&"poses drift".to_owned()))
    );
}

#[test]
fn what_there_is_has_its_pages() {
    let titles = with(None, &Value::Null, |subject| {
        let sheets = of(subject).sheets.into_iter();
        sheets.map(|sheet| sheet.title).collect::<Vec<_>>()
    });
    assert_eq!(
        titles,
        ["Plan", "Elevations", "What is ambiguous", "Trajectory"]
    );
}
