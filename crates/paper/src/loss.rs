//! (32): how far a predicted image is from the measured one.

/// `‖Î − I‖₁` of one view; `d_image` becomes its slope, the sign of the difference. Both images have
/// the shape `[beam][range bin]`.
pub(crate) fn l1(predicted: &[f32], measured: &[f32], d_image: &mut Vec<f32>) -> f64 {
    d_image.clear();
    d_image.extend(predicted.iter().zip(measured).map(|(p, m)| slope(p - m)));
    let differences = predicted
        .iter()
        .zip(measured)
        .map(|(p, m)| f64::from((p - m).abs()));
    differences.sum()
}

/// 0 where they agree: dark pixels that nothing is predicted in have no gradient.
fn slope(difference: f32) -> f32 {
    if difference > 0.0 {
        1.0
    } else if difference < 0.0 {
        -1.0
    } else {
        0.0
    }
}

/// `‖I‖₁`: the loss of an empty map.
pub(crate) fn of_nothing(measured: &[f32]) -> f64 {
    measured.iter().map(|value| f64::from(*value)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loss_adds_differences_and_its_slope_is_their_sign() {
        let mut d_image = vec![7.0; 9];
        let loss = l1(&[1.0, 0.0, 0.25], &[0.5, 0.0, 0.5], &mut d_image);
        assert!((loss - 0.75).abs() < 1e-12);
        assert_eq!(d_image, [1.0, 0.0, -1.0]);
        assert!((of_nothing(&[0.5, 0.25]) - 0.75).abs() < 1e-12);
    }
}
