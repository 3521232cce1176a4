//! The kernels against the f64 twin, and what they promise.

mod energy;
mod extremes;

use fearless_simd::Level;

use super::*;
use crate::reference::online as twin;
use crate::sample::{self, Numbers as Dice};

const BARE: OnlineOptions = OnlineOptions { occlusion: false };
const SHADOWING: OnlineOptions = OnlineOptions { occlusion: true };

fn levels() -> [Level; 2] {
    [Level::baseline(), Level::new()]
}

fn all(gaussians: &GaussianArrays) -> Vec<u32> {
    (0..gaussians.len() as u32).collect()
}

fn weights(dice: &mut Dice, count: u32) -> Vec<f32> {
    (0..count).map(|_| dice.between(-1.0, 1.0)).collect()
}

/// Everything at once, for short tests.
fn render(
    options: OnlineOptions,
    geometry: &PingGeometry,
    gaussians: &GaussianArrays,
    d_intensity: &[f32],
) -> (Vec<f32>, GradientArrays) {
    let mut renderer = OnlineRenderer::new(options);
    let intensity = renderer
        .forward(geometry, gaussians, &all(gaussians))
        .to_vec();
    let mut gradients = GradientArrays::zeros(gaussians.len());
    renderer.backward(gaussians, d_intensity, &mut gradients);
    (intensity, gradients)
}

/// Largest difference of intensity over the largest intensity; of gradients over each Gaussian's
/// largest, or 1 % of the ping's largest where a Gaussian's own happens to cancel below that.
fn errors(
    level: Level,
    options: OnlineOptions,
    geometry: &PingGeometry,
    gaussians: &GaussianArrays,
    d_intensity: &[f32],
) -> (f64, f64) {
    let visible = all(gaussians);
    let mut renderer = OnlineRenderer::with_level(options, level);
    let found = renderer.forward(geometry, gaussians, &visible).to_vec();
    let mut gradients = GradientArrays::zeros(gaussians.len());
    renderer.backward(gaussians, d_intensity, &mut gradients);
    assert_eq!(renderer.not_finite_count(), 0);

    let numbers = twin::numbers_of::<f64>(gaussians);
    let cutoffs = twin::Cutoffs::default();
    let expected = twin::forward(geometry, &numbers, &visible, options.occlusion, &cutoffs);
    let d_intensity: Vec<f64> = d_intensity.iter().map(|&g| f64::from(g)).collect();
    let expected_gradients = twin::backward(geometry, &numbers, &expected, &d_intensity);

    let most = |values: &[f64]| values.iter().fold(0f64, |most, x| most.max(x.abs()));
    let peak = most(&expected.intensity);
    assert!(peak > 0.0);
    let differences = found.iter().zip(&expected.intensity);
    let forward = differences.fold(0f64, |worst, (&f, e)| {
        worst.max((f64::from(f) - e).abs() / peak)
    });
    let most_of_all = expected_gradients
        .iter()
        .map(|g| most(g))
        .fold(0f64, f64::max);
    let mut backward = 0f64;
    for (index, expected) in expected_gradients.iter().enumerate() {
        let (found, most) = (gradients.get(index), most(expected).max(0.01 * most_of_all));
        for (&f, e) in found.iter().zip(expected) {
            backward = backward.max((f64::from(f) - e).abs() / most);
        }
    }
    (forward, backward)
}

#[test]
fn they_agree_with_the_twin_at_every_level() {
    for (seed, options) in [(1, BARE), (2, SHADOWING)] {
        let (geometry, gaussians) = sample::bench_scene(seed);
        let d_intensity = weights(&mut Dice::new(seed), geometry.bin_count);
        for level in levels() {
            let (forward, backward) = errors(level, options, &geometry, &gaussians, &d_intensity);
            println!("{options:?} {level:?}: forward {forward:e}, backward {backward:e}");
            assert!(forward < 1e-4, "{options:?} {level:?}: {forward:e}");
            assert!(backward < 1e-3, "{options:?} {level:?}: {backward:e}");
        }
    }
}

#[test]
fn the_order_of_names_does_not_matter_and_strangers_are_left_out() {
    let (geometry, gaussians) = sample::bench_scene(3);
    let mut renderer = OnlineRenderer::new(SHADOWING);
    let sorted: Vec<u32> = (0..2_000).step_by(3).collect();
    let expected = renderer.forward(&geometry, &gaussians, &sorted).to_vec();
    let mut mixed: Vec<u32> = sorted.iter().rev().copied().collect();
    mixed.extend([2_000, u32::MAX, 0, 0, 3]);
    let found = renderer.forward(&geometry, &gaussians, &mixed);
    let bits = |values: &[f32]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(found), bits(&expected));
}

#[test]
fn a_used_renderer_gives_the_bits_of_a_new_one() {
    let (geometry, gaussians) = sample::bench_scene(4);
    let loss = weights(&mut Dice::new(4), geometry.bin_count);
    let mut used = OnlineRenderer::new(SHADOWING);
    let mut short = geometry;
    short.bin_count = 100;
    used.forward(&short, &gaussians, &all(&gaussians));
    used.backward(
        &gaussians,
        &loss,
        &mut GradientArrays::zeros(gaussians.len()),
    );
    let intensity = used
        .forward(&geometry, &gaussians, &all(&gaussians))
        .to_vec();
    let mut gradients = GradientArrays::zeros(gaussians.len());
    used.backward(&gaussians, &loss, &mut gradients);
    assert_eq!(
        (intensity, gradients),
        render(SHADOWING, &geometry, &gaussians, &loss)
    );
}

#[test]
fn rows_hold_what_intensity_is_made_of() {
    let (geometry, gaussians) = sample::bench_scene(5);
    let mut renderer = OnlineRenderer::new(SHADOWING);
    let expected = renderer
        .forward(&geometry, &gaussians, &all(&gaussians))
        .to_vec();
    let (mut sum, mut energies, mut pairs) = (vec![0f32; 600], Vec::new(), 0);
    for row in renderer.rows() {
        energies.clear();
        renderer.row_energies(row, &mut energies);
        assert_eq!(energies.len(), row.bins().len());
        pairs += energies.len() as u64;
        for (sum, energy) in sum[row.bins()].iter_mut().zip(&energies) {
            *sum += row.opacity * row.reflectivity * energy;
        }
    }
    assert_eq!(pairs, renderer.pair_count());
    let peak = expected.iter().copied().fold(0f32, f32::max);
    for (a, b) in sum.iter().zip(&expected) {
        assert!((a - b).abs() < 1e-6 * peak);
    }
}

#[test]
fn they_see_what_the_projector_sees() {
    let (geometry, gaussians) = sample::bench_scene(6);
    let mut renderer = OnlineRenderer::new(BARE);
    renderer.forward(&geometry, &gaussians, &all(&gaussians));
    assert_eq!(renderer.rows().len(), gaussians.len());
    for row in renderer.rows() {
        let one = gaussians.get(row.index as usize);
        let splat = geometry.project(one.mean_m, &one.covariance_m2()).unwrap();
        assert!((splat.range_m - row.range_m - row.offset_m).abs() < 2e-5);
        assert!((splat.range_sigma_m * row.inverse_sigma - 1.0).abs() < 1e-3);
        assert!((splat.energy / row.energy - 1.0).abs() < 1e-3);
    }
}

#[test]
fn nothing_is_made_of_nothing() {
    let (geometry, gaussians) = sample::bench_scene(0);
    let mut renderer = OnlineRenderer::new(SHADOWING);
    assert!(renderer.intensity().is_empty());
    let mut gradients = GradientArrays::zeros(gaussians.len());
    renderer.backward(&gaussians, &[1.0; 600], &mut gradients);
    let dark = renderer.forward(&geometry, &gaussians, &[]);
    assert_eq!(dark, [0.0; 600]);
    renderer.backward(&gaussians, &[1.0; 600], &mut gradients);
    assert_eq!(gradients, GradientArrays::zeros(gaussians.len()));
    let mut no_bins = geometry;
    no_bins.bin_count = 0;
    assert!(renderer.forward(&no_bins, &gaussians, &[0, 1]).is_empty());
    renderer.backward(&gaussians, &[], &mut gradients);
    assert!(
        gradients
            .fields()
            .iter()
            .all(|field| field.iter().all(|g| g.is_finite()))
    );
}

#[test]
fn a_second_call_grows_no_buffer() {
    let (geometry, gaussians) = sample::bench_scene(8);
    let mut renderer = OnlineRenderer::new(SHADOWING);
    let mut gradients = GradientArrays::zeros(gaussians.len());
    let mut capacities = [[0; 6]; 2];
    for capacities in &mut capacities {
        renderer.forward(&geometry, &gaussians, &all(&gaussians));
        renderer.backward(&gaussians, &[1.0; 600], &mut gradients);
        *capacities = [
            renderer.visible.capacity(),
            renderer.rows.capacity(),
            renderer.intensity.capacity(),
            renderer.partial.capacity(),
            renderer.row_gradients.capacity(),
            renderer.occlusion.capacity(),
        ];
    }
    assert_eq!(capacities[0], capacities[1]);
}
