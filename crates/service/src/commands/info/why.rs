//! `echosplat info MAP.ply --why X,Y,Z`: why the map says there what it says.

use std::path::Path;

use echosplat_model::glam::DVec3;
use echosplat_model::{Gaussian, Standing, Why};
use echosplat_recording::ply::{self, MapFile};
use serde_json::{Value, json};

use super::refused;
use crate::exit::Usage;
use crate::kind::Kind;

/// Gaussians this near are told of.
const WITHIN_M: f64 = 0.30;
/// Of these the nearest; where none is as near, the one nearest to there.
const MOST: usize = 8;
/// How the file of what is ambiguous ends, which stands beside its map.
const AMBIGUOUS: &str = ".ambiguous.ply";
const UNSAID: &str = "no Gaussian of the map has a reason: it was written by an earlier EchoSplat or saved by another \
                      program; map the recording once more, with `echosplat replay`";
const NOTHING: &str = "nothing is published nearer: no echo was likely enough to come from there, or in the last \
                       work-out other places explained all of them, or it is below the ground. None of these is in \
                       the files";

/// What a map says of a place.
#[derive(Debug)]
pub(super) struct Answer {
    at_m: DVec3,
    /// How many Gaussians are within [`WITHIN_M`].
    near_count: usize,
    /// The nearest first, each with how far it is, metres.
    nearest: Vec<(f64, DVec3, Gaussian)>,
    says_why: bool,
}

/// # Errors
/// If the file is no map.
pub(super) fn ask(file: &Path, at_m: DVec3) -> anyhow::Result<Answer> {
    let kind = Kind::of(file)?;
    if kind != Kind::Map {
        let (file, kind) = (file.display(), kind.name());
        return Err(Usage::error(format!(
            "--why asks a map: {file} is a {kind}; give the map.ply that `echosplat replay` makes of it"
        )));
    }
    let mut map = ply::read_map(file).map_err(|error| refused(file, &error))?;
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    if name.ends_with(AMBIGUOUS) {
        let all = map.gaussians.iter_mut();
        all.for_each(|gaussian| gaussian.standing = Standing::Ambiguous);
    }
    Ok(Answer::of(&map, at_m))
}

impl Answer {
    fn of(map: &MapFile, at_m: DVec3) -> Self {
        let placed = |gaussian: &Gaussian| {
            let place_m = map.origin_m + gaussian.mean_m.as_dvec3();
            (place_m.distance(at_m), place_m, *gaussian)
        };
        let mut nearest: Vec<_> = map.gaussians.iter().map(placed).collect();
        nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
        let near_count = nearest.partition_point(|(away_m, ..)| *away_m <= WITHIN_M);
        nearest.truncate(near_count.clamp(1, MOST));
        let is_said = |gaussian: &Gaussian| gaussian.why != Why::default();
        Self {
            at_m,
            near_count,
            nearest,
            says_why: map.gaussians.iter().any(is_said),
        }
    }

    /// A sentence on what is missing, if something is.
    fn lack(&self) -> Option<&'static str> {
        match (self.near_count, self.says_why) {
            (_, false) if !self.nearest.is_empty() => Some(UNSAID),
            (0, _) => Some(NOTHING),
            _ => None,
        }
    }

    pub(super) fn in_json(&self) -> Value {
        let told = self.nearest.iter().map(|(away_m, place_m, gaussian)| {
            let Why {
                reason,
                clear,
                measured,
            } = gaussian.why;
            json!({
                "away_m": away_m,
                "place_m": place_m.to_array(),
                "standing": gaussian.standing,
                "probability": gaussian.probability,
                "sigma_m": finite(gaussian.sigma_m),
                "reason": reason.name(),
                "clear_observations": clear,
                "measured": measured,
                "unit": reason.unit(),
                "words": gaussian.why.to_string(),
            })
        });
        json!({
            "at_m": self.at_m.to_array(),
            "within_m": WITHIN_M,
            "count": self.near_count,
            "lack": self.lack(),
            "gaussians": told.collect::<Vec<_>>(),
        })
    }

    /// A line for the place and one for each Gaussian.
    pub(super) fn lines(&self) -> String {
        let [x, y, z] = self.at_m.to_array();
        let shown = self.nearest.len();
        let first = match self.near_count {
            0 if shown == 0 => "the map holds no Gaussian".to_owned(),
            0 => format!("no Gaussian within {WITHIN_M:.2} m of {x} {y} {z}; the nearest:"),
            count => format!(
                "the {shown} nearest of {count} Gaussians within {WITHIN_M:.2} m of {x} {y} {z}:"
            ),
        };
        let lines = self.nearest.iter().map(|(away_m, place_m, gaussian)| {
            let [x, y, z] = place_m.to_array();
            let standing = match gaussian.standing {
                Standing::Confident => "confident",
                Standing::Ambiguous => "ambiguous",
            };
            let sigma = match finite(gaussian.sigma_m) {
                Some(sigma_m) => format!("{sigma_m:.3} m"),
                None => "unknown".to_owned(),
            };
            format!(
                "  {away_m:.2} m away, at {x:.2} {y:.2} {z:.2}: {standing}, probability {:.2}, sigma {sigma}: {}",
                gaussian.probability, gaussian.why
            )
        });
        let lack = self.lack().map(|lack| format!("  ({lack})"));
        let all = std::iter::once(first).chain(lines).chain(lack);
        all.collect::<Vec<_>>().join("\n")
    }
}

fn finite(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}

#[cfg(test)]
mod tests {
    use echosplat_model::Reason;
    use echosplat_model::glam::{Quat, Vec3};

    use super::*;

    fn map(whys: &[Why]) -> MapFile {
        let gaussian = |(id, &why): (usize, &Why)| Gaussian {
            id: id as u32,
            mean_m: Vec3::X * 0.02 * id as f32,
            rotation: Quat::IDENTITY,
            scale_m: Vec3::splat(0.02),
            opacity: 0.5,
            reflectivity: 0.5,
            sigma_m: f32::INFINITY,
            position_covariance_m2: Gaussian::known_alike_m2(f32::INFINITY),
            probability: 0.25,
            standing: Standing::Ambiguous,
            why,
        };
        MapFile {
            origin_m: DVec3::new(100.0, 0.0, 0.0),
            gaussians: whys.iter().enumerate().map(gaussian).collect(),
            ..MapFile::default()
        }
    }

    #[test]
    fn the_nearest_say_why_with_their_figures() {
        let whys: Vec<Why> = (0..40)
            .map(|clear| Why::of(Reason::FewClear, clear as f32, 3.0))
            .collect();
        let answer = Answer::of(&map(&whys), DVec3::new(100.001, 0.0, 0.0));
        assert_eq!((answer.near_count, answer.nearest.len()), (16, MOST));
        let told = answer.in_json();
        assert_eq!(told["gaussians"][1]["reason"], "few_clear");
        assert_eq!(told["gaussians"][1]["clear_observations"], 1);
        assert_eq!(told["gaussians"][1]["unit"], "nats");
        assert!(told["gaussians"][1]["sigma_m"].is_null() && told["lack"].is_null());
        let lines = answer.lines();
        assert!(
            lines.starts_with("the 8 nearest of 16 Gaussians within 0.30 m of 100.001 0 0:"),
            "{lines}"
        );
        assert!(
            lines.contains(
                "ambiguous, probability 0.25, sigma unknown: only 0 observations are clear"
            ),
            "{lines}"
        );
        assert!(lines.contains("only 3 nats more likely"), "{lines}");
    }

    #[test]
    fn a_place_without_gaussians_tells_of_the_nearest_and_a_map_without_reasons_says_so() {
        let with = map(&[Why::of(Reason::Ground, 0.0, 0.0)]);
        let answer = Answer::of(&with, DVec3::ZERO);
        assert_eq!(answer.in_json()["count"], 0);
        let lines = answer.lines();
        assert!(
            lines.contains("no Gaussian within 0.30 m") && lines.contains("ground"),
            "{lines}"
        );
        assert!(lines.contains(NOTHING), "{lines}");
        let lines = Answer::of(&map(&[Why::default()]), DVec3::X * 100.0).lines();
        assert!(
            lines.contains("does not say why") && lines.contains(UNSAID),
            "{lines}"
        );
        let lines = Answer::of(&map(&[]), DVec3::ZERO).lines();
        assert!(
            lines.starts_with("the map holds no Gaussian") && lines.contains(NOTHING),
            "{lines}"
        );
    }
}
