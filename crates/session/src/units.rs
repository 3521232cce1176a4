//! Whose profiles are heard, where several units send on one link or into one log.
//!
//! A unit is told by what its profiles say of it, channel, source and heading, and by its own count
//! of pings and milliseconds. Neither is enough: some packets bear a wrong source, and two units may
//! say the same of themselves. So a profile is of the unit that it goes on from; one that goes on
//! from none, or bears another label, waits until the unit that is mapped goes on or does not. What
//! does not belong to it is never mapped.

use std::collections::VecDeque;

use echosplat_firmware_protocol::OsMonoProfile;
use serde::Serialize;

use crate::config::SessionConfig;
use crate::continuity::{Advance, Stamp};

/// Headings this near are of one unit: beams are narrower, and units that look elsewhere are turned
/// by more.
const SAME_HEADING_DEG: f32 = 10.0;
/// A unit asked for by its heading may be turned by so much.
const ASKED_HEADING_DEG: f32 = 30.0;
/// So many profiles wait to show whose they are. If the unit that is mapped sent nothing meanwhile, it
/// was restarted, or says something else of itself now.
const MOST_WAITING: usize = 8;
/// So many lost ones are none to wonder at.
const FEW_PINGS: i64 = 8;
/// After more, time is off the pace by no more than this fraction: another unit's count may lie anywhere.
const FAR_OFF_SHARE: f64 = 0.02;
/// Other units that are told apart; those beyond count as the last.
const MOST_OTHERS: usize = 8;
/// Another unit is told once so many profiles of it came: fewer may be damage.
const TOLD_AFTER: u64 = 3;
/// Profiles of late that a second one of the same number is compared with.
const REMEMBERED: usize = 16;

/// What a profile says of the unit that sent it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnitLabel {
    /// As synchronised units have one each.
    pub channel: u8,
    /// Device id of the frame. Wrong on some packets.
    pub source: u8,
    /// Where the transducer looks, degrees.
    pub heading_deg: f32,
}

/// One unit that was heard.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnitHeard {
    /// What it says of itself.
    #[serde(flatten)]
    pub label: UnitLabel,
    /// Its profiles so far.
    pub profiles: u64,
    /// Whether its profiles become pings; those of others are left out.
    pub is_mapped: bool,
}

impl UnitLabel {
    pub(crate) fn of(profile: &OsMonoProfile<'_>, source: u8) -> Self {
        Self {
            channel: profile.channel_number,
            source,
            heading_deg: profile.transducer_heading_deg,
        }
    }

    fn is_like(&self, other: &Self) -> bool {
        self.channel == other.channel
            && self.source == other.source
            && looks_along(self.heading_deg, other.heading_deg, SAME_HEADING_DEG)
    }

    fn is_wanted(&self, config: &SessionConfig) -> bool {
        let heading_deg = config.heading_deg.map(|heading_deg| heading_deg as f32);
        config.channel.is_none_or(|channel| channel == self.channel)
            && config.source.is_none_or(|source| source == self.source)
            && heading_deg
                .is_none_or(|asked| looks_along(self.heading_deg, asked, ASKED_HEADING_DEG))
    }
}

/// As in `channel 1, source 2, heading 90°`.
impl std::fmt::Display for UnitLabel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            channel,
            source,
            heading_deg,
        } = self;
        write!(
            f,
            "channel {channel}, source {source}, heading {heading_deg:.0}°"
        )
    }
}

/// Headings that are no number say nothing.
fn looks_along(a_deg: f32, b_deg: f32, within_deg: f32) -> bool {
    let apart_deg = (a_deg - b_deg + 180.0).rem_euclid(360.0) - 180.0;
    apart_deg.is_nan() || apart_deg.abs() <= within_deg
}

/// A profile, as far as it says whose it is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sent {
    pub(crate) label: UnitLabel,
    pub(crate) stamp: Stamp,
    /// Of all its bytes.
    pub(crate) digest: u64,
    /// Whether the stream of the unit that is mapped has it already, or has a place for it.
    pub(crate) has_place: bool,
}

/// What becomes of a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Whose {
    Mapped,
    /// Of another unit, or of one that is not asked for.
    Other,
    /// Kept until the next ones show it.
    Waits,
}

/// What a profile that waited turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Settled {
    Mapped,
    Other,
    /// Damaged in number or time: it lies beyond those after it.
    Unconfirmed,
    /// From before, and without a place there.
    Late,
}

/// What came of the newest profile.
#[derive(Debug, Default)]
pub(crate) struct Judged {
    /// What those that waited are, oldest first: all of them, or none yet.
    pub(crate) settled: Vec<Settled>,
    pub(crate) this: Option<Whose>,
    /// Another unit that is told from now on.
    pub(crate) told: Option<UnitLabel>,
}

/// The units heard so far.
#[derive(Debug, Default)]
pub(crate) struct Units {
    mapped: Option<Track>,
    others: Vec<Track>,
    waiting: Vec<Sent>,
    /// The newest of the unit that is mapped.
    newest: VecDeque<Sent>,
}

/// Of one unit.
#[derive(Debug, Clone, Copy)]
struct Track {
    label: UnitLabel,
    /// `None` once a new session of a log begins, where it counts anew.
    last: Option<Stamp>,
    pace_ms: Option<f64>,
    profiles: u64,
}

impl Track {
    fn begun_by(sent: &Sent) -> Self {
        Self {
            label: sent.label,
            last: Some(sent.stamp),
            pace_ms: None,
            profiles: 1,
        }
    }

    /// How well a profile goes on: pings since the last one, and by how many milliseconds it is off the
    /// pace. `None` if it does not.
    fn distance_to(&self, stamp: &Stamp) -> Option<(i64, f64)> {
        let step = Advance::between(self.last.as_ref()?, stamp);
        let is_next = step.pings == 1 && step.millis >= 0;
        let is_near = (1..=FEW_PINGS).contains(&step.pings) && step.millis >= 0;
        let Some(pace_ms) = self.pace_ms else {
            return is_near.then_some((step.pings, 0.0));
        };
        let expected_ms = step.pings as f64 * pace_ms;
        let off_ms = (step.millis as f64 - expected_ms).abs();
        let most_off_ms = 5.0 + 0.5 * pace_ms + FAR_OFF_SHARE * expected_ms;
        let in_pace = match is_near {
            true => step.keeps(pace_ms),
            false => step.pings > 0 && off_ms <= most_off_ms,
        };
        (is_next || in_pace).then_some((step.pings, off_ms))
    }

    fn take(&mut self, sent: &Sent) {
        let step = self.last.map(|last| Advance::between(&last, &sent.stamp));
        if let Some(pace_ms) = step.and_then(Advance::pace) {
            let known_ms = self.pace_ms.unwrap_or(pace_ms);
            self.pace_ms = Some(known_ms + 0.25 * (pace_ms - known_ms));
        }
        // One that comes late does not turn back the count.
        if step.is_none_or(|step| step.pings > 0 || !sent.has_place) {
            self.last = Some(sent.stamp);
        }
        self.profiles += 1;
    }
}

impl Units {
    /// Says of the next profile, and of those that waited, whose they are.
    pub(crate) fn judge(&mut self, sent: Sent, config: &SessionConfig) -> Judged {
        let Some(mapped) = self.mapped else {
            return match sent.label.is_wanted(config) {
                true => {
                    self.mapped = Some(Track::begun_by(&sent));
                    self.remember(&sent);
                    Judged::this(Whose::Mapped)
                }
                false => self.other(&sent),
            };
        };
        if mapped.label.channel != sent.label.channel && mapped.last.is_some() {
            return self.other(&sent);
        }
        if mapped.last.is_none() {
            return self.judge_in_new_session(sent, &mapped);
        }
        let goes_on = mapped.distance_to(&sent.stamp);
        let is_like = mapped.label.is_like(&sent.label);
        if let Some(other) = self.established_like(&sent.label) {
            let by_other = other.distance_to(&sent.stamp);
            let is_nearer = match (goes_on, by_other) {
                (Some(own), Some(other)) => own < other || (is_like && own == other),
                (own, None) => own.is_some() || is_like,
                (None, Some(_)) => false,
            };
            if !is_nearer {
                return self.other(&sent);
            }
        }
        match (is_like, goes_on) {
            (true, _) if self.is_counterfeit(&sent) => self.other(&sent),
            (true, Some(_)) => self.is_mapped(sent),
            (true, None) if sent.has_place => self.is_mapped(sent),
            (true, None) | (false, Some(_)) => self.wait(sent),
            (false, None) => self.other(&sent),
        }
    }

    /// Nothing more comes for now: those that wait are handed on, to be judged by their order alone.
    pub(crate) fn release(&mut self) {
        self.waiting.clear();
    }

    /// A session of a log begins: units count anew and stay who they are.
    pub(crate) fn begin_log_session(&mut self) {
        for track in self.mapped.iter_mut().chain(&mut self.others) {
            track.last = None;
        }
        self.newest.clear();
    }

    /// All that were heard, the one that is mapped first.
    pub(crate) fn heard(&self) -> Vec<UnitHeard> {
        let heard = |track: &Track, is_mapped| UnitHeard {
            label: track.label,
            profiles: track.profiles,
            is_mapped,
        };
        let others = self.others.iter().filter(|track| track.is_told());
        let mapped = self.mapped.iter().map(|track| heard(track, true));
        mapped
            .chain(others.map(|track| heard(track, false)))
            .collect()
    }

    /// Another unit of this label that was told already.
    fn established_like(&self, label: &UnitLabel) -> Option<Track> {
        let others = self.others.iter().filter(|other| other.profiles > 1);
        others.copied().find(|other| other.label.is_like(label))
    }

    /// Number and time of one that came, and other contents: of a unit that counts in step.
    fn is_counterfeit(&self, sent: &Sent) -> bool {
        let same = |known: &&Sent| {
            (known.stamp.ping_number, known.stamp.timestamp_ms)
                == (sent.stamp.ping_number, sent.stamp.timestamp_ms)
        };
        let known = self.newest.iter().find(same);
        known.is_some_and(|known| known.digest != sent.digest)
    }

    fn remember(&mut self, sent: &Sent) {
        if self.newest.len() == REMEMBERED {
            self.newest.pop_front();
        }
        self.newest.push_back(*sent);
    }

    /// It goes on from those mapped: what waited is not needed to explain it.
    fn is_mapped(&mut self, sent: Sent) -> Judged {
        let mut judged = self.settle(&sent);
        self.take(&sent);
        judged.this = Some(Whose::Mapped);
        judged
    }

    fn take(&mut self, sent: &Sent) {
        self.remember(sent);
        if let Some(mapped) = &mut self.mapped {
            mapped.take(sent);
            // It may follow a compass.
            if mapped.label.is_like(&sent.label) {
                mapped.label = sent.label;
            }
        }
    }

    /// Those that waited, now that the unit that is mapped has gone on without them.
    fn settle(&mut self, next: &Sent) -> Judged {
        let waiting = std::mem::take(&mut self.waiting);
        let mut judged = Judged::default();
        for (index, sent) in waiting.iter().enumerate() {
            let Some(mapped) = self.mapped else { break };
            let is_before = Advance::between(&sent.stamp, &next.stamp).pings >= 1;
            let is_alike = mapped.label.is_like(&sent.label);
            // A wrong label in its place in the count.
            let is_mislabelled =
                !is_alike && is_before && mapped.distance_to(&sent.stamp).is_some();
            // Of its own label and going on with none: perhaps damage, which is told by its neighbours.
            let may_be_damage = is_alike && !is_in_run(&waiting, index) && !self.is_of_twin(sent);
            if is_mislabelled {
                self.take(sent);
            } else {
                let told = self.note_other(sent);
                judged.told = judged.told.or(told);
            }
            judged.settled.push(match (is_mislabelled, may_be_damage) {
                (true, _) => Settled::Mapped,
                (false, true) if is_before => Settled::Late,
                (false, true) => Settled::Unconfirmed,
                (false, false) => Settled::Other,
            });
        }
        judged
    }

    /// Whether another of the same label was seen to go on so.
    fn is_of_twin(&self, sent: &Sent) -> bool {
        let goes_on = |other: &Track| other.distance_to(&sent.stamp).is_some();
        let alike = |other: &Track| other.label.is_like(&sent.label);
        self.others
            .iter()
            .any(|other| alike(other) && goes_on(other))
    }

    fn wait(&mut self, sent: Sent) -> Judged {
        self.waiting.push(sent);
        if self.waiting.len() < MOST_WAITING {
            return Judged::this(Whose::Waits);
        }
        // The unit that is mapped is silent: it is these, under another count or label.
        let waiting = std::mem::take(&mut self.waiting);
        if let (Some(mapped), Some(last)) = (&mut self.mapped, waiting.last()) {
            mapped.label = last.label;
            mapped.last = Some(last.stamp);
            mapped.profiles += waiting.len() as u64;
        }
        Judged {
            settled: vec![Settled::Mapped; waiting.len()],
            this: None,
            told: None,
        }
    }

    /// The unit that was mapped in the session before, or if it is not there the first one.
    fn judge_in_new_session(&mut self, sent: Sent, mapped: &Track) -> Judged {
        if mapped.label.is_like(&sent.label) {
            let waiting = std::mem::take(&mut self.waiting);
            let mut judged = Judged::this(Whose::Mapped);
            for other in &waiting {
                let told = self.note_other(other);
                judged.told = judged.told.or(told);
                judged.settled.push(Settled::Other);
            }
            self.take(&sent);
            return judged;
        }
        if self.established_like(&sent.label).is_some() {
            return self.other(&sent);
        }
        self.waiting.push(sent);
        if self.waiting.len() < MOST_WAITING {
            return Judged::this(Whose::Waits);
        }
        let waiting = std::mem::take(&mut self.waiting);
        let label = waiting[0].label;
        let is_ours = |sent: &Sent| sent.label.is_like(&label);
        let settled = |sent: &Sent| match is_ours(sent) {
            true => Settled::Mapped,
            false => Settled::Other,
        };
        for sent in &waiting {
            if is_ours(sent) {
                if let Some(mapped) = &mut self.mapped {
                    mapped.label = label;
                }
                self.take(sent);
            } else {
                self.note_other(sent);
            }
        }
        Judged {
            settled: waiting.iter().map(settled).collect(),
            this: None,
            told: None,
        }
    }

    fn other(&mut self, sent: &Sent) -> Judged {
        let told = self.note_other(sent);
        Judged {
            told,
            ..Judged::this(Whose::Other)
        }
    }

    /// Counts a profile of another unit; says so when that is told first.
    fn note_other(&mut self, sent: &Sent) -> Option<UnitLabel> {
        let alike = self
            .others
            .iter()
            .position(|other| other.label.is_like(&sent.label));
        let index = match alike {
            Some(index) => {
                self.others[index].note(sent);
                index
            }
            None if self.others.len() < MOST_OTHERS => {
                self.others.push(Track::begun_by(sent));
                self.others.len() - 1
            }
            None => {
                self.others[MOST_OTHERS - 1].profiles += 1;
                MOST_OTHERS - 1
            }
        };
        let other = &self.others[index];
        (other.profiles == TOLD_AFTER).then_some(other.label)
    }
}

/// Whether one of those that waited goes on from the one before it, or the one after it from it.
fn is_in_run(waiting: &[Sent], index: usize) -> bool {
    let goes_on = |pair: &[Sent]| {
        let step = Advance::between(&pair[0].stamp, &pair[1].stamp);
        (1..=FEW_PINGS).contains(&step.pings) && step.millis >= 0
    };
    let before = index
        .checked_sub(1)
        .and_then(|from| waiting.get(from..=index));
    let after = waiting.get(index..index + 2);
    before.is_some_and(goes_on) || after.is_some_and(goes_on)
}

impl Track {
    fn is_told(&self) -> bool {
        self.profiles >= TOLD_AFTER
    }

    /// As [`Self::take`], of a unit that is not mapped: what does not go on is no unit yet.
    fn note(&mut self, sent: &Sent) {
        let goes_on = self.last.is_none() || self.distance_to(&sent.stamp).is_some();
        if !(goes_on || self.is_told()) {
            *self = Self::begun_by(sent);
            return;
        }
        self.take(sent);
        self.last = Some(sent.stamp);
    }
}

impl Judged {
    fn this(whose: Whose) -> Self {
        Self {
            this: Some(whose),
            ..Self::default()
        }
    }
}
