//! One ping and what is before it: heard by the program's kernels, and by the plain twin in f64.

use echosplat_measurement::heard::Detail;
use echosplat_measurement::lanes::Level;
use echosplat_measurement::twin::Twin;
use echosplat_measurement::{
    Beam, Element, Listener, PingGeometry, PingPose, Scene, SymmetricMat3, simd_level,
};
use glam::{Mat3, Quat, Vec3};

use crate::draw::Draw;

/// Power per bin that echoes are told from.
pub(crate) const NOISE: f32 = 1e-6;
/// One sigma of a Gaussian that is nothing special, metres.
const SIGMA_M: f32 = 0.03;

/// A ping without its measurement.
#[derive(Debug, Clone)]
pub(crate) struct Trial {
    pub(crate) geometry: PingGeometry,
    pub(crate) elements: Vec<Element>,
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

/// A round Gaussian that is nothing special.
pub(super) fn plain(mean_m: Vec3) -> Element {
    Element::even(mean_m, SymmetricMat3::isotropic(SIGMA_M), 1.0)
}

/// One with a shape.
pub(super) fn shaped(mean_m: Vec3, rotation: Quat, scale_m: Vec3) -> Element {
    let scaled = Mat3::from_quat(rotation) * Mat3::from_diagonal(scale_m);
    Element::even(mean_m, SymmetricMat3::of(scaled * scaled.transpose()), 1.0)
}

/// One like those of a map, somewhere in the beam.
pub(super) fn usual(draw: &mut Draw) -> Element {
    let range_m = draw.between(2.0, 9.0);
    let (y, z) = (draw.between(-0.01, 0.01), draw.between(-0.25, 0.25));
    let mean_m = range_m * Vec3::new(1.0, y, z);
    let scale_m = Vec3::from_array(std::array::from_fn(|_| draw.between(0.01, 0.1)));
    Element {
        ahead: (2.0 * draw.cube()).exp(),
        behind: (2.0 * draw.cube()).exp(),
        ..shaped(mean_m, draw.rotation(), scale_m)
    }
}

impl Trial {
    pub(super) fn of(elements: Vec<Element>) -> Self {
        Self {
            geometry: geometry(),
            elements,
        }
    }

    /// Of [`usual`] Gaussians.
    pub(crate) fn random(draw: &mut Draw, count: usize) -> Self {
        let mut trial = Self::of((0..count).map(|_| usual(draw)).collect());
        trial.geometry.pose.drift_per_m = 1e-4 * draw.cube();
        trial
    }

    pub(crate) fn twin(&self) -> Twin {
        Twin::of(&self.geometry, &self.elements)
    }

    pub(crate) fn listener(&self, level: Level) -> (Listener, Vec<f32>) {
        let mut listener = Listener::with_level(level);
        let scene = Scene::of(&self.elements);
        let heard = listener.hear(&scene, &self.geometry, NOISE, Detail::Full);
        let heard = heard.to_vec();
        (listener, heard)
    }

    /// Power per bin, noise included, by the program.
    pub(super) fn program(&self) -> Vec<f32> {
        self.listener(simd_level::level()).1
    }
}
