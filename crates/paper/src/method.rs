//! The method in the paper's order.

use crate::parameters::{GaussianArrays, GradientArrays, opacity_of, opacity_slope};
use crate::rendering::PaperRenderer;
use crate::retain::retain;
use echosplat_model::{Gaussian, GaussianId, Snapshot};
use glam::Vec3;

use crate::adam::{Adam, Rates};
use crate::alignment::Alignment;
use crate::asserted;
use crate::candidates::{self, CandidateCounts};
use crate::elevation_ray::{ElevationRays, RayView};
use crate::images::Images;
use crate::pruning::{Prunable, Pruned, prune};
use crate::random::Random;
use crate::start::{self, logit};
use crate::tags::ViewTags;
use crate::{Choices, loss, regularisers};

/// What one epoch did.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct EpochReport {
    /// Epochs run, this one included.
    pub epoch: u32,
    /// (32): summed over the views, each at the moment before its step.
    pub loss: f64,
    /// The same of a map of nothing.
    pub loss_of_nothing: f64,
    /// (41) without its weight `λ_elev`, mean over the views.
    pub elevation_loss: f64,
    /// `λ_α ‖α‖² + λ_s ‖S‖²` of (42), mean over the views.
    pub size_loss: f64,
    /// Gaussians at its end.
    pub gaussians: usize,
    /// Those the map asserts.
    pub asserted: usize,
    /// Gaussian–pixel pairs rendered; each is gone through once forward and once backward.
    pub pairs: u64,
    /// What was let go at its end.
    pub pruned: Pruned,
    /// Gaussians whose gradient was not finite and taken as 0.
    pub non_finite: usize,
}

/// A reconstruction under way. The same images and choices give the same bits at any thread count.
pub struct PaperMethod {
    images: Images,
    choices: Choices,
    beam_width_m: f32,
    counts: CandidateCounts,
    gaussians: GaussianArrays,
    ids: Vec<GaussianId>,
    tags: ViewTags,
    /// Views of each row of `tags`: `n_k` of (35).
    view_counts: Vec<u32>,
    gradients: GradientArrays,
    adam: Adam,
    alignment: Alignment,
    /// `∂L_recon/∂α · α` of (49), summed over the views of an epoch.
    impact: Vec<f32>,
    renderer: PaperRenderer,
    rays: ElevationRays,
    order: Random,
    loss_of_nothing: f64,
    epoch: u32,
    pairs: u64,
    buffers: Buffers,
}

/// Reused from view to view.
#[derive(Debug, Default)]
struct Buffers {
    subset: Vec<u32>,
    d_image: Vec<f32>,
    /// `g_i` of (43), in the order of `subset`.
    opacity_gradient: Vec<f32>,
}

impl PaperMethod {
    /// (11) to (13): from images to the first Gaussians. Uses rayon's current pool. Choices that fail
    /// [`Choices::check`] make no usable map.
    #[must_use]
    pub fn new(images: Images, choices: Choices) -> Self {
        let beam_width_m = candidates::beam_width_m(&images, &choices);
        let (found, counts) = candidates::find(&images, beam_width_m, &choices);
        let gaussians = start::gaussians(&found, beam_width_m, &choices);
        let count = gaussians.len();
        Self {
            beam_width_m,
            counts,
            gaussians,
            ids: (0..count as GaussianId).collect(),
            view_counts: (0..count).map(|row| found.tags.count(row)).collect(),
            tags: found.tags,
            gradients: GradientArrays::zeros(count),
            adam: Adam::new(count),
            alignment: Alignment::new(count),
            impact: vec![0.0; count],
            renderer: PaperRenderer::parallel(),
            rays: ElevationRays::default(),
            order: Random::new(choices.shuffle_seed),
            loss_of_nothing: images
                .images
                .iter()
                .map(|i| loss::of_nothing(&i.value))
                .sum(),
            epoch: 0,
            pairs: 0,
            buffers: Buffers::default(),
            images,
            choices,
        }
    }

    /// One step per view (31), in an order of its own for every epoch, then pruning if it is due.
    pub fn run_epoch(&mut self) -> EpochReport {
        let view_count = self.images.images.len();
        let mut views: Vec<usize> = (0..view_count).collect();
        self.order.shuffle(&mut views);
        self.impact.fill(0.0);
        let mut report = EpochReport::default();
        for view in views {
            self.step(view, &mut report);
        }
        self.epoch += 1;
        if self.is_pruning_due() {
            report.pruned = self.prune();
        }
        report.epoch = self.epoch;
        report.loss_of_nothing = self.loss_of_nothing;
        report.elevation_loss /= view_count.max(1) as f64;
        report.size_loss /= view_count.max(1) as f64;
        report.gaussians = self.gaussians.len();
        report.asserted = asserted::count(&self.gaussians, self.choices.asserted_opacity);
        self.pairs += report.pairs;
        report
    }

    /// Whether all epochs of a whole run are done.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.epoch >= self.choices.epochs
    }

    /// What the map asserts, relative to the images' origin, in order of id.
    #[must_use]
    pub fn gaussians(&self) -> Vec<Gaussian> {
        self.gaussians_above(self.choices.asserted_opacity)
    }

    /// The Gaussians more opaque than a threshold of the caller's.
    #[must_use]
    pub fn gaussians_above(&self, least_opacity: f32) -> Vec<Gaussian> {
        asserted::asserted(&self.gaussians, &self.ids, least_opacity)
    }

    /// The same as a map. Its unit is the images': what a pixel shows of αρ = 1, not what one
    /// steradian sends back.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            epoch: 0,
            sequence: u64::from(self.epoch),
            time: self.images.time,
            through_ping: self.images.through_ping,
            origin_m: self.images.origin_m,
            intensity_unit: self.images.intensity_unit,
            gaussians: self.gaussians(),
        }
    }

    /// How many candidates there were.
    #[must_use]
    pub fn candidate_counts(&self) -> CandidateCounts {
        self.counts
    }

    /// The length that the choices in beam widths are measured by.
    #[must_use]
    pub fn beam_width_m(&self) -> f32 {
        self.beam_width_m
    }

    /// Gaussian–pixel pairs of all epochs so far.
    #[must_use]
    pub fn pair_count(&self) -> u64 {
        self.pairs
    }

    /// Gaussians now, asserted or not.
    #[must_use]
    pub fn gaussian_count(&self) -> usize {
        self.gaussians.len()
    }

    /// The images it is made of.
    #[must_use]
    pub fn images(&self) -> &Images {
        &self.images
    }

    /// The choices it runs by.
    #[must_use]
    pub fn choices(&self) -> &Choices {
        &self.choices
    }

    /// One view: render its Gaussians, (32), (42), Adam, then (43) to (46).
    fn step(&mut self, view: usize, report: &mut EpochReport) {
        self.buffers.subset.clear();
        self.tags.rows_of(view, &mut self.buffers.subset);
        self.reconstruct(view, report);
        self.note_opacity_gradients();
        self.regularise(view, report);
        report.non_finite += self.adam.step(
            &self.buffers.subset,
            &self.rates(),
            &mut self.gaussians,
            &mut self.gradients,
        );
        self.align_opacities();
        self.keep_in_limits();
    }

    /// (14) to (32) and the gradient.
    fn reconstruct(&mut self, view: usize, report: &mut EpochReport) {
        let image = &self.images.images[view];
        let Buffers {
            subset, d_image, ..
        } = &mut self.buffers;
        let shadowing = self.choices.shadowing.into();
        let predicted = self
            .renderer
            .forward(&image.geometry, &self.gaussians, subset, shadowing);
        report.loss += loss::l1(predicted, &image.value, d_image);
        report.pairs += self.renderer.pair_count();
        self.renderer
            .backward(&self.gaussians, d_image, &mut self.gradients);
    }

    /// (43) and the sum of (49), before regularisers add to the gradients.
    fn note_opacity_gradients(&mut self) {
        self.buffers.opacity_gradient.clear();
        for &index in &self.buffers.subset {
            let index = index as usize;
            let logit = self.gaussians.opacity_logit[index];
            let gradient = self.gradients.opacity_logit[index] / opacity_slope(logit).max(1e-6);
            self.buffers.opacity_gradient.push(gradient);
            self.impact[index] += gradient * opacity_of(logit);
        }
    }

    /// (42) beside the reconstruction.
    fn regularise(&mut self, view: usize, report: &mut EpochReport) {
        let subset = &self.buffers.subset;
        report.size_loss += regularisers::add(
            &self.gaussians,
            subset,
            self.beam_width_m,
            &self.choices,
            &mut self.gradients,
        );
        let view = RayView {
            image: &self.images.images[view],
            view_counts: &self.view_counts,
            choices: &self.choices,
        };
        report.elevation_loss += self
            .rays
            .add(view, &self.gaussians, subset, &mut self.gradients);
    }

    fn rates(&self) -> Rates {
        let choices = &self.choices;
        let done = self.epoch as f32 / choices.epochs.max(1) as f32;
        let shrunk = choices.rate_at_end.powf(done.min(1.0));
        Rates {
            mean_m: shrunk * choices.rate_mean_beams * self.beam_width_m,
            rotation: shrunk * choices.rate_rotation,
            log_scale: shrunk * choices.rate_log_scale,
            opacity_logit: shrunk * choices.rate_opacity,
            reflectivity_log: shrunk * choices.rate_reflectivity,
        }
    }

    /// (44) to (46), after the step.
    fn align_opacities(&mut self) {
        let gradients = self
            .buffers
            .subset
            .iter()
            .zip(&self.buffers.opacity_gradient);
        for (&index, &gradient) in gradients {
            let index = index as usize;
            let opacity = opacity_of(self.gaussians.opacity_logit[index]);
            let aligned = self
                .alignment
                .aligned(index, opacity, gradient, &self.choices);
            self.gaussians.opacity_logit[index] = logit(aligned);
        }
    }

    /// Scales within their limits, quaternions of length 1.
    fn keep_in_limits(&mut self) {
        let limits = self.choices.scale_limits_beams;
        let [low, high] = limits.map(|beams| (beams * self.beam_width_m).ln());
        for &index in &self.buffers.subset {
            let index = index as usize;
            for field in &mut self.gaussians.log_scale {
                field[index] = field[index].max(low).min(high);
            }
            let fields = &mut self.gaussians.rotation;
            let length2: f32 = fields.iter().map(|field| field[index] * field[index]).sum();
            let scale = if length2 > 1e-12 {
                length2.sqrt().recip()
            } else {
                1.0
            };
            fields.iter_mut().for_each(|field| field[index] *= scale);
        }
    }

    fn is_pruning_due(&self) -> bool {
        let since = self.epoch.checked_sub(self.choices.prune_from_epoch);
        since.is_some_and(|since| since.is_multiple_of(self.choices.prune_every_epochs.max(1)))
    }

    fn prune(&mut self) -> Pruned {
        let [x, y, z] = &self.gaussians.mean_m;
        let means = x.iter().zip(y).zip(z);
        let mean_m: Vec<Vec3> = means.map(|((x, y), z)| Vec3::new(*x, *y, *z)).collect();
        let logits = self.gaussians.opacity_logit.iter();
        let opacity: Vec<f32> = logits.map(|logit| opacity_of(*logit)).collect();
        let impact: Vec<f32> = self.impact.iter().map(|sum| sum.abs()).collect();
        let all = Prunable {
            mean_m: &mean_m,
            opacity: &opacity,
            impact: &impact,
        };
        let (keep, pruned) = prune(&all, self.beam_width_m, &self.choices);
        self.retain(&keep);
        pruned
    }

    fn retain(&mut self, keep: &[bool]) {
        self.gaussians.retain(keep);
        self.tags.retain(keep);
        self.adam.retain(keep);
        self.alignment.retain(keep);
        retain(&mut self.ids, keep);
        retain(&mut self.view_counts, keep);
        self.gradients = GradientArrays::zeros(self.gaussians.len());
        self.impact = vec![0.0; self.gaussians.len()];
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, LazyLock};

    use super::*;
    use crate::Shadowing;
    use echosplat_model::PosedPing;
    use echosplat_simulator::{Dive, DiveKind, NoiseLevel, Scene, SimulatedSonar};

    const SPHERE: &str = "name = \"sphere\"\n\
        [viewpoints]\ncount = 12\nstandoff_m = 3\n\
        [[sphere]]\ncenter_m = [0, 0, 0]\nradius_m = 0.3\n";

    static IMAGES: LazyLock<Images> = LazyLock::new(|| {
        let scene = Arc::new(Scene::parse(SPHERE, None).unwrap());
        let dive = Dive::plan(DiveKind::Viewpoints, &scene, NoiseLevel::None, 1).unwrap();
        let dive = Arc::new(dive);
        let sonar = SimulatedSonar::new(scene, dive.clone(), NoiseLevel::None, 1);
        let trajectory = dive.trajectory(0.5);
        let ping = |index| sonar.posed_ping(index, &trajectory);
        let pings: Vec<PosedPing> = (0..dive.pings()).filter_map(ping).collect();
        Images::from_pings(&pings, &Choices::default()).unwrap()
    });

    /// Few epochs, so larger steps.
    fn choices() -> Choices {
        Choices {
            epochs: 30,
            support_views: 6,
            rate_opacity: 0.1,
            alignment_rate: 0.02,
            ..Choices::default()
        }
    }

    fn run(threads: usize, epochs: usize) -> (PaperMethod, Vec<EpochReport>) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| {
            let mut method = PaperMethod::new(IMAGES.clone(), choices());
            let reports = (0..epochs).map(|_| method.run_epoch()).collect();
            (method, reports)
        })
    }

    #[test]
    fn twelve_views_of_a_sphere_become_a_sphere() {
        let (method, reports) = run(2, 30);
        let (first, last) = (reports[0], reports[29]);
        assert!(
            last.loss < 0.8 * first.loss,
            "{} to {}",
            first.loss,
            last.loss
        );
        assert!(
            last.loss < 0.8 * last.loss_of_nothing,
            "{} {}",
            last.loss,
            last.loss_of_nothing
        );
        assert!(method.is_done() && last.pairs > 0 && last.non_finite == 0);
        assert_eq!(
            method.pair_count(),
            reports.iter().map(|r| r.pairs).sum::<u64>()
        );

        let snapshot = method.snapshot();
        assert_eq!(snapshot.gaussians.len(), last.asserted);
        let near_share = |gaussians: &[Gaussian]| {
            let off_m = |g: &&Gaussian| {
                ((snapshot.origin_m + g.mean_m.as_dvec3()).length() - 0.3).abs() < 0.1
            };
            let near = gaussians.iter().filter(off_m).count();
            (near, near as f64 / gaussians.len() as f64)
        };
        let (_, at_first) = near_share(&run(1, 0).0.gaussians_above(0.0));
        let (near, share) = near_share(&snapshot.gaussians);
        assert!(
            near > 50 && share > 0.75 && share > at_first + 0.1,
            "{near}: {at_first} to {share}"
        );
        assert!(snapshot.gaussians.iter().is_sorted_by_key(|g| g.id));
    }

    #[test]
    fn all_of_the_papers_renderers_train() {
        let losses = [Shadowing::Averaged, Shadowing::Exact, Shadowing::Off].map(|shadowing| {
            let choices = Choices {
                shadowing,
                ..choices()
            };
            let mut method = PaperMethod::new(IMAGES.clone(), choices);
            let (first, second) = (method.run_epoch(), method.run_epoch());
            assert!(second.loss < first.loss, "{shadowing:?}");
            second.loss
        });
        assert!(losses[0] < losses[1] && losses[0] < losses[2], "{losses:?}");
    }

    #[test]
    fn one_thread_or_two_give_the_same_bits() {
        let ((one, first), (two, second)) = (run(1, 12), run(2, 12));
        assert_eq!(first, second);
        assert!(first[11].pruned.by_opacity + first[9].pruned.by_opacity > 0);
        let bits = |method: &PaperMethod| -> Vec<u32> {
            let fields = method.gaussians.fields().into_iter().flatten();
            fields.map(|value| value.to_bits()).collect()
        };
        assert_eq!(bits(&one), bits(&two));
        assert_eq!(one.ids, two.ids);
    }
}
