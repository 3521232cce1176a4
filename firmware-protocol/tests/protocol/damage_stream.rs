//! Streams of intact frames with damage strewn between them, from a seed.

use std::collections::BTreeSet;

use echosplat_firmware_protocol::{Message, OsMonoProfile, PowerResults, id};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::reference::{Candidate, candidate};

/// What lies between two intact frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Damage {
    /// 1 to 64 random bytes.
    StrayBytes,
    /// One byte 42.
    StrayB,
    /// The bytes 42 52.
    StrayStart,
    /// A header that claims 0 to 65535 bytes.
    FalseHeader,
    /// A frame without its end.
    CutFrame,
    /// A frame without its beginning.
    HeadlessFrame,
    /// A frame with one byte missing.
    DroppedByte,
    /// A frame with 1 to 8 bits flipped.
    FlippedBits,
    /// A frame with another length in its header.
    DamagedLength,
}

impl Damage {
    pub(crate) const ALL: [Self; 9] = [
        Self::StrayBytes,
        Self::StrayB,
        Self::StrayStart,
        Self::FalseHeader,
        Self::CutFrame,
        Self::HeadlessFrame,
        Self::DroppedByte,
        Self::FlippedBits,
        Self::DamagedLength,
    ];
}

/// Intact frames, and the damaged bytes before each and after the last.
pub(crate) struct DamagedStream {
    rng: ChaCha8Rng,
    kinds: Vec<Damage>,
    bin_count: usize,
    pub frames: Vec<Vec<u8>>,
    /// One more than there are frames; empty where nothing is damaged.
    pub gaps: Vec<Vec<u8>>,
    /// Gaps made anew because a sum over them was right by chance.
    pub coincidences: usize,
}

impl DamagedStream {
    /// `frame_count` intact frames, most of them profiles of `bin_count` results. About two gaps
    /// in three have damage of one of `kinds`.
    ///
    /// Sixteen bits of sum pass one damaged frame in some 65536, and any decoder would take it:
    /// such gaps are made anew.
    pub(crate) fn new(seed: u64, frame_count: usize, bin_count: usize, kinds: &[Damage]) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        let mut stream = Self {
            rng,
            kinds: kinds.to_vec(),
            bin_count,
            frames: Vec::new(),
            gaps: Vec::new(),
            coincidences: 0,
        };
        stream.frames = (0..frame_count)
            .map(|index| stream.frame(index as u32))
            .collect();
        stream.gaps = (0..=frame_count).map(|_| stream.gap()).collect();
        loop {
            let chance = stream.gaps_with_a_right_sum();
            if chance.is_empty() {
                return stream;
            }
            stream.coincidences += chance.len();
            for gap in chance {
                stream.gaps[gap] = stream.gap();
            }
        }
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (gap, frame) in self.gaps.iter().zip(&self.frames) {
            bytes.extend_from_slice(gap);
            bytes.extend_from_slice(frame);
        }
        bytes.extend_from_slice(&self.gaps[self.frames.len()]);
        bytes
    }

    pub(crate) fn damaged_byte_count(&self) -> usize {
        self.gaps.iter().map(Vec::len).sum()
    }

    fn gaps_with_a_right_sum(&self) -> BTreeSet<usize> {
        let bytes = self.bytes();
        let mut found = BTreeSet::new();
        let mut at = 0;
        for (index, gap) in self.gaps.iter().enumerate() {
            let starts = at..at + gap.len();
            if starts
                .into_iter()
                .any(|at| matches!(candidate(&bytes[at..]), Candidate::Intact(_)))
            {
                found.insert(index);
            }
            at += gap.len() + self.frames.get(index).map_or(0, Vec::len);
        }
        found
    }

    fn frame(&mut self, ping_number: u32) -> Vec<u8> {
        match self.rng.random_range(0..20) {
            0 => encoded(&Message::Nop),
            1 => encoded(&Message::Ack {
                acked_id: id::SET_SPEED_OF_SOUND,
            }),
            _ => self.profile(ping_number),
        }
    }

    fn profile(&mut self, ping_number: u32) -> Vec<u8> {
        let mut raw = vec![0; 2 * self.bin_count];
        self.rng.fill(raw.as_mut_slice());
        let profile = OsMonoProfile {
            ping_number,
            start_mm: 500,
            length_mm: 10_000,
            timestamp_ms: ping_number.wrapping_mul(17),
            ping_hz: 451_127,
            gain_index: self.rng.random_range(0..8),
            sos_dmps: 15_000,
            channel_number: 0,
            pulse_duration_sec: 2.5e-5,
            analog_gain: 1.0,
            max_pwr_db: self.rng.random_range(40.0..75.0),
            min_pwr_db: self.rng.random_range(-45.0..-20.0),
            transducer_heading_deg: 0.0,
            vehicle_heading_deg: 0.0,
            pwr_results: PowerResults::from_bytes(&raw).unwrap(),
        };
        encoded(&Message::OsMonoProfile(profile))
    }

    fn gap(&mut self) -> Vec<u8> {
        if self.kinds.is_empty() || self.rng.random_ratio(1, 3) {
            return Vec::new();
        }
        let kind = self.kinds[self.rng.random_range(0..self.kinds.len())];
        self.damage(kind)
    }

    fn damage(&mut self, kind: Damage) -> Vec<u8> {
        let mut frame = self.profile(0);
        match kind {
            Damage::StrayBytes => self.random_bytes(1..65),
            Damage::StrayB => b"B".to_vec(),
            Damage::StrayStart => b"BR".to_vec(),
            Damage::FalseHeader => self.false_header(),
            Damage::CutFrame => {
                frame.truncate(self.rng.random_range(1..frame.len()));
                frame
            }
            Damage::HeadlessFrame => frame.split_off(self.rng.random_range(1..frame.len())),
            Damage::DroppedByte => {
                frame.remove(self.rng.random_range(0..frame.len()));
                frame
            }
            Damage::FlippedBits => {
                for _ in 0..self.rng.random_range(1..=8) {
                    let at = self.rng.random_range(0..frame.len());
                    frame[at] ^= 1 << self.rng.random_range(0..8);
                }
                frame
            }
            Damage::DamagedLength => {
                frame[2..4].copy_from_slice(&self.rng.random::<u16>().to_le_bytes());
                frame
            }
        }
    }

    /// Of an id of the tables or any other, with a length that may or may not be allowed, and
    /// perhaps some bytes of payload.
    fn false_header(&mut self) -> Vec<u8> {
        const IDS: [u16; 8] = [0, 1, 3, 10, 12, 150, 2197, 2198];
        let known = IDS[self.rng.random_range(0..IDS.len())];
        let message_id = if self.rng.random() {
            known
        } else {
            self.rng.random()
        };
        let payload_length: u16 = match self.rng.random_range(0..3) {
            0 => self.rng.random_range(0..100),
            1 => self.rng.random_range(0..4000),
            _ => self.rng.random(),
        };
        let mut header = b"BR".to_vec();
        header.extend(payload_length.to_le_bytes());
        header.extend(message_id.to_le_bytes());
        header.extend([1, 0]);
        header.extend(self.random_bytes(0..40));
        header
    }

    fn random_bytes(&mut self, byte_counts: std::ops::Range<usize>) -> Vec<u8> {
        let mut bytes = vec![0; self.rng.random_range(byte_counts)];
        self.rng.fill(bytes.as_mut_slice());
        bytes
    }
}

fn encoded(message: &Message<'_>) -> Vec<u8> {
    let mut bytes = vec![0; message.encoded_byte_count()];
    message.encode(1, 0, &mut bytes).unwrap();
    bytes
}
