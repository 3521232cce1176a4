//! Small scenes for tests.

use crate::parameters::{GaussianArrays, Parameters};
use crate::rendering::PaperView;
use echosplat_model::Timestamp;
use glam::{DVec3, Mat3, Quat, Vec3};

use crate::images::{Image, Images};

/// Looks along x from 4 m before the origin and a little aside by `view`; 33 beams over 40°, 160 bins
/// of 3 cm from 2 m; lit where asked.
pub(crate) fn image(view: u32, is_lit: impl Fn(usize, usize) -> bool) -> Image {
    let geometry = PaperView {
        position_m: Vec3::new(-4.0, 0.0, 0.01 * view as f32),
        axes: Mat3::from_rotation_z(0.0),
        range_min_m: 2.0,
        range_step_m: 0.03,
        range_bins: 160,
        fov_rad: 40f32.to_radians(),
        beams: 33,
        least_pixel_variance: 0.3,
    };
    let value = (0..33 * 160).map(|at| f32::from(u8::from(is_lit(at / 160, at % 160))));
    Image {
        view,
        geometry,
        value: value.collect(),
    }
}

pub(crate) fn images(images: Vec<Image>) -> Images {
    Images {
        origin_m: DVec3::ZERO,
        images,
        intensity_unit: 1.0,
        left_out_count: 0,
        time: Timestamp::ZERO,
        through_ping: 0,
    }
}

/// Different from one another in everything.
pub(crate) fn gaussians(count: usize) -> GaussianArrays {
    let mut arrays = GaussianArrays::new();
    for index in 0..count {
        let t = index as f32;
        arrays.push(Parameters {
            mean_m: Vec3::new(0.3 * t.sin(), 0.4 * (1.7 * t).cos(), 0.2 * (2.3 * t).sin()),
            rotation: Quat::from_rotation_x(0.3 * t),
            log_scale: Vec3::new(-3.0 + 0.1 * t, -2.5, -2.8),
            opacity_logit: 0.4 * t - 1.0,
            reflectivity_log: -0.5,
        });
    }
    arrays
}
