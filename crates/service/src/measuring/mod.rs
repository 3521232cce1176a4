//! Sizes in a map, each with its sigma, in words and as facts: the same whether `measure`, the live page or a report asks.

mod asked;

use std::fmt::Write as _;

use echosplat_georeference::Georeference;
use echosplat_model::Gaussian;
use echosplat_model::glam::DVec3;
use echosplat_survey::{
    Bin, Cut, Cylinder, Distance, Plane, Sample, SurveyError, Told, distance, fit_cylinder,
    fit_plane, profile, samples_of, section,
};
use serde_json::{Value, json};

pub(crate) use asked::{Asked, STEP_M, What};

/// Metres; how far around a place is looked unless asked otherwise.
const AROUND_M: f64 = 1.0;
/// Metres; how far from the ends of a distance something of the map must be.
const END_M: f64 = 0.5;
/// Metres; to each side of a line.
const BESIDE_M: f64 = 0.25;
/// Metres; a pile is looked for so far up and down from a place, then followed as far as it goes.
const PILE_REACH_M: f64 = 4.0;
/// Metres; a pile that is not seen over more than this is taken to end there.
const PILE_GAP_M: f64 = 1.0;
/// Metres; a pile's own places are no farther from its surface than this, at least and at most.
const PILE_SKIN_M: (f64, f64) = (0.05, 0.15);
/// Rounds of choosing a pile's places by the cylinder found so far.
const PILE_ROUNDS: usize = 3;

/// What was measured.
#[derive(Debug, Clone)]
pub(crate) struct Measured {
    pub(crate) name: &'static str,
    /// For people.
    pub(crate) lines: Vec<String>,
    /// As `--json` prints it.
    pub(crate) facts: Value,
    /// Its places, metres of the world: one, or the ends of a line.
    pub(crate) shape: Vec<DVec3>,
    /// As CSV, its heading first; nothing where one line says all.
    pub(crate) rows: String,
}

/// What the map asserts, as places.
pub(crate) fn asserted(origin_m: DVec3, gaussians: &[Gaussian]) -> Vec<Sample> {
    let mut samples = samples_of(origin_m, gaussians);
    samples.retain(|sample| sample.is_confident);
    samples
}

/// # Errors
/// If what was asked for is not there.
pub(crate) fn measure(
    asked: &Asked,
    samples: &[Sample],
    place: Option<&Georeference>,
) -> Result<Measured, SurveyError> {
    let within = |usual_m: f64| asked.within_m.unwrap_or(usual_m);
    match asked.what {
        What::Distance([from_m, to_m]) => {
            distance(samples, from_m, to_m, within(END_M)).map(|found| of_distance(&found))
        }
        What::Pile(at_m) => {
            pile(samples, at_m, within(AROUND_M)).map(|found| of_pile(&found, place))
        }
        What::Plane(at_m) => {
            let reach_m = within(AROUND_M);
            let near = samples
                .iter()
                .filter(|sample| sample.at_m.distance(at_m) <= reach_m);
            let near: Vec<Sample> = near.copied().collect();
            fit_plane(&near).map(|found| of_plane(&found, place))
        }
        What::Profile(ends_m) => {
            let [from_m, to_m] = ends_m;
            let bins = profile(samples, from_m, to_m, within(BESIDE_M), asked.step_m)?;
            Ok(of_profile(&bins, ends_m))
        }
        What::Section(ends_m) => {
            let [from_m, to_m] = ends_m;
            let cuts = section(samples, from_m, to_m, within(BESIDE_M));
            Ok(of_section(&cuts, ends_m))
        }
    }
}

/// The pile whose places are near a place: those near the upright line through it, then those near the cylinder found, as far
/// up and down as they go.
fn pile(samples: &[Sample], at_m: DVec3, reach_m: f64) -> Result<Cylinder, SurveyError> {
    let is_level = |sample: &Sample| (sample.at_m.z - at_m.z).abs() <= PILE_REACH_M;
    let near = samples
        .iter()
        .filter(|sample| is_level(sample) && (sample.at_m - at_m).truncate().length() <= reach_m);
    let near: Vec<Sample> = near.copied().collect();
    let mut found = fit_cylinder(&near)?;
    for _ in 0..PILE_ROUNDS {
        let skin_m = (3.0 * found.residual_m).clamp(PILE_SKIN_M.0, PILE_SKIN_M.1);
        let on_it = samples
            .iter()
            .filter(|sample| found.off_m(sample.at_m).abs() <= skin_m);
        let on_it: Vec<Sample> = on_it.copied().collect();
        found = fit_cylinder(&without_gaps(on_it, at_m.z))?;
    }
    Ok(found)
}

/// Those that follow each other up and down from the one nearest in height.
fn without_gaps(mut samples: Vec<Sample>, height_m: f64) -> Vec<Sample> {
    samples.sort_by(|a, b| a.at_m.z.total_cmp(&b.at_m.z));
    let z = |sample: &Sample| sample.at_m.z;
    let above = samples.partition_point(|sample| z(sample) < height_m);
    let is_gap = |pair: &[Sample]| z(&pair[1]) - z(&pair[0]) > PILE_GAP_M;
    let begin = samples[..above].windows(2).rposition(is_gap);
    let end = samples[above..].windows(2).position(is_gap);
    let begin = begin.map_or(0, |at| at + 1);
    let end = end.map_or(samples.len(), |at| above + at + 1);
    samples[begin..end].to_vec()
}

/// With two digits of the sigma, and three decimals at most.
fn with_sigma(told: Told, unit: &str) -> String {
    let first = told.sigma.abs().log10().floor();
    let decimals = (1.0 - first).clamp(0.0, 3.0) as usize;
    match told.sigma.is_finite() {
        true => format!(
            "{:.decimals$} ± {:.decimals$} {unit}",
            told.value, told.sigma
        ),
        false => format!("{:.3} {unit}, of unknown sigma", told.value),
    }
}

fn fact(told: Told) -> Value {
    // Infinity is null in JSON: unknown.
    json!({ "value": told.value, "sigma": told.sigma })
}

fn at(place_m: DVec3) -> String {
    let [x, y, z] = place_m.to_array();
    format!("{x:.3},{y:.3},{z:.3}")
}

fn of_distance(found: &Distance) -> Measured {
    let [from_m, to_m] = found.ends_m;
    Measured {
        name: "distance",
        lines: vec![
            format!(
                "from {} to {}, the nearest of the map",
                at(from_m),
                at(to_m)
            ),
            format!("straight {}", with_sigma(found.length_m, "m")),
            format!("along the ground {}", with_sigma(found.horizontal_m, "m")),
            format!("higher by {}", with_sigma(found.height_m, "m")),
        ],
        facts: json!({
            "from_m": from_m.to_array(),
            "to_m": to_m.to_array(),
            "length_m": fact(found.length_m),
            "horizontal_m": fact(found.horizontal_m),
            "height_m": fact(found.height_m),
        }),
        shape: found.ends_m.to_vec(),
        rows: String::new(),
    }
}

/// Degrees clockwise from true north where the map says where that is, else from the world's y axis; and in words.
fn heading(x: f64, y: f64, place: Option<&Georeference>) -> (f64, &'static str) {
    let direction = DVec3::new(x, y, 0.0);
    let (turned, of) = match place {
        Some(place) => (place.enu_from_world() * direction, "true north"),
        None => (direction, "the world's y axis"),
    };
    (turned.x.atan2(turned.y).to_degrees().rem_euclid(360.0), of)
}

fn of_pile(found: &Cylinder, place: Option<&Georeference>) -> Measured {
    let lean = found.lean_from_upright_deg();
    let axis = found.axis();
    let (towards_deg, north) = heading(axis.x, axis.y, place);
    let (bottom_m, top_m) = found.from_to_m;
    let diameter_m = Told {
        value: 2.0 * found.radius_m.value,
        sigma: 2.0 * found.radius_m.sigma,
    };
    let [lean_x, lean_y] = found.lean_deg;
    Measured {
        name: "pile",
        lines: vec![
            format!("a pile whose axis is at {}", at(found.middle_m)),
            format!("diameter {}", with_sigma(diameter_m, "m")),
            format!(
                "lean {}, towards {towards_deg:.0} degrees from {north}; {} along x, {} along y",
                with_sigma(lean, "degrees"),
                with_sigma(lean_x, "degrees"),
                with_sigma(lean_y, "degrees")
            ),
            format!(
                "seen from {bottom_m:.2} to {top_m:.2} m, {:.2} m high, {:.0} degrees around; {} Gaussians {:.3} m off",
                top_m - bottom_m,
                found.seen_deg,
                found.count,
                found.residual_m
            ),
        ],
        facts: json!({
            "middle_m": found.middle_m.to_array(),
            "middle_sigma_m": found.middle_sigma_m.to_array(),
            "diameter_m": fact(diameter_m),
            "radius_m": fact(found.radius_m),
            "lean_deg": fact(lean),
            "lean_x_deg": fact(lean_x),
            "lean_y_deg": fact(lean_y),
            "lean_towards_deg": towards_deg,
            "lean_towards_from": north,
            "bottom_m": bottom_m,
            "top_m": top_m,
            "height_m": top_m - bottom_m,
            "seen_deg": found.seen_deg,
            "gaussians": found.count,
            "residual_m": found.residual_m,
        }),
        shape: vec![found.middle_m],
        rows: String::new(),
    }
}

fn of_plane(found: &Plane, place: Option<&Georeference>) -> Measured {
    let (towards_deg, north) = heading(found.normal.x, found.normal.y, place);
    Measured {
        name: "plane",
        lines: vec![
            format!("a plane whose middle is at {}", at(found.middle_m)),
            format!(
                "tilt {}, down towards {towards_deg:.0} degrees from {north}",
                with_sigma(found.tilt_deg, "degrees")
            ),
            format!("{} Gaussians {:.3} m off", found.count, found.residual_m),
        ],
        facts: json!({
            "middle_m": found.middle_m.to_array(),
            "normal": found.normal.to_array(),
            "tilt_deg": fact(found.tilt_deg),
            "towards_deg": towards_deg,
            "towards_from": north,
            "gaussians": found.count,
            "residual_m": found.residual_m,
        }),
        shape: vec![found.middle_m],
        rows: String::new(),
    }
}

fn of_profile(bins: &[Bin], ends_m: [DVec3; 2]) -> Measured {
    let mut rows = "along_m,height_m,sigma_m,gaussians\n".to_owned();
    for bin in bins {
        let height = bin
            .height_m
            .map(|h| format!("{:.4},{:.4}", h.value, h.sigma));
        let height = height.unwrap_or_else(|| ",".to_owned());
        // Writing to a string cannot fail.
        let _ = writeln!(rows, "{:.4},{height},{}", bin.along_m, bin.count);
    }
    let told = bins.iter().map(|bin| {
        json!({ "along_m": bin.along_m, "height_m": bin.height_m.map(fact), "gaussians": bin.count })
    });
    Measured {
        name: "profile",
        lines: rows.lines().map(str::to_owned).collect(),
        facts: json!({ "profile": told.collect::<Vec<_>>() }),
        shape: ends_m.to_vec(),
        rows,
    }
}

fn of_section(cuts: &[Cut], ends_m: [DVec3; 2]) -> Measured {
    let mut rows = "along_m,beside_m,height_m,sigma_m\n".to_owned();
    for cut in cuts {
        let height = cut.height_m;
        let _ = writeln!(
            rows,
            "{:.4},{:.4},{:.4},{:.4}",
            cut.along_m, cut.beside_m, height.value, height.sigma
        );
    }
    let told = cuts.iter().map(|cut| {
        json!({ "along_m": cut.along_m, "beside_m": cut.beside_m, "height_m": fact(cut.height_m) })
    });
    Measured {
        name: "section",
        lines: rows.lines().map(str::to_owned).collect(),
        facts: json!({ "section": told.collect::<Vec<_>>() }),
        shape: ends_m.to_vec(),
        rows,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::DMat3;

    #[test]
    fn a_pile_is_followed_as_far_as_it_goes_and_not_to_what_stands_above_it() {
        let at = |z: f64| Sample {
            at_m: DVec3::new(0.0, 0.0, z),
            covariance_m2: DMat3::ZERO,
            probability: 1.0,
            is_confident: true,
            is_ground: false,
        };
        let pile = (0..90).map(|i| at(-8.0 + 0.1 * f64::from(i)));
        let above = (0..20).map(|i| at(3.0 + 0.1 * f64::from(i)));
        let below = (0..5).map(|i| at(-12.0 + 0.1 * f64::from(i)));
        let all: Vec<Sample> = above.chain(pile).chain(below).collect();
        for height_m in [-7.9, -2.0, 0.8] {
            let kept = without_gaps(all.clone(), height_m);
            assert_eq!(kept.len(), 90, "{height_m}");
            assert!((kept[0].at_m.z + 8.0).abs() < 1e-9);
        }
        assert_eq!(without_gaps(Vec::new(), 0.0), []);
    }

    #[test]
    fn a_number_has_as_many_decimals_as_its_sigma_says() {
        let said = |value, sigma| with_sigma(Told { value, sigma }, "m");
        assert_eq!(said(1.234_56, 0.012_3), "1.235 ± 0.012 m");
        assert_eq!(said(8.018_2, 0.351), "8.02 ± 0.35 m");
        assert_eq!(said(8.018_2, 35.1), "8 ± 35 m");
        assert_eq!(said(8.018_2, 0.0), "8.018 ± 0.000 m");
        assert_eq!(said(8.018_2, f64::INFINITY), "8.018 m, of unknown sigma");
    }
}
