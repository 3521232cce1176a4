//! The map as a picture to be turned: its Gaussians, packed into the document, and the script of the live
//! page that draws them.

use std::f64::consts::LN_10;
use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use echosplat_model::{Gaussian, Standing};
use glam::DVec3;
use serde_json::{Value, json};

/// Most Gaussians in a document: 24 bytes each as base64, 1.4 MB at most.
pub const MAX_GAUSSIANS: usize = 60_000;
/// Most places of a track, 8 bytes each.
const MAX_PLACES: usize = 2_000;
/// As `viewer.js` reads them.
const GAUSSIAN_BYTES: usize = 18;
const PLACE_BYTES: usize = 6;
/// Logarithms of the least and the most of what is written as one byte: scales of 1 mm to 10 m, sigmas of
/// 0.1 mm to 10 m, reflectivities of −120 to 0 dB.
const SCALE_LN: [f64; 2] = [-3.0 * LN_10, LN_10];
const SIGMA_LN: [f64; 2] = [-4.0 * LN_10, LN_10];
const REFLECTIVITY_LN: [f64; 2] = [-12.0 * LN_10, 0.0];
/// Of a distance from the truth; 255 is 0.51 m or more.
const ERROR_STEP_M: f64 = 0.002;
/// Those left are drawn larger by this power of how few they are, as the live page does.
const LARGER_POWER: f64 = 0.35;

/// What is packed.
#[derive(Debug, Clone)]
pub struct MapView {
    head: Value,
    bytes: Vec<u8>,
    stride: usize,
    total: usize,
}

/// Places as whole steps in a box.
struct Steps {
    low: DVec3,
    step: DVec3,
}

impl Steps {
    fn over(places: impl Iterator<Item = DVec3>) -> Self {
        let ends = places.map(|place| (place, place));
        let (low, high) = ends
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
            .unwrap_or_default();
        let step = (high - low) / f64::from(u16::MAX);
        Self { low, step }
    }

    fn write(&self, place: DVec3, to: &mut Vec<u8>) {
        let steps = (place - self.low) / self.step.max(DVec3::splat(1e-12));
        for value in steps.to_array() {
            to.extend((value.round() as u16).to_le_bytes());
        }
    }

    fn to_json(&self) -> Value {
        json!({"low": self.low.to_array(), "step": self.step.to_array()})
    }
}

impl MapView {
    /// Of Gaussians, and the way of the sonar in the frame of their means. `errors_m` is how far each is
    /// from the truth, metres, in the order of the Gaussians; `None` where no truth is known. Above
    /// [`MAX_GAUSSIANS`] one in two, three and so on is kept. What is not finite is left out.
    #[must_use]
    pub fn new(gaussians: &[Gaussian], errors_m: Option<&[f64]>, track: &[DVec3]) -> Self {
        Self::packed(gaussians, errors_m, None, track)
    }

    /// Of two maps laid on each other: what became of each Gaussian is its number in [`CHANGES`](crate::CHANGES).
    #[must_use]
    pub fn of_changes(gaussians: &[Gaussian], changes: &[u8]) -> Self {
        Self::packed(gaussians, None, Some(changes), &[])
    }

    fn packed(
        gaussians: &[Gaussian],
        errors_m: Option<&[f64]>,
        changes: Option<&[u8]>,
        track: &[DVec3],
    ) -> Self {
        let errors = |index: usize| errors_m.and_then(|errors| errors.get(index).copied());
        let sound = gaussians.iter().enumerate().filter(|(_, g)| g.is_sound());
        let change = |index: usize| changes.and_then(|all| all.get(index).copied());
        let of = |(index, g)| (g, errors(index), change(index).unwrap_or(0));
        let sound: Vec<_> = sound.map(of).collect();
        let stride = sound.len().div_ceil(MAX_GAUSSIANS).max(1);
        let kept = || sound.iter().step_by(stride);
        let steps = Steps::over(kept().map(|(g, ..)| g.mean_m.as_dvec3()));
        let count = kept().count();
        let mut bytes = Vec::with_capacity(count * GAUSSIAN_BYTES + MAX_PLACES * PLACE_BYTES);
        for (gaussian, error_m, change) in kept() {
            write_gaussian(gaussian, *error_m, *change, &steps, &mut bytes);
        }
        let track: Vec<DVec3> = track.iter().copied().filter(|p| p.is_finite()).collect();
        let every = track.len().div_ceil(MAX_PLACES).max(1);
        let places = || track.iter().copied().step_by(every);
        let way = Steps::over(places());
        places().for_each(|place| way.write(place, &mut bytes));
        let mut track = way.to_json();
        track["count"] = places().count().into();
        let head = json!({
            "count": count,
            "box": steps.to_json(),
            "scale": SCALE_LN,
            "sigma": SIGMA_LN,
            "reflectivity": REFLECTIVITY_LN,
            "has_error": errors_m.is_some(),
            "has_change": changes.is_some(),
            "error_step": ERROR_STEP_M,
            "larger": (stride as f64).powf(LARGER_POWER),
            "track": track,
        });
        Self {
            head,
            bytes,
            stride,
            total: sound.len(),
        }
    }

    pub(super) fn to_html(&self) -> String {
        let mut html = include_str!("viewer.html").to_owned();
        if self.stride > 1 {
            let _ = writeln!(
                html,
                "<p class=\"note\">One in {} of {} Gaussians is in this picture, drawn larger, so that the \
                 file stays below 2 MB; figures count all.</p>",
                self.stride, self.total
            );
        }
        // Of numbers and names of our own: nothing in it can end the element.
        let _ = writeln!(
            html,
            "<script type=\"application/json\" id=\"map-head\">{}</script>\n\
             <script type=\"text/plain\" id=\"map-data\">{}</script>",
            self.head,
            STANDARD.encode(&self.bytes)
        );
        html
    }
}

/// 0 to 255 over the logarithms of `ends`; what is not finite is the most.
fn logarithmic(value: f64, [low, high]: [f64; 2]) -> u8 {
    let share = (value.max(f64::MIN_POSITIVE).ln() - low) / (high - low);
    (255.0 * share.clamp(0.0, 1.0)).round() as u8
}

fn write_gaussian(
    gaussian: &Gaussian,
    error_m: Option<f64>,
    change: u8,
    steps: &Steps,
    to: &mut Vec<u8>,
) {
    steps.write(gaussian.mean_m.as_dvec3(), to);
    let scales = gaussian.scale_m.as_dvec3().to_array();
    to.extend(scales.map(|scale_m| logarithmic(scale_m, SCALE_LN)));
    let [x, y, z, w] = gaussian.rotation.normalize().to_array();
    to.extend([w, x, y, z].map(|part| ((127.0 * part).round() as i8).cast_unsigned()));
    to.push((255.0 * gaussian.opacity.clamp(0.0, 1.0)).round() as u8);
    to.push(logarithmic(gaussian.reflectivity.into(), REFLECTIVITY_LN));
    to.push(logarithmic(gaussian.sigma_m.into(), SIGMA_LN));
    let error = error_m.map_or(255.0, |error_m| (error_m / ERROR_STEP_M).round());
    to.push(error.clamp(0.0, 255.0) as u8);
    to.push(u8::from(gaussian.standing == Standing::Confident) | (change << 1));
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};

    fn gaussian(place: Vec3) -> Gaussian {
        Gaussian {
            id: 1,
            mean_m: place,
            rotation: Quat::from_rotation_z(0.5),
            scale_m: Vec3::new(0.05, 0.02, 0.01),
            opacity: 0.5,
            reflectivity: 0.1,
            sigma_m: f32::INFINITY,
            position_covariance_m2: Gaussian::known_alike_m2(f32::INFINITY),
            probability: 0.9,
            standing: Standing::Confident,
            why: echosplat_model::Why::default(),
        }
    }

    #[test]
    fn places_come_back_within_half_a_step() {
        let places = [Vec3::new(-30.0, 2.0, -5.0), Vec3::new(20.0, 2.0, -4.2)];
        let view = MapView::new(&places.map(gaussian), Some(&[0.03, 9.0]), &[DVec3::ONE]);
        assert_eq!(view.bytes.len(), 2 * GAUSSIAN_BYTES + PLACE_BYTES);
        let numbers = |value: &Value| -> Vec<f64> {
            let list = value.as_array().unwrap().iter();
            list.map(|n| n.as_f64().unwrap()).collect()
        };
        let (low, step) = (
            numbers(&view.head["box"]["low"]),
            numbers(&view.head["box"]["step"]),
        );
        for (index, place) in places.iter().enumerate() {
            for axis in 0..3 {
                let at = index * GAUSSIAN_BYTES + 2 * axis;
                let steps = u16::from_le_bytes([view.bytes[at], view.bytes[at + 1]]);
                let read = low[axis] + f64::from(steps) * step[axis];
                assert!((read - f64::from(place[axis])).abs() <= 0.5 * step[axis] + 1e-6);
            }
        }
        assert!(step[0] < 0.001, "50 m in steps below a millimetre");
        // The error of 3 cm in steps of 2 mm, and one beyond all of them; sigma without end is the most.
        let errors = [view.bytes[16], view.bytes[GAUSSIAN_BYTES + 16]];
        assert_eq!((errors, view.bytes[15]), ([15, 255], 255));
    }

    #[test]
    fn what_became_of_a_gaussian_stands_beside_whether_it_is_asserted() {
        let mut gaussians = [Vec3::ZERO, Vec3::ONE].map(gaussian);
        gaussians[1].standing = Standing::Ambiguous;
        let view = MapView::of_changes(&gaussians, &[4, 5]);
        assert_eq!(view.head["has_change"], true);
        assert_eq!(
            (view.bytes[17], view.bytes[GAUSSIAN_BYTES + 17]),
            (4 << 1 | 1, 5 << 1)
        );
    }

    #[test]
    fn a_big_map_is_thinned_and_says_so() {
        let many: Vec<Gaussian> = (0..150_001)
            .map(|i| gaussian(Vec3::splat(0.5 * i as f32)))
            .collect();
        let view = MapView::new(&many, None, &[]);
        let html = view.to_html();
        assert!(html.len() < 1_600_000, "{} bytes", html.len());
        assert!(html.contains("One in 3 of 150001"), "{}", &html[..2000]);
        assert_eq!(view.head["has_error"], false);
    }

    #[test]
    fn what_is_not_finite_and_nothing_at_all_are_no_trouble() {
        let wrong = gaussian(Vec3::splat(f32::NAN));
        let view = MapView::new(&[wrong], None, &[DVec3::NAN]);
        assert_eq!((view.bytes.len(), view.total), (0, 0));
        assert!(!view.to_html().contains("null"));
    }
}
