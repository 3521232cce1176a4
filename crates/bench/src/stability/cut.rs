//! The edge of the paper's kernels. Rounding puts a pixel that lies on it inside or outside, and either is right.

use echosplat_paper::PARAMETER_COUNT;
use echosplat_paper::twin::{self, Row, Setting};

/// How much nearer or further the cut may fall: single precision's rounding of a pixel some hundred pixels from the
/// image's edge under a kernel a few pixels wide.
const ROUNDING: f64 = 1e-5;

/// The image nearest to the program's.
pub(super) fn nearest_image(
    setting: &Setting<'_>,
    gaussians: &[Row<f64>],
    image: &[f32],
) -> Vec<f64> {
    let pixels: Vec<[f32; 1]> = image.iter().map(|&pixel| [pixel]).collect();
    let forward = |setting: &Setting<'_>| {
        let image = twin::forward(setting, gaussians);
        image.into_iter().map(|pixel| [pixel]).collect()
    };
    let nearest = nearest(setting, forward, &pixels);
    nearest.into_iter().map(|[pixel]| pixel).collect()
}

/// The gradients nearest to the program's.
pub(super) fn nearest_gradients(
    setting: &Setting<'_>,
    gaussians: &[Row<f64>],
    slope: &[f32],
    gradients: &[[f32; PARAMETER_COUNT]],
) -> Vec<Row<f64>> {
    let slope: Vec<f64> = slope.iter().map(|&slope| f64::from(slope)).collect();
    let backward = |setting: &Setting<'_>| twin::backward(setting, gaussians, &slope);
    nearest(setting, backward, gradients)
}

/// The numbers nearest to the program's that the twin gives with the cut where rounding may put it.
fn nearest<const N: usize>(
    setting: &Setting<'_>,
    twin: impl Fn(&Setting<'_>) -> Vec<[f64; N]>,
    program: &[[f32; N]],
) -> Vec<[f64; N]> {
    let cut_at = |part: f64| {
        let reach_sigmas = part * setting.reach_sigmas;
        twin(&Setting {
            reach_sigmas,
            ..*setting
        })
    };
    let pairs = cut_at(1.0 - ROUNDING)
        .into_iter()
        .zip(cut_at(1.0 + ROUNDING));
    let nearest = |(index, (nearer, further)): (usize, ([f64; N], [f64; N]))| {
        std::array::from_fn(|k| {
            let (least, most) = (nearer[k].min(further[k]), nearer[k].max(further[k]));
            // Where the program has no number the twin's stands, and comparing the two fails.
            let number = program.get(index).map_or(f64::NAN, |row| row[k].into());
            number.max(least).min(most)
        })
    };
    pairs.enumerate().map(nearest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_paper::rendering::Transmittance;
    use echosplat_paper::scenes;

    #[test]
    fn what_is_at_the_cut_is_right_on_both_sides_and_what_is_not_is_held_to_the_twin() {
        let view = scenes::paper_scene_of(0, 0).view;
        let setting = Setting::new(&view, Transmittance::None);
        let reach = setting.reach_sigmas;
        // Whether something so far off is seen, as the program has it.
        let of = |at: f64, program: f32| {
            let is_in = |setting: &Setting<'_>| vec![[f64::from(at < setting.reach_sigmas)]];
            nearest(&setting, is_in, &[[program]])[0][0]
        };
        let is = |at: f64, program: f32, expected: f64| {
            let found = of(at, program);
            assert!((found - expected).abs() < f64::EPSILON, "{at}: {found}");
        };
        is(reach, 0.0, 0.0);
        is(reach, 1.0, 1.0);
        is(reach, 1.5, 1.0);
        is(0.9 * reach, 0.0, 1.0);
        is(1.1 * reach, 1.0, 0.0);
        // The twin's stands beside what is no number, and beside what is missing.
        is(0.9 * reach, f32::NAN, 1.0);
        assert_eq!(nearest(&setting, |_| vec![[1.0]; 2], &[[1.0]]).len(), 2);
    }
}
