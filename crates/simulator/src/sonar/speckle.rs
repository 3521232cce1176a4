//! Speckle that neighbouring bins share, and pings of a sonar that hardly moves.

use echosplat_model::Pose;
use glam::{DVec2, DVec3};

use crate::random::{Purpose, Random};

/// Waves whose sum is the lasting speckle. Their amplitudes are normal, so its power is exponential with
/// any number; with few it would repeat itself along a dive.
const WAVE_COUNT: usize = 16;
/// Bins with speckle of their own: the most a unit offers. Further ones begin anew.
const BIN_COUNT: usize = 1200;
/// The receiver's response over neighbouring bins, sum of squares 1. The pulse of a real unit is two
/// bins long, and powers of neighbouring bins correlate with 0.4 to 0.5; this gives
/// (2 · 0.412 · 0.813)² = 0.45.
const RESPONSE: [f64; 3] = [0.412, 0.813, 0.412];
/// Of the amplitude's power, what a ping shares with those just before from the same place. Powers
/// then correlate with 0.66² = 0.43; those of a real unit at rest with 0.55 from one ping to the next
/// and 0.35 to 0.43 after 0.1 s.
const LASTING_SHARE: f64 = 0.66;
/// What lasts falls by a factor e in this time, at rest: powers correlate with 0.26 after 1 s, those
/// of a real unit with 0.12 to 0.41.
const LASTING_S: f64 = 4.0;
/// One sigma of the shift that makes speckle new. Echoes from all over a fan of 50° interfere over
/// λ / 50° = 4 mm.
const SHIFT_M: f64 = 0.004;
/// One sigma of the turn that does: that of the beam, which then holds other places.
const TURN_RAD: f64 = crate::beam::AZIMUTH_SIGMA_RAD;

/// The share of all pings' speckle that lasts from one to the next: a sum of waves over the sensor's
/// place, attitude and time, so that it is a function of where the sensor is and not of other pings.
pub(super) struct Speckle {
    waves: [Wave; WAVE_COUNT],
    /// Amplitude of each wave in each bin, as the receiver gives it back.
    amplitudes: Vec<[DVec2; WAVE_COUNT]>,
}

/// Phase per metre, per unit of the forward and of the upward axis, and per second.
#[derive(Debug, Clone, Copy)]
struct Wave {
    place: DVec3,
    forward: DVec3,
    up: DVec3,
    time: f64,
}

impl Speckle {
    pub(super) fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, Purpose::Speckle, 0);
        // Normal wave numbers correlate as exp(−½ d²/σ²), Cauchy's as exp(−t/τ).
        let waves = std::array::from_fn(|_| Wave {
            place: random.normal3() / SHIFT_M,
            forward: random.normal3() / TURN_RAD,
            up: random.normal3() / TURN_RAD,
            time: (std::f64::consts::PI * (random.unit() - 0.5)).tan() / LASTING_S,
        });
        let scale = (1.0 / WAVE_COUNT as f64).sqrt();
        let mut white =
            || -> [DVec2; WAVE_COUNT] { std::array::from_fn(|_| scale * random.amplitude()) };
        let white: Vec<_> = (0..BIN_COUNT + 2).map(|_| white()).collect();
        let of_bin = |around: &[[DVec2; WAVE_COUNT]]| {
            std::array::from_fn(|wave| response([0, 1, 2].map(|bin| around[bin][wave])))
        };
        Self {
            waves,
            amplitudes: white.windows(3).map(of_bin).collect(),
        }
    }

    /// Phases of the waves for a ping from `pose`, world from sensor, `time_s` into the dive.
    pub(super) fn phases(&self, pose: &Pose, time_s: f64) -> Phases {
        let (forward, up) = (pose.rotation * DVec3::X, pose.rotation * DVec3::Z);
        Phases(self.waves.map(|wave| {
            let phase_rad = wave.place.dot(pose.translation_m)
                + wave.forward.dot(forward)
                + wave.up.dot(up)
                + wave.time * time_s;
            DVec2::from_angle(phase_rad)
        }))
    }

    /// Amplitude of an echo of mean power 1 in `bin`; `fresh` is the share that is this ping's alone.
    pub(super) fn amplitude(&self, bin: usize, phases: &Phases, fresh: DVec2) -> DVec2 {
        let amplitudes = &self.amplitudes[bin % BIN_COUNT];
        let waves = amplitudes.iter().zip(&phases.0);
        let lasting: DVec2 = waves
            .map(|(amplitude, phase)| phase.rotate(*amplitude))
            .sum();
        LASTING_SHARE.sqrt() * lasting + (1.0 - LASTING_SHARE).sqrt() * fresh
    }
}

/// Of one ping.
pub(super) struct Phases([DVec2; WAVE_COUNT]);

/// Amplitudes of `count` bins, each of mean power 1, from white noise through the receiver.
pub(super) fn received(count: usize, random: &mut Random) -> Vec<DVec2> {
    let mut around = [DVec2::ZERO, random.amplitude(), random.amplitude()];
    let mut next = || {
        around = [around[1], around[2], random.amplitude()];
        response(around)
    };
    (0..count).map(|_| next()).collect()
}

fn response(around: [DVec2; 3]) -> DVec2 {
    around[0] * RESPONSE[0] + around[1] * RESPONSE[1] + around[2] * RESPONSE[2]
}
