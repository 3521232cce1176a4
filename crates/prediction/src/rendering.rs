//! What a map says that a ping measures, from anywhere.

use echosplat_measurement::heard::Detail;
use echosplat_measurement::{Element, Listener, PingGeometry, Scene, SymmetricMat3};
use echosplat_model::Gaussian;
use glam::DVec3;

/// A map made ready for rendering pings, by the model that it is made with: nothing hides anything.
pub struct MapRenderer {
    /// Of its own coordinates: amid the map, so that single precision resolves ranges as finely
    /// kilometres from the map's origin as beside it.
    origin_m: DVec3,
    scene: Scene,
    listener: Listener,
}

impl MapRenderer {
    /// Of Gaussians relative to `origin_m`, confident and ambiguous alike: together they explain
    /// the echoes. `intensity_unit` is intensity per steradian that αρ = 1 sends back. Gaussians
    /// that are not finite are left out.
    #[must_use]
    pub fn new(origin_m: DVec3, intensity_unit: f32, gaussians: &[Gaussian]) -> Self {
        let sound = gaussians.iter().filter(|gaussian| gaussian.is_sound());
        let amid_m = sound.clone().next();
        let amid_m = amid_m.map_or(DVec3::ZERO, |gaussian| gaussian.mean_m.as_dvec3());
        let element = |gaussian: &Gaussian| {
            let mean_m = (gaussian.mean_m.as_dvec3() - amid_m).as_vec3();
            let strength = gaussian.opacity * gaussian.reflectivity * intensity_unit;
            Element::even(mean_m, covariance_m2(gaussian), strength)
        };
        let elements: Vec<Element> = sound.map(element).collect();
        Self {
            origin_m: origin_m + amid_m,
            scene: Scene::of(&elements),
            listener: Listener::default(),
        }
    }

    /// Ping geometries are relative to this, world coordinates.
    #[must_use]
    pub fn origin_m(&self) -> DVec3 {
        self.origin_m
    }

    /// Intensity per bin without noise in the unit of the pings that the map was made of, shape
    /// `[bin_count]`.
    pub fn ping(&mut self, geometry: &PingGeometry) -> &[f32] {
        self.listener
            .hear(&self.scene, geometry, 0.0, Detail::Strength)
    }
}

/// Exactly round where the Gaussian is.
fn covariance_m2(gaussian: &Gaussian) -> SymmetricMat3 {
    let scale_m = gaussian.scale_m;
    match scale_m.min_element().to_bits() == scale_m.max_element().to_bits() {
        true => SymmetricMat3::isotropic(scale_m.x),
        false => SymmetricMat3::of(gaussian.covariance_m2()),
    }
}
