//! What a drawing has around its map: grid, numbers, scale bar, north arrow, colours, and numbers of measures.

use std::fmt::Write;

use glam::{DVec2, DVec3};

use super::{
    BELOW_MM, Drawn, FOOT_MM, Frame, LEFT_MM, PAGE_MM, RIGHT_MM, Shown, Side, TOP_MM, raster,
};
use crate::axes::{number, ticks};
use crate::escape;

/// Between two lines of the grid at least, mm.
const LEAST_GRID_MM: f64 = 14.0;
/// Longest scale bar, mm.
const LONGEST_BAR_MM: f64 = 60.0;
/// Length of the north arrow, mm.
const ARROW_MM: f64 = 12.0;
/// Corners of a track that are drawn at most.
const MAX_CORNERS: usize = 3000;
/// Colours of the legend's bar, mm.
const COLORS_MM: f64 = 46.0;
const COLOR_STEPS: usize = 23;

pub(super) fn figure(drawn: &Drawn, frame: &Frame, shown: Shown, z_m: (f64, f64)) -> String {
    let size = frame.size_mm();
    let height = TOP_MM + size.y + BELOW_MM + FOOT_MM;
    let mut svg = format!(
        "<svg viewBox=\"0 0 {PAGE_MM} {height:.2}\" role=\"img\" aria-label=\"{}\" data-scale=\"{}\" \
         data-left-m=\"{}\" data-bottom-m=\"{}\">",
        escape(&looking(drawn, frame.side)),
        frame.scale,
        frame.low.x,
        frame.low.y,
    );
    svg += &drawn
        .raster(frame, shown, z_m)
        .to_svg(LEFT_MM, TOP_MM, size);
    svg += &grid(drawn, frame);
    if shown == Shown::Track {
        svg += &track(drawn, frame);
    }
    svg += &numbers(drawn, frame);
    let foot_mm = TOP_MM + size.y + BELOW_MM;
    svg += &scale_bar(frame, foot_mm);
    if frame.side == Side::Above {
        svg += &north_arrow(drawn, size);
    }
    if shown == Shown::Asserted {
        svg += &colors(drawn, z_m, foot_mm);
    }
    svg += "</svg>";
    format!(
        "<figure>{svg}<figcaption>{}</figcaption></figure>\n",
        escape(&caption(drawn, frame, shown))
    )
}

/// From where, in words.
fn looking(drawn: &Drawn, side: Side) -> String {
    let heading = drawn.bearings.x_heading_deg;
    let towards = |turn_deg: f64, axis: &str| match heading {
        Some(x_deg) => {
            let degrees = (x_deg + turn_deg).rem_euclid(360.0);
            format!("looking {} ({degrees:03.0}°)", compass(degrees))
        }
        None => format!("looking along {axis}"),
    };
    match side {
        Side::Above => "Plan, seen from above".to_owned(),
        Side::AlongY => format!("Elevation, {}", towards(-90.0, "y")),
        Side::AgainstX => format!("Elevation, {}", towards(180.0, "−x")),
    }
}

fn compass(degrees: f64) -> &'static str {
    const NAMES: [&str; 8] = [
        "north",
        "north-east",
        "east",
        "south-east",
        "south",
        "south-west",
        "west",
        "north-west",
    ];
    NAMES[((degrees / 45.0).round() as usize) % NAMES.len()]
}

fn caption(drawn: &Drawn, frame: &Frame, shown: Shown) -> String {
    let what = match shown {
        Shown::Asserted => String::new(),
        Shown::Ambiguous => {
            " Violet may or may not be there; grey is what the map asserts.".to_owned()
        }
        Shown::Track => " The way of the sonar, on the map in grey.".to_owned(),
        Shown::Changes => String::new(),
    };
    let north = match (frame.side, drawn.bearings.x_heading_deg) {
        (Side::Above, None) => " Where north is was not told.",
        _ => "",
    };
    let outside = outside(drawn, frame, shown);
    format!(
        "{}. 1 : {} on A4 at 100 %.{what}{north}{outside}",
        looking(drawn, frame.side),
        number(frame.scale)
    )
}

/// Of what is drawn, so much lies beyond the rectangle.
fn outside(drawn: &Drawn, frame: &Frame, shown: Shown) -> String {
    let wanted = match shown {
        Shown::Ambiguous => echosplat_model::Standing::Ambiguous,
        _ => echosplat_model::Standing::Confident,
    };
    let these = drawn.gaussians.iter().filter(|g| g.is_sound());
    let these = these.filter(|g| g.standing == wanted);
    let is_out = |place: DVec3| !frame.holds(frame.side.flat(place));
    let count = these.filter(|g| is_out(drawn.place(g))).count();
    match count {
        0 => String::new(),
        1 => " One Gaussian lies outside.".to_owned(),
        count => format!(" {count} Gaussians lie outside."),
    }
}

/// What stands along an axis of the drawing.
fn axis_names(drawn: &Drawn, side: Side) -> [String; 2] {
    let bearings = drawn.bearings;
    let level = |axis: &str, turn_deg: f64| {
        let heading = bearings
            .x_heading_deg
            .map(|x| (x + turn_deg).rem_euclid(360.0));
        let is_quarter = |degrees: &f64| (degrees / 90.0 - (degrees / 90.0).round()).abs() < 1e-6;
        match heading.filter(is_quarter) {
            Some(degrees) => format!("{axis}, m ({})", compass(degrees)),
            None => format!("{axis}, m"),
        }
    };
    let up = bearings.name.clone();
    match side {
        Side::Above => [level("x", 0.0), level("y", -90.0)],
        Side::AlongY => [level("x", 0.0), up],
        Side::AgainstX => [level("y", -90.0), up],
    }
}

fn grid(drawn: &Drawn, frame: &Frame) -> String {
    let size = frame.size_mm();
    let (left, top) = (LEFT_MM, TOP_MM);
    let (right, bottom) = (left + size.x, top + size.y);
    let mut svg = String::new();
    // The same step both ways, so that squares are squares.
    let most = (size.max_element() / LEAST_GRID_MM).max(2.0);
    let span_m = (frame.high - frame.low).max_element();
    let step_m = step_of(&ticks(0.0, span_m, most), span_m);
    let lines = |low: f64, high: f64| -> Vec<f64> {
        let (first, last) = ((low / step_m).ceil() as i64, (high / step_m).floor() as i64);
        (first..=last).map(|index| index as f64 * step_m).collect()
    };
    for x_m in lines(frame.low.x, frame.high.x) {
        let x = frame.at_mm(DVec2::new(x_m, frame.low.y)).x;
        let _ = write!(
            svg,
            "<path class=\"grid\" d=\"M{x:.3} {top:.3}V{bottom:.3}\"/><text x=\"{x:.2}\" y=\"{:.2}\" \
             text-anchor=\"middle\">{}</text>",
            bottom + 3.6,
            number(x_m)
        );
    }
    // Heights have their own zero: lines stand at whole steps of what is told.
    let bearings = drawn.bearings;
    let tells = frame.side != Side::Above;
    let told = |up_m: f64| if tells { bearings.told(up_m) } else { up_m };
    let (a, b) = (told(frame.low.y), told(frame.high.y));
    for value in lines(a.min(b), a.max(b)) {
        let up_m = match (tells, bearings.is_depth) {
            (true, true) => -value - bearings.height_offset_m,
            (true, false) => value - bearings.height_offset_m,
            (false, _) => value,
        };
        let y = frame.at_mm(DVec2::new(frame.low.x, up_m)).y;
        let _ = write!(
            svg,
            "<path class=\"grid\" d=\"M{left:.3} {y:.3}H{right:.3}\"/><text x=\"{:.2}\" y=\"{:.2}\" \
             text-anchor=\"end\">{}</text>",
            left - 1.2,
            y + 1.0,
            number(value)
        );
    }
    let [along, up] = axis_names(drawn, frame.side);
    let _ = write!(
        svg,
        "<path class=\"frame\" d=\"M{left:.3} {top:.3}H{right:.3}V{bottom:.3}H{left:.3}Z\"/>\
         <text class=\"axis\" x=\"{right:.2}\" y=\"{:.2}\" text-anchor=\"end\">{}</text>\
         <text class=\"axis\" x=\"0\" y=\"3.2\">{}</text>",
        bottom + 7.6,
        escape(&along),
        escape(&up),
    );
    svg
}

fn step_of(ticks: &[f64], span: f64) -> f64 {
    match ticks {
        [first, second, ..] => second - first,
        _ => span.max(1e-6),
    }
}

fn track(drawn: &Drawn, frame: &Frame) -> String {
    let side = frame.side;
    let places: Vec<DVec3> = drawn
        .track_m
        .iter()
        .copied()
        .filter(|p| p.is_finite())
        .collect();
    let every = places.len().div_ceil(MAX_CORNERS).max(1);
    let mut path = String::new();
    let last = places.len().saturating_sub(1);
    for (index, place) in places.iter().enumerate() {
        if index % every > 0 && index != last {
            continue;
        }
        let at = frame.at_mm(side.flat(*place));
        let _ = write!(
            path,
            "{}{:.2} {:.2}",
            if index == 0 { 'M' } else { 'L' },
            at.x,
            at.y
        );
    }
    let mut svg = format!("<path class=\"track\" d=\"{path}\"/>");
    for (place, name) in [(places.first(), "begin"), (places.last(), "end")] {
        let Some(place) = place else { continue };
        let at = frame.at_mm(side.flat(*place));
        let below = if name == "end" { 4.4 } else { -1.8 };
        let _ = write!(
            svg,
            "<circle class=\"mark\" cx=\"{:.2}\" cy=\"{:.2}\" r=\"1.1\"/><text class=\"axis halo\" x=\"{:.2}\" y=\"{:.2}\">{name}</text>",
            at.x,
            at.y,
            at.x + 1.6,
            at.y + below,
        );
    }
    svg
}

fn numbers(drawn: &Drawn, frame: &Frame) -> String {
    let mut svg = String::new();
    for numbered in drawn.numbered {
        let at = |place: &DVec3| frame.at_mm(frame.side.flat(*place));
        let ends: Vec<DVec2> = numbered.places_m.iter().map(at).collect();
        if let [from, to] = ends[..] {
            let _ = write!(
                svg,
                "<path class=\"measured\" d=\"M{:.2} {:.2}L{:.2} {:.2}\"/>",
                from.x, from.y, to.x, to.y
            );
        }
        let count = ends.len().max(1) as f64;
        let middle = ends.iter().sum::<DVec2>() / count;
        let _ = write!(
            svg,
            "<circle class=\"number\" cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"2.3\"/><text class=\"axis\" x=\"{x:.2}\" y=\"{:.2}\" \
             text-anchor=\"middle\">{}</text>",
            middle.y + 1.05,
            numbered.number,
            x = middle.x,
            y = middle.y,
        );
    }
    svg
}

/// Four fields, alternately black and white.
fn scale_bar(frame: &Frame, top_mm: f64) -> String {
    let length_m = bar_m(LONGEST_BAR_MM / frame.mm_per_m());
    let length_mm = length_m * frame.mm_per_m();
    let (x, y) = (LEFT_MM, top_mm + 6.6);
    let quarter = 0.25 * length_mm;
    let mut svg = format!(
        "<g class=\"scalebar\" data-m=\"{length_m}\"><rect class=\"bar\" x=\"{x:.3}\" y=\"{y:.3}\" \
         width=\"{length_mm:.3}\" height=\"1.5\"/>"
    );
    for field in [0.0, 2.0] {
        let _ = write!(
            svg,
            "<rect class=\"black\" x=\"{:.3}\" y=\"{y:.3}\" width=\"{quarter:.3}\" height=\"1.5\"/>",
            x + field * quarter
        );
    }
    for (share, unit) in [(0.0, ""), (0.5, ""), (1.0, " m")] {
        let anchor = if share > 0.9 { "start" } else { "middle" };
        let shift = if share > 0.9 { -1.2 } else { 0.0 };
        let _ = write!(
            svg,
            "<text x=\"{:.2}\" y=\"{:.2}\" text-anchor=\"{anchor}\">{}{unit}</text>",
            x + share * length_mm + shift,
            y - 1.2,
            number(share * length_m)
        );
    }
    svg + "</g>"
}

/// 1, 2 or 5 times a power of ten, at most this.
fn bar_m(most_m: f64) -> f64 {
    let decade = 10_f64.powf(most_m.log10().floor());
    let digit = [5.0, 2.0, 1.0]
        .into_iter()
        .find(|d| d * decade <= most_m * (1.0 + 1e-9));
    digit.unwrap_or(1.0) * decade
}

/// In the drawing's upper right corner, where the heading of its axes is known.
fn north_arrow(drawn: &Drawn, size: DVec2) -> String {
    let Some(x_heading_deg) = drawn.bearings.x_heading_deg else {
        return String::new();
    };
    let turn = x_heading_deg.to_radians();
    // North in the drawing, whose y goes down: a turn to the left of x by its heading.
    let north = DVec2::new(turn.cos(), -turn.sin());
    let beside = DVec2::new(-north.y, north.x);
    let middle = DVec2::new(
        LEFT_MM + size.x - RIGHT_MM - 0.75 * ARROW_MM,
        TOP_MM + 0.85 * ARROW_MM,
    );
    let (tip, foot) = (
        middle + 0.5 * ARROW_MM * north,
        middle - 0.5 * ARROW_MM * north,
    );
    let notch = foot + 0.25 * ARROW_MM * north;
    let (left, right) = (foot - 2.2 * beside, foot + 2.2 * beside);
    let letter = tip + 2.4 * north;
    format!(
        "<g class=\"north\" data-heading=\"{x_heading_deg}\"><circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"9\"/>\
         <path class=\"black\" d=\"M{:.2} {:.2}L{:.2} {:.2}L{:.2} {:.2}Z\"/><path class=\"bar\" d=\"M{:.2} {:.2}L{:.2} \
         {:.2}L{:.2} {:.2}Z\"/><text class=\"axis\" x=\"{:.2}\" y=\"{:.2}\" text-anchor=\"middle\">N</text></g>",
        middle.x,
        middle.y,
        tip.x,
        tip.y,
        left.x,
        left.y,
        notch.x,
        notch.y,
        tip.x,
        tip.y,
        right.x,
        right.y,
        notch.x,
        notch.y,
        letter.x,
        letter.y + 1.1
    )
}

/// The colours of heights, on the right of the scale bar.
fn colors(drawn: &Drawn, (low_m, high_m): (f64, f64), top_mm: f64) -> String {
    let (x, y) = (PAGE_MM - RIGHT_MM - COLORS_MM, top_mm + 6.6);
    let width = COLORS_MM / COLOR_STEPS as f64;
    let mut svg = String::new();
    for step in 0..COLOR_STEPS {
        let [r, g, b] =
            raster::ramp((step as f64 + 0.5) / COLOR_STEPS as f64).map(|c| c.round() as u8);
        let _ = write!(
            svg,
            "<rect fill=\"#{r:02x}{g:02x}{b:02x}\" x=\"{:.2}\" y=\"{y:.2}\" width=\"{:.2}\" height=\"2.2\"/>",
            x + step as f64 * width,
            width + 0.05
        );
    }
    for (share, anchor) in [(0.0, "start"), (1.0, "end")] {
        let z_m = low_m + share * (high_m - low_m);
        let _ = write!(
            svg,
            "<text x=\"{:.2}\" y=\"{:.2}\" text-anchor=\"{anchor}\">{}</text>",
            x + share * COLORS_MM,
            y + 5.4,
            format!("{:.1}", drawn.bearings.told(z_m)).replace('-', "−")
        );
    }
    let _ = write!(
        svg,
        "<text class=\"axis\" x=\"{:.2}\" y=\"{:.2}\" text-anchor=\"end\">{}</text>",
        PAGE_MM - RIGHT_MM,
        y - 1.2,
        escape(&drawn.bearings.name)
    );
    svg
}
