//! Sonar images I(r, θ) made of pings: one image per view, beams side by side.

use crate::rendering::PaperView;
use echosplat_model::{PosedPing, Timestamp};
use glam::{DMat3, DQuat, DVec3};

use crate::choices::{ChoiceError, Choices};

/// Beams may lie off the even spacing of (20) by this share of it.
const UNEVEN_SHARE: f64 = 0.3;

/// One measured image and where it was taken.
#[derive(Debug, Clone)]
pub struct Image {
    /// Number of the view.
    pub view: u32,
    /// Pose relative to [`Images::origin_m`], beams and range bins.
    pub geometry: PaperView,
    /// Intensity over [`Images::intensity_unit`], clipped to 1 and raised to the chosen power, 0 to
    /// 1; shape `[beam][range bin]`, beams from right to left.
    pub value: Vec<f32>,
}

/// The paired images and poses that a reconstruction is made of.
#[derive(Debug, Clone)]
pub struct Images {
    /// Added to every position gives the world's: the first view's position.
    pub origin_m: DVec3,
    /// In order of view.
    pub images: Vec<Image>,
    /// The measured intensity that counts as 1: the median over the views of their brightest pixel.
    pub intensity_unit: f32,
    /// Pings that are no beam of an image, left out.
    pub left_out_count: usize,
    /// Transmit time of the newest ping.
    pub time: Timestamp,
    /// Sequence of that ping.
    pub through_ping: u64,
}

/// Why pings make no images.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// A choice out of range.
    #[error(transparent)]
    Choice(#[from] ChoiceError),
    /// None belongs to a view, or all are dark.
    #[error(
        "no image shows anything: of {ping_count} pings, {left_out_count} carry no view number"
    )]
    Nothing {
        /// Pings given.
        ping_count: usize,
        /// Those without a view.
        left_out_count: usize,
    },
    /// Too few beams.
    #[error("view {view} has {beams} beam; an image needs at least 2")]
    OneBeam {
        /// Number of the view.
        view: u32,
        /// Its beams.
        beams: usize,
    },
    /// Beams of one image with different bins.
    #[error("the pings of view {view} have different ranges or numbers of bins")]
    Settings {
        /// Number of the view.
        view: u32,
    },
    /// Beams that (20) cannot index, or two in one direction.
    #[error("the beams of view {view} are not evenly spaced in azimuth about one axis")]
    Uneven {
        /// Number of the view.
        view: u32,
    },
    /// A pose that is not finite.
    #[error("a ping of view {view} has a pose that is not finite")]
    Pose {
        /// Number of the view.
        view: u32,
    },
}

impl Images {
    /// Groups pings by their view and turns each group into an image. The view's pose is found from
    /// its beams: its z is theirs, its x the middle between the outermost beams' axes.
    ///
    /// # Errors
    /// If a choice is out of range, no image shows anything, or the beams of a view are none of one
    /// image.
    pub fn from_pings(pings: &[PosedPing], choices: &Choices) -> Result<Self, ImageError> {
        choices.check()?;
        let mut beams: Vec<(u32, &PosedPing)> = pings
            .iter()
            .filter_map(|ping| Some((ping.ping.view()?, ping)))
            .collect();
        let left_out_count = pings.len() - beams.len();
        let nothing = ImageError::Nothing {
            ping_count: pings.len(),
            left_out_count,
        };
        beams.sort_by_key(|(view, ping)| (*view, ping.ping.sequence()));
        let Some(newest) = beams.iter().map(|b| b.1).max_by_key(|p| p.ping.sequence()) else {
            return Err(nothing);
        };
        let origin_m = beams[0].1.world_from_sensor.translation_m;
        let mut images = beams
            .chunk_by(|a, b| a.0 == b.0)
            .map(|group| image(group, origin_m, choices))
            .collect::<Result<Vec<_>, _>>()?;
        let intensity_unit = median_of_peaks(&images);
        if !(intensity_unit > 0.0) {
            return Err(nothing);
        }
        for value in images.iter_mut().flat_map(|image| &mut image.value) {
            *value = (*value / intensity_unit).min(1.0).powf(choices.image_power);
        }
        Ok(Self {
            origin_m,
            images,
            intensity_unit,
            left_out_count,
            time: newest.ping.transmit_time(),
            through_ping: newest.ping.sequence(),
        })
    }

    /// The first `count` images only.
    pub fn truncate(&mut self, count: usize) {
        self.images.truncate(count);
    }
}

impl Image {
    /// Value of one pixel, which must exist.
    #[inline]
    #[must_use]
    pub fn at(&self, beam: usize, bin: usize) -> f32 {
        self.value[beam * self.geometry.range_bins as usize + bin]
    }
}

/// One view's pings, of which there is at least one.
fn image(
    group: &[(u32, &PosedPing)],
    origin_m: DVec3,
    choices: &Choices,
) -> Result<Image, ImageError> {
    let (view, first) = group[0];
    let settings = *first.ping.settings();
    if group.len() < 2 {
        return Err(ImageError::OneBeam {
            view,
            beams: group.len(),
        });
    }
    let same = |(_, ping): &&(u32, &PosedPing)| {
        let other = ping.ping.settings();
        other.bin_count == settings.bin_count
            && (other.range_start_m - settings.range_start_m).abs() < 1e-6
            && (other.range_length_m - settings.range_length_m).abs() < 1e-6
    };
    if !group.iter().all(|beam| same(&beam)) {
        return Err(ImageError::Settings { view });
    }
    let fan = FanAxes::of(group).ok_or(ImageError::Pose { view })?;
    let order = fan.evenly_spaced().ok_or(ImageError::Uneven { view })?;
    let bin_count = settings.bin_count;
    let mut intensity = Vec::with_capacity(group.len() * bin_count);
    for beam in order {
        intensity.extend_from_slice(group[beam].1.ping.intensity());
    }
    let step_m = settings.bin_length_m();
    Ok(Image {
        view,
        geometry: PaperView {
            position_m: (fan.position_m - origin_m).as_vec3(),
            axes: fan.axes.as_mat3(),
            // (20) counts pixels from the middle of the first.
            range_min_m: settings.bin_center_m(0) as f32,
            range_step_m: step_m as f32,
            range_bins: bin_count as u32,
            fov_rad: fan.width_rad as f32,
            beams: group.len() as u32,
            least_pixel_variance: choices.least_pixel_variance,
        },
        value: intensity,
    })
}

/// A view's frame, found from its beams.
struct FanAxes {
    position_m: DVec3,
    axes: DMat3,
    /// Between the axes of the outermost beams: the FOV of (20).
    width_rad: f64,
    /// Azimuth of each beam in `axes`, in the order given.
    azimuths_rad: Vec<f64>,
}

impl FanAxes {
    /// `None` if a pose is not finite or the beams look in opposite directions.
    fn of(group: &[(u32, &PosedPing)]) -> Option<Self> {
        let beam_axes = |(_, ping): &(u32, &PosedPing)| {
            let turn = DQuat::from_rotation_z(f64::from(ping.ping.beam_azimuth_rad()));
            DMat3::from_quat(ping.world_from_sensor.rotation * turn)
        };
        let axes: Vec<DMat3> = group.iter().map(beam_axes).collect();
        let count = group.len() as f64;
        let position_m = group
            .iter()
            .map(|(_, ping)| ping.world_from_sensor.translation_m)
            .sum::<DVec3>()
            / count;
        let up = axes
            .iter()
            .map(|a| a.z_axis)
            .sum::<DVec3>()
            .try_normalize()?;
        let along = axes.iter().map(|a| a.x_axis).sum::<DVec3>();
        let along = (along - up * along.dot(up)).try_normalize()?;
        let rough = DMat3::from_cols(along, up.cross(along), up);
        let azimuth = |axes: &DMat3| {
            let beam = rough.transpose() * axes.x_axis;
            beam.y.atan2(beam.x)
        };
        let mut azimuths_rad: Vec<f64> = axes.iter().map(azimuth).collect();
        let low = azimuths_rad.iter().copied().fold(f64::INFINITY, f64::min);
        let high = azimuths_rad
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max);
        let middle = 0.5 * (low + high);
        for azimuth in &mut azimuths_rad {
            *azimuth -= middle;
        }
        let fan = Self {
            position_m,
            axes: rough * DMat3::from_rotation_z(middle),
            width_rad: high - low,
            azimuths_rad,
        };
        (fan.position_m.is_finite() && fan.width_rad.is_finite()).then_some(fan)
    }

    /// The beams from right to left; `None` unless they are where (20) has them.
    fn evenly_spaced(&self) -> Option<Vec<usize>> {
        let count = self.azimuths_rad.len();
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| self.azimuths_rad[a].total_cmp(&self.azimuths_rad[b]));
        let step = self.width_rad / (count - 1) as f64;
        let is_there = |(place, &beam): (usize, &usize)| {
            let expected = place as f64 * step - 0.5 * self.width_rad;
            (self.azimuths_rad[beam] - expected).abs() < UNEVEN_SHARE * step
        };
        order.iter().enumerate().all(is_there).then_some(order)
    }
}

/// The brightest pixel of a view, of the middle one when views are sorted by it: neither a single
/// specular return nor the dark views set it.
fn median_of_peaks(images: &[Image]) -> f32 {
    let peak = |image: &Image| image.value.iter().copied().fold(0.0, f32::max);
    let mut peaks: Vec<f32> = images.iter().map(peak).collect();
    peaks.sort_unstable_by(f32::total_cmp);
    peaks.get(peaks.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use echosplat_model::{Ping, PingSettings, Pose, Twist};

    const BEAMS: usize = 8;
    const STEP_RAD: f64 = 0.02;

    fn view_pose() -> Pose {
        Pose::from_yaw_pitch_roll(2.0, 0.3, -0.2, DVec3::new(1e6, -3.0, 5.0))
    }

    /// Beam `beam` lit in bin `beam`, its own pose turned about z by its azimuth.
    fn ping(view: Option<u32>, sequence: u64, beam: usize) -> PosedPing {
        let settings = PingSettings {
            range_start_m: 1.0,
            range_length_m: 4.0,
            bin_count: 20,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 0.0,
            pulse_duration_s: 0.0,
            gain_index: 0,
        };
        let mut intensity = vec![0.0; 20];
        intensity[beam] = 4.0;
        let time = Timestamp::from_secs_f64(sequence as f64);
        let ping = Ping::new(sequence, time, settings, intensity).unwrap();
        let ping = view.map_or(ping.clone(), |view| ping.with_beam(0.0, view));
        let azimuth = (beam as f64 - 3.5) * STEP_RAD;
        PosedPing {
            ping: Arc::new(ping),
            world_from_sensor: view_pose()
                * Pose::from_yaw_pitch_roll(azimuth, 0.0, 0.0, DVec3::ZERO),
            twist: Twist::default(),
            reference_range_m: 0.0,
            uncertainty: None,
            jitter: None,
        }
    }

    fn pings() -> Vec<PosedPing> {
        // Not in the order of azimuth.
        let beams = [3, 1, 0, 2, 7, 6, 4, 5].into_iter().enumerate();
        beams
            .map(|(sequence, beam)| ping(Some(9), sequence as u64, beam))
            .collect()
    }

    #[test]
    fn the_views_pose_and_beams_are_recovered_from_its_pings() {
        let mut all = pings();
        all.push(ping(None, 8, 0));
        let images = Images::from_pings(&all, &Choices::default()).unwrap();
        let [image] = images.images.as_slice() else {
            panic!("one image");
        };
        assert_eq!(
            (image.view, images.left_out_count, images.through_ping),
            (9, 1, 7)
        );
        assert_eq!(images.origin_m, view_pose().translation_m);
        let expected = DMat3::from_quat(view_pose().rotation).as_mat3();
        assert!(image.geometry.axes.abs_diff_eq(expected, 1e-5));
        let step = image.geometry.azimuth_step_rad();
        assert!((f64::from(step) - STEP_RAD).abs() < 1e-6);
        assert!((image.geometry.range_min_m - 1.1).abs() < 1e-6);
        assert!((images.intensity_unit - 4.0).abs() < 1e-6);
        for beam in 0..BEAMS {
            for bin in 0..20 {
                let expected = if beam == bin { 1.0 } else { 0.0 };
                assert!(
                    (image.at(beam, bin) - expected).abs() < 1e-6,
                    "{beam} {bin}"
                );
            }
        }
    }

    #[test]
    fn what_is_no_image_is_refused_by_name() {
        let from =
            |pings: &[PosedPing]| Images::from_pings(pings, &Choices::default()).unwrap_err();
        let none = ImageError::Nothing {
            ping_count: 1,
            left_out_count: 1,
        };
        assert_eq!(from(&[ping(None, 0, 0)]), none);
        assert_eq!(
            from(&pings()[..1]),
            ImageError::OneBeam { view: 9, beams: 1 }
        );
        let mut gap = pings();
        gap.remove(1);
        assert_eq!(from(&gap), ImageError::Uneven { view: 9 });
        let mut broken = pings();
        broken[2].world_from_sensor.translation_m.x = f64::NAN;
        assert_eq!(from(&broken), ImageError::Pose { view: 9 });
    }
}
