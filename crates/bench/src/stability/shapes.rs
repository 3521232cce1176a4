//! Stiff shapes and singular places: covariance condition, the polar axis, range 0.

use echosplat_acoustics::Parameters;
use glam::Vec3;

use super::Row;
use super::naive;
use super::row::{Comparison, Figure, Label};
use super::scene::{Scene, plain};
use crate::draw::Draw;

const CONDITION: Label = Label {
    case: "covariance condition",
    quantity: "intensity of the worst bin, errors relative to the profile's peak",
    why: "Cross-section and variance in range are sums of squares of the scaled axes' cross products; \
          no determinant is a difference, and none is inverted. Conditions above 10¹² are clamped \
          and counted.",
};

const POLAR: Label = Label {
    case: "polar axis",
    quantity: "largest intensity, at 3 m straight above or below",
    why: "Azimuth has no meaning on the sensor's z axis, where its derivatives grow without bound; \
          the fan hears nothing there, so nothing is rendered.",
};

const NEAR: Label = Label {
    case: "range to 0",
    quantity: "intensity of the worst bin, errors relative to the profile's peak",
    why: "Nearer than 5 cm there is only the ringing transducer; such Gaussians are left out.",
};

/// Decades 10² to 10¹², the worst of many shapes and directions each.
pub(super) fn condition(seed: u64, quick: bool) -> Vec<Row> {
    let count = if quick { 40 } else { 500 };
    (2..=12)
        .map(|decade| condition_row(seed, decade, count))
        .chain([clamped_row(seed, 13)])
        .collect()
}

fn condition_row(seed: u64, decade: u32, count: usize) -> Row {
    let mut draw = Draw::new(seed, 100 + u64::from(decade));
    let ratio = 10_f32.powf(0.5 * decade as f32);
    let compare = |gaussian: Parameters| {
        let scene = Scene::new(false).with(gaussian);
        let truth = scene.twin::<f64>();
        let naive = naive::profile(&scene.geometry, &gaussian);
        Comparison::of_many(&truth, &scene.program()).with_naive_many(&truth, &naive)
    };
    let first = compare(stretched(&mut draw, ratio));
    let worst = (1..count).fold(first, |worst, _| {
        worst.worse(compare(stretched(&mut draw, ratio)))
    });
    worst.row(CONDITION, format!("10^{decade}, worst of {count}"), 5e-4)
}

/// Anything from needle to disc, its longest axis `ratio` times its shortest.
fn stretched(draw: &mut Draw, ratio: f32) -> Parameters {
    let longest_m = (1.05e-5 * ratio).max(0.3);
    let shortest_m = longest_m / ratio;
    let middle_m = shortest_m * ratio.powf(draw.between(0.0, 1.0));
    Parameters {
        mean_m: Vec3::new(5.0, 0.03, 0.8) + 0.02 * draw.cube(),
        rotation: draw.rotation(),
        log_scale: Vec3::new(longest_m, middle_m, shortest_m).map(f32::ln),
        ..plain(Vec3::ZERO)
    }
}

/// Beyond 10¹² the arrays' clamp thickens the thin axes; the twin sees the clamped Gaussian.
fn clamped_row(seed: u64, decade: u32) -> Row {
    let mut draw = Draw::new(seed, 100 + u64::from(decade));
    let mut gaussian = stretched(&mut draw, 1e6);
    gaussian.log_scale.z = gaussian.log_scale.x - 0.5 * decade as f32 * std::f32::consts::LN_10;
    let naive = naive::profile(&super::scene::geometry(), &gaussian);
    let mut scene = Scene::new(false).with(gaussian);
    let counted = scene.gaussians.clamp().conditions;
    let truth = scene.twin::<f64>();
    let comparison = Comparison::of_many(&truth, &scene.program()).with_naive_many(&truth, &naive);
    comparison.row(
        CONDITION,
        format!("10^{decade}, clamped to 10^12 ({counted} counted)"),
        5e-4,
    )
}

pub(super) fn polar(_seed: u64, _quick: bool) -> Vec<Row> {
    let row = |off_axis_m: f32| {
        let each = [-3.0, 3.0].map(|height_m| {
            let gaussian = plain(Vec3::new(off_axis_m, 0.1 * off_axis_m, height_m));
            let scene = Scene::new(false).with(gaussian);
            let naive = naive::profile(&scene.geometry, &gaussian);
            let loudest = |profile: &[f32]| loudest(profile.iter().copied());
            let gradient = scene.program_gradient(&vec![1.0; 600]);
            let slope = loudest(&gradient.concat());
            Comparison::of(0.0, loudest(&scene.program()).max(slope), 1.0)
                .with_naive(loudest(&naive), 1.0)
        });
        let worst = each[0].worse(each[1]);
        worst.row(
            POLAR,
            format!("{} m off the axis", Figure(off_axis_m.into())),
            0.0,
        )
    };
    [0.1, 1e-3, 1e-8, 1e-20, 0.0].map(row).into()
}

/// The largest, and not a number if one is none.
fn loudest(profile: impl Iterator<Item = f32>) -> f64 {
    let most = |most: f32, value: f32| match value.is_nan() || most.is_nan() {
        true => f32::NAN,
        false => most.max(value.abs()),
    };
    f64::from(profile.fold(0.0, most))
}

pub(super) fn near(_seed: u64, _quick: bool) -> Vec<Row> {
    let row = |range_m: f32| {
        let gaussian = Parameters {
            log_scale: Vec3::splat(-7.0),
            ..plain(Vec3::new(range_m, 0.0, 0.0))
        };
        let scene = Scene::new(false).with(gaussian);
        let truth = match range_m > 0.05 {
            true => scene.twin::<f64>(),
            false => vec![0.0; 600],
        };
        let naive = naive::profile(&scene.geometry, &gaussian);
        let comparison = Comparison::of_many(&truth, &scene.program());
        let comparison = comparison.with_naive_many(&truth, &naive);
        comparison.row(NEAR, format!("{} m", Figure(range_m.into())), 2e-5)
    };
    [1.0, 0.051, 0.05, 1e-3, 1e-10, 1e-25, 0.0].map(row).into()
}
