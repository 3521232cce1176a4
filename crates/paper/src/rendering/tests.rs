//! The fast renderer against its plain f64 twin.

use fearless_simd::Level;

use super::{PaperRenderer, PaperView, Transmittance};
use crate::parameters::{GaussianArrays, GradientArrays};
use crate::random::Random;
use crate::scenes::{PaperScene, paper_scene, paper_scene_of};
use crate::twin::{self, Row, Setting};

pub(super) const KINDS: [Transmittance; 3] = [
    Transmittance::None,
    Transmittance::Exact,
    Transmittance::Averaged,
];

fn rows(gaussians: &GaussianArrays) -> Vec<Row<f64>> {
    let row = |i| gaussians.get(i).to_array().map(f64::from);
    (0..gaussians.len()).map(row).collect()
}

/// Slopes of the image like those of an L1 loss.
pub(super) fn slopes(count: usize, seed: u64) -> Vec<f32> {
    let mut noise = Random::new(seed);
    (0..count)
        .map(|_| noise.between(-1.0, 1.0).signum())
        .collect()
}

/// Largest of some errors; none may be NaN.
fn worst(errors: impl Iterator<Item = f64>) -> f64 {
    errors.fold(0.0, |a, b| {
        assert!(!b.is_nan());
        a.max(b)
    })
}

/// Largest error of the image over its peak.
fn image_error(fast: &[f32], exact: &[f64]) -> f64 {
    assert_eq!(fast.len(), exact.len());
    let peak = exact.iter().fold(1e-30, |a: f64, b| a.max(b.abs()));
    let error = |(f, e): (&f32, &f64)| (f64::from(*f) - e).abs() / peak;
    worst(fast.iter().zip(exact).map(error))
}

/// Errors of gradients in ascending order, each of one kind of parameter of one Gaussian, over the
/// larger of that gradient and a share of the Gaussian's steepest: what random slopes of pixels
/// leave of a gradient may be nothing but their difference.
fn gradient_errors(fast: &GradientArrays, exact: &[Row<f64>], share: f64) -> Vec<f64> {
    let mut errors = Vec::new();
    for (i, exact) in exact.iter().enumerate() {
        let fast = fast.get(i);
        let steepest = exact.iter().fold(0f64, |a, b| a.max(b.abs()));
        for group in [0..3, 3..7, 7..10, 10..11, 11..12] {
            let size = worst(group.clone().map(|k| exact[k].abs()));
            let error = worst(group.map(|k| (f64::from(fast[k]) - exact[k]).abs()));
            let scale = size.max(share * steepest);
            errors.push(if scale > 0.0 { error / scale } else { error });
        }
    }
    errors.sort_by(f64::total_cmp);
    errors
}

pub(super) fn render(
    scene: &PaperScene,
    kind: Transmittance,
    renderer: &mut PaperRenderer,
) -> Vec<f32> {
    renderer
        .forward(&scene.view, &scene.gaussians, &scene.all(), kind)
        .to_vec()
}

/// Error of the image, and the median, 99 % and largest of the gradients' errors.
pub(super) fn errors_of(
    mut renderer: PaperRenderer,
    scene: &PaperScene,
    kind: Transmittance,
    share: f64,
) -> [f64; 4] {
    let setting = Setting::new(&scene.view, kind);
    let fast = render(scene, kind, &mut renderer);
    let rows = rows(&scene.gaussians);
    let image = image_error(&fast, &twin::forward(&setting, &rows));
    let d_image = slopes(fast.len(), 5);
    let mut gradients = GradientArrays::zeros(rows.len());
    renderer.backward(&scene.gaussians, &d_image, &mut gradients);
    assert_eq!(renderer.dropped_gradient_count(), 0);
    let d_image: Vec<f64> = d_image.into_iter().map(f64::from).collect();
    let exact = twin::backward(&setting, &rows, &d_image);
    let errors = gradient_errors(&gradients, &exact, share);
    let at = |part: f64| errors[((errors.len() - 1) as f64 * part) as usize];
    [image, at(0.5), at(0.99), at(1.0)]
}

pub(super) fn errors(scene: &PaperScene, kind: Transmittance) -> [f64; 4] {
    errors_of(PaperRenderer::new(), scene, kind, 1e-3)
}

#[test]
fn image_and_gradients_agree_with_the_twin() {
    let scene = paper_scene_of(11, 2000);
    for level in [Level::baseline(), Level::new()] {
        for kind in KINDS {
            let found = errors_of(PaperRenderer::with_level(level), &scene, kind, 1e-3);
            println!("{kind:?} {found:?}");
            let [image, median, most, all] = found;
            assert!(
                image < 1e-4 && median < 3e-5 && most < 2e-3 && all < 0.1,
                "{kind:?} {found:?}"
            );
        }
    }
}

#[test]
fn splats_as_large_as_the_image_take_several_batches() {
    let mut scene = paper_scene_of(4, 150);
    for field in &mut scene.gaussians.log_scale {
        field.fill(0.7);
    }
    scene.gaussians.opacity_logit.fill(-3.0);
    for kind in KINDS {
        let found = errors(&scene, kind);
        println!("{kind:?} {found:?}");
        let [image, median, most, all] = found;
        assert!(
            image < 1e-4 && median < 1e-4 && most < 2e-3 && all < 1e-2,
            "{kind:?} {found:?}"
        );
    }
}

#[test]
fn bands_on_threads_give_the_same_bits() {
    let scene = paper_scene(2);
    let d_image = slopes(scene.view.pixel_count(), 1);
    for kind in KINDS {
        let run = |mut renderer: PaperRenderer| {
            let image = render(&scene, kind, &mut renderer);
            let mut gradients = GradientArrays::zeros(scene.gaussians.len());
            renderer.backward(&scene.gaussians, &d_image, &mut gradients);
            (image, gradients)
        };
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(2)
            .build()
            .unwrap();
        let alone = run(PaperRenderer::new());
        assert_eq!(alone, pool.install(|| run(PaperRenderer::parallel())));
    }
}

#[test]
fn a_second_way_back_finds_the_same() {
    let scene = paper_scene_of(3, 3000);
    let d_image = slopes(scene.view.pixel_count(), 1);
    for kind in KINDS {
        let mut renderer = PaperRenderer::new();
        render(&scene, kind, &mut renderer);
        let [first, second] = [(); 2].map(|()| {
            let mut gradients = GradientArrays::zeros(scene.gaussians.len());
            renderer.backward(&scene.gaussians, &d_image, &mut gradients);
            gradients
        });
        assert_eq!(first, second);
        let again = render(&scene, kind, &mut renderer);
        assert_eq!(again, render(&scene, kind, &mut PaperRenderer::new()));
    }
}

fn bits(row: [f32; 12]) -> [u32; 12] {
    row.map(f32::to_bits)
}

#[test]
fn a_subset_is_rendered_alone_whatever_its_order() {
    let scene = paper_scene_of(8, 600);
    let kind = Transmittance::Averaged;
    let mut chosen = scene.clone();
    let mask: Vec<bool> = (0..600).map(|i| i % 3 == 1).collect();
    chosen.gaussians.retain(&mask);
    let expected = render(&chosen, kind, &mut PaperRenderer::new());
    let subset: Vec<u32> = (0..200)
        .rev()
        .map(|i| 3 * i + 1)
        .chain([600, u32::MAX])
        .collect();
    let mut renderer = PaperRenderer::new();
    let found = renderer
        .forward(&scene.view, &scene.gaussians, &subset, kind)
        .to_vec();
    assert_eq!(found, expected);
    let d_image = slopes(found.len(), 2);
    let mut gradients = GradientArrays::zeros(600);
    renderer.backward(&scene.gaussians, &d_image, &mut gradients);
    let mut of_chosen = GradientArrays::zeros(200);
    render(&chosen, kind, &mut renderer);
    renderer.backward(&chosen.gaussians, &d_image, &mut of_chosen);
    for i in 0..200 {
        assert_eq!(bits(gradients.get(3 * i + 1)), bits(of_chosen.get(i)));
        assert_eq!(bits(gradients.get(3 * i)), [0; 12]);
    }
}

#[test]
fn pairs_are_counted_as_the_pixels_of_the_kernels() {
    let scene = PaperScene {
        view: PaperView {
            least_pixel_variance: 0.0,
            ..paper_scene(0).view
        },
        ..paper_scene_of(1, 1)
    };
    let mut renderer = PaperRenderer::new();
    let image = render(&scene, Transmittance::None, &mut renderer);
    let lit = image.iter().filter(|&&pixel| pixel > 0.0).count();
    assert_eq!(renderer.pair_count(), lit as u64);
}
