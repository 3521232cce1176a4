//! The table of choices: what each is, and why.

use serde::Serialize;

use super::{Choices, Shadowing};

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
                "the paper states no normalisation; one unit for all views keeps their intensities comparable, and the median hears neither a specular return nor the dark views",
            ),
            row(
                "image_power",
                self.image_power,
                "1: linear, as (6) and (8) give it; amplitudes (0.5, active from 0.3) cost twice as much and ended worse on the fence, better on the truss, at the opacity weights tried",
            ),
            row(
                "active_value",
                self.active_value,
                "V-B \"each active sonar pixel\", VI \"intensity thresholding\": no value printed; 10 dB below the unit",
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
                "\"reflectivity proportional to the measured intensity\" before (13): several Gaussians share every pixel at the start; at this factor those that stay end on both sides of the two printed opacities",
            ),
            row(
                "scale_beams",
                format!("{} beam widths", self.scale_beams),
                "no initial scale printed: about one range bin of the fence, a quarter of a beam",
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
                "λ_α of (42), on the view's Gaussians at every step: \"to minimize the number of Gaussians\"; a fiftieth of it left more phantoms above the lower printed opacity on the fence",
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
                "step of the logit; trials with larger steps here and in (44) overshot in the first epochs",
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
                "early: most of the cost lies before it, and the fence ends nearly the same from 2, 4 or 10",
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
