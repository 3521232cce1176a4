//! The geometry of one image.

use echosplat_model::glam::{Mat3, Vec3};

/// More pixels than any imaging sonar has; views beyond are not rendered. Places of pixels and
/// their padding stay exact as f32.
const PIXELS_MAX: u64 = 1 << 22;
/// Most numbers that a row is padded by.
const PADDING_MAX: u64 = 16;

/// Geometry of one image, shape `[beams][range_bins]`, on the map's local coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PaperView {
    /// Origin of the sensor relative to the map's origin.
    pub position_m: Vec3,
    /// The sensor's axes in world coordinates, as columns: forward, left, up.
    pub axes: Mat3,
    /// Range of the middle of bin 0: `r_min`.
    pub range_min_m: f32,
    /// Range from bin to bin: `ε_r`.
    pub range_step_m: f32,
    /// Number of range bins: H.
    pub range_bins: u32,
    /// Azimuth from the first beam to the last: FOV. The first is the rightmost.
    pub fov_rad: f32,
    /// Number of beams: W.
    pub beams: u32,
    /// Added to both diagonals of the pixel covariance, pixels²; the paper has 0.
    pub least_pixel_variance: f32,
}

/// How a Gaussian is shadowed by those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Transmittance {
    /// Not at all: T = 1.
    None,
    /// (26) to (28): by the product of what each pixel's nearer Gaussians let through.
    Exact,
    /// (29), (30): by that product's mean over the pixels the Gaussian covers.
    Averaged,
}

impl PaperView {
    /// `ε_θ`: azimuth from beam to beam.
    #[must_use]
    pub fn azimuth_step_rad(&self) -> f32 {
        self.fov_rad / self.beams.saturating_sub(1).max(1) as f32
    }

    /// Pixels in the image; 0 if the view [is not sound](Self::is_sound).
    #[must_use]
    pub fn pixel_count(&self) -> usize {
        if self.is_sound() {
            self.beams as usize * self.range_bins as usize
        } else {
            0
        }
    }

    /// Whether the view can be rendered: all numbers finite, steps positive, 1 to 2²² pixels.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let bins = u64::from(self.range_bins);
        let pixels = u64::from(self.beams) * (bins + PADDING_MAX);
        let steps = self.range_step_m.min(self.azimuth_step_rad());
        self.position_m.is_finite()
            && self.axes.is_finite()
            && self.range_min_m.is_finite()
            && self.range_step_m.is_finite()
            && self.fov_rad.is_finite()
            && steps > 1e-9
            && (0.0..=1e6).contains(&self.least_pixel_variance)
            && bins > 0
            && (1..=PIXELS_MAX).contains(&pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_that_is_not_sound_has_no_pixels() {
        let sound = crate::scenes::paper_scene(0).view;
        assert_eq!(sound.pixel_count(), 64 * 500);
        let views = [
            PaperView {
                range_step_m: f32::NAN,
                ..sound
            },
            PaperView {
                range_step_m: 0.0,
                ..sound
            },
            PaperView {
                fov_rad: f32::INFINITY,
                ..sound
            },
            PaperView { beams: 0, ..sound },
            PaperView {
                range_bins: u32::MAX,
                ..sound
            },
            PaperView {
                least_pixel_variance: -1.0,
                ..sound
            },
        ];
        for view in views {
            assert_eq!(view.pixel_count(), 0, "{view:?}");
        }
    }
}
