//! Colour of a reflectivity, for viewers that show only colour.

/// Reflectivity drawn as the darkest colour; everything the map holds is relative to 1.
const DARKEST_DB: f32 = -40.0;

/// Nine even stops of the viridis ramp (public domain), whose lightness rises evenly.
const STOPS: [[f32; 3]; 9] = [
    [0.267, 0.005, 0.329],
    [0.279, 0.175, 0.483],
    [0.230, 0.322, 0.546],
    [0.173, 0.449, 0.558],
    [0.128, 0.567, 0.551],
    [0.153, 0.681, 0.504],
    [0.360, 0.785, 0.388],
    [0.667, 0.863, 0.198],
    [0.993, 0.906, 0.144],
];

/// Red, green and blue, 0 to 1, of a linear reflectivity: −40 dB and below dark, 0 dB bright.
pub(crate) fn color_of_reflectivity(reflectivity: f32) -> [f32; 3] {
    let decibel = 10.0 * reflectivity.max(f32::MIN_POSITIVE).log10();
    let position = ((decibel - DARKEST_DB) / -DARKEST_DB).clamp(0.0, 1.0) * 8.0;
    let stop = (position as usize).min(7);
    let fraction = position - stop as f32;
    std::array::from_fn(|channel| {
        let (low, high) = (STOPS[stop][channel], STOPS[stop + 1][channel]);
        low + fraction * (high - low)
    })
}

/// The same, 0 to 255.
pub(crate) fn bytes_of_color(color: [f32; 3]) -> [u8; 3] {
    color.map(|channel| (255.0 * channel).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ramp_brightens_with_reflectivity_and_survives_zero() {
        let lightness = |r: f32| color_of_reflectivity(r).iter().sum::<f32>();
        assert!(lightness(0.0) <= lightness(1e-3));
        assert!(lightness(1e-3) < lightness(1e-1));
        assert!(lightness(1e-1) < lightness(1.0));
        assert!(lightness(f32::NAN).is_finite());
    }
}
