//! The seabed as a layer of its own: a smooth height field under what pings show of it.
//!
//! Beyond its onset the ground lights every bin, so nothing is ever dark there and its echoes would
//! breed phantoms along their arcs. Its onset is sharp, one place of the ground per ping. Heights
//! through those places tell what each bin of any ping would hold of ground alone: only what stands
//! out from that is an echo, and the layer explains the rest.
//!
//! Used only where pings show ground; asserted only where its onset follows the vehicle's height and tilt. Deliberately absent: overhangs, and ground that is not below.
//!
//! Cost: for every fourth ping an onset (0.5 ms), where none shows for every 128th; for every ping 200 stretches of range over the field, 40 µs.

mod fan_plane;
mod field;
mod onset;
mod proof;

use echosplat_measurement::{Beam, PingGeometry};
use echosplat_model::glam::{Quat, Vec2, Vec3};
use echosplat_model::{Gaussian, GaussianId, Reason, Standing, Switch, Why};

use crate::classify::certainty::NEAR_M;
use crate::detect::profile::{Backdrop, Profile};
use fan_plane::{FanEnergy, FanPlane};
use field::{Field, NODE_M, STEP_SIGMA_M};
use onset::{FALLS, Onset, Runs, falling};
use proof::Proof;

/// Pings to each asked; bounds work.
/// Every so many-th ping is asked for the ground; those between show the same of it.
const STRIDE: u32 = 4;
/// Pings where no ground is; bounds work.
/// The same after so many pings in a row that showed none.
const IDLE_STRIDE: u32 = 128;
/// Pings in a row without ground; found.
const IDLE_AFTER: u32 = 64;
/// Pings in vain; found.
/// After so many in vain, brightness may be anything again.
const DOUBTED_AFTER: u32 = 8;
/// Onsets; found.
/// Sound does not come through ground: so many onsets in a row from behind it, and what is known of it is wrong.
const DENIED_AFTER: u32 = 64;
/// Pings; found.
/// The ground is there once so many pings showed it, and this share of those that could. They also tell by what
/// power of range its brightness falls.
const LEAST_SHOWN: u32 = 24;
/// Fraction of pings; found.
const LEAST_SHARE: f32 = 0.3;
/// Metres, found: further off is something else.
/// Measurements further than this from what is known are of something else.
const OUTLIER_M: f32 = 0.6;
/// Metres ground may be off; found.
/// How far the ground may be from where it is thought to be.
const TOLERANCE_M: f32 = 0.12;
/// Slope where nothing was measured, derived: two sigma.
/// Slope that ground may have where nothing was measured: two sigma of what the field expects.
const STEEPEST: f32 = 2.0 * STEP_SIGMA_M / NODE_M;
/// Slope, found.
/// The same beyond the slope thought, where it was measured. Found; nodes of 15 onsets each leave 0.12 open at two
/// sigma before they are smoothed.
const STEEPEST_KNOWN: f32 = 0.08;
/// Stretches of range; bounds work.
/// Stretches of range that the ground is looked at in.
const MOST_STRETCHES: usize = 200;
/// Slope; found.
/// Ground that descends less is no more sharply told, metres per metre.
const LEAST_DESCENT: f32 = 0.02;
/// Steps to the ground's elevation, derived: it is smooth.
/// Steps to the elevation at which the ground is met; it is smooth.
const STEPS: usize = 2;
/// Weight of a new brightness; found.
/// What each new brightness counts.
const BRIGHTNESS_RATE: f32 = 0.12;
/// Onsets between smoothings; bounds work.
/// Onsets between smoothings of the field.
const ONSETS_PER_SMOOTHING: u32 = 16;
/// Metres of scatter; found.
/// Ground that scatters more is not asserted.
const MOST_SPREAD_M: f32 = 0.2;
/// Metres, found: deeper is not seen.
const BURIED_M: f32 = 0.3;
/// Metres, half its Gaussians' thickness; found.
const THICKNESS_M: f32 = 0.02;
/// First id of ground; layout.
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
    /// Those since the last that showed what may be ground.
    idle: u32,
    /// Whether what begins too near the end of pings to be told from a wall follows the vehicle as ground does.
    open: Proof,
    /// Onsets in a row that lie behind ground that is known.
    denied: u32,
    /// Pings that had to show the ground that others showed, and those that did.
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
            idle: 0,
            open: Proof::default(),
            denied: 0,
            able: 0,
            shown: 0,
            falls: Default::default(),
            log_range_sum: 0.0,
        }
    }

    /// Whether there is what looks like ground in view at all: it explains echoes.
    pub(crate) fn is_there(&self) -> bool {
        self.shown >= LEAST_SHOWN && self.is_shown_enough()
    }

    fn is_shown_enough(&self) -> bool {
        self.shown as f32 > LEAST_SHARE * self.able as f32
    }

    /// A first guess that others do not show is none.
    fn forget(&mut self) {
        (self.field, self.proof, self.falls) = Default::default();
        (self.able, self.shown, self.denied, self.log_range_sum) = Default::default();
    }

    /// Log likelihood ratio, nats, of ground against reverberation, if it is there.
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
            false => self.falls[self.most_likely()].brightness.unwrap_or(0.0),
        }
    }

    /// Index of the power of range that brightness falls by.
    fn most_likely(&self) -> usize {
        let gains = self.falls.iter().map(|fall| fall.gain).enumerate();
        let best = gains.reduce(|best, other| if other.1 > best.1 { other } else { best });
        best.map_or(0, |(index, _)| index)
    }

    /// Learns from a ping.
    pub(crate) fn listen(&mut self, geometry: &PingGeometry, intensity: &[f32], profile: &Profile) {
        if self.switch == Switch::Off {
            return;
        }
        self.heard = self.heard.wrapping_add(1);
        let stride = match self.idle < IDLE_AFTER {
            true => STRIDE,
            false => IDLE_STRIDE,
        };
        if !self.heard.is_multiple_of(stride) {
            return;
        }
        let plane = FanPlane::of(geometry);
        let (from, noise) = (profile.first_bin(), profile.noise);
        let near_m = geometry.range_start_m + from as f32 * geometry.bin_length_m;
        self.runs
            .fill(intensity, from, noise, near_m, geometry.bin_length_m);
        if !self.runs.can_tell(&plane, &self.fan) {
            return;
        }
        let descent = plane.descent(-self.fan.half_width_rad());
        self.in_vain = self.in_vain.saturating_add(1);
        let may_be = self.onset(&plane);
        self.idle = may_be.map_or(self.idle.saturating_add(1), |_| 0);
        if let Some(open) = may_be.filter(|onset| onset.is_open) {
            self.open.add(open.point_m, plane.position_m, descent);
        }
        let onset = may_be.filter(|onset| self.is_told(onset));
        if onset.is_some() || self.is_awaited(&plane) {
            self.able = self.able.saturating_add(1);
        }
        if self.shown < LEAST_SHOWN && self.able > LEAST_SHOWN && !self.is_shown_enough() {
            self.forget();
        }
        let Some(onset) = onset else {
            return;
        };
        self.in_vain = 0;
        if self.field.is_between(plane.position_m, onset.point_m) {
            self.denied += 1;
            if self.denied > DENIED_AFTER {
                (self.field, self.proof, self.denied) = Default::default();
            }
            return;
        }
        self.denied = 0;
        self.shown = self.shown.saturating_add(1);
        let range_m = (onset.point_m - plane.position_m).length();
        self.log_range_sum += range_m.ln();
        self.proof.add(onset.point_m, plane.position_m, descent);
        self.field.add(onset.point_m);
        if self.shown.is_multiple_of(ONSETS_PER_SMOOTHING) {
            self.field.smooth();
        }
    }

    /// Whether an onset is that of ground: a wall would have ended since, or would not follow the vehicle, or it goes on from
    /// ground that is there.
    fn is_told(&self, onset: &Onset) -> bool {
        let goes_on = || self.is_there() && self.off_m(onset).abs() < OUTLIER_M;
        !onset.is_open || self.open.is_enough() || goes_on()
    }

    /// Metres that an onset is above the ground as it is known.
    fn off_m(&self, onset: &Onset) -> f32 {
        onset.point_m.z - self.field.height_m(onset.point_m.truncate())
    }

    /// Whether the ping at hand has to show the ground, if it lies where it is thought to be.
    fn is_awaited(&self, plane: &FanPlane) -> bool {
        let edge_rad = -self.fan.half_width_rad();
        let descent = plane.descent(edge_rad);
        let depth_m = |place_m: Vec3| plane.position_m.z - self.field.height_m(place_m.truncate());
        let range_m = (0..=STEPS).fold(0.0, |range_m, _| {
            depth_m(plane.position_m + plane.direction(edge_rad) * range_m) / descent
        });
        self.shown > 0 && self.runs.reach_m().contains(&range_m)
    }

    /// The ground in the ping at hand, by the most likely power of range; learns its brightness, and the power as long as it is
    /// not settled.
    fn onset(&mut self, plane: &FanPlane) -> Option<Onset> {
        let is_unsettled = self.shown < LEAST_SHOWN;
        let settled = self.most_likely();
        let mut onsets = [None; FALLS.len()];
        for (index, &power) in FALLS.iter().enumerate() {
            if !is_unsettled && index != settled {
                continue;
            }
            // One wrong guess must not be held against everything that does not fit it.
            let is_trusted = self.in_vain <= DOUBTED_AFTER;
            let known = self.falls[index].brightness.filter(|_| is_trusted);
            let Some(onset) = self.runs.onset(plane, &self.fan, power, known) else {
                continue;
            };
            onsets[index] = Some(onset);
            if !self.is_told(&onset) {
                continue;
            }
            let off_m = self.off_m(&onset);
            let is_there = self.is_there();
            let fall = &mut self.falls[index];
            if !is_there || off_m.abs() < OUTLIER_M {
                // The gain may walk in mid-dive.
                let before = known.unwrap_or(onset.brightness);
                let now = before * (onset.brightness / before).powf(BRIGHTNESS_RATE);
                fall.brightness = Some(now);
            }
            if is_unsettled {
                fall.gain += onset.gain;
            }
        }
        onsets[self.most_likely()]
    }

    /// Power of the ground per bin of a ping, by the brightness of its time, 0 for that of now.
    pub(crate) fn backdrop(&self, geometry: &PingGeometry, brightness: f32) -> Backdrop {
        if !self.is_there() {
            return Backdrop::default();
        }
        let brightness = if brightness > 0.0 {
            brightness
        } else {
            self.brightness()
        };
        let fall = FALLS[self.most_likely()];
        let at = |range_m: f32| brightness * falling(range_m, fall);
        let mut backdrop = Backdrop {
            expected: vec![0.0; geometry.bin_count as usize],
            most: vec![0.0; geometry.bin_count as usize],
        };
        let stretches = self.stretches(geometry);
        for stretch in &stretches {
            let bins = &mut backdrop.expected[stretch.start..stretch.end];
            let power = at(stretch.range_m) * stretch.energy_rad / bins.len() as f32;
            bins.fill(power);
        }
        for stretch in &stretches {
            let reach = (TOLERANCE_M / stretch.descent / geometry.bin_length_m) as usize;
            let end = (stretch.end + reach).min(backdrop.expected.len());
            let around = &backdrop.expected[stretch.start.saturating_sub(reach)..end];
            let near = around.iter().copied().fold(0.0, f32::max);
            let steepest = if stretch.is_beyond_onset {
                stretch.steepest
            } else {
                0.0
            };
            let turned_rad = steepest * geometry.bin_length_m / stretch.range_m;
            let most = near + at(stretch.range_m) * turned_rad;
            backdrop.most[stretch.start..stretch.end].fill(most);
        }
        backdrop
    }

    /// The ground as a ping meets it, nearest first: seen where it stands above all that is nearer.
    fn stretches(&self, geometry: &PingGeometry) -> Vec<Stretch> {
        let plane = FanPlane::of(geometry);
        let count = geometry.bin_count as usize;
        let bins = count.div_ceil(MOST_STRETCHES);
        let (mut elevation_rad, mut horizon_rad) = (self.fan.lowest_rad(), f32::MIN);
        let mut below_rad = 0.0;
        let mut stretches = Vec::with_capacity(count.div_ceil(bins));
        for start in (0..count).step_by(bins) {
            let end = (start + bins).min(count);
            let far_m = geometry.range_start_m + end as f32 * geometry.bin_length_m;
            for _ in 0..STEPS {
                let at_m = plane.position_m + plane.direction(elevation_rad) * far_m;
                let depth_m = plane.position_m.z - self.field.height_m(at_m.truncate());
                elevation_rad = plane.elevation_of_ground(depth_m, far_m);
            }
            horizon_rad = elevation_rad.max(horizon_rad);
            let upto_rad = self.fan.below(horizon_rad);
            let direction = plane.direction(elevation_rad);
            let place_m = plane.position_m + direction * far_m;
            stretches.push(Stretch {
                start,
                end,
                range_m: far_m - 0.5 * (end - start) as f32 * geometry.bin_length_m,
                energy_rad: upto_rad - below_rad,
                descent: (-direction.z).max(LEAST_DESCENT),
                is_beyond_onset: upto_rad > 0.0,
                steepest: match self.field.is_known(place_m.truncate()) {
                    true => STEEPEST_KNOWN,
                    false => STEEPEST,
                },
            });
            below_rad = upto_rad;
        }
        stretches
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
        let here = self.brightness() * falling(range_m, FALLS[self.most_likely()]);
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
                    position_covariance_m2: Gaussian::known_alike_m2(ground.spread_m),
                    probability: within(NEAR_M, ground.spread_m),
                    standing: Standing::Confident,
                    why: Why::of(Reason::Ground, 0.0, 0.0),
                }
            })
            .filter(Gaussian::is_sound)
            .collect();
        published.sort_unstable_by_key(|gaussian| gaussian.id);
        published
    }
}

/// Probability that a normal error of this sigma is at most `near_m`, to 0.01: the logistic curve is as near to it.
fn within(near_m: f32, sigma_m: f32) -> f32 {
    (0.851 * near_m / sigma_m).tanh()
}

/// Bins over one stretch of ground, half-open.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    start: usize,
    end: usize,
    range_m: f32,
    /// Sensitivity summed up over the elevations at which it is seen, radians.
    energy_rad: f32,
    /// Metres down per metre of range.
    descent: f32,
    is_beyond_onset: bool,
    /// What it may rise towards the sonar beyond what is thought, metres per metre.
    steepest: f32,
}

#[cfg(test)]
mod tests;
