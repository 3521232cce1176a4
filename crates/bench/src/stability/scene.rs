//! One ping and what it sees, rendered three times: by the program's kernels, by the plain twin in
//! f64, and by the same twin in f32.

use echosplat_acoustics::online::{OnlineOptions, OnlineRenderer};
use echosplat_acoustics::reference::online::{Cutoffs, backward, forward, numbers_of};
use echosplat_acoustics::{
    Beam, GaussianArrays, GradientArrays, PARAMETER_COUNT, Parameters, PingGeometry, PingPose, Real,
};
use glam::{Mat3, Quat, Vec3};

use crate::draw::Draw;

/// Gradient or value of one Gaussian's parameters.
pub(super) type Numbers<R> = [R; PARAMETER_COUNT];

/// A ping without its measurement.
#[derive(Debug, Clone)]
pub(super) struct Scene {
    pub(super) geometry: PingGeometry,
    pub(super) gaussians: GaussianArrays,
    pub(super) occlusion: bool,
}

/// At the origin, looking along x: 600 bins of 2 cm.
pub(super) fn geometry() -> PingGeometry {
    PingGeometry {
        pose: PingPose {
            position_m: Vec3::ZERO,
            axes: Mat3::IDENTITY,
            drift_per_m: Vec3::ZERO,
            reference_range_m: 6.0,
        },
        range_start_m: 0.0,
        bin_length_m: 0.02,
        bin_count: 600,
        range_variance_m2: 1e-4,
        azimuth_variance_rad2: 0.0,
        beam: Beam::default(),
    }
}

/// A Gaussian that is nothing special, at a place in the beam.
pub(super) fn plain(mean_m: Vec3) -> Parameters {
    Parameters {
        mean_m,
        rotation: Quat::IDENTITY,
        log_scale: Vec3::splat(-3.0),
        opacity_logit: 0.5,
        reflectivity_log: -0.5,
    }
}

/// A Gaussian like those of a map, somewhere in the beam.
pub(super) fn usual(draw: &mut Draw) -> Parameters {
    let range_m = draw.between(2.0, 9.0);
    Parameters {
        mean_m: Vec3::new(
            range_m,
            0.01 * range_m * draw.between(-1.0, 1.0),
            0.25 * range_m * draw.between(-1.0, 1.0),
        ),
        rotation: draw.rotation(),
        log_scale: Vec3::from_array(std::array::from_fn(|_| draw.between(-4.5, -1.5))),
        opacity_logit: draw.between(-2.0, 2.0),
        reflectivity_log: draw.between(-2.0, 0.0),
    }
}

impl Scene {
    pub(super) fn new(occlusion: bool) -> Self {
        Self {
            geometry: geometry(),
            gaussians: GaussianArrays::new(),
            occlusion,
        }
    }

    /// Of [`usual`] Gaussians.
    pub(super) fn random(draw: &mut Draw, count: usize, occlusion: bool) -> Self {
        let mut scene = Self::new(occlusion);
        scene.geometry.pose.drift_per_m = 1e-4 * draw.cube();
        for _ in 0..count {
            scene.gaussians.push(usual(draw));
        }
        scene
    }

    pub(super) fn with(mut self, gaussian: Parameters) -> Self {
        self.gaussians.push(gaussian);
        self
    }

    fn visible(&self) -> Vec<u32> {
        (0..self.gaussians.len() as u32).collect()
    }

    fn renderer(&self) -> OnlineRenderer {
        OnlineRenderer::new(OnlineOptions {
            occlusion: self.occlusion,
        })
    }

    /// Intensity per bin by the program.
    pub(super) fn program(&self) -> Vec<f32> {
        let mut renderer = self.renderer();
        renderer
            .forward(&self.geometry, &self.gaussians, &self.visible())
            .to_vec()
    }

    /// By the twin, with the program's cut-offs.
    pub(super) fn twin<R: Real>(&self) -> Vec<R> {
        self.twin_of(&numbers_of(&self.gaussians), &Cutoffs::default())
    }

    /// By the twin, of these numbers in place of the scene's.
    pub(super) fn twin_of<R: Real>(&self, numbers: &[Numbers<R>], cutoffs: &Cutoffs) -> Vec<R> {
        let visible = self.visible();
        forward(&self.geometry, numbers, &visible, self.occlusion, cutoffs).intensity
    }

    /// dL/d(parameters) of every Gaussian by the program, given dL/d(intensity).
    pub(super) fn program_gradient(&self, d_intensity: &[f32]) -> Vec<Numbers<f32>> {
        let mut renderer = self.renderer();
        let _ = renderer.forward(&self.geometry, &self.gaussians, &self.visible());
        let mut gradients = GradientArrays::zeros(self.gaussians.len());
        renderer.backward(&self.gaussians, d_intensity, &mut gradients);
        (0..gradients.len()).map(|i| gradients.get(i)).collect()
    }

    /// The same by the twin.
    pub(super) fn twin_gradient<R: Real>(
        &self,
        d_intensity: &[f32],
        cutoffs: &Cutoffs,
    ) -> Vec<Numbers<R>> {
        let numbers = numbers_of(&self.gaussians);
        let visible = self.visible();
        let rendering = forward(&self.geometry, &numbers, &visible, self.occlusion, cutoffs);
        let d: Vec<R> = d_intensity.iter().map(|&d| R::of_f32(d)).collect();
        backward(&self.geometry, &numbers, &rendering, &d)
    }

    /// A loss's slope by intensity: of both signs, the same for the same draw.
    pub(super) fn slope(&self, draw: &mut Draw) -> Vec<f32> {
        (0..self.geometry.bin_count)
            .map(|_| draw.between(-1.0, 1.0))
            .collect()
    }
}
