//! The seabed as a layer of its own: a smooth height field under what pings show of it.
//!
//! Beyond its onset the ground lights every bin, so nothing is ever dark there and its echoes would
//! breed phantoms along their arcs. Its onset is sharp, one place of the ground per ping. Heights
//! through those places tell what each bin of any ping would hold of ground alone: only what stands
//! out from that is an echo, and the layer explains the rest.
//!
//! Used only where pings show ground; asserted only where its onset follows the vehicle's height and tilt. Deliberately absent: overhangs, and ground that is not below.
//!
//! Cost: for every fourth ping an onset (1 ms), where none shows for every 128th; for every ping 96 rays over the field, 20 µs.

mod fan_plane;
mod field;
mod onset;
mod proof;

use echosplat_acoustics::{Beam, Look};
use echosplat_model::glam::{Quat, Vec2, Vec3};
use echosplat_model::{Gaussian, GaussianId, Standing, Switch};

use crate::detect::profile::{Backdrop, Profile};
use fan_plane::{FanEnergy, FanPlane};
use field::{Field, NODE_M, STEP_SIGMA_M};
use onset::{FALLS, Onset, Runs, falling};
use proof::Proof;

/// Every so many-th ping is asked for the ground; those between show the same of it.
const STRIDE: u32 = 4;
/// The same after so many pings in a row that showed none.
const IDLE_STRIDE: u32 = 128;
const IDLE_AFTER: u32 = 64;
/// After so many in vain, brightness may be anything again.
const DOUBTED_AFTER: u32 = 8;
/// The ground is there once so many pings showed it, and this share of those that could. They also tell by what
/// power of range its brightness falls.
const LEAST_SHOWN: u32 = 24;
const LEAST_SHARE: f32 = 0.3;
/// Measurements further than this from what is known are of something else.
const OUTLIER_M: f32 = 0.6;
/// How far the ground may be from where it is thought to be.
const TOLERANCE_M: f32 = 0.12;
/// Slope of ground that nothing is known of, two sigma of what the field expects.
const STEEPEST: f32 = 2.0 * STEP_SIGMA_M / NODE_M;
/// Rays over the height of the fan.
const RAYS: usize = 96;
/// Rays that descend less than this never meet it, metres per metre.
const LEAST_DESCENT: f32 = 0.02;
/// Steps to where a ray meets the ground; it is smooth.
const RAY_STEPS: usize = 3;
/// What each new brightness counts.
const BRIGHTNESS_RATE: f32 = 0.12;
/// Onsets between smoothings of the field.
const ONSETS_PER_SMOOTHING: u32 = 16;
/// Ground that scatters more is not asserted.
const MOST_SPREAD_M: f32 = 0.2;
/// What is deeper than this is not seen.
const BURIED_M: f32 = 0.3;
/// Half the thickness of its Gaussians.
const THICKNESS_M: f32 = 0.02;
/// Ids of the ground start here, far above all others.
const FIRST_ID: GaussianId = 1 << 31;

/// What is known of the seabed.
#[derive(Debug)]
pub(crate) struct Seabed {
    switch: Switch,
    fan: FanEnergy,
    beam_sigma_rad: f32,
    field: Field,
    proof: Proof,
    runs: Runs,
    heard: u32,
    /// Pings asked since the last that showed ground.
    in_vain: u32,
    /// Pings that could show ground, and those that did.
    able: u32,
    shown: u32,
    /// By each power of range of [`FALLS`].
    falls: [Fall; FALLS.len()],
    /// Log of the range of onsets, summed up.
    log_range_sum: f32,
}

/// What onsets say if brightness falls by one power of range.
#[derive(Debug, Clone, Copy, Default)]
struct Fall {
    /// Gain in log likelihood over no ground, summed up over the onsets that tell it.
    gain: f32,
    /// Power per radian of elevation at 1 m, of late.
    brightness: Option<f32>,
}

impl Seabed {
    pub(crate) fn new(beam: &Beam, switch: Switch) -> Self {
        Self {
            switch,
            fan: FanEnergy::new(beam),
            beam_sigma_rad: beam.azimuth_sigma_rad(),
            field: Field::default(),
            proof: Proof::default(),
            runs: Runs::default(),
            heard: 0,
            in_vain: 0,
            able: 0,
            shown: 0,
            falls: Default::default(),
            log_range_sum: 0.0,
        }
    }

    /// Whether there is what looks like ground in view at all: it explains echoes.
    pub(crate) fn is_there(&self) -> bool {
        self.shown >= LEAST_SHOWN && self.shown as f32 > LEAST_SHARE * self.able as f32
    }

    /// Natural logarithm of how much likelier it is ground than reverberation, if it is there.
    pub(crate) fn log_ratio(&self) -> Option<f32> {
        self.is_there().then(|| self.proof.log_ratio())
    }

    /// Whether it is ground, and no reverberation: the map asserts it.
    pub(crate) fn is_proven(&self) -> bool {
        self.is_there() && (self.switch == Switch::On || self.proof.is_enough())
    }

    /// Power per radian of elevation at 1 m, of late; 0 as long as none is known.
    pub(crate) fn brightness(&self) -> f32 {
        match self.shown < LEAST_SHOWN {
            true => 0.0,
            false => self.falls[self.likeliest()].brightness.unwrap_or(0.0),
        }
    }

    /// Index of the power of range that brightness falls by.
    fn likeliest(&self) -> usize {
        let gains = self.falls.iter().map(|fall| fall.gain).enumerate();
        let best = gains.reduce(|best, other| if other.1 > best.1 { other } else { best });
        best.map_or(0, |(index, _)| index)
    }

    /// Learns from a ping.
    pub(crate) fn listen(&mut self, look: &Look, intensity: &[f32], profile: &Profile) {
        if self.switch == Switch::Off {
            return;
        }
        self.heard = self.heard.wrapping_add(1);
        let stride = match self.in_vain < IDLE_AFTER {
            true => STRIDE,
            false => IDLE_STRIDE,
        };
        if !self.heard.is_multiple_of(stride) {
            return;
        }
        let plane = FanPlane::of(look);
        let near_m = look.range_start_m + profile.blank as f32 * look.bin_length_m;
        let (from, noise) = (profile.blank, profile.noise);
        self.runs
            .fill(intensity, from, noise, near_m, look.bin_length_m);
        if !self.runs.can_tell(&plane, &self.fan) {
            return;
        }
        self.able = self.able.saturating_add(1);
        self.in_vain = self.in_vain.saturating_add(1);
        let Some(onset) = self.onset(&plane) else {
            return;
        };
        self.in_vain = 0;
        self.shown = self.shown.saturating_add(1);
        let range_m = (onset.point_m - plane.position_m).length();
        self.log_range_sum += range_m.ln();
        let descent = plane.descent(-self.fan.half_width_rad());
        self.proof.add(onset.point_m, plane.position_m, descent);
        self.field.add(onset.point_m);
        if self.shown.is_multiple_of(ONSETS_PER_SMOOTHING) {
            self.field.smooth();
        }
    }

    /// The ground in the ping at hand, by the likeliest power of range; learns its brightness, and the power as long as
    /// it is open.
    fn onset(&mut self, plane: &FanPlane) -> Option<Onset> {
        let is_open = self.shown < LEAST_SHOWN;
        let settled = self.likeliest();
        let mut onsets = [None; FALLS.len()];
        for (index, &power) in FALLS.iter().enumerate() {
            if !is_open && index != settled {
                continue;
            }
            // One wrong guess must not be held against everything that does not fit it.
            let is_trusted = self.in_vain <= DOUBTED_AFTER;
            let known = self.falls[index].brightness.filter(|_| is_trusted);
            let Some(onset) = self.runs.onset(plane, &self.fan, power, known) else {
                continue;
            };
            let off_m = onset.point_m.z - self.field.height_m(onset.point_m.truncate());
            let is_there = self.is_there();
            let fall = &mut self.falls[index];
            if !is_there || off_m.abs() < OUTLIER_M {
                // The gain may walk in mid-dive.
                let before = known.unwrap_or(onset.brightness);
                let now = before * (onset.brightness / before).powf(BRIGHTNESS_RATE);
                fall.brightness = Some(now);
            }
            if is_open {
                fall.gain += onset.gain;
            }
            onsets[index] = Some(onset);
        }
        onsets[self.likeliest()]
    }

    /// Power of the ground per bin of a look, by the brightness of its time, 0 for that of now.
    pub(crate) fn backdrop(&self, look: &Look, brightness: f32) -> Backdrop {
        if !self.is_there() {
            return Backdrop::default();
        }
        let brightness = if brightness > 0.0 {
            brightness
        } else {
            self.brightness()
        };
        let fall = FALLS[self.likeliest()];
        let count = look.bin_count as usize;
        let mut expected = vec![0.0; count];
        let met = self.rays(look);
        for pair in met.windows(2) {
            let [near, far] = [pair[0], pair[1]];
            let middle_m = 0.5 * (near.range_m + far.range_m);
            let energy_rad = far.energy_below_rad - near.energy_below_rad;
            let power = brightness * falling(middle_m, fall) * energy_rad;
            let bin = |range_m: f32| {
                let bin = (range_m - look.range_start_m) / look.bin_length_m;
                bin.clamp(0.0, count as f32)
            };
            let (first, last) = (bin(near.range_m), bin(far.range_m));
            let bins = (far.range_m - near.range_m).max(1e-3) / look.bin_length_m;
            let end = (last.ceil() as usize).min(count);
            let lit = expected.iter_mut().enumerate().take(end);
            for (bin, expected) in lit.skip(first as usize) {
                let overlap = last.min(bin as f32 + 1.0) - first.max(bin as f32);
                *expected += power / bins * overlap;
            }
        }
        let mut most = widened(&expected, look, &met);
        if let Some(&last) = met.last() {
            let from_m = met[0].range_m;
            let at = |range_m: f32| brightness * falling(range_m, fall);
            self.add_slopes(&mut most, look, from_m, last.direction, at);
        }
        Backdrop { expected, most }
    }

    /// Adds the most that ground may send back beyond its onset at `from_m` where nothing is known of its height: a
    /// slope turned towards the sonar. `brightness` is power per radian at a range.
    fn add_slopes(
        &self,
        most: &mut [f32],
        look: &Look,
        from_m: f32,
        direction: Vec3,
        brightness: impl Fn(f32) -> f32,
    ) {
        let per_step = (NODE_M / look.bin_length_m).ceil() as usize;
        for (step, bins) in most.chunks_mut(per_step).enumerate() {
            let middle = (step as f32 + 0.5) * per_step as f32;
            let range_m = look.range_start_m + middle * look.bin_length_m;
            let place_m = look.pose.position_m + direction * range_m;
            if range_m > from_m && !self.field.is_known(place_m.truncate()) {
                let turned_rad = STEEPEST * look.bin_length_m / range_m;
                let slope = brightness(range_m) * turned_rad;
                bins.iter_mut().for_each(|most| *most += slope);
            }
        }
    }

    /// Where rays from the lower edge of the fan upwards meet the ground, nearest first.
    fn rays(&self, look: &Look) -> Vec<Met> {
        let plane = FanPlane::of(look);
        let end_m = look.range_start_m + look.bin_length_m * look.bin_count as f32;
        let lowest_rad = self.fan.lowest_rad();
        let mut met: Vec<Met> = Vec::with_capacity(RAYS);
        for ray in 0..RAYS {
            let elevation_rad = lowest_rad * (1.0 - 2.0 * ray as f32 / RAYS as f32);
            let direction = plane.direction(elevation_rad);
            let near_m = met.last().map_or(0.0, |met| met.range_m);
            if !(-direction.z > LEAST_DESCENT) || near_m >= end_m {
                break;
            }
            let mut range_m = near_m;
            for _ in 0..RAY_STEPS {
                let at_m = plane.position_m + direction * range_m;
                let clear_m = at_m.z - self.field.height_m(at_m.truncate());
                range_m = (range_m - clear_m / direction.z).clamp(near_m, 2.0 * end_m);
            }
            met.push(Met {
                range_m,
                descent: -direction.z,
                direction,
                energy_below_rad: self.fan.below(elevation_rad),
            });
        }
        met
    }

    /// Whether a place lies under the ground.
    pub(crate) fn hides(&self, place_m: Vec3) -> bool {
        self.is_there() && place_m.z < self.field.height_m(place_m.truncate()) - BURIED_M
    }

    /// The ground that pings measured, as flat Gaussians in order of id, four to a node. `unit` is
    /// the intensity per steradian that αρ = 1 stands for.
    pub(crate) fn published(&self, unit: f32) -> Vec<Gaussian> {
        if !self.is_proven() {
            return Vec::new();
        }
        // Of what a radian of elevation holds, the beam across takes in this much solid angle.
        let solid_angle = std::f32::consts::TAU.sqrt() * self.beam_sigma_rad;
        let range_m = (self.log_range_sum / self.shown as f32).exp();
        let here = self.brightness() * falling(range_m, FALLS[self.likeliest()]);
        let product = (here / solid_angle / unit).clamp(1e-12, 1.0);
        let scale_m = 0.2 * NODE_M;
        let asserted = self.field.measured().filter(|g| g.spread_m < MOST_SPREAD_M);
        let mut published: Vec<Gaussian> = asserted
            .flat_map(|ground| (0..4).map(move |part| (ground, part)))
            .map(|(ground, part)| {
                let corner = Vec2::new((part % 2) as f32 - 0.5, (part / 2) as f32 - 0.5);
                let place_m = ground.place_m + corner * (0.5 * NODE_M);
                Gaussian {
                    id: FIRST_ID + 4 * ground.serial + part,
                    mean_m: place_m.extend(self.field.height_m(place_m)),
                    rotation: Quat::from_rotation_arc(Vec3::Z, self.field.normal(place_m)),
                    scale_m: Vec3::new(scale_m, scale_m, THICKNESS_M),
                    opacity: product.cbrt(),
                    reflectivity: product.cbrt() * product.cbrt(),
                    sigma_m: ground.spread_m,
                    standing: Standing::Confident,
                }
            })
            .filter(Gaussian::is_sound)
            .collect();
        published.sort_unstable_by_key(|gaussian| gaussian.id);
        published
    }
}

/// A ray that meets the ground.
#[derive(Debug, Clone, Copy)]
struct Met {
    range_m: f32,
    /// Metres down per metre of range.
    descent: f32,
    direction: Vec3,
    /// Sensitivity summed up from the fan's lower edge to it, radians.
    energy_below_rad: f32,
}

/// The most that each bin may hold with the ground a little higher or deeper: a metre of height is
/// `1 / descent` metres of range.
fn widened(expected: &[f32], look: &Look, met: &[Met]) -> Vec<f32> {
    let mut met = met.iter().peekable();
    let mut most = vec![0.0; expected.len()];
    for (bin, most) in most.iter_mut().enumerate() {
        let range_m = look.range_start_m + (bin as f32 + 0.5) * look.bin_length_m;
        while met.next_if(|met| met.range_m < range_m).is_some() {}
        let Some(ray) = met.peek() else { break };
        let reach = (TOLERANCE_M / ray.descent / look.bin_length_m) as usize;
        let end = (bin + reach + 1).min(expected.len());
        let window = &expected[bin.saturating_sub(reach)..end];
        *most = window.iter().copied().fold(0.0, f32::max);
    }
    most
}

#[cfg(test)]
mod tests;
