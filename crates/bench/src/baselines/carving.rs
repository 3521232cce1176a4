//! Carving by hit ratio: of all places on the arcs of echoes, those that most observations find lit.
//!
//! Two passes over all pings: the first marks the voxels on the arcs, the second counts for each of
//! them the pings whose fan passes it and whether their bin at that range was lit or dark. Echoes are
//! found as the mapper finds them, so that the two differ in what they make of them.

use echosplat_model::PosedPing;
use glam::{DQuat, DVec3};

use super::voxels::{Voxel, Voxels};

/// What there is to choose.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Carving {
    /// Edge of a voxel, metres; 0 takes 0.35 of the beam's width at the far end of the first ping,
    /// as the mapper does.
    pub(crate) voxel_m: f64,
    /// Half the fan, radians.
    pub(crate) elevation_half_width_rad: f64,
    /// Nearer than this a ping says nothing, metres.
    pub(crate) blanking_m: f64,
    /// A bin is an echo above this many times the mean noise power.
    pub(crate) detection_factor: f32,
    /// And no further than this below the strongest echo so far, decibels.
    pub(crate) dynamic_range_db: f32,
    /// Bins this near an echo are lit as well, since poses are not exact, metres.
    pub(crate) tolerance_m: f64,
    /// Dark bins this far behind an echo say nothing: they may be in its shadow. Metres.
    pub(crate) shadow_m: f64,
    /// Least share of observations that find a kept voxel lit, 0 to 1.
    pub(crate) least_share: f64,
    /// Least number of pings that observe a kept voxel.
    pub(crate) least_observations: u32,
}

impl Default for Carving {
    fn default() -> Self {
        Self {
            voxel_m: 0.0,
            elevation_half_width_rad: 25f64.to_radians(),
            blanking_m: 0.5,
            detection_factor: 12.0,
            dynamic_range_db: 30.0,
            tolerance_m: 0.06,
            shadow_m: 0.6,
            least_share: 0.9,
            least_observations: 16,
        }
    }
}

/// What is left after carving.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Carved {
    /// Centres of the kept voxels, world coordinates, metres.
    pub(crate) positions_m: Vec<DVec3>,
    /// Places observed, both passes together.
    pub(crate) voxel_observations: u64,
    /// Places on arcs that found no room.
    pub(crate) dropped: u64,
}

/// 0.35 of the beam's width of 0.8° at half power, radians.
const VOXEL_RAD: f64 = 0.35 * 0.8 * std::f64::consts::PI / 180.0;
const VOXEL_LIMITS_M: (f64, f64) = (0.02, 0.5);
/// Lower quartile over mean of exponentially distributed noise: −ln(3/4).
const QUARTILE_OVER_MEAN: f32 = 0.287_682;

impl Carving {
    /// Of all pings together, in their order. The same pings give the same voxels.
    #[must_use]
    pub(crate) fn carve(&self, pings: &[PosedPing]) -> Carved {
        let Some(first) = pings.first() else {
            return Carved::default();
        };
        let origin_m = first.world_from_sensor.translation_m;
        let edge_m = self.edge_m(first);
        let profiles = self.profiles(pings);
        let mut voxels = Voxels::new(edge_m);
        let mut observations = 0;
        for (posed, states) in pings.iter().zip(&profiles) {
            let fan = Fan::new(posed, origin_m, edge_m, self.elevation_half_width_rad);
            observations += fan.visit(
                |bin| states[bin] == State::Echo,
                |place_m, _| {
                    voxels.put_on_arc(place_m);
                },
            );
        }
        for (ping, (posed, states)) in (1..).zip(pings.iter().zip(&profiles)) {
            let fan = Fan::new(posed, origin_m, edge_m, self.elevation_half_width_rad);
            observations += fan.visit(
                |bin| states[bin] != State::Mute,
                |place_m, bin| {
                    voxels.observe(place_m, ping, states[bin] != State::Dark);
                },
            );
        }
        let kept = voxels.centers(|voxel| self.keeps(voxel));
        Carved {
            positions_m: kept.into_iter().map(|place_m| origin_m + place_m).collect(),
            voxel_observations: observations,
            dropped: voxels.dropped(),
        }
    }

    fn edge_m(&self, first: &PosedPing) -> f64 {
        if self.voxel_m > 0.0 {
            return self.voxel_m;
        }
        let (least_m, most_m) = VOXEL_LIMITS_M;
        let far_m = first.ping.settings().range_end_m();
        (VOXEL_RAD * far_m).clamp(least_m, most_m)
    }

    fn keeps(&self, voxel: &Voxel) -> bool {
        let observations = u32::from(voxel.hits) + u32::from(voxel.misses);
        let least_hits = self.least_share * f64::from(observations);
        observations >= self.least_observations && f64::from(voxel.hits) >= least_hits
    }

    /// What every bin of every ping says; the strongest echo so far falls slowly, so that one
    /// specular return does not hide what follows.
    fn profiles(&self, pings: &[PosedPing]) -> Vec<Vec<State>> {
        let mut strongest = 0.0_f32;
        let profile = |posed: &PosedPing| {
            let intensity = posed.ping.intensity();
            let settings = posed.ping.settings();
            let bin_m = settings.bin_length_m();
            let blank = (self.blanking_m - settings.range_start_m) / bin_m;
            let blank = (blank.ceil().max(0.0) as usize).min(intensity.len());
            let open = &intensity[blank..];
            let peak = open.iter().copied().fold(0.0, f32::max);
            strongest = peak.max(0.9995 * strongest);
            let floor = strongest * 10f32.powf(-0.1 * self.dynamic_range_db);
            let threshold = (self.detection_factor * noise(open)).max(floor);
            let widen = (self.tolerance_m / bin_m).ceil() as usize;
            let shadow = (self.shadow_m / bin_m) as usize;
            states(intensity, blank, threshold, widen, shadow)
        };
        pings.iter().map(profile).collect()
    }
}

/// What a bin says of the places at its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Nothing.
    Mute,
    /// Nothing is there.
    Dark,
    /// An echo is near.
    Lit,
    /// An echo.
    Echo,
}

/// Mean power of the noise, from the lower quartile of the bins.
fn noise(open: &[f32]) -> f32 {
    let mut sorted = open.to_vec();
    if sorted.is_empty() {
        return 0.0;
    }
    let quarter = sorted.len() / 4;
    let (_, &mut quartile, _) = sorted.select_nth_unstable_by(quarter, f32::total_cmp);
    quartile / QUARTILE_OVER_MEAN
}

fn states(
    intensity: &[f32],
    blank: usize,
    threshold: f32,
    widen: usize,
    shadow: usize,
) -> Vec<State> {
    let count = intensity.len();
    let is_echo = |bin: &usize| *bin >= blank && intensity[*bin] > threshold;
    let mut states = vec![State::Dark; count];
    for bin in (0..count).filter(is_echo) {
        states[bin..(bin + widen + shadow).min(count)].fill(State::Mute);
    }
    for bin in (0..count).filter(is_echo) {
        states[bin.saturating_sub(widen)..(bin + widen + 1).min(count)].fill(State::Lit);
    }
    for bin in (0..count).filter(is_echo) {
        states[bin] = State::Echo;
    }
    states[..blank].fill(State::Mute);
    states
}

/// The plane of one ping, sampled about a voxel apart.
struct Fan<'a> {
    posed: &'a PosedPing,
    position_m: DVec3,
    /// Unit vectors from the lowest elevation to the highest, a voxel apart at the far end.
    directions: Vec<DVec3>,
    edge_m: f64,
}

impl<'a> Fan<'a> {
    fn new(posed: &'a PosedPing, origin_m: DVec3, edge_m: f64, half_rad: f64) -> Self {
        let pose = posed.world_from_sensor;
        let far_m = posed.ping.settings().range_end_m();
        let steps = (2.0 * half_rad * far_m / edge_m).ceil().clamp(1.0, 4096.0) as usize;
        let azimuth = DQuat::from_rotation_z(posed.ping.beam_azimuth_rad().into());
        let rotation = pose.rotation * azimuth;
        let direction = |step: usize| {
            let elevation = half_rad * (2.0 * step as f64 / steps as f64 - 1.0);
            rotation * DVec3::new(elevation.cos(), 0.0, elevation.sin())
        };
        Self {
            posed,
            position_m: pose.translation_m - origin_m,
            directions: (0..=steps).map(direction).collect(),
            edge_m,
        }
    }

    /// Calls `found` with places and their bin; how many there were. Where bins are shorter than half
    /// a voxel, the first of them that `wants` accepts speaks for the others.
    fn visit(&self, wants: impl Fn(usize) -> bool, mut found: impl FnMut(DVec3, usize)) -> u64 {
        let settings = self.posed.ping.settings();
        let far_m = settings.range_end_m();
        let every = ((0.5 * self.edge_m / settings.bin_length_m()) as usize).max(1);
        let mut count = 0;
        for group in 0..settings.bin_count.div_ceil(every) {
            let mut bins = group * every..settings.bin_count.min((group + 1) * every);
            let Some(bin) = bins.find(|bin| wants(*bin)) else {
                continue;
            };
            let range_m = settings.bin_center_m(bin);
            let stride = ((far_m / range_m.max(self.edge_m)) as usize).max(1);
            for direction in self.directions.iter().step_by(stride) {
                found(self.position_m + *direction * range_m, bin);
                count += 1;
            }
        }
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_simulator::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene, SimulatedSonar};
    use std::sync::Arc;

    #[test]
    fn bins_are_lit_near_echoes_and_mute_behind_them() {
        let mut intensity = vec![0.0; 12];
        intensity[5] = 1.0;
        let said = states(&intensity, 2, 0.5, 1, 3);
        use State::{Dark, Echo, Lit, Mute};
        let expected = [
            Mute, Mute, Dark, Dark, Lit, Echo, Lit, Mute, Mute, Dark, Dark, Dark,
        ];
        assert_eq!(said, expected);
    }

    #[test]
    fn a_survey_leaves_what_is_there_and_silence_nothing() {
        let scene = Arc::new(Scene::named("fence").unwrap());
        let noise = NoiseLevel::None;
        let options = DiveOptions {
            duration_s: 60.0,
            ..DiveOptions::default()
        };
        let dive = Dive::plan_with(DiveKind::Survey, &scene, noise, 1, &options).unwrap();
        let dive = Arc::new(dive);
        let trajectory = dive.trajectory(0.5);
        let sonar = SimulatedSonar::new(Arc::clone(&scene), Arc::clone(&dive), noise, 1);
        let pings: Vec<PosedPing> = (0..dive.pings())
            .filter_map(|index| sonar.posed_ping(index, &trajectory))
            .collect();
        let carved = Carving::default().carve(&pings);
        let is_near = |place_m: &&DVec3| scene.nearest(**place_m).0 < 0.25;
        let near = carved.positions_m.iter().filter(is_near).count();
        let count = carved.positions_m.len();
        assert!(count > 50 && 2 * near > count, "{near} of {count} are near");
        assert!(carved.voxel_observations > 100_000 && carved.dropped == 0);
        assert_eq!(Carving::default().carve(&[]), Carved::default());
    }
}
