//! A simulated ping as the frame a real unit sends.

use echosplat_firmware_protocol::{Message, OsMonoProfile, PowerResults};

use super::SimulatedPing;

impl SimulatedPing {
    /// The ping as an `os_mono_profile` frame from device `device_id`. `None` if it has more bins
    /// than a frame holds.
    #[must_use]
    pub fn frame(&self, device_id: u8) -> Option<Vec<u8>> {
        let results: Vec<u8> = self
            .profile
            .pwr_results
            .iter()
            .flat_map(|raw| raw.to_le_bytes())
            .collect();
        let settings = &self.settings;
        let millimetres = |length_m: f64| (length_m * 1e3).round() as u32;
        let message = Message::OsMonoProfile(OsMonoProfile {
            ping_number: self.sequence as u32,
            start_mm: millimetres(settings.range_start_m),
            length_mm: millimetres(settings.range_length_m),
            timestamp_ms: self.device_time_ms,
            ping_hz: settings.frequency_hz as u32,
            gain_index: settings.gain_index.max(0) as u16,
            sos_dmps: (settings.speed_of_sound_mps * 10.0).round() as u16,
            channel_number: 0,
            pulse_duration_sec: settings.pulse_duration_s as f32,
            analog_gain: analog_gain(settings.gain_index),
            max_pwr_db: self.profile.max_pwr_db,
            min_pwr_db: self.profile.min_pwr_db,
            transducer_heading_deg: 0.0,
            vehicle_heading_deg: 0.0,
            pwr_results: PowerResults::from_bytes(&results).ok()?,
        });
        encoded(&message, device_id)
    }
}

/// Factor on amplitude by gain index. 0 and 4 to 7 as units of this family reported them; 1 to 3,
/// which none was seen to use, in equal ratios between.
fn analog_gain(gain_index: i16) -> f32 {
    const BY_INDEX: [f32; 8] = [5.25, 10.19, 19.78, 38.4, 74.55, 142.8, 242.0, 464.6];
    BY_INDEX[usize::from(gain_index.clamp(0, 7).unsigned_abs())]
}

/// The message as a frame from `device_id` to any host.
pub(crate) fn encoded(message: &Message<'_>, device_id: u8) -> Option<Vec<u8>> {
    let mut bytes = vec![0; message.encoded_byte_count()];
    let written = message.encode(device_id, 0, &mut bytes).ok()?;
    bytes.truncate(written);
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::analog_gain;
    use crate::sonar::gain::gain_db;

    #[test]
    fn gains_are_those_of_real_units() {
        let gains = [-1, 0, 4, 7, 8].map(analog_gain).map(f32::to_bits);
        let expected = [5.25, 5.25, 74.55, 464.6, 464.6_f32].map(f32::to_bits);
        assert_eq!(gains, expected);
    }

    #[test]
    fn what_is_reported_of_the_gain_differs_from_it_by_up_to_1_5_db_a_step() {
        let error_db = |index: i16| {
            let reported = analog_gain(index + 1) / analog_gain(index);
            20.0 * f64::from(reported).log10() - (gain_db(index + 1) - gain_db(index))
        };
        let errors_db = [4, 5, 6].map(error_db);
        assert!(errors_db.iter().all(|error_db| error_db.abs() < 1.55));
        assert!(errors_db.iter().any(|error_db| error_db.abs() > 1.4));
    }
}
