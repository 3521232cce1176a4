//! What a map says that a ping measures, from anywhere.

use echosplat_acoustics::{
    GaussianArrays, OnlineOptions, OnlineRenderer, PingGeometry, SpatialIndex,
};
use echosplat_model::Gaussian;
use glam::DVec3;

/// A map made ready for rendering pings by the `online` measurement.
pub struct MapRenderer {
    /// Of its own coordinates: amid the map, so that single precision resolves ranges as finely
    /// kilometres from the map's origin as beside it.
    origin_m: DVec3,
    intensity_unit: f32,
    gaussians: GaussianArrays,
    index: SpatialIndex,
    renderer: OnlineRenderer,
    visible: Vec<u32>,
    intensity: Vec<f32>,
}

impl MapRenderer {
    /// Of Gaussians relative to `origin_m`, confident and ambiguous alike: together they explain
    /// the echoes. `intensity_unit` is intensity per steradian that αρ = 1 sends back. Gaussians
    /// that are not finite are left out.
    #[must_use]
    pub fn new(
        origin_m: DVec3,
        intensity_unit: f32,
        gaussians: &[Gaussian],
        occlusion: bool,
    ) -> Self {
        let sound = gaussians.iter().filter(|gaussian| gaussian.is_sound());
        let mut sound: Vec<Gaussian> = sound.copied().collect();
        let amid_m = sound.first().map_or(DVec3::ZERO, |g| g.mean_m.as_dvec3());
        for gaussian in &mut sound {
            gaussian.mean_m = (gaussian.mean_m.as_dvec3() - amid_m).as_vec3();
        }
        let gaussians = GaussianArrays::from_gaussians(&sound);
        Self {
            origin_m: origin_m + amid_m,
            intensity_unit,
            index: SpatialIndex::new(&gaussians),
            gaussians,
            renderer: OnlineRenderer::new(OnlineOptions { occlusion }),
            visible: Vec::new(),
            intensity: Vec::new(),
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
        self.index.visible(geometry, &mut self.visible);
        let rendered = self
            .renderer
            .forward(geometry, &self.gaussians, &self.visible);
        let unit = self.intensity_unit;
        self.intensity.clear();
        self.intensity
            .extend(rendered.iter().map(|energy| energy * unit));
        &self.intensity
    }
}
