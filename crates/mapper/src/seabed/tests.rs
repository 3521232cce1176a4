use super::*;
use echosplat_measurement::PingPose;
use echosplat_model::glam::Mat3;
use echosplat_model::{Ping, PingSettings, Timestamp};

use crate::MapperConfig;
use crate::detect::profile::Levels;

const BINS: usize = 600;
const BIN_M: f32 = 0.0167;
const NOISE: f32 = 1.0;
const BRIGHTNESS: f32 = 5000.0;

fn geometry(height_m: f32, x_m: f32) -> PingGeometry {
    PingGeometry {
        pose: PingPose {
            position_m: Vec3::new(x_m, 0.0, height_m),
            axes: Mat3::IDENTITY,
            drift_per_m: Vec3::ZERO,
            reference_range_m: 5.0,
        },
        range_start_m: 0.0,
        bin_length_m: BIN_M,
        bin_count: BINS as u32,
        range_variance_m2: 1e-4,
        azimuth_variance_rad2: 0.0,
        beam: Beam::default(),
    }
}

/// Exponential noise at its own quantiles, shuffled by a stride that differs from ping to ping.
fn speckle(bin: usize, ping: usize) -> f32 {
    let quantile = ((bin * 997 + ping * 131) % BINS) as f32 + 0.5;
    -(1.0 - quantile / BINS as f32).ln()
}

/// What a ping `height_m` above flat ground at z = 0 holds, by `dφ/dr` of `sin φ = h/r`.
fn ground(height_m: f32, bin: usize) -> f32 {
    let elevation = |range_m: f32| -(height_m / range_m).min(1.0).asin();
    let (near, far) = (bin as f32 * BIN_M, (bin + 1) as f32 * BIN_M);
    let middle = elevation(0.5 * (near + far));
    let turned = elevation(far) - elevation(near.max(1e-3));
    BRIGHTNESS * Beam::default().elevation_weight(middle) * turned
}

fn heard(levels: &mut Levels, index: usize, power: impl Fn(usize) -> f32) -> (Vec<f32>, Profile) {
    let settings = PingSettings {
        range_start_m: 0.0,
        range_length_m: f64::from(BIN_M) * BINS as f64,
        bin_count: BINS,
        speed_of_sound_mps: 1500.0,
        frequency_hz: 450e3,
        pulse_duration_s: 2e-5,
        gain_index: 0,
    };
    let power = |bin| (NOISE + power(bin)) * speckle(bin, index);
    let intensity: Vec<f32> = (0..BINS).map(power).collect();
    let ping = Ping::new(index as u64, Timestamp::ZERO, settings, intensity.clone()).unwrap();
    let config = MapperConfig::default();
    let profile = levels.profile(&ping, 0.04, &Backdrop::default(), Box::default(), &config);
    (intensity, profile)
}

/// A vehicle that goes ahead while it heaves between 1.5 and 2.5 m.
fn dive(power: impl Fn(f32, usize) -> f32) -> Seabed {
    dive_with(Seabed::new(&Beam::default(), Switch::Auto), power)
}

fn dive_with(seabed: Seabed, power: impl Fn(f32, usize) -> f32) -> Seabed {
    dive_ringing(seabed, 0.0, power)
}

/// The same of a unit that is known to ring for so long.
fn dive_ringing(mut seabed: Seabed, until_m: f64, power: impl Fn(f32, usize) -> f32) -> Seabed {
    let mut levels = Levels::default();
    for index in 0..400 {
        let height_m = 2.0 + 0.5 * (0.05 * index as f32).sin();
        // The noise floor is heard before the ground is.
        let quiet = index < 40;
        let (intensity, mut profile) = heard(&mut levels, index, |bin| match quiet {
            true => 0.0,
            false => power(height_m, bin),
        });
        profile.ring_until(until_m);
        let geometry = geometry(height_m, 0.005 * index as f32);
        seabed.listen(&geometry, &intensity, &profile);
    }
    seabed
}

#[test]
fn flat_ground_is_found_at_its_height_and_explains_its_echoes() {
    let seabed = dive(ground);
    assert!(seabed.is_there());
    let published = seabed.published(BRIGHTNESS * 1e4);
    assert!(!published.is_empty());
    for gaussian in &published {
        assert!(gaussian.mean_m.z.abs() < 0.1, "{}", gaussian.mean_m);
        assert!((gaussian.rotation * Vec3::Z).z > 0.95);
    }
    let backdrop = seabed.backdrop(&geometry(2.0, 1.0), 0.0);
    for bin in [330, 400, 500] {
        let ratio = backdrop.expected[bin] / ground(2.0, bin);
        assert!((0.6..1.6).contains(&ratio), "bin {bin}: {ratio}");
    }
    assert!(backdrop.most[200] <= 0.0);
    assert!(seabed.hides(Vec3::new(1.0, 4.0, -0.6)) && !seabed.hides(Vec3::new(1.0, 4.0, 0.2)));
}

#[test]
fn ground_is_found_beyond_what_is_known_to_ring() {
    let ringing = |bin: usize| 300.0 * (-(bin as f32) * BIN_M / 0.4).exp();
    let power = |height_m: f32, bin: usize| ringing(bin) + ground(height_m, bin);
    let seabed = dive_ringing(Seabed::new(&Beam::default(), Switch::Auto), 2.3, power);
    let published = seabed.published(BRIGHTNESS * 1e4);
    assert!(!published.is_empty());
    let off_m = published.iter().map(|gaussian| gaussian.mean_m.z.abs());
    let most_m = off_m.fold(0.0, f32::max);
    assert!(most_m < 0.12, "{most_m} m off");
}

#[test]
fn ground_that_falls_with_range_is_found_at_its_height_at_any_level_over_the_noise() {
    for level in [1.0, 1e4] {
        let falling = |height_m: f32, bin: usize| {
            let range_m = (bin as f32 + 0.5) * BIN_M;
            level * (range_m / 5.0).powi(-3) * ground(height_m, bin)
        };
        let seabed = dive(falling);
        let published = seabed.published(BRIGHTNESS * 1e8);
        assert!(!published.is_empty());
        let off_m = published.iter().map(|gaussian| gaussian.mean_m.z.abs());
        let most_m = off_m.fold(0.0, f32::max);
        assert!(most_m < 0.12, "{most_m} m off at {level}");
    }
}

#[test]
fn a_wrong_first_guess_of_brightness_does_not_hide_the_ground() {
    let mut guessed = Seabed::new(&Beam::default(), Switch::Auto);
    guessed.falls[0].brightness = Some(BRIGHTNESS / 300.0);
    let seabed = dive_with(guessed, ground);
    assert!(seabed.is_there());
    let ratio = seabed.brightness() / BRIGHTNESS;
    assert!((0.5..2.0).contains(&ratio), "{ratio}");
}

/// Ground at this height on 20 by 20 m.
fn measured(height_m: f32) -> Field {
    let mut field = Field::default();
    for place in 0..1600 {
        let at = |index: i32| (index - 20) as f32 * NODE_M;
        field.add(Vec3::new(at(place % 40), at(place / 40), height_m));
    }
    field.smooth();
    field
}

#[test]
fn what_lies_behind_measured_ground_is_no_onset() {
    let field = measured(0.0);
    let sensor_m = Vec3::new(0.0, 0.0, 1.0);
    assert!(field.is_between(sensor_m, Vec3::new(8.0, 0.0, -4.0)));
    assert!(!field.is_between(sensor_m, Vec3::new(2.0, 0.0, -0.1)));
    assert!(!field.is_between(sensor_m, Vec3::new(3.0, 0.0, -1.0)));
    // Nobody measured ground there.
    assert!(!field.is_between(sensor_m + 40.0 * Vec3::Y, Vec3::new(8.0, 40.0, -4.0)));
}

#[test]
fn ground_that_onsets_keep_denying_is_measured_anew() {
    let mut wrong = Seabed::new(&Beam::default(), Switch::Auto);
    wrong.field = measured(1.7);
    let seabed = dive_with(dive_with(wrong, ground), ground);
    let published = seabed.published(BRIGHTNESS * 1e4);
    assert!(!published.is_empty());
    let off_m = published.iter().map(|gaussian| gaussian.mean_m.z.abs());
    let most_m = off_m.fold(0.0, f32::max);
    assert!(most_m < 0.15, "{most_m} m off");
}

#[test]
fn a_structure_without_ground_is_no_ground() {
    let seabed = dive(|_, bin| {
        if (240..264).contains(&bin) {
            500.0
        } else {
            0.0
        }
    });
    assert!(!seabed.is_there());
    assert!(
        seabed
            .backdrop(&geometry(2.0, 1.0), 0.0)
            .expected
            .is_empty()
    );
    assert!(seabed.published(1.0).is_empty());
}

/// Pings from these heights, one after the other, after some that hear the noise alone.
fn listen_from(
    seabed: &mut Seabed,
    heights_m: impl Iterator<Item = f32>,
    power: impl Fn(f32, usize) -> f32,
) {
    let mut levels = Levels::default();
    for (index, height_m) in heights_m.enumerate() {
        let quiet = index < 40;
        let power = |bin| if quiet { 0.0 } else { power(height_m, bin) };
        let (intensity, profile) = heard(&mut levels, index, power);
        let geometry = geometry(height_m, 0.005 * index as f32);
        seabed.listen(&geometry, &intensity, &profile);
    }
}

/// Far too high for the ground to be in reach, but for the last ninth of each so many pings.
fn mostly_high(every: usize) -> impl Iterator<Item = f32> {
    (0..2880).map(move |index: usize| match index % every < every / 9 * 8 {
        true => 6.0,
        false => 2.0 + 0.5 * (0.05 * index as f32).sin(),
    })
}

#[test]
fn ground_that_is_mostly_out_of_reach_is_there() {
    let mut seabed = Seabed::new(&Beam::default(), Switch::Auto);
    // Never out of reach for so long that it is looked for less often.
    listen_from(&mut seabed, mostly_high(270), ground);
    assert!(seabed.is_there(), "{} of {}", seabed.shown, seabed.able);
}

#[test]
fn a_first_guess_that_others_do_not_show_is_forgotten() {
    let mut guessed = Seabed::new(&Beam::default(), Switch::Auto);
    // From 6 m up it would begin 7.1 m away.
    guessed.field = measured(3.0);
    (guessed.shown, guessed.able) = (1, 1);
    listen_from(&mut guessed, mostly_high(2880), ground);
    assert!(guessed.is_there(), "{} of {}", guessed.shown, guessed.able);
    assert!(guessed.field.height_m(Vec2::new(6.0, 0.0)).abs() < 0.3);
}

#[test]
fn ground_goes_on_to_where_a_single_ping_takes_it_for_a_wall() {
    // From 3.6 m up it begins 8.5 m away, and pings end at 10 m.
    let high = || std::iter::repeat_n(3.6, 400);
    let mut unknown = Seabed::new(&Beam::default(), Switch::Auto);
    listen_from(&mut unknown, high(), ground);
    assert!(!unknown.is_there() && unknown.shown == 0);
    let mut known = dive(ground);
    let shown = known.shown;
    listen_from(&mut known, high(), ground);
    assert!(
        known.is_there() && known.shown > shown + 40,
        "{}",
        known.shown - shown
    );
    assert!(known.field.height_m(Vec2::new(8.5, 0.0)).abs() < 0.15);
}

/// What a vehicle makes of echoes that goes ahead 1.6 m higher than that of [`dive`].
fn dive_high(power: impl Fn(f32, usize) -> f32) -> Seabed {
    let mut seabed = Seabed::new(&Beam::default(), Switch::Auto);
    let heights_m = (0..1600).map(|index| 3.6 + 0.3 * (0.05 * index as f32).sin());
    listen_from(&mut seabed, heights_m, power);
    seabed
}

#[test]
fn ground_too_far_to_be_told_from_a_wall_is_told_by_following_the_vehicle() {
    let seabed = dive_high(ground);
    assert!(seabed.is_there(), "{} of {}", seabed.shown, seabed.able);
    let height_m = seabed.field.height_m(Vec2::new(12.0, 0.0));
    assert!(height_m.abs() < 0.15, "{height_m}");
    // As far, as loud and as long, but always there.
    let wall = dive_high(|_, bin| ground(3.6, bin));
    assert!(!wall.is_there(), "{} of {}", wall.shown, wall.able);
    // A level beam stays at its height as ground does, and ends.
    let beam = dive_high(|height_m, bin| {
        let beyond_m = bin as f32 * BIN_M - height_m / 0.42;
        if (0.0..0.4).contains(&beyond_m) {
            500.0
        } else {
            0.0
        }
    });
    assert!(!beam.is_there(), "{} of {}", beam.shown, beam.able);
}

#[test]
fn a_sonar_mounted_upside_down_sees_the_same_ground() {
    let upright = geometry(2.0, 0.0);
    let mut turned = upright;
    turned.pose.axes = Mat3::from_rotation_x(std::f32::consts::PI);
    let (a, b) = (FanPlane::of(&upright), FanPlane::of(&turned));
    let edge_rad = -Beam::default().elevation_half_width_rad();
    assert!((a.descent(edge_rad) - b.descent(edge_rad)).abs() < 1e-5);
    assert!((a.elevation_of_ground(2.0, 6.0) - b.elevation_of_ground(2.0, 6.0)).abs() < 1e-5);
}
