//! Every choice the paper leaves open, made once for both of its cases.

use crate::rendering::Transmittance;
use serde::{Deserialize, Serialize};

mod table;

pub use table::Choice;

/// The opacity above which the paper's figures of the fence show Gaussians.
pub const ASSERTED_IN_FENCE_FIGURE: f32 = 0.7;
/// The opacity above which its figures of the truss show Gaussians.
pub const ASSERTED_IN_TRUSS_FIGURE: f32 = 0.2;

/// How Gaussians shadow one another in a rendered image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shadowing {
    /// (29), (30): one transmittance per Gaussian.
    Averaged,
    /// (26) to (28): one per Gaussian and pixel.
    Exact,
    /// Not at all.
    Off,
}

impl From<Shadowing> for Transmittance {
    fn from(shadowing: Shadowing) -> Self {
        match shadowing {
            Shadowing::Averaged => Self::Averaged,
            Shadowing::Exact => Self::Exact,
            Shadowing::Off => Self::None,
        }
    }
}

/// What the paper does not say. Lengths in space are in *beam widths*: the spacing of beams times the
/// middle range of the active pixels, the one scale that both of its cases share.
/// [`Choices::rows`] says why each value is what it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Choices {
    /// Power to which an intensity over the unit is raised: 1 leaves it linear, ½ makes amplitudes.
    pub image_power: f32,
    /// Least value of an active pixel, 0 to 1.
    pub active_value: f32,
    /// Half of `φ_max − φ_min` of (11) and (34).
    pub elevation_half_width_rad: f32,
    /// Spacing of elevation samples (11), in spacings of beams.
    pub elevation_step_beams: f32,
    /// Edge of the cells whose samples become one candidate, beam widths.
    pub merge_beams: f32,
    /// Radius within which views support a candidate (12), beam widths.
    pub support_beams: f32,
    /// `M` of (12) as a share of all views, at least `support_views`.
    pub support_share: f32,
    /// Least `M` of (12).
    pub support_views: u32,
    /// `ρ` of a pixel of value 1 at the start.
    pub reflectivity_share: f32,
    /// One sigma along every axis at the start, beam widths.
    pub scale_beams: f32,
    /// Least and largest sigma while optimising, beam widths.
    pub scale_limits_beams: [f32; 2],
    /// Added to both diagonals of (24), pixels².
    pub least_pixel_variance: f32,
    /// Which of the paper's two renderers.
    pub shadowing: Shadowing,
    /// `λ_α` of (42).
    pub opacity_weight: f32,
    /// `λ_s` of (42), scales in beam widths.
    pub scale_weight: f32,
    /// `λ_elev` of (42).
    pub elevation_weight: f32,
    /// `λ_depth` of (40), per m².
    pub depth_weight: f32,
    /// `ε` of (37).
    pub entropy_epsilon: f32,
    /// `Δφ` of (34).
    pub elevation_bin_rad: f32,
    /// Adam's step of the mean, beam widths.
    pub rate_mean_beams: f32,
    /// Adam's step of the quaternion's parts.
    pub rate_rotation: f32,
    /// Adam's step of the log scales.
    pub rate_log_scale: f32,
    /// Adam's step of the opacity's logit.
    pub rate_opacity: f32,
    /// Adam's step of the log reflectivity.
    pub rate_reflectivity: f32,
    /// All steps shrink evenly in their logarithm to this share at the last epoch.
    pub rate_at_end: f32,
    /// `η` of (44).
    pub alignment_rate: f32,
    /// `β` of (45).
    pub alignment_memory: f32,
    /// `λ_h` of (46).
    pub alignment_decay: f32,
    /// Epochs of a whole run.
    pub epochs: u32,
    /// First epoch that ends with pruning.
    pub prune_from_epoch: u32,
    /// Epochs from pruning to pruning.
    pub prune_every_epochs: u32,
    /// Opacity below which a Gaussian goes.
    pub prune_opacity: f32,
    /// Distance to a more opaque one below which a Gaussian goes, beam widths.
    pub prune_distance_beams: f32,
    /// `r_d` of (47), beam widths.
    pub density_radius_beams: f32,
    /// `N_min` of (48), itself counted.
    pub density_least: u32,
    /// Share of Gaussians that the guard (49) protects: those of highest impact.
    pub guard_share: f32,
    /// Gaussians more opaque than this are what the map asserts.
    pub asserted_opacity: f32,
    /// Seed of the order of views.
    pub shuffle_seed: u64,
}

impl Default for Choices {
    fn default() -> Self {
        Self {
            image_power: 1.0,
            active_value: 0.1,
            elevation_half_width_rad: 25f32.to_radians(),
            elevation_step_beams: 1.0,
            merge_beams: 1.0,
            support_beams: 1.0,
            support_share: 0.08,
            support_views: 3,
            reflectivity_share: 0.4,
            scale_beams: 0.25,
            scale_limits_beams: [0.02, 2.0],
            least_pixel_variance: 0.3,
            shadowing: Shadowing::Averaged,
            opacity_weight: 0.05,
            scale_weight: 1e-2,
            elevation_weight: 1e-3,
            depth_weight: 1.0,
            entropy_epsilon: 1e-8,
            elevation_bin_rad: 2f32.to_radians(),
            rate_mean_beams: 0.04,
            rate_rotation: 1e-3,
            rate_log_scale: 5e-3,
            rate_opacity: 0.01,
            rate_reflectivity: 0.0,
            rate_at_end: 0.1,
            alignment_rate: 0.001,
            alignment_memory: 0.9,
            alignment_decay: 0.002,
            epochs: 100,
            prune_from_epoch: 2,
            prune_every_epochs: 2,
            prune_opacity: 0.05,
            prune_distance_beams: 0.2,
            density_radius_beams: 2.0,
            density_least: 3,
            guard_share: 0.02,
            asserted_opacity: ASSERTED_IN_TRUSS_FIGURE,
            shuffle_seed: 1,
        }
    }
}

/// A choice that no reconstruction can be made with.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("choice {name} is {value}; allowed is {low} to {high}")]
pub struct ChoiceError {
    name: &'static str,
    value: f32,
    low: f32,
    high: f32,
}

impl Choices {
    /// # Errors
    /// Names the first choice that is out of range.
    pub fn check(&self) -> Result<(), ChoiceError> {
        let [scale_low, scale_high] = self.scale_limits_beams;
        for (name, value, low, high) in [
            ("image_power", self.image_power, 0.05, 4.0),
            ("active_value", self.active_value, 1e-3, 1.0),
            (
                "elevation_half_width_rad",
                self.elevation_half_width_rad,
                0.01,
                1.5,
            ),
            (
                "elevation_step_beams",
                self.elevation_step_beams,
                0.05,
                100.0,
            ),
            ("merge_beams", self.merge_beams, 0.05, 100.0),
            ("support_beams", self.support_beams, 0.05, 100.0),
            ("support_share", self.support_share, 0.0, 1.0),
            ("reflectivity_share", self.reflectivity_share, 1e-3, 1.0),
            ("scale_limits_beams[0]", scale_low, 1e-4, 100.0),
            ("scale_limits_beams[1]", scale_high, scale_low, 100.0),
            ("scale_beams", self.scale_beams, scale_low, scale_high),
            (
                "least_pixel_variance",
                self.least_pixel_variance,
                0.0,
                100.0,
            ),
            ("opacity_weight", self.opacity_weight, 0.0, 1e6),
            ("scale_weight", self.scale_weight, 0.0, 1e6),
            ("elevation_weight", self.elevation_weight, 0.0, 1e6),
            ("depth_weight", self.depth_weight, 0.0, 1e6),
            ("entropy_epsilon", self.entropy_epsilon, 1e-30, 1.0),
            ("elevation_bin_rad", self.elevation_bin_rad, 1e-3, 3.2),
            ("rate_mean_beams", self.rate_mean_beams, 0.0, 10.0),
            ("rate_rotation", self.rate_rotation, 0.0, 10.0),
            ("rate_log_scale", self.rate_log_scale, 0.0, 10.0),
            ("rate_opacity", self.rate_opacity, 0.0, 10.0),
            ("rate_reflectivity", self.rate_reflectivity, 0.0, 10.0),
            ("rate_at_end", self.rate_at_end, 1e-6, 1.0),
            ("alignment_rate", self.alignment_rate, 0.0, 100.0),
            ("alignment_memory", self.alignment_memory, 0.0, 1.0),
            ("alignment_decay", self.alignment_decay, 0.0, 100.0),
            ("prune_opacity", self.prune_opacity, 0.0, 1.0),
            ("prune_distance_beams", self.prune_distance_beams, 0.0, 10.0),
            (
                "density_radius_beams",
                self.density_radius_beams,
                0.05,
                100.0,
            ),
            ("guard_share", self.guard_share, 0.0, 1.0),
            ("asserted_opacity", self.asserted_opacity, 0.0, 1.0),
        ] {
            if !(value >= low && value <= high) {
                return Err(ChoiceError {
                    name,
                    value,
                    low,
                    high,
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_out_of_range_is_named() {
        assert_eq!(Choices::default().check(), Ok(()));
        let no_cell = Choices {
            merge_beams: 0.0,
            ..Choices::default()
        };
        let message = no_cell.check().unwrap_err().to_string();
        assert_eq!(message, "choice merge_beams is 0; allowed is 0.05 to 100");
        let nan = Choices {
            rate_opacity: f32::NAN,
            ..Choices::default()
        };
        assert!(nan.check().is_err());
    }
}
