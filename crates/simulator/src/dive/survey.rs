//! Continuous motion past a structure: the survey, and its two degenerate cousins.

use std::f64::consts::TAU;

use echosplat_model::Pose;
use glam::{DVec2, DVec3};

use super::track::Track;
use super::{DiveError, DiveKind, Motion};
use crate::random::{Purpose, Random};
use crate::scene::{Scene, SurveyPath};

/// Distance kept from every surface.
pub(super) const CLEARANCE_M: f64 = 0.5;

/// Speed along the track, and the most with heave on top of it.
const SPEED_MPS: f64 = 0.28;
const SPEED_RANGE_MPS: std::ops::RangeInclusive<f64> = 0.22..=0.34;
const TOP_SPEED_MPS: f64 = 0.39;
/// The length of dive whose laps come out whole.
const WHOLE_LAPS_S: f64 = 240.0;
/// One sweep of the heading to and fro: 2 to 3 pings per beam width at 40 pings/s.
const SWEEP_PERIOD_S: f64 = 9.0;
const SWEEP_MARGIN_RAD: f64 = 3.0 * DEGREE;
const SWEEP_MOST_RAD: f64 = 42.0 * DEGREE;
const SWEEP_LEAST_RAD: f64 = 6.0 * DEGREE;
const ROLL_RAD: f64 = 25.0 * DEGREE;
/// The golden ratio keeps roll out of step with the sweep: each place is seen at many rolls.
const ROLL_PERIOD_S: f64 = SWEEP_PERIOD_S * 1.618_034;
/// Distance between the near and the far pass of a survey along a structure.
const LANE_GAP_M: f64 = 1.5;
/// Height above the structure's middle of dives at one depth, so that no truth is its own mirror.
const LEVEL_OFFSET_M: f64 = 0.6;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Motion in closed form.
#[derive(Debug, Clone)]
pub(super) struct Survey {
    track: Track,
    start_m: f64,
    speed_mps: f64,
    facing: Facing,
    /// Corners of the structure from above, as seen along the track.
    outline: [DVec2; 4],
    height_m: f64,
    pitch_rad: f64,
    heave: Wave,
    roll: Wave,
    sweep_phase_rad: f64,
}

#[derive(Debug, Clone, Copy)]
enum Facing {
    Inward,
    Fixed(DVec2),
}

#[derive(Debug, Clone, Copy)]
struct Wave {
    amplitude: f64,
    period_s: f64,
    phase_rad: f64,
}

impl Wave {
    fn at(&self, time_s: f64) -> f64 {
        self.amplitude * (TAU * time_s / self.period_s + self.phase_rad).sin()
    }
}

impl Survey {
    pub(super) fn pose_at(&self, time_s: f64) -> Pose {
        let (place, inward) = self.track.at(self.start_m + self.speed_mps * time_s);
        let facing = match self.facing {
            Facing::Inward => inward,
            Facing::Fixed(direction) => direction,
        };
        let (middle_rad, half_rad) = self.sweep(place, facing);
        let swing = rounded_triangle(TAU * time_s / SWEEP_PERIOD_S + self.sweep_phase_rad);
        let yaw_rad = facing.to_angle() + middle_rad + half_rad * swing;
        let height_m = self.height_m + self.heave.at(time_s);
        let position = place.extend(height_m);
        Pose::from_yaw_pitch_roll(yaw_rad, self.pitch_rad, self.roll.at(time_s), position)
    }

    /// Middle and half of the angles the structure fills, relative to `facing`.
    fn sweep(&self, place: DVec2, facing: DVec2) -> (f64, f64) {
        let bearing = |corner: DVec2| facing.angle_to(corner - place);
        let limited = |angle: f64| angle.clamp(-SWEEP_MOST_RAD, SWEEP_MOST_RAD);
        let bearings = self.outline.map(bearing).map(limited);
        let low = bearings.into_iter().fold(f64::INFINITY, f64::min);
        let high = bearings.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let half = 0.5 * (high - low) + SWEEP_MARGIN_RAD;
        (0.5 * (low + high), half.max(SWEEP_LEAST_RAD))
    }

    /// Whether it keeps clear of everything, looked at along a whole lap at its lowest and highest.
    fn is_clear(&self, scene: &Scene) -> bool {
        const LOOKS: u32 = 200;
        let lap_m = self.track.length();
        (0..LOOKS).all(|look| {
            let (place, _) = self.track.at(lap_m * f64::from(look) / f64::from(LOOKS));
            [-1.0, 0.0, 1.0].into_iter().all(|side| {
                let height_m = self.height_m + side * self.heave.amplitude;
                let position = place.extend(height_m);
                scene.distance(position) >= CLEARANCE_M && scene.is_open_water(position)
            })
        })
    }
}

/// A triangle wave between −1 and 1 with rounded tips: an even sweep without a jolt.
fn rounded_triangle(phase_rad: f64) -> f64 {
    const ROUNDING: f64 = 0.97;
    (ROUNDING * phase_rad.sin()).asin() / ROUNDING.asin()
}

/// The motion and the range to listen to.
pub(super) fn plan(kind: DiveKind, scene: &Scene, seed: u64) -> Result<(Motion, f64), DiveError> {
    const LIFTS: u32 = 16;
    const LIFT_M: f64 = 0.25;
    const RETREATS: u32 = 6;
    const RETREAT_M: f64 = 0.75;
    for retreat in 0..RETREATS {
        for lift in 0..LIFTS {
            let retreat_m = f64::from(retreat) * RETREAT_M;
            let lift_m = f64::from(lift) * LIFT_M;
            let (survey, range_m) = draft(kind, scene, seed, retreat_m, lift_m);
            if survey.is_clear(scene) {
                return Ok((Motion::Moving(survey), range_m));
            }
        }
    }
    Err(DiveError::NoRoom {
        kind,
        scene: scene.name().to_owned(),
        clearance_m: CLEARANCE_M,
    })
}

fn draft(kind: DiveKind, scene: &Scene, seed: u64, retreat_m: f64, lift_m: f64) -> (Survey, f64) {
    let hints = scene.survey_hints();
    let mut random = Random::new(seed, Purpose::Plan, 0);
    let (low, high) = structure_or_default(scene);
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let standoff_m = hints
        .standoff_m
        .unwrap_or_else(|| (2.0 * half.z).clamp(4.2, 7.0))
        + retreat_m;
    let (track, facing) = match hints.path {
        SurveyPath::Around => {
            let track = Track {
                center: middle.truncate(),
                half: half.truncate(),
                radius: standoff_m,
            };
            (track, Facing::Inward)
        }
        SurveyPath::Along => along(middle, half, standoff_m, hints.heading_deg),
    };
    let is_flat = matches!(kind, DiveKind::Level | DiveKind::Pan);
    let offset_m = if is_flat { LEVEL_OFFSET_M } else { 0.0 };
    let height_m = hints.depth_z_m.unwrap_or(middle.z) + offset_m + lift_m;
    let heave_m = hints
        .heave_m
        .unwrap_or_else(|| (0.75 * half.z).clamp(1.0, 1.6));
    let speed_mps = speed(track.length());
    let climb_mps = (TOP_SPEED_MPS.powi(2) - speed_mps.powi(2)).sqrt();
    let moving = if is_flat { 0.0 } else { 1.0 };
    let inward_m = standoff_m + half.truncate().min_element();
    let mut phase = || random.between(0.0, TAU);
    let survey = Survey {
        outline: outline(low, high),
        height_m,
        // Dives at one depth keep level; the others look at the structure's middle.
        pitch_rad: moving * (height_m - middle.z).atan2(inward_m),
        heave: Wave {
            amplitude: moving * heave_m,
            period_s: TAU * heave_m / climb_mps,
            phase_rad: phase(),
        },
        roll: Wave {
            amplitude: moving * ROLL_RAD,
            period_s: ROLL_PERIOD_S,
            phase_rad: phase(),
        },
        sweep_phase_rad: phase(),
        start_m: if kind == DiveKind::Pan {
            0.0
        } else {
            random.unit() * track.length()
        },
        speed_mps: if kind == DiveKind::Pan {
            0.0
        } else {
            speed_mps
        },
        track,
        facing,
    };
    let reach_m = 1.2 * (standoff_m + half.truncate().length());
    let range_m = hints
        .range_m
        .unwrap_or_else(|| (reach_m / 5.0).ceil() * 5.0);
    (
        survey,
        range_m
            .max(standoff_m + 2.0)
            .max(if hints.range_m.is_some() { 0.0 } else { 10.0 }),
    )
}

/// A stadium before the structure: the near lane at the standoff, the far one beyond it.
fn along(middle: DVec3, half: DVec3, standoff_m: f64, heading_deg: Option<f64>) -> (Track, Facing) {
    let facing = DVec2::from_angle(heading_deg.unwrap_or(90.0).to_radians());
    let depth_m = half.truncate().dot(facing.abs());
    let width_m = half.truncate().dot(facing.perp().abs());
    let back_m = depth_m + standoff_m + 0.5 * LANE_GAP_M;
    let straight_m = (width_m - 1.0).max(1.0);
    let lies_along_x = facing.x.abs() < facing.y.abs();
    let track = Track {
        center: middle.truncate() - facing * back_m,
        half: if lies_along_x {
            DVec2::new(straight_m, 0.0)
        } else {
            DVec2::new(0.0, straight_m)
        },
        radius: 0.5 * LANE_GAP_M,
    };
    (track, Facing::Fixed(facing))
}

/// So that laps come out whole, if that is a speed a vehicle would go.
fn speed(lap_m: f64) -> f64 {
    let laps = (SPEED_MPS * WHOLE_LAPS_S / lap_m).round();
    let speed_mps = laps * lap_m / WHOLE_LAPS_S;
    if SPEED_RANGE_MPS.contains(&speed_mps) {
        speed_mps
    } else {
        SPEED_MPS
    }
}

fn outline(low: DVec3, high: DVec3) -> [DVec2; 4] {
    [
        DVec2::new(low.x, low.y),
        DVec2::new(high.x, low.y),
        DVec2::new(high.x, high.y),
        DVec2::new(low.x, high.y),
    ]
}

/// Where nothing stands, a dive goes around a place where a fence could.
pub(crate) fn structure_or_default(scene: &Scene) -> (DVec3, DVec3) {
    let half = DVec3::new(3.0, 0.5, 2.0);
    scene.bounds().unwrap_or((-half, half))
}
