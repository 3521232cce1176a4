//! Profiles: which unit they are of, and what becomes of those of the one that is mapped.

use bytes::Bytes;
use echosplat_firmware_protocol::{Frame, Message, OsMonoProfile};
use echosplat_model::Timestamp;

use super::{Core, Warned};
use crate::event::SessionEvent;
use crate::handshake::Confirmation;
use crate::profile;
use crate::units::{Sent, Settled, UnitLabel, Whose};

impl Core {
    pub(super) fn handle_profile(
        &mut self,
        profile: &OsMonoProfile<'_>,
        frame: &Frame<'_>,
        now: Timestamp,
    ) {
        self.counters.profiles += 1;
        if profile::check(profile).is_err() {
            return self.admit(profile, frame, now);
        }
        let label = UnitLabel::of(profile, frame.src_device_id());
        let sent = Sent {
            label,
            stamp: profile::stamp(profile),
            digest: fnv1a(frame.payload()),
            has_place: self.stream.has_place_for(profile),
        };
        let judged = self.units.judge(sent, &self.config);
        if let Some(other) = judged.told {
            self.tell_other_unit(&other);
        }
        let is_kept = !matches!(judged.this, Some(Whose::Mapped | Whose::Other));
        if is_kept {
            let bytes = Bytes::copy_from_slice(frame.bytes());
            self.waiting.push((bytes, now));
        }
        if !judged.settled.is_empty() {
            self.settle_waiting(&judged.settled);
        }
        match judged.this {
            Some(Whose::Mapped) => self.admit(profile, frame, now),
            Some(Whose::Other) => self.leave_out(&label),
            Some(Whose::Waits) | None => {}
        }
    }

    fn tell_other_unit(&mut self, other: &UnitLabel) {
        let text = match self.units.heard().first().filter(|unit| unit.is_mapped) {
            Some(mapped) => format!(
                "another unit is heard ({other}) and left out: the one that is mapped has {}",
                mapped.label
            ),
            None => format!("a unit is heard that is not asked for: {other}"),
        };
        self.events.push_back(SessionEvent::Warning(text));
    }

    fn leave_out(&mut self, label: &UnitLabel) {
        let mapped = self.units.heard().first().map(|unit| unit.label.channel);
        let listened = mapped.or(self.config.channel);
        let rejected = &mut self.counters.profiles_rejected;
        match listened.is_some_and(|channel| channel != label.channel) {
            true => rejected.other_channel += 1,
            false => rejected.other_unit += 1,
        }
    }

    /// What those that waited are, oldest first.
    pub(super) fn settle_waiting(&mut self, settled: &[Settled]) {
        let waiting = std::mem::take(&mut self.waiting);
        for ((bytes, arrival), settled) in waiting.iter().zip(settled) {
            let rejected = &mut self.counters.profiles_rejected;
            match settled {
                Settled::Mapped => {}
                Settled::Other => rejected.other_unit += 1,
                Settled::Unconfirmed => rejected.unconfirmed += 1,
                Settled::Late => rejected.late += 1,
            }
            if *settled != Settled::Mapped {
                continue;
            }
            let frame = Frame::from_bytes(bytes).ok();
            let message = frame.and_then(|frame| Some((Message::parse(&frame).ok()?, frame)));
            if let Some((Message::OsMonoProfile(profile), frame)) = message {
                self.admit(&profile, &frame, *arrival);
            }
        }
    }

    /// A profile of the unit that is mapped, as far as can be told.
    fn admit(&mut self, profile: &OsMonoProfile<'_>, frame: &Frame<'_>, now: Timestamp) {
        if let Some(handshake) = &mut self.handshake {
            match handshake.profile(profile, &self.config, now) {
                Confirmation::Confirmed => self.events.push_back(SessionEvent::Configured),
                Confirmation::AsBefore => {}
                Confirmation::Mismatch => self.counters.settings_mismatched += 1,
                Confirmation::Disputed => {
                    self.counters.settings_mismatched += 1;
                    let text = "somebody else has changed the device's settings; asking again";
                    self.warn_once(Warned::Disputed, text.to_owned());
                }
            }
        }
        let events = &mut self.events;
        let taken = self.stream.insert(
            profile,
            frame,
            (&self.config, now),
            &mut self.counters,
            &mut |event| events.push_back(event),
        );
        if let Err(reason) = taken {
            self.first_refusal.get_or_insert_with(|| reason.to_string());
        }
    }
}

/// FNV-1a of 64 bits: contents that differ have different digests.
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}
