//! A dive's track, extent and measured places as `GeoJSON` and KML.

use std::io::{self, Write};

use echosplat_georeference::{Georeference, Place};
use echosplat_model::StampedPose;
use echosplat_model::glam::{DVec2, DVec3};
use serde_json::{Value, json};

use crate::export::{sound, world_m};
use crate::ply::MapFile;

/// Metres; a track's points are no nearer to each other.
const TRACK_STEP_M: f64 = 0.1;

/// Decimals of a degree: 0.1 mm.
const DEGREE_DECIMALS: f64 = 1e9;
/// Decimals of a metre: 0.1 mm.
const METRE_DECIMALS: f64 = 1e4;

/// Something on the Earth.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// One place.
    Point(Place),
    /// From place to place.
    Line(Vec<Place>),
    /// Anticlockwise around, its first place not said again.
    Area(Vec<Place>),
}

/// A shape with its name and what is told of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Feature {
    /// For people.
    pub name: String,
    /// Where it is.
    pub shape: Shape,
    /// Name and value of each fact.
    pub facts: Vec<(&'static str, Value)>,
}

/// The track of the poses, if there are any, and the convex extent of the map.
#[must_use]
pub fn features_of(map: &MapFile, poses: &[StampedPose], place: &Georeference) -> Vec<Feature> {
    let facts = |count: usize, what| {
        vec![
            (what, json!(count)),
            ("height_datum", json!(place.datum.name())),
            ("georeference", json!(place.source)),
        ]
    };
    let mut found = Vec::new();
    let track = thinned(poses);
    if track.len() > 1 {
        found.push(Feature {
            name: "track".to_owned(),
            shape: Shape::Line(track.iter().map(|at| place.place_of(*at)).collect()),
            facts: facts(poses.len(), "poses"),
        });
    }
    let places: Vec<DVec3> = sound(map)
        .map(|gaussian| world_m(map.origin_m, gaussian))
        .collect();
    let corners = hull(&places);
    if corners.len() > 2 {
        found.push(Feature {
            name: "extent".to_owned(),
            shape: Shape::Area(corners.iter().map(|at| place.place_of(*at)).collect()),
            facts: facts(places.len(), "gaussians"),
        });
    }
    found
}

fn thinned(poses: &[StampedPose]) -> Vec<DVec3> {
    let places = poses
        .iter()
        .map(|pose| pose.world_from_vehicle.translation_m);
    let mut kept: Vec<DVec3> = Vec::new();
    for at in places.clone() {
        if kept
            .last()
            .is_none_or(|last| last.distance(at) >= TRACK_STEP_M)
        {
            kept.push(at);
        }
    }
    let mut places = places;
    kept.extend(places.next_back().filter(|last| kept.last() != Some(last)));
    kept
}

/// Corners of the least convex outline seen from above, anticlockwise, at the mean height.
fn hull(places: &[DVec3]) -> Vec<DVec3> {
    let mut flat: Vec<DVec2> = places.iter().map(|place| place.truncate()).collect();
    flat.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    flat.dedup();
    let height_m = places.iter().map(|place| place.z).sum::<f64>() / places.len().max(1) as f64;
    let chain = |points: &mut dyn Iterator<Item = DVec2>| {
        let mut chain: Vec<DVec2> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..]
                && (b - a).perp_dot(point - b) <= 0.0
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut corners = chain(&mut flat.iter().copied());
    corners.extend(chain(&mut flat.iter().rev().copied()));
    corners
        .iter()
        .map(|corner| corner.extend(height_m))
        .collect()
}

/// Writes `GeoJSON` (RFC 7946): longitude, latitude, height in metres over what `height_datum` says. What crosses the
/// antimeridian is cut there.
///
/// # Errors
/// Of the writer.
pub fn write_geojson(features: &[Feature], mut writer: impl Write) -> io::Result<()> {
    let features: Vec<Value> = features.iter().map(geojson_feature).collect();
    let document = json!({ "type": "FeatureCollection", "features": features });
    serde_json::to_writer(&mut writer, &document)?;
    writer.write_all(b"\n")?;
    writer.flush()
}

fn geojson_feature(feature: &Feature) -> Value {
    let mut properties = json!({ "name": feature.name });
    for (name, value) in &feature.facts {
        properties[*name] = value.clone();
    }
    json!({ "type": "Feature", "properties": properties, "geometry": geometry(&feature.shape) })
}

fn geometry(shape: &Shape) -> Value {
    let of = |kind: &str, mut parts: Vec<Value>| match parts.len() {
        1 => json!({ "type": kind, "coordinates": parts.remove(0) }),
        _ => json!({ "type": format!("Multi{kind}"), "coordinates": parts }),
    };
    let line = |points: &Vec<DVec3>| Value::from(points.iter().map(position).collect::<Vec<_>>());
    match shape {
        Shape::Point(place) => of("Point", vec![position(&point(place))]),
        Shape::Line(places) => {
            let pieces = cut_line(&unwrapped(places));
            of("LineString", pieces.iter().map(line).collect())
        }
        Shape::Area(places) => {
            let ring = |points: &Vec<DVec3>| {
                let mut closed = points.clone();
                closed.extend(points.first());
                json!([line(&closed)])
            };
            let pieces = cut_area(&unwrapped(places));
            of("Polygon", pieces.iter().map(ring).collect())
        }
    }
}

fn point(place: &Place) -> DVec3 {
    DVec3::new(place.longitude_deg, place.latitude_deg, place.height_m)
}

fn position(point: &DVec3) -> Value {
    let rounded = |value: f64, decimals: f64| (value * decimals).round() / decimals;
    json!([
        rounded(point.x, DEGREE_DECIMALS),
        rounded(point.y, DEGREE_DECIMALS),
        rounded(point.z, METRE_DECIMALS)
    ])
}

/// Longitude, latitude, height; without a step of 360 degrees, and so perhaps beyond 180.
fn unwrapped(places: &[Place]) -> Vec<DVec3> {
    let first_deg = places.first().map_or(0.0, |place| place.longitude_deg);
    let near = |place: &Place| {
        let mut point = point(place);
        point.x += 360.0 * ((first_deg - point.x) / 360.0).round();
        point
    };
    places.iter().map(near).collect()
}

/// The antimeridian that a dive beyond it crosses, degrees.
fn crossed(points: &[DVec3]) -> Option<f64> {
    [-180.0, 180.0].into_iter().find(|&at_deg| {
        let beyond = |point: &DVec3| point.x > at_deg;
        points.iter().any(beyond) && !points.iter().all(beyond)
    })
}

fn between(a: DVec3, b: DVec3, at_deg: f64) -> DVec3 {
    let mut found = a.lerp(b, (at_deg - a.x) / (b.x - a.x));
    found.x = at_deg;
    found
}

/// Moved by whole turns, so that longitudes are within −180 to 180.
fn wrapped(mut points: Vec<DVec3>) -> Vec<DVec3> {
    let middle_deg = points.iter().map(|point| point.x).sum::<f64>() / points.len().max(1) as f64;
    let turns = (middle_deg / 360.0).round();
    points.iter_mut().for_each(|point| point.x -= 360.0 * turns);
    points
}

fn cut_line(points: &[DVec3]) -> Vec<Vec<DVec3>> {
    let Some(at_deg) = crossed(points) else {
        return vec![wrapped(points.to_vec())];
    };
    let mut pieces: Vec<Vec<DVec3>> = vec![points.first().copied().into_iter().collect()];
    for pair in points.windows(2) {
        let is_across = (pair[0].x > at_deg) != (pair[1].x > at_deg);
        if is_across {
            let edge = between(pair[0], pair[1], at_deg);
            pieces
                .last_mut()
                .into_iter()
                .for_each(|piece| piece.push(edge));
            pieces.push(vec![edge]);
        }
        pieces
            .last_mut()
            .into_iter()
            .for_each(|piece| piece.push(pair[1]));
    }
    pieces.into_iter().map(wrapped).collect()
}

fn cut_area(points: &[DVec3]) -> Vec<Vec<DVec3>> {
    let Some(at_deg) = crossed(points) else {
        return vec![wrapped(points.to_vec())];
    };
    let half = |is_beyond: bool| {
        let is_kept = |point: &DVec3| (point.x > at_deg) == is_beyond;
        let mut kept = Vec::new();
        let next = points.iter().cycle().skip(1);
        for (a, b) in points.iter().zip(next) {
            if is_kept(a) {
                kept.push(*a);
            }
            if is_kept(a) != is_kept(b) {
                kept.push(between(*a, *b, at_deg));
            }
        }
        wrapped(kept)
    };
    vec![half(false), half(true)]
}

/// Writes KML 2.2: longitude, latitude and height, which viewers take as over mean sea level; what it is over stands in
/// each description.
///
/// # Errors
/// Of the writer.
pub fn write_kml(features: &[Feature], mut writer: impl Write) -> io::Result<()> {
    writeln!(writer, r#"<?xml version="1.0" encoding="UTF-8"?>"#)?;
    writeln!(
        writer,
        r#"<kml xmlns="http://www.opengis.net/kml/2.2"><Document>"#
    )?;
    for feature in features {
        let facts = feature
            .facts
            .iter()
            .map(|(name, value)| format!("{name}: {value}"));
        let facts: Vec<String> = facts.collect();
        writeln!(
            writer,
            "<Placemark><name>{}</name><description>{}</description>{}</Placemark>",
            escaped(&feature.name),
            escaped(&facts.join("; ")),
            kml_geometry(&feature.shape)
        )?;
    }
    writeln!(writer, "</Document></kml>")?;
    writer.flush()
}

fn kml_geometry(shape: &Shape) -> String {
    let coordinates = |points: &[DVec3]| {
        let words = points
            .iter()
            .map(|p| format!("{:.9},{:.9},{:.4}", p.x, p.y, p.z));
        let words: Vec<String> = words.collect();
        format!("<coordinates>{}</coordinates>", words.join(" "))
    };
    let mode = "<altitudeMode>absolute</altitudeMode>";
    match shape {
        Shape::Point(place) => format!("<Point>{mode}{}</Point>", coordinates(&[point(place)])),
        Shape::Line(places) => {
            let pieces = cut_line(&unwrapped(places));
            let lines = pieces
                .iter()
                .map(|piece| format!("<LineString>{mode}{}</LineString>", coordinates(piece)));
            format!(
                "<MultiGeometry>{}</MultiGeometry>",
                lines.collect::<String>()
            )
        }
        Shape::Area(places) => {
            let pieces = cut_area(&unwrapped(places));
            let rings = pieces.iter().map(|piece| {
                let mut closed = piece.clone();
                closed.extend(piece.first());
                let ring = coordinates(&closed);
                format!(
                    "<Polygon>{mode}<outerBoundaryIs><LinearRing>{ring}</LinearRing></outerBoundaryIs></Polygon>"
                )
            });
            format!(
                "<MultiGeometry>{}</MultiGeometry>",
                rings.collect::<String>()
            )
        }
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
