//! Where numbers end: the fast renderer against its f64 twin at the edges of its domain.

use echosplat_model::glam::{EulerRot, Mat3, Quat, Vec3};

use super::tests::{KINDS, errors, errors_of, render, slopes};
use super::{PaperRenderer, PaperView, Transmittance};
use crate::parameters::{GaussianArrays, GradientArrays, PARAMETER_COUNT, Parameters};
use crate::random::Random;
use crate::scenes::{PaperScene, paper_scene_of};

fn view() -> PaperView {
    PaperView {
        position_m: Vec3::ZERO,
        axes: Mat3::IDENTITY,
        range_min_m: 0.5,
        range_step_m: 0.02,
        range_bins: 300,
        fov_rad: 1.0,
        beams: 48,
        least_pixel_variance: 0.3,
    }
}

fn ball(mean_m: Vec3, sigma_m: f32, logit: f32) -> Parameters {
    Parameters {
        mean_m,
        rotation: Quat::IDENTITY,
        log_scale: Vec3::splat(sigma_m.ln()),
        opacity_logit: logit,
        reflectivity_log: 0.0,
    }
}

fn scene(view: PaperView, all: impl IntoIterator<Item = Parameters>) -> PaperScene {
    let mut gaussians = GaussianArrays::new();
    for parameters in all {
        gaussians.push(parameters);
    }
    PaperScene { view, gaussians }
}

fn at(range_m: f32, azimuth: f32, elevation: f32) -> Vec3 {
    let level_m = range_m * elevation.cos();
    Vec3::new(
        level_m * azimuth.cos(),
        level_m * azimuth.sin(),
        range_m * elevation.sin(),
    )
}

#[track_caller]
fn check(scene: &PaperScene, image_limit: f64, gradient_limit: f64) {
    for kind in KINDS {
        let found = errors(scene, kind);
        println!("{kind:?} {found:?}");
        assert!(
            found[0] < image_limit && found[3] < gradient_limit,
            "{kind:?} {found:?}"
        );
    }
}

#[test]
fn pixel_covariances_of_any_condition() {
    let mut noise = Random::new(1);
    for decade in 2..=12 {
        let stretch = 10f32.powf(0.5 * decade as f32);
        for least_pixel_variance in [0.0, 0.3] {
            let view = PaperView {
                least_pixel_variance,
                ..view()
            };
            // Needles of one pixel's width, at any angle in range and azimuth, apart from each other.
            let needles = (0..4).map(|i| {
                let azimuth = 0.2 * i as f32 - 0.3;
                let turn = noise.between(-3.0, 3.0);
                Parameters {
                    rotation: Quat::from_euler(EulerRot::ZYX, turn, 0.3, 1.0),
                    log_scale: Vec3::new(0.03 * stretch, 0.03, 0.02).map(f32::ln),
                    ..ball(at(2.0 + i as f32, azimuth, 0.1), 1.0, -1.0)
                }
            });
            let scene = scene(view, needles.collect::<Vec<_>>());
            for kind in KINDS {
                let found = errors(&scene, kind);
                println!("1e{decade} {least_pixel_variance} {kind:?} {found:?}");
                assert!(
                    found[0] < 1e-4 && found[3] < 1e-2,
                    "1e{decade} {kind:?} {found:?}"
                );
            }
        }
    }
}

#[test]
fn azimuth_near_the_seam() {
    let view = PaperView {
        fov_rad: 6.2,
        beams: 120,
        ..view()
    };
    let around = [-3.1, -3.139, 3.138, 3.1412, -3.1412, 3.0, 1.6, -1.6];
    let all = around.map(|azimuth| ball(at(3.0 + 0.02 * azimuth, azimuth, 0.1), 0.1, -1.0));
    check(&scene(view, all), 1e-4, 1e-2);
}

#[test]
fn elevations_near_the_axis() {
    let all = [0.3, 0.1, 0.03, 0.01, 3e-3, 1.2e-3, 0.9e-3, 1e-4, 1e-7, 0.0].map(|tilt| {
        let elevation = std::f32::consts::FRAC_PI_2 - tilt;
        ball(at(2.0 + tilt, 0.2, elevation), 0.02, -1.0)
    });
    check(&scene(view(), all), 1e-3, 3e-2);
}

#[test]
fn ranges_near_zero() {
    let view = PaperView {
        range_min_m: 0.0,
        ..view()
    };
    let ranges = [0.0, 1e-38, 1e-20, 1e-3, 0.049, 0.0501, 0.06, 0.1, 0.3];
    let all = ranges.map(|range| ball(at(range, 0.1, 0.1), 0.01, -1.0));
    check(&scene(view, all), 1e-4, 1e-2);
}

#[test]
fn a_hundred_thousand_along_a_ray() {
    let view = PaperView {
        beams: 3,
        fov_rad: 0.05,
        range_bins: 60,
        ..view()
    };
    for (opacity, limit) in [(0.5f32, 1e-5), (1e-8, 2e-6)] {
        let logit = (opacity / (1.0 - opacity)).ln();
        // What is weak sends little back, so that its shadow on the last one is what is seen.
        let crowd = (0..100_000).map(|i| Parameters {
            reflectivity_log: -12.0,
            ..ball(at(1.0 + 1e-6 * (i % 1000) as f32, 0.0, 0.0), 0.03, logit)
        });
        let last = ball(at(1.01, 0.0, 0.0), 0.03, -2.0);
        let scene = scene(view, crowd.chain([last]));
        for kind in KINDS {
            let found = errors_of(PaperRenderer::new(), &scene, kind, 1e-3);
            println!("{opacity} {kind:?} {found:?}");
            assert!(found[0] < limit, "{opacity} {kind:?} {found:?}");
            assert!(found[2] < 3e-3, "{opacity} {kind:?} {found:?}");
        }
    }
}

#[test]
fn nearly_opaque_ones_on_the_way_back() {
    let mut noise = Random::new(9);
    for logit in [6.0, 6.8, 6.9, 9.0, 60.0] {
        let all = (0..60).map(|_| {
            let mean = at(noise.between(1.0, 1.6), noise.between(-0.3, 0.3), 0.1);
            ball(mean, 0.05, logit)
        });
        let scene = scene(view(), all.collect::<Vec<_>>());
        for kind in KINDS {
            let found = errors(&scene, kind);
            println!("{logit} {kind:?} {found:?}");
            // α itself is known to 6·10⁻⁸, and 1 − α so to 6·10⁻⁵.
            assert!(
                found[0] < 3e-4 && found[2] < 1e-2,
                "{logit} {kind:?} {found:?}"
            );
        }
    }
}

#[test]
fn what_is_not_finite_harms_nothing_else() {
    let good = paper_scene_of(6, 120);
    let values = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e38,
        -1e38,
        1e20,
        -1e20,
    ];
    for kind in KINDS {
        let mut spoilt = good.clone();
        for parameter in 0..PARAMETER_COUNT {
            for value in values {
                let mut row = good.gaussians.get(parameter).to_array();
                row[parameter] = value;
                spoilt.gaussians.push(Parameters::from_array(row));
            }
        }
        let mut renderer = PaperRenderer::new();
        let image = render(&spoilt, kind, &mut renderer);
        assert!(image.iter().all(|pixel| pixel.is_finite()), "{kind:?}");
        let mut d_image = slopes(image.len(), 1);
        for (slope, value) in d_image.iter_mut().step_by(97).zip(values.iter().cycle()) {
            *slope = *value;
        }
        let mut gradients = GradientArrays::zeros(spoilt.gaussians.len());
        renderer.backward(&spoilt.gaussians, &d_image, &mut gradients);
        let finite = |field: &[f32]| field.iter().all(|value| value.is_finite());
        assert!(gradients.fields().into_iter().all(finite), "{kind:?}");
        // NaN alone is as if it were not there.
        let mut nan = good.clone();
        let mut row = good.gaussians.get(3).to_array();
        row[10] = f32::NAN;
        nan.gaussians.push(Parameters::from_array(row));
        let clean = render(&good, kind, &mut renderer);
        assert_eq!(render(&nan, kind, &mut renderer), clean);
    }
}

#[test]
fn views_of_one_beam_or_one_bin_or_none() {
    let all = [0.52, 0.6, 1.0, 2.0].map(|range| ball(at(range, 0.01, 0.2), 0.05, -1.0));
    for (beams, range_bins) in [(1, 300), (48, 1), (1, 1), (2, 2), (3, 7)] {
        let view = PaperView {
            beams,
            range_bins,
            ..view()
        };
        check(&scene(view, all), 1e-4, 1e-2);
    }
    let unsound = PaperView {
        fov_rad: f32::NAN,
        ..view()
    };
    let scene = scene(unsound, all);
    let mut renderer = PaperRenderer::new();
    assert!(render(&scene, Transmittance::Averaged, &mut renderer).is_empty());
    let mut gradients = GradientArrays::zeros(4);
    renderer.backward(&scene.gaussians, &[1.0], &mut gradients);
    assert_eq!(gradients, GradientArrays::zeros(4));
}

#[test]
fn short_or_missing_slopes_count_as_zero() {
    let scene = paper_scene_of(5, 100);
    let mut renderer = PaperRenderer::new();
    render(&scene, Transmittance::Averaged, &mut renderer);
    let mut gradients = GradientArrays::zeros(100);
    renderer.backward(&scene.gaussians, &[], &mut gradients);
    assert_eq!(gradients, GradientArrays::zeros(100));
    // Fewer gradients than Gaussians: the rest has nowhere to go.
    let d_image = slopes(scene.view.pixel_count(), 3);
    renderer.backward(&scene.gaussians, &d_image, &mut GradientArrays::zeros(10));
}
