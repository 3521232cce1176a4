//! 2198 `os_mono_profile`: one profile, received power over range.

use crate::error::ParseError;
use crate::wire::{Field, f32_at, put, u16_at, u32_at};

/// Payload without results.
pub(crate) const FIXED_BYTES: usize = field::VEHICLE_HEADING_DEG.end;

/// The most results a profile may have. The device offers 200 to 1200; what is above leaves room
/// for later firmware.
pub const MAX_RESULT_COUNT: usize = 4096;

/// Payload bytes from which the count of results can be read.
pub(crate) const RESULT_COUNT_KNOWN_BYTES: usize = field::NUM_RESULTS.end;

mod field {
    use crate::wire::Field;

    pub(super) const PING_NUMBER: Field = 0..4;
    pub(super) const START_MM: Field = 4..8;
    pub(super) const LENGTH_MM: Field = 8..12;
    pub(super) const TIMESTAMP_MS: Field = 12..16;
    pub(super) const PING_HZ: Field = 16..20;
    pub(super) const GAIN_INDEX: Field = 20..22;
    pub(super) const NUM_RESULTS: Field = 22..24;
    pub(super) const SOS_DMPS: Field = 24..26;
    pub(super) const CHANNEL_NUMBER: usize = 26;
    pub(super) const RESERVED: usize = 27;
    pub(super) const PULSE_DURATION_SEC: Field = 28..32;
    pub(super) const ANALOG_GAIN: Field = 32..36;
    pub(super) const MAX_PWR_DB: Field = 36..40;
    pub(super) const MIN_PWR_DB: Field = 40..44;
    pub(super) const TRANSDUCER_HEADING_DEG: Field = 44..48;
    pub(super) const VEHICLE_HEADING_DEG: Field = 48..52;
}

/// One profile. Result `i` of `n` covers the ranges `start_mm + length_mm · [i, i + 1)/n`, at the
/// speed of sound it names.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OsMonoProfile<'a> {
    /// Counts pings from 0 at power-up.
    pub ping_number: u32,
    /// Range at which the first result begins, in millimetres.
    pub start_mm: u32,
    /// Range from there to the end of the last result, in millimetres.
    pub length_mm: u32,
    /// Device time since power-up in milliseconds; wraps after 49.7 days.
    pub timestamp_ms: u32,
    /// Carrier frequency in hertz; 451127 on a real unit.
    pub ping_hz: u32,
    /// Gain step in use, 0 to 7.
    pub gain_index: u16,
    /// Speed of sound the device computed ranges with, in decimetres per second.
    pub sos_dmps: u16,
    /// Which of several synchronised units this is.
    pub channel_number: u8,
    /// Length of the pulse in seconds.
    pub pulse_duration_sec: f32,
    /// Gain of the receiver.
    pub analog_gain: f32,
    /// Power of result 65535, in decibels. The scale changes from ping to ping.
    pub max_pwr_db: f32,
    /// Power of result 0, in decibels.
    pub min_pwr_db: f32,
    /// Heading of the transducer in degrees.
    pub transducer_heading_deg: f32,
    /// Heading of the vehicle in degrees.
    pub vehicle_heading_deg: f32,
    /// Power over range, near to far; its length is `num_results` of the tables.
    pub pwr_results: PowerResults<'a>,
}

impl<'a> OsMonoProfile<'a> {
    /// Power of result `index` in decibels.
    #[must_use]
    pub fn power_db(&self, index: usize) -> Option<f32> {
        self.pwr_results
            .power_db(index, self.min_pwr_db, self.max_pwr_db)
    }

    /// `payload` has an allowed length.
    pub(super) fn parse(payload: &'a [u8]) -> Result<Self, ParseError> {
        let pwr_results = PowerResults::from_bytes(&payload[FIXED_BYTES..])?;
        pwr_results.check_count(u16_at(payload, field::NUM_RESULTS))?;
        Ok(Self {
            ping_number: u32_at(payload, field::PING_NUMBER),
            start_mm: u32_at(payload, field::START_MM),
            length_mm: u32_at(payload, field::LENGTH_MM),
            timestamp_ms: u32_at(payload, field::TIMESTAMP_MS),
            ping_hz: u32_at(payload, field::PING_HZ),
            gain_index: u16_at(payload, field::GAIN_INDEX),
            sos_dmps: u16_at(payload, field::SOS_DMPS),
            channel_number: payload[field::CHANNEL_NUMBER],
            pulse_duration_sec: f32_at(payload, field::PULSE_DURATION_SEC),
            analog_gain: f32_at(payload, field::ANALOG_GAIN),
            max_pwr_db: f32_at(payload, field::MAX_PWR_DB),
            min_pwr_db: f32_at(payload, field::MIN_PWR_DB),
            transducer_heading_deg: f32_at(payload, field::TRANSDUCER_HEADING_DEG),
            vehicle_heading_deg: f32_at(payload, field::VEHICLE_HEADING_DEG),
            pwr_results,
        })
    }

    pub(super) fn payload_byte_count(&self) -> usize {
        FIXED_BYTES + self.pwr_results.bytes.len()
    }

    pub(super) fn emit(&self, payload: &mut [u8]) {
        put(payload, field::PING_NUMBER, &self.ping_number.to_le_bytes());
        put(payload, field::START_MM, &self.start_mm.to_le_bytes());
        put(payload, field::LENGTH_MM, &self.length_mm.to_le_bytes());
        put(
            payload,
            field::TIMESTAMP_MS,
            &self.timestamp_ms.to_le_bytes(),
        );
        put(payload, field::PING_HZ, &self.ping_hz.to_le_bytes());
        put(payload, field::GAIN_INDEX, &self.gain_index.to_le_bytes());
        put(
            payload,
            field::NUM_RESULTS,
            &self.pwr_results.num_results().to_le_bytes(),
        );
        put(payload, field::SOS_DMPS, &self.sos_dmps.to_le_bytes());
        payload[field::CHANNEL_NUMBER] = self.channel_number;
        payload[field::RESERVED] = 0;
        put(
            payload,
            field::PULSE_DURATION_SEC,
            &self.pulse_duration_sec.to_le_bytes(),
        );
        put(payload, field::ANALOG_GAIN, &self.analog_gain.to_le_bytes());
        put(payload, field::MAX_PWR_DB, &self.max_pwr_db.to_le_bytes());
        put(payload, field::MIN_PWR_DB, &self.min_pwr_db.to_le_bytes());
        put(
            payload,
            field::TRANSDUCER_HEADING_DEG,
            &self.transducer_heading_deg.to_le_bytes(),
        );
        put(
            payload,
            field::VEHICLE_HEADING_DEG,
            &self.vehicle_heading_deg.to_le_bytes(),
        );
        payload[FIXED_BYTES..].copy_from_slice(self.pwr_results.bytes);
    }
}

/// Power over range as the wire has it: a view of little-endian u16, at most
/// [`MAX_RESULT_COUNT`] of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PowerResults<'a> {
    /// Of even length.
    bytes: &'a [u8],
}

impl<'a> PowerResults<'a> {
    /// Views `bytes` as little-endian u16.
    ///
    /// # Errors
    /// If their count is odd or above 2 · [`MAX_RESULT_COUNT`].
    pub fn from_bytes(bytes: &'a [u8]) -> Result<Self, ParseError> {
        let allowed = crate::PayloadLengths::of(crate::id::OS_MONO_PROFILE);
        let found = FIXED_BYTES + bytes.len();
        if !allowed.allow(found) {
            let message_id = crate::id::OS_MONO_PROFILE;
            return Err(ParseError::Length {
                message_id,
                found,
                allowed,
            });
        }
        Ok(Self { bytes })
    }

    /// The bytes viewed, two for each result.
    #[must_use]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Number of results.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len() / 2
    }

    /// Whether there is no result.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Raw results, near to far; 0 to 65535 over the profile's own decibel scale.
    pub fn iter(
        &self,
    ) -> impl ExactSizeIterator<Item = u16> + DoubleEndedIterator + Clone + use<'a> {
        self.bytes
            .as_chunks::<2>()
            .0
            .iter()
            .map(|pair| u16::from_le_bytes(*pair))
    }

    /// Result `index` in decibels on the scale from `min_pwr_db` to `max_pwr_db`.
    #[must_use]
    pub fn power_db(&self, index: usize, min_pwr_db: f32, max_pwr_db: f32) -> Option<f32> {
        let raw = *self.bytes.as_chunks::<2>().0.get(index)?;
        Some(power_db(u16::from_le_bytes(raw), min_pwr_db, max_pwr_db))
    }

    fn num_results(&self) -> u16 {
        // At most MAX_RESULT_COUNT, by construction.
        self.len() as u16
    }

    fn check_count(&self, stated: u16) -> Result<(), ParseError> {
        if usize::from(stated) != self.len() {
            return Err(ParseError::ResultCount {
                stated,
                held: self.len(),
            });
        }
        Ok(())
    }
}

/// A raw result in decibels: `min + raw/65535 · (max − min)`. Linear power is `10^(dB/10)`.
#[must_use]
pub fn power_db(raw: u16, min_pwr_db: f32, max_pwr_db: f32) -> f32 {
    min_pwr_db + f32::from(raw) / 65535.0 * (max_pwr_db - min_pwr_db)
}

/// Whether a profile's count of results fills a payload of `payload_bytes`; None while
/// `payload_start`, the part of it that has come, is too short to tell.
pub(crate) fn result_count_fits(payload_start: &[u8], payload_bytes: usize) -> Option<bool> {
    const COUNT: Field = field::NUM_RESULTS;
    let count = payload_start.get(COUNT)?;
    let result_count = usize::from(u16_at(count, 0..2));
    Some(FIXED_BYTES + 2 * result_count == payload_bytes)
}
