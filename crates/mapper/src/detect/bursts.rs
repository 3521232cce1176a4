//! Pulses of another sonar: what one ping hears where the ping before, whose beam saw the same, heard nothing like it.
//!
//! Cost: the bins of a ping times twice those that an echo is widened by.

use echosplat_measurement::PingGeometry;

/// Ratio of power, derived: 12 dB beam, 6 dB speckle.
/// What two pings hear of one place differs by at most this: 12 dB of the beam, if it turned by its width between
/// them, and 6 dB of speckle.
const MOST_BETWEEN_PINGS: f32 = 63.0;
/// Metres between pings; found.
/// Beyond this move between pings an echo may be elsewhere, metres.
const MOST_MOVE_M: f32 = 0.05;

/// Remembers the ping before.
#[derive(Debug, Default)]
pub(crate) struct Bursts {
    before: Option<(PingGeometry, Vec<f32>)>,
}

impl Bursts {
    /// Runs of bins from `blank` on, half-open, that are no echoes: 18 dB above all that the ping before heard within
    /// `widen` bins. None where the pings do not see the same.
    pub(crate) fn runs(
        &mut self,
        geometry: &PingGeometry,
        intensity: &[f32],
        blank: usize,
        widen: usize,
    ) -> Box<[(u32, u32)]> {
        let before = self.before.take();
        let mut runs: Vec<(u32, u32)> = Vec::new();
        if let Some((_, heard)) = before.filter(|(then, _)| sees_alike(geometry, then)) {
            for (bin, &power) in intensity.iter().enumerate().skip(blank) {
                let around = bin.saturating_sub(widen)..(bin + widen + 1).min(heard.len());
                let most = heard.get(around).unwrap_or_default();
                let most = most.iter().copied().fold(0.0, f32::max);
                let is_burst = most > 0.0 && power > MOST_BETWEEN_PINGS * most;
                match runs.last_mut() {
                    _ if !is_burst => {}
                    Some((_, end)) if *end as usize == bin => *end += 1,
                    _ => runs.push((bin as u32, bin as u32 + 1)),
                }
            }
        }
        self.before = Some((*geometry, intensity.to_vec()));
        runs.into()
    }
}

/// Whether two pings have the same bins and beams at most a beam's width and a small move apart.
fn sees_alike(now: &PingGeometry, then: &PingGeometry) -> bool {
    let is_same = |a: f32, b: f32| (a - b).abs() <= f32::EPSILON * a.abs();
    let turned = now.pose.axes.x_axis.dot(then.pose.axes.y_axis).abs();
    now.bin_count == then.bin_count
        && is_same(now.bin_length_m, then.bin_length_m)
        && is_same(now.range_start_m, then.range_start_m)
        && turned <= now.beam.azimuth_width_deg.to_radians()
        && now.pose.axes.x_axis.dot(then.pose.axes.x_axis) > 0.0
        && now.pose.position_m.distance(then.pose.position_m) <= MOST_MOVE_M
}

#[cfg(test)]
mod tests {
    use echosplat_measurement::{Beam, PingPose};
    use echosplat_model::glam::{Mat3, Vec3};

    use super::*;

    fn geometry(heading_deg: f32) -> PingGeometry {
        PingGeometry {
            pose: PingPose {
                position_m: Vec3::ZERO,
                axes: Mat3::from_rotation_z(heading_deg.to_radians()),
                drift_per_m: Vec3::ZERO,
                reference_range_m: 5.0,
            },
            range_start_m: 0.0,
            bin_length_m: 0.02,
            bin_count: 500,
            range_variance_m2: 1e-4,
            azimuth_variance_rad2: 0.0,
            beam: Beam::default(),
        }
    }

    /// Noise of 1, an echo that a beam at its middle hears with 100, and more besides.
    fn heard(echo: f32, more: &[(usize, f32)]) -> Vec<f32> {
        let mut powers = vec![1.0; 500];
        powers[200..203].fill(echo);
        for &(bin, power) in more {
            powers[bin] = power;
        }
        powers
    }

    #[test]
    fn a_pulse_at_another_range_is_told_and_an_echo_that_comes_into_the_beam_is_not() {
        let mut bursts = Bursts::default();
        let mut runs = |heading_deg, powers: &[f32]| {
            bursts.runs(&geometry(heading_deg), powers, 10, 4).to_vec()
        };
        assert!(runs(0.0, &heard(6.0, &[])).is_empty());
        assert!(runs(0.5, &heard(100.0, &[])).is_empty());
        let loud = [(5, 1e4), (300, 1e4), (301, 1e3), (400, 60.0)];
        assert_eq!(runs(1.0, &heard(100.0, &loud)), [(300, 302)]);
        // What stays is an echo, and what comes into view after a turn may be.
        assert!(runs(1.5, &heard(100.0, &loud[1..])).is_empty());
        assert!(runs(3.5, &heard(100.0, &[(350, 1e4)])).is_empty());
    }

    #[test]
    fn silence_before_tells_nothing() {
        let mut bursts = Bursts::default();
        bursts.runs(&geometry(0.0), &[0.0; 500], 0, 4);
        assert!(
            bursts
                .runs(&geometry(0.0), &heard(100.0, &[]), 0, 4)
                .is_empty()
        );
    }
}
