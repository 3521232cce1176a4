//! The fast renderer against its plain f64 twin.

use echosplat_model::glam::{Mat3, Quat, Vec3};
use fearless_simd::Level;

use super::{PaperRenderer, PaperView, Transmittance};
use crate::reference::paper::{self, Row, Setting};
use crate::sample_paper::{Noise, PaperScene, paper_scene, paper_scene_of};
use crate::{GaussianArrays, GradientArrays, PARAMETER_COUNT, Parameters};

const KINDS: [Transmittance; 3] = [
    Transmittance::None,
    Transmittance::Exact,
    Transmittance::Averaged,
];

fn rows(gaussians: &GaussianArrays) -> Vec<Row<f64>> {
    let row = |i| gaussians.get(i).to_array().map(f64::from);
    (0..gaussians.len()).map(row).collect()
}

/// Slopes of the image like those of an L1 loss, and as f64.
fn slopes(count: usize, seed: u64) -> (Vec<f32>, Vec<f64>) {
    let mut noise = Noise::new(seed);
    let slopes: Vec<f32> = (0..count)
        .map(|_| noise.between(-1.0, 1.0).signum())
        .collect();
    let exact = slopes.iter().copied().map(f64::from).collect();
    (slopes, exact)
}

/// Largest error of the image over its peak.
fn image_error(fast: &[f32], exact: &[f64]) -> f64 {
    assert_eq!(fast.len(), exact.len());
    let peak = exact.iter().fold(1e-30, |a: f64, b| a.max(b.abs()));
    let error = |(f, e): (&f32, &f64)| (f64::from(*f) - e).abs() / peak;
    let worst = fast.iter().zip(exact).map(error).fold(0.0, |a: f64, b| {
        assert!(!b.is_nan());
        a.max(b)
    });
    worst
}

/// Shares of gradients whose error is above each limit; errors are over that Gaussian's largest
/// gradient of the same kind of parameter.
fn gradient_errors(fast: &GradientArrays, exact: &[Row<f64>]) -> Vec<f64> {
    let mut errors = Vec::new();
    for (i, exact) in exact.iter().enumerate() {
        let fast = fast.get(i);
        for group in [0..3, 3..7, 7..10, 10..11, 11..12] {
            let scale = group.clone().map(|k| exact[k].abs()).fold(0.0, f64::max);
            let error = group
                .map(|k| (f64::from(fast[k]) - exact[k]).abs())
                .fold(0.0, |a, b| {
                    assert!(!f64::is_nan(b));
                    f64::max(a, b)
                });
            errors.push(if scale > 0.0 { error / scale } else { error });
        }
    }
    errors.sort_by(f64::total_cmp);
    errors
}

fn render(scene: &PaperScene, kind: Transmittance, renderer: &mut PaperRenderer) -> Vec<f32> {
    renderer
        .forward(&scene.view, &scene.gaussians, &scene.all(), kind)
        .to_vec()
}

/// Image error, and gradient errors in ascending order, of a scene in one kind.
fn errors(scene: &PaperScene, kind: Transmittance) -> (f64, Vec<f64>) {
    let setting = Setting::new(&scene.view, kind);
    let mut renderer = PaperRenderer::new();
    let fast = render(scene, kind, &mut renderer);
    let rows = rows(&scene.gaussians);
    let image = image_error(&fast, &paper::forward(&setting, &rows));
    let (d_image, exact) = slopes(fast.len(), 5);
    let mut gradients = GradientArrays::zeros(rows.len());
    renderer.backward(&scene.gaussians, &d_image, &mut gradients);
    assert_eq!(renderer.dropped_gradient_count(), 0);
    let exact = paper::backward(&setting, &rows, &exact);
    (image, gradient_errors(&gradients, &exact))
}

#[test]
fn image_and_gradients_agree_with_the_twin() {
    let scene = paper_scene_of(11, 2000);
    for kind in KINDS {
        let (image, gradients) = errors(&scene, kind);
        let at = |share: f64| gradients[((gradients.len() - 1) as f64 * share) as usize];
        println!(
            "{kind:?}: image {image:e} gradients {:e} {:e} {:e}",
            at(0.5),
            at(0.99),
            at(1.0)
        );
    }
}

#[test]
fn bands_on_threads_give_the_same_bits() {
    let scene = paper_scene(2);
    let (d_image, _) = slopes(scene.view.pixel_count(), 1);
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
