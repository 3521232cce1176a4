use echosplat_model::glam::{Quat, Vec3};

use super::*;

fn gaussian(mean_m: Vec3, standing: Standing) -> Gaussian {
    Gaussian {
        id: 1,
        mean_m,
        rotation: Quat::IDENTITY,
        scale_m: Vec3::splat(0.02),
        opacity: 0.5,
        reflectivity: 0.1,
        sigma_m: 0.02,
        position_covariance_m2: Gaussian::known_alike_m2(0.02),
        probability: 0.9,
        standing,
        why: echosplat_model::Why::default(),
    }
}

/// A box of 6 by 3 by 2 m, its corners alone.
fn corners() -> Vec<Gaussian> {
    let places = (0..8).map(|i| {
        let pick = |bit: i32, size: f32| if i >> bit & 1 == 1 { size } else { 0.0 };
        Vec3::new(pick(0, 6.0), pick(1, 3.0), pick(2, 2.0))
    });
    places
        .map(|place| gaussian(place, Standing::Confident))
        .collect()
}

fn drawn<'a>(gaussians: &'a [Gaussian], bearings: &'a Bearings) -> Drawn<'a> {
    Drawn {
        origin_m: DVec3::new(10.0, 20.0, -5.0),
        gaussians,
        changes: &[],
        track_m: &[],
        numbered: &[],
        bearings,
    }
}

/// The number behind `name="`, in the first element that holds `element`.
fn value(svg: &str, element: &str, name: &str) -> f64 {
    let from = svg
        .find(element)
        .unwrap_or_else(|| panic!("{element}: {svg:.600}"));
    let after = &svg[from..];
    let at = after.find(&format!("{name}=\"")).expect("it is there") + name.len() + 2;
    let text = &after[at..];
    text[..text.find('"').unwrap()].parse().unwrap()
}

#[test]
fn a_scale_bar_is_as_long_as_it_says_at_the_scale_that_is_told() {
    let gaussians = corners();
    let bearings = Bearings::default();
    for side in [Side::Above, Side::AlongY, Side::AgainstX] {
        let svg = drawn(&gaussians, &bearings)
            .figure(side, Shown::Asserted, 200.0)
            .unwrap();
        let scale = value(&svg, "<svg", "data-scale");
        let length_m = value(&svg, "class=\"scalebar\"", "data-m");
        let bar_mm = value(&svg, "class=\"bar\"", "width");
        assert!(
            (bar_mm * scale / 1000.0 - length_m).abs() < 1e-3 * length_m,
            "{scale}"
        );
        assert!(svg.contains(&format!("1 : {scale}")), "{svg:.300}");
    }
}

#[test]
fn what_is_drawn_is_where_and_as_large_as_it_is() {
    let gaussians = corners();
    let bearings = Bearings::default();
    let drawn = drawn(&gaussians, &bearings);
    for (side, low, high) in [
        (Side::Above, DVec2::new(10.0, 20.0), DVec2::new(16.0, 23.0)),
        (Side::AlongY, DVec2::new(10.0, -5.0), DVec2::new(16.0, -3.0)),
        (
            Side::AgainstX,
            DVec2::new(20.0, -5.0),
            DVec2::new(23.0, -3.0),
        ),
    ] {
        let (low_m, high_m) = drawn.bounds(Shown::Asserted).unwrap();
        let (low_m, high_m) = (low_m - 0.3, high_m + 0.3);
        let frame = framed(side, low_m, high_m, drawn.scale(low_m, high_m, side, 200.0));
        let raster = drawn.raster(&frame, Shown::Asserted, (-5.0, -3.0));
        let (found_low, found_high) = raster.lit_box();
        // To 1.6 sigmas of 2 cm, and a pixel.
        let reach = 1.6 * 0.02 + 2.0 * frame.scale / 6000.0;
        assert!(
            (found_low - low).abs().max_element() < reach,
            "{side:?} {found_low}"
        );
        assert!(
            (found_high - high).abs().max_element() < reach,
            "{side:?} {found_high}"
        );
        assert!(raster.lit() > 0.0 && raster.lit() < 0.05);
        let size = frame.size_mm();
        assert!(size.x <= PAGE_MM && size.y < 200.0, "{size}");
    }
}

#[test]
fn north_stands_where_the_heading_of_x_puts_it() {
    let gaussians = corners();
    let with = |x_heading_deg| Bearings {
        x_heading_deg,
        ..Bearings::default()
    };
    let plan = |bearings: &Bearings| {
        drawn(&gaussians, bearings)
            .figure(Side::Above, Shown::Asserted, 200.0)
            .unwrap()
    };
    let unknown = plan(&with(None));
    assert!(
        !unknown.contains("class=\"north\"") && unknown.contains("Where north is was not told")
    );
    // x is east: north is up. x is north: north is to the right. x is south: to the left.
    for (x_heading_deg, toward) in [(90.0, DVec2::NEG_Y), (0.0, DVec2::X), (180.0, DVec2::NEG_X)] {
        let svg = plan(&with(Some(x_heading_deg)));
        let arrow = &svg[svg.find("class=\"north\"").unwrap()..];
        let middle = DVec2::new(value(arrow, "<circle", "cx"), value(arrow, "<circle", "cy"));
        let letter = DVec2::new(
            value(arrow, "<text", " x"),
            value(arrow, "<text", " y") - 1.1,
        );
        let found = (letter - middle).normalize();
        assert!(found.dot(toward) > 0.999, "{x_heading_deg} {found}");
    }
    let side = |heading| {
        drawn(&gaussians, &with(Some(heading)))
            .figure(Side::AlongY, Shown::Asserted, 90.0)
            .unwrap()
    };
    assert!(side(90.0).contains("looking north (000°)") && side(90.0).contains("x, m (east)"));
    assert!(side(130.0).contains("looking north-east (040°)") && !side(130.0).contains("x, m ("));
}

#[test]
fn depth_is_told_downward_and_from_what_it_is_counted_from() {
    let gaussians = corners();
    let bearings = Bearings {
        height_offset_m: -2.0,
        is_depth: true,
        name: "depth, m".to_owned(),
        ..Bearings::default()
    };
    let svg = drawn(&gaussians, &bearings)
        .figure(Side::AlongY, Shown::Asserted, 90.0)
        .unwrap();
    // The box is from -5 to -3 m of the world, so from 7 to 5 m below what heights are counted from.
    let y_of = |said: &str| {
        let at = svg
            .find(&format!(">{said}</text>"))
            .unwrap_or_else(|| panic!("{said}: {svg:.3000}"));
        value(&svg[svg[..at].rfind("<text").unwrap()..], "<text", " y")
    };
    assert!(y_of("5") < y_of("7"), "deep is below");
    assert!(svg.contains("depth, m"));
}

#[test]
fn what_is_ambiguous_has_a_page_of_its_own_and_nothing_has_none() {
    let bearings = Bearings::default();
    let mut gaussians = corners();
    let titles = |gaussians: &[Gaussian]| {
        let sheets = drawn(gaussians, &bearings).sheets();
        sheets
            .into_iter()
            .map(|sheet| sheet.title)
            .collect::<Vec<_>>()
    };
    assert_eq!(titles(&gaussians), ["Plan", "Elevations"]);
    gaussians.push(gaussian(Vec3::ONE, Standing::Ambiguous));
    assert_eq!(titles(&gaussians).last().unwrap(), "What is ambiguous");
    assert!(titles(&[]).is_empty());
    let wrong = gaussian(Vec3::splat(f32::NAN), Standing::Confident);
    assert!(titles(&[wrong]).is_empty());
}

#[test]
fn scales_are_those_of_drawings() {
    let scales = [0.3, 1.0, 1.1, 21.0, 26.0, 51.0, 990.0].map(round_scale);
    let told = scales.map(|scale| scale.to_string());
    assert_eq!(told, ["1", "1", "1.25", "25", "40", "75", "1000"]);
}
