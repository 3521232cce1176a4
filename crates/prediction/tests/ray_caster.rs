//! The measurement of Gaussians against rays cast on them drawn as solids: two programs that share
//! nothing but the scene.

use std::fmt::Write;

use echosplat_mapper::{MapperConfig, geometry_of};
use echosplat_model::{Gaussian, Ping, PingSettings, Pose, PosedPing, Standing, Timestamp, Twist};
use echosplat_prediction::MapRenderer;
use echosplat_simulator::{Scene, echoes_at_rest};
use glam::{DQuat, DVec3};

/// Pings of the ray caster whose mean is taken: its rays are jittered.
const CASTS: u64 = 48;

/// One Gaussian before a sensor at the origin that looks along x.
#[derive(Clone, Copy)]
struct Piece {
    mean_m: DVec3,
    scale_m: DVec3,
    yaw_pitch_roll_deg: DVec3,
    reflectivity: f64,
}

/// At a place, by range along x, azimuth offset in metres, and height.
fn at(x: f64, y: f64, z: f64) -> Piece {
    Piece {
        mean_m: DVec3::new(x, y, z),
        scale_m: DVec3::ZERO,
        yaw_pitch_roll_deg: DVec3::ZERO,
        reflectivity: 1.0,
    }
}

impl Piece {
    fn ball(mut self, sigma_m: f64) -> Self {
        self.scale_m = DVec3::splat(sigma_m);
        self
    }

    /// Flat along its own x.
    fn disc(mut self, sigma_m: f64) -> Self {
        self.scale_m = DVec3::new(0.1 * sigma_m, sigma_m, sigma_m);
        self
    }

    fn turned(mut self, yaw_deg: f64, pitch_deg: f64, roll_deg: f64) -> Self {
        self.yaw_pitch_roll_deg = DVec3::new(yaw_deg, pitch_deg, roll_deg);
        self
    }

    fn reflecting(mut self, reflectivity: f64) -> Self {
        self.reflectivity = reflectivity;
        self
    }

    fn rotation(&self) -> DQuat {
        let [yaw, pitch, roll] = self.yaw_pitch_roll_deg.to_array().map(f64::to_radians);
        Pose::from_yaw_pitch_roll(yaw, pitch, roll, DVec3::ZERO).rotation
    }

    /// A Gaussian of a map lies where its echoes come from; those of a solid come from its lit
    /// side, on the mean two thirds of its half depth before its middle.
    fn set_back_m(&self) -> DVec3 {
        let along = self.mean_m.normalize();
        let own = self.rotation().conjugate() * along;
        let half_depth_m = std::f64::consts::SQRT_2 / (own / self.scale_m).length();
        along * (2.0 / 3.0 * half_depth_m)
    }

    fn gaussian(&self) -> Gaussian {
        Gaussian {
            id: 0,
            mean_m: self.mean_m.as_vec3(),
            rotation: self.rotation().as_quat(),
            scale_m: self.scale_m.as_vec3(),
            opacity: 0.999,
            reflectivity: self.reflectivity as f32,
            sigma_m: 0.01,
            position_covariance_m2: Gaussian::known_alike_m2(0.01),
            probability: 1.0,
            standing: Standing::Confident,
            why: echosplat_model::Why::default(),
        }
    }
}

/// As solids: ∫exp(−d²/2) over directions is the area of the ellipse with √2 sigmas as semi-axes.
fn scene_of(pieces: &[Piece]) -> Scene {
    let mut toml = "name = \"pieces\"\n".to_owned();
    for piece in pieces {
        let list = |v: DVec3| format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z);
        let _ = writeln!(
            toml,
            "[[ellipsoid]]\ncenter_m = {}\nsemi_axes_m = {}\nyaw_pitch_roll_deg = {}\n\
             reflectivity = {:?}",
            list(piece.mean_m + piece.set_back_m()),
            list(piece.scale_m * std::f64::consts::SQRT_2),
            list(piece.yaw_pitch_roll_deg),
            piece.reflectivity
        );
    }
    Scene::parse(&toml, None).expect("the table is a scene")
}

/// The coarsest bins that the device offers: in finer ones the lit side of a ball is told from a
/// cloud as deep as the ball.
fn settings() -> PingSettings {
    PingSettings {
        range_start_m: 0.0,
        range_length_m: 12.0,
        bin_count: 200,
        speed_of_sound_mps: 1500.0,
        frequency_hz: 450_000.0,
        pulse_duration_s: 32e-6,
        gain_index: 0,
    }
}

fn by_rays(pieces: &[Piece]) -> Vec<f64> {
    let scene = scene_of(pieces);
    let mut sum = vec![0.0; settings().bin_count];
    for seed in 0..CASTS {
        let cast = echoes_at_rest(&scene, &Pose::IDENTITY, &settings(), seed);
        sum.iter_mut()
            .zip(cast)
            .for_each(|(sum, power)| *sum += power);
    }
    sum.iter().map(|sum| sum / CASTS as f64).collect()
}

fn by_map(pieces: &[Piece]) -> Vec<f64> {
    let gaussians: Vec<Gaussian> = pieces.iter().map(Piece::gaussian).collect();
    let config = MapperConfig {
        position_sigma_m: 0.0,
        attitude_sigma_deg: 0.0,
        ..MapperConfig::default()
    };
    let silence = vec![0.0; settings().bin_count];
    let posed = PosedPing {
        ping: Ping::new(0, Timestamp::ZERO, settings(), silence)
            .expect("silence is a ping")
            .into(),
        world_from_sensor: Pose::IDENTITY,
        twist: Twist::default(),
        reference_range_m: 6.0,
        uncertainty: None,
        jitter: None,
    };
    let mut renderer = MapRenderer::new(DVec3::ZERO, 1.0, &gaussians);
    let geometry = geometry_of(&posed, renderer.origin_m(), &config);
    renderer
        .ping(&geometry)
        .iter()
        .map(|&i| f64::from(i))
        .collect()
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        ab += (a - mean_a) * (b - mean_b);
        aa += (a - mean_a).powi(2);
        bb += (b - mean_b).powi(2);
    }
    ab / (aa * bb).sqrt()
}

fn scenes() -> Vec<(&'static str, Vec<Piece>)> {
    vec![
        (
            "discs face-on, far apart",
            vec![
                at(2.5, 0.0, 0.2).disc(0.02),
                at(4.0, 0.01, -0.5).disc(0.04),
                at(6.0, -0.02, 1.0).disc(0.06),
                at(9.5, 0.0, -1.5).disc(0.1),
            ],
        ),
        (
            "balls alone",
            vec![
                at(2.0, 0.0, 0.0).ball(0.02),
                at(3.5, 0.02, 0.6).ball(0.03),
                at(5.5, 0.0, -1.0).ball(0.03),
                at(8.0, -0.05, 1.5).ball(0.04),
            ],
        ),
        (
            "tilted discs",
            vec![
                at(2.2, 0.0, 0.1).disc(0.03).turned(30.0, 0.0, 0.0),
                at(4.2, 0.0, -0.6).disc(0.05).turned(0.0, 35.0, 0.0),
                at(6.3, 0.03, 0.8).disc(0.06).turned(25.0, -20.0, 0.0),
                at(9.0, 0.0, 0.0).disc(0.08).turned(-35.0, 15.0, 40.0),
            ],
        ),
        (
            "other reflectivities",
            vec![
                at(2.5, 0.0, 0.2).disc(0.03).reflecting(0.1),
                at(4.0, 0.0, -0.5).disc(0.04).reflecting(0.9),
                at(6.0, 0.0, 1.0).ball(0.04).reflecting(0.5),
                at(8.0, 0.0, -1.5).disc(0.08).reflecting(0.25),
            ],
        ),
        (
            "above and below one another",
            vec![
                at(3.0, 0.0, 0.5).disc(0.05),
                at(3.5, 0.0, 0.1).disc(0.05),
                at(4.0, 0.0, -0.3).disc(0.06),
                at(4.5, 0.0, -0.9).ball(0.04),
                at(5.0, 0.02, 1.5).ball(0.04),
            ],
        ),
        (
            "half beside the beam",
            vec![
                at(3.0, 0.03, 0.0).disc(0.03),
                at(5.0, -0.05, 0.4).disc(0.05),
                at(7.0, 0.08, -0.8).ball(0.04),
                at(9.0, 0.0, 0.6).disc(0.06),
            ],
        ),
    ]
}

#[test]
fn scenes_in_which_nothing_hides_anything_sound_alike() {
    let total = |profile: &[f64]| profile.iter().sum::<f64>();
    for (name, pieces) in scenes() {
        let (rays, map) = (by_rays(&pieces), by_map(&pieces));
        let alike = correlation(&rays, &map);
        assert!(alike >= 0.98, "{name}: correlation {alike:.4}");
        // The edge of a solid is sharper than a Gaussian's, so the narrow beam gets more of it:
        // across the beam an ellipse of √2 sigmas has half the variance.
        let ratio = total(&map) / total(&rays);
        assert!(
            ratio > 0.8 && ratio < 1.05,
            "{name}: energy {ratio:.3} of the rays'"
        );
    }
}
