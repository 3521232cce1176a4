//! Every choice the paper leaves open, made once for both of its cases.

use echosplat_acoustics::paper::Transmittance;
use serde::{Deserialize, Serialize};

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
    /// Power to which an intensity over the unit is raised; ½ makes amplitudes.
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
            image_power: 0.5,
            active_value: 0.3,
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
            opacity_weight: 1e-3,
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

/// One row of the table of choices.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Choice {
    /// The field's name, or what is chosen in words where it is no number.
    pub name: &'static str,
    /// Its value, with the unit.
    pub value: String,
    /// Why, and where in the paper.
    pub why: &'static str,
}

impl Choices {
    /// Every choice with its value and why: the table for reports.
    #[must_use]
    pub fn rows(&self) -> Vec<Choice> {
        let mut rows = self.rows_of_images_and_candidates();
        rows.extend(self.rows_of_rendering_and_loss());
        rows.extend(self.rows_of_steps());
        rows.extend(self.rows_of_pruning_and_map());
        rows
    }

    fn rows_of_images_and_candidates(&self) -> Vec<Choice> {
        let degrees = |rad: f32| format!("{:.1}°", rad.to_degrees());
        vec![
            row(
                "image unit",
                "median over views of the brightest pixel".to_owned(),
                "the paper states no normalisation; one unit for all views keeps their intensities comparable, and the median hears neither a glint nor the dark views",
            ),
            row(
                "image_power",
                self.image_power,
                "I = (intensity/unit)^½, an amplitude: under L1 (32) a linear image's bright pixels are a minority under every kernel and its best map is empty; (8) takes gains as already adjusted",
            ),
            row(
                "active_value",
                self.active_value,
                "V-B \"each active sonar pixel\", VI \"intensity thresholding\": no value printed; 0.3 of amplitude is 10 dB below the unit",
            ),
            row(
                "elevation_half_width_rad",
                degrees(self.elevation_half_width_rad),
                "φ_min, φ_max of (11): the sonar's fan at half power",
            ),
            row(
                "elevation_step_beams",
                format!("{} beam spacings", self.elevation_step_beams),
                "(11) \"uniformly sampled\": as dense as the image is in azimuth",
            ),
            row(
                "merge_beams",
                format!("{} beam widths", self.merge_beams),
                "duplicates on neighbouring arcs are one candidate; not in the paper, whose 50,940 candidates from 249 views are fewer than their active pixels' arcs",
            ),
            row(
                "support_beams",
                format!("{} beam widths", self.support_beams),
                "(12) \"within a spatial radius\": a beam's own uncertainty; the tags follow from it, so it also sets how much darkness around its echoes a Gaussian answers for",
            ),
            row(
                "support_share",
                format!("{} of the views", self.support_share),
                "M of (12): a fixed M would mean less the more views there are; near the printed counts 38,024 and 174,637",
            ),
            row(
                "support_views",
                self.support_views,
                "M of (12) where views are few",
            ),
        ]
    }

    fn rows_of_rendering_and_loss(&self) -> Vec<Choice> {
        let shadowing = match self.shadowing {
            Shadowing::Averaged => "averaged",
            Shadowing::Exact => "exact",
            Shadowing::Off => "off",
        };
        vec![
            row(
                "reflectivity_share",
                self.reflectivity_share,
                "\"reflectivity proportional to the measured intensity\" before (13): several Gaussians share every pixel at the start; at this factor those that stay end between the two printed opacities",
            ),
            row(
                "scale_beams",
                format!("{} beam widths", self.scale_beams),
                "no initial scale printed: about one range bin, half a beam",
            ),
            row(
                "scale_limits_beams",
                format!("{:?} beam widths", self.scale_limits_beams),
                "keeps (18)'s linearisation meaningful",
            ),
            row(
                "least_pixel_variance",
                format!("{} px²", self.least_pixel_variance),
                "added to (24) so that no Gaussian falls between pixels; as optical splatting does",
            ),
            row(
                "shadowing",
                shadowing,
                "(29), (30) is the paper's own way of training",
            ),
            row(
                "loss",
                "sum over pixels, one view per step",
                "(31), (32) as printed, not divided by anything",
            ),
            row(
                "opacity_weight",
                self.opacity_weight,
                "λ_α of (42), on the view's Gaussians at every step",
            ),
            row(
                "scale_weight",
                self.scale_weight,
                "λ_s of (42), scales in beam widths",
            ),
            row(
                "elevation_weight",
                self.elevation_weight,
                "λ_elev of (42); small, since (39) draws a front and a back of one structure together",
            ),
            row(
                "depth_weight",
                format!("{} per m²", self.depth_weight),
                "λ_depth of (40)",
            ),
            row(
                "entropy_epsilon",
                self.entropy_epsilon,
                "ε of (37), \"a small constant\"",
            ),
            row(
                "elevation_bin_rad",
                format!("{:.1}°", self.elevation_bin_rad.to_degrees()),
                "Δφ of (34): a beam spacing or two",
            ),
            row(
                "f_k",
                "bilinear between pixels",
                "(35): the entropy's only gradient goes through it, and a pixel's value alone has none",
            ),
        ]
    }

    fn rows_of_steps(&self) -> Vec<Choice> {
        vec![
            row(
                "optimiser",
                "Adam (0.9, 0.999), one step per view on its tagged Gaussians",
                "\"the optimisation step\" is all the paper says; Adam is what Gaussian splatting uses",
            ),
            row(
                "rate_mean_beams",
                format!("{} beam widths", self.rate_mean_beams),
                "step of the mean",
            ),
            row(
                "rate_rotation",
                self.rate_rotation,
                "step of the quaternion",
            ),
            row(
                "rate_log_scale",
                self.rate_log_scale,
                "step of the log scale, as Gaussian splatting",
            ),
            row(
                "rate_opacity",
                self.rate_opacity,
                "step of the logit; larger ones overshoot in the first epoch and lose the structure",
            ),
            row(
                "rate_reflectivity",
                self.rate_reflectivity,
                "0: without shadowing only αρ shows in an image, and the map is read off α",
            ),
            row(
                "rate_at_end",
                self.rate_at_end,
                "all steps shrink to this share, as Gaussian splatting's means",
            ),
            row(
                "alignment_rate",
                self.alignment_rate,
                "η of (44), after every step",
            ),
            row("alignment_memory", self.alignment_memory, "β of (45)"),
            row("alignment_decay", self.alignment_decay, "λ_h of (46)"),
            row("epochs", self.epochs, "figure 3 ends at epoch 100"),
            row(
                "shuffle_seed",
                self.shuffle_seed,
                "order of views, new in every epoch",
            ),
        ]
    }

    fn rows_of_pruning_and_map(&self) -> Vec<Choice> {
        vec![
            row(
                "prune_from_epoch",
                self.prune_from_epoch,
                "early: most of the cost lies before it, and the fence ends the same from 2, 4 or 10",
            ),
            row(
                "prune_every_epochs",
                self.prune_every_epochs,
                "no interval printed",
            ),
            row(
                "prune_opacity",
                self.prune_opacity,
                "V-D1 \"below a specified threshold\"",
            ),
            row(
                "prune_distance_beams",
                format!("{} beam widths", self.prune_distance_beams),
                "V-D1 \"distance from the surrounding Gaussians reduces below\": of two so close the less opaque goes",
            ),
            row(
                "density_radius_beams",
                format!("{} beam widths", self.density_radius_beams),
                "r_d of (47)",
            ),
            row(
                "density_least",
                self.density_least,
                "N_min of (48), itself counted as (47) does",
            ),
            row(
                "guard_share",
                self.guard_share,
                "(49) \"high impact scores\": this share of all, by |Σ over the epoch's views of g·α|",
            ),
            row(
                "asserted_opacity",
                self.asserted_opacity,
                "figures show above 0.7 (fence) and 0.2 (truss); one rule for both here",
            ),
        ]
    }
}

fn row(name: &'static str, value: impl std::fmt::Display, why: &'static str) -> Choice {
    Choice {
        name,
        value: value.to_string(),
        why,
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

    #[test]
    fn every_choice_has_its_row() {
        let choices = Choices::default();
        let rows = choices.rows();
        let fields = serde_json::to_value(&choices).unwrap();
        for (name, _) in fields.as_object().unwrap() {
            assert_eq!(
                rows.iter().filter(|row| row.name == name).count(),
                1,
                "{name}"
            );
        }
        assert!(
            rows.iter()
                .all(|row| !row.value.is_empty() && !row.why.is_empty())
        );
    }
}
