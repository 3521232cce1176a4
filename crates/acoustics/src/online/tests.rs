//! The kernels against the f64 twin.

use fearless_simd::Level;

use super::*;
use crate::reference::online as twin;
use crate::sample::{self, Numbers as Dice};

const OCCLUSION: [OnlineOptions; 2] = [
    OnlineOptions { occlusion: false },
    OnlineOptions { occlusion: true },
];

fn levels() -> [Level; 3] {
    [Level::fallback(), Level::baseline(), Level::new()]
}

fn all(gaussians: &GaussianArrays) -> Vec<u32> {
    (0..gaussians.len() as u32).collect()
}

fn weights(dice: &mut Dice, count: u32) -> Vec<f32> {
    (0..count).map(|_| dice.between(-1.0, 1.0)).collect()
}

/// Largest difference of intensity over the largest intensity; of gradients over each Gaussian's
/// largest.
fn errors(
    level: Level,
    options: OnlineOptions,
    look: &Look,
    gaussians: &GaussianArrays,
    d_intensity: &[f32],
) -> (f64, f64) {
    let visible = all(gaussians);
    let mut renderer = OnlineRenderer::with_level(options, level);
    let found = renderer.forward(look, gaussians, &visible).to_vec();
    let mut gradients = GradientArrays::zeros(gaussians.len());
    renderer.backward(gaussians, d_intensity, &mut gradients);
    assert_eq!(renderer.not_finite_count(), 0);

    let numbers = twin::numbers_of::<f64>(gaussians);
    let cutoffs = twin::Cutoffs::default();
    let expected = twin::forward(look, &numbers, &visible, options.occlusion, &cutoffs);
    let d_intensity: Vec<f64> = d_intensity.iter().map(|&g| f64::from(g)).collect();
    let expected_gradients = twin::backward(look, &numbers, &expected, &d_intensity);

    let most = |values: &[f64]| values.iter().fold(0f64, |most, x| most.max(x.abs()));
    let peak = most(&expected.intensity);
    let forward = (found.iter().zip(&expected.intensity)).fold(0f64, |worst, (&f, e)| {
        worst.max((f64::from(f) - e).abs() / peak)
    });
    let mut backward = 0f64;
    for (index, expected) in expected_gradients.iter().enumerate() {
        let (found, most) = (gradients.get(index), most(expected));
        for (&f, e) in found.iter().zip(expected) {
            if most > 0.0 || f != 0.0 {
                backward = backward.max((f64::from(f) - e).abs() / most);
            }
        }
    }
    (forward, backward)
}

#[test]
fn they_agree_with_the_twin_at_every_level() {
    for (seed, options) in [(1, OCCLUSION[0]), (2, OCCLUSION[1])] {
        let (look, gaussians) = sample::bench_scene(seed);
        let d_intensity = weights(&mut Dice::new(seed), look.bin_count);
        for level in levels() {
            let (forward, backward) = errors(level, options, &look, &gaussians, &d_intensity);
            println!("{options:?} {level:?}: forward {forward:e}, backward {backward:e}");
            assert!(forward < 1e-4, "{options:?} {level:?}: {forward:e}");
            assert!(backward < 1e-3, "{options:?} {level:?}: {backward:e}");
        }
    }
}
