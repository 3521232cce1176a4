//! What stands between a source of poses and the join: one vehicle, one clock, one track.
//!
//! Poses of a live source may be stamped by a clock that is wrong or steps, may come from a second
//! publisher with another opinion, and may jump when the estimator resets. [`PoseGuard`] follows one
//! track. A pose that does not continue it, by place, stamp or epoch, is held: if those after it go on from it and the
//! track itself is silent, the track has moved; if the track goes on, the pose was an outlier or another publisher's and is
//! refused. How many have to go on depends on how common such poses were (`odds.rs`). A track that moved begins a new
//! epoch, unless only its stamps are a little ahead. No input, no output and no clock: poses come in with
//! the time they arrived, so that a recording is judged as the dive was.

mod odds;
mod track;

use echosplat_model::{StampedPose, Timestamp};
use serde::Serialize;

use crate::{ArrivedPose, StampClock};
use odds::{Odds, Preference};
use track::{Break, GoesOn, Rival, Track, between, lead_s};

/// Refusals that make another publisher; found.
/// So many refusals of one kind within a dive are another publisher and not outliers.
const SECOND_SOURCE_POSES: u64 = 5;

/// What became of poses, and where the track stands.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct GuardReport {
    /// Counts the tracks; poses of two epochs are never mixed.
    pub epoch: u32,
    /// Why the newest epoch began.
    pub epoch_reason: Option<String>,
    /// Poses refused since they are stamped 0, which is no time.
    pub stamps_zero: u64,
    /// Poses refused since their stamp is far from where the clock is.
    pub stamps_far: u64,
    /// Poses refused since they lie far from the track, which goes on without them.
    pub off_track: u64,
    /// How far the newest of these lay from the track, metres.
    pub off_track_m: f64,
    /// Poses refused since they are of another epoch of their source than the track, which goes on without them.
    pub other_epochs: u64,
    /// The epoch of the newest of these.
    pub other_epoch: Option<u32>,
    /// How far it lay from the track, metres.
    pub other_epoch_m: f64,
    /// By how much the stamp of the newest pose refused for it was further ahead than those of the track, seconds.
    pub stamp_off_s: f64,
    /// Poses as old as, or older than, one that was taken.
    pub out_of_order: u64,
    /// Added to the stamps since their clock stepped, seconds.
    pub clock_shift_s: f64,
    /// How far stamps lead their arrival, seconds, at the least delay of late; negative if they lag.
    /// 0 where the data have a clock of their own.
    pub lead_s: f64,
    /// For how long poses have been the same to the last bit, seconds.
    pub still_s: f64,
}

impl GuardReport {
    /// Whether a second publisher sends poses of its own.
    #[must_use]
    pub fn has_second_source(&self) -> bool {
        self.off_track >= SECOND_SOURCE_POSES
    }

    /// Whether poses of another epoch come among those of the track.
    #[must_use]
    pub fn has_other_epochs(&self) -> bool {
        self.other_epochs >= SECOND_SOURCE_POSES
    }
}

/// A pose that is taken, and whether the join has to forget those before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Guarded {
    /// It goes on from the one before.
    Pose(StampedPose),
    /// The clock of the poses went back: what comes now lies before what is held.
    ClockWentBack,
}

/// Follows one track of poses.
#[derive(Debug)]
pub struct PoseGuard {
    clock: StampClock,
    track: Option<Track>,
    /// Where the clock of the pings stepped, the track until then.
    former: Option<Track>,
    rival: Option<Rival>,
    odds: Odds,
    preference: Preference,
    report: GuardReport,
}

impl PoseGuard {
    /// With [`StampClock::Host`] stamps are held against the time of arrival, and a jump begins a new
    /// epoch. With [`StampClock::Data`] arrival says nothing, and jumps are the data's own, as between
    /// the views of a simulated dive.
    #[must_use]
    pub fn new(clock: StampClock) -> Self {
        Self {
            clock,
            track: None,
            former: None,
            rival: None,
            odds: Odds::default(),
            preference: Preference::default(),
            report: GuardReport::default(),
        }
    }

    /// Judges the next pose; `take` gets what is to be joined with pings, in order.
    pub fn push(&mut self, mut arrived: ArrivedPose, take: &mut dyn FnMut(Guarded)) {
        if self.is_unstamped(&arrived) {
            self.report.stamps_zero += 1;
            return;
        }
        let shift_s = self.report.clock_shift_s;
        arrived.pose.time = arrived.pose.time.offset_by(shift_s);
        let Some(track) = &self.track else {
            return match self.former.is_some() {
                true => self.after_step(arrived, take),
                false => self.begin(&[arrived], take),
            };
        };
        match track.break_of(&arrived, self.clock) {
            None => self.go_on(arrived, take),
            Some(Break::Order) => {
                self.report.out_of_order += 1;
                self.odds.refused(1);
                self.follows_other_stamps(&arrived, take);
            }
            Some(found) => self.doubt(arrived, found, take),
        }
    }

    /// The clock of the pings stepped. Whether that of the poses stepped with it, the next ones tell.
    pub fn clock_stepped(&mut self) {
        self.former = self.track.take().or(self.former.take());
        self.rival = None;
        self.next_epoch("the clock of the pings stepped".to_owned());
    }

    /// No more poses come: those held that only their stamps set apart go on.
    pub fn finish(&mut self, take: &mut dyn FnMut(Guarded)) {
        let is_early = |rival: &mut Rival| rival.found() == Break::Early;
        if let Some(rival) = self.rival.take_if(is_early) {
            self.track_moved(rival, take);
        }
    }

    /// What became of poses so far.
    #[must_use]
    pub fn report(&self) -> &GuardReport {
        &self.report
    }

    /// Whether nobody filled in its stamp. A clock of the data's own may begin at 0, and goes on.
    fn is_unstamped(&self, arrived: &ArrivedPose) -> bool {
        let newest = self.track.as_ref().map(|track| track.newest().pose.time);
        arrived.pose.time == Timestamp::ZERO
            && (self.clock == StampClock::Host || newest == Some(Timestamp::ZERO))
    }

    fn begin(&mut self, poses: &[ArrivedPose], take: &mut dyn FnMut(Guarded)) {
        self.report.still_s = 0.0;
        for arrived in poses {
            match &mut self.track {
                Some(track) => track.extend(arrived),
                None => self.track = Some(Track::new(arrived)),
            }
            self.hand_on(arrived, take);
        }
    }

    fn hand_on(&self, arrived: &ArrivedPose, take: &mut dyn FnMut(Guarded)) {
        take(Guarded::Pose(StampedPose {
            epoch: self.report.epoch,
            ..arrived.pose
        }));
    }

    fn go_on(&mut self, arrived: ArrivedPose, take: &mut dyn FnMut(Guarded)) {
        // The track is alive: whatever was held is not it.
        if let Some(rival) = self.rival.take() {
            self.refuse(&rival);
            if self.follows_other_stamps(rival.newest(), take) {
                return;
            }
        }
        self.odds.taken(1);
        self.preference.taken();
        let Some(track) = &mut self.track else { return };
        track.extend(&arrived);
        self.report.still_s = track.still_s();
        if self.clock == StampClock::Host {
            self.report.lead_s = track.lead_s();
        }
        self.hand_on(&arrived, take);
    }

    fn refuse(&mut self, rival: &Rival) {
        let count = rival.len() as u64;
        self.odds.refused(count);
        let newest = rival.newest();
        match rival.found() {
            Break::Jump { metres } => {
                self.report.off_track += count;
                self.report.off_track_m = metres;
            }
            Break::Epoch => {
                self.report.other_epochs += count;
                self.report.other_epoch = Some(newest.pose.epoch);
                let away_m = |track: &Track| between(track.newest(), newest).0;
                self.report.other_epoch_m = self.track.as_ref().map_or(0.0, away_m);
            }
            Break::Ahead | Break::Behind | Break::Order | Break::Early => {
                self.report.stamps_far += count;
                self.report.stamp_off_s = self.stamp_off_s(newest);
            }
        }
    }

    /// How much further ahead a stamp is than those of the track.
    fn stamp_off_s(&self, arrived: &ArrivedPose) -> f64 {
        let Some(track) = &self.track else { return 0.0 };
        match self.clock {
            StampClock::Host => lead_s(arrived) - track.lead_s(),
            StampClock::Data => arrived.pose.time.seconds_since(track.newest().pose.time),
        }
    }

    /// A pose was refused. If it is the track's vehicle's, and about as many come so as are taken, stamped nearer to when
    /// they arrive, it is the track whose stamps are wrong: whether this one was followed instead.
    fn follows_other_stamps(
        &mut self,
        refused: &ArrivedPose,
        take: &mut dyn FnMut(Guarded),
    ) -> bool {
        let Some(track) = &self.track else {
            return false;
        };
        let found = track.break_of(refused, self.clock);
        let is_of_stamps = !matches!(found, Some(Break::Epoch | Break::Jump { .. }));
        let is_better = lead_s(refused).abs() + track::EARLY_S < track.lead_s().abs();
        let counts = self.clock == StampClock::Host && is_of_stamps && is_better;
        if !counts || !self.preference.refused() {
            return false;
        }
        tracing::warn!(
            off_s = track.lead_s(),
            "poses whose stamps are nearer to their arrival are followed from now on"
        );
        if refused.pose.time <= track.newest().pose.time {
            take(Guarded::ClockWentBack);
        }
        (self.track, self.rival) = (None, None);
        self.preference = Preference::default();
        self.begin(&[*refused], take);
        true
    }

    fn doubt(&mut self, arrived: ArrivedPose, found: Break, take: &mut dyn FnMut(Guarded)) {
        if !self.rival_goes_on(&arrived) {
            if let Some(before) = self.rival.replace(Rival::new(arrived, found)) {
                self.refuse(&before);
            }
            return;
        }
        let interval_s = self.track.as_ref().map_or(0.0, Track::interval_s);
        let is_believed = |rival: &Rival| {
            rival.len() >= self.odds.least_run() && rival.span_s(self.clock) >= 3.0 * interval_s
        };
        if let Some(rival) = self.rival.take_if(|rival| is_believed(rival)) {
            self.track_moved(rival, take);
        }
    }

    /// Whether the pose is of the run that is held; one stamped no later than what came before is refused and counted.
    fn rival_goes_on(&mut self, arrived: &ArrivedPose) -> bool {
        let Some(rival) = &mut self.rival else {
            return false;
        };
        let goes_on = rival.go_on(arrived, self.clock);
        self.report.out_of_order += u64::from(goes_on == GoesOn::AsBefore);
        goes_on != GoesOn::No
    }

    /// Gathers poses until it is clear which clock they are on now.
    fn after_step(&mut self, arrived: ArrivedPose, take: &mut dyn FnMut(Guarded)) {
        if !self.rival_goes_on(&arrived) {
            self.rival = Some(Rival::new(arrived, Break::Behind));
        }
        let held = |rival: &mut Rival| rival.len() >= odds::LEAST_RUN;
        let Some(rival) = self.rival.take_if(held) else {
            return;
        };
        let mut poses = rival.into_poses();
        if let Some(former) = self.former.take() {
            let shift_s = former.shift_for(&poses);
            self.shift(&mut poses, shift_s);
        }
        self.begin(&poses, take);
    }

    fn shift(&mut self, poses: &mut [ArrivedPose], shift_s: f64) {
        self.report.clock_shift_s += shift_s;
        for arrived in poses {
            arrived.pose.time = arrived.pose.time.offset_by(shift_s);
        }
    }

    /// Those held are the track from now on.
    fn track_moved(&mut self, rival: Rival, take: &mut dyn FnMut(Guarded)) {
        let found = rival.found();
        let mut poses = rival.into_poses();
        if found == Break::Early {
            return self.begin(&poses, take);
        }
        let Some(old) = self.track.take() else { return };
        // A few poses were the strays, and not those that go on.
        let was_stray = old.len() < odds::LEAST_RUN && !matches!(found, Break::Jump { .. });
        if was_stray {
            self.report.stamps_far += old.len() as u64;
        } else if found == Break::Epoch {
            self.next_epoch(found.reason(0.0));
        } else if self.clock == StampClock::Host {
            let shift_s = match found {
                Break::Ahead | Break::Behind => old.shift_for(&poses),
                _ => 0.0,
            };
            self.shift(&mut poses, shift_s);
            self.next_epoch(found.reason(shift_s));
        }
        let first = poses.first().map(|arrived| arrived.pose.time);
        if first.is_some_and(|first| first <= old.newest().pose.time) {
            take(Guarded::ClockWentBack);
        }
        self.begin(&poses, take);
    }

    fn next_epoch(&mut self, reason: String) {
        self.report.epoch += 1;
        tracing::warn!(epoch = self.report.epoch, "a new epoch of poses: {reason}");
        self.report.epoch_reason = Some(reason);
    }
}

#[cfg(test)]
mod tests;
