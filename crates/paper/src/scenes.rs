//! Made-up scenes for benches and tests of the paper's renderer: the same for the same seed.

use echosplat_model::glam::{EulerRot, Mat3, Quat, Vec3};

use crate::parameters::{GaussianArrays, Parameters};
use crate::random::Random;
use crate::rendering::PaperView;

/// One image and what is before it.
#[derive(Debug, Clone)]
pub struct PaperScene {
    /// The image's geometry.
    pub view: PaperView,
    /// What it sees.
    pub gaussians: GaussianArrays,
}

impl PaperScene {
    /// All Gaussians, as a subset.
    #[must_use]
    pub fn all(&self) -> Vec<u32> {
        (0..self.gaussians.len() as u32).collect()
    }
}

/// 5,000 Gaussians in one image of 64 beams over 60° and 500 bins of 2 cm from 1 m on; their
/// kernels cover from about 5 × 4 to 20 × 6 pixels (range × azimuth), 50 on the average.
#[must_use]
pub fn paper_scene(seed: u64) -> PaperScene {
    paper_scene_of(seed, 5000)
}

/// [`paper_scene`] with another number of Gaussians.
#[must_use]
pub fn paper_scene_of(seed: u64, count: usize) -> PaperScene {
    let mut noise = Random::new(seed);
    let turn = Quat::from_euler(EulerRot::ZYX, noise.between(-3.0, 3.0), 0.2, -0.1);
    let view = PaperView {
        position_m: Vec3::new(noise.between(-5.0, 5.0), noise.between(-5.0, 5.0), 2.0),
        axes: Mat3::from_quat(turn),
        range_min_m: 1.0,
        range_step_m: 0.02,
        range_bins: 500,
        fov_rad: std::f32::consts::FRAC_PI_3,
        beams: 64,
        least_pixel_variance: 0.3,
    };
    let mut gaussians = GaussianArrays::with_capacity(count);
    for _ in 0..count {
        gaussians.push(in_view(&view, &mut noise));
    }
    PaperScene { view, gaussians }
}

fn in_view(view: &PaperView, noise: &mut Random) -> Parameters {
    let range_m = view.range_min_m + view.range_step_m * noise.between(0.0, view.range_bins as f32);
    let azimuth = noise.between(-0.5, 0.5) * view.fov_rad;
    let elevation = noise.between(-0.4, 0.4);
    let toward = Quat::from_rotation_z(azimuth) * Quat::from_rotation_y(-elevation);
    let mean = view.axes * (toward * (Vec3::X * range_m)) + view.position_m;
    let across_m = range_m * elevation.cos() * view.azimuth_step_rad();
    let scale_m = Vec3::new(
        view.range_step_m * noise.between(0.4, 2.6),
        across_m * noise.between(0.1, 0.6),
        across_m * noise.between(0.1, 0.6),
    );
    let tilt = Quat::from_euler(
        EulerRot::ZYX,
        noise.between(-0.3, 0.3),
        noise.between(-0.3, 0.3),
        noise.between(-3.0, 3.0),
    );
    Parameters {
        mean_m: mean,
        rotation: Quat::from_mat3(&view.axes) * toward * tilt,
        log_scale: scale_m.map(f32::ln),
        opacity_logit: noise.between(-4.0, 1.0),
        reflectivity_log: noise.between(-2.0, 0.0),
    }
}
