//! A speed of sound other than the one that the pings report.

use echosplat_model::PingSettings;

/// How far the true speed of sound is from the reported one.
///
/// Near the surface sound goes at 1,400 m/s (fresh water, freezing) to 1,550 m/s (a warm sea), by the equations
/// of Chen and Millero (1977): a unit that was told 1,500 m/s is up to 7 % wrong. Each degree more adds
/// 2 to 5 m/s, so that it changes on the way through a thermocline.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SoundSpeed {
    /// True over reported speed, less 1, at the first ping; −0.1 to 0.1. Where sound is faster than
    /// reported, everything seems nearer.
    pub error: f64,
    /// What of it has been added by the last ping, in even steps; −0.1 to 0.1.
    pub drift: f64,
}

impl SoundSpeed {
    /// The window of a ping as it truly lies in the water; `elapsed` is the share of the dive that
    /// has passed.
    pub(crate) fn in_water(&self, reported: &PingSettings, elapsed: f64) -> PingSettings {
        let error = self.error + self.drift * elapsed.clamp(0.0, 1.0);
        if !(error.abs() > 0.0) {
            return *reported;
        }
        reported.with_speed_of_sound(reported.speed_of_sound_mps * (1.0 + error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_reaches_as_far_as_sound_goes_in_its_time() {
        let reported = PingSettings {
            range_start_m: 1.0,
            range_length_m: 9.0,
            bin_count: 450,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 451_127.0,
            pulse_duration_s: 2e-5,
            gain_index: 0,
        };
        let sound = SoundSpeed {
            error: 0.015,
            drift: -0.005,
        };
        let ends_m = [0.0, 0.5, 1.0].map(|e| sound.in_water(&reported, e).range_end_m());
        for (end_m, expected) in ends_m.iter().zip([10.15, 10.125, 10.1]) {
            assert!((end_m - expected).abs() < 1e-9, "{end_m}");
        }
        let start = sound.in_water(&reported, 0.0);
        assert!((start.range_start_m - 1.015).abs() < 1e-12);
        assert!((start.speed_of_sound_mps - 1522.5).abs() < 1e-9);
        assert_eq!(SoundSpeed::default().in_water(&reported, 0.3), reported);
    }
}
