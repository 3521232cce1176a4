//! What came, what was taken, and what was left out and why.

use serde::Serialize;

/// Profiles left out, by reason. Together with the pings they add up to the profiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct ProfilesRejected {
    /// Payload that is no profile, or bins that do not fit its length.
    pub payload: u64,
    /// Of another channel than the one listened to.
    pub other_channel: u64,
    /// Of another unit of that channel.
    pub other_unit: u64,
    /// Start or length of the range outside 0 to 300 m, or length 0.
    pub range: u64,
    /// No bins.
    pub bins: u64,
    /// Speed of sound that no water has.
    pub speed_of_sound: u64,
    /// Carrier frequency above 10 MHz.
    pub frequency: u64,
    /// Pulse duration that is negative, longer than 0.1 s, or no number.
    pub pulse: u64,
    /// Gain index above 15.
    pub gain: u64,
    /// Decibel scale that is not finite, upside down or beyond ±200 dB.
    pub scale: u64,
    /// Ping number and time that were already there.
    pub duplicate: u64,
    /// Older than what was already there, and without a place there: further back than a link's
    /// disorder, or the number of another ping.
    pub late: u64,
    /// A jump in number, time or settings that the next profile did not confirm.
    pub unconfirmed: u64,
}

impl ProfilesRejected {
    /// All reasons together.
    #[must_use]
    pub fn total(&self) -> u64 {
        let Self {
            payload,
            other_channel,
            other_unit,
            duplicate,
            late,
            unconfirmed,
            ..
        } = *self;
        payload + other_channel + other_unit + self.implausible() + duplicate + late + unconfirmed
    }

    /// Whole profiles that say what no sonar can have: settings or decibel scale.
    #[must_use]
    pub fn implausible(&self) -> u64 {
        self.settings() + self.scale
    }

    /// Settings outside what a sonar can have, of any kind.
    #[must_use]
    pub fn settings(&self) -> u64 {
        let Self {
            range,
            bins,
            speed_of_sound,
            frequency,
            pulse,
            gain,
            ..
        } = *self;
        range + bins + speed_of_sound + frequency + pulse + gain
    }
}

/// What came, what was taken, and what was left out and why, since the session was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct SessionCounters {
    /// Bytes given to the session.
    pub bytes_received: u64,
    /// Frames whose checksum was right.
    pub frames_good: u64,
    /// Frame candidates that were none: bad checksum, impossible length, cut off.
    pub frames_bad: u64,
    /// Bytes that belong to no good frame.
    pub bytes_skipped: u64,
    /// Good frames of an id that is not known, or whose payload does not fit its id.
    pub frames_unknown: u64,
    /// Good frames of a known id that this session has no use for.
    pub frames_unused: u64,
    /// Profiles in good frames: pings, rejected ones, and at most one that waits for the next.
    pub profiles: u64,
    /// Pings made of them.
    pub pings: u64,
    /// Profiles left out.
    pub profiles_rejected: ProfilesRejected,
    /// Of these, pings that came after one that was made later. They are pings like any others.
    pub pings_late: u64,
    /// Ping numbers that were skipped over and have not come late since.
    pub pings_missing: u64,
    /// Profiles that did not show the settings asked for.
    pub settings_mismatched: u64,
    /// Requests for settings sent again.
    pub resends: u64,
    /// Reboots of the device: number and time both fell back.
    pub reboots: u64,
    /// Times the host's clock was seen to step, or a link's delay to change for good.
    pub clock_steps: u64,
    /// Requests the device acknowledged.
    pub acks: u64,
    /// Requests the device refused.
    pub nacks: u64,
    /// Sessions begun in a log.
    pub log_sessions: u64,
    /// JSON packets of a log that could not be read.
    pub json_bad: u64,
    /// NMEA wrappers, counted and not used.
    pub nmea: u64,
    /// `MAVLink` wrappers, counted and not used.
    pub mavlink: u64,
    /// Status messages of the device.
    pub status: u64,
}
